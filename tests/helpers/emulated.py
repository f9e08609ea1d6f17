"""What tests of the emulated device share."""

from __future__ import annotations

import math
from typing import Any

import bsdf_models
import light_scenes
import sdf_grids
import torch

import torchrender as tr

PATH = tr.PathTracer(max_depth=5)
CLOSE = {torch.float32: 2e-5, torch.float64: 1e-12}
"""Of the largest number of a gradient: both add the same numbers, in another order."""


def differentiable(scene: tr.Scene) -> dict[str, torch.nn.Parameter]:
    """All parameters that the image has a derivative by, which alone are trained afterwards."""
    scene.train_only()
    refused = {slot.name for slot in scene.layout().slots if slot.refusal}
    found = {name: parameter for name, parameter in scene.named_parameters() if name not in refused}
    for parameter in found.values():
        parameter.requires_grad_(True)
    return found


def check_close(found: dict[str, torch.Tensor], expected: dict[str, torch.Tensor]) -> None:
    """Numbers by name differ by `CLOSE` of the largest one at most, in their precision; some are not zero."""
    assert any(float(g.abs().max()) > 0 for g in expected.values())
    for name, g in expected.items():
        most = CLOSE[g.dtype] * float(g.abs().max())
        torch.testing.assert_close(found[name], g, rtol=0, atol=most, msg=lambda m, n=name: f"{n}: {m}")


def check_transposed(function, values: tuple[torch.Tensor, ...], tangents, tangent: torch.Tensor, generator) -> None:
    """<J t, w> = <t, J^T w>: `tangent`, that of `function` at `values` along `tangents`, and its reverse mode."""
    weights = torch.randn(tangent.shape, generator=generator, dtype=tangent.dtype)
    back = torch.func.vjp(function, *values)[1](weights)
    one = (tangent * weights).sum(dtype=torch.float64)
    other = sum((t * g).sum(dtype=torch.float64) for t, g in zip(tangents, back, strict=True))
    scale = (tangent * weights).abs().sum(dtype=torch.float64)
    assert abs(float(one - other)) < CLOSE[tangent.dtype] / 2 * float(scale)


RAYS = ("closest_rays", "shadow_rays")


def check_image(
    device, scene: tr.Scene, names: tuple[str, ...] = ("rgb", "alpha"), close: bool = False, **settings
) -> torch.Tensor:
    """What the device renders is what the CPU renders in one tree, bit for bit; returns the image.

    Args:
        close: but for the order of sums.
    """
    settings = {"integrator": PATH, "spp": 4, "seed": 3, **settings}
    device("tree")
    expected = tr.render(scene, outputs=names, **settings)
    rays = {name: scene.statistics["render"][name] for name in RAYS}
    device("emulated")
    found = tr.render(scene, outputs=names, **settings)
    if close:
        check_close(dict(zip(names, found, strict=True)), dict(zip(names, expected, strict=True)))
    for name, a, b in zip(names, found, expected, strict=True):
        told = f"{name}: {(a != b).double().mean():.3%} differ, by {(a - b).abs().max()} at most"
        assert close or torch.equal(a, b), told
    assert float(found[0].max()) > 0.01
    if not getattr(settings["integrator"], "hide_emitters", False):  # there the CPU traces all again for a few
        assert {name: scene.statistics["render"][name] for name in RAYS} == rays
    return found[0]


def gradients(scene: tr.Scene, parameters: dict[str, torch.nn.Parameter], **settings) -> dict[str, torch.Tensor]:
    """Of a weighted sum of the image's numbers."""
    image = tr.render(scene, **{"integrator": PATH, "spp": 2, "seed": 3, **settings})
    weights = torch.linspace(0.5, 1.5, image.numel(), dtype=image.dtype).reshape(image.shape)
    found = torch.autograd.grad((image * weights).sum(), list(parameters.values()))
    return dict(zip(parameters, found, strict=True))


def check_gradients(
    device, scene: tr.Scene, parameters: dict[str, torch.nn.Parameter] | None = None, **settings
) -> None:
    """Those of the device are the CPU's but for the order of sums: by everything, or by these parameters."""
    device("emulated")
    chosen = differentiable(scene) if parameters is None else parameters
    assert chosen
    device("tree")
    expected = gradients(scene, chosen, **settings)
    rays = {name: scene.statistics["vjp"][name] for name in RAYS}
    device("emulated")
    check_close(gradients(scene, chosen, **settings), expected)
    if not getattr(settings.get("integrator"), "hide_emitters", False):  # there the CPU traces all again for a few
        assert {name: scene.statistics["vjp"][name] for name in RAYS} == rays


def check_forward_mode(
    device,
    scene: tr.Scene,
    parameters: dict[str, torch.nn.Parameter] | None = None,
    close: bool = False,
    **settings,
) -> None:
    """Tangents of the image are the CPU's, and <J t, w> = <t, J^T w> with the same samples.

    Args:
        parameters: which are to have tangents; all that can unless given.
        close: the image itself is the CPU's but for the order of sums.
    """
    chosen = differentiable(scene) if parameters is None else parameters
    scene.train_only()
    generator = torch.Generator().manual_seed(1)
    values = tuple(p.detach() for p in chosen.values())
    tangents = tuple(torch.randn(v.shape, generator=generator, dtype=v.dtype) for v in values)
    settings = {"spp": 4, "seed": 3, "seed_grad": 5, **settings}

    def image(*given: torch.Tensor) -> torch.Tensor:
        return tr.render(scene, params=dict(zip(chosen, given, strict=True)), **settings)

    found, expected = {}, {}
    for name, to in (("tree", expected), ("emulated", found)):
        device(name)
        to["image"], to["tangent"] = torch.func.jvp(image, values, tangents)
    check_close({"image": found["image"]}, {"image": expected["image"]})
    assert close or torch.equal(found["image"], expected["image"])
    check_close({"tangent": found["tangent"]}, {"tangent": expected["tangent"]})
    check_transposed(image, values, tangents, found["tangent"], generator)


