"""Least squares for what light is linear in, colours, textures, lamps, skies: few steps, and seldom a learning rate."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import torch

FLOOR = 0.01  # of a tensor's typical value: entries below are divided by no less
STEP = 4  # between sizes of the pyramid
BRIGHTER = 0.5  # the least share that light, less what is lost, has of both
STRAY = 0.01  # of a visit's mean light: entries that have much less were hardly visited

_LINEAR = {1: "linear", 2: "bilinear", 3: "trilinear"}


class LeastSquares(torch.optim.Optimizer):
    """Steps as long as the light says: for reflectances, emitted radiance, and other factors of a picture's light.

    Where pictures I become brighter with parameters a >= 0, nearly in proportion, as with colours, textures, lamps
    and environment maps, the loss L = mean w^2 (I - T)^2 over a picture's n values has a bound on its curvature that is
    diagonal and known::

        D_t = 2 / n  sum_p  w_p^2 J_pt I_p / a_t        with J = dI / da >= 0

    A gradient step divided by it, ``a -= g / D``, lets L not grow if I = J a, whatever the scene, its size and units
    (De Pierro, "On the relation between the ISRA and the EM algorithm for positron emission tomography", IEEE
    Transactions on Medical Imaging 12, 1993). The same paths estimate J in g and in D, as two derivatives of the
    picture that differ in the weights of pixels, and most of their noise goes out of the quotient: a texel moves by
    the mean of what the pixels that show it say. (Entries below a hundredth of a tensor's typical value are divided by
    that in place of their own, or black ones would stay black; so they may move by as much, to and fro.)

    Two more things make steps of few samples useful. D is a sum over visits, in which each is worth `memory` of the
    next one, so that views of the same texel are averaged. And an entry of a texture or grid that has not had `damping`
    pixels' worth of light moves as its neighbourhood of four by four does, which has had that of sixteen, and so on up
    a pyramid: large features come first, and texels between the paths are not left behind.

    The steps need the picture, not a loss::

        optimizer = tr.optim.LeastSquares([texture], high=1.0)
        for it in range(20):
            optimizer.zero_grad()
            picture = renderer(sensor=it % 10, spp=4, seed=it)
            loss = optimizer.step(picture, targets[it % 10])

    The gradient is in ``.grad`` afterwards as ``loss.backward()`` would leave it, also of parameters that this
    optimiser does not have, such as a roughness, for an Adam that makes its step then. What ``.grad`` had before is
    part of the step: the gradient of a prior, which is weighed against a mean over all values; or, where `zero_grad`
    was forgotten, that of the last step.

    What it is not for:

    * What makes pictures darker or sharper (densities of smoke, roughness, shapes). It is refused where that shows.
    * Light by way of many reflections grows faster than in proportion. In closed bright rooms the loss jumps up and
      down; ``lr=0.3`` helps.
    * The last digits by one or two samples a pixel: the noise of a picture is in D, too, which leaves results too
      bright, by 2 to 3 % on a wall under a lamp and a sky with one sample, by nothing to be seen with four. More
      samples, or ``memory`` near 1, at the end.
    * Other light in the same pixels, which does not depend on the parameters, makes steps shorter than they need be.
    * Processes that share parameters would make different steps: D is not exchanged.

    Args:
        params: tensors of values >= 0, and not all of them 0, or parameter groups.
        lr: factor of the steps; 1 is right for light that is linear in the parameters.
        damping: light that an entry has to have had until it moves by itself more than with others, in units of what a
            pixel of the picture that is not black brings in the mean, whether it shows the parameter or not. More for
            textures finer than the pixels, noisy pictures, and objects that fill a small part of them (10 to 30); less
            where every texel fills pixels of its own (1).
        memory: weight of an earlier visit beside the next one, from 0 to 1. More averages more noise, of about
            1 / (1 - memory) visits; less takes fewer steps where parameters share their pixels or other things change.
        low: numbers, or tensors that broadcast to the parameters, below which no step goes, at least 0.
        high: the same above.
        dims: number of leading axes along which entries have neighbours; None: all but the last of three or four
            (textures (H, W, C), grids (Z, Y, X, C)), else none.

    Raises:
        ValueError: for options out of range.
    """

    def __init__(
        self,
        params: Iterable[torch.Tensor] | Iterable[dict[str, Any]],
        lr: float = 1.0,
        *,
        damping: float = 3.0,
        memory: float = 0.5,
        low: float | torch.Tensor = 0.0,
        high: float | torch.Tensor = float("inf"),
        dims: int | None = None,
    ) -> None:
        defaults = {"lr": lr, "damping": damping, "memory": memory, "low": low, "high": high, "dims": dims}
        super().__init__(params, defaults)

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Add parameters with options of their own, checked here."""
        options = {**self.defaults, **{k: v for k, v in param_group.items() if k != "params"}}
        if not 0 <= float(options["lr"]) < math.inf:
            raise ValueError(f"lr: expected a number >= 0, got {options['lr']!r}")
        if not 0 < float(options["damping"]) < math.inf:
            raise ValueError(f"damping: expected a number of pixels > 0, got {options['damping']!r}")
        if not 0 <= float(options["memory"]) <= 1:
            raise ValueError(f"memory: expected a number from 0 to 1, got {options['memory']!r}")
        if not bool(torch.as_tensor(options["low"]).min() >= 0):
            raise ValueError(f"low: expected nothing below 0, got {options['low']!r}")
        if not bool((torch.as_tensor(options["high"]) >= torch.as_tensor(options["low"])).all()):
            raise ValueError(f"high: expected nothing below low, {options['low']!r}, got {options['high']!r}")
        dims = options["dims"]
        if dims is not None and not (isinstance(dims, int) and 0 <= dims <= 3):
            raise ValueError(f"dims: expected 0, 1, 2, 3 or None, got {dims!r}")
        super().add_param_group(param_group)
        group = self.param_groups[-1]
        try:
            for parameter in group["params"]:
                _check_shapes(parameter, group)
        except ValueError:
            self.param_groups.pop()
            raise

    def step(  # type: ignore[override]
        self, image: torch.Tensor, target: torch.Tensor, weight: torch.Tensor | float | None = None
    ) -> torch.Tensor:
        """One step towards a picture, or several of the same size.

        Args:
            image: a rendering whose graph leads to the parameters, any shape. The graph is freed: a rendering a step.
            target: of the same shape. What is not finite may have the weight 0.
            weight: by which differences are multiplied, w; broadcasts to the picture. None: 1.

        Returns:
            The mean of w^2 (image - target)^2 before the step, a scalar without a graph.

        Raises:
            ValueError: if shapes differ, values are negative or all 0, or pictures do not become brighter with a
                parameter.
            RuntimeError: if picture, target, weight or a derivative are not finite. In both cases all values are as
                before.
        """
        learned = [(group, p) for group in self.param_groups for p in group["params"] if p.requires_grad and p.numel()]
        for group, parameter in learned:
            _check_shapes(parameter, group)
            _check_values(parameter)
        if not image.requires_grad:
            raise ValueError("image: it has no graph; no parameter of it requires a gradient")
        picture = image.detach()
        weighted, curvature, loss = _compare(picture, target, weight)
        torch.autograd.backward(image, weighted, retain_graph=bool(learned))
        if not learned:
            return loss
        found = torch.autograd.grad(image, [p for _, p in learned], curvature, allow_unused=True)
        lit = int(curvature.count_nonzero())
        with torch.no_grad():
            steps = [
                (group, parameter, gradient, *_bound(parameter, gradient, share))
                for (group, parameter), share in zip(learned, found, strict=True)
                if share is not None and (gradient := parameter.grad) is not None
            ]
            for group, parameter, gradient, light, received in steps:
                if received > 0:
                    self._update(parameter, gradient, light, received, lit, group)
        return loss

    def _update(
        self,
        parameter: torch.Tensor,
        gradient: torch.Tensor,
        light: torch.Tensor,
        received: float,
        lit: int,
        group: dict[str, Any],
    ) -> None:
        """A step of one tensor; `light` bounds its curvature in this visit, `received` in all, from `lit` values."""
        state = self.state[parameter]
        if not state:
            state["light"] = torch.zeros_like(parameter)
            state["pixel"], state["visits"] = 0.0, 0.0
        memory = group["memory"]
        state["visits"] = memory * state["visits"] + 1
        state["pixel"] += (received / lit - state["pixel"]) / state["visits"]
        # Entries that get no light, or next to none by stray paths, were not visited, and forget nothing.
        visited = light + STRAY * received / int(light.count_nonzero())
        torch.div(light, visited, out=visited)
        whole = state["light"]
        whole.addcmul_(whole, visited, value=memory - 1).add_(light)
        damping = max(group["damping"] * state["pixel"], torch.finfo(parameter.dtype).tiny)
        change = _shared(gradient, whole, damping, _dims_of(parameter, group["dims"]))
        torch.sub(parameter, change, alpha=group["lr"], out=change)
        low, high = (torch.as_tensor(group[name]).to(parameter) for name in ("low", "high"))
        torch.clamp(change, low, high, out=parameter)


