"""Materials of trimesh objects as BSDFs and area lights of a scene dict."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
import torch

from ..image import srgb_to_linear


class Materials:
    """Collects the materials of one file; meshes that share one share the BSDF.

    Attributes:
        bsdfs: id -> dict, to be put at the top level of the scene.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.bsdfs: dict[str, Any] = {}
        self._ids: dict[int, str] = {}
        self._kept: list[Any] = []  # keeps the materials alive, so that their `id` stays theirs

    def of(self, mesh: Any, taken: set[str]) -> dict[str, Any]:
        """The entries ``bsdf`` and, where needed, ``attributes`` and ``emitter`` of a mesh."""
        material = getattr(mesh.visual, "material", None)
        if material is not None:
            entries: dict[str, Any] = {"bsdf": {"type": "ref", "id": self._bsdf(material, taken)}}
            emission = getattr(material, "emissiveFactor", None)
            if emission is not None and np.max(emission) > 0:
                entries["emitter"] = {"type": "area", "radiance": _rgb(np.broadcast_to(emission, 3))}
            return entries
        kind = mesh.visual.kind if mesh.visual is not None and mesh.visual.defined else None
        if kind in ("vertex", "face"):
            colours = mesh.visual.vertex_colors if kind == "vertex" else mesh.visual.face_colors
            data = torch.tensor(np.asarray(colours)[:, :3].astype(np.float64) / 255)
            reflectance = {"type": "mesh_attribute", "name": f"{kind}_color"}
            return {"attributes": {f"{kind}_color": data}, "bsdf": two_sided(reflectance)}
        return {"bsdf": two_sided(_rgb([0.5, 0.5, 0.5]))}

    def _bsdf(self, material: Any, taken: set[str]) -> str:
        if id(material) not in self._ids:
            key = identifier(str(getattr(material, "name", None) or "material"), taken)
            self.bsdfs[key] = two_sided(self._reflectance(material))
            self._ids[id(material)] = key
            self._kept.append(material)
        return self._ids[id(material)]

    def _reflectance(self, material: Any) -> dict[str, Any]:
        """The base colour (glTF) or diffuse colour (OBJ), linear, as a constant or a bitmap."""
        if hasattr(material, "baseColorFactor"):
            image, factor = material.baseColorTexture, _factor(material.baseColorFactor)
            self._warn_about_the_rest(material)
        else:
            image = getattr(material, "image", None)
            # With a picture, the factor is 1: many exporters write an arbitrary one beside it.
            given = (getattr(material, "kwargs", None) or {}).get("kd", getattr(material, "diffuse", None))
            factor = np.ones(3) if image is not None else _factor(given)
        if image is None:
            return _rgb(factor.clip(0, 1))
        texels = torch.from_numpy(np.asarray(image.convert("RGB")).astype(np.float32) / np.float32(255))
        data = srgb_to_linear(texels) * torch.from_numpy(factor).float()
        return {"type": "bitmap", "data": data, "raw": True}

    def _warn_about_the_rest(self, material: Any) -> None:
        metallic = getattr(material, "metallicFactor", None)
        unused = ["metallicFactor"] if metallic else []
        for name in ("metallicRoughnessTexture", "normalTexture", "emissiveTexture", "occlusionTexture"):
            unused += [name] if getattr(material, name, None) is not None else []
        unused += ["alphaMode"] if getattr(material, "alphaMode", None) in ("MASK", "BLEND") else []
        if unused:
            label = getattr(material, "name", None) or "material"
            message = f"{self.name}: {label!r} becomes diffuse; not used: {', '.join(unused)}"
            warnings.warn(message, stacklevel=5)


def two_sided(reflectance: Any) -> dict[str, Any]:
    """A diffuse BSDF on both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def identifier(text: str, taken: set[str]) -> str:
    """`text` as a name without dots that is not in `taken`, to which it is added."""
    base = re.sub(r"\W+", "_", text).strip("_") or "mesh"
    name, number = base, 1
    while name in taken:
        name, number = f"{base}_{number}", number + 1
    taken.add(name)
    return name


def _factor(value: Any) -> np.ndarray:
    """A colour factor as three linear floats; trimesh stores them as bytes. None is 1."""
    if value is None:
        return np.ones(3)
    array = np.asarray(value)
    scaled = array.astype(np.float64) / 255 if array.dtype.kind in "iu" else array.astype(np.float64)
    return np.broadcast_to(scaled.reshape(-1)[:3], 3).copy()


def _rgb(value: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) for v in value]}
