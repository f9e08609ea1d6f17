"""Materials and lights at the ends of their ranges: images and gradients stay finite, without a sample dropped."""

from __future__ import annotations

import pytest
import torch
from degenerate_scenes import FLOOR, LAMP, SKY, camera, check, differentiable, load, variants

import torchrender as tr


# ------------------------------------------------------------------------------------------- materials and lights
@variants
@pytest.mark.parametrize("albedo", [0.0, 1.0])
@pytest.mark.parametrize("kind", ["constant", "bitmap"])
def test_albedo_zero_and_one_in_a_closed_room(kind, albedo, variant, dtype):
    texture = {"type": "bitmap", "data": torch.full((2, 2, 3), albedo), "raw": True}
    reflectance = albedo if kind == "constant" else texture
    room = {"type": "cube", "to_world": tr.Transform.scale(2), "flip_normals": True}
    room["bsdf"] = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
    objects = {
        "camera": camera(origin=(0, 0, 1.5)),
        "room": room,
        "lamp": {**LAMP, "to_world": tr.Transform.scale(0.3)},
    }
    scene = tr.load_dict({"type": "scene", **objects}, variant=variant, dtype=dtype)
    for integrator in (tr.PathTracer(max_depth=20, rr_depth=100), tr.PathTracer(max_depth=-1, rr_depth=2)):
        image = check(scene, spp=4, integrator=integrator)
        assert image.max() > 0


@variants
def test_furnace_at_albedo_one(variant, dtype):
    """A white ball in a white sky is as bright as the sky, to what is lost beyond the longest path."""
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": 1.0}}
    settings = {"spp": 64, "integrator": tr.PathTracer(max_depth=-1), "sampler": "independent"}
    image = check(load({"sky": SKY, "ball": ball}, variant, dtype), **settings)
    seen = image[..., 0][(image[..., 0] - 1).abs() > 1e-5]  # the rest is sky
    assert len(seen) > 60
    # independent pixels; beyond 4.9 standard errors with probability 1e-6
    assert abs(seen.mean() - 1) < 4.9 * seen.std() / len(seen) ** 0.5


@variants
@pytest.mark.parametrize(
    ("inside", "outside"), [(1.0, 1.0), (1.5, 1.5), (1.0, 1.5), (1.0 + 1e-7, 1.0), (1e-3, 1.0), (50.0, 1.0)]
)
def test_indices_of_refraction(inside, outside, variant, dtype):
    ball = {"type": "sphere", "bsdf": {"type": "dielectric", "int_ior": inside, "ext_ior": outside}}
    floor = {**FLOOR, "to_world": tr.Transform.translate([0, 0, -2]).scale(4)}
    image = check(load({"sky": SKY, "ball": ball, "floor": floor}, variant, dtype))
    if inside == outside:  # the ball is not there, except that it blocks the floor's own shadow rays
        assert image.min() > 0.1
        assert image.max() <= 1.0001


@variants
@pytest.mark.parametrize(("eta", "k"), [(1.0, 0.0), (0.0, 0.0), (0.0, 1.0), (1e-6, 1e-6), (100.0, 100.0)])
def test_conductors(eta, k, variant, dtype):
    ball = {"type": "sphere", "bsdf": {"type": "conductor", "eta": eta, "k": k}}
    image = check(load({"sky": SKY, "ball": ball}, variant, dtype))
    assert image.max() <= 1.0001
    if (eta, k) == (1.0, 0.0):  # no boundary: nothing is reflected
        assert image.min().abs() < 1e-7


FROM_ABOVE = tr.Transform.look_at([0, 0, 2], [0, 0, 0], [0, 1, 0])


def lights_of(radiance: float) -> dict[str, dict]:
    return {
        "area": {"lamp": {**LAMP, "emitter": {"type": "area", "radiance": radiance}}},
        "ball": {
            "lamp": {
                "type": "sphere",
                "center": [0, 0, 2],
                "radius": 0.2,
                "emitter": {"type": "area", "radiance": radiance},
            }
        },
        "constant": {"sky": {"type": "constant", "radiance": radiance}},
        "envmap": {"sky": {"type": "envmap", "data": torch.full((4, 8, 3), radiance)}},
        "point": {"bulb": {"type": "point", "position": [0, 0, 2], "intensity": radiance}},
        "directional": {"sun": {"type": "directional", "direction": [0, 0, -1], "irradiance": radiance}},
        "spot": {"lamp": {"type": "spot", "to_world": FROM_ABOVE, "intensity": radiance}},
        "projector": {"beamer": {"type": "projector", "to_world": FROM_ABOVE, "irradiance": radiance, "fov": 40}},
        "textured": {
            "lamp": {
                **LAMP,
                "emitter": {
                    "type": "area",
                    "radiance": {"type": "bitmap", "data": torch.full((2, 2, 3), radiance), "raw": True},
                },
            }
        },
    }


