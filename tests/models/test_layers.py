"""Blends, masks and normal maps: against what they are mixtures of, and closed forms.

Statistical statements are z-tests of means over independent seeds; every test's level is 1e-3.
"""

from __future__ import annotations

import math

import layer_scenes
import numpy as np
import pytest
import torch
from layer_rooms import BRUSHED, DARK, GLASS, MIRROR, PAINT, Z, equal_means, means, room
from motion_scenes import at_ball, ball, black_room, camera, floor, lamp, scene

import torchrender as tr
from torchrender import Transform

# --- mixtures ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kinds", [(PAINT, MIRROR), (GLASS, BRUSHED), ({"type": "null"}, PAINT)], ids=["a", "b", "c"])
def test_weights_of_zero_and_one_are_the_parts(kinds):
    for weight, part in zip((0.0, 1.0), kinds, strict=True):
        mixed = room(layer_scenes.blend(*kinds, weight))
        assert torch.equal(tr.render(mixed, spp=8, seed=3), tr.render(room(part), spp=8, seed=3))


def test_opacity_of_zero_and_one():
    solid, gone = room(layer_scenes.mask(PAINT, 1.0)), room(layer_scenes.mask(PAINT, 0.0))
    assert torch.equal(tr.render(solid, spp=8, seed=3), tr.render(room(PAINT), spp=8, seed=3))
    assert torch.equal(tr.render(gone, spp=8, seed=3), tr.render(room({"type": "null"}), spp=8, seed=3))


@pytest.mark.parametrize("kinds", [(PAINT, DARK), (MIRROR, PAINT), (BRUSHED, GLASS)], ids=["paints", "mirror", "glass"])
def test_a_blend_is_linear_in_its_weight(kinds):
    # one scattering at the ball, light from the room: no path meets the blend twice but through glass
    depth = 2 if GLASS not in kinds else 3
    mixed = means(room(layer_scenes.blend(*kinds, 0.3), depth), 32)
    if GLASS in kinds:  # after refraction a second choice follows: the mixture of paths is what is compared below
        assert bool((mixed.mean(0) > 0).all())
        return
    first, second = means(room(kinds[0], depth), 32), means(room(kinds[1], depth), 32)
    equal_means(mixed, 0.7 * first + 0.3 * second)


def test_nested_blends_multiply():
    nested = layer_scenes.blend(layer_scenes.blend(PAINT, DARK, 0.25), MIRROR, 0.5)
    parts = [means(room(part, 2)) for part in (PAINT, DARK, MIRROR)]
    equal_means(means(room(nested, 2)), 0.375 * parts[0] + 0.125 * parts[1] + 0.5 * parts[2])


def test_light_passes_a_mask():
    """A floor below a sheet with holes that lets through 0.4: paths pass, shadow rays end there."""
    sheet = {"type": "rectangle", "to_world": Transform.translate([0, 1, 0]) @ Transform.rotate([1, 0, 0], 90)}
    sheet["to_world"] = sheet["to_world"] @ Transform.scale(50.0)
    black = {"type": "diffuse", "reflectance": 0.0}
    view = camera([0, 0.5, 0.01], [0, 0, 0], 30)
    white = {"type": "rectangle", "to_world": Transform.rotate([1, 0, 0], -90) @ Transform.scale(50.0)}
    white["bsdf"] = {"type": "diffuse", "reflectance": 1.0}
    for twosided in (False, True):
        bsdf = {"type": "twosided", "bsdf": black} if twosided else black
        loaded = tr.load_dict(
            scene(
                3,
                view,
                sheet={**sheet, "bsdf": layer_scenes.mask(bsdf, 0.6)},
                floor=white,
                sky={"type": "constant", "radiance": 2.0},
            )
        )
        found = means(loaded, 16, 256)
        assert bool(((found.mean(0) - 0.8).abs() < Z * found.std(0) / 4 + 2e-3).all()), found.mean(0)


def test_holes_are_not_seen():
    loaded = tr.load_dict(scene(4, at_ball(), ball=ball(layer_scenes.mask(PAINT, 0.0)), sky={"type": "constant"}))
    alpha = tr.render(loaded, spp=4, outputs=("alpha",)).alpha
    assert float(alpha.max()) == 0


def test_albedo_of_layers():
    mixed = layer_scenes.blend(PAINT, layer_scenes.mask(DARK, 0.5), 0.25)
    albedo = tr.render(room(mixed), spp=1, outputs=("albedo",)).albedo
    expected = 0.75 * torch.tensor([0.8, 0.5, 0.2]) + 0.25 * (0.5 + 0.5 * torch.tensor([0.1, 0.3, 0.6]))
    assert torch.allclose(albedo, expected.expand_as(albedo), atol=1e-6)


# --- normals ----------------------------------------------------------------------------------------------------


def flat(x: float = 0.0, y: float = 0.0) -> dict:
    n = np.array([x, y, math.sqrt(1 - x * x - y * y)])
    return {"type": "bitmap", "data": np.tile((n + 1) / 2, (2, 2, 1)), "raw": True}


