"""A device of PyTorch's that behaves as a card's tensors do, and is the host: for what tensors elsewhere go through.

PyTorch lets Python be the backend of its device type for private use (``pretended`` here). A tensor of it holds one of
the host, which nothing but operators of PyTorch reaches, and the emulated device: its address is one that nobody else
can follow (EmulatedTensor in csrc/device/emulated.h). Autograd, modules and optimisers take it for one of any other
accelerator.
"""

from __future__ import annotations

from typing import Any

import torch
from torch.utils import _pytree as pytree

try:
    from torch.utils import backend_registration

    register = backend_registration._setup_privateuseone_for_python_backend
except (AttributeError, ImportError):  # older ones
    register = None

from torchrender import devices

NAME = "pretended"
transfers: list[tuple[str, tuple[int, ...]]] = []
"""What was copied by PyTorch, to the card or to the CPU, and its shape."""
OUT_OF_REACH = 1 << 62


class CardTensor(torch.Tensor):
    host: torch.Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, host: torch.Tensor) -> CardTensor:
        like = {"strides": host.stride(), "dtype": host.dtype, "device": f"{NAME}:0"}
        return torch.Tensor._make_wrapper_subclass(cls, host.shape, **like)

    def __init__(self, host: torch.Tensor) -> None:
        self.host = host

    @classmethod
    def __torch_dispatch__(cls, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(function, args, kwargs or {})


def _run(function: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """An operator, by the host's; its results are on the card if it is told so, else if anything it gets is."""
    tensors = [value for value in pytree.tree_leaves((args, kwargs)) if isinstance(value, torch.Tensor)]
    given = [tensor for tensor in tensors if isinstance(tensor, CardTensor)]
    host = [tensor for tensor in tensors if not isinstance(tensor, CardTensor) and tensor.ndim > 0]
    if given and host and not any(word in str(function) for word in ("copy", "index")):
        raise RuntimeError(f"{function}: expected all tensors to be on the same device")
    device = kwargs.get("device")
    on_card = bool(given) if device is None else torch.device(device).type == NAME
    if given and device is not None and not on_card:
        transfers.append(("cpu", tuple(given[0].shape)))
    if function is torch.ops.aten.copy_.default and len(given) == 1:
        transfers.append((NAME if given[0] is args[0] else "cpu", tuple(given[0].shape)))
    args, plain = pytree.tree_map_only(CardTensor, lambda tensor: tensor.host, (args, dict(kwargs)))
    if device is not None:
        plain["device"] = "cpu"
    found = function(*args, **plain)
    if function._schema.is_mutable and given:  # in place
        return given[0]
    if function is torch.ops.aten._to_copy.default and found is args[0]:
        found = found.clone()
    return pytree.tree_map_only(torch.Tensor, CardTensor, found) if on_card else found


def available() -> bool:
    """Whether this version of PyTorch has such devices; makes it known."""
    global _library
    if register is not None and _library is None:
        module = backend_registration._DummyBackendModule()
        module.get_amp_supported_dtype = lambda: [torch.float16]  # torch.utils.checkpoint asks for it
        register(NAME, module)
        devices.EMULATED[NAME] = lambda tensor: tensor.host.data_ptr() + OUT_OF_REACH
        _library = torch.library.Library("_", "IMPL", "PrivateUse1")
        _library.fallback(lambda function, *args, **kwargs: _run(function, args, kwargs))
    return _library is not None


_library: Any = None
