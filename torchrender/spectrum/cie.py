"""Colours of spectra: the CIE 1931 standard observer, daylight D65, and linear sRGB.

Tables from 360 to 830 nm in steps of 5 nm: the colour-matching functions of ISO/CIE 11664-1 (2-degree observer) and the
illuminant D65 of ISO/CIE 11664-2.
"""

from __future__ import annotations

import functools

import numpy as np

X = """
0.0001299 0.0002321 0.0004149 0.0007416 0.001368 0.002236 0.004243 0.00765 0.01431 0.02319 0.04351 0.07763 0.13438
0.21477 0.2839 0.3285 0.34828 0.34806 0.3362 0.3187 0.2908 0.2511 0.19536 0.1421 0.09564 0.05795 0.03201 0.0147
0.0049 0.0024 0.0093 0.0291 0.06327 0.1096 0.1655 0.22575 0.2904 0.3597 0.43345 0.51205 0.5945 0.6784 0.7621 0.8425
0.9163 0.9786 1.0263 1.0567 1.0622 1.0456 1.0026 0.9384 0.85445 0.7514 0.6424 0.5419 0.4479 0.3608 0.2835 0.2187
0.1649 0.1212 0.0874 0.0636 0.04677 0.0329 0.0227 0.01584 0.0113592 0.00811092 0.00579035 0.00410946 0.00289933
0.00204919 0.00143997 0.000999949 0.000690079 0.000476021 0.000332301 0.000234826 0.00016615 0.000117413 8.30753e-05
5.87065e-05 4.15099e-05 2.93533e-05 2.06738e-05 1.45598e-05 1.0254e-05 7.22146e-06 5.08587e-06 3.58165e-06
2.52252e-06 1.77651e-06 1.25114e-06
"""
Y = """
3.917e-06 6.965e-06 1.239e-05 2.202e-05 3.9e-05 6.4e-05 0.00012 0.000217 0.000396 0.00064 0.00121 0.00218 0.004
0.0073 0.0116 0.01684 0.023 0.0298 0.038 0.048 0.06 0.0739 0.09098 0.1126 0.13902 0.1693 0.20802 0.2586 0.323 0.4073
0.503 0.6082 0.71 0.7932 0.862 0.91485 0.954 0.9803 0.99495 1 0.995 0.9786 0.952 0.9154 0.87 0.8163 0.757 0.6949
0.631 0.5668 0.503 0.4412 0.381 0.321 0.265 0.217 0.175 0.1382 0.107 0.0816 0.061 0.04458 0.032 0.0232 0.017 0.01192
0.00821 0.005723 0.004102 0.002929 0.002091 0.001484 0.001047 0.00074 0.00052 0.0003611 0.0002492 0.0001719 0.00012
8.48e-05 6e-05 4.24e-05 3e-05 2.12e-05 1.499e-05 1.06e-05 7.4657e-06 5.2578e-06 3.7029e-06 2.6078e-06 1.8366e-06
1.2934e-06 9.1093e-07 6.4153e-07 4.5181e-07
"""
Z = """
0.0006061 0.001086 0.001946 0.003486 0.00645 0.01055 0.02005 0.03621 0.06785 0.1102 0.2074 0.3713 0.6456 1.03905
1.3856 1.62296 1.74706 1.7826 1.77211 1.7441 1.6692 1.5281 1.28764 1.0419 0.81295 0.6162 0.46518 0.3533 0.272 0.2123
0.1582 0.1117 0.07825 0.05725 0.04216 0.02984 0.0203 0.0134 0.00875 0.00575 0.0039 0.00275 0.0021 0.0018 0.00165
0.0014 0.0011 0.001 0.0008 0.0006 0.00034 0.00024 0.00019 0.0001 5e-05 3e-05 2e-05 1e-05 0 0 0 0 0 0 0 0 0 0 0 0 0 0
0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0
"""
D65 = """
46.6383 49.3637 52.0891 51.0323 49.9755 52.3118 54.6482 68.7015 82.7549 87.1204 91.486 92.4589 93.4318 90.057
86.6823 95.7736 104.865 110.936 117.008 117.41 117.812 116.336 114.861 115.392 115.923 112.367 108.811 109.082
109.354 108.578 107.802 106.296 104.79 106.239 107.689 106.047 104.405 104.225 104.046 102.023 100 98.1671 96.3342
96.0611 95.788 92.2368 88.6856 89.3459 90.0062 89.8026 89.5991 88.6489 87.6987 85.4936 83.2886 83.4939 83.6992
81.863 80.0268 80.1207 80.2146 81.2462 82.2778 80.281 78.2842 74.0027 69.7213 70.6652 71.6091 72.979 74.349 67.9765
61.604 65.7448 69.8856 72.4863 75.087 69.3398 63.5927 55.0054 46.4182 56.6118 66.8054 65.0941 63.3828 63.8434 64.304
61.8779 59.4519 55.7054 51.959 54.6998 57.4406 58.8765 60.3125
"""

