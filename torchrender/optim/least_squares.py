"""Least squares for colours, textures, lights and other maps: few steps, and seldom a learning rate."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import torch

from ..autograd import backward_and_grads
from .curvature import Curvature, curvature_of, words

STEP = 4  # between sizes of the pyramid
UNSURE = 0.15  # of D's mean: what is no bound may be too small by chance where it is less
STRAY = 0.01  # of a visit's mean light: entries that have much less were hardly visited

_LINEAR = {1: "linear", 2: "bilinear", 3: "trilinear"}


class _Visit(NamedTuple):
    """What a step knows of one tensor. `light` is D in this visit, `received` its sum, from `lit` values."""

    kind: Curvature
    group: dict[str, Any]
    parameter: torch.Tensor
    gradient: torch.Tensor
    shares: list[torch.Tensor]
    light: torch.Tensor
    received: float
    lit: int


class LeastSquares(torch.optim.Optimizer):
    """Steps as long as a picture's derivatives say: for colours, textures, lights, and other maps.

    The loss is L = mean w^2 (I - T)^2 over the n values of a picture I. A gradient step is divided by a diagonal D in
    place of the second derivative, ``a -= lr * g / D``, so that it is right in the parameter's units and depends
    neither on the scene nor on its size. D is found with the gradient's random numbers; of a rendering of one camera as
    it is, by the gradient's paths, which are traced once. There are two kinds, by groups of parameters, with
    J = dI / da:

    ``"light"``
        Pictures become brighter with parameters a >= 0, nearly in proportion: colours, textures, lamps, environment
        maps. Then::

            D_t = 2 / n  sum_p  w_p^2 J_pt I_p / a_t

        is a bound, with which L does not grow if I = J a (De Pierro, "On the relation between the ISRA and the EM
        algorithm for positron emission tomography", IEEE Transactions on Medical Imaging 12, 1993). Most of the noise
        of J goes out of the quotient: a texel moves by the mean of what the pixels that show it say. (Entries below a
        hundredth of a tensor's typical value are divided by that in place of their own, or black ones would stay black;
        so they may move by as much, to and fro.)

    ``"signs"``
        Anything else that has many entries, each of which few pixels show: maps of roughness and normals, densities of
        smoke. ::

            D_t = 2 / n  sum_p  w_p^2 J_pt^2

        the diagonal of Gauss and Newton's matrix, is estimated with random signs s of the picture's values, since that
        is the mean of ``2 / n (sum_p s_p w_p J_pt)^2``, from `probes` such sums (Bekas, Kokiopoulou and Saad, "An
        estimator for the diagonal of a matrix", Applied Numerical Mathematics 57, 2007). It is no bound, for what a
        pixel's parameters have in common is left out: hence steps of 0.3, or less where that would go too far along
        the line, by the same random sums or because a loss cannot fall by more than itself. It is noisy, too: hence
        more damping, and at least 0.15 of D's mean. The signs are of `torch.manual_seed`.

    Two more things make steps of few samples useful. D is a sum over visits, in which each is worth `memory` of the
    next one, so that views of the same texel are averaged. And an entry of a texture or grid that has not had `damping`
    pixels' worth of D moves as its neighbourhood of four by four does, which has had that of sixteen, and so on up
    a pyramid: large features come first, and texels between the paths are not left behind.

    The steps need the picture, not a loss::

        optimizer = tr.optim.LeastSquares(
            [{"params": [colour]}, {"params": [roughness, normals], "curvature": "signs", "low": 0.05}], high=1.0
        )
        for it in range(20):
            optimizer.zero_grad()
            picture = renderer(sensor=it % 10, spp=4, seed=it)
            loss = optimizer.step(picture, targets[it % 10])

    The gradient is in ``.grad`` afterwards as ``loss.backward()`` would leave it, also of parameters that this
    optimiser does not have, such as a position, for an Adam that makes its step then. What ``.grad`` had before is
    part of the step: the gradient of a prior, which is weighed against a mean over all values; or, where `zero_grad`
    was forgotten, that of the last step.

    What it is not for:

    * By light: what makes pictures darker or sharper. It is refused where that shows.
    * By signs: single numbers that all pixels show, such as one roughness or a pose. What is noise in J is in J^2, too,
      which makes their steps short; Adam finds them sooner. Nor priors that are strong beside the loss, which do not
      count in the length of steps: where pictures are right to the last digit, nothing moves.
    * Light by way of many reflections grows faster than in proportion. In closed bright rooms the loss jumps up and
      down; ``lr=0.3`` helps.
    * The last digits by one or two samples a pixel: the noise of a picture is in D, too, which by light leaves results
      too bright, by 2 to 3 % on a wall under a lamp and a sky with one sample, by nothing to be seen with four. More
      samples, or ``memory`` near 1, at the end.
    * Other light in the same pixels, which does not depend on the parameters, makes steps by light shorter than they
      need be.
    * Processes that share parameters would make different steps: D is not exchanged.

    Args:
        params: tensors, or parameter groups; by light of values >= 0, and not all of them 0.
        lr: factor of the steps; None: 1 by light, which is right where light is linear in the parameters, 0.3 by signs.
            (This and what follows, where given here, is for groups of both kinds that say nothing else.)
        curvature: ``"light"`` or ``"signs"``.
        probes: by signs, random sums of a step, each of them a sweep over the paths. Few, down to 1, are quicker, and
            enough for grids that many pixels show; for maps single entries may then move much too far in the first
            steps (with 4, the loss of a highlight's roughness grew to five times in one first step of 100; with 8 to
            1.5 times at most).
        damping: how much of D an entry has to have had until it moves by itself more than with others, in units of what
            a value of the picture brings in the mean, whether it shows the parameter or not; None: 3 by light, 10 by
            signs. More for textures finer than the pixels, noisy pictures, and objects that fill a small part of them
            (10 to 30); less where every texel fills pixels of its own, and for grids (1 to 3).
        memory: weight of an earlier visit beside the next one, from 0 to 1. More averages more noise, of about
            1 / (1 - memory) visits; less takes fewer steps where parameters share their pixels or other things change.
        low: numbers, or tensors that broadcast to the parameters, below which no step goes; None: 0 by light, which
            allows for nothing less, no bound by signs.
        high: the same above.
        dims: number of leading axes along which entries have neighbours; None: all but the last of three or four
            (textures (H, W, C), grids (Z, Y, X, C)), else none.

    Raises:
        ValueError: for options out of range.
    """

    def __init__(
        self,
        params: Iterable[torch.Tensor] | Iterable[dict[str, Any]],
        lr: float | None = None,
        *,
        curvature: str = "light",
        probes: int = 8,
        damping: float | None = None,
        memory: float = 0.5,
        low: float | torch.Tensor | None = None,
        high: float | torch.Tensor = float("inf"),
        dims: int | None = None,
    ) -> None:
        defaults = {"lr": lr, "curvature": curvature, "probes": probes, "damping": damping, "memory": memory}
        super().__init__(params, {**defaults, "low": low, "high": high, "dims": dims})

    def __setstate__(self, state: dict[str, Any]) -> None:
        """That of an optimiser from before there were random signs."""
        super().__setstate__(state)
        for group in self.param_groups:
            group.setdefault("curvature", "light")
            group.setdefault("probes", 8)

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Add parameters with options of their own, checked here."""
        options = {**self.defaults, **{k: v for k, v in param_group.items() if k != "params"}}
        curvature = curvature_of(options)
        for name in ("lr", "damping", "low"):
            if options[name] is None:
                options[name] = getattr(curvature, name)
        if not 0 <= float(options["lr"]) < math.inf:
            raise ValueError(f"lr: expected a number >= 0, got {options['lr']!r}")
        if not 0 < float(options["damping"]) < math.inf:
            raise ValueError(f"damping: expected a number of pixels > 0, got {options['damping']!r}")
        if not 0 <= float(options["memory"]) <= 1:
            raise ValueError(f"memory: expected a number from 0 to 1, got {options['memory']!r}")
        if not bool(torch.as_tensor(options["low"]).min() >= curvature.low):
            raise ValueError(f"low: expected nothing below {curvature.low:g}, got {options['low']!r}")
        if not bool((torch.as_tensor(options["high"]) >= torch.as_tensor(options["low"])).all()):
            raise ValueError(f"high: expected nothing below low, {options['low']!r}, got {options['high']!r}")
        dims = options["dims"]
        if dims is not None and not (isinstance(dims, int) and 0 <= dims <= 3):
            raise ValueError(f"dims: expected 0, 1, 2, 3 or None, got {dims!r}")
        super().add_param_group({**param_group, **options})
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
                Hooks, and `retain_grad`, see the derivatives that D is made of, too.
            target: of the same shape. What is not finite may have the weight 0.
            weight: by which differences are multiplied, w; broadcasts to the picture. None: 1.

        Returns:
            The mean of w^2 (image - target)^2 before the step, a scalar without a graph.

        Raises:
            ValueError: if shapes differ; by light, if values are negative or all 0, or pictures do not become brighter
                with a parameter.
            RuntimeError: if picture, target, weight or a derivative are not finite. In both cases all values are as
                before.
        """
        if not image.requires_grad:
            raise ValueError("image: it has no graph; no parameter of it requires a gradient")
        learned: dict[Curvature, list[tuple[dict[str, Any], torch.Tensor]]] = {}
        for group in self.param_groups:
            curvature = curvature_of(group)
            for parameter in group["params"]:
                if parameter.requires_grad and parameter.numel():
                    _check_shapes(parameter, group)
                    curvature.check(parameter)
                    learned.setdefault(curvature, []).append((group, parameter))
        picture = image.detach()
        weight, weighted, loss = _compare(picture, target, weight)
        scale = 2 / picture.numel()
        adjoints = {kind: kind.adjoints(picture, weight, scale) for kind in learned}
        others = [([p for _, p in learned[kind]], adjoint) for kind, some in adjoints.items() for adjoint in some]
        products = iter(backward_and_grads(image, weighted.mul_(scale), others))
        with torch.no_grad():
            visits = []
            for kind, some in adjoints.items():
                lit = int(some[0].count_nonzero())
                for (group, parameter), *shares in zip(learned[kind], *(next(products) for _ in some), strict=True):
                    gradient = parameter.grad
                    if gradient is None or any(share is None for share in shares):
                        continue
                    if not all(bool(each.sum().isfinite()) for each in (gradient, *shares)):
                        raise RuntimeError(
                            f"the picture's derivative by {words(parameter)} is not finite; no step was made"
                        )
                    light = kind.diagonal(parameter, *shares)
                    received = float(light.sum())
                    if not math.isfinite(received):
                        raise RuntimeError(f"D of {words(parameter)} is not finite; no step was made")
                    if received > 0:
                        visits.append(_Visit(kind, group, parameter, gradient, shares, light, received, lit))
            changes = [self._direction(visit) for visit in visits]
            longest = {kind: _longest(kind, loss, visits, changes) for kind in adjoints}
            for (kind, group, parameter, *_), change in zip(visits, changes, strict=True):
                rate = min(group["lr"], longest[kind])
                torch.sub(parameter, change, alpha=rate, out=change)
                low, high = (_like(group[name], parameter) for name in ("low", "high"))
                torch.clamp(change, low, high, out=parameter)
        return loss

    def _direction(self, visit: _Visit) -> torch.Tensor:
        """The gradient by D, of which a step is a part."""
        kind, group, parameter, gradient, _, light, received, lit = visit
        state = self.state[parameter]
        if not state:
            state["light"] = torch.zeros_like(parameter)
            state["pixel"], state["visits"] = 0.0, 0.0
        memory = group["memory"]
        state["visits"] = memory * state["visits"] + 1
        state["pixel"] += (received / lit - state["pixel"]) / state["visits"]
        # Entries that get no light, or next to none by stray paths, were not visited, and forget nothing.
        mean = received / int(light.count_nonzero())
        visited = light + STRAY * mean
        torch.div(light, visited, out=visited)
        whole = state["light"]
        whole.addcmul_(whole, visited, value=memory - 1).add_(light)
        damping = max(group["damping"] * state["pixel"], torch.finfo(parameter.dtype).tiny)
        if not kind.bounds:
            damping = max(damping, UNSURE * mean)
        return _shared(gradient, whole, damping, _dims_of(parameter, group["dims"]))


def _longest(kind: Curvature, loss: torch.Tensor, visits: list[_Visit], changes: list[torch.Tensor]) -> float:
    """A length of the steps of a kind that is safe where D is no bound, since it leaves out what parameters share.

    Along the change c a loss with the second derivative H falls by x g c - x^2 c H c / 2, most with x = g c / (c H c).
    The signs estimate c H c as they do D. Where they are few, it is chance, but not that the fall, (g c)^2 / (2 c H c),
    is no more than the loss L: x is at most 2 L / (g c), of which this has half.
    """
    if kind.bounds:
        return math.inf
    mine = [(visit, change) for visit, change in zip(visits, changes, strict=True) if visit.kind is kind]
    slope = sum(float((visit.gradient * change).sum()) for visit, change in mine)
    if slope <= 0:
        return math.inf
    products = [[float((share * change).sum()) for share in visit.shares] for visit, change in mine]
    bend = sum(sum(of_one_sum) ** 2 for of_one_sum in zip(*products, strict=True))
    return min(float(loss) / slope, slope / bend if bend > 0 else math.inf)


def _compare(picture: torch.Tensor, target: Any, weight: Any) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The weight of each value, w, and w^2 (I - T), of which nothing else has this memory; the loss."""
    target = _like(target, picture)
    if target.shape != picture.shape:
        raise ValueError(f"target: expected the picture's shape {tuple(picture.shape)}, got {tuple(target.shape)}")
    w = _like(1.0 if weight is None else weight, picture)
    try:
        w = w.expand(picture.shape)
    except RuntimeError:
        raise ValueError(
            f"weight: {tuple(w.shape)} does not broadcast to the picture's {tuple(picture.shape)}"
        ) from None
    difference = torch.where(w != 0, picture - target, picture.new_zeros(()))
    weighted = w * w * difference
    loss = (weighted * difference).mean()
    if not bool(loss.isfinite()):
        raise RuntimeError("image, target or weight is not finite; no step was made")
    return w, weighted, loss


def _like(value: Any, tensor: torch.Tensor) -> torch.Tensor:
    """A number or a tensor in the precision of another, where that lies."""
    return torch.as_tensor(value, dtype=tensor.dtype, device=tensor.device).detach()


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
            raise ValueError(f"{name}: {tuple(shape)} does not broadcast to {words(parameter)}")


def _dims_of(parameter: torch.Tensor, dims: int | None) -> int:
    if dims is None:
        return parameter.dim() - 1 if parameter.dim() in (3, 4) else 0
    return dims


def _shared(
    gradient: torch.Tensor, light: torch.Tensor, damping: float, dims: int, both: torch.Tensor | None = None
) -> torch.Tensor:
    """Gradient / light where light is more than `damping`, and else that of the neighbourhood.

    A weighted mean of both, with the same at a quarter of the size for the neighbourhood; at the smallest size with 0.
    `both`: gradient and light in one tensor, if there is one, which halves the number of sums.
    """
    if max(gradient.shape[:dims], default=1) < STEP:
        return gradient / (light + damping)
    if both is None:
        sums = torch.stack([_summed(gradient, 0, dims), _summed(light, 0, dims)])
    else:
        sums = _summed(both, 1, dims)
    coarse = _shared(sums[0], sums[1], damping, dims, sums)
    # In the order of memory that the gradient has, and not its neighbourhood's.
    return torch.add(gradient, _spread(coarse, gradient.shape, dims), alpha=damping).div_(light + damping)


def _summed(grid: torch.Tensor, first: int, dims: int) -> torch.Tensor:
    """Sums of four entries along each of `dims` axes from `first` on; the last may be of fewer."""
    for dim in range(first, first + dims):
        count = grid.shape[dim]
        rest = count % STEP
        whole = grid.narrow(dim, 0, count - rest).unflatten(dim, (count // STEP, STEP))
        # slice by slice, which is quicker than a sum along a short axis
        slices = whole.unbind(dim + 1)
        sums = slices[0] + slices[1]
        for each in slices[2:]:
            sums += each
        grid = torch.cat([sums, grid.narrow(dim, count - rest, rest).sum(dim, keepdim=True)], dim) if rest else sums
    return grid


def _spread(grid: torch.Tensor, shape: torch.Size, dims: int) -> torch.Tensor:
    """The same at four times the size along the leading axes, interpolated linearly, cut to `shape`."""
    channels = grid.reshape(*grid.shape[:dims], -1).movedim(-1, 0)[None]
    finer = torch.nn.functional.interpolate(channels, scale_factor=STEP, mode=_LINEAR[dims])
    for dim in range(dims):
        finer = finer.narrow(dim + 2, 0, shape[dim])
    return finer[0].movedim(0, -1).reshape(shape)
