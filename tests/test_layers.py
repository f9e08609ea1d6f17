"""Blends, masks and normal maps: against what they are mixtures of, closed forms, and finite differences.

Statistical statements are z-tests of means over independent seeds; every test's level is 1e-3.
"""

from __future__ import annotations

import math

import layer_scenes
import numpy as np
import pytest
import torch
from motion_scenes import at_ball, ball, black_room, camera, floor, lamp, scene, smooth_texture

import torchrender as tr
from torchrender import Transform

PAINT = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.2]}}
DARK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.3, 0.6]}}
MIRROR = {"type": "conductor"}
GLASS = {"type": "dielectric", "int_ior": 1.3, "ext_ior": 1.0}
BRUSHED = {"type": "roughconductor", "alpha": 0.4, "distribution": "ggx"}
Z = 3.29  # two-sided, 1e-3


def room(bsdf: dict, depth: int = 3, **more) -> tr.Scene:
    return tr.load_dict(scene(depth, at_ball(), ball=ball(bsdf), room=black_room(), **more))


def means(loaded: tr.Scene, runs: int = 16, spp: int = 64, **more) -> torch.Tensor:
    """Mean radiance of each run (runs, C)."""
    return torch.stack([tr.render(loaded, spp=spp, seed=100 + k, **more).double().mean((0, 1)) for k in range(runs)])


def equal_means(a: torch.Tensor, b: torch.Tensor) -> None:
    gap = (a.mean(0) - b.mean(0)).abs()
    error = (a.var(0) / len(a) + b.var(0) / len(b)).sqrt()
    # several channels, and few runs: a wider limit than that of one normal number
    assert bool((gap <= 4.5 * error + 1e-6).all()), f"{a.mean(0)} and {b.mean(0)}, error {error}"


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


# --- derivatives ----------------------------------------------------------------------------------------------------


def derivative(loaded: tr.Scene, name: str, direction: torch.Tensor, seed: int, spp: int, **more) -> float:
    x = loaded.get_parameter(name).detach().clone().requires_grad_()
    image = tr.render(loaded, spp=spp, seed=seed, seed_grad=seed + 1000, params={name: x}, **more)
    (gradient,) = torch.autograd.grad(image.mean(), x)
    return float((gradient * direction).sum())


def difference(loaded: tr.Scene, name: str, direction: torch.Tensor, step: float, seed: int, spp: int, **more) -> float:
    x = loaded.get_parameter(name).detach()
    with torch.no_grad():
        a, b = (
            tr.render(loaded, spp=spp, seed=seed, params={name: x + s * direction}, **more).double().mean()
            for s in (step, -step)
        )
    return float(a - b) / (2 * step)


def soft(description: dict) -> dict:
    """The scene with a filter that light paths can be differentiated through."""
    return {**description, "camera": {**description["camera"], "film": {"type": "hdrfilm", "width": 6, "height": 6}}}


def agree(loaded: tr.Scene, name: str, direction: torch.Tensor, step: float, spp: int = 256, runs: int = 12, **more):
    ours = torch.tensor([derivative(loaded, name, direction, 7 * k, spp, **more) for k in range(runs)])
    theirs = torch.tensor([difference(loaded, name, direction, step, 7 * k, spp, **more) for k in range(runs)])
    error = float((ours.var() / runs + theirs.var() / runs).sqrt())
    gap = abs(float(ours.mean() - theirs.mean()))
    assert gap < 4.4 * error + 3e-3 * abs(float(theirs.mean())), f"{name}: {ours.mean()}, {theirs.mean()} +- {error}"
    assert abs(float(theirs.mean())) > 3 * error, f"{name}: nothing is measured, {theirs.mean()} +- {error}"


