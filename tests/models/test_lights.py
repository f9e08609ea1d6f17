"""Lights without a surface: closed forms, what is refused, media, files; and choosing among many lights by power.

Images against another renderer: test_references.py; against the oracle, with all derivatives: test_oracle.py; of light
tracing: test_particle_images.py, test_particle_derivatives.py.
"""

from __future__ import annotations

import math

import light_scenes as ls
import numpy as np
import pytest
import torch
from moving_differences import direction_of

import torchrender as tr
from torchrender.testing.statistics import sidak, student_p_value

T = tr.Transform
DIRECT = tr.PathTracer(max_depth=2)
WALL = {"type": "rectangle", "to_world": T.scale(50), "bsdf": {"type": "diffuse", "reflectance": 1.0}}


def radiance_at(x: float, y: float, **objects) -> torch.Tensor:
    """Reflected radiance (3,) of a white wall at z = 0, at the point (x, y); its irradiance is pi times that."""
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    to_world = T.look_at([x + 0.5, y, 3], [x, y, 0], [0, 1, 0])
    camera = {"type": "perspective", "fov": 1e-5, "to_world": to_world, "film": film}
    scene = tr.load_dict({"type": "scene", "camera": camera, "wall": WALL, **objects}, dtype=torch.float64)
    return tr.render(scene, integrator=DIRECT, spp=1, seed=1)[0, 0]


# --------------------------------------------------------------------------------------------------------- closed forms
@pytest.mark.parametrize("angle", [0.0, 10.0, 19.5, 25.0, 29.5, 31.0, 60.0])
def test_irradiance_below_a_spot(angle):
    """I(angle) cos^3 / h^2 on a plane at the distance h, across the axis."""
    spot = {
        **{"type": "spot", "intensity": [6.0, 3.0, 1.5], "cutoff_angle": 30, "beam_width": 20},
        "to_world": T.look_at([0.3, -0.2, 2], [0.3, -0.2, 0], [0, 1, 0]),
    }
    found = radiance_at(0.3 + 2 * math.tan(math.radians(angle)), -0.2, spot=spot)
    fall = min(max((30 - angle) / 10, 0.0), 1.0)
    expected = fall * math.cos(math.radians(angle)) ** 3 / 4 / math.pi * torch.tensor([6.0, 3.0, 1.5]).double()
    assert torch.allclose(found, expected, rtol=1e-4, atol=1e-9)


def test_a_spot_ends_where_it_says_when_it_does_not_fade():
    spot = {
        "type": "spot",
        "cutoff_angle": 30,
        "beam_width": 30,
        "to_world": T.look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]),
    }
    inside, outside = (radiance_at(math.tan(math.radians(a)), 0, spot=spot)[0] for a in (29.9, 30.1))
    assert float(inside) == pytest.approx(math.cos(math.radians(29.9)) ** 3 / math.pi, rel=1e-4)
    assert float(outside) == 0


def test_beam_width_is_three_quarters_of_the_cutoff():
    assert float(tr.SpotLight(cutoff_angle=40.0).beam_width) == 30
    assert float(tr.SpotLight().beam_width) == 15


