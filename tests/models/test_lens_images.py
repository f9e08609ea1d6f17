"""Images of every camera: closed forms, other places where cameras stand, files, what is refused."""

from __future__ import annotations

import copy
import math
import pickle

import pytest
import torch

import torchrender as tr

LOOK = tr.Transform.look_at([0.3, 1.0, 4.0], [0, 0, 0])
LENS = {
    "distorted": {"type": "perspective", "fov": 45.0, "distortion": [-0.2, 0.08, 0.01, -0.02, 0.03, 0.02, -0.03, 0.01]},
    "thinlens": {"type": "thinlens", "fov": 40.0, "aperture_radius": 0.3, "focus_distance": 3.2},
    "orthographic": {"type": "orthographic", "to_world": LOOK @ tr.Transform.scale([1.5, 1.5, 1])},
    "fisheye": {"type": "fisheye", "fov": 130.0, "distortion": [0.05, -0.02, 0.01, -0.003], "max_angle": 80.0},
    "panorama": {"type": "panorama"},
    "radiancemeter": {"type": "radiancemeter"},
    "distant": {"type": "distant"},
    "distant_point": {"type": "distant", "target": [0.1, 0.3, 0.2]},
}
FILM = {"type": "hdrfilm", "width": 12, "height": 8, "rfilter": {"type": "box"}}
PIXEL = {**FILM, "width": 1, "height": 1}


def sensor(name: str) -> dict:
    film = PIXEL if name.startswith(("radiance", "distant")) else FILM
    return {"to_world": LOOK, "film": film, **LENS[name]}


def scene_of(**objects) -> tr.Scene:
    texels = torch.rand(6, 8, 3, generator=torch.Generator().manual_seed(1))
    paint = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels, "raw": True}}
    return tr.load_dict(
        {
            "type": "scene",
            "ball": {"type": "sphere", "radius": 0.8, "bsdf": paint},
            "floor": {
                "type": "rectangle",
                "to_world": tr.Transform.rotate([1, 0, 0], -90).scale(3),
                "bsdf": paint,
            },
            "sky": {"type": "constant", "radiance": 0.7},
            **objects,
        }
    )


def image(scene: tr.Scene, camera=0, **settings) -> torch.Tensor:
    return tr.render(scene, sensor=camera, **{"spp": 4, "seed": 3, **settings})


# --------------------------------------------------------------------------------------------------------- closed forms
def test_a_panorama_of_a_map_has_its_columns_and_rows():
    texels = torch.rand(6, 12, 3, generator=torch.Generator().manual_seed(2))
    turn = tr.Transform.rotate([1, 2, 3], 40)
    film = {"type": "hdrfilm", "width": 12 * 15, "height": 6 * 15, "rfilter": {"type": "box"}}
    scene = tr.load_dict(
        {
            "type": "scene",
            "camera": {"type": "panorama", "to_world": turn, "film": film},
            "sky": {"type": "envmap", "data": texels, "to_world": turn},
        }
    )
    found = image(scene)[:, 7::15]  # where texels have their centres
    row = (torch.arange(90) + 0.5) / 90 * 5  # the first and the last one are the poles
    above = row.long().clamp_max(4)
    part = (row - above)[:, None, None]
    expected = texels[above] * (1 - part) + texels[above + 1] * part
    # between texels the map is linear: half a pixel is a thirtieth of their distance
    torch.testing.assert_close(found, expected, atol=0.06, rtol=0)
    assert float((found - expected).abs().mean()) < 0.01


def test_the_disk_that_a_fisheye_sees():
    """A white ball of angular radius a under an equidistant lens is a disk of area pi (a f)^2."""
    angle, distance = math.radians(35), 4.0
    ball = {
        "type": "sphere",
        "center": [0, 0, distance],
        "radius": distance * math.sin(angle),
        "bsdf": {"type": "null"},
    }
    film = {"type": "hdrfilm", "width": 90, "height": 90, "rfilter": {"type": "box"}}
    scene = tr.load_dict({"type": "scene", "camera": {"type": "fisheye", "film": film}, "ball": ball})
    depth = image(scene, outputs=("depth",), spp=16).depth
    expected = math.pi * (angle * 45 / (math.pi / 2)) ** 2
    assert float(torch.isfinite(depth).sum()) == pytest.approx(expected, rel=0.12)  # pixels that touch it count
    side = torch.isfinite(depth[45]).sum()
    assert int(side) == pytest.approx(2 * angle * 45 / (math.pi / 2), abs=2)


