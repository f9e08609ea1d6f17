"""A table of the sigmoids of all colours, and its interpolation, which is fast enough for images.

By the largest channel, its value, and the ratios of the other two to it, as Jakob and Hanika have it. Both the value
and the ratios are denser at their ends, where coefficients vary most.
"""

from __future__ import annotations

from typing import Any

import torch
from torch.autograd import Function

from .. import backends
from ..errors import NotDifferentiableError
from ..functions import refuse_batches
from .cached import made_once
from .sigmoids import nodes
from .solving import levenberg, newton, reachable

FINE, COARSE = 64, 16  # nodes an axis: for images, and to begin the search for a constant's coefficients
BINS = 1024  # as the core has them
SECOND = "upsample: exact=False has first derivatives only; exact=True has others, too"
BATCHED = "upsample: exact=False: is_grads_batched and vectorize=True do not reach into it, but torch.func.vmap does"
BLACK = 1e-6  # what is not brighter than this is black
_END = 5e-4  # how near colours of the table come to the ends of ratios and values, but for dark ones
_PART = 2048  # colours at a time, so that they stay in the cache


def lookup(rgb: torch.Tensor, size: int, light: bool = False) -> torch.Tensor:
    """Coefficients and scales (..., 4) of colours (..., 3), see `upsample`: trilinear in a table of `size`^3 nodes.

    Differentiable as what it is, once. The derivative at black is that of grey.
    """
    return Texels.apply(rgb, size, light)


class Texels(Function):
    """``coefficients and scales = Texels.apply(rgb, size, light)``, see `lookup`."""

    @staticmethod
    def forward(rgb: torch.Tensor, size: int, light: bool) -> torch.Tensor:
        return call_core("values", rgb, None, size, light)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        rgb, *ctx.settings = inputs
        ctx.save_for_backward(rgb)
        ctx.save_for_forward(rgb)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> Any:
        return TexelsDerivative.apply("reverse", *ctx.saved_tensors, grad, *ctx.settings), None, None

    @staticmethod
    def jvp(ctx: Any, tangent: torch.Tensor, *_: Any) -> torch.Tensor:
        return TexelsDerivative.apply("forward", *ctx.saved_tensors, tangent, *ctx.settings)

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], rgb: torch.Tensor, *settings: Any) -> tuple[torch.Tensor, int]:
        return Texels.apply(rgb.movedim(in_dims[0], 0), *settings), 0


class TexelsDerivative(Function):
    """Adjoints (..., 4) of coefficients and scales to those of colours, or tangents (..., 3) the other way."""

    @staticmethod
    def forward(what: str, rgb: torch.Tensor, given: torch.Tensor, size: int, light: bool) -> torch.Tensor:
        return call_core(what, rgb, given, size, light)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, *_: Any) -> Any:
        raise NotDifferentiableError(SECOND)

    @staticmethod
    def jvp(ctx: Any, *_: Any) -> Any:
        raise NotDifferentiableError(SECOND)

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[Any, ...], what: str, rgb: torch.Tensor, given: torch.Tensor, *settings: Any
    ) -> tuple[torch.Tensor, int]:
        both = [
            tensor.expand(info.batch_size, *tensor.shape) if dim is None else tensor.movedim(dim, 0)
            for tensor, dim in zip((rgb, given), in_dims[1:3], strict=True)
        ]
        return TexelsDerivative.apply(what, *both, *settings), 0


