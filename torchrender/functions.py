"""Bases of this package's autograd functions: what `torch.func` may ask of them, and what raises a clear error."""

from __future__ import annotations

from typing import Any

import torch
from torch.autograd import Function

from .errors import NotDifferentiableError

functorch: Any = torch._C._functorch  # pyright: ignore[reportAttributeAccessIssue] (torch has no types for it)

BATCHED = (
    "vmap does not reach into a rendering: loop over the inputs (jacrev does so with chunk_size=1, "
    "torch.autograd.functional.jacobian with vectorize=False, and in place of jacfwd a loop over jvp); "
    "several cameras are one call, sensor=[...]"
)
SECOND = "a rendering has first derivatives only: differentiating its gradient again is not possible"


class UnbatchedFunction(Function):
    """A function that `vmap` does not reach into."""

    @staticmethod
    def vmap(info: Any, in_dims: Any, *_: Any) -> Any:
        raise NotDifferentiableError(BATCHED)


class DerivativeFunction(UnbatchedFunction):
    """A derivative as a function of its own: `torch.func` unwraps its tensors. It has no derivative in turn."""

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, *_: Any) -> Any:
        raise NotDifferentiableError(SECOND)

    @staticmethod
    def jvp(ctx: Any, *tangents: Any) -> Any:
        raise NotDifferentiableError(SECOND)


class ConstantFunction(UnbatchedFunction):
    """A call of the core that is given plain tensors inside of `torch.func`, too. Its results have no derivatives."""

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.count = len(inputs)
        ctx.outputs = len(output) if isinstance(output, tuple) else 0
        ctx.mark_non_differentiable(*(output if isinstance(output, tuple) else (output,)))

    @staticmethod
    def backward(ctx: Any, *_: Any) -> Any:
        return (None,) * ctx.count

    @staticmethod
    def jvp(ctx: Any, *_: Any) -> Any:
        return (None,) * ctx.outputs if ctx.outputs else None


def unwrapped(tensor: torch.Tensor) -> torch.Tensor:
    """`tensor` as it is outside of `torch.func`, without derivatives."""
    while functorch.is_functorch_wrapped_tensor(tensor):
        tensor = functorch.get_unwrapped(tensor)
    with torch._C._DisableFuncTorch():
        return tensor.detach()


def refuse_batches(tensor: Any, said: str = BATCHED) -> None:
    """NotDifferentiableError, which says this, for a tensor that is batched by `vmap`.

    torch itself would say less clearly what is wrong with random seeds inside of `vmap`, and with ``is_grads_batched``
    and ``vectorize=True``, which use a vmap that asks no `Function` whether it has a rule.
    """
    for name in ("is_batchedtensor", "is_legacy_batchedtensor"):
        is_batched = getattr(functorch, name, None)
        if is_batched is not None and isinstance(tensor, torch.Tensor) and is_batched(tensor):
            raise NotDifferentiableError(said)
