"""What a glTF file says of a material and trimesh does not keep: extensions, and how textures are looked up.

Conventions: Khronos Group, "glTF 2.0 Specification" (2021), sections 3.8 (textures) and 3.9 (materials), and the
extensions that are named below.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

_WRAP = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_NEAREST = 9728
# Known by Entry, by trimesh, or of no account for pictures.
_KNOWN = (
    "emissive_strength unlit ior specular transmission volume clearcoat sheen anisotropy pbrSpecularGlossiness".split()
)


@dataclass
class Entry:
    """A material as the file describes it; an empty one for materials that come from elsewhere.

    Attributes:
        header: the file's JSON.
        material: the material's part of it.
        lost: names of what was asked for and is not there.
    """

    header: Mapping[str, Any] = field(default_factory=dict)
    material: Mapping[str, Any] = field(default_factory=dict)
    lost: list[str] = field(default_factory=list)

    def extension(self, name: str) -> Mapping[str, Any] | None:
        """KHR_materials_NAME, None if the material has none."""
        return self.material.get("extensions", {}).get(f"KHR_materials_{name}")

    def number(self, extension: str, name: str, default: float) -> float:
        """A number of an extension, whose textures are not supported."""
        found = self.extension(extension)
        if found is None:
            return default
        texture = f"{name.removesuffix('Factor')}Texture"
        self.lost += [f"{extension}.{texture}"] if texture in found else []
        return float(found.get(name, default))

    @property
    def unlit(self) -> bool:
        return self.extension("unlit") is not None

    @property
    def strength(self) -> float:
        """The factor of KHR_materials_emissive_strength."""
        return self.number("emissive_strength", "emissiveStrength", 1.0)

    @property
    def base_color(self) -> list[float] | None:
        """The exact factor; trimesh rounds it to bytes."""
        return None if self.extension("pbrSpecularGlossiness") else self._pbr.get("baseColorFactor")

    @property
    def _pbr(self) -> Mapping[str, Any]:
        return self.material.get("pbrMetallicRoughness", {})

    def without_image(self, has: Callable[[str], bool]) -> list[str]:
        """The textures of the material for which there is no image."""
        names = [name for part in (self.material, self._pbr) for name in part if name.endswith("Texture")]
        return [f"{name} (it cannot be read)" for name in names if not has(name)]

    def bitmap(self, texture: str) -> dict[str, Any]:
        """How a texture of this name is looked up, as parameters of a ``bitmap``."""
        info = self.material.get(texture, self._pbr.get(texture))
        if info is None:
            return {}
        transform = info.get("extensions", {}).get("KHR_texture_transform", {})
        if transform.get("texCoord", info.get("texCoord", 0)) != 0:
            self.lost.append(f"{texture}.texCoord")
        settings: dict[str, Any] = {}
        if transform:
            (x, y), angle = transform.get("offset", (0.0, 0.0)), float(transform.get("rotation", 0.0))
            u, v = transform.get("scale", (1.0, 1.0))
            # v runs downwards, so that what looks counter-clockwise is a negative angle
            turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
            matrix = np.eye(3)
            matrix[:2] = np.column_stack([turn @ np.diag([u, v]), [x, y]])
            settings["to_uv"] = matrix
        sampler = self.header["textures"][info["index"]].get("sampler")
        if sampler is not None:
            sampler = self.header["samplers"][sampler]
            across, down = (_WRAP[sampler.get(name, 10497)] for name in ("wrapS", "wrapT"))
            settings |= {} if across == "repeat" else {"wrap_mode": across}
            settings |= {"filter_type": "nearest"} if sampler.get("magFilter") == _NEAREST else {}
            self.lost += [f"{texture}.wrapT"] if across != down else []
        return settings

    def normal_scale(self) -> float:
        return float(self.material.get("normalTexture", {}).get("scale", 1.0))

    def layers(self, bsdf: dict[str, Any], known: Mapping[str, str]) -> dict[str, Any]:
        """A ``principled`` BSDF with the extensions of the material, as near as its parameters come.

        Transmission through what has no thickness is that of ``principledthin``.
        """
        bsdf = {**bsdf, **self._eta(), **self._coat(), **self._anisotropy(bsdf.get("roughness"))}
        transmission = self.number("transmission", "transmissionFactor", 0.0)
        volume = self.extension("volume") or {}
        if transmission > 0 and volume.get("thicknessFactor", 0.0) > 0:
            bsdf["spec_trans"] = transmission
            self.lost += ["volume.attenuationColor"] if "attenuationColor" in volume else []
        elif transmission > 0 and "principledthin" in known:
            missing = [n for n in ("metallic", "clearcoat") if not _zero(bsdf.pop(n, 0.0))]
            self.lost += [f"{name} beside transmission" for name in missing]
            bsdf.pop("clearcoat_gloss", None)
            bsdf = {**bsdf, "type": "principledthin", "spec_trans": transmission}
        elif transmission > 0:
            self.lost.append("transmission")
        self.lost += [
            name for name in self.material.get("extensions", {}) if name.removeprefix("KHR_materials_") not in _KNOWN
        ]
        return bsdf

    def _eta(self) -> dict[str, float]:
        """KHR_materials_ior and KHR_materials_specular: an index with the same reflectance at normal incidence."""
        if self.extension("ior") is None and self.extension("specular") is None:
            return {}
        ior = self.number("ior", "ior", 1.5)
        factor = self.number("specular", "specularFactor", 1.0)
        specular = self.extension("specular") or {}
        if any(c != 1 for c in specular.get("specularColorFactor", ())) or "specularColorTexture" in specular:
            self.lost.append("specular.specularColor")
        if ior < 1:  # 0 stands for infinity
            self.lost.append("ior")
            ior = 1.5
        if self.extension("transmission") is not None:  # the index bends light, too
            self.lost += ["specular.specularFactor"] if factor != 1 else []
            factor = 1.0
        root = (ior - 1) / (ior + 1) * math.sqrt(factor)
        return {"eta": (1 + root) / (1 - root)}

    def _coat(self) -> dict[str, float]:
        """KHR_materials_clearcoat and KHR_materials_sheen."""
        found = {}
        coat = self.number("clearcoat", "clearcoatFactor", 0.0)
        if coat > 0:
            # the alpha of the coat is between 0.1 (gloss 0) and 0.001 (gloss 1); glTF's is the square of the roughness
            alpha = self.number("clearcoat", "clearcoatRoughnessFactor", 0.0) ** 2
            found |= {"clearcoat": coat, "clearcoat_gloss": min(1.0, max(0.0, (0.1 - alpha) / 0.099))}
            self.lost += [
                f"clearcoat.{n}" for n in (self.extension("clearcoat") or {}) if n == "clearcoatNormalTexture"
            ]
        sheen = self.extension("sheen") or {}
        colour = [float(c) for c in sheen.get("sheenColorFactor", (0.0,))]
        if max(colour) > 0:
            found["sheen"] = min(1.0, max(colour))
            self.lost += ["sheen.sheenColorFactor (hue)"] if min(colour) < max(colour) else []
            self.lost += [f"sheen.{name}" for name in sheen if name != "sheenColorFactor"]
        return found

    def _anisotropy(self, roughness: Any) -> dict[str, float]:
        """The extension KHR_materials_anisotropy as Burley's anisotropy and roughness.

        The extension's alpha along u is nearer to 1 by the square of the strength; Burley's is as much larger along u
        as it is smaller across it.
        """
        strength = self.number("anisotropy", "anisotropyStrength", 0.0)
        if strength <= 0:
            return {}
        if not isinstance(roughness, float):
            self.lost.append("anisotropy beside a texture of roughness")
            return {}
        given = self.extension("anisotropy") or {}
        self.lost += [f"anisotropy.{name}" for name in ("anisotropyRotation", "anisotropyTexture") if given.get(name)]
        across = max(roughness * roughness, 1e-3)
        along = across + (1 - across) * min(strength, 1.0) ** 2
        return {"roughness": (along * across) ** 0.25, "anisotropic": min(1.0, (1 - across / along) / 0.9)}


def _zero(value: Any) -> bool:
    return isinstance(value, float) and value == 0