@variants
@pytest.mark.parametrize("light", lights_of(0.0))
def test_lights_that_are_off(light, variant, dtype):
    scene = load({"floor": FLOOR, **lights_of(0.0)[light]}, variant, dtype)
    assert check(scene).max() == 0
    name = next(
        n
        for n in differentiable(scene)
        if n.endswith(("radiance.value", "irradiance.value", "intensity.value", "radiance.data", "sky.data"))
    )
    # switched off, but it would be seen: the derivative by its radiance is that of a light that is on
    image = tr.render(scene, spp=16, seed=1)
    (gradient,) = torch.autograd.grad(image.sum(), scene.get_parameter(name))
    assert gradient.sum() > 0


@variants
def test_a_scene_without_light_and_one_without_shapes(variant, dtype):
    assert check(load({"floor": FLOOR}, variant, dtype)).max() == 0
    assert check(load({}, variant, dtype)).max() == 0
    assert (check(load({"sky": SKY}, variant, dtype)) == 1).all()


@variants
def test_an_emitting_mesh_may_shrink_to_nothing(variant, dtype):
    """It contributes nothing then, whether there are other lights or not; a grown one shines again."""

    def mesh(size: float) -> tr.Mesh:
        corners = [[-size, -size, 2], [-size, size, 2], [size, size, 2]]
        return tr.Mesh(corners, [[0, 1, 2]], emitter={"type": "area", "radiance": 3.0})

    for others in ({}, {"sky": SKY}):
        scene = load({"floor": FLOOR, "lamp": mesh(0.5), **others}, variant, dtype)
        bright = check(scene)
        positions = scene.get_parameter("lamp.vertex_positions")
        with torch.no_grad():
            kept = positions.clone()
            positions[:, :2] = 0
        dark = check(scene)
        without = check(load({"floor": FLOOR, **others}, variant, dtype))
        torch.testing.assert_close(dark.mean(), without.mean(), rtol=0.02, atol=0)
        with torch.no_grad():
            positions.copy_(kept)
        assert torch.equal(check(scene), bright)
        assert torch.equal(check(load({"floor": FLOOR, "lamp": mesh(0.0), **others}, variant, dtype)), dark)


@pytest.mark.parametrize(
    ("light", "message"),
    [
        ({"type": "sphere", "radius": 0.0}, "radius"),
        ({"type": "rectangle", "to_world": tr.Transform.scale(0.0)}, "to_world"),
        ({"type": "disk", "to_world": tr.Transform.scale(0.0)}, "to_world"),
    ],
)
def test_a_light_of_size_zero_that_no_matrix_describes_is_refused_by_name(light, message):
    light = {**light, "emitter": {"type": "area", "radiance": 1.0}}
    with pytest.raises(ValueError, match=f"lamp.*{message}"):
        tr.render(load({"lamp": light}), spp=1)


@variants
@pytest.mark.parametrize("radius", [1e-3, 1e-6])
def test_tiny_lights(radius, variant, dtype):
    ball = {
        "type": "sphere",
        "center": [0, 0, 5],
        "radius": radius,
        "emitter": {"type": "area", "radiance": radius**-2},
    }
    image = check(load({"floor": FLOOR, "lamp": ball}, variant, dtype), spp=64)
    # far from it, it is a point light of intensity pi radius^2 radiance
    bulb = {"type": "point", "position": [0, 0, 5], "intensity": torch.pi}
    expected = check(load({"floor": FLOOR, "lamp": bulb}, variant, dtype), spp=64)
    torch.testing.assert_close(image, expected, rtol=0.05, atol=1e-3)


@variants
def test_a_point_light_in_a_surface_and_in_the_camera(variant, dtype):
    for position in ([0, 0, 0], [0, 0, 4], [0, 0, 1e-20]):
        bulb = {"type": "point", "position": position, "intensity": 1.0}
        check(
            load(
                {
                    "floor": FLOOR,
                    "bulb": bulb,
                    "glass": {"type": "sphere", "radius": 0.2, "bsdf": {"type": "dielectric"}},
                },
                variant,
                dtype,
            )
        )
