"""BSDFs that need more than their declaration: indices of refraction by name, conductors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import torch

from ..errors import describe, nearest
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


# Real and imaginary part of the index of refraction, as red, green and blue of the spectra that Mitsuba 3.9.1 has (read
# back from its `conductor`): measurements collected by Palik, "Handbook of Optical Constants of Solids", 1985, and in
# the databases of SOPRA and luxpop.
CONDUCTORS = {
    "a-C": ((2.94405, 2.22714, 1.96816), (0.887465, 0.799299, 0.81529)),
    "Ag": ((0.155276, 0.116728, 0.138388), (4.82835, 3.12222, 2.1469)),
    "Al": ((1.6575, 0.880405, 0.521244), (9.22381, 6.2695, 4.837)),
    "AlAs": ((3.6053, 3.23294, 2.21632), (0.000679437, 0.0, 0.00751271)),
    "AlSb": ((0.0, 4.13937, 4.66925), (0.0, 0.0940091, 1.30057)),
    "Au": ((0.143036, 0.375307, 1.44205), (3.983, 2.38556, 1.60336)),
    "Be": ((4.18501, 3.18503, 2.78406), (3.83547, 3.01012, 2.86899)),
    "Cr": ((4.36967, 2.91651, 1.6549), (5.20655, 4.23131, 3.7547)),
    "CsI": ((2.1449, 1.70232, 1.66243), (0.0, 0.0, 0.0)),
    "Cu": ((0.201005, 0.92375, 1.10222), (3.91326, 2.45305, 2.14209)),
    "Cu2O": ((3.55177, 2.94987, 2.75188), (0.114207, 0.193897, 0.606134)),
    "CuO": ((3.24754, 2.44781, 2.21022), (0.52109, 0.570031, 0.722179)),
    "d-C": ((2.70872, 2.31883, 2.2289), (0.0, 0.0, 0.0)),
    "Hg": ((2.39894, 1.44003, 0.90957), (6.32759, 4.37192, 3.42176)),
    "HgTe": ((4.77904, 3.2312, 2.6599), (1.63161, 1.58081, 1.72929)),
    "Ir": ((3.0863, 2.08219, 1.61791), (5.59215, 4.06709, 3.26731)),
    "K": ((0.0640432, 0.0464098, 0.0381849), (2.1042, 1.34894, 0.913126)),
    "Li": ((0.265791, 0.195618, 0.220949), (3.54015, 2.31112, 1.66861)),
    "MgO": ((2.08958, 1.65072, 1.59488), (0.0, 0.0, 0.0)),
    "Mo": ((4.48397, 3.52513, 2.77631), (4.11144, 3.42083, 3.15061)),
    "Na_palik": ((0.0602694, 0.0561409, 0.0619884), (3.17927, 2.11249, 1.57904)),
    "Nb": ((3.42007, 2.79009, 2.39563), (3.44139, 2.73767, 2.57975)),
    "Ni_palik": ((2.3673, 1.66337, 1.46708), (4.49881, 3.05015, 2.34544)),
    "Rh": ((2.58579, 1.86022, 1.55426), (6.78226, 4.70299, 3.97607)),
    "Se": ((4.05831, 2.84294, 2.82085), (0.75405, 0.638444, 0.521808)),
    "SiC": ((3.17234, 2.52597, 2.47937), (7.53766e-07, 0.0, 1.01925e-05)),
    "SnTe": ((4.52425, 1.98164, 1.28159), (0.0, 0.0, 0.0)),
    "Ta": ((2.06272, 2.39294, 2.62793), (2.40836, 1.74149, 1.94703)),
    "Te": ((7.39023, 4.4821, 2.63711), (3.25602, 3.52706, 3.29205)),
    "ThF4": ((1.83071, 1.44223, 1.38765), (0.0, 0.0, 0.0)),
    "TiC": ((3.70053, 2.83742, 2.58229), (3.26564, 2.35159, 2.17279)),
    "TiN": ((1.64845, 1.15052, 1.37982), (3.36833, 1.9435, 1.10207)),
    "TiO2": ((3.45661, 2.80174, 2.90517), (0.000105265, 0.0, 0.000652887)),
    "VC": ((3.65757, 2.75274, 2.53267), (3.0683, 2.19869, 1.96319)),
    "V_palik": ((4.27758, 3.51295, 2.76107), (3.4913, 2.88945, 3.11152)),
    "VN": ((2.8656, 2.11919, 1.94009), (3.03224, 2.05612, 1.61631)),
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


VISIBLE = {"sample_visible": "is not there: normals are sampled by what is visible, which changes the noise alone"}


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
    inside = "bk7"

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
        if material != "none":
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
            properties["eta"], properties["k"] = CONDUCTORS[material]
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
        specular_reflectance_sampling_rate, diffuse_reflectance_sampling_rate, specular_transmittance_sampling_rate,
            diffuse_transmittance_sampling_rate: how often each part is sampled, relative to the others (numbers).
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