@pytest.mark.parametrize("distance", [1.0, 2.5])
def test_pixels_of_a_projector(distance):
    """On a white screen at distance 1 a texel shows its own colour; the irradiance falls with the square."""
    texels = torch.rand(3, 4, 3, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    image = {"type": "bitmap", "data": texels, "raw": True, "filter_type": "nearest"}
    to_world = T.look_at([0.1, 0.2, distance], [0.1, 0.2, 0], [0, 1, 0])
    beamer = {"type": "projector", "irradiance": image, "fov": 50, "scale": 0.5, "to_world": to_world}
    width = 2 * distance * math.tan(math.radians(25))
    for row in range(3):
        for column in range(4):
            # seen from the projector, which looks along -z: row 0 is up, column 0 at -x
            x = 0.1 + width * ((column + 0.3) / 4 - 0.5)
            y = 0.2 - width * 3 / 4 * ((row + 0.4) / 3 - 0.5)
            found = radiance_at(x, y, beamer=beamer)
            assert torch.allclose(found, 0.5 * texels[row, column] / distance**2, rtol=1e-4), (row, column)
    for x, y in ((width * 0.51, 0.0), (0.0, width * 3 / 8 * 1.02), (-width * 0.51, 0.0)):
        assert float(radiance_at(0.1 + x, 0.2 + y, beamer=beamer).max()) == 0


def test_fields_of_view_of_a_projector():
    data = torch.rand(10, 20, 3)
    by_height = tr.Projector(irradiance=data, fov=30.0, fov_axis="y")
    expected = 2 * math.degrees(math.atan(2 * math.tan(math.radians(15))))
    assert float(by_height.x_fov) == pytest.approx(expected, rel=1e-6)
    assert float(tr.Projector(irradiance=data, fov=30.0).x_fov) == 30
    lens = tr.Projector(irradiance=torch.rand(24, 36, 3), focal_length="18mm")
    assert float(lens.x_fov) == pytest.approx(90, rel=1e-6)


def test_parallel_light_on_a_diffuse_wall():
    direction = [0.4, -0.3, -1.0]
    cosine = 1 / math.sqrt(0.4**2 + 0.3**2 + 1)
    found = radiance_at(5.0, -3.0, sun={"type": "directional", "direction": direction, "irradiance": [3.0, 2.0, 1.0]})
    assert torch.allclose(found, torch.tensor([3.0, 2, 1]).double() * cosine / math.pi, rtol=1e-6)
    behind = {"type": "directional", "direction": [0.4, -0.3, 1.0]}
    assert float(radiance_at(0, 0, sun=behind).max()) == 0


def test_power_that_light_tracing_measures():
    """All of each light's flux arrives on a large floor: of the spot 2 pi I (1 - (sin c - sin b) / (c - b)), of the
    projector pi scale times the mean and the area of its image at distance 1. Student's tests, 0.01 together."""
    down = T.look_at([0, 1, 0], [0, -1, 0], [0, 0, 1])
    c, b = math.radians(50), math.radians(30)
    cases = {
        "spot": (
            {"type": "spot", "intensity": 2.0, "cutoff_angle": 50, "beam_width": 30, "to_world": down},
            4 * math.pi * (1 - (math.sin(c) - math.sin(b)) / (c - b)),
        ),
        "projector": (
            {"type": "projector", "irradiance": 0.7, "scale": 2.0, "fov": 60, "to_world": down},
            math.pi * 2 * 0.7 * 4 * math.tan(math.radians(30)) ** 2,
        ),
        "directional": ({"type": "directional", "irradiance": 2.0, "direction": [0.3, -1, 0.2]}, None),
    }
    for name, (light, power) in cases.items():
        description = ls.metered(half=5.0, light=light)
        description["floor"]["meter"]["film"]["rfilter"] = {"type": "box"}  # whose weights add up to 1 everywhere
        scene = tr.load_dict(description)
        images = [tr.render(scene, integrator=tr.ParticleTracer(max_depth=2), spp=200, seed=i) for i in range(8)]
        flux = torch.stack([image.double().mean() * 100 for image in images])
        expected = 2 / math.sqrt(1 + 0.3**2 + 0.2**2) * 100 if power is None else power
        error = float(flux.std()) / len(flux) ** 0.5
        gap = max(abs(float(flux.mean()) - expected) - 1e-5 * expected, 0.0)
        p = 1.0 if gap == 0 else float(student_p_value(torch.tensor(gap / error), len(flux) - 1))
        assert p >= sidak(0.01, len(cases)), f"{name}: {float(flux.mean()):.5g} +- {error:.2g}, expected {expected:.5g}"
        assert error < 0.02 * expected


# ------------------------------------------------------------------------------------------------------------ direction
def test_direction_and_to_world_of_parallel_light():
    sun = tr.DirectionalLight(direction=[0.0, -3.0, 4.0])
    assert torch.allclose(sun.direction, torch.tensor([0.0, -0.6, 0.8]))
    rotation = sun.to_world[:3, :3]
    assert torch.allclose(rotation.T @ rotation, torch.eye(3), atol=1e-6) and float(torch.det(rotation)) > 0
    sun.direction = [2.0, 0.0, 0.0]
    assert torch.allclose(sun.to_world[:3, 2], torch.tensor([1.0, 0.0, 0.0]))
    assert torch.allclose(tr.DirectionalLight().direction, torch.tensor([0.0, 0.0, 1.0]))


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
def test_gradient_by_a_direction_that_was_given():
    """E cos / pi on a wall at z = 0, by the direction d: E (d_z / |d|)' / pi."""
    direction = torch.tensor([0.4, -0.3, -1.0], dtype=torch.float64, requires_grad=True)
    radiance_at(0, 0, sun={"type": "directional", "direction": direction, "irradiance": 2.0})[0].backward()
    given = direction.grad
    d = direction.detach().clone().requires_grad_()
    (-d[2] / d.norm() * 2 / math.pi).backward()
    assert torch.allclose(given, d.grad, rtol=1e-6)


# -------------------------------------------------------------------------------------------------------- what is wrong
@pytest.mark.parametrize(
    ("light", "message"),
    [
        ({"type": "spot", "cutoff_angle": 20, "beam_width": 25}, r"lamp.beam_width: expected at most cutoff_angle.*20"),
        ({"type": "spot", "cutoff_angle": 200}, "lamp.cutoff_angle: 200 is outside the range"),
        ({"type": "spot", "to_world": T.scale([1, 2, 1])}, "lamp.to_world: a spot light's matrix may turn and move"),
        (
            {"type": "projector", "to_world": T.scale([1, 2, 1])},
            "lamp.to_world: a projector's matrix may turn and move",
        ),
        ({"type": "projector", "fov": 180}, "lamp.fov: expected an angle between 0 and 180"),
        ({"type": "projector", "fov": 40, "focal_length": "50mm"}, "lamp: projector: give one of fov, focal_length"),
        ({"type": "directional", "direction": [0, 0, 0]}, "lamp.direction: expected a direction that is not zero"),
        ({"type": "directional", "direction": [0, 0, 1], "to_world": T.scale(1)}, "give direction or to_world"),
        ({"type": "directional", "direction": [0, 1]}, "lamp.direction: expected three numbers"),
        ({"type": "spot", "position": [0, 1, 2]}, "lamp: spot has no parameter 'position'"),
        (
            {"type": "projector", "irradiance": {"type": "ref", "id": "image"}},
            "lamp: projector: with a reference to an image elsewhere, give fov",
        ),
    ],
)
def test_errors(light, message):
    with pytest.raises(ValueError, match=message):
        tr.load_dict({"type": "scene", "lamp": light})


def test_images_that_need_a_mesh_are_refused():
    attribute = {"type": "mesh_attribute", "name": "vertex_color"}
    checks = {"type": "checkerboard", "color0": attribute}
    for light in (
        {"type": "spot", "texture": attribute},
        {"type": "projector", "irradiance": checks, "fov": 30},
    ):
        scene = tr.load_dict(ls.floor_view(lamp=light))
        with pytest.raises(ValueError, match=r"lamp: field .*: expected a texture with coordinates"):
            tr.render(scene, spp=1)


def test_a_frame_that_cannot_be_inverted_is_refused_by_name():
    scene = tr.load_dict(ls.floor_view(lamp=ls.spot()))
    matrix = scene.lamp.to_world.detach().clone()
    matrix[:3, 0] = 0
    with pytest.raises(ValueError, match="lamp: field 'to_world': expected an invertible matrix"):
        tr.render(scene, spp=1, params={"lamp.to_world": matrix})
    assert float(tr.render(scene, spp=4, seed=1).detach().max()) > 0


# ---------------------------------------------------------------------------------------------------------------- media
FOG = {
    "type": "cube",
    "to_world": T.translate([0.2, 0, 0.2]) @ T.scale([1.5, 0.9, 1.5]),
    "bsdf": {"type": "null"},
    "interior": {"type": "homogeneous", "sigma_t": [0.5, 0.7, 0.9], "albedo": 0.8},
}
IN_FOG = {
    "spot": (ls.spot(), ("cutoff_angle", "beam_width", "intensity.value", "texture.data")),
    "projector": (ls.projector(70), ("x_fov", "scale", "irradiance.data")),
    "sun": (ls.sun(), ("irradiance.value",)),
}


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize("name", IN_FOG)
def test_derivatives_through_media(name):
    """With the same random numbers a difference has no noise, but for the border of the projector's image, which moves
    with its field of view and is part of no derivative: that image fades out at its border."""
    light, names = IN_FOG[name]
    if name == "projector":
        fade = torch.tensor([0.0, 1, 2, 2, 1, 0])
        light["irradiance"] = {**light["irradiance"], "data": (fade[:, None] * fade)[..., None].expand(-1, -1, 3)}
    scene = tr.load_dict(ls.floor_view(lamp=light, fog=FOG), dtype=torch.float64)
    volumetric = tr.VolumetricPathTracer(max_depth=4, rr_depth=99)
    values = {f"lamp.{n}": scene.get_parameter(f"lamp.{n}").detach() for n in (*names, "to_world")}

    def f(params):
        image = tr.render(scene, integrator=volumetric, spp=16, seed=2, correlated=True, params=params)
        weight = torch.linspace(1, 2, image.numel(), dtype=image.dtype).reshape(image.shape)
        return (image * weight).mean()

    leaves = {n: v.clone().requires_grad_() for n, v in values.items()}
    gradients = torch.autograd.grad(f(leaves), list(leaves.values()))
    generator = torch.Generator().manual_seed(3)
    for (parameter, value), gradient in zip(values.items(), gradients, strict=True):
        change = torch.rand(value.shape, generator=generator, dtype=value.dtype) + 0.5
        if parameter == "lamp.to_world":
            change = direction_of(parameter, value)
        with torch.no_grad():
            high, low = (float(f({**values, parameter: value + s * 1e-4 * change})) for s in (1, -1))
        found = float((gradient * change).sum())
        assert found == pytest.approx((high - low) / 2e-4, rel=2e-3), parameter
        assert abs(found) > 1e-5, parameter
    result = tr.testing.dot_product_test(
        lambda *tensors: tr.render(
            scene, integrator=volumetric, spp=4, seed=5, params=dict(zip(values, tensors, strict=True))
        ),
        list(values.values()),
        rtol=1e-10,
    )
    assert result, result.message


# ---------------------------------------------------------------------------------------------------------------- files
def test_saved_scenes_come_back(tmp_path):
    scene = tr.load_dict(ls.room(spot=ls.spot(), beamer=ls.projector(), sun=ls.sun(), integrator={"type": "path"}))
    scene["integrator"] = tr.PathTracer(max_depth=3, emitter_sampling="power")
    scene.save(tmp_path / "scene.xml")
    again = tr.load_file(tmp_path / "scene.xml")
    assert again.integrator.emitter_sampling == "power"
    values = dict(again.named_parameters())
    for name, value in scene.named_parameters():
        assert torch.allclose(values[name], value, atol=1e-6), name
    first, second = (tr.render(s, spp=4, seed=1) for s in (scene, again))
    assert torch.allclose(first, second, rtol=1e-4, atol=1e-5)
    assert 'name="fov"' in (tmp_path / "scene.xml").read_text()


def test_scenes_in_mitsubas_words(tmp_path):
    text = """<scene version="3.0.0">
        <emitter type="directional" id="sun"><vector name="direction" x="0" y="-1" z="1"/>
            <rgb name="irradiance" value="1, 2, 3"/></emitter>
        <emitter type="spot" id="lamp"><rgb name="intensity" value="4"/><float name="cutoff_angle" value="50"/>
            <transform name="to_world"><lookat origin="1, 2, 3" target="1, 0, 3" up="0, 0, 1"/></transform>
            <texture name="texture" type="checkerboard"/></emitter>
        <emitter type="projector" id="beamer"><float name="fov" value="30"/><string name="fov_axis" value="x"/>
            <texture name="irradiance" type="checkerboard"/><float name="scale" value="2"/></emitter>
    </scene>"""
    (tmp_path / "a.xml").write_text(text)
    scene = tr.load_file(tmp_path / "a.xml")
    assert torch.allclose(scene.sun.direction, torch.tensor([0.0, -(0.5**0.5), 0.5**0.5]))
    assert torch.allclose(scene.lamp.to_world[:3, 2], torch.tensor([0.0, -1.0, 0.0]), atol=1e-6)
    assert float(scene.lamp.beam_width) == 37.5 and float(scene.beamer.x_fov) == 30


# ----------------------------------------------------------------------------------------------------- many lights
def many(n: int = 40, strong: float = 100.0, weak: float = 0.1, **more) -> dict:
    """One strong light among weak ones, close to each other over a floor."""
    lights = {
        f"light_{i}": {"type": "point", "position": [0.05 * (i % 8), 1.0, 0.05 * (i // 8)], "intensity": weak}
        for i in range(n)
    }
    lights[f"light_{min(7, n - 1)}"]["intensity"] = strong
    return ls.floor_view(**lights, **more)


def runs(scene: tr.Scene, sampling: str, spp: int, count: int) -> torch.Tensor:
    integrator = tr.PathTracer(max_depth=2, emitter_sampling=sampling)
    settings = {"integrator": integrator, "spp": spp, "sampler": "independent"}
    images = [tr.render(scene, seed=100 + i, **settings).detach() for i in range(count)]
    return torch.stack(images).double().flatten(1)


def test_choosing_by_power_lowers_the_variance_as_expected():
    """Of estimates c_i / p_i the second moment is sum c_i^2 / p_i. The contributions c_i are nearly proportional to the
    intensities, of which the mean is known; the floor's texture is smooth. The ratio of variances is measured to 20 %,
    and the means are equal (Student, 0.001)."""
    n, strong, weak = 40, 100.0, 0.1
    scene = tr.load_dict({**many(n, strong, weak), "floor": {**ls.floor(), "bsdf": {"type": "diffuse"}}})
    power = np.full(n, weak)
    power[7] = strong
    chosen = np.maximum(power, 0.1 * power.mean())
    total = power.sum() ** 2

    def variance(p):
        return (power**2 / p).sum() - total

    expected = variance(np.full(n, 1 / n)) / variance(chosen / chosen.sum())
    by_weight, by_power = (runs(scene, sampling, 4, 48) for sampling in ("weight", "power"))
    gain = float(by_weight.var(0).mean() / by_power.var(0).mean())
    assert expected > 100
    assert gain == pytest.approx(expected, rel=0.2), f"gain {gain:.4g}, expected {expected:.4g}"
    difference = by_power.mean(1) - by_weight.mean(1)
    score = difference.mean().abs() / (difference.std() / len(difference) ** 0.5)
    assert float(student_p_value(score, len(difference) - 1)) > 0.001


def test_gradients_of_lights_chosen_by_power():
    """Of the mean of the image by every intensity: the same as with weights, also that of a black light."""
    scene = tr.load_dict(many(6, 5.0, 1.0), dtype=torch.float64)
    scene.light_3.intensity = 0.0
    names = [f"light_{i}.intensity.value" for i in range(6)]
    leaves = scene.train_only(*names)
    found = {}
    for sampling in ("weight", "power"):
        integrator = tr.PathTracer(max_depth=2, emitter_sampling=sampling)
        rows = []
        for seed in range(16):
            image = tr.render(scene, integrator=integrator, spp=1, spp_grad=64, seed=seed)
            rows.append(torch.stack(torch.autograd.grad(image.mean(), leaves)))
        found[sampling] = torch.stack(rows)
    mean = {s: g.mean(0) for s, g in found.items()}
    error = sum(g.var(0) / len(g) for g in found.values()).sqrt()
    p = student_p_value((mean["power"] - mean["weight"]).abs() / error, 15)
    assert bool((p > sidak(0.01, len(names))).all()), f"{mean}"
    assert float(mean["power"][3]) > 10 * float(error[3])


@pytest.mark.filterwarnings("ignore:the scene has a directionalarea light")
def test_power_of_every_kind_of_light():
    """Probabilities are those of the closed forms, with a tenth of the mean for the weak ones."""
    scene = tr.load_dict(
        {
            "type": "scene",
            "floor": ls.floor(1.0),
            "ball": {"type": "sphere", "radius": 0.5, "emitter": {"type": "area", "radiance": 2.0}},
            "spot": {"type": "spot", "cutoff_angle": 50, "beam_width": 50, "intensity": 3.0, "to_world": T.scale(1)},
            "beamer": {"type": "projector", "irradiance": torch.full((2, 4, 3), 1.5), "fov": 60},
            "bulb": {"type": "point", "intensity": 4.0},
            "lamp": {
                "type": "rectangle",
                "emitter": {"type": "area", "radiance": {"type": "checkerboard", "color0": 1.0, "color1": 3.0}},
            },
            "beam": {"type": "rectangle", "emitter": {"type": "directionalarea", "radiance": 2.0}},
            "sun": {"type": "directional", "irradiance": 2.0},
            "sky": {"type": "constant", "radiance": 0.5},
        },
        dtype=torch.float64,
    )
    # of the ball around the scene: x, z in [-1, 1], y in [-1, 1]
    disk = math.pi * (math.sqrt(3) * 1.001 + 1e-6) ** 2
    expected = {
        "ball": 2 * math.pi * math.pi,
        "spot": 3 * 2 * math.pi * (1 - math.cos(math.radians(50))),
        "beamer": math.pi * 1.5 * 4 * math.tan(math.radians(30)) ** 2 / 2,
        "bulb": 16 * math.pi,
        "lamp": 2 * math.pi * 4,
        "beam": 2 * 4,
        "sun": 2 * disk,
        "sky": 4 * math.pi * disk * 0.5,
    }
    mean = sum(expected.values()) / len(expected)
    weights = {name: max(power, 0.1 * mean) for name, power in expected.items()}
    order = [path.split(".")[0] for _, _, path in scene.layout().objects["emitter"]]
    found = pmf_by_power(scene)
    assert set(order) == set(expected)
    for name, p in zip(order, found, strict=True):
        assert p == pytest.approx(weights[name] / sum(weights.values()), rel=1e-6), name


def pmf_by_power(scene: tr.Scene) -> list[float]:
    """Probabilities of the emitters in their native order."""
    settings = {"sensor": tr.PerspectiveCamera(), "spp": 1, "crop": (0, 0, 2, 2)}
    tr.render(scene, integrator=tr.PathTracer(emitter_sampling="power"), **settings)
    return scene._native.handle.emitter_probabilities()


def test_an_unknown_way_of_choosing_is_refused():
    with pytest.raises(ValueError, match="PathTracer: emitter_sampling: expected weight or power, got 'area'"):
        tr.PathTracer(emitter_sampling="area")
    with pytest.raises(ValueError, match="emitter_sampling: expected weight or power"):
        tr.load_dict({"type": "scene", "integrator": {"type": "direct", "emitter_sampling": 1}})
