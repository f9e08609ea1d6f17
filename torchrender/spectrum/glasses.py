"""Transparent materials by name: Sellmeier's coefficients, and where they come from."""

from __future__ import annotations

import torch

from ..errors import describe, nearest
from .indices import sellmeier

_SCHOTT = "Schott, optical glass catalogue, 2017"

# B1, B2, B3, then C1, C2, C3 in square micrometres. Schott's are relative to air, at 20 degrees.
_CATALOGUE = {
    "N-BK7": (1.03961212, 0.231792344, 1.01046945, 0.00600069867, 0.0200179144, 103.560653),
    "N-K5": (1.08511833, 0.199562005, 0.930511663, 0.00661099503, 0.024110866, 111.982777),
    "N-BAK4": (1.28834642, 0.132817724, 0.945395373, 0.00779980626, 0.0315631177, 105.965875),
    "N-BAF10": (1.5851495, 0.143559385, 1.08521269, 0.00926681282, 0.0424489805, 105.613573),
    "N-SK16": (1.34317774, 0.241144399, 0.994317969, 0.00704687339, 0.0229005, 92.7508526),
    "N-FK51A": (0.971247817, 0.216901417, 0.904651666, 0.00472301995, 0.0153575612, 168.68133),
    "F2": (1.34533359, 0.209073176, 0.937357162, 0.00997743871, 0.0470450767, 111.886764),
    "N-F2": (1.39757037, 0.159201403, 1.2686543, 0.00995906143, 0.0546931752, 119.248346),
    "N-SF5": (1.52481889, 0.187085527, 1.42729015, 0.011254756, 0.0588995392, 129.141675),
    "N-SF6": (1.77931763, 0.338149866, 2.08734474, 0.0133714182, 0.0617533621, 174.01759),
    "SF10": (1.61625977, 0.259229334, 1.07762317, 0.0127534559, 0.0581983954, 116.60768),
    "N-SF11": (1.73759695, 0.313747346, 1.89878101, 0.013188707, 0.0623068142, 155.23629),
    "N-LASF9": (2.00029547, 0.298926886, 1.80691843, 0.0121426017, 0.0538736236, 156.530829),
}

# B, wavelengths of resonances in micrometres (their squares are C), origin
_PAPERS = {
    "fused silica": (
        (0.6961663, 0.4079426, 0.8974794),
        (0.0684043, 0.1162414, 9.896161),
        "I. H. Malitson, J. Opt. Soc. Am. 55, 1205 (1965)",
    ),
    "diamond": ((0.3306, 4.3356), (0.175, 0.106), "F. Peter, Z. Phys. 15, 358 (1923)"),
    "sapphire": (  # the ordinary ray
        (1.4313493, 0.65054713, 5.3414021),
        (0.0726631, 0.1193242, 18.028251),
        "I. H. Malitson and M. J. Dodge, J. Opt. Soc. Am. 62, 1405 (1972)",
    ),
    "CaF2": (
        (0.5675888, 0.4710914, 3.8484723),
        (0.050263605, 0.1003909, 34.64904),
        "I. H. Malitson, Appl. Opt. 2, 1103 (1963)",
    ),
    "BaF2": (
        (0.643356, 0.506762, 3.8261),
        (0.057789, 0.10968, 46.3864),
        "I. H. Malitson, J. Opt. Soc. Am. 54, 628 (1964)",
    ),
    "MgF2": (  # the ordinary ray
        (0.48755108, 0.39875031, 2.3120353),
        (0.04338408, 0.09461442, 23.793604),
        "M. J. Dodge, Appl. Opt. 23, 1980 (1984)",
    ),
}

# name -> B, C, origin
GLASSES: dict[str, tuple[tuple[float, ...], tuple[float, ...], str]] = {
    **{name: (row[:3], row[3:], _SCHOTT) for name, row in _CATALOGUE.items()},
    **{name: (b, tuple(at * at for at in resonances), origin) for name, (b, resonances, origin) in _PAPERS.items()},
    "water": (  # at 20 degrees
        (0.5684027565, 0.1726177391, 0.02086189578, 0.1130748688),
        (0.005101829712, 0.01821153936, 0.02620722293, 10.69792721),
        "M. Daimon and A. Masumura, Appl. Opt. 46, 3811 (2007)",
    ),
}


def glass(name: str) -> torch.Tensor:
    """The index of refraction of a material, a table (471,), float64; by the published formula that `GLASSES` has.

    Args:
        name: ``"N-BK7"``, ``"SF10"``, ``"fused silica"``, ``"water"`` and others, which an error lists.

    Raises:
        ValueError: naming the materials that there are, or those with a name like this.
    """
    known = {_plain(known): known for known in GLASSES}
    if not isinstance(name, str) or _plain(name) not in known:
        hint = nearest(name, GLASSES) if isinstance(name, str) else nearest("", GLASSES)
        raise ValueError(f"name: expected a material, got {describe(name)}; {hint}")
    b, c, _ = GLASSES[known[_plain(name)]]
    return sellmeier(torch.tensor(b, dtype=torch.float64), torch.tensor(c, dtype=torch.float64))


def _plain(name: str) -> str:
    return name.lower().replace(" ", "").replace("_", "").replace("-", "")