def materials() -> dict[str, dict[str, Any]]:
    """Every model of the registry, with what wraps them."""
    red, image = {"type": "rgb", "value": [0.7, 0.3, 0.2]}, light_scenes.texels(5, 4)
    found = {kind: {"type": kind} for kind in bsdf_models.DECLARED}
    diffuse, metal = {"type": "diffuse", "reflectance": red}, {"type": "roughconductor", "alpha": 0.2}
    return {
        **found,
        "blend": {"type": "blendbsdf", "weight": image, "first": diffuse, "second": metal},
        "mask": {"type": "mask", "opacity": image, "bsdf": {"type": "twosided", "bsdf": diffuse}},
        "normalmap": {"type": "normalmap", "normalmap": image, "bsdf": metal},
        "bumpmap": {"type": "bumpmap", "texture": image, "bsdf": metal},
    }


def scene_of_materials(
    bsdfs: dict[str, dict[str, Any]], size: int, rfilter: str = "box", dtype: torch.dtype = torch.float32
) -> tr.Scene:
    """A ball of each in rows, under a lamp and a sky."""
    columns = math.ceil(math.sqrt(len(bsdfs)))
    objects = {
        f"ball_{i}": {"type": "sphere", "center": [i % columns, i // columns, 0.0], "radius": 0.45, "bsdf": bsdf}
        for i, bsdf in enumerate(bsdfs.values())
    }
    middle = (columns - 1) / 2
    camera = {
        "type": "perspective",
        "fov": 45,
        "to_world": tr.Transform.look_at([middle, middle, 7.0], [middle, middle, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": rfilter}},
    }
    lamp = {"type": "point", "position": [middle, middle, 6.0], "intensity": 20.0}
    given = {"type": "scene", "camera": camera, **objects, "sky": light_scenes.envmap(), "lamp": lamp}
    return tr.load_dict(given, dtype=dtype)


def blobs(normals: str = "smooth", dtype: torch.dtype = torch.float32) -> tr.Scene:
    """Grids of distances: one of glass above a floor, with an uneven surface, and a turned one of metal."""
    film = {"type": "hdrfilm", "width": 20, "height": 15, "rfilter": {"type": "box"}}
    camera = {"type": "perspective", "fov": 45, "film": film}
    camera["to_world"] = tr.Transform.look_at([0.9, -2.2, 2.2], [0.5, 0.5, 0.4], [0, 0, 1])
    turned = tr.Transform.translate([-0.7, 0.3, 0.1]).rotate([1, 2, 0.5], 40).scale([0.8, 1.1, 0.9])
    floor = {"type": "rectangle", "to_world": tr.Transform.translate([0.5, 0.5, 0]) @ tr.Transform.scale(2)}
    return tr.load_dict(
        {
            "type": "scene",
            "camera": camera,
            "floor": {**floor, "bsdf": {"type": "diffuse", "reflectance": light_scenes.texels(5, 4)}},
            "glass": {
                **sdf_grids.shape(sdf_grids.dented((9, 12, 10), 0.01), normals=normals),
                "bsdf": {"type": "roughdielectric", "alpha": 0.1},
            },
            "metal": {
                **sdf_grids.shape(sdf_grids.dented((6, 5, 17), 0.02, seed=1), normals=normals, to_world=turned),
                "bsdf": {"type": "roughconductor", "alpha": 0.3},
            },
            "sky": light_scenes.envmap(),
            "lamp": {"type": "point", "position": [0.5, -0.5, 3.0], "intensity": 10.0},
        },
        dtype=dtype,
    )


def hills(interpolation: str, dtype: torch.dtype = torch.float32) -> tr.Scene:
    """A field of glass above a floor, with a texture, beneath a smaller one that hides and lights it by its metal."""
    x, y = torch.meshgrid(torch.linspace(-1, 1, 40), torch.linspace(-1, 1, 70), indexing="ij")
    waves = 0.15 * torch.sin(6 * x) * torch.cos(5 * y + x)
    field = {"type": "heightfield", "interpolation": interpolation}
    above = tr.Transform.translate([0.2, 0.1, 0.9]) @ tr.Transform.rotate([1, 0, 0], 20) @ tr.Transform.scale(0.5)
    film = {"type": "hdrfilm", "width": 20, "height": 15, "rfilter": {"type": "box"}}
    camera = {"type": "perspective", "fov": 45, "film": film}
    camera["to_world"] = tr.Transform.look_at([1.0, -2.5, 2.5], [0, 0, 0.2], [0, 0, 1])
    paper = {"type": "diffuse", "reflectance": light_scenes.texels(5, 4)}
    return tr.load_dict(
        {
            "type": "scene",
            "camera": camera,
            "floor": {"type": "rectangle", "to_world": tr.Transform.translate([0, 0, -0.5]), "bsdf": paper},
            "water": {**field, "heights": waves, "bsdf": {"type": "roughdielectric", "alpha": 0.1}},
            "metal": {**field, "heights": waves[::4, ::6], "to_world": above, "bsdf": {"type": "roughconductor"}},
            "sky": light_scenes.envmap(),
            "lamp": {"type": "point", "position": [0.5, -0.5, 3.0], "intensity": 10.0},
        },
        dtype=dtype,
    )
