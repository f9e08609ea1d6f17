"""Light tracing against closed forms: what beams and lamps bring to a receiver, and where glass bends it to.

Tests of random quantities reject correct code with a probability of 0.001 each; paths that are reflected or
transmitted by chance are counted, so that the noise is known.
"""

from __future__ import annotations

import math

import light_scenes as ls
import pytest
import torch

import torchrender as tr
from torchrender.testing.statistics import normal_p_value, sidak

pytestmark = pytest.mark.once  # closed forms of what the images of test_particle_images have

SIGNIFICANCE = 0.001
T = tr.Transform
COLOUR = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
RGB = {"type": "rgb", "value": COLOUR.tolist()}


def film(size: int, rfilter: str = "tent") -> dict:
    """A tent of radius 1 keeps sums and first moments of what falls on the film, if none of it is near the edge."""
    return {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": rfilter}}


def receiver(half: float, size: int, rfilter: str = "tent", **more) -> dict:
    """A black floor at y = -1 that measures; texels are 2 half / size wide."""
    meter = {"type": "irradiancemeter", "film": film(size, rfilter)}
    return ls.floor(half, **{"bsdf": {"type": "diffuse", "reflectance": 0.0}, "meter": meter, **more})


def narrow_beam(half: float, x: float = 0.0, z: float = 0.0, radiance=RGB) -> dict:
    """A square beam that goes down from y = 2."""
    emitter = {"type": "directionalarea", "radiance": radiance}
    return {"type": "rectangle", "to_world": ls.facing_down(x, 2, z) @ T.scale([half, half, 1]), "emitter": emitter}


def measure(spp: int, max_depth: int = -1, seed: int = 1, **objects: object) -> torch.Tensor:
    """Irradiance (H, W, 3) in double precision, from independent paths: those that arrive are counted."""
    scene = tr.load_dict({"type": "scene", **objects}, dtype=torch.float64)
    integrator = tr.ParticleTracer(max_depth=max_depth, rr_depth=99)
    return tr.render(scene, integrator=integrator, spp=spp, seed=seed, sampler="independent")


def power(image: torch.Tensor, half: float) -> torch.Tensor:
    """What arrives on the whole of a square of that half width."""
    return image.mean((0, 1)) * (2 * half) ** 2


def moments(image: torch.Tensor, half: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean (x, z) of what arrives, and its variance (2,), without that of the tent: 1/6 of a square texel."""
    weight = image[..., 0] / image[..., 0].sum()
    n = len(image)
    line = ((torch.arange(n, dtype=torch.float64) + 0.5) / n * 2 - 1) * half
    x, z = line.expand(n, n), -line[:, None].expand(n, n)  # row 0 is v = 0, where z is largest
    mean = torch.stack([(weight * x).sum(), (weight * z).sum()])
    variance = torch.stack([(weight * (x - mean[0]) ** 2).sum(), (weight * (z - mean[1]) ** 2).sum()])
    return mean, variance - (2 * half / n) ** 2 / 6


def share_is(found: float, expected: float, n: int, tests: int = 1) -> None:
    """`found` is the share of n paths that arrive; `expected` its probability."""
    z = (found - expected) / math.sqrt(expected * (1 - expected) / n)
    p = float(normal_p_value(torch.tensor(z)))
    assert p >= sidak(SIGNIFICANCE, tests), f"share {found:.6f}, expected {expected:.6f}, z = {z:.2f}"


# --------------------------------------------------------------------------------------------------------------- beams
@pytest.mark.parametrize("shape", ["rectangle", "disk"])
def test_irradiance_of_a_beam_is_its_radiance(shape):
    beam = {**narrow_beam(0.5, 0.3, 0.1), "type": shape}
    image = measure(16, floor=receiver(3, 24), light=beam)
    area = 1.0 if shape == "rectangle" else math.pi / 4
    torch.testing.assert_close(power(image, 3.0), area * COLOUR, rtol=1e-9, atol=0)  # every path brings the same
    mean, _ = moments(image, 3)
    assert float((mean - torch.tensor([0.3, 0.1])).norm()) < 4 * 0.5 / math.sqrt(16 * 24 * 24)
    # within the beam, whose rays are spread evenly: (H, W) in the middle of a receiver as wide as it
    middle = measure(64, floor=receiver(0.1, 4, "box"), light={**narrow_beam(0.5), "type": shape})
    n = 64 * 16 * (0.04 / area)
    assert float(normal_p_value((middle.mean() / COLOUR.mean() - 1) * math.sqrt(n))) >= SIGNIFICANCE


def test_a_beam_at_an_angle_spreads_over_more():
    angle = math.radians(50)
    emitter = {"type": "directionalarea", "radiance": RGB}
    place = T.rotate([0, 0, 1], 50) @ T.translate([0, 2, 0]) @ T.rotate([1, 0, 0], 90) @ T.scale(0.3)
    image = measure(32, floor=receiver(4.5, 90), light={"type": "rectangle", "to_world": place, "emitter": emitter})
    torch.testing.assert_close(power(image, 4.5), 0.36 * COLOUR, rtol=1e-9, atol=0)
    mean, variance = moments(image, 4.5)
    expected = torch.tensor([-2 * math.sin(angle) + math.tan(angle) * (2 * math.cos(angle) + 1), 0.0])
    # the centre of the lamp is at 2 (-sin, cos), the beam goes along (sin, -cos)
    assert float((mean - expected).norm()) < 4 * 0.6 / math.sqrt(12 * 32 * 90 * 90)
    sides = torch.tensor([0.6 / math.cos(angle), 0.6])
    torch.testing.assert_close(variance, (sides**2 / 12).double(), rtol=0.03, atol=0)


def test_a_texture_is_thrown_as_it_is():
    data = torch.rand(3, 4, 3, generator=torch.Generator().manual_seed(2))
    texture = {"type": "bitmap", "data": data, "raw": True, "filter_type": "nearest"}
    meter = {"type": "irradiancemeter", "film": {**film(4, "box"), "height": 3}}
    place = T.translate([0, -1, 0]) @ T.rotate([1, 0, 0], -90)
    scene = tr.load_dict(
        {
            "type": "scene",
            "floor": {"type": "rectangle", "to_world": place, "meter": meter},
            "light": narrow_beam(1.0, radiance=texture),
        },
        dtype=torch.float64,
    )
    # texels of the lamp are those of the receiver, seen from behind, v against v
    runs = torch.stack([tr.render(scene, integrator="ptracer", spp=64, seed=i) for i in range(30)])
    expected = data.flip(0).double()
    z = (runs.mean(0) - expected) / (runs.std(0) / math.sqrt(30))
    assert float(normal_p_value(z).min()) >= sidak(SIGNIFICANCE, z.numel())
    assert float(((runs.mean(0) - expected) / expected).abs().max()) < 0.1


# --------------------------------------------------------------------------------------------------------------- glass
def test_one_surface_of_glass_takes_its_reflection_and_no_more():
    """Power is measured, not radiance: there is no factor of eta squared."""
    angle, eta, spp, size = 35.0, 1.5, 40, 16
    place = T.rotate([0, 0, 1], angle) @ T.rotate([1, 0, 0], -90) @ T.scale(3)
    glass = {"type": "dielectric", "int_ior": eta, "ext_ior": 1.0}
    plate = {"type": "rectangle", "to_world": place, "bsdf": glass}
    image = measure(spp, 3, floor=receiver(3, size), light=narrow_beam(0.2), plate=plate)
    expected = 1 - ls.fresnel(math.cos(math.radians(angle)), eta)
    share_is(float(power(image, 3.0)[0]) / 0.16, expected, spp * size**2)
    mean, _ = moments(image, 3)
    bent = math.radians(angle) - math.asin(math.sin(math.radians(angle)) / eta)  # Snell
    # towards the normal, which leans to -x: the ray that comes from above goes on to +x
    assert float(mean[0]) == pytest.approx(math.tan(bent), abs=4 * 0.4 / math.sqrt(12 * spp * size**2))
    assert abs(float(mean[1])) < 4 * 0.4 / math.sqrt(12 * spp * size**2)


@pytest.mark.parametrize("angle", [0.0, 30.0, 40.0])  # from 45 degrees on reflected light goes down, too
def test_a_flat_plate_shifts_the_image(angle):
    eta, thickness, spp, size = 1.5, 0.4, 4, 50
    glass = {"type": "dielectric", "int_ior": eta, "ext_ior": 1.0}
    place = T.rotate([0, 0, 1], angle) @ T.scale([1, thickness / 2, 2])
    plate = {"type": "cube", "to_world": place, "bsdf": glass}
    through = measure(spp, 4, floor=receiver(2.5, size), light=narrow_beam(0.2), plate=plate)
    sine, cosine = math.sin(math.radians(angle)), math.cos(math.radians(angle))
    reflectance = ls.fresnel(cosine, eta)
    n = spp * size**2
    share_is(float(power(through, 2.5)[0]) / 0.16, (1 - reflectance) ** 2, n, tests=2)
    mean, variance = moments(through, 2.5)
    shift = thickness * sine * (1 - cosine / math.sqrt(eta**2 - sine**2))  # across the ray, which goes straight down
    assert float(mean[0]) == pytest.approx(shift, abs=4 * 0.4 / math.sqrt(12 * n))
    assert float(variance[0]) == pytest.approx(0.16 / 12, rel=0.03)
    # with all inner reflections, which arrive beside it
    beside = measure(spp, -1, floor=receiver(6, size), light=narrow_beam(0.2), plate=plate)
    whole = (1 - reflectance) / (1 + reflectance)
    if angle <= 30:  # else some of them leave by the plate's side
        share_is(float(power(beside, 6.0)[0]) / 0.16, whole, n, tests=2)


def test_tinted_glass_multiplies():
    tint = torch.tensor([0.2, 0.5, 0.9], dtype=torch.float64)
    glass = {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.0}
    glass["specular_transmittance"] = {"type": "rgb", "value": tint.tolist()}
    plate = {"type": "rectangle", "to_world": T.rotate([1, 0, 0], -90), "bsdf": glass}
    image = measure(4, floor=receiver(3, 8), light=narrow_beam(0.2), plate=plate)
    torch.testing.assert_close(power(image, 3.0), 0.16 * tint * COLOUR, rtol=1e-6, atol=0)


@pytest.mark.parametrize("kind", ["sphere", "mesh"])
def test_a_ball_lens_focuses_at_its_focal_length(kind):
    """Rays at a small height h cross a plane at distance d from the centre at h (1 - d / f), f = n R / 2 (n - 1)."""
    eta, radius, half, size, spp = 1.5, 0.5, 0.02, 32, 8
    focal = eta * radius / (2 * (eta - 1))
    glass = {"type": "dielectric", "int_ior": eta, "ext_ior": 1.0}
    reach = 0.04
    for distance in (0.7 * focal, focal, 2 * focal):
        center = [0.0, -1 + distance, 0.0]
        lens: object = {"type": "sphere", "center": center, "radius": radius, "bsdf": glass}
        if kind == "mesh":
            vertices, faces = ls.icosphere(5)
            lens = tr.Mesh(vertices * radius + torch.tensor(center), faces, vertex_normals=vertices, bsdf=glass)
        # beside the axis, so that it is seen which side is which
        image = measure(spp, 4, floor=receiver(reach, size), light=narrow_beam(half / 2, half / 2), lens=lens)
        mean, variance = moments(image, reach)
        magnification = 1 - distance / focal
        texel = 2 * reach / size
        tolerance = 0.02 * half if kind == "sphere" else 0.06 * half
        assert float(mean[0]) == pytest.approx(half / 2 * magnification, abs=tolerance)
        assert abs(float(mean[1])) < tolerance
        wide = variance.clamp_min(0).sqrt()
        if distance == focal:
            assert float(wide.max()) < 0.5 * texel
        else:
            expected = half * abs(magnification) / math.sqrt(12)
            assert float((wide - expected).abs().max()) < tolerance
        share = float(power(image, reach)[0]) / half**2
        share_is(share, (1 - ls.fresnel(1.0, eta)) ** 2, spp * size**2, tests=3)


def test_energy_through_a_wavy_sheet_is_what_fresnel_lets_through():
    spp, size, n = 10, 32, 200
    sheet = ls.wavy_sheet({"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}, amplitude=0.1)
    scene = tr.load_dict(
        {"type": "scene", "floor": receiver(20, size), "light": narrow_beam(0.8), "sheet": sheet}, dtype=torch.float64
    )
    image = tr.render(scene, integrator=tr.ParticleTracer(max_depth=3), spp=spp, seed=1)
    line = ((torch.arange(n, dtype=torch.float64) + 0.5) / n * 2 - 1) * 0.8
    x, z = torch.meshgrid(line, line, indexing="ij")
    origins = torch.stack([x, torch.full_like(x, 1.9), z], -1).reshape(-1, 3)
    hits = tr.ray_intersect(scene, origins, torch.tensor([[0.0, -1, 0]]).double().expand_as(origins))
    normals = torch.nn.functional.normalize(hits.shading_normal, dim=1)
    through = torch.tensor([1 - ls.fresnel(abs(c), 1.5) for c in normals[:, 1].tolist()]).double()
    assert float(through.std()) > 1e-6
    share_is(float(power(image, 20.0)[0]) / 1.6**2, float(through.mean()), spp * size**2)


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("inside_out", [False, True])
def test_steep_waves_that_shadow_and_reflect_totally_stay_finite(inside_out, normals):
    iors = {"int_ior": 1.0, "ext_ior": 1.5} if inside_out else {"int_ior": 1.5, "ext_ior": 1.0}
    sheet = ls.wavy_sheet({"type": "dielectric", **iors}, amplitude=1.5, normals=normals)
    scene = tr.load_dict(
        {"type": "scene", "floor": receiver(20, 16), "light": ls.beam(RGB), "sheet": sheet}, dtype=torch.float64
    )
    vertices, matrix = scene.train_only("sheet.vertex_positions", "light.to_world")
    image = tr.render(scene, integrator=tr.ParticleTracer(max_depth=12), spp=16, seed=1, nan="raise")
    image.square().mean().backward()
    for tensor in (image, vertices.grad, matrix.grad):
        assert bool(torch.isfinite(tensor).all())
        assert float(tensor.abs().max()) > 0
    assert scene.statistics["render"]["nonfinite"] == 0
    sent, found = 1.4 * 1.2, float(power(image.detach(), 20.0)[0])
    # interpolated normals do not keep energy where they are far from those of the faces
    assert 0.3 * sent < found <= sent * (1.3 if normals else 1 + 1e-9)


# --------------------------------------------------------------------------------------------------------------- lamps
def test_form_factor_of_parallel_squares():
    """Of two unit squares at the distance 1 (Howell, "A catalog of radiation heat transfer factors", C-11)."""
    spp, size = 100, 16
    s = math.sqrt(2)
    expected = 2 / math.pi * (math.log(math.sqrt(4 / 3)) + 2 * s * math.atan(1 / s) - 2 * math.atan(1))
    lamp = {
        "type": "rectangle",
        "to_world": ls.facing_down(0, 0, 0) @ T.scale(0.5),
        "emitter": {"type": "area", "radiance": RGB},
    }
    image = measure(spp, floor=receiver(0.5, size, "box"), light=lamp)
    share_is(float(image[..., 0].mean()) / math.pi, expected, spp * size**2)


def test_a_point_light_above_a_plane():
    """I cos / r^2, averaged over every texel."""
    spp, size, half, height = 400, 8, 2.0, 1.5
    lamp = {"type": "point", "position": [0.3, -1 + height, 0.4], "intensity": RGB}
    floor = receiver(half, size, "box")
    image = measure(spp, floor=floor, light=lamp)[..., 0]
    fine = 16
    line = ((torch.arange(size * fine, dtype=torch.float64) + 0.5) / (size * fine) * 2 - 1) * half
    x, z = line.expand(len(line), -1), -line[:, None].expand(-1, len(line))
    values = height / ((x - 0.3) ** 2 + (z - 0.4) ** 2 + height**2) ** 1.5
    expected = torch.nn.functional.avg_pool2d(values[None, None], fine)[0, 0]
    texel = (2 * half / size) ** 2
    share = expected * texel / (4 * math.pi)
    z_score = (image - expected) / expected * torch.sqrt(share * spp * size**2 / (1 - share))
    assert float(normal_p_value(z_score).min()) >= sidak(SIGNIFICANCE, z_score.numel())


@pytest.mark.parametrize("rfilter", ["box", "tent", "gaussian"])
def test_a_sky_of_constant_radiance(rfilter):
    """Up to the edge of the surface, beyond which a filter finds nothing."""
    objects = {"floor": receiver(1, 8, rfilter), "sky": {"type": "constant"}}
    runs = torch.stack([measure(16, 2, i, **objects).mean() for i in range(40)])
    z = (runs.mean() - math.pi) / (runs.std() / math.sqrt(40))
    assert float(normal_p_value(z)) >= SIGNIFICANCE
    assert float(runs.std()) / math.sqrt(40) < 0.03 * math.pi


def test_a_camera_sees_what_a_beam_brings():
    """Radiance of a diffuse surface: albedo E / pi."""
    description = ls.floor_view(ls.close_camera(fov=8), light=narrow_beam(0.2))
    scene = tr.load_dict(description, dtype=torch.float64)
    settings = {"integrator": tr.ParticleTracer(max_depth=3), "sampler": "independent"}
    runs = torch.stack([tr.render(scene, spp=64, seed=i, **settings).mean((0, 1)) for i in range(30)])
    expected = COLOUR * torch.tensor([0.5, 0.6, 0.7]) / math.pi
    z = (runs.mean(0) - expected) / (runs.std(0) / math.sqrt(30))
    assert float(normal_p_value(z).min()) >= sidak(SIGNIFICANCE, 3)
    assert float((runs.std(0) / expected).max()) / math.sqrt(30) < 0.01


# ----------------------------------------------------------------------------------------------------- what is measured
def test_the_front_is_measured_and_null_lets_light_through():
    null = {"type": "null"}
    upper = {**receiver(2, 8, bsdf=null), "to_world": T.rotate([1, 0, 0], -90) @ T.scale(2)}
    back = {**upper, "to_world": T.rotate([1, 0, 0], 90) @ T.scale(2)}
    light, once = narrow_beam(0.3), tr.ParticleTracer(max_depth=3)
    scene = {"type": "scene", "light": light, "floor": receiver(2, 8)}
    front, below = (
        tr.render(
            tr.load_dict({**scene, "upper": upper}, dtype=torch.float64), integrator=once, spp=4, seed=1, sensor=i
        )
        for i in (0, 1)
    )
    for image in (front, below):
        torch.testing.assert_close(power(image, 2.0), 0.36 * COLOUR, rtol=1e-9, atol=0)
    loaded = tr.load_dict({**scene, "upper": back}, dtype=torch.float64)
    found = {loaded.sensors[i].shape: tr.render(loaded, integrator=once, spp=4, seed=1, sensor=i) for i in (0, 1)}
    assert float(found[loaded.upper].abs().max()) == 0
    torch.testing.assert_close(found[loaded.floor], front)  # of the same random numbers


def test_a_mesh_measures_as_a_rectangle_does():
    corners = torch.tensor([[-2.0, -1, 2], [2, -1, 2], [2, -1, -2], [-2, -1, -2]])
    uv = torch.tensor([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    mesh = tr.Mesh(corners, torch.tensor([[0, 1, 2], [0, 2, 3]]), vertex_texcoords=uv)
    meter = {"type": "irradiancemeter", "film": film(9), "shape": {"type": "ref", "id": "sheet"}}
    light = narrow_beam(0.3, 0.5, 0.7, ls.texels(3, 3))
    other = measure(4, light=light, sheet=mesh, meter=meter)
    rectangle = measure(4, light=light, floor=receiver(2, 9))
    assert float(rectangle.sum()) > 0
    torch.testing.assert_close(other, rectangle, rtol=1e-6, atol=1e-9)


def test_lights_of_depth_one_are_not_measured():
    """A path of one segment ends on the light itself; a meter needs the one that arrives, and one to be read."""
    assert float(measure(4, 1, floor=receiver(3, 8), light=narrow_beam(0.5)).sum()) == 0
    assert float(measure(4, 2, floor=receiver(3, 8), light=narrow_beam(0.5)).sum()) > 0