@pytest.mark.parametrize("weight", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("kinds", [(PAINT, DARK), (MIRROR, PAINT), (PAINT, BRUSHED)], ids=["paints", "mirror", "metal"])
def test_derivative_by_the_weight(kinds, weight):
    """The image is linear in the weight: the difference of the parts' images is the derivative, at 0 and 1, too."""
    loaded = tr.load_dict(
        scene(2, at_ball(), ball=ball(layer_scenes.blend(*kinds, weight)), room=black_room()), dtype=torch.float64
    )
    name = "ball.bsdf.weight.value"
    ours = torch.tensor([derivative(loaded, name, torch.ones(()), 3 * k, 64) for k in range(16)])
    ends = [
        torch.tensor([float(tr.render(room(kind, 2), spp=64, seed=k).double().mean()) for k in range(16)])
        for kind in kinds
    ]
    expected = ends[1] - ends[0]
    error = float((ours.var() / 16 + expected.var() / 16).sqrt())
    assert abs(float(ours.mean() - expected.mean())) < 4.4 * error


def test_derivative_by_the_opacity():
    loaded = room(layer_scenes.mask({"type": "twosided", "bsdf": PAINT}, 0.6), 4)
    agree(loaded, "ball.bsdf.opacity.value", torch.ones(()), 0.1)


@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize("opacity", [0.0, 0.9, 1.0])
def test_holes_before_a_lamp(opacity, correlated):
    """The image is 1 - opacity, though no path of an image of opacity 1 meets the lamp."""
    loaded = tr.load_dict(
        scene(
            2,
            camera([0, 0, 5], [0, 0, 0], 30),
            sheet={"type": "rectangle", "to_world": Transform.scale(3.0), "bsdf": layer_scenes.mask(PAINT, opacity)},
            lamp={
                "type": "rectangle",
                "to_world": Transform.translate([0, 0, -1]) @ Transform.scale(9.0),
                "emitter": {"type": "area", "radiance": 1.0},
            },
        )
    )
    found = []
    for seed in range(16):
        x = torch.tensor(opacity, requires_grad=True)
        params = {"sheet.bsdf.opacity.value": x}
        tr.render(loaded, spp=64, seed=seed, correlated=correlated, params=params).mean().backward()
        found.append(float(x.grad))
    mean, error = np.mean(found), np.std(found, ddof=1) / 4
    assert abs(mean + 1) < 4.1 * error + 1e-5, f"{mean} +- {error}"  # Student's t of 15 degrees of freedom


@pytest.mark.parametrize(
    "name", ["ball.bsdf.weight.data", "ball.bsdf.bsdf_0.reflectance.value", "ball.bsdf.bsdf_1.alpha.value"]
)
def test_derivatives_inside_of_a_textured_blend(name):
    loaded = room(layer_scenes.blend(PAINT, BRUSHED))
    agree(loaded, name, torch.ones_like(loaded.get_parameter(name)), 0.03)


@pytest.mark.parametrize("integrator", [None, tr.ParticleTracer(max_depth=3)], ids=["path", "particles"])
@pytest.mark.parametrize("kind", ["diffuse", "rough"])
def test_derivative_by_a_normal_map(kind, integrator):
    bsdf = PAINT if kind == "diffuse" else {**BRUSHED, "alpha": 0.6}
    lights = {"lamp": lamp("rectangle")}
    mapped = layer_scenes.normal_map(bsdf, flip_invalid_normals=False)
    loaded = tr.load_dict(soft(scene(2, camera([0.3, 1, 4], [0, 0, 0], 20), floor=floor(mapped), **lights)))
    name = "floor.bsdf.normalmap.data"
    generator = torch.Generator().manual_seed(4)
    direction = torch.randn(loaded.get_parameter(name).shape, generator=generator)
    direction[..., 0] += 1.0
    more = {} if integrator is None else {"integrator": integrator}
    agree(loaded, name, direction, 0.01, 256, **more)


@pytest.mark.parametrize("integrator", [None, tr.ParticleTracer(max_depth=2)], ids=["path", "particles"])
@pytest.mark.parametrize("name", ["nested_texture.data", "scale"])
def test_derivative_by_heights(name, integrator):
    mapped = layer_scenes.bump_map(PAINT, 0.2, flip_invalid_normals=False)
    mapped["heights"]["data"] = mapped["heights"]["data"][::6, ::8].copy()
    view = camera([0.3, 1, 4], [0, 0, 0], 20)
    loaded = tr.load_dict(soft(scene(2, view, floor=floor(mapped), lamp=lamp("rectangle"))))
    name = f"floor.bsdf.{name}"
    value = loaded.get_parameter(name)
    direction = torch.randn(value.shape, generator=torch.Generator().manual_seed(4)) if value.ndim else torch.ones(())
    more = {} if integrator is None else {"integrator": integrator}
    agree(loaded, name, direction, 0.02, 256, **more)


@pytest.mark.parametrize("outputs", [None, ("albedo",)], ids=["image", "albedo"])
def test_clamped_weights_have_no_derivative(outputs):
    texels = torch.tensor([[1.5, 1.5], [-0.5, -0.5]])[..., None]  # a row above 1, a row below 0
    weight = {"type": "bitmap", "data": texels, "raw": True, "filter_type": "nearest"}
    loaded = room(layer_scenes.blend(PAINT, DARK, weight), 2)
    loaded.train_only("ball.bsdf.weight.data")
    found = tr.render(loaded, spp=16, seed=1, outputs=outputs)
    (found if outputs is None else found.albedo).sum().backward()
    assert float(loaded.get_parameter("ball.bsdf.weight.data").grad.abs().max()) == 0


@pytest.mark.parametrize("kind", ["blend", "mask", "normalmap", "bumpmap"])
def test_forward_and_reverse_mode_agree(kind):
    both = {"type": "twosided", "bsdf": PAINT}
    bsdf = {
        "blend": layer_scenes.blend(PAINT, BRUSHED),
        "mask": layer_scenes.mask(both),
        "normalmap": layer_scenes.normal_map({**BRUSHED, "alpha": 0.6}),
        "bumpmap": layer_scenes.bump_map({**BRUSHED, "alpha": 0.6}),
    }[kind]
    loaded = tr.load_dict(scene(4, at_ball(), ball=ball(bsdf), room=black_room()), dtype=torch.float64)
    name = {
        "blend": "weight.data",
        "mask": "opacity.data",
        "normalmap": "normalmap.data",
        "bumpmap": "nested_texture.data",
    }[kind]
    name = f"ball.bsdf.{name}"
    value = loaded.get_parameter(name).detach()
    direction = torch.randn(value.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)

    def image(x):
        return tr.render(loaded, spp=8, seed=1, params={name: x})

    _, tangent = torch.func.jvp(image, (value,), (direction,))
    x = value.clone().requires_grad_()
    weight = torch.rand(tangent.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    (gradient,) = torch.autograd.grad((image(x) * weight).sum(), x)
    assert math.isclose(float((gradient * direction).sum()), float((tangent * weight).sum()), rel_tol=1e-8)


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


def test_derivatives_of_light_paths_through_layers():
    loaded = tr.load_dict(
        scene(
            2,
            camera([0.3, 1, 4], [0, 0, 0], 20),
            floor=floor(layer_scenes.blend(PAINT, BRUSHED, 0.4)),
            lamp=lamp("rectangle"),
        )
    )
    agree(loaded, "floor.bsdf.weight.value", torch.ones(()), 0.1, integrator=tr.ParticleTracer(max_depth=2))


def test_volumetric_paths_pass_masks():
    loaded = room(layer_scenes.mask({"type": "twosided", "bsdf": PAINT}, 0.5), 4)
    equal_means(means(loaded), means(loaded, integrator=tr.VolumetricPathTracer(max_depth=4)))


# --- descriptions ----------------------------------------------------------------------------------------------------


def test_errors_name_the_place():
    both = {"type": "twosided", "bsdf": PAINT}
    for bsdf, message in [
        ({"type": "blendbsdf", "a": PAINT}, "nested BSDF is missing"),
        ({"type": "mask", "opacity": 0.5}, "nested BSDF is missing"),
        ({"type": "normalmap", "bsdf": PAINT}, "'normalmap' is missing"),
        ({"type": "bumpmap", "bsdf": PAINT}, "'nested_texture' is missing"),
        (layer_scenes.normal_map(both), "stands around"),
        (layer_scenes.normal_map(layer_scenes.normal_map(PAINT)), "stands around"),
        ({"type": "twosided", "bsdf": layer_scenes.mask(PAINT)}, "two-sided"),
        ({"type": "twosided", "bsdf": layer_scenes.blend(PAINT, GLASS)}, "two-sided"),
        ({"type": "blendbsdf", "a": PAINT, "b": PAINT, "c": PAINT}, "more than 2"),
    ]:
        with pytest.raises(ValueError, match=message):
            room(bsdf)
    deep = PAINT
    for _ in range(9):
        deep = layer_scenes.blend(deep, DARK, 0.5)
    with pytest.raises(ValueError, match="nested at most 8 deep"):
        tr.render(room(deep), spp=1)
    constant = {"type": "normalmap", "normalmap": 0.5, "bsdf": PAINT}
    plain = {"type": "normalmap", "normalmap": {"type": "bitmap", "data": np.zeros((2, 2, 1))}, "bsdf": PAINT}
    for bsdf, message in [(constant, "a bitmap, in a scene without"), (plain, r"a bitmap of shape \(rows,")]:
        with pytest.raises(ValueError, match=f"ball.bsdf: field 'normalmap': expected {message}"):
            tr.render(grey_room(bsdf, "mono"), spp=1)
    with pytest.raises(ValueError, match="needs"):
        room(layer_scenes.mask(PAINT)).get_submodule("ball.bsdf").nested_bsdf = None


def test_media_have_no_derivative_of_normals():
    loaded = room(layer_scenes.normal_map(PAINT))
    parameter = loaded.train_only("ball.bsdf.normalmap.data")
    with pytest.raises(tr.NotDifferentiableError, match="VolumetricPathTracer"):
        tr.render(loaded, spp=1, integrator=tr.VolumetricPathTracer(max_depth=3))
    with pytest.raises(tr.NotDifferentiableError, match="box filter"):
        tr.render(loaded, spp=1, integrator=tr.ParticleTracer(max_depth=3))
    assert len(parameter) == 1


def grey_room(bsdf: dict, variant: str) -> tr.Scene:
    light = {"type": "area", "radiance": {"type": "bitmap", "data": smooth_texture(32, 64)[..., :1], "raw": True}}
    walls = {**black_room(), "emitter": light}
    return tr.load_dict(soft(scene(3, at_ball(), ball=ball(bsdf), room=walls)), variant=variant, dtype=torch.float64)


@pytest.mark.core
@pytest.mark.parametrize("integrator", [None, tr.ParticleTracer(max_depth=3)], ids=["path", "particles"])
@pytest.mark.parametrize("kind", ["normalmap", "bumpmap"])
def test_without_colours_normals_turn_alike(kind, integrator):
    """A grey scene is the same in one channel and in three, image and gradients of all maps; so are nested normals."""
    metal = {"type": "roughconductor", "alpha": 0.6, "distribution": "ggx", "eta": 1.5, "k": 2.0}
    bsdf = {"normalmap": layer_scenes.normal_map(metal), "bumpmap": layer_scenes.bump_map(metal, 0.1)}[kind]
    name = "ball.bsdf." + {"normalmap": "normalmap.data", "bumpmap": "nested_texture.data"}[kind]
    alpha = "ball.bsdf.nested_bsdf.alpha.value"
    found = []
    for variant in ("mono", "rgb"):
        loaded = grey_room(bsdf, variant)
        values = [loaded.get_parameter(n).detach().clone().requires_grad_() for n in (name, alpha)]
        params = dict(zip((name, alpha), values, strict=True))
        image = tr.render(loaded, spp=8 if integrator is None else 512, seed=3, params=params, integrator=integrator)
        found.append([image[..., :1], *torch.autograd.grad((image.mean(-1) ** 2).sum(), values)])

        def f(*tensors, loaded=loaded):
            given = dict(zip((name, alpha), tensors, strict=True))
            return tr.render(loaded, spp=64, seed=5, params=given, integrator=integrator)

        result = tr.testing.dot_product_test(f, [v.detach() for v in values], rtol=1e-9)
        assert result and result.forward != 0, result.message
    for one, three in zip(*found, strict=True):
        torch.testing.assert_close(one, three, rtol=1e-9, atol=1e-12)
        assert float(one.detach().abs().max()) > 1e-3
    assert found[0][1].shape == (12, 16, 3) if kind == "normalmap" else (48, 64, 1)


def test_normals_keep_three_channels_when_colours_go(tmp_path):
    """Assigned maps, those of objects from another scene and saved scenes; colours of the same file turn grey."""
    image = torch.rand(4, 4, 3, generator=torch.Generator().manual_seed(1))
    bsdf = tr.NormalMap(normalmap={"type": "bitmap", "data": image, "raw": True}, bsdf=PAINT)
    made = tr.load_dict(
        {"type": "scene", "camera": {"type": "perspective"}, "ball": {"type": "sphere", "bsdf": bsdf}}, variant="mono"
    )
    assert (
        torch.equal(made.ball.bsdf.normalmap.data, image) and made.ball.bsdf.nested_bsdf.reflectance.value.numel() == 1
    )
    made.ball.bsdf.normalmap = {"type": "bitmap", "data": image.flip(0), "raw": True}
    assert torch.equal(made.ball.bsdf.normalmap.data, image.flip(0))
    made.save(tmp_path / "scene.xml")
    again = tr.load_file(tmp_path / "scene.xml", variant="mono")
    assert torch.equal(again.ball.bsdf.normalmap.data, image.flip(0))


def test_one_image_is_not_both_normals_and_colours_without_colours():
    ref = {"type": "ref", "id": "map"}
    turned = {"type": "normalmap", "normalmap": ref, "bsdf": {"type": "diffuse", "reflectance": ref}}
    image = {"type": "bitmap", "data": layer_scenes.normals(), "raw": True}
    description = scene(2, at_ball(), map=image, ball=ball(turned), room=black_room())
    assert tr.render(tr.load_dict(description), spp=1).isfinite().all()
    with pytest.raises(ValueError, match=r"ball\.bsdf"):
        tr.render(tr.load_dict(description, variant="mono"), spp=1)


def test_texels_are_read_raw():
    texels = smooth_texture(4, 4).float()
    loaded = room({"type": "normalmap", "normalmap": {"type": "bitmap", "data": texels}, "bsdf": PAINT})
    assert torch.equal(loaded.get_parameter("ball.bsdf.normalmap.data"), texels)


def test_saved_and_loaded_again(tmp_path):
    both = {"type": "twosided", "bsdf": layer_scenes.blend(PAINT, layer_scenes.bump_map(BRUSHED, 0.1, scale=0.7))}
    loaded = room(
        layer_scenes.mask(both, 0.8),
        lamp={
            "type": "sphere",
            "center": [0, 3, 0],
            "radius": 0.2,
            "bsdf": layer_scenes.normal_map(DARK, flip_invalid_normals=False),
        },
    )
    loaded.save(tmp_path / "scene.xml")
    again = tr.load_file(tmp_path / "scene.xml")
    assert {n: tuple(p.shape) for n, p in again.named_parameters()} == {
        n: tuple(p.shape) for n, p in loaded.named_parameters()
    }
    assert torch.equal(tr.render(again, spp=4, seed=1), tr.render(loaded, spp=4, seed=1))
