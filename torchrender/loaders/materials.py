"""Materials of trimesh objects as BSDFs and area lights of a scene dict."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from ..errors import SubstitutionWarning
from ..image import srgb_to_linear
from ..scene import registry
from .gltf_materials import Entry


class Materials:
    """Collects the materials of one file; meshes that share one share the BSDF.

    Attributes:
        bsdfs: id -> dict, to be put at the top level of the scene.
    """

    def __init__(self, name: str, header: Mapping[str, Any] | None = None) -> None:
        self.name = name
        self.header = header  # of a glTF file whose materials were `numbered`
        self.bsdfs: dict[str, Any] = {}
        self._ids: dict[tuple[int, bool], str] = {}
        self._kept: list[Any] = []  # keeps the materials alive, so that their `id` stays theirs

    def of(self, mesh: Any, taken: set[str]) -> dict[str, Any]:
        """The entries ``bsdf`` and, where needed, ``attributes`` and ``emitter`` of a mesh."""
        material = getattr(mesh.visual, "material", None)
        if material is not None:
            colours = self._colours(mesh, material)
            entries: dict[str, Any] = {"bsdf": {"type": "ref", "id": self._bsdf(material, taken, colours is not None)}}
            if colours is not None:
                entries["attributes"] = {"vertex_color": colours}
            radiance = _emission(material, self._entry(material)[1])
            if radiance is not None:
                entries["emitter"] = {"type": "area", "radiance": radiance}
            return entries
        visual = mesh.visual
        kind = visual.kind if visual is not None and visual.defined else None
        if visual is not None and kind in ("vertex", "face"):
            colours = visual.vertex_colors if kind == "vertex" else visual.face_colors
            data = torch.tensor(np.asarray(colours)[:, :3].astype(np.float64) / 255)
            reflectance = {"type": "mesh_attribute", "name": f"{kind}_color"}
            return {"attributes": {f"{kind}_color": data}, "bsdf": two_sided(reflectance)}
        return {"bsdf": two_sided(_rgb([0.5, 0.5, 0.5]))}

    def _entry(self, material: Any) -> tuple[str | None, Entry]:
        """The name of a material, and what the file says of it beyond what trimesh knows."""
        name = getattr(material, "name", None)
        if self.header is None or name is None:
            return name, Entry()
        described = self.header["materials"][int(str(name).partition(":")[0])]
        return described.get("name"), Entry(self.header, described)

    def _colours(self, mesh: Any, material: Any) -> torch.Tensor | None:
        """The colours of a glTF mesh's vertices (V, 3) times the base colour, where it has no texture."""
        given = getattr(mesh.visual, "vertex_attributes", {}).get("color")
        if self.header is None or given is None:
            return None
        name, entry = self._entry(material)
        if material.baseColorTexture is not None or entry.unlit:
            self._say(name, "a texture without the colours of the vertices", ["COLOR_0"])
            return None
        colours = np.asarray(given)[:, :3]
        scale = np.iinfo(colours.dtype).max if colours.dtype.kind in "iu" else 1
        factor = _factor(material.baseColorFactor if entry.base_color is None else entry.base_color)
        return torch.from_numpy((colours.astype(np.float64) / scale).clip(0, 1) * factor.clip(0, 1))

    def _bsdf(self, material: Any, taken: set[str], coloured: bool) -> str:
        place = id(material), coloured
        if place not in self._ids:
            name, entry = self._entry(material)
            key = identifier(str(name or "material"), taken)
            if hasattr(material, "baseColorFactor"):
                self.bsdfs[key], lost = metallic_roughness(material, registry.scene_types(), entry, coloured)
                if lost:
                    self._say(name, self.bsdfs[key]["type"], lost)
            else:
                bsdf = two_sided(_diffuse_colour(material))
                opacity = _opacity(material)
                if opacity < 1 and "mask" in registry.scene_types():
                    bsdf = {"type": "mask", "opacity": opacity, "bsdf": bsdf}
                self.bsdfs[key] = bsdf
            self._ids[place] = key
            self._kept.append(material)
        return self._ids[place]

    def _say(self, name: str | None, kind: str, lost: list[str]) -> None:
        text = f"{self.name}: {name or 'material'!r} becomes {kind}; not used: {', '.join(lost)}"
        warnings.warn(text, SubstitutionWarning, stacklevel=6)


