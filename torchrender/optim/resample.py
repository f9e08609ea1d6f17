"""Growing a texture or volume during an optimisation, together with the state of its optimiser."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn

from ..errors import describe, nearest

_WRAP_MODES = ("repeat", "mirror", "clamp", "corners")

# How an optimiser's state scales when a tensor of n entries becomes one of m: each new entry receives about n / m of
# the old gradient, so a first moment scales with it, a second moment with its square, a count or a length not at all.
_POWERS = {
    **dict.fromkeys(("exp_avg", "momentum_buffer", "grad_avg", "exp_inf", "prev", "light"), 1),
    **dict.fromkeys(("exp_avg_sq", "max_exp_avg_sq", "square_avg", "sum"), 2),
    **dict.fromkeys(("step", "acc_delta", "step_size", "ax"), 0),
}


def resample(tensor: torch.Tensor, size: Sequence[int], wrap_mode: str | Sequence[str] = "repeat") -> torch.Tensor:
    """Resample a texture or volume linearly, texel centres at (i + 0.5) / n in both grids, as `bitmap` places them.

    Args:
        tensor: (H, W, C) or (Z, Y, X, C), floating point; or any tensor whose leading dimensions are resampled.
        size: the new leading dimensions, such as (H, W); the remaining ones stay.
        wrap_mode: ``"repeat"``, ``"mirror"`` or ``"clamp"``: what lies beyond the border; one for all dimensions or one
            for each. ``"corners"``: the first and the last number lie on the border, as those of an `sdfgrid`.

    Returns:
        Tensor with the new leading dimensions, differentiable. Each value is an average of old ones with weights that
        are not negative, so bounds and positivity stay.

    Raises:
        TypeError, ValueError: if an argument is not one of those above.
    """
    if not isinstance(tensor, torch.Tensor) or not tensor.is_floating_point():
        raise TypeError(f"tensor: expected a floating-point tensor, got {describe(tensor)}")
    size = tuple(int(n) for n in size)
    if not 1 <= len(size) <= tensor.dim() or min(size) < 1 or 0 in tensor.shape:
        shape = tuple(tensor.shape)
        raise ValueError(f"size: expected up to {tensor.dim()} positive integers for shape {shape}, got {size}")
    modes = (wrap_mode,) * len(size) if isinstance(wrap_mode, str) else tuple(wrap_mode)
    if len(modes) != len(size) or any(mode not in _WRAP_MODES for mode in modes):
        raise ValueError(f"wrap_mode: expected one of {_WRAP_MODES}, or {len(size)} of them, got {wrap_mode!r}")
    for axis, (count, mode) in enumerate(zip(size, modes)):
        if count != tensor.shape[axis]:
            tensor = _resample_axis(tensor, axis, count, mode)
    return tensor


def _resample_axis(tensor: torch.Tensor, axis: int, count: int, mode: str) -> torch.Tensor:
    old = tensor.shape[axis]
    # Exact for all sizes in use: positions are small rationals, computed in double precision.
    position = (torch.arange(count, dtype=torch.float64) + 0.5) * (old / count) - 0.5
    if mode == "corners":
        position = torch.arange(count, dtype=torch.float64) * ((old - 1) / max(count - 1, 1))
    low = position.floor()
    weight = (position - low).to(tensor.dtype).to(tensor.device)
    shape = [1] * tensor.dim()
    shape[axis] = count
    weight = weight.reshape(shape)
    index = low.long()
    ends = [_wrap(i, old, mode).to(tensor.device) for i in (index, index + 1)]
    return tensor.index_select(axis, ends[0]) * (1 - weight) + tensor.index_select(axis, ends[1]) * weight


def _wrap(index: torch.Tensor, size: int, mode: str) -> torch.Tensor:
    if mode == "repeat":
        return index % size
    if mode in ("clamp", "corners"):
        return index.clamp(0, size - 1)
    folded = index % (2 * size)
    return torch.where(folded < size, folded, 2 * size - 1 - folded)


def upsample(
    module: nn.Module,
    name: str,
    size: Sequence[int],
    optimizer: torch.optim.Optimizer | None = None,
    *,
    wrap_mode: str | Sequence[str] | None = None,
) -> nn.Parameter:
    """Replace a parameter of a scene by a finer one, in the scene and in its optimiser.

    Args:
        module: a scene, or any module.
        name: the parameter's dotted name, such as ``"wall.bsdf.reflectance.data"``. If it is parametrised
            (`torchrender.constraints`), the value is resampled and the parameter behind it set accordingly.
        size: the new leading dimensions: (H, W) of a texture or of heights, (Z, Y, X) of a volume or a grid of
            distances; none smaller than it is.
        optimizer: its state (moments and so on) is resampled with the parameter and scaled for the new number of
            entries, among which the gradient is shared out.
        wrap_mode: as in :func:`resample`; by default the module's own ``wrap_mode``, else ``"clamp"`` for volumes and
            for (H, W) without channels, ``"repeat"`` for anything else.

    Returns:
        The new parameter, which is to be used from now on; the old one is not in the module any more.

    Raises:
        ValueError: if there is no such parameter, the size does not fit, or the optimiser does not have it.
        TypeError: if the optimiser keeps a state that cannot be resampled.
    """
    owner, leaf = _owner(module, name)
    chain = getattr(owner, "parametrizations", {})
    constrained = leaf in chain
    if constrained and not getattr(chain[leaf], "is_tensor", False):
        raise ValueError(f"name: {name!r} is parametrised by several tensors, which cannot be resampled")
    old = chain[leaf].original if constrained else owner._parameters.get(leaf)
    if old is None:
        raise ValueError(f"name: {name!r} is not a parameter; {nearest(name, dict(module.named_parameters()))}")
    if wrap_mode is None:
        own = getattr(owner, "wrap_mode", None)
        clamped = old.dim() == 4 or (old.dim() == 2 and len(tuple(size)) == 2)
        wrap_mode = own if own in _WRAP_MODES else ("clamp" if clamped else "repeat")
    if not constrained:
        new = upsample_tensor(old, size, optimizer, wrap_mode=wrap_mode)
    else:
        with torch.no_grad():
            value = resample(getattr(owner, leaf), _larger(old, size), wrap_mode)
            for step in reversed(list(chain[leaf])):
                value = step.right_inverse(value)
        new = _replace(old, value, optimizer, tuple(size), wrap_mode)
    for place in module.modules():  # an object that is used twice may hold the same parameter in two places
        for key, parameter in list(place._parameters.items()):
            if parameter is old:
                setattr(place, key, new)
    return new


def upsample_tensor(
    parameter: torch.Tensor,
    size: Sequence[int],
    optimizer: torch.optim.Optimizer | None = None,
    *,
    wrap_mode: str | Sequence[str] = "repeat",
) -> nn.Parameter:
    """The same for a parameter that no module holds, such as one that is passed as ``params={...}`` of a render.

    Args:
        parameter: a leaf tensor (H, W), (H, W, C) or (Z, Y, X, C).
        size, optimizer, wrap_mode: as in :func:`upsample`.

    Returns:
        The new parameter, with the old one's ``requires_grad``.
    """
    if not isinstance(parameter, torch.Tensor) or not parameter.is_leaf:
        raise TypeError(f"parameter: expected a leaf tensor, got {describe(parameter)}")
    with torch.no_grad():
        value = resample(parameter, _larger(parameter, size), wrap_mode)
    return _replace(parameter, value, optimizer, tuple(size), wrap_mode)


def _owner(module: nn.Module, name: str) -> tuple[nn.Module, str]:
    if not isinstance(module, nn.Module):
        raise TypeError(f"module: expected a scene or another nn.Module, got {describe(module)}")
    path, _, leaf = name.rpartition(".")
    try:
        return module.get_submodule(path), leaf
    except AttributeError:
        known = dict(module.named_parameters())
        raise ValueError(f"name: there is no parameter {name!r}; {nearest(name, known)}") from None


def _larger(parameter: torch.Tensor, size: Sequence[int]) -> tuple[int, ...]:
    size, old = tuple(int(n) for n in size), tuple(parameter.shape)
    # The last axis is one of channels; two numbers for two axes are those of a grid without any.
    grid = parameter.dim() if parameter.dim() == len(size) == 2 else max(parameter.dim() - 1, 1)
    if len(size) != grid or any(n < m for n, m in zip(size, old)):
        wanted = old[:grid]
        raise ValueError(f"size: expected {len(wanted)} numbers of at least {wanted} for shape {old}, got {size}")
    return size


def _replace(
    old: torch.Tensor,
    value: torch.Tensor,
    optimizer: torch.optim.Optimizer | None,
    size: tuple[int, ...],
    wrap_mode: str | Sequence[str],
) -> nn.Parameter:
    """A new parameter with this value, which takes the place of `old` in the optimiser."""
    new = nn.Parameter(value.detach().clone(), requires_grad=old.requires_grad)
    if optimizer is None:
        return new
    places = [
        (group["params"], i) for group in optimizer.param_groups for i, p in enumerate(group["params"]) if p is old
    ]
    if not places:
        raise ValueError(f"optimizer: it does not have the parameter of shape {tuple(old.shape)}")
    state = dict(optimizer.state.get(old, {}))
    ratio = old.numel() / new.numel()
    for key, entry in state.items():
        if not isinstance(entry, torch.Tensor) or entry.dim() == 0:
            if isinstance(entry, (list, dict)):
                raise TypeError(f"optimizer: the state {key!r} of {type(optimizer).__name__} cannot be resampled")
            continue
        if entry.shape != old.shape or key not in _POWERS:
            raise TypeError(f"optimizer: the state {key!r} of {type(optimizer).__name__} cannot be resampled")
        with torch.no_grad():
            # RMSprop's momentum is one of normalised steps, not of gradients.
            power = 0 if isinstance(optimizer, torch.optim.RMSprop) and key == "momentum_buffer" else _POWERS[key]
            state[key] = resample(entry, size, wrap_mode) * ratio**power
    for params, index in places:
        params[index] = new
    optimizer.state.pop(old, None)
    if state:
        optimizer.state[new] = state
    return new
