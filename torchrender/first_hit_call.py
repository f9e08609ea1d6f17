"""The names of outputs, and what is asked of those of the first hit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch

from .render_call import RenderCall

# What the path tracer itself gives: numbers a pixel, -1 for those of a colour, 0 for a plain number.
PATH_OUTPUTS = {"rgb": -1, "alpha": 0, "variance": -1, "second_moment": -1}
# Of polarised light, functions of the first one: see polarization.py.
STOKES_OUTPUTS = {"stokes": -4, "dolp": -1, "aolp": -1, "docp": -1}
FIRST_HIT_OUTPUTS = {
    "depth": 0,
    "distance": 0,
    "position": 3,
    "normal": 3,
    "shading_normal": 3,
    "normal_camera": 3,
    "shading_normal_camera": 3,
    "uv": 2,
    "barycentric": 2,
    "dp_du": 3,
    "dp_dv": 3,
    "albedo": -1,
    "specular_reflectance": -1,
    "roughness": 0,
    "shape_id": 0,
    "prim_id": 0,
    "material_id": 0,
}
# Found in PyTorch, see footprints.py and features.py.
FOOTPRINTS = {"duv_dx": 2, "duv_dy": 2}
OUTPUTS = {**PATH_OUTPUTS, **STOKES_OUTPUTS, **FIRST_HIT_OUTPUTS, **FOOTPRINTS}
FEATURES = "features"  # needs the argument of this name
IDENTIFIERS = ("shape_id", "prim_id", "material_id")
ATTRIBUTES = ("vertex_", "face_")
"""What names of colours of meshes begin with, which are outputs, too; a colour's numbers a pixel."""
MAX_ATTRIBUTES = 4
# In the order of the core, csrc/core/integrator/aovs.h; colours of meshes come after them.
CHANNELS = {"depth": 0, "distance": 0, "ray_length": 0, **FIRST_HIT_OUTPUTS}


def channels_of(name: str) -> int:
    """Numbers a pixel, -1 for those of a colour, -4 for four a colour, 0 for a plain number."""
    return {**OUTPUTS, **CHANNELS}.get(name, -1)


@dataclass
class FirstHitCall:
    """What outputs of the first hit are asked for, besides tensors.

    Attributes:
        render: the rendering that these outputs belong to.
        names: of the outputs, keys of FIRST_HIT_OUTPUTS or ``"ray_length"``, the distance from the near plane.
        zero_at_misses: average over all samples, taking zero for those that hit nothing.
        attributes: numbers of those names that are colours of meshes.
    """

    render: RenderCall
    names: tuple[str, ...]
    zero_at_misses: bool = False
    attributes: dict[str, int] = field(default_factory=dict)

    def config(self, derivative: bool) -> dict[str, Any]:
        configs = self.render.configs(derivative)
        return {**configs[0], "seeds": [c["seed"] for c in configs], **self.settings()}

    def settings(self) -> dict[str, Any]:
        """What the core has to know besides the settings of the rendering."""
        return {"zero_at_misses": self.zero_at_misses, "attributes": list(self.attributes.values())}

    def core_names(self) -> dict[str, str]:
        """Those that are averages, by their names in the core and in its order."""
        numbered = {f"attribute_{i}": name for i, name in enumerate(self.attributes)}
        known = {**dict.fromkeys(CHANNELS), **dict.fromkeys(numbered)}
        names = {core: numbered.get(core, core) for core in known if core not in IDENTIFIERS}
        return {core: name for core, name in names.items() if name in self.names}

    def addresses(self, tensors: Mapping[str, torch.Tensor]) -> dict[str, int]:
        """Where outputs lie, by their names in the core."""
        numbered = {name: f"attribute_{i}" for i, name in enumerate(self.attributes)}
        return {numbered.get(name, name): tensor.data_ptr() for name, tensor in tensors.items()}

    def empty(self, name: str) -> torch.Tensor:
        channels = channels_of(name) if channels_of(name) >= 0 else self.render.native.channels
        shape = self.render.size if channels == 0 else (*self.render.size, channels)
        dtype = torch.int32 if name in IDENTIFIERS else self.render.native.dtype
        return torch.empty(shape, dtype=dtype, device="cpu")
