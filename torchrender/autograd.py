"""The boundary to autograd: one `torch.autograd.Function` with forward, reverse mode and forward mode.

The derivative is estimated from samples of its own, keyed by `seed_grad`, so what is saved are the parameters, whose
version counters let torch notice edits in between. Where image and derivative share their samples (``correlated=True``)
the hits of their rays are kept besides, and the backward pass traces nothing.
"""

from __future__ import annotations

import warnings
import weakref
from dataclasses import dataclass
from typing import Any

import torch
from torch.autograd import Function

from . import backends
from .errors import NotDifferentiableError, RenderError
from .scene.derivatives import Wanted, depth_outside
from .scene.film import Film
from .scene.native import NativeScene

MASK = (1 << 64) - 1
BATCHED = (
    "vmap does not reach into a rendering: loop over the inputs (jacrev does so with chunk_size=1, "
    "torch.autograd.functional.jacobian with vectorize=False, and in place of jacfwd a loop over jvp); "
    "several cameras are one call, sensor=[...]"
)
STORED_HITS_LIMIT = 1 << 30
"""Bytes that the hits kept for backward passes may take, of all graphs together; rays beyond are traced again.

With 0 none are kept. A rendering takes the value that this has when it begins.
"""
SECOND = "a rendering has first derivatives only: differentiating its gradient again is not possible"


def mix(seed: int, stream: int) -> int:
    """A 64-bit hash of a seed and a stream number (splitmix64's finaliser)."""
    x = (seed + 0x9E3779B97F4A7C15 * (stream + 1)) & MASK
    x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & MASK
    return x ^ (x >> 31)


@dataclass
class RenderCall:
    """Everything of one rendering of one sensor that is no tensor."""

    native: NativeScene
    config: dict[str, Any]  # what primal and derivative rendering share
    size: tuple[int, ...]  # (H, W), or (N,) with a list of pixels
    spp: int
    seed: int
    spp_grad: int
    seed_grad: int
    passes: int
    nan: str
    pixels: Any  # the array to whose memory `config` points
    alpha: bool
    variance: bool
    statistics: dict[str, Any]
    wanted: Wanted  # what is said about derivatives that are asked for
    film: Film
    features: dict[int, torch.Tensor]  # those of the output of this name, by the number of their shape
    adaptive_grad: bool = False
    keep_hits: bool = False  # the derivative has the image's samples, and may be asked for
    hits: Any = None  # weak reference to what is kept, from the image's rendering on
    kept: torch.Tensor | None = None  # keeps it alive until autograd does

    def configs(self, derivative: bool) -> list[dict[str, Any]]:
        """The core's settings of each pass."""
        seed, spp = (self.seed_grad, self.spp_grad) if derivative else (self.seed, self.spp)
        threads = torch.get_num_threads()
        return [
            {**self.config, "spp": spp, "seed": seed if i == 0 else mix(seed, i), "threads": threads}
            for i in range(self.passes)
        ]

    def check_indices(self) -> None:
        """Faces that were edited since the image was rendered, which torch does not notice: they have no gradient."""
        if self.native.index_key != self.native.layout.index_key():
            raise RuntimeError(
                "the faces of a mesh have been modified by an inplace operation between rendering and backward()"
            )

    def finish(self, kind: str, all_stats: list[dict[str, Any]]) -> None:
        """Keep the statistics; speak once of samples that were not finite."""
        total = dict(all_stats[0])
        for stats in all_stats[1:]:
            for key, value in stats.items():
                if isinstance(value, (int, float)) and key != "lanes":
                    total[key] += value
        self.statistics[kind] = total
        count = int(total.get("nonfinite", 0))
        if count:
            where = next((s["nonfinite_where"] for s in all_stats if s.get("nonfinite")), "")
            text = f"{count} samples were not finite" + (f", first at {where}" if where else "")
            if self.nan == "raise":
                raise RenderError(text)
            warnings.warn(text + "; they were dropped", RuntimeWarning, stacklevel=depth_outside())

    def store_hits(self) -> torch.Tensor:
        """Begin to keep hits; they live as long as the memory of the tensor that comes back."""
        store = backends.core().HitStore(int(STORED_HITS_LIMIT))
        self.hits = weakref.ref(store)
        return torch.frombuffer(store, dtype=torch.uint8)

    def with_hits(self, configs: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """The passes' settings with where their hits are kept, if that is still there."""
        store = self.hits() if self.hits is not None else None
        return configs if store is None else [{**c, "hits": (store, i)} for i, c in enumerate(configs)]

    def shape(self) -> tuple[int, ...]:
        return (*self.size, self.native.channels)


def _passes(configs: list[dict[str, Any]]) -> Any:
    if len(configs) < 2:
        return configs
    from .progress import progress

    return progress(configs, desc="passes", leave=False, delay=1.0)


class RenderFunction(Function):
    """``image[, alpha][, variance] = RenderFunction.apply(call, *parameters)``."""

    @staticmethod
    def forward(call: RenderCall, *params: torch.Tensor) -> Any:
        real = {"dtype": call.native.dtype, "device": "cpu"}
        shapes = {"image": call.shape()}
        if call.alpha:
            shapes["alpha"] = call.size
        if call.variance:
            shapes["variance"] = call.shape()
        total = {name: torch.empty(shape, **real) for name, shape in shapes.items()}
        all_stats = []
        out = total
        call.kept = call.store_hits() if call.keep_hits else None
        for i, config in enumerate(_passes(call.with_hits(call.configs(derivative=False)))):
            if i == 1:
                out = {name: torch.empty_like(tensor) for name, tensor in total.items()}
            addresses = {name: tensor.data_ptr() for name, tensor in out.items()}
            all_stats.append(call.native.call("render", list(params), config, addresses))
            if i:
                for name, tensor in total.items():
                    tensor += out[name]
        if call.passes > 1:
            for name, tensor in total.items():
                tensor /= call.passes**2 if name == "variance" else call.passes
        call.finish("render", all_stats)
        return tuple(total.values()) if len(total) > 1 else total["image"]

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        call, *params = inputs
        ctx.call = call
        # Hits are freed by whatever frees the saved tensors. (With torch.func this comes once for every level, of which
        # one differentiates.)
        kept = ()
        if call.kept is not None and any(ctx.needs_input_grad):
            kept, call.kept = (call.kept,), None
        ctx.save_for_backward(*params, *kept)
        ctx.save_for_forward(*params)
        ctx.set_materialize_grads(False)
        if isinstance(output, tuple):
            # All of the derivative of coverage is the term of moving silhouettes, which is missing; that of variance
            # is not implemented.
            ctx.mark_non_differentiable(*output[1:])

    @staticmethod
    def backward(ctx: Any, grad_image: torch.Tensor | None, *_: Any) -> Any:
        needed = ctx.needs_input_grad[1:]
        saved = ctx.saved_tensors  # of which the last may be what keeps the hits alive
        if grad_image is None or not any(needed):
            return (None,) * (1 + len(needed))
        return (None, *RenderVjpFunction.apply(ctx.call, needed, grad_image, *saved[: len(needed)]))

    @staticmethod
    def jvp(ctx: Any, _call: Any, *tangents: torch.Tensor | None) -> Any:
        call = ctx.call
        params = ctx.saved_tensors
        call.wanted.check(i for i, given in enumerate(tangents) if given is not None)
        tangent = RenderJvpFunction.apply(call, *params, *tangents)
        return (tangent, *(None,) * (call.alpha + call.variance)) if call.alpha or call.variance else tangent

    @staticmethod
    def vmap(info: Any, in_dims: Any, *_: Any) -> Any:
        raise NotDifferentiableError(BATCHED)


class _Derivative(Function):
    """A derivative as a function of its own: `torch.func` unwraps its tensors, and a second one is refused in words."""

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, *_: Any) -> Any:
        raise NotDifferentiableError(SECOND)

    @staticmethod
    def jvp(ctx: Any, *tangents: Any) -> Any:
        raise NotDifferentiableError(SECOND)

    @staticmethod
    def vmap(info: Any, in_dims: Any, *_: Any) -> Any:
        raise NotDifferentiableError(BATCHED)


