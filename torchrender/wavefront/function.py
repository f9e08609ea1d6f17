"""A rendering in chunks, and its derivative: chunks that are traced again and differentiated one by one."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from ..errors import RenderError, depth_outside, describe, nearest
from ..functions import DerivativeFunction, UnbatchedFunction, refuse_batches
from ..interruption import Interruption
from ..progress import steps
from ..render_call import RenderCall
from ..scene.derivatives import moves_rays
from ..scene.gradient_requirements import GradientRequirements
from ..scene.host_memory import on_host
from ..scene.native import NativeScene
from ..scene.packing import Layout
from ..scene.scene import Scene
from ..seeds import mix
from .film import Samples, Splats, Spread
from .numbers import Numbers, pixel_key
from .path import WavefrontTracer
from .world import World

# What a native rendering and one in PyTorch have in common.
SHARED = (
    "native size spp seed spp_grad seed_grad passes progress nan alpha statistics requirements layout interruption"
).split()


class TorchParameters(nn.Module):
    """The parameters of all BSDFs of a scene that are written in PyTorch, each once, and calls with others in place."""

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        modules = list(dict.fromkeys(layout.torch_bsdfs.values()))
        self.bsdfs = nn.ModuleList(modules)
        places = {id(module): i for i, module in enumerate(modules)}
        self.prefix = {path: f"bsdfs.{places[id(module)]}." for path, module in layout.torch_names.items()}

    def tensors(self, params: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """Tensors by their names here, those of `params` (by their names in the scene) in place of the modules' own."""
        found: dict[str, torch.Tensor] = dict(self.named_parameters())
        index = {id(tensor): name for name, tensor in found.items()}
        for name, tensor in params.items():
            own = self._own(name)
            if own is None:
                raise KeyError(name)
            if not isinstance(tensor, torch.Tensor):
                raise TypeError(f"render: params: {name}: expected a tensor, got {describe(tensor)}")
            if tensor.shape != own.shape:
                raise ValueError(
                    f"render: params: {name}: expected shape {tuple(own.shape)}, got {tuple(tensor.shape)}"
                )
            found[index[id(own)]] = tensor
        return {name: on_host(tensor) for name, tensor in found.items()}

    def _own(self, name: str) -> torch.Tensor | None:
        parameters = dict(self.named_parameters(remove_duplicate=False))
        for path, prefix in self.prefix.items():
            if name.startswith(f"{path}."):
                return parameters.get(prefix + name[len(path) + 1 :])
        return None

    def owns(self, name: str) -> bool:
        return self._own(name) is not None

    def names(self) -> list[str]:
        """All names that parameters have in the scene."""
        parameters = [n for n, _ in self.named_parameters(remove_duplicate=False)]
        return [f"{path}.{n[len(p) :]}" for path, p in self.prefix.items() for n in parameters if n.startswith(p)]

    def forward(self, function: Callable[[], Any]) -> Any:
        return function()


def split_params(layout: Layout, params: Any) -> tuple[Mapping[str, torch.Tensor] | None, dict[str, torch.Tensor]]:
    """`params` of `render` without those of BSDFs written in PyTorch, and those."""
    if not params or not isinstance(params, Mapping) or not layout.torch_bsdfs:
        return params, {}
    torch_parameters = TorchParameters(layout)
    of_torch = {n: t for n, t in params.items() if isinstance(n, str) and torch_parameters.owns(n)}
    for name in params:
        inside = any(isinstance(name, str) and name.startswith(f"{path}.") for path in layout.torch_names)
        if inside and name not in of_torch:
            raise ValueError(
                f"render: params: the scene has no parameter {name!r}; {nearest(name, torch_parameters.names())}"
            )
    return {n: t for n, t in params.items() if n not in of_torch}, of_torch