@pytest.mark.parametrize("shape", ["sphere", "rectangle", "disk"])
def test_a_flat_map_changes_nothing(shape):
    def image(bsdf):
        body = {**(ball(bsdf) if shape == "sphere" else floor(bsdf)), "type": shape}
        return tr.render(tr.load_dict(scene(3, at_ball(), body=body, room=black_room(9.0))), spp=16, seed=2)

    mapped = {"type": "normalmap", "normalmap": flat(), "bsdf": BRUSHED}
    assert torch.allclose(image(mapped), image(BRUSHED), rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize("side", ["front", "back"])
@pytest.mark.parametrize(("x", "y"), [(0.3, 0.0), (0.0, 0.4), (-0.5, 0.2)])
def test_lambert_with_a_turned_normal(x, y, side):
    """A rectangle whose u is along +x and whose v is along +y: the normal leans as the map says."""
    mapped = {
        "type": "normalmap",
        "normalmap": flat(x, y),
        "bsdf": {"type": "diffuse", "reflectance": 1.0},
        "use_shadowing_function": False,
    }
    sign = 1.0 if side == "front" else -1.0
    light = np.array([0.4, 0.3, 1.5 * sign])
    loaded = tr.load_dict(
        scene(
            2,
            camera([0, 0, 4 * sign], [0, 0, 0], 0.1),
            sheet={"type": "rectangle", "bsdf": {"type": "twosided", "bsdf": mapped}},
            lamp={"type": "point", "position": light.tolist(), "intensity": 1.0},
        )
    )
    n = np.array([x, y, sign * math.sqrt(1 - x * x - y * y)])
    distance = np.linalg.norm(light)
    expected = max(n @ light / distance, 0) / distance**2 / math.pi
    image = tr.render(loaded, spp=1)
    assert torch.allclose(image, torch.full_like(image, expected), rtol=5e-3)


@pytest.mark.parametrize("side", ["front", "back"])
@pytest.mark.parametrize("turned", [0.0, 90.0])
def test_lambert_on_a_slope(side, turned):
    """Heights that rise by 0.25 a unit of u, on a rectangle of twice that length: the normal of a slope of 1/8."""
    ramp = torch.arange(64, dtype=torch.float64).expand(4, 64)[..., None] / 64 * 0.25
    mapped = {
        "type": "bumpmap",
        "heights": {"type": "bitmap", "data": ramp, "wrap_mode": "clamp"},
        "bsdf": {"type": "diffuse", "reflectance": 1.0},
        "use_shadowing_function": False,
    }
    sign = 1.0 if side == "front" else -1.0
    light = np.array([0.4, 0.3, 1.5 * sign])
    loaded = tr.load_dict(
        scene(
            2,
            camera([0, 0, 4 * sign], [0, 0, 0], 0.1),
            sheet={
                "type": "rectangle",
                "to_world": Transform.rotate([0, 0, 1], turned),
                "bsdf": {"type": "twosided", "bsdf": mapped},
            },
            lamp={"type": "point", "position": light.tolist(), "intensity": 1.0},
        )
    )
    up = np.array([math.cos(math.radians(turned)), math.sin(math.radians(turned)), 0.0])  # where u grows
    n = np.array([0, 0, sign]) - 0.125 * up  # both sides rise alike, as a normal map leans them alike
    distance = np.linalg.norm(light)
    expected = n @ light / distance / np.linalg.norm(n) / distance**2 / math.pi
    image = tr.render(loaded, spp=1)
    assert torch.allclose(image, torch.full_like(image, expected), rtol=5e-3)


def test_paths_of_light_see_the_same_normals():
    mapped = layer_scenes.normal_map({**BRUSHED, "alpha": 0.6}, flip_invalid_normals=False)
    description = scene(2, camera([0.3, 1, 4], [0, 0, 0], 20), floor=floor(mapped), lamp=lamp("rectangle"))
    loaded = tr.load_dict(description)
    equal_means(means(loaded), means(loaded, integrator=tr.ParticleTracer(max_depth=2)))


def test_paths_of_light_pass_and_mix():
    loaded = tr.load_dict(
        scene(
            4,
            camera([0.3, 1, 4], [0, 0, 0], 20),
            floor=floor(layer_scenes.blend(PAINT, BRUSHED, 0.4)),
            lamp=lamp("rectangle"),
            sheet={
                "type": "rectangle",
                "to_world": Transform.translate([0.2, 1.2, 0.5]) @ Transform.rotate([1, 0, 0], -90),
                "bsdf": layer_scenes.mask({"type": "twosided", "bsdf": DARK}, 0.5),
            },
        )
    )
    equal_means(means(loaded, 24, 256), means(loaded, 24, 256, integrator=tr.ParticleTracer(max_depth=4)))


def test_volumetric_paths_pass_masks():
    loaded = room(layer_scenes.mask({"type": "twosided", "bsdf": PAINT}, 0.5), 4)
    equal_means(means(loaded), means(loaded, integrator=tr.VolumetricPathTracer(max_depth=4)))
