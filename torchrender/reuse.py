"""What a `Renderer` keeps between calls with ``reuse``: of each view its last estimates, and their parameters.

Each call renders every view four times with half of its samples: with two seeds at its parameters, and with the same
two at those of the view's last picture; see `torchrender.recursion` for what that gives.

Reservoirs that carry light paths from iteration to iteration (Chang, Sivaram, Nowrouzezahrai, Hašan, Ramamoorthi,
Georgiev, Hachisuka, "Parameter-space ReSTIR for Differentiable and Inverse Rendering", SIGGRAPH 2023; Wang, Wyman, Wu,
Zhao, "Amortizing Samples in Physics-Based Inverse Rendering using ReSTIR", SIGGRAPH Asia 2023) keep a few paths for
each texel or pixel, whose contributions are evaluated again at other parameters. Here paths are not kept but named by
their seed, and a sweep evaluates all paths of a seed for all parameters: there is no single path that could be chosen
for a texel. But all paths of a seed can be evaluated at two sets of parameters, which is what a recursion takes.
"""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import torch
from torch import nn
from torch.autograd import Function

from .autograd import reattach
from .compiling import opaque
from .errors import depth_outside, describe, nearest
from .fingerprints import Fingerprints, remembered
from .functions import functorch
from .integrators import Stack, Stokes
from .recursion import Recursion
from .render import arrange, render, sensors_of_list
from .render_arguments import as_integrator, count
from .render_sensors import chosen_sensors, layout_with_room
from .scene.packing import Layout
from .scene.scene import Scene
from .scene.sensor import Sensor, default_sampler
from .scene.values import in_forward_mode
from .seeds import mix, seeds
from .shares import ALONE
from .shares import current as current_share

ReuseName: TypeAlias = Literal["image", "both"]
KINDS = ("image", "both")
SECOND_CHAIN = 0x7265757365  # what tells the seeds of the second chain


@dataclass
class View:
    """What is kept of one view.

    Attributes:
        described: all that its pictures depend on, but the values in `params`; see `Fingerprints`.
        params: values of what is learned or given, at the last picture.
        image: the picture's recursion.
        gradients: those of the gradients, by parameter.
        adjoint: the incoming gradient of the last picture, once its backward pass was there.
        past: gradients at the parameters of the view's picture before, until then: two of each parameter.
    """

    described: dict[str, Any]
    params: dict[str, torch.Tensor]
    image: Recursion = field(default_factory=Recursion)
    gradients: dict[str, Recursion] = field(default_factory=dict)
    adjoint: torch.Tensor | None = None
    past: list[tuple[torch.Tensor, ...]] | None = None


def check_reuse(reuse: Any, scene: Scene, settings: Mapping[str, Any]) -> None:
    """Errors for what cannot be reused in this way."""
    if not isinstance(reuse, str):
        raise TypeError(f"Renderer: reuse: expected {' or '.join(map(repr, KINDS))} or None, got {describe(reuse)}")
    if reuse not in KINDS:
        raise ValueError(f"Renderer: reuse: unknown kind {reuse!r}; {nearest(reuse, KINDS)}")
    if settings.get("outputs") is not None:
        raise ValueError("Renderer: reuse: it is the picture that is estimated; leave outputs out, or use tr.render")
    if isinstance(as_integrator(scene, settings.get("integrator")), (Stack, Stokes)):
        raise ValueError(
            "Renderer: reuse: it is the picture of an integrator without further outputs that is estimated"
        )
    if settings.get("correlated"):
        raise ValueError(
            "Renderer: reuse: correlated=True has the derivative of one picture, this one is made of several"
        )
    if settings.get("on_interrupt", "raise") != "raise":
        raise ValueError("Renderer: reuse: the rest of an interrupted picture is no step; leave on_interrupt out")
    if reuse == "both" and settings.get("adaptive_grad"):
        raise ValueError(
            "Renderer: reuse='both' needs equal samples of old and new gradients, and adaptive_grad=True has others; "
            "reuse='image' goes with it"
        )
    for name in ("spp", "spp_grad") if reuse == "both" else ("spp",):
        if settings.get(name) is not None:
            halved(name, count(name, settings[name]))


def halved(name: str, number: int) -> int:
    """Half a number of samples, which has to be even."""
    if number % 2:
        raise ValueError(f"Renderer: reuse: {name} has to be even, for samples come in two halves; got {number}")
    return number // 2


