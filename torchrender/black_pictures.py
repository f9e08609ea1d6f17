"""A picture without any light: what people forget, said once, at the first rendering of a scene."""

from __future__ import annotations

import itertools
import warnings
from typing import Any

import torch

from .errors import depth_outside, warn_once
from .functions import functorch
from .queries import Hits, find_hits
from .scene.container import Container
from .scene.host_memory import numbers_on_host
from .scene.media import Medium
from .scene.native import NativeScene
from .scene.packing import Layout
from .scene.plugin import Plugin
from .scene.shapes import ON_SHAPES
from .scene.torch_bsdf import TorchBSDF

GRID = 16  # rays along a side of the film that are looked at


def warn_of_missing_light(scene: Container, packed: Layout) -> None:
    """Lights that light nothing because they belong to no shape; and a scene without any."""
    packed.lights_seen = True
    for name, module in scene._modules.items():
        if isinstance(module, Plugin) and module.type in ON_SHAPES and id(module) not in packed.used:
            text = f"{name}: this {module.type} light lights nothing, since it is no shape's emitter"
            warn_once(scene.warned, f"{name}: idle", text)
    glows = any(isinstance(m, Medium) and m._child("emission") is not None for m in scene.modules())
    if not packed.objects["emitter"] and not glows:
        text = "the scene has no light, so that its picture is black: add one, such as {'type': 'constant'}"
        warn_once(scene.warned, "light", text)


def warn_of_black_picture(
    scene: Container, packed: Layout, native: NativeScene, tensors: list[torch.Tensor], camera: Any, image: torch.Tensor
) -> None:
    """Why the first picture of a scene with lights is black, if what the camera meets first tells it."""
    scene.warned.add("black")  # that it was looked at
    if packed.media or not packed.objects["emitter"] or not hasattr(camera, "rays"):
        return  # what is seen within media is more than surfaces
    if functorch.is_functorch_wrapped_tensor(image):
        return
    with torch.no_grad():
        if bool(image.any()):
            return
        reason = _reason(scene, packed, native, [t.detach() for t in tensors], camera)
    if reason:
        warnings.warn(f"the picture is black: {reason}", UserWarning, stacklevel=depth_outside())


def _reason(
    scene: Container, packed: Layout, native: NativeScene, tensors: list[torch.Tensor], camera: Any
) -> str | None:
    shapes = [scene[name] for _, _, name in packed.objects["shape"]]
    rows, columns = (
        (torch.arange(GRID) + 0.5) * (size / GRID) + first
        for first, size in zip(camera.film.window[:2], camera.film.window[2:], strict=True)
    )
    places = torch.stack([g.reshape(-1) for g in torch.meshgrid(columns, rows, indexing="xy")], 1)
    of_distant = {}
    if camera.type == "distant":  # whose one pixel sees the whole scene, through its lens
        box = torch.tensor(native.handle.bounding_box(), dtype=native.dtype).reshape(2, 3)
        lens = (torch.arange(GRID) + 0.5) / GRID
        of_distant = {"lens": torch.cartesian_prod(lens, lens), "bounds": box}
    rays = camera.rays(places, **of_distant)  # which lie where the camera does
    origins, directions, lengths = (numbers_on_host(t) for t in (rays.origins, rays.directions, rays.tmax))
    seen = find_hits(native, tensors, origins, directions, lengths)
    if not bool(seen.valid.any()):
        return None if any(m.type in ("constant", "envmap") for m in _emitters(scene)) else _NOTHING
    around = torch.tensor(list(itertools.product((-1.0, 0.3, 1.0), repeat=3))).to(directions)
    origin = origins[:1].expand(len(around), 3).contiguous()
    enclosed = find_hits(native, tensors, origin, around, torch.full_like(around[:, 0], float("inf")))
    first = int(enclosed.shape_id[0])
    if bool(enclosed.valid.all()) and bool((enclosed.shape_id == first).all()) and _blocks(shapes[first]):
        return f"the camera is inside of {packed.objects['shape'][first][2]!r}, where no light arrives"
    if bool(_from_behind(seen, directions)[seen.valid].all()) and all(
        _one_sided(shapes[i]._child("bsdf")) for i in seen.shape_id[seen.valid].unique().tolist()
    ):
        names = ", ".join(packed.objects["shape"][i][2] for i in seen.shape_id[seen.valid].unique().tolist()[:4])
        return (
            f"all surfaces that the camera sees ({names}) turn their backs to it, and their BSDFs are one-sided: put "
            "them into {'type': 'twosided', ...}, or flip_normals"
        )
    return None


_NOTHING = "no ray of the camera meets a surface; scene.bounding_box() says where the shapes are"


def _emitters(scene: Container) -> list[Plugin]:
    return [m for m in scene.modules() if isinstance(m, Plugin) and m.category == "emitter"]


def _from_behind(hits: Hits, directions: torch.Tensor) -> torch.Tensor:
    return (hits.normal * directions).sum(1) > 0


def _blocks(shape: Plugin) -> bool:
    """Whether no light comes through, and none from the shape itself."""
    return shape._child("emitter") is None and not _transmits(shape._child("bsdf"))


def _inner(bsdf: Plugin) -> list[Plugin]:
    return [m for m in bsdf._modules.values() if isinstance(m, Plugin) and m.category == "bsdf"]


def _transmits(bsdf: Plugin | None) -> bool:
    if bsdf is None:
        return False
    if isinstance(bsdf, TorchBSDF):
        return True
    return "transmits" in bsdf.model().flags or any(_transmits(m) for m in _inner(bsdf))


def _one_sided(bsdf: Plugin | None) -> bool:
    if bsdf is None:
        return True
    if isinstance(bsdf, TorchBSDF):
        return not bsdf.two_sided
    return bsdf.type != "twosided" and not _transmits(bsdf) and all(_one_sided(m) for m in _inner(bsdf))
