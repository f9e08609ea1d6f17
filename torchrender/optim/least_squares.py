"""Least squares for what light is linear in: colours, textures, lamps, skies. No learning rate, few steps."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch

TINY = 1e-30  # added to what divides, far below any light, for entries that have none
FLOOR = 0.02  # of a tensor's mean: entries below are divided by no less
STEP = 4  # between sizes of the pyramid
BRIGHTER = 0.5  # the least share that light, less what goes out, has of both

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
    the mean of what the pixels that show it say.

    Two more things make steps of few samples useful. D is a sum over visits, in which each is worth `memory` of the
    next one, so that views of the same texel are averaged. And an entry of a texture or grid that has not had `damping`
    pixels' worth of light moves as its neighbourhood of four by four does, which has had that of sixteen, and so on up
    a pyramid: large features come first, and texels between the paths are not left behind. Both change how fast a
    result is reached, and not which one.

    The steps need the picture, not a loss::

        optimizer = tr.optim.LeastSquares([texture], high=1.0)
        for it in range(20):
            optimizer.zero_grad()
            picture = renderer(sensor=it % 10, spp=4, seed=it)
            loss = optimizer.step(picture, targets[it % 10])

    The gradient is in ``.grad`` afterwards, also of parameters that this optimiser does not have, as if ``loss`` had
    been passed back; so others may make a step of their own then, such as Adam for a roughness. What ``.grad`` had
    before, of a prior say, is part of the step.

    Not for what makes pictures darker or sharper (densities of smoke, roughness, shapes), which is refused where that
    shows. Light by way of several reflections grows faster than in proportion: where most of it does, `lr` below 1.
    Other light in the same pixels, which does not depend on the parameters, makes steps shorter than they need be.
    Processes that share parameters would make different steps: D is not exchanged.

    Args:
        params: tensors of values >= 0, and not all of them 0, or parameter groups.
        lr: factor of the steps; 1 is right for light that is linear in the parameters.
        damping: light, in pixels, that an entry has to have had until it moves rather by itself than with others.
        memory: weight of an earlier visit beside the next one, from 0 to 1. More averages more noise, of the last
            1 / (1 - memory) visits; less is sooner there where parameters share their pixels, or other things change.
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
        if not float(options["lr"]) >= 0:
            raise ValueError(f"lr: expected a number >= 0, got {options['lr']!r}")
        if not float(options["damping"]) > 0:
            raise ValueError(f"damping: expected a number of pixels > 0, got {options['damping']!r}")
        if not 0 <= float(options["memory"]) <= 1:
            raise ValueError(f"memory: expected a number from 0 to 1, got {options['memory']!r}")
        if not bool(torch.as_tensor(options["low"]).min() >= 0):
            raise ValueError(f"low: expected nothing below 0, got {options['low']!r}")
        if options["dims"] not in (None, 0, 1, 2, 3):
            raise ValueError(f"dims: expected 0, 1, 2, 3 or None, got {options['dims']!r}")
        super().add_param_group(param_group)
        for parameter in self.param_groups[-1]["params"]:
            if not parameter.is_floating_point():
                raise ValueError(f"params: expected real numbers, got {parameter.dtype}")
            if _dims_of(parameter, options["dims"]) > parameter.dim():
                raise ValueError(f"dims: {options['dims']} are more than the axes of {tuple(parameter.shape)}")

    def step(  # type: ignore[override]
        self, image: torch.Tensor, target: torch.Tensor, weight: torch.Tensor | float | None = None
    ) -> torch.Tensor:
        """One step towards a picture, or several of the same size.

        Args:
            image: a rendering whose graph leads to the parameters, any shape. It is freed: once a step.
            target: of the same shape.
            weight: by which differences are multiplied, w; broadcasts to the picture. None: 1.

        Returns:
            The mean of w^2 (image - target)^2 before the step, a scalar without a graph.

        Raises:
            ValueError: if shapes differ, values are negative or all 0, or pictures do not become brighter with a
                parameter.
            RuntimeError: if picture or target are not finite. In both cases all values are as before.
        """
        groups = [(group, p) for group in self.param_groups for p in group["params"] if p.requires_grad]
        for _, parameter in groups:
            _check(parameter)
        picture = image.detach()
        if not image.requires_grad:
            raise ValueError("image: it has no graph; no parameter of it requires a gradient")
        if target.shape != picture.shape:
            raise ValueError(f"target: expected the picture's shape {tuple(picture.shape)}, got {tuple(target.shape)}")
        w = torch.as_tensor(1.0 if weight is None else weight, dtype=picture.dtype, device=picture.device)
        if torch.broadcast_shapes(w.shape, picture.shape) != picture.shape:
            raise ValueError(f"weight: {tuple(w.shape)} does not broadcast to the picture's {tuple(picture.shape)}")
        difference = picture - target.to(picture)
        weighted = w * w * difference
        loss = (weighted * difference).mean()
        if not bool(loss.isfinite()):
            raise RuntimeError("image, target or weight is not finite; no step was made")
        curvature = w * w * picture.abs() * (2 / picture.numel())
        torch.autograd.backward(image, weighted * (2 / picture.numel()), retain_graph=True)
        found = torch.autograd.grad(image, [p for _, p in groups], curvature, allow_unused=True)
        lit = int(curvature.count_nonzero())
        with torch.no_grad():
            lights = [None if share is None else _bound(p, share) for (_, p), share in zip(groups, found, strict=True)]
            for (group, parameter), light in zip(groups, lights, strict=True):
                if light is not None and parameter.grad is not None and lit:
                    self._update(parameter, parameter.grad, light, lit, group)
        return loss

    def _update(
        self, parameter: torch.Tensor, gradient: torch.Tensor, light: torch.Tensor, lit: int, group: dict[str, Any]
    ) -> None:
        """A step of one tensor, by the bound of its curvature in a picture of so many values that are not black."""
        pixel = float(light.sum()) / lit
        if not pixel > 0:
            return
        state = self.state[parameter]
        if not state:
            state["light"] = torch.zeros_like(parameter)
            state["pixel"], state["steps"] = 0.0, 0
        # A pixel's worth: the mean over all steps.
        state["steps"] += 1
        state["pixel"] += (pixel - state["pixel"]) / state["steps"]
        # Entries without light were not visited, and forget nothing.
        whole = state["light"]
        whole.addcmul_(whole, light.sign(), value=group["memory"] - 1).add_(light).clamp_(min=0)
        dims = _dims_of(parameter, group["dims"])
        change = _shared(gradient, whole, group["damping"] * state["pixel"] + TINY, dims)
        parameter.sub_(change, alpha=group["lr"])
        low, high = (torch.as_tensor(group[name]).to(parameter) for name in ("low", "high"))
        torch.clamp(parameter, low, high, out=parameter)


def _words(parameter: torch.Tensor) -> str:
    return f"the parameter of shape {tuple(parameter.shape)}"


def _check(parameter: torch.Tensor) -> None:
    least, most = (float(value) for value in parameter.detach().aminmax())
    if not (least >= 0 and most > 0):
        words = "all are 0" if least == 0 else f"got {least:g}"
        raise ValueError(f"params: expected values >= 0, and some above, {words} in {_words(parameter)}")


def _bound(parameter: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
    """sum_p w_p^2 J_pt I_p, divided by the values."""
    scale = parameter.clamp(min=FLOOR * float(parameter.mean()))
    light = torch.div(share, scale, out=scale)
    if float(light.sum()) < BRIGHTER * float(torch.linalg.vector_norm(light, 1)):
        raise ValueError(
            f"params: pictures do not become brighter with {_words(parameter)}; LeastSquares is for colours, textures "
            "and lights"
        )
    return light


def _dims_of(parameter: torch.Tensor, dims: int | None) -> int:
    if dims is None:
        return parameter.dim() - 1 if parameter.dim() in (3, 4) else 0
    return dims


def _shared(gradient: torch.Tensor, light: torch.Tensor, damping: float, dims: int) -> torch.Tensor:
    """Gradient / light, where light is more than `damping`, and else that of the neighbourhood.

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
