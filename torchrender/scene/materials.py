"""BSDFs that need more than their declaration: indices of refraction by name, conductors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

from ..errors import describe, nearest
from . import values
from .conductors import CONDUCTORS
from .context import Context
from .indices import is_index_spectrum, refractive_index
from .plugin import Plugin
from .registry import register

VISIBLE = {"sample_visible": "is not there: normals are sampled by what is visible, which changes the noise alone"}


@register
class Dielectric(Plugin):
    """Smooth dielectric interface.

    Args:
        int_ior: index of refraction inside, a number or a material name; default ``"bk7"`` (1.5046). Or a spectrum, see
            `DispersiveDielectric`.
        ext_ior: index of refraction outside; default ``"air"`` (1.000277).
        eta: relative index of refraction, in place of the two.
        specular_reflectance, specular_transmittance: factors for tinting (texture); 1 is physical.
    """

    category, type = "bsdf", "dielectric"
    inside = "bk7"

    def __new__(cls, **properties: Any) -> Dielectric:
        disperses = any(is_index_spectrum(properties.get(name)) for name in ("int_ior", "ext_ior", "eta"))
        return object.__new__(DispersiveDielectric if disperses and cls is Dielectric else cls)

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["int_ior", "ext_ior", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        given = [n for n in ("int_ior", "ext_ior") if n in properties]
        if given and "eta" in properties:
            ctx.error(f"{self.type}: give eta, or {' and '.join(given)}, but not both")
        if "eta" not in properties:
            inside, outside = properties.pop("int_ior", self.inside), properties.pop("ext_ior", "air")
            eta = refractive_index(inside, ctx.at("int_ior")) / refractive_index(outside, ctx.at("ext_ior"))
            properties["eta"] = values.rounded(eta, inside, ctx)
        return properties


@register
class DispersiveDielectric(Dielectric):
    """Smooth dielectric interface with an index of refraction by wavelength: a `Dielectric` that disperses.

    Where paths are refracted, one of their three wavelengths goes on, for all of them. In `rgb` and `mono` scenes the
    index is that at 589.3 nm, and nothing is dispersed.

    Args:
        int_ior: index of refraction inside: a dict such as ``{"type": "glass", "name": "N-BK7"}``, ``{"type": "abbe",
            "n_d": 1.5168, "V_d": 64.17}``, ``cauchy`` (A, B) or ``sellmeier`` (B, C), a table (471,) as `tr.spectrum`
            makes it, a number, or a material name; default ``"bk7"`` (1.5046).
        ext_ior: index of refraction outside, the same; default ``"air"`` (1.000277).
        eta: relative index of refraction, in place of the two.
        specular_reflectance, specular_transmittance: factors for tinting (texture); 1 is physical.
    """

    type = "dispersivedielectric"

    def context_of(self, name: str, ctx: Context) -> Context:
        return replace(ctx, index=name == "eta")

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        given = {n: properties.pop(n) for n in ("int_ior", "ext_ior") if n in properties}
        if given and "eta" in properties:
            ctx.error(f"{self.type}: give eta, or {' and '.join(given)}, but not both")
        if "eta" not in properties:
            properties["eta"] = {"type": "relative_index", "int_ior": self.inside, "ext_ior": "air", **given}
        return properties

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        eta = self._child("eta")
        if eta is not None and (eta.type != "constant" or eta.value.shape == (3,)):
            ctx.at("eta").error(
                f"expected a number or an index of refraction by wavelength, got "
                f"{'three numbers' if eta.type == 'constant' else 'a ' + eta.type}"
            )


DIRECTIONS = ("alpha_u", "alpha_v")


def two_roughnesses(properties: dict[str, Any], ctx: Context, kind: str) -> None:
    """Refuse one direction's roughness alone, and that of all directions beside it."""
    given = [name for name in DIRECTIONS if name in properties]
    if "alpha" in properties:
        ctx.error(f"{kind}: give alpha, or {' and '.join(DIRECTIONS)}, but not both")
    if len(given) == 1:
        ctx.error(f"{kind}: {given[0]} is given without {DIRECTIONS[given[0] == DIRECTIONS[0]]}; give both, or alpha")


