"""`Renderer`, a scene and how to render it as a layer of a network."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

import torch
from torch import nn

from .errors import describe, nearest
from .interruption import interruption_of
from .outputs import check_names
from .render import render
from .render_arguments import as_integrator, check_kinds_of_derivative, check_words, count
from .render_types import OutputNames, Outputs, RendererSettings, RenderSettings
from .reuse import Memory, ReuseName, check_reuse
from .scene.scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Unpack

Result = TypeVar("Result")


class Renderer(nn.Module, Generic[Result]):
    """A scene and how to render it, as a layer: calling it is `render` with these settings as defaults.

    Args:
        scene: a `Scene`; its parameters are this module's.
        train: patterns of the parameters that require gradients, as of `Scene.train_only`; None leaves them.
        reuse: ``"image"`` makes pictures of what the last call of the view has found and of samples of the difference
            to it, ``"both"`` gradients, too; None does not. Unbiased (see `torchrender.recursion`), with less variance
            where parameters change little from call to call, at the price of rendering twice. The state is this
            module's, in `state_dict`, too. In evaluation mode, without recorded derivatives and in forward mode
            pictures are plain, and nothing is kept. A view whose scene, film, integrator or frozen parameters have
            changed is estimated anew, with one UserWarning. Not with ``outputs``, ``correlated``, ``on_interrupt``,
            cameras that are no part of the scene, `TorchBSDF`, nor ``"both"`` with ``adaptive_grad``.
        settings: keyword arguments of `render`, each of which a call may override.

    Raises:
        TypeError, ValueError: for unknown settings, those that `render` refuses, and what `reuse` does not go with;
            with it `spp`, and for ``"both"`` `spp_grad`, have to be even.
    """

    scene: Scene
    settings: dict[str, Any]

    @overload
    def __init__(
        self: Renderer[torch.Tensor],
        scene: Scene,
        *,
        train: str | Sequence[str] | None = None,
        reuse: ReuseName | None = None,
        outputs: None = None,
        **settings: Unpack[RendererSettings],
    ) -> None: ...

    @overload
    def __init__(
        self: Renderer[Outputs],
        scene: Scene,
        *,
        train: str | Sequence[str] | None = None,
        reuse: ReuseName | None = None,
        outputs: OutputNames,
        **settings: Unpack[RendererSettings],
    ) -> None: ...

    def __init__(
        self,
        scene: Scene,
        *,
        train: str | Sequence[str] | None = None,
        reuse: ReuseName | None = None,
        **settings: Any,
    ) -> None:
        super().__init__()
        if not isinstance(scene, Scene):
            raise TypeError(f"Renderer: scene: expected a Scene (see load_dict, load_file), got {describe(scene)}")
        accepted = [k for k in inspect.signature(render).parameters if k not in ("scene", "params")]
        for name in settings:
            if name not in accepted:
                raise TypeError(f"Renderer: unknown argument {name!r}; {nearest(name, accepted)}")
        self.scene = scene
        self.settings = settings
        if settings.get("integrator") is not None:
            as_integrator(scene, settings["integrator"])
        for name in ("spp", "spp_grad", "passes"):
            if settings.get(name) is not None:
                count(name, settings[name])
        words = {"layout": "hwc", "nan": "drop", "sampler": None, "range": "warn"}
        check_words(*(settings.get(name, default) for name, default in words.items()))
        check_kinds_of_derivative(settings.get("adaptive_grad", False), settings.get("correlated", False))
        interruption_of(settings.get("on_interrupt", "raise"))
        if settings.get("outputs") is not None:
            check_names(settings["outputs"])
        if train is not None:
            scene.train_only(*([train] if isinstance(train, str) else train))
        self.memory: Memory | None = None
        if reuse is not None:
            check_reuse(reuse, scene, settings)
            self.memory = Memory(reuse)

    @overload
    def forward(self, *, view: int | str | None = None, **overrides: Unpack[RenderSettings]) -> Result: ...

    @overload
    def forward(
        self, *, view: int | str | None = None, outputs: None, **overrides: Unpack[RenderSettings]
    ) -> torch.Tensor: ...

    @overload
    def forward(
        self, *, view: int | str | None = None, outputs: OutputNames, **overrides: Unpack[RenderSettings]
    ) -> Outputs: ...

    def forward(self, *, view: int | str | None = None, **overrides: Any) -> Any:
        """Render; keyword arguments are those of `render`.

        Args:
            view: which pictures follow one another, for `reuse`, where one camera has several: by other lamps, say.
            overrides: as of `render`.
        """
        settings = {**self.settings, **overrides}
        if self.memory is not None and self.memory.works():
            return self.memory(self.scene, settings, view)
        return render(self.scene, **settings)

    def reset(self) -> None:
        """Forget what earlier calls have found; without `reuse` there is nothing."""
        if self.memory is not None:
            self.memory.reset()

    if TYPE_CHECKING:  # that of nn.Module is Callable[..., Any]

        @overload
        def __call__(self, *, view: int | str | None = None, **overrides: Unpack[RenderSettings]) -> Result: ...

        @overload
        def __call__(
            self, *, view: int | str | None = None, outputs: None, **overrides: Unpack[RenderSettings]
        ) -> torch.Tensor: ...

        @overload
        def __call__(
            self, *, view: int | str | None = None, outputs: OutputNames, **overrides: Unpack[RenderSettings]
        ) -> Outputs: ...

        def __call__(self, **overrides: Any) -> Any: ...

    def extra_repr(self) -> str:
        return ", ".join(f"{k}={v!r}" for k, v in self.settings.items())
