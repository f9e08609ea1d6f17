"""The derivative of a spectral image by the responses of its film's channels.

Images are linear in them, the densities p of wavelengths being given: with W_j(lambda) a channel is the mean over
samples of W_j(lambda_c) L_c / (3 p(lambda_c)), summed over a path's wavelengths. The core has the transposed of that
(csrc/cpu/render_response.h), of the derivative's own samples; along a tangent the derivative is an image of these
samples with the tangent in place of W.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from .functions import DerivativeFunction, UnbatchedFunction, refuse_batches
from .progress import tracked
from .render_call import RenderCall
from .scene.context import SAMPLES


def with_responses(call: RenderCall, tensors: Sequence[torch.Tensor], weights: torch.Tensor, result: Any) -> Any:
    """`result`, an image or a tuple that begins with it, with the derivative by the film's weights (471, 3)."""
    term = ResponseFunction.apply(call, weights, *tensors)
    return (result[0] + term, *result[1:]) if isinstance(result, tuple) else result + term


class ResponseFunction(UnbatchedFunction):
    """``zeros = ResponseFunction.apply(call, weights, *parameters)``, which have the derivative by the weights."""

    @staticmethod
    def forward(call: RenderCall, weights: torch.Tensor, *params: torch.Tensor) -> torch.Tensor:
        return torch.zeros(call.shape(), dtype=call.native.dtype)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        ctx.call, weights, *params = inputs
        ctx.dtype = weights.dtype
        ctx.save_for_backward(*params)
        ctx.save_for_forward(*params)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, adjoint: torch.Tensor | None) -> Any:
        rest = (None,) * len(ctx.saved_tensors)
        if adjoint is None or not ctx.needs_input_grad[1]:
            return None, None, *rest
        return None, ResponseVjp.apply(ctx.call, adjoint, *ctx.saved_tensors).to(ctx.dtype), *rest

    @staticmethod
    def jvp(ctx: Any, _call: Any, tangent: torch.Tensor | None, *_: Any) -> torch.Tensor:
        if tangent is None:
            return torch.zeros(ctx.call.shape(), dtype=ctx.call.native.dtype)
        return ResponseJvp.apply(ctx.call, tangent, *ctx.saved_tensors)


class ResponseVjp(DerivativeFunction):
    """``gradient = ResponseVjp.apply(call, adjoint, *parameters)``: (471, 3), float64."""

    @staticmethod
    def forward(call: RenderCall, adjoint: torch.Tensor, *params: torch.Tensor) -> torch.Tensor:
        refuse_batches(adjoint)
        call.check_indices()
        adjoint = (adjoint.detach() / call.passes).to(call.native.dtype).contiguous()
        gradient = torch.zeros(SAMPLES, 3, dtype=torch.float64)
        statistics = []
        for config in tracked(call.configs(derivative=True), "derivative", call.progress):
            addresses = adjoint.data_ptr(), gradient.data_ptr()
            statistics.append(call.native.call("response_vjp", list(params), config, *addresses))
        call.finish("responses", statistics)
        return gradient


class ResponseJvp(DerivativeFunction):
    """``change = ResponseJvp.apply(call, tangent, *parameters)``: of the image, for a tangent (471, 3) of weights."""

    @staticmethod
    def forward(call: RenderCall, tangent: torch.Tensor, *params: torch.Tensor) -> torch.Tensor:
        refuse_batches(tangent)
        tangent = tangent.detach().to(call.native.dtype).contiguous()
        total = torch.zeros(call.shape(), dtype=call.native.dtype)
        statistics = []
        for config in tracked(call.configs(derivative=True), "derivative", call.progress):
            positions, intervals, _ = config["spectral"]
            config["spectral"] = positions, intervals, tangent.data_ptr()
            out = torch.empty_like(total)
            statistics.append(call.native.call("render", list(params), config, {"image": out.data_ptr()}))
            total += out
        call.finish("responses", statistics)
        return total / call.passes