def _compare(picture: torch.Tensor, target: Any, weight: Any) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The loss's derivative by the picture, what D is the derivative of, and the loss."""
    target = torch.as_tensor(target).detach().to(picture)
    if target.shape != picture.shape:
        raise ValueError(f"target: expected the picture's shape {tuple(picture.shape)}, got {tuple(target.shape)}")
    w = torch.as_tensor(1.0 if weight is None else weight).detach().to(picture)
    try:
        w = w.expand(picture.shape)
    except RuntimeError:
        raise ValueError(
            f"weight: {tuple(w.shape)} does not broadcast to the picture's {tuple(picture.shape)}"
        ) from None
    zero = picture.new_zeros(())
    seen = w != 0
    difference = torch.where(seen, picture - target, zero)
    weighted = w * w * difference
    loss = (weighted * difference).mean()
    if not bool(loss.isfinite()):
        raise RuntimeError("image, target or weight is not finite; no step was made")
    scale = 2 / picture.numel()
    return weighted * scale, torch.where(seen, w * w * picture.abs() * scale, zero), loss


def _words(parameter: torch.Tensor) -> str:
    return f"the parameter of shape {tuple(parameter.shape)}"


def _check_shapes(parameter: torch.Tensor, group: dict[str, Any]) -> None:
    if not parameter.is_floating_point():
        raise ValueError(f"params: expected real numbers, got {parameter.dtype}")
    if _dims_of(parameter, group["dims"]) > parameter.dim():
        raise ValueError(f"dims: {group['dims']} are more than the axes of {tuple(parameter.shape)}")
    for name in ("low", "high"):
        shape = torch.as_tensor(group[name]).shape
        if len(shape) > parameter.dim() or any(
            n not in (1, m) for n, m in zip(reversed(shape), reversed(parameter.shape), strict=False)
        ):
            raise ValueError(f"{name}: {tuple(shape)} does not broadcast to {_words(parameter)}")