class RenderJvpFunction(_Derivative):
    """``tangent = RenderJvpFunction.apply(call, *parameters, *tangents)``."""

    @staticmethod
    def forward(call: RenderCall, *tensors: torch.Tensor | None) -> torch.Tensor:
        dtype = call.native.dtype
        count = len(tensors) // 2
        params, tangents = list(tensors[:count]), tensors[count:]
        dense = [
            None if t is None else t.detach().to(dtype=dtype).expand(p.shape).contiguous()
            for t, p in zip(tangents, params, strict=True)
        ]
        addresses = [0 if t is None else t.data_ptr() for t in dense]
        total = out = torch.empty(call.shape(), dtype=dtype, device="cpu")
        all_stats = []
        for i, config in enumerate(_passes(call.configs(derivative=True))):
            if i == 1:
                out = torch.empty_like(out)
            all_stats.append(call.native.call("render_jvp", params, config, addresses, out.data_ptr()))
            if i:
                total += out
        if call.passes > 1:
            total /= call.passes
        call.finish("jvp", all_stats)
        return total


class RenderVjpFunction(_Derivative):
    """``gradients = RenderVjpFunction.apply(call, needed, adjoint, *parameters)``."""

    @staticmethod
    def forward(call: RenderCall, needed: tuple[bool, ...], adjoint: torch.Tensor, *params: torch.Tensor) -> Any:
        refuse_batches(adjoint)
        call.check_indices()
        adjoint = adjoint.detach().to(dtype=call.native.dtype).contiguous()
        if call.passes > 1:
            adjoint = adjoint / call.passes
        grads = [zero_gradient(p) if n else None for p, n in zip(params, needed, strict=True)]
        addresses = [0 if g is None else g.data_ptr() for g in grads]
        all_stats = []
        for config in _passes(call.with_hits(call.configs(derivative=True))):
            config["adaptive"] = call.adaptive_grad
            all_stats.append(call.native.call("render_vjp", list(params), config, adjoint.data_ptr(), addresses))
        call.finish("vjp", all_stats)
        return tuple(grads)


def zero_gradient(parameter: torch.Tensor) -> torch.Tensor:
    """Zeros like `parameter`. Of a large texture they lie in large pages, where the system has them, before the first
    touch: page by page that takes longer than clearing them.
    """
    gradient = torch.empty_like(parameter)
    backends.core().use_large_pages(gradient.data_ptr(), gradient.nbytes)
    return gradient.zero_()


def refuse_batches(tensor: Any) -> None:
    """Words for what torch itself would say less clearly: random seeds inside of `vmap`, and ``is_grads_batched`` and
    ``vectorize=True``, which use a vmap that asks no `Function` whether it has a rule.
    """
    for name in ("is_batchedtensor", "is_legacy_batchedtensor"):
        is_batched = getattr(torch._C._functorch, name, None)
        if is_batched is not None and isinstance(tensor, torch.Tensor) and is_batched(tensor):
            raise NotDifferentiableError(BATCHED)


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
