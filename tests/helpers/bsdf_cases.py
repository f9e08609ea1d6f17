"""BSDFs whose values are compared with Mitsuba's, as plain dictionaries, and the directions at which.

`bench/make_bsdf_references.py` evaluates them with Mitsuba 3.9.1 into files of `tests/data` (see FILES),
`test_bsdf_references.py` with torchrender. This module needs NumPy alone, so that both environments can import it.
"""

from __future__ import annotations

import numpy as np

N = 100  # pairs of directions


def rgb(*values: float) -> dict:
    return {"type": "rgb", "value": list(values)}


def _plastic(**more) -> dict:
    return {"type": "plastic", "diffuse_reflectance": rgb(0.8, 0.4, 0.1), **more}


def _rough_plastic(**more) -> dict:
    return {**_plastic(), "type": "roughplastic", **more}


def _principled(**more) -> dict:
    return {"type": "principled", "base_color": rgb(0.7, 0.4, 0.1), **more}


def _thin(**more) -> dict:
    return _principled(**{"type": "principledthin", **more})


_METAL = {"type": "roughconductor", "material": "Au", "specular_reflectance": rgb(0.9, 0.7, 0.5)}
_GLASS = {"type": "roughdielectric", "int_ior": 1.5, "ext_ior": 1.0}
_SHEET = {
    "roughness": 0.4,
    "spec_trans": 0.4,
    "eta": 1.4,
    "spec_tint": 0.5,
    "sheen": 0.7,
    "sheen_tint": 0.4,
    "flatness": 0.6,
    "diff_trans": 0.8,
}
_EVERYTHING = {
    "roughness": 0.4,
    "metallic": 0.3,
    "spec_trans": 0.6,
    "eta": 1.4,
    "spec_tint": 0.5,
    "sheen": 0.7,
    "sheen_tint": 0.4,
    "flatness": 0.6,
    "clearcoat": 0.8,
    "clearcoat_gloss": 0.3,
}