class Memory(nn.Module):
    """The views of a `Renderer` with ``reuse``, by its argument `view` and the number of their camera.

    Args:
        kind: ``"image"`` or ``"both"``.
    """

    def __init__(self, kind: ReuseName) -> None:
        super().__init__()
        self.kind = kind
        self.views: dict[tuple[Hashable, int], View] = {}
        self.fingerprints = Fingerprints()
        self.warned = False

    def reset(self) -> None:
        """Forget all views."""
        self.views.clear()

    def works(self) -> bool:
        """Whether pictures are reused: in training mode, where derivatives are recorded, and not in forward mode."""
        inside = in_forward_mode() or functorch.maybe_current_level() is not None
        return self.training and torch.is_grad_enabled() and not inside

    @opaque
    def forward(self, scene: Scene, settings: dict[str, Any], view: Hashable = None) -> torch.Tensor:
        """`render` with these settings, and with what is known of the view."""
        check_reuse(self.kind, scene, settings)
        if current_share() is not ALONE:
            raise ValueError("Renderer: reuse: pictures that processes share are not reused")
        sensor, params = settings.get("sensor", 0), settings.get("params")
        packed = layout_with_room(scene, sensor)
        if packed.torch_bsdfs:
            raise ValueError("Renderer: reuse: scenes with a TorchBSDF are not reused")
        cameras, batched = chosen_sensors(packed, sensor, one_size=settings.get("size") is None)
        for index, camera in cameras:
            if index >= packed.own_sensors:
                raise ValueError(
                    f"Renderer: reuse: pictures of the scene's own cameras are reused, not of {describe(camera)}: "
                    "scene['name'] = camera"
                )
        if isinstance(params, Sequence):
            sensors_of_list(sensor, params)
        by_camera = params if isinstance(params, Sequence) else [params] * len(cameras)
        first, gradient = seeds(settings.get("seed"), settings.get("seed_grad"), False)
        pictures = []
        for (index, camera), own in zip(cameras, by_camera, strict=True):
            changed = {"sensor": index, "seed": first, "seed_grad": gradient, "params": own, "layout": "hwc"}
            pictures.append(self._picture(scene, packed, camera, {**settings, **changed}, (view, index)))
        return arrange(pictures, batched, settings.get("layout", "hwc"), -1)

    def _picture(
        self, scene: Scene, packed: Layout, camera: Sensor, settings: dict[str, Any], key: tuple[Hashable, int]
    ) -> torch.Tensor:
        now = remembered(packed, settings["params"])
        described = self.fingerprints.describe(scene, packed, camera, settings, now)
        last = self.views.get(key)
        if last is not None and last.described != described:
            self._warn(last.described, described)
            last = None
        samples = settings.get("spp")
        samples = default_sampler(camera).sample_count if samples is None else count("spp", samples)
        calls = calls_of(settings, samples, self.kind)
        view = View(described, {name: tensor.detach().clone() for name, tensor in now.items()})
        learned = {name: tensor for name, tensor in now.items() if tensor.requires_grad}
        both = self.kind == "both" and bool(learned)
        if both:
            leaves = GradientFunction.apply(view, last, list(learned), *learned.values())
            calls = [
                {**call, "params": {**now, **dict(zip(learned, leaves[i::2], strict=True))}}
                for i, call in enumerate(calls)
            ]
        # What is wrong with arguments is said before the past is rendered; statistics are those of the last call.
        first = rendered(scene, calls[0])
        olds = None if last is None else past(scene, calls, last, list(learned), view)
        with torch.set_grad_enabled(both):
            fresh = [first, rendered(scene, calls[1])]
        value, view.image = (Recursion() if last is None else last.image).step(fresh, olds)
        self.views[key] = view
        if both:
            return PictureFunction.apply(view, value, *fresh)
        return reattach(value, first) if first.requires_grad else value

    def _warn(self, before: dict[str, Any], now: dict[str, Any]) -> None:
        if self.warned:
            return
        self.warned = True
        other = " and ".join(name for name in now if now[name] != before.get(name))
        warnings.warn(
            f"Renderer: reuse: since the last picture of a view {other} changed; it is estimated anew. "
            "renderer.reset() before such a change says nothing",
            UserWarning,
            stacklevel=depth_outside(),
        )

    def get_extra_state(self) -> dict[str, Any]:
        """Of `state_dict`: what `torch.load` takes with ``weights_only=True``."""
        views = []
        for (name, index), view in self.views.items():
            gradients = {key: recursion.state() for key, recursion in view.gradients.items()}
            stored = {"described": view.described, "params": view.params, "adjoint": view.adjoint}
            views.append({"view": name, "sensor": index, "image": view.image.state(), "gradients": gradients, **stored})
        return {"kind": self.kind, "views": views}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Of `load_state_dict`. ValueError if the state is of another kind."""
        if state["kind"] != self.kind:
            raise ValueError(f"Renderer: reuse is {self.kind!r}, but the state that is loaded has {state['kind']!r}")
        self.views = {}
        for stored in state["views"]:
            gradients = {key: Recursion.restored(chains) for key, chains in stored["gradients"].items()}
            image = Recursion.restored(stored["image"])
            view = View(stored["described"], stored["params"], image, gradients, stored["adjoint"])
            self.views[stored["view"], stored["sensor"]] = view

    def extra_repr(self) -> str:
        return f"{self.kind!r}, views={len(self.views)}"


def rendered(scene: Scene, settings: dict[str, Any], **changed: Any) -> torch.Tensor:
    """The picture with these settings of `render`."""
    return render(scene, **{**settings, **changed})


def calls_of(settings: dict[str, Any], samples: int, kind: str) -> list[dict[str, Any]]:
    """The two renderings of a picture. In that of an image the first one has all of the derivative."""
    count_grad = samples if settings.get("spp_grad") is None else count("spp_grad", settings["spp_grad"])
    if kind == "both":
        count_grad = halved("spp_grad", count_grad)
    first = {**settings, "spp": halved("spp", samples), "spp_grad": count_grad}
    other = {name: mix(settings[name], SECOND_CHAIN) for name in ("seed", "seed_grad")}
    return [first, {**first, **other}]


def past(
    scene: Scene, calls: Sequence[dict[str, Any]], last: View, learned: list[str], view: View
) -> list[torch.Tensor]:
    """Pictures from the random numbers of `calls` at the last parameters; `view` gets gradients of the same."""
    if last.adjoint is None:
        with torch.no_grad():
            return [rendered(scene, call, params=last.params) for call in calls]
    images, view.past = [], []
    for call in calls:
        leaves = {name: last.params[name].detach().requires_grad_() for name in learned}
        image = rendered(scene, call, params={**last.params, **leaves})
        view.past.append(torch.autograd.grad(image, list(leaves.values()), last.adjoint))
        images.append(image.detach())
    return images


class PictureFunction(Function):
    """``picture = PictureFunction.apply(view, value, first, second)``: the value, with the derivative of both.

    Each gets all of the incoming gradient: `GradientFunction` takes the mean.
    """

    @staticmethod
    def forward(ctx: Any, view: View, value: torch.Tensor, *_: torch.Tensor) -> torch.Tensor:
        ctx.view = view
        return value.clone()

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> Any:
        (adjoint,) = grads
        if ctx.view.adjoint is None:
            ctx.view.adjoint = adjoint.detach().clone()
        return None, None, adjoint, adjoint


class GradientFunction(Function):
    """``a, b, c, d, ... = GradientFunction.apply(view, last, names, *params)``: each parameter for both renderings.

    The gradient is the recursion's. Further backward passes of the same picture have that of the fresh samples.
    """

    @staticmethod
    def forward(ctx: Any, view: View, last: View | None, names: list[str], *params: torch.Tensor) -> Any:
        ctx.view, ctx.last, ctx.names = view, last, names
        return tuple(tensor.detach() for tensor in params for _ in range(2))

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> Any:
        view, before = ctx.view, {} if ctx.last is None else ctx.last.gradients
        pairs = list(zip(grads[0::2], grads[1::2], strict=True))
        if view.gradients:
            return (None, None, None, *((a + b) / 2 for a, b in pairs))
        found = []
        olds = zip(*view.past, strict=True) if view.past else [None] * len(pairs)
        for name, fresh, old in zip(ctx.names, pairs, olds, strict=True):
            value, view.gradients[name] = before.get(name, Recursion()).step(fresh, old)
            found.append(value)
        view.past = ctx.last = None
        return (None, None, None, *found)
