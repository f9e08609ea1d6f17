"""Outputs besides radiance: depth, normals, albedo, identifiers and so on of the first surface that the camera sees.

They are averages over the camera's samples of a pixel, the same samples that radiance is estimated from, weighted by
the reconstruction filter; those that hit nothing are left out. Surfaces of every material count, `null` included;
with an integrator's `hide_emitters` shapes that emit do not. Only primary visibility matters: no light is involved.

``dp_du`` and ``dp_dv`` are the derivatives of the position by the texture coordinates that ``uv`` shows: constant on a
triangle, zero where its coordinates do not vary. ``barycentric`` repeats ``uv`` on curved shapes. ``roughness`` is the
number that the material's own parameter ``alpha`` or ``roughness`` has there; without one it is 1 on diffuse surfaces
and 0 on smooth ones. ``specular_reflectance`` is the parameter of that name, 0 without one. ``material_id`` is a number
that surfaces of one BSDF object share. ``duv_dx`` and ``duv_dy`` are how fast uv changes over the film, per pixel to
the right and down, at a pixel's centre: see `torchrender.footprints`. Names that begin with ``vertex_`` or ``face_``
are colours of meshes, 0 on shapes that have none of that name. ``features`` are those that `render` is given.

``variance`` is that of the image's values, estimated from the samples x of weights w that a value I = sum(w x) / sum(w)
is made of: sum(w^2 (x - I)^2) / sum(w)^2 * n / (n - 1) with n = sum(w)^2 / sum(w^2), which for the box filter is the
sample variance over the number of samples. It is infinite for a single sample; of several passes it is that of their
average. Filters that reach over several pixels make it too large at edges (about a sixth, where there are many): each
pixel has its fixed number of samples, which varies less than samples drawn from all of them would. With the samplers
``"stratified"`` and ``"sobol"`` it is an upper estimate: about what independent samples would have, since the spread of
samples does not show how well they complement each other. Their actual variance is seen in images of several seeds.
``second_moment`` is the mean of squared samples, sum(w x^2) / sum(w).
"""

from __future__ import annotations

import functools
from collections import namedtuple
from collections.abc import Sequence
from typing import Any

import torch

from .autograd import dense_tangents, gradients_of, with_parameters
from .devices import address
from .errors import describe, nearest
from .first_hit_call import (
    ATTRIBUTES,
    CHANNELS,
    FEATURES,
    FOOTPRINTS,
    IDENTIFIERS,
    MAX_ATTRIBUTES,
    OUTPUTS,
    FirstHitCall,
)
from .functions import DerivativeFunction, UnbatchedFunction, refuse_batches
from .render_call import RenderCall
from .scene.host_memory import on_host
from .scene.packing import Layout
from .scene.scene import Scene


@functools.cache
def outputs_type(names: tuple[str, ...]) -> Any:
    """The named tuple of these outputs. Made once, which takes longer than a small rendering; can be pickled."""
    made = namedtuple("Outputs", names)
    made.__reduce__ = lambda self: (collect, (self._fields, tuple(self)))
    return made


def collect(names: tuple[str, ...], values: Sequence[torch.Tensor]) -> Any:
    """A named tuple of outputs."""
    return outputs_type(names)(*values)


def check_names(outputs: Any) -> tuple[str, ...]:
    """`outputs` of `render` as a tuple of known names."""
    if isinstance(outputs, str) or not isinstance(outputs, Sequence) or not outputs:
        raise TypeError(f"render: outputs: expected a sequence of names such as ('rgb', 'alpha'), got {outputs!r}")
    for name in outputs:
        if not isinstance(name, str):
            raise TypeError(f"render: outputs: expected names, got {describe(name)}")
        if name not in OUTPUTS and name != FEATURES and not name.startswith(ATTRIBUTES):
            raise ValueError(f"render: outputs: unknown name {name!r}; {nearest(str(name), [*OUTPUTS, FEATURES])}")
    if len(set(outputs)) != len(outputs):
        raise ValueError(f"render: outputs: a name comes twice in {tuple(outputs)!r}")
    if sum(name.startswith(ATTRIBUTES) for name in outputs) > MAX_ATTRIBUTES:
        raise ValueError(f"render: outputs: at most {MAX_ATTRIBUTES} colours of meshes at once, got {tuple(outputs)!r}")
    return tuple(outputs)


def attributes_of(layout: Layout, names: Sequence[str]) -> dict[str, int]:
    """The numbers of those of `names` that are colours of meshes; ValueError if no mesh has one of them."""
    known = {name for row in layout.objects["attribute"] for name in [row[2].rpartition(".")[2]]}
    found = {}
    for name in names:
        if name in OUTPUTS or name in CHANNELS or name == FEATURES:
            continue
        if name not in known:
            raise ValueError(f"render: outputs: no mesh has colours {name!r}; {nearest(name, [*known, *OUTPUTS])}")
        found[name] = layout.attribute_names[name]
    return found