def call_core(what: str, rgb: torch.Tensor, given: torch.Tensor | None, size: int, light: bool) -> torch.Tensor:
    """A call of the core: csrc/cpu/upsampling.h; on the processor, and in double precision if the colours are."""
    refuse_batches(rgb if given is None else given, BATCHED)
    dtype = torch.float64 if rgb.dtype == torch.float64 else torch.float32
    arrays = _table(size, dtype) | {"rgb": rgb.to("cpu", dtype).contiguous()}
    if given is not None:
        arrays["given"] = given.to("cpu", dtype).contiguous()
    arrays["out"] = out = torch.empty((*rgb.shape[:-1], 3 if what == "reverse" else 4), dtype=dtype)
    core, addresses = backends.core(dtype), {name: tensor.data_ptr() for name, tensor in arrays.items()}
    core.use_large_pages(out.data_ptr(), out.nbytes)
    name = str(dtype).removeprefix("torch.")
    core.upsample(what, name, addresses, size, light, torch.get_num_threads(), rgb.numel() // 3)
    return out.to(rgb.device, rgb.dtype)


@made_once
def _table(size: int, dtype: torch.dtype) -> dict[str, torch.Tensor]:
    """The table as the core takes it: see csrc/core/color/upsampling.h."""
    table, value_nodes, ratio_nodes = _made(size)
    rows = torch.empty(len(table), 4, dtype=dtype)
    backends.core(dtype).use_large_pages(rows.data_ptr(), rows.nbytes)  # it is read at random
    rows[:, :3], rows[:, 3] = table, 0
    arrays = {"rows": rows}
    bins = torch.linspace(0, 1, BINS + 1, dtype=dtype)
    for name, at in (("value", value_nodes.to(dtype)), ("ratio", ratio_nodes.to(dtype))):
        arrays[f"{name}_nodes"] = at
        arrays[f"{name}_cells"] = (torch.searchsorted(at, bins, right=True) - 1).clamp(0, size - 2).int()
    return arrays


@made_once
def _made(size: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The table (3 size^3, 3), float32, and the values and ratios (size,) of its nodes."""
    t = torch.linspace(0, 1, size, dtype=torch.float64)
    ratio_nodes = _smooth_step(t)
    value_nodes = _smooth_step(ratio_nodes)
    colours = _colours(value_nodes, ratio_nodes)
    table = _march(colours.float(), 2 if size == FINE else 4)
    if size == FINE:
        _correct(table, colours)
    return table.reshape(size, 3, -1, 3).transpose(0, 1).reshape(-1, 3), value_nodes, ratio_nodes


def _smooth_step(t: torch.Tensor) -> torch.Tensor:
    return t * t * (3 - 2 * t)


def _colours(values: torch.Tensor, ratios: torch.Tensor) -> torch.Tensor:
    """(size, 3 size^2, 3): value, then channel and ratios."""
    second, first = torch.meshgrid(ratios.clamp(min=_END), ratios.clamp(min=_END), indexing="ij")
    shades = torch.stack([torch.ones_like(first), first, second], -1).reshape(-1, 3)
    shades = torch.cat([shades.roll(channel, 1) for channel in range(3)])
    return reachable(values.clamp(BLACK, 1 - _END)[:, None, None] * shades)


def _march(colours: torch.Tensor, steps: int) -> torch.Tensor:
    """Some of Newton's steps from each value to the next, from the middle to both ends; at 48 nodes."""
    rule, middle = nodes(10, torch.float32), len(colours) // 2
    result = torch.empty_like(colours)
    target = colours[middle]
    grey = target.mean(-1, keepdim=True)
    current = torch.zeros_like(target)
    for step in range(1, 9):
        current = newton(current, grey + (target - grey) * step / 8, rule, 2)
    result[middle] = newton(current, target, rule, 4)
    for numbers, back in ((range(middle - 1, -1, -1), 1), (range(middle + 1, len(colours)), -1)):
        for i in numbers:
            for part in range(0, colours.shape[1], _PART):
                rows = slice(part, part + _PART)
                result[i, rows] = newton(result[i + back, rows], colours[i, rows], rule, steps)
    return result.nan_to_num(0.0)


def _correct(table: torch.Tensor, colours: torch.Tensor) -> None:
    """What Newton's steps have missed, and steep spectra, for which they had too few nodes."""
    rule, found = nodes(10, torch.float32), table.view(-1, 3)
    wanted = colours.view(-1, 3)
    errors = [
        (rule.colours(part)[0] - target).abs().amax(-1)
        for part, target in zip(found.split(_PART), wanted.float().split(_PART))
    ]
    wrong = (torch.cat(errors) > 2e-4).nonzero()[:, 0]
    start = found[wrong].double()
    found[wrong] = levenberg(start, wanted[wrong], nodes(1, torch.float64), 30, 1e-5).float()
