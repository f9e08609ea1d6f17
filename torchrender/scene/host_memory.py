"""Tensors where the core can read them, in the host's memory: those of scenes that lie on a card, or wherever else.

Copies are kept as long as nothing has changed, so that what the core has made of them is not made again either. A copy
is never written to: what has changed gets another one, since an earlier image may want the old one for its derivative.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import torch
from torch import nn
from torch.utils.weak import WeakIdKeyDictionary

from ..functions import UnbatchedFunction, functorch
from .values import has_derivative

F = TypeVar("F", bound=Callable[..., Any])


class _Copied(NamedTuple):
    alias: torch.Tensor  # of the original: it holds the storage, so that an equal address means the same memory
    version: int
    copy: torch.Tensor


_copied = WeakIdKeyDictionary()  # by the original


def on_host(tensor: torch.Tensor) -> torch.Tensor:
    """`tensor` on the CPU, where a derivative is recorded as a function of it."""
    if tensor.is_cpu:
        return tensor
    if has_derivative(tensor) or functorch.is_functorch_wrapped_tensor(tensor):
        return _OnHost.apply(tensor)
    return numbers_on_host(tensor)


def numbers_on_host(tensor: torch.Tensor) -> torch.Tensor:
    """The numbers of `tensor` on the CPU, in the same memory as the last time unless the tensor has changed."""
    if tensor.is_cpu:
        return tensor.detach()
    version = -1 if tensor.is_inference() else tensor._version
    known = _copied.get(tensor)
    if known is not None and known.version == version >= 0 and _same_memory(known.alias, tensor):
        return known.copy
    with torch.inference_mode(False), torch._C._DisableFuncTorch():  # not what `torch.func` would follow
        found = tensor.detach().to("cpu").contiguous()
        if version >= 0:
            _copied[tensor] = _Copied(tensor.detach(), version, found)
    return found


def _same_memory(a: torch.Tensor, b: torch.Tensor) -> bool:
    return a.data_ptr() == b.data_ptr() and a.shape == b.shape and a.stride() == b.stride() and a.dtype == b.dtype


class _OnHost(UnbatchedFunction):
    @staticmethod
    def forward(tensor: torch.Tensor) -> torch.Tensor:
        return numbers_on_host(tensor).detach()

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[torch.Tensor], output: torch.Tensor) -> None:
        ctx.place = inputs[0].device

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> torch.Tensor:
        return grad.to(ctx.place)

    @staticmethod
    def jvp(ctx: Any, tangent: torch.Tensor) -> torch.Tensor:
        return tangent.to("cpu")


def move(module: nn.Module, place: torch.device) -> None:
    """Bring a module's tensors there, if they lie elsewhere."""
    if any(tensor.device != place for tensor in (*module.parameters(), *module.buffers())):
        module.to(place)


def results_at_the_scene(function: F) -> F:
    """Decorator of a function of a scene that computes on the host: the tensors that it returns go to the scene."""

    @functools.wraps(function)
    def call(scene: Any, *arguments: Any, **named: Any) -> Any:
        found = function(scene, *arguments, **named)
        place = scene.device
        if place.type == "cpu":
            return found
        return type(found)(*(t.to(place) for t in found)) if isinstance(found, tuple) else found.to(place)

    return cast("F", call)
