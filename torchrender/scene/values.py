"""From what people write in a scene to tensors: numbers, colours, spectra, points, arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch.autograd import forward_ad

from ..errors import describe, nearest
from ..transform import Transform, as_matrix, is_whole, plain, single
from .context import LUMINANCE, Context


def floating(value: Any, ctx: Context) -> torch.Tensor:
    """`value` as a dense floating-point tensor of the context's dtype. Tensors keep their gradient."""
    if isinstance(value, torch.Tensor):
        tensor = value
    elif isinstance(value, Transform):
        tensor = value.matrix
    else:
        given = getattr(value, "dtype", None)
        if isinstance(value, (str, bytes, Mapping)) or value is None:
            ctx.error(f"expected numbers, got {describe(value)}")
        try:
            tensor = torch.as_tensor(plain(value), dtype=torch.float64, device="cpu")
        except (TypeError, ValueError, RuntimeError):
            ctx.error(f"expected numbers, got {describe(value)}")
        if ctx.dtype is None and str(given) not in ("float64",):
            tensor = tensor.to(torch.get_default_dtype())
    if tensor.layout is not torch.strided:
        ctx.error(f"expected a dense tensor, got layout {tensor.layout}")
    if tensor.is_complex():
        ctx.error(f"expected real numbers, got {describe(value)}")
    if tensor.is_meta and ctx.device.type != "meta":
        ctx.error("expected numbers, got a tensor on the meta device, which has none")
    if ctx.dtype is not None:
        target = ctx.dtype
    elif tensor.dtype in (torch.float32, torch.float64):
        target = tensor.dtype
    else:
        target = torch.get_default_dtype()
    return tensor.to(dtype=target, device=ctx.device)


def in_forward_mode() -> bool:
    """Whether tensors may carry tangents."""
    return forward_ad._current_level >= 0


def has_tangent(tensor: torch.Tensor) -> bool:
    """Whether `tensor` carries a tangent of forward mode, which no attribute of it tells."""
    return in_forward_mode() and forward_ad.unpack_dual(tensor).tangent is not None


def has_derivative(tensor: torch.Tensor) -> bool:
    """Whether a derivative with respect to `tensor` is recorded: reverse mode, or a tangent of forward mode."""
    return (tensor.requires_grad and torch.is_grad_enabled()) or has_tangent(tensor)


def number(value: Any, ctx: Context) -> torch.Tensor:
    """A single number, as a tensor of shape ()."""
    tensor = floating(value, ctx)
    if tensor.numel() != 1:
        ctx.error(f"expected a number, got {describe(value)}")
    return tensor.reshape(())


def vector(value: Any, ctx: Context) -> torch.Tensor:
    """Three numbers, as a tensor of shape (3,)."""
    tensor = floating(value, ctx)
    if tensor.numel() != 3:
        ctx.error(f"expected three numbers, got {describe(value)}")
    return tensor.reshape(3)


def matrix(value: Any, size: int, ctx: Context) -> torch.Tensor:
    """A (size, size) matrix."""
    with ctx.located():
        made = as_matrix(value, size, "transform")
    return made.to(dtype=ctx.dtype or _dtype_of(value), device=ctx.device)


def double(value: Any, ctx: Context) -> torch.Tensor:
    """A number in float64, for computations before it is `rounded`."""
    return number(value, replace(ctx, dtype=torch.float64))


def double_array(value: Any, ctx: Context) -> Any:
    """Numbers as a float64 NumPy array, for tables that carry no gradient."""
    return floating(value, replace(ctx, dtype=torch.float64)).detach().cpu().numpy()


def rounded(result: torch.Tensor, given: Any, ctx: Context) -> torch.Tensor:
    """`result`, computed in float64 from `given`, in the precision that `given` itself would have been taken in."""
    return result.to(ctx.dtype or _dtype_of(given))


def _dtype_of(value: Any) -> torch.dtype:
    return value.dtype if isinstance(value, torch.Tensor) and value.is_floating_point() else torch.get_default_dtype()


def luminance(color: torch.Tensor) -> torch.Tensor:
    """Rec. 709 luminance of (..., 3) as (..., 1)."""
    return (color * color.new_tensor(LUMINANCE)).sum(-1, keepdim=True)


def to_channels(color: torch.Tensor, ctx: Context) -> torch.Tensor:
    """Image or colour (..., C) with the channels of the context: luminance in mono, alpha dropped."""
    if color.shape[-1] in (2, 4):
        color = color[..., :-1]
    if ctx.color == "mono" and color.shape[-1] == 3:
        color = luminance(color)
    return color


def numbers(text: str, ctx: Context) -> list[float]:
    """The numbers in a text, which commas or spaces separate."""
    try:
        return [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        ctx.error(f"expected numbers, got {text!r}")


def image(value: Any, ctx: Context) -> torch.Tensor:
    """Texels (H, W, C), C = 1 or 3, contiguous; (H, W) counts as one channel, alpha is dropped, mono has luminance."""
    tensor = floating(value, ctx)
    if tensor.ndim == 2:
        tensor = tensor[..., None]
    if tensor.ndim != 3 or tensor.shape[-1] not in (1, 2, 3, 4) or 0 in tensor.shape:
        first = tensor.ndim == 3 and tensor.shape[0] in (1, 3, 4) and min(tensor.shape) > 0
        hint = ", which looks like (C, H, W): C comes last here" if first else ""
        ctx.error(f"expected texels of shape (H, W, C) with 1 to 4 channels and H, W > 0, got {describe(value)}{hint}")
    return to_channels(tensor, ctx).contiguous()


def voxels(value: Any, ctx: Context) -> torch.Tensor:
    """Voxels (Z, Y, X, C), C = 1 or 3, contiguous; (Z, Y, X) counts as one channel, mono has luminance."""
    tensor = floating(value, ctx)
    if tensor.ndim == 3:
        tensor = tensor[..., None]
    if tensor.ndim != 4 or tensor.shape[-1] not in (1, 3) or 0 in tensor.shape:
        ctx.error(f"expected voxels of shape (Z, Y, X, C) with C = 1 or 3 and Z, Y, X > 0, got {describe(value)}")
    return to_channels(tensor, ctx).contiguous()


def integer(value: Any, ctx: Context, minimum: int | None = None) -> int:
    """An integer; booleans are refused."""
    number = single(value)
    if getattr(number, "ndim", 0) or not is_whole(number):
        ctx.error(f"expected an integer, got {describe(value)}")
    result = int(number)
    if minimum is not None and result < minimum:
        ctx.error(f"expected at least {minimum}, got {result}")
    return result


def boolean(value: Any, ctx: Context) -> bool:
    """True or False, nothing that merely could be read as one."""
    if isinstance(single(value), bool):
        return bool(value)
    ctx.error(f"expected True or False, got {describe(value)}")


def choice(value: Any, options: Sequence[str], ctx: Context) -> int:
    """Position of the word `value` among `options`."""
    if not isinstance(value, str):
        ctx.error(f"expected one of {', '.join(options)}, got {describe(value)}")
    if value not in options:
        ctx.error(f"unknown word {value!r}; {nearest(value, options)}")
    return options.index(value)
