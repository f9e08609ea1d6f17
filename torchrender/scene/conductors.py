"""Metals and their like by name: their complex indices of refraction, as colours and as spectra.

The measurements are those that Mitsuba 3.9.1 has as tables (`bench/make_conductor_spectra.py` reads them), which name
the database luxpop as their source. Where luxpop has them from, by what the tables say:

* "Handbook of Optical Constants of Solids", ed. E. D. Palik, 1985: Ni_palik.
* "Handbook of Optical Constants of Solids II", ed. E. D. Palik, 1991: AlAs, AlSb, HgTe, K, Li, Na_palik, Se, SnTe, Te,
  ThF4, V_palik.
* Palik, either volume, and at wavelengths too short to be seen others: Be, Cr, CsI, Cu2O, CuO, d-C, Hg, Ir, MgO, Mo,
  Nb, Rh, SiC, Ta, TiC, TiN, TiO2, VC, VN, W; a-C likewise, and D. Windt, 1988.
* Nothing is said of Ag, Al, Au and Cu. Their wavelengths are steps of 0.05 eV, as in the database of SOPRA, from which
  they are presumably.

Se and Te are ordinary rays. TiO2 says that it is one, but its numbers (2.91 at 589 nm) are those of rutile's
extraordinary ray. CsI, d-C, MgO and ThF4 are transparent: k is 0, or nearly. Of SnTe, which is not, k is missing, too.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from ..errors import nearest
from ..spectrum import cie

# Real and imaginary part of the index of refraction, as red, green and blue of the spectra as they are, without an
# illuminant, read back from the rgb variant of Mitsuba's `conductor`: where nothing was measured they count as 0.
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

_FILE = Path(__file__).with_name("conductors.npz")
_NODES = np.linspace(cie.FIRST, cie.LAST, 95)  # nm


def conductor_spectra(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Index of refraction (eta, k) of a metal of `CONDUCTORS`, each float64 (471,): at every nm from 360 to 830.

    Straight lines between multiples of 5 nm. Beyond `conductor_range` the outermost measurement is held, and the eta of
    AlAs between 387 and 443 nm, which is missing, lies on a straight line.

    Raises:
        KeyError: there is no such metal.
    """
    row = _row(name)
    grid = np.arange(cie.FIRST, cie.LAST + 1.0)
    return np.interp(grid, _NODES, _tables()["eta"][row]), np.interp(grid, _NODES, _tables()["k"][row])


def conductor_range(name: str) -> tuple[float, float]:
    """The first and last wavelength between 360 and 830 nm that the measurements of a metal cover.

    Raises:
        KeyError: there is no such metal.
    """
    low, high = _tables()["range"][_row(name)]
    return float(low), float(high)


def _row(name: str) -> int:
    if name not in CONDUCTORS:
        raise KeyError(f"unknown metal {name!r}; {nearest(str(name), CONDUCTORS)}")
    return list(_tables()["names"]).index(name)


@cache
def _tables() -> dict[str, np.ndarray]:
    """By name `names` (37,), `eta` and `k` (37, 95) at `_NODES` and `range` (37, 2)."""
    with np.load(_FILE) as file:
        return {name: file[name].astype(np.float64) if name != "names" else file[name] for name in file.files}