@dataclass
class WavefrontCall:
    """Everything of one rendering of one sensor that is no tensor; fields as in `RenderCall`."""

    scene: Scene
    native: NativeScene
    layout: Layout
    config: dict[str, Any]
    sensor: int
    film_size: tuple[int, int]
    splats: Splats
    size: tuple[int, ...]
    spp: int
    seed: int
    spp_grad: int
    seed_grad: int
    passes: int
    progress: bool | None
    nan: str
    alpha: bool
    sampler: str
    statistics: dict[str, Any]
    requirements: GradientRequirements
    interruption: Interruption
    parameters: TorchParameters
    names: list[str]  # of the last tensors, those of `parameters`

    @property
    def slots(self) -> int:
        return len(self.layout.slots)

    def moving(self, needed: Sequence[bool]) -> bool:
        """Whether one of the tensors that derivatives are `needed` of moves rays or hits."""
        return any(moves_rays(slot) for slot, n in zip(self.layout.slots, needed, strict=False) if n)

    def traced(self, tensors: Sequence[torch.Tensor], needed: Sequence[bool] | None = None) -> Iterator[Chunk]:
        """Chunks of all passes, traced; attached to the `needed` ones of `tensors`, if that is given."""
        derivative = needed is not None
        world = World(
            self.scene, self.layout, self.native, tensors[: self.slots], derivative and self.moving(needed or ())
        )
        modules = {f"{name}": t for name, t in zip(self.names, tensors[self.slots :], strict=True)}
        spp, seed = (self.spp_grad, self.seed_grad) if derivative else (self.spp, self.seed)
        lost = paths = 0
        try:
            for number in steps(range(self.passes), "passes", self.progress):
                random = Numbers(
                    self.sampler, spp, seed if number == 0 else mix(seed, number), self.sensor, world.dtype
                )
                tracer = WavefrontTracer(world, self.config, random, derivative)
                total = len(self.splats.sources) * spp
                starts = range(0, total, self.config["chunk"])
                for start in steps(starts, "chunks", self.progress):
                    index = torch.arange(start, min(start + self.config["chunk"], total))
                    samples = self.splats.samples(index, spp, random)
                    with torch.set_grad_enabled(derivative):
                        radiance, alpha = self._trace(tracer, samples, modules)
                    bad = ~torch.isfinite(radiance.detach()).all(1)
                    paths += len(index)
                    if bool(bad.any()):
                        lost += int(bad.sum())
                        samples, radiance, alpha = self._drop(tracer, samples, modules, bad, radiance, alpha)
                    yield Chunk(number, samples, radiance, alpha)
        except KeyboardInterrupt:
            if self.interruption.returns and not derivative:
                self._finish("render", paths, lost, world.nonfinite_where)
            raise
        self._finish("vjp" if derivative else "render", paths, lost, world.nonfinite_where)

    def _trace(
        self, tracer: WavefrontTracer, samples: Samples, modules: dict[str, torch.Tensor]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        world = tracer.world
        world.begin()
        rays = world.camera_rays(self.sensor, self.film_size, samples.positions, samples.lens)
        if not world.moving:
            rays = type(rays)(*(t.detach() for t in rays))

        def trace() -> Any:
            return tracer.trace(rays, pixel_key(*samples.pixel.unbind(1)), samples.sample)

        elsewhere = {n: on_host(b) for n, b in self.parameters.named_buffers() if b.device.type != "cpu"}
        return torch.func.functional_call(self.parameters, {**elsewhere, **modules}, (trace,))

    def _drop(
        self,
        tracer: WavefrontTracer,
        samples: Samples,
        modules: dict[str, torch.Tensor],
        bad: torch.Tensor,
        radiance: torch.Tensor,
        alpha: torch.Tensor,
    ) -> tuple[Samples, torch.Tensor, torch.Tensor]:
        """Samples without those that are not finite, which count as black.

        For a derivative the others are traced once more without them, because values that are not finite go through
        the graph even where their weight is zero.
        """
        if not radiance.requires_grad:
            return samples, torch.where(bad[:, None], 0.0, radiance), alpha
        samples = samples[~bad]
        with torch.enable_grad():
            return samples, *self._trace(tracer, samples, modules)

    def _finish(self, kind: str, paths: int, lost: int, where: str) -> None:
        self.statistics[kind] = {"paths": paths, "nonfinite": lost, "nonfinite_where": where}
        if lost:
            self.complain(f"{lost} samples were not finite" + (f", first at {where}" if where else ""))

    def complain(self, text: str) -> None:
        if self.nan == "raise":
            raise RenderError(text)
        warnings.warn(text + "; they were dropped", RuntimeWarning, stacklevel=depth_outside())

    def spread(self, samples: Samples) -> Spread:
        return self.splats.spread(samples.pixel, samples.offset)

    def weights(self) -> torch.Tensor:
        """Sums of the filter's weights (count, passes) of the derivative's samples, which are known beforehand."""
        sums = torch.zeros(self.splats.count, self.passes, dtype=torch.float64, device="cpu")
        for number in range(self.passes):
            seed = self.seed_grad if number == 0 else mix(self.seed_grad, number)
            random = Numbers(self.sampler, self.spp_grad, seed, self.sensor, self.native.dtype)
            total = len(self.splats.sources) * self.spp_grad
            for start in range(0, total, self.config["chunk"]):
                index = torch.arange(start, min(start + self.config["chunk"], total))
                samples = self.splats.samples(index, self.spp_grad, random)
                one = torch.ones(len(index), 1, dtype=torch.float64)
                self.spread(samples).add(sums[:, number : number + 1], one)
        return sums

    def image(self, values: torch.Tensor) -> torch.Tensor:
        """Values (count, K) of the pixels that are wanted, as the result has them."""
        found = values[self.splats.where].to(self.native.dtype)
        return found.reshape(*self.size, values.shape[1])


@dataclass
class Chunk:
    """Samples of one pass, by its number, and what their paths found: radiance (N, C) and alpha (N,)."""

    number: int
    samples: Samples
    radiance: torch.Tensor
    alpha: torch.Tensor


def on_cpu() -> AbstractContextManager[Any]:
    """Where tensors are made, whatever torch's default device is."""
    return nullcontext() if torch.empty(0).device.type == "cpu" else torch.device("cpu")


def share(sums: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """``sums / weights``, 0 where there are none."""
    return torch.where(weights > 0, sums / torch.where(weights > 0, weights, 1.0), 0.0)


class WavefrontFunction(UnbatchedFunction):
    """``image[, alpha] = WavefrontFunction.apply(call, *tensors)``: those of the slots, then those of modules."""

    @staticmethod
    def forward(call: WavefrontCall, *tensors: torch.Tensor) -> Any:
        with on_cpu():
            return WavefrontFunction.render(call, tensors)

    @staticmethod
    def render(call: WavefrontCall, tensors: Sequence[torch.Tensor]) -> Any:
        channels = call.native.channels
        empty = torch.zeros(call.splats.count, channels + 2, dtype=torch.float64, device="cpu")
        sums = [empty.clone() for _ in range(call.passes)]
        complete = 0  # passes
        try:
            for chunk in call.traced([t.detach() for t in tensors]):
                complete = chunk.number
                if complete and call.interruption.happened:  # in an earlier view
                    break
                one = torch.ones_like(chunk.alpha)[:, None]
                columns = torch.cat([chunk.radiance, chunk.alpha[:, None], one], 1)
                call.spread(chunk.samples).add(sums[chunk.number], columns)
            else:
                complete = call.passes
        except KeyboardInterrupt:
            if not complete or not call.interruption.returns:
                raise
            call.interruption.happened = True
        call.interruption.count(complete * call.spp, call.passes * call.spp)
        call.passes = complete
        total = torch.stack([share(s[:, :-1], s[:, -1:]) for s in sums[:complete]]).mean(0)
        image = call.image(total[:, :channels])
        return (image, call.image(total[:, channels:])[..., 0]) if call.alpha else image

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        call, *tensors = inputs
        ctx.call = call
        ctx.save_for_backward(*tensors)
        ctx.save_for_forward(*tensors)
        ctx.set_materialize_grads(False)
        if isinstance(output, tuple):
            ctx.mark_non_differentiable(output[1])

    @staticmethod
    def backward(ctx: Any, grad_image: torch.Tensor | None, *_: Any) -> Any:
        needed = ctx.needs_input_grad[1:]
        tensors = ctx.saved_tensors
        if grad_image is None or not any(needed):
            return (None,) * (1 + len(needed))
        return (None, *WavefrontVjpFunction.apply(ctx.call, needed, grad_image, *tensors))

    @staticmethod
    def jvp(ctx: Any, _call: Any, *tangents: torch.Tensor | None) -> Any:
        call = ctx.call
        call.requirements.check(i for i, t in enumerate(tangents[: call.slots]) if t is not None)
        tangent = WavefrontJvpFunction.apply(call, *ctx.saved_tensors, *tangents)
        return (tangent, None) if call.alpha else tangent


def leaves(tensors: Sequence[torch.Tensor], needed: Sequence[bool]) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """Copies of `tensors` that share their memory, of which the `needed` ones require gradients, and those alone."""
    copies = [t.detach().requires_grad_(bool(n)) for t, n in zip(tensors, needed, strict=True)]
    return copies, [t for t in copies if t.requires_grad]


class WavefrontVjpFunction(DerivativeFunction):
    """``gradients = WavefrontVjpFunction.apply(call, needed, adjoint, *tensors)``."""

    @staticmethod
    def forward(call: WavefrontCall, needed: tuple[bool, ...], adjoint: torch.Tensor, *tensors: torch.Tensor) -> Any:
        refuse_batches(adjoint)
        with on_cpu():
            return WavefrontVjpFunction.pull(call, needed, adjoint, tensors)

    @staticmethod
    def pull(
        call: WavefrontCall, needed: tuple[bool, ...], adjoint: torch.Tensor, tensors: Sequence[torch.Tensor]
    ) -> tuple[torch.Tensor | None, ...]:
        channels = call.native.channels
        adjoint = adjoint.detach().double().reshape(-1, channels)
        of_film = torch.zeros(call.splats.count, channels, dtype=torch.float64, device="cpu")
        of_film.index_add_(0, call.splats.where, adjoint)
        weights = call.weights()
        attached, sought = leaves(tensors, needed)
        gradients = [torch.zeros_like(t) for t in sought]
        for chunk in call.traced(attached, needed):
            if not chunk.radiance.requires_grad:
                continue
            of_pass = share(of_film, weights[:, chunk.number, None]) / call.passes
            of_samples = call.spread(chunk.samples).collect(of_pass).to(chunk.radiance.dtype)
            found = torch.autograd.grad(chunk.radiance, sought, of_samples, allow_unused=True)
            for total, gradient in zip(gradients, found, strict=True):
                if gradient is not None:
                    total += gradient
        for gradient in gradients:
            if not bool(torch.isfinite(gradient).all()):
                call.complain("a derivative is not finite in some places")
                gradient.nan_to_num_(0.0, 0.0, 0.0)
        result = iter(gradients)
        return tuple(next(result) if n else None for n in needed)


class WavefrontJvpFunction(DerivativeFunction):
    """``tangent = WavefrontJvpFunction.apply(call, *tensors, *tangents)``.

    Samples' tangents J v are the derivative of the linear function <u, J v> = <J' u, v> with respect to u.
    """

    @staticmethod
    def forward(call: WavefrontCall, *given: torch.Tensor | None) -> torch.Tensor:
        with on_cpu():
            return WavefrontJvpFunction.push(call, given)

    @staticmethod
    def push(call: WavefrontCall, given: Sequence[torch.Tensor | None]) -> torch.Tensor:
        count = len(given) // 2
        tensors: list[Any] = list(given[:count])
        needed = [t is not None for t in given[count:]]
        attached, sought = leaves(tensors, needed)
        tangents = [
            t.detach().to(p.dtype).expand(p.shape) for t, p in zip(given[count:], tensors, strict=True) if t is not None
        ]
        channels = call.native.channels
        sums = torch.zeros(call.passes, call.splats.count, channels, dtype=torch.float64, device="cpu")
        for chunk in call.traced(attached, needed):
            if not chunk.radiance.requires_grad:
                continue
            with torch.enable_grad():
                u = torch.zeros_like(chunk.radiance, requires_grad=True)
                pulled = torch.autograd.grad(chunk.radiance, sought, u, create_graph=True, allow_unused=True)
                terms = [(g * t).sum() for g, t in zip(pulled, tangents, strict=True) if g is not None]
                if not terms:
                    continue
                (pushed,) = torch.autograd.grad(torch.stack(terms).sum(), u)
            call.spread(chunk.samples).add(sums[chunk.number], pushed)
        weights = call.weights().T[..., None]
        total = share(sums, weights).mean(0)
        if not bool(torch.isfinite(total).all()):
            call.complain("a derivative is not finite in some places")
            total.nan_to_num_(0.0, 0.0, 0.0)
        return call.image(total)


def wavefront_call(
    scene: Scene, call: RenderCall, integrator: Mapping[str, Any], of_torch: Mapping[str, torch.Tensor]
) -> WavefrontRendering:
    """The rendering that a native `call` describes, by this integrator; `of_torch` are tensors for modules' own."""
    parameters = TorchParameters(call.layout)
    named = parameters.tensors(of_torch)
    with on_cpu():
        splats = Splats(call.film, call.config["crop"], call.config["window"], call.pixels)
    shared = {name: getattr(call, name) for name in SHARED}
    made = WavefrontCall(
        scene=scene,
        config=dict(integrator),
        sensor=call.config["sensor"],
        film_size=call.config["film_size"],
        splats=splats,
        sampler=call.config["sampler"],
        parameters=parameters,
        names=list(named),
        **shared,
    )
    return WavefrontRendering(made, call.share.replicated(list(named.values())))


@dataclass
class WavefrontRendering:
    """A call and the modules' tensors for it."""

    call: WavefrontCall
    of_torch: list[torch.Tensor]

    def apply(self, tensors: Sequence[torch.Tensor]) -> Any:
        """``image[, alpha]``, with `tensors` in the scene's slots."""
        return WavefrontFunction.apply(self.call, *tensors, *self.of_torch)


def check_scene(layout: Layout) -> None:
    """What this integrator does not have, by its place in the scene."""
    if layout.media:
        raise ValueError(
            "render: integrator: WavefrontPathTracer does not trace through media, which the scene has; "
            "VolumetricPathTracer ('volpath') does"
        )


def refuse_torch_bsdfs(layout: Layout, message: str) -> None:
    """ValueError, if something in the scene has a BSDF written in PyTorch; what that is stands for {} in `message`."""
    for path, module in layout.torch_names.items():
        if id(module) in layout.used:
            what = f"{path} ({type(module).__name__}) is a BSDF written in PyTorch"
            raise ValueError(message.format(what))
