"""The output `features`: pictures of any number of channels, of what surfaces carry besides colour."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch.utils.checkpoint import checkpoint

from .errors import describe, nearest
from .first_hit_call import FirstHitCall
from .functions import functorch, refuse_batches
from .queries import Hits
from .render_call import RenderCall
from .scene.context import Context
from .scene.derivatives import moves_rays
from .scene.gather import check_place, has_derivative
from .scene.mesh import Mesh
from .scene.packing import Layout, record
from .scene.scene import Scene
from .scene.values import floating
from .transform import on_cpu
from .wavefront.film import Splats
from .wavefront.numbers import Numbers
from .wavefront.texels import bilinear, wrap
from .wavefront.world import World

CHUNK = 1 << 18  # samples that are looked up at a time; in reverse mode they are looked up again

# What is drawn is no part of a derivative, and inside torch.func every new tensor would be wrapped.
plain = torch._C._DisableFuncTorch


@on_cpu
def features(scene: Scene, call: RenderCall, params: Sequence[torch.Tensor]) -> torch.Tensor:
    """What the first surfaces carry of ``call.features``: averages over the samples of a pixel that hit a shape.

    The derivative has samples of its own, as that of radiance: the result has the numbers of one picture and the
    derivative of another, whose samples are looked up again chunk by chunk in reverse mode.

    Args:
        params: a tensor for each of the layout's slots.

    Returns:
        (H, W, N), or (P, N) for a list of pixels, in the scene's precision; 0 where nothing is hit.
    """
    carried = (_carried(scene, call, params),)
    shared = call.share.attached(carried, [*params, *call.features.values()])
    return call.share.averaged(call, params, shared, FirstHitCall(call, ()))[0]  # over samples that hit something


def _carried(scene: Scene, call: RenderCall, params: Sequence[torch.Tensor]) -> torch.Tensor:
    """Of the samples of this process."""
    layout = call.layout
    moving = any(has_derivative(p) for p, slot in zip(params, layout.slots, strict=True) if moves_rays(slot))
    if not moving and not any(has_derivative(t) for t in call.features.values()):
        return _average(World(scene, layout, call.native, params), call, call.features, False)
    attached = _average(World(scene, layout, call.native, params, moving=True), call, call.features, True)
    if (call.seed, call.spp) == (call.seed_grad, call.spp_grad):
        return attached
    with torch.no_grad():
        given = {k: t.detach() for k, t in call.features.items()}
        image = _average(World(scene, layout, call.native, params), call, given, False).detach()
    return image + (attached - attached.detach())


def _average(world: World, call: RenderCall, given: Mapping[int, torch.Tensor], derivative: bool) -> torch.Tensor:
    """The weighted mean over the samples of all passes, of the image or of its `derivative`, which is attached."""
    configs = call.configs(derivative)
    spp, offset, channels = configs[0]["spp"], configs[0]["sample_offset"], next(iter(given.values())).shape[-1]
    with plain():
        splats = Splats(call.film, call.config["crop"], call.config["window"], call.pixels)
    total, chunk = len(splats.sources) * spp, CHUNK

    def covered(positions: torch.Tensor, lens: torch.Tensor) -> torch.Tensor:
        """The features (S, N) seen through places on the film, and in a last column whether anything is."""
        rays = world.camera_rays(call.config["sensor"], call.config["film_size"], positions, lens)
        hits = world.first_hits(rays, call.config["hide_emitters"])
        rows = hits.valid.nonzero()[:, 0]
        values = _at_hits(world.layout, Hits(*(member[rows] for member in hits)), given, channels)
        result = torch.zeros(len(positions), channels + 1, dtype=world.dtype)
        return result.index_put((rows,), torch.cat([values, torch.ones_like(values[:, :1])], dim=1))

    @on_cpu  # reverse mode calls it once more, by itself
    def look_up(start: int, random: Numbers) -> torch.Tensor:
        if again:
            _check_versions(world, given, versions)
        with plain():
            samples = splats.samples(torch.arange(start, min(start + chunk, total)), spp, random, offset)
            spread = splats.spread(samples.pixel, samples.offset)
        seen = covered(samples.positions, samples.lens)
        columns = seen.new_zeros(*spread.weights.shape[:2], channels + 1).double()
        totals = spread.weights.abs().transpose(1, 2) @ columns.index_put((spread.lane, spread.place), seen.double())
        wanted = spread.target >= 0
        empty = torch.zeros(splats.count, channels + 1, dtype=torch.float64)
        return empty.index_add(0, spread.target[wanted], totals[wanted])

    if total == 0:  # no pixels: the gradient of nothing is zero
        nowhere = torch.zeros(0, 2)
        return covered(nowhere, nowhere)[:, :channels].reshape(*call.size, channels)
    again = derivative and torch.is_grad_enabled() and not functorch.maybe_current_level()
    versions = _versions(world, given) if again else {}
    sums = torch.zeros(splats.count, channels + 1, dtype=torch.float64)
    for config in configs:
        random = Numbers(config["sampler"], config["pattern"][1], config["seed"], config["sensor"], world.dtype)
        for start in range(0, total, chunk):
            found = checkpoint(look_up, start, random, use_reentrant=False) if again else look_up(start, random)
            sums = sums + found
    weight = sums[:, channels:].detach()
    image = sums[:, :channels] / torch.where(weight > 0, weight, 1.0)
    return image[splats.where].reshape(*call.size, channels).to(world.dtype)


def _versions(world: World, given: Mapping[int, torch.Tensor]) -> dict[str, int]:
    """Version counters of all tensors that are looked up, by their names in error messages."""
    layout = world.layout
    tensors = {slot.name: tensor for slot, tensor in zip(layout.slots, world.plain, strict=True)}
    tensors.update({f"features[{layout.objects['shape'][number][2]!r}]": tensor for number, tensor in given.items()})
    tensors.update({f"the faces of mesh {i}": tensor for i, tensor in enumerate(layout.index_tensors)})
    return {name: 0 if tensor.is_inference() else tensor._version for name, tensor in tensors.items()}


def _check_versions(world: World, given: Mapping[int, torch.Tensor], versions: Mapping[str, int]) -> None:
    """RuntimeError if a tensor was edited since the image was rendered: its old values cannot be looked up again."""
    for name, version in _versions(world, given).items():
        if version != versions[name]:
            raise RuntimeError(
                f"features: {name} has been modified by an inplace operation between rendering and backward()"
            )


def check_features(scene: Scene, layout: Layout, given: Any, names: Sequence[str]) -> dict[int, torch.Tensor]:
    """`features` of `render`, by the number of their shape; that they and the output are asked for together."""
    if given is None or "features" not in names:
        missing = "features={...}" if given is None else "outputs=(..., 'features')"
        raise ValueError(f"render: the output 'features' shows the tensors of features={{...}}; {missing} is missing")
    if not isinstance(given, Mapping) or not given:
        raise TypeError(f"render: features: expected tensors by the names of shapes, got {describe(given)}")
    numbers = {path: i for i, (_, _, path) in enumerate(layout.objects["shape"])}
    found: dict[int, torch.Tensor] = {}
    channels = None
    for name, value in given.items():
        what = f"render: features: {name}"
        if name not in numbers:
            said = repr(name) if isinstance(name, str) else describe(name)
            raise ValueError(f"render: features: there is no shape {said}; {nearest(str(name), numbers)}")
        refuse_batches(value)
        if isinstance(value, torch.Tensor):
            check_place(scene, what, value)
        tensor = floating(value, Context(dtype=scene.dtype, path=(what,)))
        if tensor.ndim not in (2, 3) or 0 in tensor.shape:
            raise ValueError(f"{what}: expected a texture (H, W, N) or rows of vertices (V, N), got {describe(value)}")
        shape = scene.get_submodule(name)
        if tensor.ndim == 2 and (not isinstance(shape, Mesh) or len(tensor) != len(shape.vertex_positions)):
            expected = f"{len(shape.vertex_positions)} rows" if isinstance(shape, Mesh) else "a texture (H, W, N)"
            raise ValueError(f"{what}: expected {expected}, got {describe(value)}")
        if channels not in (None, tensor.shape[-1]):
            raise ValueError(f"{what}: expected {channels} channels as the others have, got {tensor.shape[-1]}")
        channels = tensor.shape[-1]
        found[numbers[name]] = tensor
    return found


def _at_hits(layout: Layout, hits: Hits, given: Mapping[int, torch.Tensor], channels: int) -> torch.Tensor:
    """The features (N, channels) where rays have hit."""
    result = hits.position.new_zeros(len(hits.valid), channels)
    for number, tensor in given.items():
        rows = (hits.shape_id == number).nonzero()[:, 0]
        if tensor.ndim == 2:
            faces = layout.indices(record(layout, "shape", number).field["faces"]).long()
            b = hits.barycentric[rows]
            weight = torch.cat([1 - b.sum(1, keepdim=True), b], dim=1)[..., None]
            corners = faces[hits.prim_id[rows]]  # whose derivative is added up in one order, by `index_select`
            value = (tensor.index_select(0, corners.flatten()).reshape(*corners.shape, channels) * weight).sum(1)
        else:
            height, width = tensor.shape[:2]
            u, v = hits.uv[rows].unbind(1)
            x, y = u * width - 0.5, v * height - 0.5
            left, top = torch.floor(x.detach()), torch.floor(y.detach())
            columns = wrap(left.long(), width, 0), wrap(left.long() + 1, width, 0)
            lines = wrap(top.long(), height, 0), wrap(top.long() + 1, height, 0)
            value = bilinear(tensor, lines, columns, x - left, y - top, channels)
        result = result.index_put((rows,), value)
    return result
