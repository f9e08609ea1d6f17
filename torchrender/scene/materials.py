"""BSDFs that need more than their declaration: indices of refraction by name, conductors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import torch

from ..errors import nearest
from . import values
from .context import Context
from .plugin import Plugin
from .registry import register

# Indices of refraction at 589.29 nm, from the usual tables.
REFRACTIVE_INDICES = {
    "vacuum": 1.0,
    "helium": 1.000036,
    "hydrogen": 1.000132,
    "air": 1.000277,
    "carbon dioxide": 1.00045,
    "water": 1.3330,
    "acetone": 1.36,
    "ethanol": 1.361,
    "carbon tetrachloride": 1.461,
    "glycerol": 1.4729,
    "benzene": 1.501,
    "silicone oil": 1.52045,
    "bromine": 1.661,
    "water ice": 1.31,
    "fused quartz": 1.458,
    "pyrex": 1.470,
    "acrylic glass": 1.49,
    "polypropylene": 1.49,
    "bk7": 1.5046,
    "sodium chloride": 1.544,
    "amber": 1.55,
    "pet": 1.5750,
    "diamond": 2.419,
}


# Metals as red, green, blue averages of their measured eta and k.
METALS = {
    "Ag": ((0.155276, 0.116728, 0.138388), (4.82835, 3.12222, 2.1469)),
    "Al": ((1.6575, 0.880405, 0.521244), (9.22381, 6.2695, 4.837)),
    "Au": ((0.143036, 0.375307, 1.44205), (3.983, 2.38556, 1.60336)),
    "Cr": ((4.36967, 2.91651, 1.6549), (5.20655, 4.23131, 3.7547)),
    "Cu": ((0.201005, 0.92375, 1.10222), (3.91326, 2.45305, 2.14209)),
    "W": ((4.37082, 3.30025, 2.99841), (3.50064, 2.60487, 2.27323)),
}


def refractive_index(value: Any, ctx: Context) -> torch.Tensor:
    """An index of refraction, in float64, given as a number or as the name of a material; keeps its gradient."""
    if isinstance(value, str):
        name = value.strip().lower().replace("_", " ")
        if name not in REFRACTIVE_INDICES:
            ctx.error(f"unknown material {value!r}; {nearest(name, REFRACTIVE_INDICES)}")
        value = REFRACTIVE_INDICES[name]
    index = values.double(value, ctx)
    if not 0 < float(index.detach()) < float("inf"):
        ctx.error(f"an index of refraction is positive, got {float(index.detach()):g}")
    return index


@register
class Dielectric(Plugin):
    """Smooth dielectric interface.

    Args:
        int_ior: index of refraction inside, a number or a material name; default ``"bk7"`` (1.5046).
        ext_ior: index of refraction outside; default ``"air"`` (1.000277).
        eta: relative index of refraction, in place of the two.
        specular_reflectance, specular_transmittance: factors for tinting (texture); 1 is physical.
    """

    category, type = "bsdf", "dielectric"
    optional = frozenset({"specular_reflectance", "specular_transmittance"})

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["int_ior", "ext_ior", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        given = [n for n in ("int_ior", "ext_ior") if n in properties]
        if given and "eta" in properties:
            ctx.error(f"{self.type}: give eta, or {' and '.join(given)}, but not both")
        if "eta" not in properties:
            inside, outside = properties.pop("int_ior", "bk7"), properties.pop("ext_ior", "air")
            eta = refractive_index(inside, ctx.at("int_ior")) / refractive_index(outside, ctx.at("ext_ior"))
            properties["eta"] = values.rounded(eta, inside, ctx)
        return properties


@register
class RoughDielectric(Dielectric):
    """Rough dielectric interface: microscopic facets that reflect and refract once.

    What facets throw onto one another is lost. An interface of index 1.5 without absorption loses, of light that comes
    straight / under 75 degrees: GGX 0.1 % / 3 % at alpha 0.1 and 3 % / 20 % at alpha 0.5; Beckmann 0 / 1 % and
    0.3 % / 5 %.

    Args:
        distribution: of the facets' normals, ``"beckmann"`` (the default) or ``"ggx"``, with its longer tails.
        alpha: roughness, from 0.001 to 10, default 0.1; equal in all directions. Below its range while rendering it
            counts as 0.001.
        int_ior: index of refraction inside, a number or a material name; default ``"bk7"`` (1.5046).
        ext_ior: index of refraction outside; default ``"air"`` (1.000277).
        eta: relative index of refraction, in place of the two. Within 0.001 of 1 it counts as 1.001 or 0.999.
        specular_reflectance, specular_transmittance: factors for tinting (texture); 1 is physical.
    """

    category, type = "bsdf", "roughdielectric"
    inert: ClassVar[dict[str, tuple[Any, ...]]] = {"sample_visible": (True,)}
    unsupported = ("alpha_u", "alpha_v")

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        if isinstance(properties.get("alpha"), (Plugin, Mapping)):
            ctx.at("alpha").error("expected a number: this roughness cannot be a texture")
        return super().prepare(properties, ctx)


@register
class Conductor(Plugin):
    """Smooth conductor, one-sided.

    Args:
        eta, k: real and imaginary part of the index of refraction (textures or colours).
        material: ``"none"`` is a perfect mirror, the default; or a metal: Ag, Al, Au, Cr, Cu, W.
        specular_reflectance: factor (texture); 1 is physical.
    """

    category, type = "bsdf", "conductor"

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["material", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        material = properties.pop("material", "none")
        if material != "none":
            if "eta" in properties or "k" in properties:
                ctx.error("conductor: give material, or eta and k, but not both")
            if material not in METALS:
                ctx.at("material").error(
                    f"the conductor {material!r} is not known by name here; give eta and k, or one of: none, "
                    + ", ".join(METALS)
                )
            properties["eta"], properties["k"] = METALS[material]
        # Without eta and k this is a perfect mirror: eta 0, k 1.
        properties.setdefault("eta", 0.0)
        properties.setdefault("k", 1.0)
        return properties


TRANSMITTING = ("dielectric", "null", "thindielectric", "roughdielectric", "mask")


@register
class TwoSided(Plugin):
    """Reflection from both sides of a surface.

    Args:
        brdf_0: the front's BSDF, and the back's if there is no second. Nested BSDFs may have any name.
        brdf_1: the back's BSDF.
    """

    category, type = "bsdf", "twosided"

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        if self._modules.get("brdf_0") is None and not self._references:
            ctx.error("twosided: a nested BSDF is missing")

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        for name in ("brdf_0", "brdf_1"):
            child = self._modules.get(name)
            if child is not None and (child.type in TRANSMITTING or child.type == "twosided"):
                ctx.at(name).error(f"a {child.type} cannot be made two-sided: only one-sided reflection can")