def metallic_roughness(
    material: Any, known: Mapping[str, str], entry: Entry | None = None, coloured: bool = False
) -> tuple[dict[str, Any], list[str]]:
    """The BSDF of a glTF material, made of what there is.

    Base colour, metalness and roughness are those of ``principled``, whose roughness is glTF's, too: the square root
    of the microfacets' alpha. A ``normalmap`` lies around it, then both sides, then a ``mask`` of the base colour's
    alpha. Without ``principled`` a diffuse BSDF takes the base colour.

    Args:
        material: a trimesh ``PBRMaterial``. As in glTF, metalness and roughness are 1 where it says nothing.
        known: the types that this version has.
        entry: what the file says beyond that.
        coloured: the base colour is the attribute ``vertex_color`` of the mesh.

    Returns:
        The dict, and the names of the material's properties that it leaves out.
    """
    entry = entry or Entry()
    if entry.unlit:  # its colour is emitted
        return {"type": "diffuse", "reflectance": _rgb([0.0, 0.0, 0.0])}, []
    lost = _given(material, "occlusionTexture")
    lost += entry.without_image(lambda name: getattr(material, name, None) is not None)
    colour = _base_colour(material, entry)
    if coloured:
        colour = {"type": "mesh_attribute", "name": "vertex_color"}
    if "principled" in known:
        packed = _texels(getattr(material, "metallicRoughnessTexture", None))
        settings = entry.bitmap("metallicRoughnessTexture")
        bsdf = {"type": "principled", "base_color": colour}
        for name, channel in (("roughness", 1), ("metallic", 2)):
            factor = getattr(material, f"{name}Factor", None)
            factor = np.full(1, 1.0 if factor is None else float(factor))
            value = _textured(None if packed is None else packed[..., channel : channel + 1], factor, settings)
            bsdf[name] = value["value"][0] if value["type"] == "rgb" else value
        bsdf = entry.layers(bsdf, known)
    else:
        bsdf = {"type": "diffuse", "reflectance": colour}
        lost += ["metallicFactor"] if getattr(material, "metallicFactor", None) else []
        lost += _given(material, "metallicRoughnessTexture")
    clear = "spec_trans" in bsdf
    normals = _texels(getattr(material, "normalTexture", None))
    if normals is not None and "normalmap" in known:
        # both have the second axis at a right angle to the first, up the picture
        scale = entry.normal_scale()
        flat = torch.tensor([scale, scale, 1.0]) / max(1.0, abs(scale))
        normals = ((2 * normals - 1) * flat + 1) / 2 if scale != 1 else normals
        texture = {"type": "bitmap", "data": normals, "raw": True, **entry.bitmap("normalTexture")}
        bsdf = {"type": "normalmap", "normalmap": texture, "bsdf": bsdf}
    elif normals is not None:
        lost.append("normalTexture")
    if not clear:
        bsdf = {"type": "twosided", "bsdf": bsdf}
    mode = getattr(material, "alphaMode", None)
    if mode in ("MASK", "BLEND") and "mask" in known:
        given = material.baseColorFactor if entry.base_color is None else entry.base_color
        alpha = 1.0 if given is None or np.size(given) < 4 else float(_factor(given, 4)[3])
        opacity = torch.full((1, 1, 1), alpha)
        if material.baseColorTexture is not None and "A" in material.baseColorTexture.getbands():
            opacity = _fractions(material.baseColorTexture.getchannel("A").convert("RGB"))[..., :1] * alpha
        if mode == "MASK":
            cutoff = getattr(material, "alphaCutoff", None)
            opacity = (opacity >= (0.5 if cutoff is None else float(cutoff))).float()
        single = opacity.numel() == 1
        settings = entry.bitmap("baseColorTexture")
        value = float(opacity) if single else {"type": "bitmap", "data": opacity, "raw": True, **settings}
        bsdf = {"type": "mask", "opacity": value, "bsdf": bsdf}
    elif mode in ("MASK", "BLEND"):
        lost.append("alphaMode")
    return bsdf, list(dict.fromkeys(lost + entry.lost))


