"""Pictures of any number of channels: what surfaces carry besides colour, as a camera sees it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch.utils.checkpoint import checkpoint

from .errors import describe, nearest
from .queries import Hits, ray_intersect
from .render import _film_config
from .scene.context import Context
from .scene.mesh import Mesh
from .scene.scene import Scene
from .scene.sensor import Sensor
from .scene.values import integer
from .wavefront.film import Splats
from .wavefront.numbers import CAMERA_BLOCK, Numbers, pixel_key
from .wavefront.textures import bilinear, wrap

# What is drawn is no part of a derivative, and inside torch.func every new tensor would be wrapped.
plain = torch._C._DisableFuncTorch

LENS = ("thinlens",)  # cameras whose rays take a place on the lens


def render_features(
    scene: Scene,
    features: Mapping[str, Any],
    *,
    sensor: int = 0,
    spp: int = 16,
    seed: int = 0,
    chunk: int = 1 << 18,
    params: Mapping[str, torch.Tensor] | None = None,
) -> torch.Tensor:
    """What the first surfaces carry: (H, W, N) for any N, averaged over the samples of a pixel that hit a shape.

    For a decoder that turns features into colours, or a classifier's labels on a mesh::

        features = {"head": torch.zeros(256, 256, 16, requires_grad=True)}  # a texture of 16 channels
        image = decoder(tr.render_features(scene, features, spp=4).movedim(2, 0)[None])

    Samples are those of `render` with this seed, so that features line up with its image. Derivatives are those with
    respect to features and, as in `ray_intersect`, to shapes and camera, without moving silhouettes; either mode, any
    order in the features. Chunks of samples are looked up again in reverse mode: memory goes with `chunk`.

    Args:
        scene: where.
        features: by a shape's name, a texture (H, W, N), bilinear and repeated, row 0 at v = 0, or for a mesh one row a
            vertex (V, N), interpolated. Other shapes carry zeros. All have the same N.
        sensor: number of the scene's camera; a `distant` one or an irradiance meter has no such picture.
        spp, seed: samples a pixel, and what their places are drawn from.
        chunk: samples at a time.
        params: tensors that replace parameters of these names, as in `render`.

    Returns:
        (H, W, N) in the scene's precision; 0 where nothing is hit.

    Raises:
        TypeError, ValueError: before any work, naming the shape, what was expected and what came.
    """
    layout = scene.layout()
    given = _checked(scene, layout, features)
    cameras = scene.sensors
    if isinstance(sensor, bool) or not isinstance(sensor, int) or not 0 <= sensor < len(cameras):
        raise ValueError(f"render_features: sensor: expected a number below {len(cameras)}, got {describe(sensor)}")
    camera = cameras[sensor]
    if not hasattr(camera, "rays") or camera.type == "distant":
        raise ValueError(f"render_features: sensor: a {camera.type} has no such picture")
    spp = integer(spp, Context(path=("render_features", "spp")), 1)
    chunk = integer(chunk, Context(path=("render_features", "chunk")), 1)
    rendered, size, config = _film_config(camera.film, None)
    with plain():
        splats = Splats(camera.film, rendered, config["window"])
    sampler = camera.sampler.type if camera.sampler is not None else "independent"
    random = Numbers(sampler, spp, seed, sensor, scene.dtype)
    channels = next(iter(given.values())).shape[-1]
    sums = torch.zeros(splats.count, channels + 1, dtype=torch.float64)
    tensors = tuple(given.values())

    def look_up(start: int, *tensors: torch.Tensor) -> torch.Tensor:
        with plain():
            index = torch.arange(start, min(start + chunk, total))
            pixel, sample = splats.sources[index // spp], index % spp
            drawn = random.block(pixel_key(*pixel.unbind(1)), sample, CAMERA_BLOCK)
            offset = drawn[:, :2].flip(1).double()
            spread = splats.spread(pixel, offset)
        rays = _rays(camera, (pixel.double() + offset).flip(1).to(scene.dtype), drawn[:, 2:].to(scene.dtype))
        hits = ray_intersect(scene, *rays, params=params)
        values = _at_hits(layout, hits, dict(zip(given, tensors, strict=True)), channels)
        covered = torch.cat([values, hits.valid[:, None].to(values)], dim=1).double()
        columns = covered.new_zeros(*spread.weights.shape[:2], channels + 1)
        totals = spread.weights.abs().transpose(1, 2) @ columns.index_put((spread.lane, spread.place), covered)
        wanted = spread.target >= 0
        return torch.zeros_like(sums).index_add(0, spread.target[wanted], totals[wanted])

    total = len(splats.sources) * spp
    again = torch.is_grad_enabled() and not torch._C._functorch.maybe_current_level()
    for start in range(0, total, chunk):
        sums = sums + (checkpoint(look_up, start, *tensors, use_reentrant=False) if again else look_up(start, *tensors))
    weight = sums[:, channels:].detach()
    image = sums[:, :channels] / torch.where(weight > 0, weight, 1.0)
    return image[splats.where].reshape(*size, channels).to(scene.dtype)


def _rays(camera: Sensor, positions: torch.Tensor, lens: torch.Tensor) -> Any:
    return camera.rays(positions, lens) if camera.type in LENS else camera.rays(positions)  # type: ignore[attr-defined]


def _checked(scene: Scene, layout: Any, features: Any) -> dict[int, torch.Tensor]:
    """The features by the number of their shape."""
    if not isinstance(features, Mapping) or not features:
        raise TypeError(f"render_features: features: expected tensors by the names of shapes, got {describe(features)}")
    numbers = {path: i for i, (_, _, path) in enumerate(layout.objects["shape"])}
    found: dict[int, torch.Tensor] = {}
    channels = None
    for name, value in features.items():
        what = f"render_features: features: {name}"
        if name not in numbers:
            raise ValueError(f"render_features: features: there is no shape {name!r}; {nearest(str(name), numbers)}")
        tensor = value if isinstance(value, torch.Tensor) else torch.as_tensor(value)
        if tensor.is_complex() or tensor.ndim not in (2, 3) or 0 in tensor.shape:
            raise ValueError(f"{what}: expected a texture (H, W, N) or rows of vertices (V, N), got {describe(value)}")
        shape = scene.get_submodule(name)
        if tensor.ndim == 2 and (not isinstance(shape, Mesh) or len(tensor) != len(shape.vertex_positions)):
            expected = f"{len(shape.vertex_positions)} rows" if isinstance(shape, Mesh) else "a texture (H, W, N)"
            raise ValueError(f"{what}: expected {expected}, got {describe(value)}")
        if channels not in (None, tensor.shape[-1]):
            raise ValueError(f"{what}: expected {channels} channels as the others have, got {tensor.shape[-1]}")
        channels = tensor.shape[-1]
        found[numbers[name]] = tensor.to(dtype=scene.dtype)
    return found


def _at_hits(layout: Any, hits: Hits, features: dict[int, torch.Tensor], channels: int) -> torch.Tensor:
    """The features (N, channels) where rays have hit."""
    result = hits.position.new_zeros(len(hits.valid), channels)
    for number, tensor in features.items():
        rows = (hits.shape_id == number).nonzero()[:, 0]
        if not len(rows):
            continue
        if tensor.ndim == 2:
            faces = layout.index_tensors[_field(layout, number, "faces")].long()
            corner = tensor[faces[hits.prim_id[rows].long()]]
            b = hits.barycentric[rows]
            weight = torch.cat([1 - b.sum(1, keepdim=True), b], dim=1)[..., None]
            value = (corner * weight).sum(1)
        else:
            height, width = tensor.shape[:2]
            u, v = hits.uv[rows].unbind(1)
            x, y = u * width - 0.5, v * height - 0.5
            left, top = torch.floor(x.detach()), torch.floor(y.detach())
            columns = tuple(wrap(left.long() + k, width, 0) for k in (0, 1))
            lines = tuple(wrap(top.long() + k, height, 0) for k in (0, 1))
            value = bilinear(tensor, lines, columns, x - left, y - top, channels)
        result = result.index_put((rows,), value)
    return result


def _field(layout: Any, number: int, name: str) -> int:
    """An index in a field of a shape."""
    from .scene.declaration import models

    kind, numbers, _ = layout.objects["shape"][number]
    return numbers[[f.name for f in models()["shape", kind].fields].index(name)]
