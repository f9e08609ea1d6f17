"""The boundary to autograd: one `torch.autograd.Function` with forward, reverse mode and forward mode.

The derivative is estimated from samples of its own, keyed by `seed_grad`, so what is saved are the parameters, whose
version counters let torch notice edits in between. Where image and derivative share their samples (``correlated=True``)
the hits of their rays are kept besides, and the backward pass traces nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch.autograd import Function

from . import backends
from .devices import address
from .functions import DerivativeFunction, UnbatchedFunction, refuse_batches
from .progress import tracked
from .render_call import Part, RenderCall
from .scene.native import NativeScene

STORED_HITS_LIMIT = 1 << 30
"""Bytes that the hits kept for backward passes may take, of all graphs together; rays beyond are traced again.

With 0 none are kept. A rendering takes the value that this has when it begins.
"""


class RenderFunction(UnbatchedFunction):
    """``image[, alpha][, variance][, second_moment] = RenderFunction.apply(call, *parameters)``."""

    @staticmethod
    def forward(call: RenderCall, *params: torch.Tensor) -> Any:
        real = {"dtype": call.native.dtype, "device": call.place}
        shapes = {"image": call.shape()}
        for name in call.extra:
            shapes[name] = call.size if name == "alpha" else call.shape()
        all_stats = []
        call.kept = call.store_hits(int(STORED_HITS_LIMIT)) if call.keep_hits else None
        parts = call.parts()
        configs = tracked([p.config for p in parts], "image", call.progress, [p.share for p in parts])
        out = {name: torch.empty(shape, **real) for name, shape in shapes.items()}
        found: tuple[dict[str, torch.Tensor], Part] | None = None  # at any time a picture and the last part of it
        part = parts[0]
        try:
            for part, config in zip(parts, configs, strict=True):
                if part.number == 1:
                    out = {name: torch.empty(shape, **real) for name, shape in shapes.items()}
                addresses = {name: address(tensor) for name, tensor in out.items()}
                given = {**config, **_on_device(call.place)}
                all_stats.append(call.native.call("render", list(params), given, addresses))
                found = _with_part(found, part, out)
                part.config = {}  # its sums would take memory
                if call.interruption.happened:  # in an earlier view
                    break
        except KeyboardInterrupt:
            if part.done() and (found is None or part is not found[1]):
                found = _with_part(found, part, out)
            if found is None or not call.interruption.returns:
                raise
            call.interruption.happened = True
        assert found is not None
        total, last = found
        call.cut(last)
        if call.passes > 1:
            for name, tensor in total.items():
                tensor /= call.passes**2 if name == "variance" else call.passes
        if all_stats:
            call.finish("render", all_stats)
        return tuple(total.values()) if len(total) > 1 else total["image"]

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        call, *params = inputs
        ctx.call = call
        ctx.ready = {}  # gradients by adjoint, see `backward_and_grads`
        # Hits are freed by whatever frees the saved tensors. (With torch.func this comes once for every level, of which
        # one differentiates.)
        kept = ()
        if call.kept is not None and any(ctx.needs_input_grad):
            kept, call.kept = (call.kept,), None
        ctx.save_for_backward(*params, *kept)
        ctx.save_for_forward(*params)
        ctx.set_materialize_grads(False)
        if isinstance(output, tuple):
            # All of the derivative of coverage is the term of moving silhouettes, which is missing; those of variance
            # and second moment are not implemented.
            ctx.mark_non_differentiable(*output[1:])

    @staticmethod
    def backward(ctx: Any, grad_image: torch.Tensor | None, *_: Any) -> Any:
        needed = ctx.needs_input_grad[1:]
        saved = ctx.saved_tensors  # of which the last may be what keeps the hits alive
        if grad_image is None or not any(needed):
            return (None,) * (1 + len(needed))
        if ctx.ready:  # unless a hook has made another one of it
            found = ctx.ready.pop(_identity(grad_image), None)
            if found is not None:
                return None, *found
        return (None, *RenderVjpFunction.apply(ctx.call, needed, grad_image, *saved[: len(needed)]))

    @staticmethod
    def jvp(ctx: Any, _call: Any, *tangents: torch.Tensor | None) -> Any:
        call = ctx.call
        params = ctx.saved_tensors
        call.requirements.check(i for i, given in enumerate(tangents) if given is not None)
        tangent = RenderJvpFunction.apply(call, *params, *tangents)
        return (tangent, *(None,) * len(call.extra)) if call.extra else tangent


def _with_part(
    found: tuple[dict[str, torch.Tensor], Part] | None, part: Part, out: dict[str, torch.Tensor]
) -> tuple[dict[str, torch.Tensor], Part]:
    """Sums over passes with one more part: of the first pass the core adds up its parts itself."""
    if found is None or part.number == 0:
        return out, part
    return {name: tensor + out[name] for name, tensor in found[0].items()}, part


class RenderJvpFunction(DerivativeFunction):
    """``tangent = RenderJvpFunction.apply(call, *parameters, *tangents)``."""

    @staticmethod
    def forward(call: RenderCall, *tensors: torch.Tensor | None) -> torch.Tensor:
        dtype = call.native.dtype
        count = len(tensors) // 2
        params, tangents = [t for t in tensors[:count] if t is not None], tensors[count:]
        dense = [None if t is None else call.native.reached(t) for t in dense_tangents(params, tangents, dtype)]
        addresses = [0 if t is None else address(t) for t in dense]
        place = call.place
        total = out = torch.empty(call.shape(), dtype=dtype, device=place)
        all_stats = []
        for i, config in enumerate(tracked(call.configs(derivative=True), "derivative", call.progress)):
            if i == 1:
                out = torch.empty_like(out)
            given = {**config, **_on_device(place)}
            all_stats.append(call.native.call("render_jvp", params, given, addresses, address(out)))
            if i:
                total += out
        if call.passes > 1:
            total /= call.passes
        call.finish("jvp", all_stats)
        return total


class RenderVjpFunction(DerivativeFunction):
    """``gradients = RenderVjpFunction.apply(call, needed, adjoint, *parameters)``."""

    @staticmethod
    def forward(call: RenderCall, needed: tuple[bool, ...], adjoint: torch.Tensor, *params: torch.Tensor) -> Any:
        refuse_batches(adjoint)
        return _vjps(call, [needed], [adjoint], params)[0]


def _vjps(
    call: RenderCall,
    needed: Sequence[Sequence[bool]],
    adjoints: Sequence[torch.Tensor],
    params: Sequence[torch.Tensor],
) -> list[tuple[torch.Tensor | None, ...]]:
    """Gradients for each adjoint, of the parameters that it needs, by the same paths.

    The first one needs all that others do.
    """
    call.check_indices()
    # who shares samples out reads the adjoint on the CPU
    place = torch.device("cpu") if call.adaptive_grad else call.place
    adjoints = [a.detach().to(dtype=call.native.dtype, device=place).contiguous() for a in adjoints]
    if call.passes > 1:
        adjoints = [a / call.passes for a in adjoints]
    grads = [gradients_of(call.native, params, each) for each in needed]
    given = [address(a) for a in adjoints], [[0 if g is None else address(g) for g in each] for each in grads]
    all_stats = []
    for config in tracked(call.with_hits(call.configs(derivative=True)), "derivative", call.progress):
        if call.adaptive_grad:
            config |= {"adaptive": True, "sample_offset": call.share.adaptive_offset()}
        config |= {"fixed_sums": torch.are_deterministic_algorithms_enabled(), **_on_device(place)}
        all_stats.append(call.native.call("render_vjp", list(params), config, *given))
    call.finish("vjp", all_stats)
    return [with_parameters(each, params) for each in grads]


def backward_and_grads(
    image: torch.Tensor, adjoint: torch.Tensor, others: Sequence[tuple[Sequence[torch.Tensor], torch.Tensor]]
) -> list[tuple[torch.Tensor | None, ...]]:
    """``torch.autograd.backward(image, adjoint)`` and, of `others`, ``torch.autograd.grad(image, inputs, other)``.

    Where the image is a rendering as it is, of one camera, all of it is by the same paths, which are traced once. The
    gradient is None of an input that the image does not depend on.
    """
    node: Any = image.grad_fn
    adjoints = [adjoint, *(other for _, other in others)]
    apart = len(set(map(id, adjoints))) == len(adjoints)
    rendered = isinstance(node, RenderFunction._backward_cls) and image.output_nr == 0
    if apart and rendered and all((each.shape, each.dtype) == (image.shape, image.dtype) for each in adjoints):
        _prepare_gradients(node, adjoint, others)
    try:
        found = [torch.autograd.grad(image, ins, other, retain_graph=True, allow_unused=True) for ins, other in others]
        torch.autograd.backward(image, adjoint)
    finally:
        if rendered:
            node.ready.clear()
    return list(found)


def _prepare_gradients(
    node: Any, adjoint: torch.Tensor, others: Sequence[tuple[Sequence[torch.Tensor], torch.Tensor]]
) -> None:
    """Lays ready what the rendering's `backward` will be asked for."""
    needed = node.needs_input_grad[1:]
    leaves = [id(getattr(before, "variable", None)) for before, _ in node.next_functions]
    asked, adjoints = [needed], [adjoint]
    for inputs, other in others:
        sought = {id(None), *map(id, inputs)}  # by way of what is no leaf anything may be
        fewer = tuple(n and leaf in sought for n, leaf in zip(needed, leaves, strict=True))
        if any(fewer):
            asked.append(fewer)
            adjoints.append(other)
    if len(adjoints) > 1:
        grads = _vjps(node.call, asked, adjoints, node.saved_tensors[: len(needed)])
        node.ready = {_identity(each): found for each, found in zip(adjoints, grads, strict=True)}