@register
class RoughDielectric(Dielectric):
    """Rough dielectric interface: microfacets that reflect and refract once.

    What microfacets throw onto one another is lost. An interface of index 1.5 without absorption loses, of light that
    comes straight / under 75 degrees: GGX 0.1 % / 3 % at alpha 0.1 and 3 % / 20 % at alpha 0.5; Beckmann 0 / 1 % and
    0.3 % / 5 %.

    Args:
        distribution: of the microfacets' normals, ``"beckmann"`` (the default) or ``"ggx"``, with its longer tails.
        alpha: roughness (texture), default 0.1; equal in all directions. Below 0.001 it counts as 0.001.
        alpha_u, alpha_v: in place of it the roughness along dp/du and across it (textures). The object that is made is
            an `AnisotropicDielectric`.
        int_ior: index of refraction inside, a number or a material name; default ``"bk7"`` (1.5046).
        ext_ior: index of refraction outside; default ``"air"`` (1.000277).
        eta: relative index of refraction, in place of the two. Within 0.001 of 1 it counts as 1.001 or 0.999.
        specular_reflectance, specular_transmittance: factors for tinting (texture); 1 is physical.
    """

    category, type = "bsdf", "roughdielectric"
    inert: ClassVar[dict[str, tuple[Any, ...]]] = {"sample_visible": (True,)}
    noted: ClassVar[dict[str, str]] = VISIBLE

    def __new__(cls, **properties: Any) -> RoughDielectric:
        made = AnisotropicDielectric if cls is RoughDielectric and properties.keys() & {*DIRECTIONS} else cls
        return object.__new__(made)

    @classmethod
    def parameter_names(cls) -> list[str]:
        names = super().parameter_names()
        return [*names, *DIRECTIONS] if cls is RoughDielectric else names


@register
class AnisotropicDielectric(RoughDielectric):
    """Rough dielectric interface that is brushed: a `RoughDielectric` with `alpha_u` and `alpha_v`.

    Directions are those of `AnisotropicConductor`.

    Args:
        distribution: of the microfacets' normals, ``"beckmann"`` (the default) or ``"ggx"``, with its longer tails.
        alpha_u, alpha_v: roughness along dp/du and across it (textures), default 0.1. Below 0.001 they count as 0.001.
        int_ior: index of refraction inside, a number or a material name; default ``"bk7"`` (1.5046).
        ext_ior: index of refraction outside; default ``"air"`` (1.000277).
        eta: relative index of refraction, in place of the two. Within 0.001 of 1 it counts as 1.001 or 0.999.
        specular_reflectance, specular_transmittance: factors for tinting (texture); 1 is physical.
    """

    native = "anisotropicdielectric"

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        two_roughnesses(properties, ctx, self.type)
        return super().prepare(properties, ctx)


