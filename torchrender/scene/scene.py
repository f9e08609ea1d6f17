"""The scene as a module: its settings, its parameters by dotted name, and the core's copy of it.

Its objects are in `container`, what they refer to in `references`, which parameters are trained in `training`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, overload

import torch
from torch import nn

from .. import backends
from ..errors import nearest
from ..integrators import Integrator
from .camera import PerspectiveCamera
from .container import Container, with_settings
from .context import Context
from .film import Film
from .native import NativeScene
from .packing import Layout, pack
from .plugin import Plugin
from .sensor import Sensor
from .structure import structure_changed, structure_epoch
from .summary import summarise
from .training import parameters_by_every_name, train_only

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ..render_types import OutputNames, Outputs, RenderSettings

Operation = TypeVar("Operation", bound=Callable[..., Any])
POLARIZED = "_polarized"
VARIANTS = tuple(f"{color}{mode}" for color in ("mono", "rgb", "spectral") for mode in ("", POLARIZED))

_operations: dict[str, Callable[..., Any]] = {}


def operation(name: str) -> Callable[[Operation], Operation]:
    """Decorator: the function is what a scene does under this name, ``"render"`` or ``"save"``.

    Both build on scenes, so that this file cannot import them.
    """

    def add(function: Operation) -> Operation:
        _operations[name] = function
        return function

    return add


class Scene(Container):
    """A scene: shapes, materials, lights and cameras by id; every continuous quantity is a parameter.

    Made by `load_dict` and `load_file`. Objects are attributes and items: ``scene.red``, ``scene["red"]``; they are
    added, replaced and removed by ``scene["id"] = dict or object`` and ``del scene["id"]``. Parameters do not require
    gradients until they are told to.
    """

    statistics: dict[str, Any]
    warned: set[str]  # what was warned about, which is done once

    def __init__(
        self,
        objects: Mapping[str, Any],
        variant: str = "rgb",
        dtype: torch.dtype = torch.float32,
        folder: Path | None = None,
        wavelength: float | None = None,
    ) -> None:
        super().__init__()
        self._color = variant.removesuffix(POLARIZED)
        self._polarized = variant.endswith(POLARIZED)
        self._wavelength = wavelength
        self._dtype = dtype
        self._device = torch.device("cpu")
        self._native: NativeScene | None = None
        self._epoch = -1
        self._layout: Layout | None = None
        self.__dict__["statistics"] = {}
        self.__dict__["warned"] = set()
        self._watch: Any = None  # of parameters that leave their ranges, see `ranges`
        ctx = self._context(folder)
        camera = PerspectiveCamera(film=Film(1, 1), _context=ctx.at("camera"))
        # Cameras that are no part of the scene are rendered in the place of one of these.
        self._placeholders: dict[tuple[str, ...], Sensor] = {camera.kind(): camera}
        for name, value in with_settings(objects).items():
            self._put(name, value, ctx, resolve=False)
        self._resolve(ctx)

    # -------------------------------------------------------------------------------------------------- settings
    @property
    def variant(self) -> str:
        """Colour mode, ``"rgb"``, ``"mono"`` or ``"spectral"``, with ``"_polarized"`` if its light is polarised."""
        return self._color + (POLARIZED if self._polarized else "")

    @property
    def polarized(self) -> bool:
        """Whether images are of polarised light without being asked for Stokes vectors."""
        return self._polarized

    @property
    def wavelength(self) -> float | None:
        """Where a mono scene has its spectra, in nm; None if it has their luminance."""
        return self._wavelength

    @property
    def dtype(self) -> torch.dtype:
        """Precision of all parameters and of the rendering."""
        return self._dtype

    @property
    def device(self) -> torch.device:
        """Where the scene lies."""
        return self._device

    @property
    def channels(self) -> int:
        """Number of colour channels of an image, 3, but 1 in mono."""
        return 1 if self._color == "mono" else 3

    @property
    def sensors(self) -> list[Sensor]:
        """Cameras and meters, in the order of the scene."""
        return [m for m in self._modules.values() if isinstance(m, Sensor)]

    @property
    def integrator(self) -> Integrator | None:
        """The scene's own integrator, or None."""
        return next((m for m in self._modules.values() if isinstance(m, Integrator)), None)

    @property
    def film(self) -> Film | None:
        """The first camera's film, or None."""
        sensors = self.sensors
        return sensors[0].film if sensors else None

    def _context(self, folder: Path | None = None) -> Context:
        return Context(self._color, self._dtype, path=(), folder=folder, wavelength=self._wavelength)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a Mitsuba 3 XML file, and ``meshes/*.ply``, ``textures/*.exr`` and ``volumes/*.vol`` beside it.

        `load_file` gives a scene of the same objects, names and values: in single precision its images have the same
        bits. Of a double-precision scene, textures and volumes are rounded; in mono, colours become plain numbers.
        What is not saved: which parameters require gradients, and vertex normals of meshes that are shaded flat.
        Normals are brought to unit length when they are loaded.

        Args:
            path: ends in ``.xml``; its folder is made if it is not there, and files of the same names are overwritten.

        Raises:
            ValueError: naming the object that a scene file has no form for.
        """
        _operations["save"](self, path)

    # ------------------------------------------------------------------------------------------------ parameters
    def named_modules(
        self, memo: set[nn.Module] | None = None, prefix: str = "", remove_duplicate: bool = True
    ) -> Iterator[tuple[str, nn.Module]]:
        """All modules with their dotted names; an object that others use comes once, under its own id, in any case.

        With ``remove_duplicate=False`` torch would list it under every name, and `torch.func.functional_call`, which
        takes its names from there, would then leave its substitutes in the scene when it returns.
        """
        return super().named_modules(memo if remove_duplicate else None, prefix, True)

    def get_parameter(self, target: str) -> nn.Parameter:
        """The parameter of this dotted name; AttributeError names the nearest ones."""
        try:
            return super().get_parameter(target)
        except AttributeError:
            known = list(parameters_by_every_name(self))
            raise AttributeError(f"the scene has no parameter {target!r}; {nearest(target, known)}") from None

    def train_only(self, *patterns: str) -> list[nn.Parameter]:
        """Let exactly the parameters that match one of the glob `patterns` require gradients, and return them.

        ``scene.train_only("*.reflectance.*")``; called without patterns nothing requires gradients any more. Of the
        parameters that a pattern matches, those that have derivatives are chosen. The ``to_uv`` of a texture is chosen
        by a pattern that names it only: ``"*.reflectance.*"`` means colours. So are ``vertex_normals`` that are
        computed from the positions: they follow these, and what an optimiser writes into them is overwritten.

        Raises:
            ValueError: a pattern matches nothing.
            NotDifferentiableError: nothing that a pattern matches has a derivative.
        """
        return train_only(self, patterns)

    @property
    def updates(self) -> dict[str, int]:
        """How often parts of the core's copy of this scene were made so far; empty before the first rendering.

        ``"scenes"``: the whole, because objects or shapes of parameters changed; ``"meshes"``, ``"quadrics"``: shapes
        whose geometry was set; ``"tree_builds"``: the acceleration structure; ``"mesh_refits"``, ``"mesh_rebuilds"``:
        one mesh's part of it, fitted to moved vertices or made again because that had made it slow;
        ``"environments"``: tables of an environment map; ``"height_fields"``: ranges of heights; ``"sdf_grids"``: empty
        space around surfaces. What did not change is not made again. Counting begins anew when objects come or go.
        """
        return {} if self._native is None else self._native.counters()

    def rebuild(self) -> None:
        """Let the next rendering make the core's copy of this scene anew, as the first one of a process does.

        A tree that follows moving meshes depends on where they have been: of two triangles that meet where a ray passes
        it may find one, a tree that is built at once the other. A program that calls this wherever it writes or reads a
        checkpoint finds the same after an interruption, bit for bit. Costs as much as building the scene.
        """
        self._native = None

    def bounding_box(self) -> torch.Tensor:
        """Smallest axis-aligned box around all shapes: (2, 3), lower and upper corner; ValueError without shapes."""
        boxes = [m.bounds() for m in self._modules.values() if isinstance(m, Plugin) and m.category == "shape"]
        if not boxes:
            raise ValueError("bounding_box: the scene has no shapes")
        stacked = torch.stack(boxes)
        return torch.stack([stacked[:, 0].amin(0), stacked[:, 1].amax(0)])

    # ---------------------------------------------------------------------------------------------------- module
    @overload
    def forward(self, *, outputs: None = None, **settings: Unpack[RenderSettings]) -> torch.Tensor: ...

    @overload
    def forward(self, *, outputs: OutputNames, **settings: Unpack[RenderSettings]) -> Outputs: ...

    def forward(self, **settings: Any) -> torch.Tensor | Outputs:
        """``scene(...)`` is ``render(scene, ...)``."""
        return _operations["render"](self, **settings)

    if TYPE_CHECKING:  # that of nn.Module is Callable[..., Any]

        @overload
        def __call__(self, *, outputs: None = None, **settings: Unpack[RenderSettings]) -> torch.Tensor: ...

        @overload
        def __call__(self, *, outputs: OutputNames, **settings: Unpack[RenderSettings]) -> Outputs: ...

        def __call__(self, **settings: Any) -> torch.Tensor | Outputs: ...

    def _apply(self, fn: Callable[[torch.Tensor], torch.Tensor], recurse: bool = True) -> Scene:
        super()._apply(fn, recurse)
        for camera in self._placeholders.values():
            camera._apply(fn)
        first = next((p for camera in self._placeholders.values() for p in camera.parameters()), None)
        if first is not None:
            self._dtype, self._device = first.dtype, first.device
        structure_changed()
        return self

    def __getstate__(self) -> dict[str, Any]:
        # The native scene is a cache: copies and files go without, and make their own when they render.
        return {**self.__dict__, "_native": None, "_watch": None, "_layout": None, "_epoch": -1, "statistics": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        # torch.load may have brought the tensors elsewhere
        self._device = next(iter(self._placeholders.values())).to_world.device

    def __repr__(self) -> str:
        return summarise(self)

    # ---------------------------------------------------------------------------------------------------- packing
    def layout(self) -> Layout:
        """The packed structure, made anew only if some scene object changed since."""
        epoch = structure_epoch()
        if self._layout is None or self._epoch != epoch:
            self._layout = pack(self, self._placeholders.values())
            self._epoch = epoch
        return self._layout

    def admit(self, camera: Sensor) -> None:
        """Make room for rendering a camera that is no part of the scene."""
        if camera.kind() not in self._placeholders:
            self._placeholders[camera.kind()] = camera.placeholder(self._context().at("camera"))
            structure_changed()

    def native(self, layout: Layout, shapes: list[tuple[int, ...]]) -> NativeScene:
        """The native scene for this structure and these shapes of parameters, built if there is none yet."""
        native = self._native
        if (
            native is not None
            and native.dtype == self._dtype
            and native.home == self.device
            and native.core is backends.scene_core(self._dtype, self.device)
            and native.shapes == shapes
            and (native.layout is layout or native.layout.objects == layout.objects)
            and native.index_key == layout.index_key()
        ):
            return native
        native = NativeScene(layout, self._color, self._dtype, shapes, previous=native, home=self.device)
        self._native = native
        return native