def _check_values(parameter: torch.Tensor) -> None:
    least, most = (float(value) for value in parameter.detach().aminmax())
    if not (least >= 0 and most > 0):
        words = "all are 0" if least == 0 else f"got {least:g}"
        raise ValueError(f"params: expected values >= 0, and some above, {words} in {_words(parameter)}")


def _bound(parameter: torch.Tensor, gradient: torch.Tensor, share: torch.Tensor) -> tuple[torch.Tensor, float]:
    """sum_p w_p^2 J_pt I_p by the values, at least 0, and the sum of that."""
    received, both = float(share.sum()), float(torch.linalg.vector_norm(share, 1))
    if not (math.isfinite(received) and bool(gradient.sum().isfinite())):
        raise RuntimeError(f"the picture's derivative by {_words(parameter)} is not finite; no step was made")
    if received < BRIGHTER * both:
        raise ValueError(
            f"params: pictures do not become brighter with {_words(parameter)}; LeastSquares is for colours, textures "
            "and lights"
        )
    # Typical is not the mean of a sky with a sun in it. New memory costs more than the sums: one tensor for all of it.
    scale = parameter.sqrt()
    torch.clamp(parameter, min=FLOOR * float(scale.mean()) ** 2, out=scale)
    light = torch.div(share, scale, out=scale).clamp_(min=0)
    return light, float(light.sum())


def _dims_of(parameter: torch.Tensor, dims: int | None) -> int:
    if dims is None:
        return parameter.dim() - 1 if parameter.dim() in (3, 4) else 0
    return dims


def _shared(gradient: torch.Tensor, light: torch.Tensor, damping: float, dims: int) -> torch.Tensor:
    """Gradient / light where light is more than `damping`, and else that of the neighbourhood.

    A weighted mean of both, with the same at a quarter of the size for the neighbourhood; at the smallest size with 0.
    """
    if max(gradient.shape[:dims], default=1) < STEP:
        return gradient / (light + damping)
    coarse = _shared(_summed(gradient, dims), _summed(light, dims), damping, dims)
    change = _spread(coarse, gradient.shape, dims)
    return change.mul_(damping).add_(gradient).div_(light + damping)


def _summed(grid: torch.Tensor, dims: int) -> torch.Tensor:
    """Sums of four entries along each of the leading axes; the last may be of fewer."""
    for dim in range(dims):
        count = grid.shape[dim]
        whole = grid.narrow(dim, 0, count // STEP * STEP).unflatten(dim, (count // STEP, STEP))
        # slice by slice, which is quicker than a sum along a short axis
        sums = whole.select(dim + 1, 0) + whole.select(dim + 1, 1)
        for i in range(2, STEP):
            sums += whole.select(dim + 1, i)
        rest = count % STEP
        grid = torch.cat([sums, grid.narrow(dim, count - rest, rest).sum(dim, keepdim=True)], dim) if rest else sums
    return grid


def _spread(grid: torch.Tensor, shape: torch.Size, dims: int) -> torch.Tensor:
    """The same at four times the size along the leading axes, interpolated linearly, cut to `shape`."""
    channels = grid.reshape(*grid.shape[:dims], -1).movedim(-1, 0)[None]
    finer = torch.nn.functional.interpolate(channels, scale_factor=STEP, mode=_LINEAR[dims])
    for dim in range(dims):
        finer = finer.narrow(dim + 2, 0, shape[dim])
    return finer[0].movedim(0, -1).reshape(shape)