@register
class Conductor(Plugin):
    """Smooth conductor, one-sided.

    Args:
        eta, k: real and imaginary part of the index of refraction (textures or colours).
        material: ``"none"`` is a perfect mirror, the default; or a material by its formula, such as ``"Au"``, ``"Cu"``.
        specular_reflectance: factor (texture); 1 is physical.
    """

    category, type = "bsdf", "conductor"
    words: ClassVar[tuple[str, ...]] = ("material",)

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["material", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        material = properties.pop("material", "none")
        if not isinstance(material, str) or material != "none":
            if "eta" in properties or "k" in properties:
                ctx.error(f"{self.type}: give material, or eta and k, but not both")
            if not isinstance(material, str) or material not in CONDUCTORS:
                near = (
                    nearest(material, ["none", *CONDUCTORS])
                    if isinstance(material, str)
                    else f"got {describe(material)}"
                )
                ctx.at("material").error(
                    f"the conductor {material!r} is not known by name here, and eta and k are not given; {near}"
                )
            for part in ("eta", "k"):
                properties[part] = {"type": "metal", "name": material, "part": part}
        # Without eta and k this is a perfect mirror: eta 0, k 1.
        properties.setdefault("eta", 0.0)
        properties.setdefault("k", 1.0)
        return properties


@register
class RoughConductor(Conductor):
    """Rough conductor, one-sided: microfacets that reflect once.

    What microfacets throw onto one another is lost: see `RoughDielectric`.

    Args:
        distribution: of the microfacets' normals, ``"beckmann"`` (the default) or ``"ggx"``, with its longer tails.
        alpha: roughness (texture), default 0.1; equal in all directions. Below 0.001 it counts as 0.001.
        alpha_u, alpha_v: in place of it the roughness along dp/du and across it (textures). The object that is made is
            an `AnisotropicConductor`.
        eta, k, material: as for a smooth conductor.
        specular_reflectance: factor (texture); 1 is physical.
    """

    category, type = "bsdf", "roughconductor"
    inert: ClassVar[dict[str, tuple[Any, ...]]] = {"sample_visible": (True,)}
    noted: ClassVar[dict[str, str]] = VISIBLE

    def __new__(cls, **properties: Any) -> RoughConductor:
        made = AnisotropicConductor if cls is RoughConductor and properties.keys() & {*DIRECTIONS} else cls
        return object.__new__(made)

    @classmethod
    def parameter_names(cls) -> list[str]:
        names = super().parameter_names()
        return [*names, *DIRECTIONS] if cls is RoughConductor else names


@register
class AnisotropicConductor(RoughConductor):
    """Rough conductor that is brushed, one-sided: a `RoughConductor` with `alpha_u` and `alpha_v`.

    The tangent dp/du, in which the texture coordinate u grows, is made orthogonal to the shading normal; of a mesh
    without texture coordinates it is the first edge of each triangle. Brushed along u, a metal is smooth along u and
    rough across it: alpha_u < alpha_v.

    Args:
        distribution: of the microfacets' normals, ``"beckmann"`` (the default) or ``"ggx"``, with its longer tails.
        alpha_u, alpha_v: roughness along dp/du and across it (textures), default 0.1. Below 0.001 they count as 0.001.
        eta, k, material: as for a smooth conductor.
        specular_reflectance: factor (texture); 1 is physical.
    """

    native = "anisotropicconductor"

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        two_roughnesses(properties, ctx, self.type)
        return super().prepare(properties, ctx)


@register
class ThinDielectric(Dielectric):
    """Thin pane of a transparent material: what goes through is not turned aside.

    Args:
        int_ior: index of refraction of the pane, a number or a material name; default ``"bk7"`` (1.5046).
        ext_ior: index of refraction around it; default ``"air"`` (1.000277).
        eta: relative index of refraction, in place of the two.
        specular_reflectance, specular_transmittance: factors for tinting (texture); 1 is physical.
    """

    category, type = "bsdf", "thindielectric"


@register
class Plastic(Dielectric):
    """Smooth plastic, one-sided: a diffuse base below a dielectric coating.

    Args:
        diffuse_reflectance: albedo of the base (texture), default 0.5.
        nonlinear: whether colours deepen with every reflection between base and coating; default False.
        int_ior: index of refraction of the coating, a number or a material name; default ``"polypropylene"`` (1.49).
        ext_ior: index of refraction outside; default ``"air"`` (1.000277).
        eta: relative index of refraction, in place of the two.
        specular_reflectance: factor of mirror reflections (texture); 1 is physical.
    """

    category, type = "bsdf", "plastic"
    inside = "polypropylene"


@register
class RoughPlastic(RoughDielectric):
    """Rough plastic, one-sided: a diffuse base below a rough dielectric coating.

    Args:
        distribution: of the microfacets' normals, ``"beckmann"`` (the default) or ``"ggx"``, with its longer tails.
        alpha: roughness (number), default 0.1. Below 0.001 it counts as 0.001.
        diffuse_reflectance: albedo of the base (texture), default 0.5.
        nonlinear: whether colours deepen with every reflection between base and coating; default False.
        int_ior: index of refraction of the coating, a number or a material name; default ``"polypropylene"`` (1.49).
        ext_ior: index of refraction outside; default ``"air"`` (1.000277).
        eta: relative index of refraction, in place of the two.
        specular_reflectance: factor of reflections off the coating (texture); 1 is physical.
    """

    category, type = "bsdf", "roughplastic"
    inside = "polypropylene"
    unsupported = DIRECTIONS

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        if isinstance(properties.get("alpha"), (Plugin, Mapping)):
            ctx.at("alpha").error("expected a number: this roughness cannot be a texture")
        return super().prepare(properties, ctx)


@register
class PPlastic(RoughDielectric):
    """Plastic as Baek and others acquire it (2018), one-sided: rough reflection, and diffuse light through the surface.

    Diffuse light is transmitted through a smooth interface on both ways, and what that throws back inside is left out:
    it reflects less than `RoughPlastic`. Rendered in intensity, without polarisation.

    Args:
        distribution: of the microfacets' normals, ``"beckmann"`` (the default) or ``"ggx"``, with its longer tails.
        alpha: roughness (texture), default 0.1. Below 0.001 it counts as 0.001.
        diffuse_reflectance: albedo of the diffuse lobe (texture), default 0.5.
        int_ior: index of refraction inside, a number or a material name; default ``"polypropylene"`` (1.49).
        ext_ior: index of refraction outside; default ``"air"`` (1.000277).
        eta: relative index of refraction, in place of the two.
        specular_reflectance: factor of reflections off the surface (texture); 1 is physical.
    """

    category, type = "bsdf", "pplastic"
    inside = "polypropylene"
    unsupported = DIRECTIONS


# Absorption of the pigments of concentration 1 in red, green and blue, per radius of a hair: d'Eon, Francois, Hill,
# Letteri and Aubry, "An Energy-Conserving Hair Reflectance Model", EGSR 2011, as pbrt and Mitsuba have it.
MELANIN = {"eumelanin": ((0.419, 0.697, 1.37), 1.3), "pheomelanin": ((0.187, 0.4, 1.05), 0.2)}


@register
class Hair(Dielectric):
    """Hair and fur as of Chiang and others (2016): light off a rough fibre with tilted scales, and through it.

    The fibre lies across the tangent dp/du: its axis is the normal times the tangent, as on cylinders and curves, of
    which u goes around. Its colour is given by `sigma_a`, or else by the pigments.

    Args:
        sigma_a: absorption per radius of the fibre (texture).
        scale: factor of `sigma_a` (number), default 1; pigments are not scaled.
        eumelanin: concentration of the brown pigment (texture), default 1.3: 0.3 blond, 1.3 brown, 8 black.
        pheomelanin: concentration of the red pigment (texture), default 0.2.
        eumelanin_absorption, pheomelanin_absorption: absorption of either at concentration 1 (textures).
        longitudinal_roughness: along the fibre (number), 0 to 1, default 0.3. Below 0.001 it counts as 0.001.
        azimuthal_roughness: around it (number), 0 to 1, default 0.3. Below 0.001 it counts as 0.001.
        scale_tilt: angle of the scales with the fibre in degrees (number), default 2.
        int_ior: index of refraction inside, a number or a material name; default ``"amber"`` (1.55).
        ext_ior: index of refraction outside; default ``"air"`` (1.000277).
        eta: relative index of refraction, in place of the two, at least 1.
    """

    category, type = "bsdf", "hair"
    inside = "amber"

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        pigments = [name for name in (*MELANIN, *(f"{name}_absorption" for name in MELANIN)) if name in properties]
        if "sigma_a" in properties and pigments:
            ctx.error(f"hair: give sigma_a, or {' and '.join(pigments)}, but not both")
        if "sigma_a" not in properties:
            for name, (absorption, concentration) in MELANIN.items():
                properties.setdefault(name, concentration)
                properties.setdefault(f"{name}_absorption", absorption)
        return super().prepare(properties, ctx)


@register
class Principled(Plugin):
    """Burley's principled BSDF: from dielectrics over metals to glass by a few numbers from 0 to 1.

    Opaque and from behind it is black; with `spec_trans` it is an interface like `RoughDielectric`.

    Args:
        base_color: colour of the base, of metal and of tints (texture), default 0.5.
        roughness: default 0.5 (texture); the alpha of its GGX microfacets is the square of it.
        metallic: 0, a dielectric over a diffuse base, to 1, a metal (texture).
        specular: sets the index by the reflectance at normal incidence, 0.08 times it (number), default 0.5.
        eta: relative index of refraction, in place of `specular` (number).
        spec_trans: 0, opaque, to 1, clear (texture). Its derivative lacks, where it is 0, the light that would come
            through.
        spec_tint: how much of the base's hue reflections take on (texture).
        sheen, sheen_tint: reflection of cloth at grazing angles, and how much of the base's hue it takes on (texture).
        flatness: 0, diffuse, to 1, the flatter look of light from below the surface (texture).
        clearcoat, clearcoat_gloss: a second reflection, of index 1.5, and its gloss, 0 being satin (texture).
        diffuse_reflectance_sampling_rate, main_specular_sampling_rate, clearcoat_sampling_rate: how often each part is
            sampled, relative to the others (numbers), default 1.
        anisotropic: 0, microfacets as rough along the direction in which u grows as across it, to 1, ten times as rough
            along it (texture), default 0.
    """

    category, type = "bsdf", "principled"

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        if "eta" in properties and "specular" in properties:
            ctx.error("principled: give eta or specular, but not both")
        if "eta" not in properties:
            properties.setdefault("specular", 0.5)
        return properties


@register
class PrincipledThin(Plugin):
    """Burley's principled BSDF of a thin sheet, such as paper or a leaf: both sides look alike.

    Args:
        base_color: colour of the sheet and of tints (texture), default 0.5.
        roughness: default 0.5 (texture); the alpha of its GGX microfacets is the square of it.
        spec_trans: 0, diffuse, to 1, microfacets that reflect and let through (texture). Its derivative and that of
            `diff_trans` lack, where they are 0, the light that would come through.
        eta: relative index of refraction, default 1.5 (texture).
        diff_trans: 0 to 2, twice the part of diffuse light that goes through (texture).
        spec_tint: how much of the base's hue reflections take on (texture).
        sheen, sheen_tint: reflection of cloth at grazing angles, and how much of the base's hue it takes on (texture).
        flatness: 0, diffuse, to 1, the flatter look of light from below the surface (texture).
        specular_reflectance_sampling_rate, diffuse_reflectance_sampling_rate: how often these parts are sampled,
            relative to the others (numbers).
        specular_transmittance_sampling_rate, diffuse_transmittance_sampling_rate: the same of what goes through.
        anisotropic: 0, microfacets as rough along the direction in which u grows as across it, to 1, ten times as rough
            along it (texture), default 0.
    """

    category, type = "bsdf", "principledthin"


@register
class RednerMaterial(Plugin):
    """The material of redner, one-sided: a diffuse lobe and, beside it, microfacets of Blinn's and Phong's density.

    Both lobes together may reflect more than arrives. In redner it is `Material`, with its arguments of the same names;
    there paths of several bounces may count it as rougher than it is.

    Args:
        diffuse_reflectance: albedo (texture), default 0.5.
        specular_reflectance: reflectance of microfacets at normal incidence (texture), default 0.
        roughness: 2 / (n + 2) for the exponent n of the microfacets' cosine (texture), default 1; below 0.00001 it
            counts as that.
    """

    category, type = "bsdf", "redner"