class FirstHitFunction(UnbatchedFunction):
    """``outputs = FirstHitFunction.apply(call, *parameters)``, a tuple in the order of ``call.names``."""

    @staticmethod
    def forward(call: FirstHitCall, *params: torch.Tensor) -> Any:
        out = {name: call.empty(name) for name in call.names}
        stats = call.render.native.call("render_aov", list(params), call.config(False), call.addresses(out))
        call.render.finish("outputs", [stats])
        return tuple(out.values())

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        call, *params = inputs
        ctx.call = call
        ctx.save_for_backward(*params)
        ctx.save_for_forward(*params)
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(*(t for n, t in zip(call.names, output, strict=True) if n in IDENTIFIERS))

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor | None) -> Any:
        params = ctx.saved_tensors
        needed = ctx.needs_input_grad[1:]
        if not any(needed) or all(g is None for g in grads):
            return (None,) * (1 + len(params))
        return (None, *FirstHitVjpFunction.apply(ctx.call, needed, *grads, *params))

    @staticmethod
    def jvp(ctx: Any, _call: Any, *tangents: torch.Tensor | None) -> Any:
        ctx.call.render.requirements.check(i for i, given in enumerate(tangents) if given is not None)
        found = FirstHitJvpFunction.apply(ctx.call, *ctx.saved_tensors, *tangents)
        real = iter(found if isinstance(found, tuple) else (found,))
        return tuple(None if name in IDENTIFIERS else next(real) for name in ctx.call.names)


class FirstHitJvpFunction(DerivativeFunction):
    """``tangents = FirstHitJvpFunction.apply(call, *parameters, *tangents)``, of all outputs but identifiers."""

    @staticmethod
    def forward(call: FirstHitCall, *tensors: torch.Tensor | None) -> Any:
        count = len(tensors) // 2
        params, tangents = [t for t in tensors[:count] if t is not None], tensors[count:]
        dense = dense_tangents(params, tangents, call.render.native.dtype)
        out = {name: call.empty(name) for name in call.names if name not in IDENTIFIERS}
        if out:
            dense = [None if t is None else call.render.native.reached(t) for t in dense]
            given = [0 if t is None else address(t) for t in dense]
            stats = call.render.native.call("aov_jvp", params, call.config(True), given, call.addresses(out))
            call.render.finish("outputs_jvp", [stats])
        return tuple(out.values())


class FirstHitVjpFunction(DerivativeFunction):
    """``gradients = FirstHitVjpFunction.apply(call, needed, *adjoints, *parameters)``."""

    @staticmethod
    def forward(call: FirstHitCall, needed: tuple[bool, ...], *tensors: torch.Tensor | None) -> Any:
        adjoints = tensors[: len(call.names)]
        params = [t for t in tensors[len(call.names) :] if t is not None]
        for adjoint in adjoints:
            if adjoint is not None:
                refuse_batches(adjoint)
        call.render.check_indices()
        dtype = call.render.native.dtype
        dense = {
            name: g.detach().to(dtype=dtype).contiguous()
            for name, g in zip(call.names, adjoints, strict=True)
            if g is not None and name not in IDENTIFIERS
        }
        grads = gradients_of(call.render.native, params, needed)
        if dense:
            addresses = call.addresses(dense)
            to = [0 if g is None else address(g) for g in grads]
            config = call.config(True) | {"fixed_sums": torch.are_deterministic_algorithms_enabled()}
            stats = call.render.native.call("aov_vjp", params, config, addresses, to)
            call.render.finish("outputs_vjp", [stats])
        return with_parameters(grads, params)


def first_hits(
    scene: Scene,
    call: RenderCall,
    names: Sequence[str],
    params: list[torch.Tensor],
    zero_at_misses: bool = False,
) -> dict[str, torch.Tensor]:
    """Outputs by name, each (H, W) or (H, W, channels), or (N,) and (N, channels) for a list of pixels."""
    averaged = tuple(n for n in dict.fromkeys(names) if n not in FOOTPRINTS and n != FEATURES)
    found: dict[str, torch.Tensor] = {}
    if averaged:
        first = FirstHitCall(call, averaged, zero_at_misses, attributes_of(call.layout, averaged))
        values = dict(zip(averaged, FirstHitFunction.apply(first, *params), strict=True))
        real = [name for name in averaged if name not in IDENTIFIERS]  # which belong to no sample
        if real:
            totals = call.share.averaged(call, params, tuple(values[name] for name in real), first)
            values.update(zip(real, totals, strict=True))
        found.update(values)
        moved = first.core_names().values() if call.outlines and call.may_move_outlines(params) else ()
        if moved:
            from .visibility.boundary import outline_terms  # when it is needed

            terms = outline_terms(call, params, first)
            if terms is not None:
                terms = call.share.summed(terms)
                found.update({name: found[name] + term for name, term in zip(moved, terms, strict=True)})
    if all(name in averaged for name in names):
        return found
    params = [on_host(t) for t in params]  # what follows is computed by PyTorch, on the CPU
    if any(n in FOOTPRINTS for n in names):
        from .footprints import footprints

        centres = footprints(scene, call, names, params)
        values = call.share.same(call.share.attached(tuple(centres.values()), params))
        found.update(zip(centres, values, strict=True))
    if FEATURES in names:
        from .features import features

        found[FEATURES] = features(scene, call, params)
    return found
