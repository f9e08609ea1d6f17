"""What tests of the emulated device share."""

from __future__ import annotations

import math
from typing import Any

import bsdf_models
import light_scenes
import torch

import torchrender as tr

CLOSE = 2e-5
"""Of the largest number of a gradient: both add the same numbers of single precision, in another order."""


def differentiable(scene: tr.Scene) -> dict[str, torch.nn.Parameter]:
    """All parameters that the image has a derivative by, which alone are trained afterwards."""
    scene.train_only()
    refused = {slot.name for slot in scene.layout().slots if slot.refusal}
    found = {name: parameter for name, parameter in scene.named_parameters() if name not in refused}
    for parameter in found.values():
        parameter.requires_grad_(True)
    return found


def check_close(found: dict[str, torch.Tensor], expected: dict[str, torch.Tensor]) -> None:
    """Numbers by name differ by `CLOSE` of the largest one at most; some are not zero."""
    assert any(float(g.abs().max()) > 0 for g in expected.values())
    for name, g in expected.items():
        most = CLOSE * float(g.abs().max())
        torch.testing.assert_close(found[name], g, rtol=0, atol=most, msg=lambda m, n=name: f"{n}: {m}")


def check_transposed(function, values: tuple[torch.Tensor, ...], tangents, tangent: torch.Tensor, generator) -> None:
    """<J t, w> = <t, J^T w>: `tangent`, that of `function` at `values` along `tangents`, and its reverse mode."""
    weights = torch.randn(tangent.shape, generator=generator)
    back = torch.func.vjp(function, *values)[1](weights)
    one = (tangent * weights).sum(dtype=torch.float64)
    other = sum((t * g).sum(dtype=torch.float64) for t, g in zip(tangents, back, strict=True))
    scale = (tangent * weights).abs().sum(dtype=torch.float64)
    assert abs(float(one - other)) < 1e-5 * float(scale)


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


def scene_of_materials(bsdfs: dict[str, dict[str, Any]], size: int, rfilter: str = "box") -> tr.Scene:
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
    return tr.load_dict({"type": "scene", "camera": camera, **objects, "sky": light_scenes.envmap(), "lamp": lamp})


def hills(interpolation: str) -> tr.Scene:
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
        }
    )
