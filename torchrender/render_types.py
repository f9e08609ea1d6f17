"""Types of what `render` takes and gives, for editors and type checkers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict

import numpy as np
import torch

from .integrators import Integrator
from .scene.sensor import Sensor

SensorLike: TypeAlias = int | str | Sensor | Sequence[int | str | Sensor] | torch.Tensor | np.ndarray
"""Index or name of a camera of the scene, a camera, a list of them, or an integer tensor or array of indices (B,)."""
IntegratorName: TypeAlias = Literal[
    "path",
    "prb",
    "prb_basic",
    "prb_projective",
    "volpath",
    "volpathmis",
    "depth",
    "prbvolpath",
    "ptracer",
    "direct",
    "direct_projective",
    "aov",
    "moment",
    "stokes",
]
IntegratorLike: TypeAlias = Integrator | Mapping[str, Any] | IntegratorName | str
"""An integrator, the dict that describes one, or the name of its type."""
PixelsLike: TypeAlias = torch.Tensor | np.ndarray | Sequence[Sequence[int]]
"""Rows and columns (N, 2), integers."""
LayoutName: TypeAlias = Literal["hwc", "chw", "bhwc", "bchw"]
OutputName: TypeAlias = Literal[
    "rgb",
    "alpha",
    "variance",
    "second_moment",
    "stokes",
    "dolp",
    "aolp",
    "docp",
    "depth",
    "distance",
    "position",
    "normal",
    "shading_normal",
    "normal_camera",
    "shading_normal_camera",
    "uv",
    "barycentric",
    "dp_du",
    "dp_dv",
    "albedo",
    "specular_reflectance",
    "roughness",
    "shape_id",
    "prim_id",
    "material_id",
    "duv_dx",
    "duv_dy",
    "features",
]
OutputNames: TypeAlias = Sequence[OutputName | str]
"""Names of outputs; those of meshes' colours are free, and so are strings that a program makes."""
NanMode: TypeAlias = Literal["drop", "raise"]
InterruptMode: TypeAlias = Literal["raise", "return"]
RangeMode: TypeAlias = Literal["warn", "raise", "ignore"]
SamplerName: TypeAlias = Literal["independent", "stratified", "sobol"]


class RendererSettings(TypedDict, total=False):
    """The keyword arguments of `Renderer`, without `outputs`, on which the type of its result depends."""

    sensor: SensorLike
    integrator: IntegratorLike | None
    spp: int | None
    seed: int | torch.Generator | None
    spp_grad: int | None
    seed_grad: int | torch.Generator | None
    passes: int
    features: Mapping[str, torch.Tensor] | None
    size: Sequence[int] | None
    crop: Sequence[int] | None
    pixels: PixelsLike | None
    layout: LayoutName
    correlated: bool
    adaptive_grad: bool
    nan: NanMode
    sampler: SamplerName | None
    range: RangeMode
    progress: bool | None
    visibility: bool
    spp_visibility: int | tuple[int, int] | None
    on_interrupt: InterruptMode


class RenderSettings(RendererSettings, total=False):
    """Those of `render` and of a call of a `Renderer`."""

    params: Mapping[str, torch.Tensor] | Sequence[Mapping[str, torch.Tensor]] | None


if TYPE_CHECKING:

    class Outputs(tuple[torch.Tensor, ...]):
        """What ``render(scene, outputs=names)`` gives: a named tuple of tensors in the order of the names."""

        _fields: tuple[str, ...]
        rgb: torch.Tensor
        alpha: torch.Tensor
        variance: torch.Tensor
        second_moment: torch.Tensor
        stokes: torch.Tensor
        dolp: torch.Tensor
        aolp: torch.Tensor
        docp: torch.Tensor
        depth: torch.Tensor
        distance: torch.Tensor
        position: torch.Tensor
        normal: torch.Tensor
        shading_normal: torch.Tensor
        normal_camera: torch.Tensor
        shading_normal_camera: torch.Tensor
        uv: torch.Tensor
        barycentric: torch.Tensor
        dp_du: torch.Tensor
        dp_dv: torch.Tensor
        duv_dx: torch.Tensor
        duv_dy: torch.Tensor
        albedo: torch.Tensor
        specular_reflectance: torch.Tensor
        roughness: torch.Tensor
        shape_id: torch.Tensor
        prim_id: torch.Tensor
        material_id: torch.Tensor
        features: torch.Tensor

        def __getattr__(self, name: str) -> torch.Tensor:
            """Colours of meshes, by their names."""
            ...

        def _asdict(self) -> dict[str, torch.Tensor]: ...

else:
    Outputs = tuple  # made by `torchrender.outputs.outputs_type` for the names that are asked for
