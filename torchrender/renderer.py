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
from .scene.scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Unpack

Result = TypeVar("Result")


class Renderer(nn.Module, Generic[Result]):
    """A scene and how to render it, as a layer: calling it is `render` with these settings as defaults.

    Args:
        scene: a `Scene`; its parameters are this module's.
        train: patterns of the parameters that require gradients, as of `Scene.train_only`; None leaves them.
        settings: keyword arguments of `render`, each of which a call may override.
    """

    scene: Scene
    settings: dict[str, Any]

    @overload
    def __init__(
        self: Renderer[torch.Tensor],
        scene: Scene,
        *,
        train: str | Sequence[str] | None = None,
        outputs: None = None,
        **settings: Unpack[RendererSettings],
    ) -> None: ...

    @overload
    def __init__(
        self: Renderer[Outputs],
        scene: Scene,
        *,
        train: str | Sequence[str] | None = None,
        outputs: OutputNames,
        **settings: Unpack[RendererSettings],
    ) -> None: ...

    def __init__(self, scene: Scene, *, train: str | Sequence[str] | None = None, **settings: Any) -> None:
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

    @overload
    def forward(self, **overrides: Unpack[RenderSettings]) -> Result: ...

    @overload
    def forward(self, *, outputs: None, **overrides: Unpack[RenderSettings]) -> torch.Tensor: ...

    @overload
    def forward(self, *, outputs: OutputNames, **overrides: Unpack[RenderSettings]) -> Outputs: ...

    def forward(self, **overrides: Any) -> Any:
        """Render; keyword arguments are those of `render`."""
        return render(self.scene, **{**self.settings, **overrides})

    if TYPE_CHECKING:  # that of nn.Module is Callable[..., Any]

        @overload
        def __call__(self, **overrides: Unpack[RenderSettings]) -> Result: ...

        @overload
        def __call__(self, *, outputs: None, **overrides: Unpack[RenderSettings]) -> torch.Tensor: ...

        @overload
        def __call__(self, *, outputs: OutputNames, **overrides: Unpack[RenderSettings]) -> Outputs: ...

        def __call__(self, **overrides: Any) -> Any: ...

    def extra_repr(self) -> str:
        return ", ".join(f"{k}={v!r}" for k, v in self.settings.items())
