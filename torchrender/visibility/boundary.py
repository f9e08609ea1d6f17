"""The derivative of one view's outlines, in both modes; see the package's docstring."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import torch

from ..functions import DerivativeFunction, UnbatchedFunction, refuse_batches
from ..render_call import RenderCall
from ..scene.gather import has_derivative
from ..scene.scene import Scene
from .anchors import AnchorTracer
from .choice import Choice
from .film_places import SENSORS
from .film_sums import FilmPlaces
from .lights import outlines_before_lights, share_in_view
from .sampling import Boundary, BoundaryCall, Samples, placing_slots
from .seen import seen_outlines
from .vertices import outlines_before_surfaces

MOVING_LIGHTS = ("point", "spot", "projector", "directional")


class BoundaryFunction(UnbatchedFunction):
    """``image[, alpha] = BoundaryFunction.apply(boundary, *parameters)``: zeros, with the term as their derivative."""

    @staticmethod
    def forward(boundary: BoundaryCall, *params: torch.Tensor) -> Any:
        call = boundary.call
        image = torch.zeros(call.shape(), dtype=call.native.dtype)
        return (image, torch.zeros(call.size, dtype=call.native.dtype)) if call.alpha else image

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        boundary, *params = inputs
        ctx.boundary = boundary
        ctx.save_for_backward(*params)
        ctx.save_for_forward(*params)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor | None) -> Any:
        needed = ctx.needs_input_grad[1:]
        if all(a is None for a in adjoints) or not any(needed):
            return (None,) * (1 + len(needed))
        image, alpha = (*adjoints, None)[:2]
        return (None, *_Vjp.apply(ctx.boundary, needed, image, alpha, *ctx.saved_tensors))

    @staticmethod
    def jvp(ctx: Any, _boundary: Any, *tangents: torch.Tensor | None) -> Any:
        found = _Jvp.apply(ctx.boundary, *ctx.saved_tensors, *tangents)
        return found if ctx.boundary.call.alpha else found[0]


@contextlib.contextmanager
def few_threads() -> Iterator[int]:
    """One thread for PyTorch's own operations; gives the number for the core.

    They are too small here for more: beside other programs threads that wait for each other take many times as long.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield threads
    finally:
        torch.set_num_threads(threads)


class _Vjp(DerivativeFunction):
    @staticmethod
    def forward(
        boundary: BoundaryCall,
        needed: tuple[bool, ...],
        image: torch.Tensor | None,
        alpha: torch.Tensor | None,
        *params: torch.Tensor,
    ) -> Any:
        call = boundary.call
        for adjoint in (image, alpha):
            refuse_batches(adjoint)
        call.check_indices()
        film = FilmPlaces(call)
        adjoint = film.empty()
        if image is not None:
            film.add(adjoint, image.detach().reshape(-1, call.native.channels), slice(None, -1))
        if alpha is not None:
            film.add(adjoint, alpha.detach().reshape(-1, 1), slice(-1, None))
        adjoint /= film.normal
        leaves = [p.detach().requires_grad_(n) for p, n in zip(params, needed, strict=True)]
        wanted = [leaf for leaf, n in zip(leaves, needed, strict=True) if n]
        grads = [torch.zeros_like(leaf) for leaf in wanted]
        with few_threads() as threads, torch.enable_grad():
            for jump, rate, place in samples(boundary, leaves, film, threads):
                if not rate.requires_grad:
                    continue
                weight = (film.collect(adjoint, place) * jump).sum(1)
                found = torch.autograd.grad((rate * weight).sum(), wanted, allow_unused=True)
                for total, part in zip(grads, found, strict=True):
                    if part is not None:
                        total += part
        left = iter(grads)
        return tuple(next(left) if n else None for n in needed)


class _Jvp(DerivativeFunction):
    @staticmethod
    def forward(boundary: BoundaryCall, *tensors: torch.Tensor | None) -> Any:
        count = len(tensors) // 2
        params, tangents = tensors[:count], tensors[count:]
        film = FilmPlaces(boundary.call)
        total = film.empty()
        given = {i: t.detach() for i, t in enumerate(tangents) if t is not None}
        leaves = [p.detach().requires_grad_(i in given) for i, p in enumerate(params) if p is not None]
        wanted = [leaves[i] for i in given]
        with few_threads() as threads, torch.enable_grad():
            for jump, rate, place in samples(boundary, leaves, film, threads):
                if not rate.requires_grad:
                    continue
                # a product with tangents as the derivative of products with adjoints
                dummy = torch.zeros_like(rate, requires_grad=True)
                pulled = torch.autograd.grad(rate, wanted, dummy, create_graph=True, allow_unused=True)
                products = [
                    (g * t.to(g.dtype)).sum() for g, t in zip(pulled, given.values(), strict=True) if g is not None
                ]
                product = sum(products) if products else None
                speed = torch.autograd.grad(product, dummy)[0] if isinstance(product, torch.Tensor) else None
                if speed is not None:
                    film.splat(total, place, jump * speed[:, None])
        total /= film.normal
        values = film.results(total)
        call = boundary.call
        image = values[:, :-1].reshape(call.shape()).to(call.native.dtype)
        return image, values[:, -1].reshape(call.size).to(call.native.dtype)


def samples(boundary: BoundaryCall, params: Sequence[torch.Tensor], film: FilmPlaces, threads: int) -> Samples:
    """In chunks: jumps of colour and alpha with all weights (N, C + 1), rates (N,), attached, and film places (N, 2).

    They are the same in both modes, so that these agree to rounding.
    """
    scene = Boundary(boundary, params, film, threads)
    if boundary.spp[0] > 0:
        yield from seen_outlines(scene)
    max_depth = boundary.call.config["max_depth"]
    if boundary.spp[1] > 0 and not 0 <= max_depth < 2:
        choice = Choice(scene)
        if len(choice):
            tracer = AnchorTracer(scene)
            in_view = share_in_view(scene, choice, tracer)
            if bool(boundary.moves.any()):
                yield from outlines_before_surfaces(scene, choice, tracer, in_view)
            yield from outlines_before_lights(scene, choice, tracer, in_view)


def boundary_of(
    scene: Scene, call: RenderCall, spp: tuple[int, int] | None, tensors: Sequence[torch.Tensor]
) -> BoundaryCall | None:
    """The boundary term of a rendering with these tensors; None if nothing that has one may be differentiated."""
    kind, slots = placing_slots(call.layout, "sensor")[call.config["sensor"]]
    if kind not in SENSORS or spp == (0, 0):
        return None

    def asked(slots: Sequence[int]) -> bool:
        return any(has_derivative(tensors[n]) for n in slots)

    camera = asked(slots)
    moves = [camera or asked(slots) for _, slots in placing_slots(call.layout, "shape")]
    lights = any(asked(slots) for k, slots in placing_slots(call.layout, "emitter") if k in MOVING_LIGHTS)
    if not any(moves) and not lights:
        return None
    usual = max(1, call.spp_grad // 4), max(1, call.spp_grad // 8)  # as efficient as twice as many of the second
    return BoundaryCall(call, scene, spp or usual, torch.tensor(moves, dtype=torch.bool), spp is None)