def _base_colour(material: Any, entry: Entry) -> Any:
    """A constant or a bitmap."""
    factor = material.baseColorFactor if entry.base_color is None else entry.base_color
    picture = _texels(material.baseColorTexture)
    return _textured(picture, _factor(factor), entry.bitmap("baseColorTexture"), decode=True)


def _given(material: Any, *names: str) -> list[str]:
    return [name for name in names if getattr(material, name, None) is not None]


def _diffuse_colour(material: Any) -> dict[str, Any]:
    """The diffuse colour of a material of an OBJ file, linear, as a constant or a bitmap."""
    picture = _texels(getattr(material, "image", None))
    # With a picture, the factor is 1: many exporters write an arbitrary one beside it.
    given = (getattr(material, "kwargs", None) or {}).get("kd", getattr(material, "diffuse", None))
    return _textured(picture, np.ones(3) if picture is not None else _factor(given), {}, decode=True)


def _opacity(material: Any) -> float:
    """The opacity of a material of an OBJ file: ``d``, or else 1 - ``Tr``."""
    kwargs = getattr(material, "kwargs", None) or {}
    for name, of in (("d", lambda x: x), ("tr", lambda x: 1 - x)):
        if kwargs.get(name):
            return min(1.0, max(0.0, of(float(kwargs[name][-1]))))
    return 1.0


def _emission(material: Any, entry: Entry) -> dict[str, Any] | None:
    """The radiance of a material: glTF's emissive factor and texture, the ``Ke`` of an OBJ file; None if it is dark."""
    if entry.unlit:
        return _base_colour(material, entry)
    factor = getattr(material, "emissiveFactor", None)
    picture = _texels(getattr(material, "emissiveTexture", None))
    if factor is None:
        factor = (getattr(material, "kwargs", None) or {}).get("ke")
    factor = np.zeros(3) if factor is None else np.broadcast_to(np.asarray(factor, np.float64), 3)
    if factor.max() <= 0 or (picture is not None and float(picture.max()) <= 0):
        return None
    return _textured(picture, factor * entry.strength, entry.bitmap("emissiveTexture"), decode=True, clip=False)


def _texels(image: Any) -> torch.Tensor | None:
    """`_fractions` of a picture, if there is one."""
    return None if image is None else _fractions(image)


def _fractions(image: Any) -> torch.Tensor:
    """A picture's stored values as fractions of the largest, (H, W, 3)."""
    if image.mode.startswith("I"):  # 16 bits, which PIL would cut off at 255
        grey = np.asarray(image).astype(np.float32) / np.float32(65535)
        return torch.from_numpy(np.repeat(grey.clip(0, 1)[..., None], 3, axis=2))
    return torch.from_numpy(np.asarray(image.convert("RGB")).astype(np.float32) / np.float32(255))


def _textured(
    picture: torch.Tensor | None,
    factor: np.ndarray,
    settings: Mapping[str, Any],
    decode: bool = False,
    clip: bool = True,
) -> Any:
    """A constant, or a bitmap of linear values times a factor for each channel, with these further settings."""
    if picture is None:
        return _rgb(factor.clip(0, 1) if clip else factor)
    data = srgb_to_linear(picture) if decode else picture
    return {"type": "bitmap", "data": data * torch.from_numpy(np.array(factor)).float(), "raw": True, **settings}


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


def _factor(value: Any, channels: int = 3) -> np.ndarray:
    """A colour factor as linear floats; trimesh stores them as bytes. None is 1."""
    if value is None:
        return np.ones(channels)
    array = np.asarray(value)
    scaled = array.astype(np.float64) / 255 if array.dtype.kind in "iu" else array.astype(np.float64)
    return np.broadcast_to(scaled.reshape(-1)[:channels], channels).copy()


def _rgb(value: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) for v in value]}