def _identity(tensor: torch.Tensor) -> tuple[int, int]:
    """What another tensor of that time does not have, nor this one after an edit. The engine passes objects on."""
    return id(tensor), tensor._version


def dense_tangents(
    params: Sequence[torch.Tensor], tangents: Sequence[torch.Tensor | None], dtype: torch.dtype
) -> list[torch.Tensor | None]:
    """Tangents as the core reads them: of the shapes of their parameters, contiguous, None where there is none."""
    return [
        None if t is None else t.detach().to(dtype=dtype).expand(p.shape).contiguous()
        for t, p in zip(tangents, params, strict=True)
    ]


def _on_device(place: torch.device) -> dict[str, bool]:
    """What the core's settings say of an image, or its adjoint, that lies there."""
    return {} if place.type == "cpu" else {"on_device": True}


def gradients_of(
    native: NativeScene, params: Sequence[torch.Tensor], needed: Sequence[bool]
) -> list[torch.Tensor | None]:
    """Zeros for the gradients that are needed, where the core can add to them."""
    return [
        zero_gradient(parameter, parameter.device if native.holds(parameter.device) else "cpu") if wanted else None
        for parameter, wanted in zip(params, needed, strict=True)
    ]


def with_parameters(
    grads: Sequence[torch.Tensor | None], params: Sequence[torch.Tensor]
) -> tuple[torch.Tensor | None, ...]:
    """Gradients where their parameters lie."""
    return tuple(g if g is None else g.to(p.device) for g, p in zip(grads, params, strict=True))


