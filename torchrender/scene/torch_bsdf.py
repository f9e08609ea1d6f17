"""BSDFs written in PyTorch: modules that stand in a scene where a BSDF stands."""

from __future__ import annotations

import functools
import math
from typing import Any, ClassVar, NamedTuple

import torch

from ..errors import describe
from ..warp import cosine_hemisphere
from .context import Context
from .declaration import Field, Model
from .plugin import Plugin


class SurfaceInteraction(NamedTuple):
    """N points of surfaces, as a `TorchBSDF` sees them.

    `position`, `normal` (geometric), `shading_normal` (N, 3) in world space, the latter as a normal or bump map around
    the BSDF perturbs it; `uv`, `barycentric` (N, 2); `shape_id` (position among the scene's shapes) and
    `prim_id` (N,) int64.
    """

    position: torch.Tensor
    normal: torch.Tensor
    shading_normal: torch.Tensor
    uv: torch.Tensor
    barycentric: torch.Tensor
    shape_id: torch.Tensor
    prim_id: torch.Tensor


class TorchBSDF(Plugin):
    """Base of BSDFs that are written in PyTorch, for `WavefrontPathTracer`, the integrator that evaluates them.

    A subclass has `eval`, and everything that a module has::

        class Tinted(tr.TorchBSDF):
            def __init__(self):
                super().__init__()
                self.albedo = torch.nn.Parameter(torch.tensor([0.8, 0.5, 0.2]))

            def eval(self, si, wi, wo):
                return self.albedo * wo[:, 2:].clamp(min=0) / math.pi

        scene = tr.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": Tinted()}, ...})
        image = tr.render(scene, integrator=tr.WavefrontPathTracer(max_depth=3))

    Its parameters are the scene's (``ball.bsdf.albedo``) and require gradients unless they are told not to. They are
    brought to the scene's dtype. The image is differentiable in them by autograd, through whatever `eval` does.

    Directions are local (N, 3) unit vectors: +z is the shading normal, `wi` points to where the path comes from, `wo`
    to where the light comes from. The other two axes are some that go with the normal, so that only `wi` and `wo`
    together have a meaning around it. A BSDF may let light through (``wo[:, 2] < 0``); then it has `pdf` and `sample`
    of its own, since by default directions are cosine-distributed on the side of +z, and light from behind is black.

    `pdf` and `sample` are called without gradients: what is sampled is constant in the derivative, which is that of the
    integral nevertheless. They come together: who writes one writes the other. Both see the same numbers of rows, from
    1 to ``WavefrontPathTracer.chunk``.

    (``eval()`` without arguments is ``train(False)``, as for every module.)

    Args:
        two_sided: surfaces look alike from both sides: behind them, both directions are mirrored before the BSDF gets
            them. Light does not pass.

    Raises:
        TypeError: the subclass has no `eval`, or one of `pdf` and `sample` without the other.
    """

    category: ClassVar[str] = "bsdf"
    type: ClassVar[str] = "torch"
    open: ClassVar[bool] = True

    def __init__(self, *, two_sided: bool = False) -> None:
        super().__init__()
        name, cls = type(self).__name__, type(self)
        if not isinstance(two_sided, bool):
            raise TypeError(f"{name}: two_sided: expected True or False, got {describe(two_sided)}")
        if cls.eval is TorchBSDF.eval:
            raise TypeError(f"{name}: a BSDF written in PyTorch needs a method eval(self, si, wi, wo) -> (N, C)")
        if (cls.pdf is TorchBSDF.pdf) != (cls.sample is TorchBSDF.sample):
            missing = "pdf" if cls.pdf is TorchBSDF.pdf else "sample"
            raise TypeError(f"{name}: pdf and sample belong together: {missing} is missing")
        self.two_sided = two_sided

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        written = cls.__dict__.get("eval")
        if callable(written):

            @functools.wraps(written)
            def evaluate(self: TorchBSDF, *arguments: Any, **named: Any) -> Any:
                return written(self, *arguments, **named) if arguments or named else self.train(False)

            cls.eval = evaluate

    # ------------------------------------------------------------------------------------- what a subclass writes
    def eval(self, *arguments: Any) -> Any:
        """``eval(si, wi, wo)``: value (N, C), the BSDF times ``|cos(wo)|``; C is 3, or 1 in mono.

        It has to be finite and not negative; what is not finite is dropped and reported.
        """
        raise NotImplementedError(f"{type(self).__name__}.eval(si, wi, wo)")

    def pdf(self, si: SurfaceInteraction, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        """Density (N,) per solid angle with which `sample` takes `wo`; 0 where light from there is not looked at."""
        return torch.where((wi[:, 2] > 0) & (wo[:, 2] > 0), wo[:, 2] / math.pi, 0.0)

    def sample(self, si: SurfaceInteraction, wi: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Directions `wo` (N, 3) from uniform numbers `u` (N, 3) in [0, 1), and their densities (N,), 0 for none."""
        wo = cosine_hemisphere(u[:, 1], u[:, 2])
        return wo, torch.where(wi[:, 2] > 0, wo[:, 2] / math.pi, 0.0)

    # ------------------------------------------------------------------------------------------------ as a plugin
    @classmethod
    def model(cls) -> Model:
        """A model without declared fields: the parameters of the module are its own."""
        return Model(cls.category, cls.type, cls.__doc__ or "", ())

    @classmethod
    def fields(cls) -> dict[str, Field]:
        return {}

    def adapt(self, ctx: Context) -> None:
        """Take over dtype of a scene; parameters keep their identity."""
        for tensor in (*self.parameters(), *self.buffers()):
            if tensor.is_floating_point() and ctx.dtype is not None and tensor.dtype != ctx.dtype:
                tensor.data = tensor.data.to(ctx.dtype)
        self.__dict__["_color"] = ctx.color

    def extra_repr(self) -> str:
        return "two_sided=True" if self.__dict__.get("two_sided") else ""