FIRST, LAST, STEP = 360.0, 830.0, 5.0
# From XYZ to linear sRGB, IEC 61966-2-1.
XYZ_TO_RGB = np.array(
    [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
)
PLANCK, LIGHT, BOLTZMANN = 6.62607015e-34, 2.99792458e8, 1.380649e-23


def numbers(text: str) -> np.ndarray:
    """The numbers of one of these tables."""
    return np.array(text.split(), np.float64)


@functools.lru_cache(maxsize=1)
def _weights() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A fine grid of wavelengths (N,) in nm, and on it the weights (N, 3) of X, Y, Z in daylight and in equal energy.

    Each column sums to the XYZ of a spectrum of ones: the D65 white of linear sRGB, and (1, 1, 1).
    """
    grid = np.linspace(FIRST, LAST, 4701)
    known = np.arange(FIRST, LAST + 1, STEP)
    matching = np.stack([np.interp(grid, known, numbers(t)) for t in (X, Y, Z)], axis=1)
    matching[[0, -1]] /= 2  # trapezoids
    daylight = matching * np.interp(grid, known, numbers(D65))[:, None]
    white = np.linalg.solve(XYZ_TO_RGB, np.ones(3))
    return grid, daylight * (white / daylight.sum(0)), matching / matching.sum(0)


def rgb_of_spectrum(wavelengths: np.ndarray, values: np.ndarray, emission: bool) -> np.ndarray:
    """The linear sRGB colour of a tabulated spectrum, linear in between and zero beyond its ends; not clipped.

    Args:
        wavelengths: (N,) in nm, increasing, N >= 2.
        values: (N,) at these.
        emission: of light, seen as it is: a spectrum of ones has X = Y = Z = 1, the colour
            (1.2048, 0.9483, 0.9089). Else of a factor such as a reflectance, seen in daylight (D65): ones are white.

    Returns:
        (3,) red, green and blue, negative where the colour is out of the gamut.
    """
    grid, daylight, equal = _weights()
    spectrum = np.interp(grid, wavelengths, values, left=0.0, right=0.0)
    return XYZ_TO_RGB @ (spectrum @ (equal if emission else daylight))


def blackbody(temperature: float, low: float = FIRST, high: float = LAST) -> tuple[np.ndarray, np.ndarray]:
    """Planck's law: wavelengths in nm from `low` to `high` and the radiance there in W / (m^2 sr nm)."""
    wavelengths = np.linspace(max(low, FIRST), min(high, LAST), 471)
    metres = wavelengths * 1e-9
    with np.errstate(over="ignore"):
        exponent = np.expm1(PLANCK * LIGHT / (metres * BOLTZMANN * temperature))
    return wavelengths, 2e-9 * PLANCK * LIGHT**2 / metres**5 / exponent