def test_the_blur_of_a_lens():
    """A small emitter at distance d is a disk of radius r |1/d - 1/f| / tangent on the film, its light unchanged."""
    radius, focus, distance = 0.2, 2.0, 4.0
    lamp = {"type": "disk", "radius": 1, "emitter": {"type": "area", "radiance": 100.0}}
    lamp["to_world"] = tr.Transform.translate([0, 0, distance]).rotate([0, 1, 0], 180).scale(0.02)
    del lamp["radius"]
    film = {"type": "hdrfilm", "width": 101, "height": 101, "rfilter": {"type": "box"}}
    camera = {"type": "thinlens", "fov": 40.0, "aperture_radius": radius, "focus_distance": focus, "film": film}
    scene = tr.load_dict({"type": "scene", "camera": camera, "lamp": lamp})
    found = image(scene, spp=256)[..., 0]
    tangent = math.tan(math.radians(20))
    expected = radius * abs(1 / distance - 1 / focus) / tangent * 101 / 2
    y, x = torch.nonzero(found > 0, as_tuple=True)
    assert float((x.float() - 50).abs().max()) == pytest.approx(expected, abs=1.5)
    assert float((y.float() - 50).abs().max()) == pytest.approx(expected, abs=1.5)
    light = 100 * math.pi * 0.02**2 / (distance * tangent * 2 / 101) ** 2
    assert float(found.sum()) == pytest.approx(light, rel=0.05)
    sharp = image(tr.load_dict({"type": "scene", "camera": {**camera, "focus_distance": distance}, "lamp": lamp}))
    assert int((sharp > 0).any(2).sum()) <= 9


def test_an_orthographic_camera_measures_lengths():
    """Depth in parallel views does not change sizes: a 1 x 0.5 rectangle in a view 4 wide."""
    film = {"type": "hdrfilm", "width": 80, "height": 40, "rfilter": {"type": "box"}}
    camera = tr.OrthographicCamera.look_at([0, 0, 5], [0, 0, 0], width=4.0, size=(40, 80), filter="box")
    assert film["width"] == camera.film.width
    for z in (0.0, 3.0):
        plate = {"type": "rectangle", "to_world": tr.Transform.translate([0, 0, z]).scale([0.5, 0.25, 1])}
        scene = tr.load_dict({"type": "scene", "plate": plate})
        depth = image(scene, camera, outputs=("depth", "distance"))
        hit = torch.isfinite(depth.depth)
        assert int(hit.sum()) == 20 * 10
        torch.testing.assert_close(depth.depth[hit], torch.full((200,), 5 - z))
        torch.testing.assert_close(depth.distance[hit], depth.depth[hit])


def test_meters_of_one_pixel():
    light = {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 2.0, 3.0]}}
    plate = {"type": "rectangle", "emitter": light}  # in z = 0, towards +z
    colour = torch.tensor([1.0, 2.0, 3.0])

    def measured(meter: dict) -> torch.Tensor:
        return image(tr.load_dict({"type": "scene", "meter": meter, "plate": plate}), spp=4096)[0, 0]

    meter = {"type": "radiancemeter", "origin": [0.5, 0.5, 2], "film": PIXEL}
    torch.testing.assert_close(measured({**meter, "direction": [0, 0, -1]}), colour)
    assert float(measured({**meter, "direction": [0, 0, 1]}).abs().max()) == 0
    distant = {"type": "distant", "direction": [0, 0, -1], "film": PIXEL}
    torch.testing.assert_close(measured({**distant, "target": [0.3, -0.2, 0]}), colour)
    # over the cross section of the ball around it: 4 of 2 pi; five standard errors of 4096 samples
    share = 4 / (2 * math.pi)
    error = math.sqrt(share * (1 - share) / 4096)
    assert float(measured(distant)[0]) == pytest.approx(share, abs=5 * error + 1e-3)


