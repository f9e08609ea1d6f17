"""The autograd functions under `native_bsdf`: values and sampling of a native model, and what autograd asks of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch

from .errors import NotDifferentiableError
from .functions import ConstantFunction, DerivativeFunction, UnbatchedFunction
from .scene.context import LUMINANCE

BATCHED = "vmap does not reach into a native BSDF: give it all points at once, as rows of one call"
SECOND = "native BSDFs have first derivatives only: differentiating their gradient again is not possible"


class BsdfPoints(NamedTuple):
    """N points: the core's functions, `wi` (N, 3), and the model's fields, (N, C) or (N,), all of one precision."""

    functions: Any
    wi: torch.Tensor
    params: list[torch.Tensor]


def call(
    functions: Any, name: str, params: Sequence[torch.Tensor], arrays: dict[str, torch.Tensor], *more: Any
) -> None:
    """A call of the core, which reads and writes `arrays`; these are dense where it writes."""
    held = [p.contiguous() for p in params], {key: t.contiguous() for key, t in arrays.items()}
    addresses = [p.data_ptr() for p in held[0]], {key: t.data_ptr() for key, t in held[1].items()}
    getattr(functions, name)(len(arrays["wi"]), *addresses, *more)


def weights(channels: int) -> tuple[float, ...]:
    """Of luminance."""
    return LUMINANCE if channels == 3 else (1.0,)


def dot(adjoint: torch.Tensor, by: torch.Tensor, shape: Sequence[int]) -> torch.Tensor:
    """The adjoint (N, C) times the derivatives (N, C) by a field of this shape: a colour's components do not mix."""
    return adjoint * by if len(shape) == 2 else (adjoint * by).sum(1)


class _Function(UnbatchedFunction):
    """Of rows, which `vmap` does not reach into."""

    @staticmethod
    def vmap(info: Any, in_dims: Any, *_: Any) -> Any:
        raise NotDifferentiableError(BATCHED)


class BsdfEvaluation(_Function):
    """``value = BsdfEvaluation.apply(functions, lobe, wi, wo, *params)``, (N, C)."""

    @staticmethod
    def forward(functions: Any, lobe: torch.Tensor, wi: torch.Tensor, wo: torch.Tensor, *params: torch.Tensor) -> Any:
        value = wi.new_empty(len(wi), functions.channels)
        call(functions, "eval", params, {"wi": wi, "wo": wo, "lobe": lobe, "value": value})
        return value

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.functions = inputs[0]
        ctx.save_for_backward(*inputs[1:])
        ctx.save_for_forward(*inputs[1:])
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, adjoint: torch.Tensor | None) -> Any:
        if adjoint is None:
            return (None,) * len(ctx.needs_input_grad)
        needed = ctx.needs_input_grad[2:]
        by_wi, by_wo, by_params, by_luminance = derivatives(ctx, needed)
        found = [None if by is None else (adjoint[..., None] * by).sum(1) for by in (by_wi, by_wo)]
        found = [f if n else None for f, n in zip(found, needed, strict=False)]
        of_luminance = adjoint.new_tensor(weights(adjoint.shape[1]))
        for name, p, n in zip(ctx.functions.fields["all"], ctx.saved_tensors[3:], needed[2:], strict=True):
            gradient = torch.zeros_like(p) if n else None  # of what only sampling asks for
            if n and name in by_params:
                gradient = dot(adjoint, by_params[name], p.shape)
                if name in by_luminance:
                    gradient = gradient + (adjoint * by_luminance[name]).sum(1, keepdim=True) * of_luminance
            found.append(gradient)
        return (None, None, *found)

    @staticmethod
    def jvp(ctx: Any, _functions: Any, _lobe: Any, *tangents: torch.Tensor | None) -> Any:
        by_wi, by_wo, by_params, by_luminance = derivatives(ctx, [t is not None for t in tangents])
        wi = ctx.saved_tensors[1]
        total = wi.new_zeros(len(wi), ctx.functions.channels)
        for by, tangent in zip((by_wi, by_wo), tangents, strict=False):
            if by is not None and tangent is not None:
                total = total + (by * tangent[:, None]).sum(2)
        of_luminance = wi.new_tensor(weights(total.shape[1]))
        for name, tangent in zip(ctx.functions.fields["all"], tangents[2:], strict=True):
            if tangent is None or name not in by_params:
                continue
            total = total + by_params[name] * (tangent if tangent.ndim == 2 else tangent[:, None])
            if name in by_luminance:
                total = total + by_luminance[name] * (tangent * of_luminance).sum(1, keepdim=True)
        return total


