"""Many rays a block at a time: what autograd keeps of a block is made once more when its derivatives are asked for.

Of a ray there remain its beginning, what comes out, and where its flight ended: derivatives go on from there, so that
rays are not bent twice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch.autograd import forward_ad

from ..functions import DerivativeFunction, UnbatchedFunction, functorch, refuse_batches
from ..scene.values import in_forward_mode

BLOCK = 16384  # rays


@dataclass
class Known:
    """What is known of a block of rays from the first time, and where derivatives by control values are added.

    `flights`: outputs of `Flights`, once it has been called. `partials`: see `Bending`.
    """

    flights: tuple[torch.Tensor, ...] | None = None
    partials: torch.Tensor | None = None


# Of rays (N, 3) and (N, 3), the scene's parameters, and what is known of the rays: tensors of N rows.
Follow = Callable[[torch.Tensor, torch.Tensor, Sequence[torch.Tensor], Known], tuple[torch.Tensor, ...]]


def in_blocks(
    follow: Follow,
    values: int,
    origins: torch.Tensor,
    directions: torch.Tensor,
    tensors: Sequence[torch.Tensor],
) -> tuple[torch.Tensor, ...]:
    """``follow(origins, directions, tensors, Known())``, of many rays in less memory.

    Not in forward mode and not within `torch.func`, which keep nothing for later. `values`: which of `tensors` has the
    control values of the medium.
    """
    given = (origins, directions, *tensors)
    forwards = in_forward_mode() and any(forward_ad.unpack_dual(t).tangent is not None for t in given)
    if len(origins) <= BLOCK or forwards or any(functorch.is_functorch_wrapped_tensor(t) for t in given):
        return follow(origins, directions, tensors, Known())
    return _Blocks.apply(_Work(follow, values, {}), *given)


@dataclass
class _Work:
    follow: Follow
    values: int
    known: dict[int, Known]  # by the first ray of a block


class _Blocks(UnbatchedFunction):
    @staticmethod
    def forward(work: _Work, *inputs: torch.Tensor) -> Any:
        origins, directions, *tensors = (t.detach() for t in inputs)
        count = len(origins)
        out: list[torch.Tensor] = []
        for begin in range(0, count, BLOCK):
            known = work.known[begin] = Known()
            rows = slice(begin, begin + BLOCK)
            found = work.follow(origins[rows], directions[rows], tensors, known)
            out = out or [x.new_empty(count, *x.shape[1:]) for x in found]
            for whole, part in zip(out, found, strict=True):
                whole[rows] = part
        return tuple(out)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.work, *tensors = inputs
        ctx.save_for_backward(*tensors)
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(*(t for t in output if not t.is_floating_point()))

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor | None) -> Any:
        needed = ctx.needs_input_grad[1:]
        if not any(needed) or all(a is None for a in adjoints):
            return (None,) * (1 + len(needed))
        return (None, *_BlocksReverse.apply(ctx.work, needed, len(adjoints), *adjoints, *ctx.saved_tensors))


class _BlocksReverse(DerivativeFunction):
    @staticmethod
    def forward(work: _Work, needed: tuple[bool, ...], outputs: int, *given: torch.Tensor | None) -> Any:
        adjoints = given[:outputs]
        for adjoint in adjoints:
            if adjoint is not None:
                refuse_batches(adjoint)
        origins, directions, *tensors = [t.detach() for t in given[outputs:] if t is not None]
        leaves = [t.requires_grad_(wanted) for t, wanted in zip(tensors, needed[2:], strict=True)]
        values = leaves[work.values]
        partials = values.new_zeros(torch.get_num_threads(), *values.shape) if values.requires_grad else None
        found: list[torch.Tensor | None] = [None] * len(needed)
        for k, rays in enumerate((origins, directions)):
            found[k] = torch.zeros_like(rays) if needed[k] else None
        for begin, known in work.known.items():
            rows = slice(begin, begin + BLOCK)
            o = origins[rows].detach().requires_grad_(needed[0])
            d = directions[rows].detach().requires_grad_(needed[1])
            with torch.enable_grad():
                out = work.follow(o, d, leaves, replace(known, partials=partials))
                # a number, whose derivatives torch finds without loading what it compares symbolic shapes with
                products = [
                    (y * a[rows]).sum() for y, a in zip(out, adjoints, strict=True) if a is not None and y.requires_grad
                ]
                if not products:
                    continue
                total = torch.stack(products).sum()
            inputs = [t for t in (o, d, *leaves) if t.requires_grad]
            gradients = iter(torch.autograd.grad(total, inputs, allow_unused=True))
            for k, wanted in enumerate(needed):
                gradient = next(gradients) if wanted else None
                if gradient is None:
                    continue
                whole = found[k]
                if k < 2 and whole is not None:
                    whole[rows] = gradient
                elif whole is None:
                    found[k] = gradient
                else:
                    found[k] = whole + gradient
        if partials is not None:
            summed = partials[0]
            for part in partials[1:]:
                summed += part
            others = found[2 + work.values]
            found[2 + work.values] = summed if others is None else summed + others
        return tuple(found)