@pytest.mark.parametrize("name", ["fisheye", "distorted"])
def test_where_the_lens_shows_nothing(name):
    lens = {"fov": 200.0, "max_angle": 90.0} if name == "fisheye" else {"fov": 100.0, "distortion": [-0.3, 0, 0, 0]}
    camera = {**sensor(name), **lens}
    scene = scene_of(camera=camera)
    exists = scene.camera.rays().tmax.reshape(8, 12) > 0
    assert bool(exists.any()) and not bool(exists.all())
    found = image(scene, spp=64, outputs=("rgb", "alpha", "depth"))
    dark = (found.rgb == 0).all(2)
    assert bool(dark[0, 0]) and not bool(dark[exists].any())
    assert float(found.alpha[0, 0]) == 0 and not math.isfinite(float(found.depth[0, 0]))
    assert float(image(scene, spp=64, integrator="volpath")[0, 0].abs().max()) == 0


# -------------------------------------------------------------------------------------------------------------- placing
@pytest.mark.parametrize("name", LENS)
def test_cameras_outside_of_the_scene_see_the_same(name):
    first = {"type": "perspective", "film": FILM}
    inside = scene_of(first=first, other=sensor(name))
    outside = scene_of()
    camera = inside.other
    expected = image(inside, 1)
    assert float(expected.max()) > 0
    assert torch.equal(image(outside, camera), expected)
    again = image(pickle.loads(pickle.dumps(outside)), camera)
    assert torch.equal(again, expected) and torch.equal(image(copy.deepcopy(outside), camera), expected)
    assert "camera." not in repr(outside)


def test_a_list_of_all_kinds():
    scene = scene_of()
    cameras = [tr.scene.registry.build(sensor(n), tr.scene.context.Context(), "sensor") for n in list(LENS)[:5]]
    views = image(scene, [*cameras, tr.PerspectiveCamera(film=FILM)])
    assert views.shape == (6, 8, 12, 3)
    for i, camera in enumerate(cameras):
        assert torch.equal(image(scene, camera), views[i])
    double = scene.double()
    assert image(double, cameras[1].double()).dtype == torch.float64


def test_gradients_of_a_camera_outside_of_the_scene():
    scene = scene_of()
    k = torch.tensor([-0.2, 0.08, 0.01, -0.02], requires_grad=True)
    camera = tr.PerspectiveCamera.from_opencv(
        [[12.0, 0, 6], [0, 12, 4], [0, 0, 1]], torch.eye(3), [0, 0, 4], (8, 12), k
    )
    (g,) = torch.autograd.grad(image(scene, camera).sum(), k)
    assert bool((g != 0).all())


@pytest.mark.parametrize("name", LENS)
def test_files(tmp_path, name):
    scene = scene_of(camera=sensor(name))
    scene.save(tmp_path / "scene.xml")
    again = tr.load_file(tmp_path / "scene.xml")
    assert type(again.camera) is type(scene.camera)
    for a, b in zip(scene.camera.parameters(), again.camera.parameters(), strict=True):
        torch.testing.assert_close(a, b, atol=0, rtol=0)
    assert torch.equal(image(again), image(scene))


def test_xml(tmp_path):
    text = """<scene version="3.0.0"><sensor type="perspective" id="cam"><float name="fov" value="45"/>
    <string name="distortion" value="-0.2, 0.1, 0, 0.01"/></sensor>
    <sensor type="distant" id="far"><vector name="direction" x="0" y="0" z="-1"/>
    <point name="target" x="1" y="2" z="3"/></sensor></scene>"""
    (tmp_path / "a.xml").write_text(text)
    scene = tr.load_file(tmp_path / "a.xml")
    torch.testing.assert_close(scene.cam.distortion, torch.tensor([-0.2, 0.1, 0, 0.01, 0, 0, 0, 0]))
    assert scene.far.target.tolist() == [1, 2, 3] and scene.far.film.window == (0, 0, 1, 1)