# Delta lobes have no value to compare: of these, the weights of sampled directions are.
SMOOTH = {
    "roughconductor_ggx": {**_METAL, "distribution": "ggx", "alpha": 0.3},
    "roughconductor_beckmann": {**_METAL, "distribution": "beckmann", "alpha": 0.2},
    "roughconductor_coarse": {"type": "roughconductor", "distribution": "ggx", "alpha": 1.0},
    "plastic": _plastic(),
    "plastic_nonlinear": _plastic(nonlinear=True, int_ior=1.8, specular_reflectance=0.5),
    "roughplastic_ggx": _rough_plastic(distribution="ggx", alpha=0.3, specular_reflectance=rgb(0.9, 0.5, 0.2)),
    "roughplastic_beckmann": _rough_plastic(distribution="beckmann", alpha=0.1, nonlinear=True),
    "roughplastic_coarse": _rough_plastic(distribution="ggx", alpha=0.8, int_ior=1.8),
    "principled": _principled(),
    "principled_rough": _principled(roughness=1.0, specular=0.9),
    "principled_metallic": _principled(metallic=1.0, roughness=0.3),
    "principled_mixed": _principled(metallic=0.5, roughness=0.3, spec_tint=0.7, specular=0.2),
    "principled_sheen": _principled(sheen=1.0, sheen_tint=0.6, flatness=0.7),
    "principled_clearcoat": _principled(clearcoat=1.0, clearcoat_gloss=0.2, roughness=0.8),
    "principled_glossy_clearcoat": _principled(clearcoat=0.5, clearcoat_gloss=0.9, roughness=0.8),
    "principled_glass": _principled(spec_trans=1.0, eta=1.5, roughness=0.5),
    "principled_half_glass": _principled(spec_trans=0.5, eta=1.33, roughness=0.6, metallic=0.2),
    "principled_tinted_glass": _principled(spec_trans=0.5, eta=1.6, roughness=0.6, spec_tint=1.0),
    "principled_everything": _principled(**_EVERYTHING),
    "principledthin": _thin(),
    "principledthin_diffuse": _thin(diff_trans=1.2, roughness=0.9, sheen=0.5),
    "principledthin_glossy": _thin(spec_trans=1.0, roughness=0.6, spec_tint=0.3, eta=1.8),
    "principledthin_everything": _thin(**_SHEET),
}
ANISOTROPIC = {
    "roughconductor_brushed_ggx": {**_METAL, "distribution": "ggx", "alpha_u": 0.1, "alpha_v": 0.5},
    "roughconductor_brushed_beckmann": {**_METAL, "distribution": "beckmann", "alpha_u": 0.4, "alpha_v": 0.15},
    "roughconductor_brushed_coarse": {"type": "roughconductor", "distribution": "ggx", "alpha_u": 1.0, "alpha_v": 0.3},
    "roughdielectric_brushed_ggx": {
        **_GLASS,
        "distribution": "ggx",
        "alpha_u": 0.15,
        "alpha_v": 0.5,
        "specular_reflectance": rgb(0.9, 0.8, 0.7),
        "specular_transmittance": rgb(0.7, 0.8, 0.9),
    },
    "roughdielectric_brushed_beckmann": {**_GLASS, "distribution": "beckmann", "alpha_u": 0.4, "alpha_v": 0.2},
    "principled_brushed": _principled(anisotropic=0.8, metallic=0.7, roughness=0.4),
    "principled_brushed_everything": _principled(anisotropic=1.0, **_EVERYTHING),
    "principledthin_brushed": _thin(anisotropic=0.9, **_SHEET),
}
POLARIMETRIC = {
    "pplastic_ggx": _plastic(type="pplastic", distribution="ggx", alpha=0.3, specular_reflectance=rgb(0.9, 0.5, 0.2)),
    "pplastic_beckmann": _plastic(type="pplastic", distribution="beckmann", alpha=0.15, int_ior=1.8, ext_ior=1.0),
}
HAIR = {
    "hair": {"type": "hair"},
    "hair_blond": {"type": "hair", "eumelanin": 0.3, "pheomelanin": 0.5, "azimuthal_roughness": 0.6},
    "hair_dyed": {"type": "hair", "sigma_a": rgb(0.1, 0.3, 0.6), "scale": 2.0, "scale_tilt": -4.0},
    "hair_sleek": {"type": "hair", "longitudinal_roughness": 0.15, "azimuthal_roughness": 0.15, "int_ior": 1.4},
    "hair_coarse": {"type": "hair", "longitudinal_roughness": 0.8, "azimuthal_roughness": 0.9, "ext_ior": 1.1},
}
DELTA = {
    "conductor": {"type": "conductor", "material": "Cu"},
    "plastic": _plastic(specular_reflectance=rgb(0.9, 0.5, 0.2)),
    "thindielectric": {"type": "thindielectric", "specular_reflectance": 0.9, "specular_transmittance": 0.7},
    "thin_pane": {"type": "thindielectric", "int_ior": 1.8, "ext_ior": 1.0},
}

FILES = {
    "bsdf_references.npz": (SMOOTH, DELTA),
    "anisotropic_bsdf_references.npz": (ANISOTROPIC, {}),
    "pplastic_bsdf_references.npz": (POLARIMETRIC, {}),
    "hair_bsdf_references.npz": (HAIR, {}),
}
ALL_SMOOTH = SMOOTH | ANISOTROPIC | POLARIMETRIC | HAIR


def directions(n: int = N, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (n, 3) of unit vectors: a third near mirror directions, a third near the refracted ones, of either side."""
    rng = np.random.default_rng(seed)
    wi, other = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, n, 3)))
    wi[: 3 * n // 4, 2] = np.abs(wi[: 3 * n // 4, 2])
    towards = np.stack([wi * [-1, -1, 1], -wi, other])[np.arange(n) % 3, np.arange(n)]
    wo = towards + 0.4 * other
    return wi.astype(np.float32), (wo / np.linalg.norm(wo, axis=1, keepdims=True)).astype(np.float32)