def zero_gradient(parameter: torch.Tensor, place: torch.device | str = "cpu") -> torch.Tensor:
    """Zeros like `parameter` there, of a large texture in large pages where the system has them.

    These are asked for before the first touch: page by page that takes longer than clearing them.
    """
    gradient = torch.empty(parameter.shape, dtype=parameter.dtype, device=place)
    if not gradient.is_cpu:
        return gradient.zero_()
    backends.core().use_large_pages(gradient.data_ptr(), gradient.nbytes)
    return gradient.zero_()


class _Reattach(Function):
    @staticmethod
    def forward(value: torch.Tensor, derivative: torch.Tensor) -> torch.Tensor:
        return value.clone()

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> Any:
        return None, grad

    @staticmethod
    def jvp(ctx: Any, value_t: torch.Tensor, derivative_t: torch.Tensor) -> torch.Tensor:
        return derivative_t.clone()


def reattach(value: torch.Tensor, derivative: torch.Tensor) -> torch.Tensor:
    """`value` with the derivative of `derivative`: numbers of the one, gradients of the other, of equal shape.

    For example a denoised or a converged image with the gradient of a noisy one.
    """
    for name, tensor in (("value", value), ("derivative", derivative)):
        if not isinstance(tensor, torch.Tensor):
            raise TypeError(f"reattach: {name}: expected a tensor, got {type(tensor).__name__}")
    if value.shape != derivative.shape:
        raise ValueError(
            f"reattach: value has shape {tuple(value.shape)}, but derivative has {tuple(derivative.shape)}"
        )
    return _Reattach.apply(value.detach().to(derivative.dtype), derivative)