# -------------------------------------------------------------------------------------------- integrators and samplers
def glowing_room() -> dict:
    texels = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(4))
    light = {"type": "area", "radiance": {"type": "bitmap", "data": texels, "raw": True}}
    return {"room": {"type": "sphere", "radius": 6.0, "flip_normals": True, "emitter": light}}


@pytest.mark.parametrize("name", [n for n in LENS if not n.startswith("distant")])
def test_the_volumetric_path_tracer_sees_the_same_light(name):
    scene = tr.load_dict({"type": "scene", "camera": sensor(name), **glowing_room()})
    torch.testing.assert_close(
        image(scene, integrator=tr.VolumetricPathTracer(max_depth=1)),
        image(scene, integrator=tr.PathTracer(max_depth=1)),
    )


def test_a_camera_in_fog():
    """Light of 1 from everywhere through a ball of absorbing fog around the lens."""
    fog = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.0}
    ball = {"type": "sphere", "radius": 2.0, "bsdf": {"type": "null"}, "interior": fog}
    for name in ("thinlens", "fisheye", "panorama", "radiancemeter"):
        camera = {**sensor(name), "to_world": tr.Transform(), "near_clip": 1e-4, "aperture_radius": 1e-4}
        camera = {k: v for k, v in camera.items() if k in ("type", "film", "to_world", "fov") or k in LENS[name]}
        scene = tr.load_dict({"type": "scene", "fog": ball, "camera": camera, "sky": {"type": "constant"}})
        scene.camera.medium = scene.fog.interior_medium
        found = image(scene, integrator="volpath", spp=512)
        middle = found[found.shape[0] // 2, found.shape[1] // 2]
        assert float(middle.mean()) == pytest.approx(math.exp(-1.0), abs=0.1)


@pytest.mark.parametrize("sampler", ["stratified", "sobol"])
def test_samplers_choose_points_on_the_lens(sampler):
    """The same mean as with independent numbers, by a two-sample z-test at 1e-4 over 16 seeds each."""
    scene = scene_of(camera=sensor("thinlens"))
    means = [
        torch.stack([image(scene, seed=s, spp=16, sampler=kind).double().mean() for s in range(16)])
        for kind in ("independent", sampler)
    ]
    error = torch.sqrt(sum(m.var() / len(m) for m in means))
    assert bool(torch.isfinite(error)) and float((means[0].mean() - means[1].mean()).abs() / error) < 4.0


@pytest.mark.parametrize("name", LENS)
def test_light_tracing_refuses_them_by_name(name):
    scene = scene_of(camera=sensor(name))
    kind = "'perspective' with distortion" if name == "distorted" else f"'{LENS[name]['type']}'$"
    with pytest.raises(ValueError, match=rf"sensor: ParticleTracer connects light to a perspective.*of type {kind}"):
        image(scene, integrator="ptracer")


# ------------------------------------------------------------------------------------------------------------- extremes
@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning", "ignore:.*samples were not finite")
@pytest.mark.parametrize("name", LENS)
@pytest.mark.parametrize("value", [0.0, 1e30, -1e30, 1e-30])
def test_extreme_numbers_never_crash(name, value):
    """Images and gradients are finite, or there is an error that names the parameter."""
    for parameter in tr.load_dict({"type": "scene", "camera": sensor(name)}).camera.state_dict():
        scene = scene_of(camera=sensor(name))
        (tensor,) = [p for n, p in scene.named_parameters() if n == f"camera.{parameter}"]
        differentiable = scene.camera.fields()[parameter].derivative.startswith("interior")
        tensor.requires_grad_(differentiable)
        with torch.no_grad():
            tensor.fill_(value)
        try:
            found = image(scene, outputs=("rgb", "depth"))
            if differentiable:
                image(scene).sum().backward()
                assert bool(torch.isfinite(tensor.grad).all())
        except (ValueError, tr.RenderError) as error:
            assert parameter in str(error) or "finite" in str(error)
            continue
        assert bool(torch.isfinite(found.rgb).all())