def derivatives(
    ctx: Any, needed: Sequence[bool]
) -> tuple[torch.Tensor | None, torch.Tensor | None, dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    """Those of the value by wi, wo (N, C, 3), by fields, and by the luminance of fields (N, C), of what is needed.

    Adjoints and tangents are multiplied with them by torch, so that both modes are differentiable in these, if in
    nothing else: what a derivative of the gradient by its adjoint asks for.
    """
    names = ctx.functions.fields
    wanted = {name for name, n in zip(names["all"], needed[2:], strict=True) if n}
    of_fields = tuple(name in wanted for name in names["variables"])
    of_luminance = tuple(name in wanted for name in names["luminance"])
    directions = any(needed[:2])
    found = iter(BsdfDerivatives.apply(ctx.functions, directions, of_fields + of_luminance, *ctx.saved_tensors))
    by_wi, by_wo = (next(found), next(found)) if directions else (None, None)
    by_params = {name: next(found) for name in names["variables"] if name in wanted}
    by_luminance = {name: next(found) for name in names["luminance"] if name in wanted}
    return by_wi, by_wo, by_params, by_luminance


class _Derivatives(_Function, DerivativeFunction):
    """Derivatives of a native BSDF, which have none."""

    @staticmethod
    def backward(ctx: Any, *_: Any) -> Any:
        raise NotDifferentiableError(SECOND)

    @staticmethod
    def jvp(ctx: Any, *_: Any) -> Any:
        raise NotDifferentiableError(SECOND)


class BsdfDerivatives(_Derivatives):
    """By wi and wo (N, C, 3), and by those variables that are wanted (N, C)."""

    @staticmethod
    def forward(
        functions: Any,
        directions: bool,
        variables: tuple[bool, ...],
        lobe: torch.Tensor,
        wi: torch.Tensor,
        wo: torch.Tensor,
        *params: torch.Tensor,
    ) -> Any:
        n, channels = len(wi), functions.channels
        arrays = {"lobe": lobe, "wi": wi, "wo": wo}
        by_directions = [wi.new_empty(n, channels, 3) for _ in range(2 if directions else 0)]
        arrays |= dict(zip(("by_wi", "by_wo"), by_directions, strict=False))
        by_variables = [wi.new_empty(n, channels) if wanted else None for wanted in variables]
        addresses = [0 if t is None else t.data_ptr() for t in by_variables]
        call(functions, "eval_derivative", params, arrays, addresses)
        return (*by_directions, *(t for t in by_variables if t is not None))


class BsdfSampling(_Function, ConstantFunction):
    """``wo, pdf, eta, lobe, delta, value``, or the density ``pdf``, of directions or numbers `other` (N, 3)."""

    @staticmethod
    def forward(functions: Any, samples: bool, wi: torch.Tensor, other: torch.Tensor, *params: torch.Tensor) -> Any:
        n = len(wi)
        pdf = wi.new_empty(n)
        if not samples:
            call(functions, "pdf", params, {"wi": wi, "wo": other, "pdf": pdf})
            return pdf
        found = {"wo": wi.new_empty(n, 3), "pdf": pdf, "eta": wi.new_empty(n)}
        found["lobe"] = torch.empty(n, dtype=torch.int32, device="cpu")
        found["delta"] = torch.empty(n, dtype=torch.uint8, device="cpu")
        found["value"] = wi.new_empty(n, functions.channels)
        call(functions, "sample", params, {"wi": wi, "u": other, **found})
        return tuple(found.values())


class BsdfDirection(_Function):
    """``wo = BsdfDirection.apply(functions, lobe, delta, wo, wi, *params)``: attached where the lobe is a delta."""

    @staticmethod
    def forward(
        functions: Any,
        lobe: torch.Tensor,
        delta: torch.Tensor,
        wo: torch.Tensor,
        wi: torch.Tensor,
        *params: torch.Tensor,
    ) -> torch.Tensor:
        return wo.clone()

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.functions = inputs[0]
        lobe, delta, _, *others = inputs[1:]
        ctx.save_for_backward(lobe, delta, *others)
        ctx.save_for_forward(lobe, delta, *others)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, adjoint: torch.Tensor | None) -> Any:
        if adjoint is None or not any(ctx.needs_input_grad):
            return (None,) * len(ctx.needs_input_grad)
        needed = ctx.needs_input_grad[4:]
        by_wi, *by_numbers = BsdfDirectionDerivatives.apply(ctx.functions, *ctx.saved_tensors)
        params = ctx.saved_tensors[3:]
        found = [(adjoint[..., None] * by_wi).sum(1), *(torch.zeros_like(p) for p in params)]
        for i, by in zip(_turning(ctx.functions, params), by_numbers, strict=True):
            _first(found[1 + i]).copy_((adjoint * by).sum(1))
        return (None, None, None, None, *(f if n else None for f, n in zip(found, needed, strict=True)))

    @staticmethod
    def jvp(ctx: Any, _functions: Any, _lobe: Any, _delta: Any, _wo: Any, *tangents: torch.Tensor | None) -> Any:
        by_wi, *by_numbers = BsdfDirectionDerivatives.apply(ctx.functions, *ctx.saved_tensors)
        wi, *of_params = tangents
        total = torch.zeros_like(by_wi[..., 0]) if wi is None else (by_wi * wi[:, None]).sum(2)
        for i, by in zip(_turning(ctx.functions, ctx.saved_tensors[3:]), by_numbers, strict=True):
            tangent = of_params[i]
            if tangent is not None:
                total = total + by * _first(tangent)[:, None]
        return total


def _turning(functions: Any, params: Sequence[torch.Tensor]) -> list[int]:
    """Which parameters turn delta lobes: the numbers (N,), or of one colour (N, C) the first component."""
    if functions.turned_by >= 0:
        return [functions.turned_by]
    return [i for i, p in enumerate(params) if p.ndim == 1]


def _first(values: torch.Tensor) -> torch.Tensor:
    return values if values.ndim == 1 else values[:, 0]


class BsdfDirectionDerivatives(_Derivatives):
    """Derivatives of the directions of delta lobes by wi (N, 3, 3), and by what turns them (N, 3); elsewhere 0."""

    @staticmethod
    def forward(
        functions: Any, lobe: torch.Tensor, delta: torch.Tensor, wi: torch.Tensor, *params: torch.Tensor
    ) -> Any:
        n, numbers = len(wi), len(_turning(functions, params))
        arrays = {"lobe": lobe, "wi": wi, "by_wi": wi.new_empty(n, 3, 3), "by_number": wi.new_empty(n, 3, numbers)}
        call(functions, "direction_derivative", params, arrays)
        turned = (delta != 0)[:, None]
        by_wi = torch.where(turned[..., None], arrays["by_wi"], 0.0)
        return (by_wi, *(torch.where(turned, by, 0.0) for by in arrays["by_number"].unbind(2)))
