"""Sun and sky of a clear day as tensors: an environment map, and the sun's light.

Preetham, Shirley and Smits, "A Practical Analytic Model for Daylight", SIGGRAPH 1999: luminance and chromaticity of
the sky by Perez's formula (appendix A.2), sunlight after the losses in the atmosphere (appendix A.1, with data of
Iqbal, "An Introduction to Solar Radiation", 1983). Mitsuba's `sunsky` has the model of Hosek and Wilkie (2012), which
knows the ground's albedo. On a horizontal plane, for turbidity 3 and the sun at 45 degrees, the sky here gives 1.6
(blue) to 1.8 times (red) the irradiance of theirs, the sun 0.9 to 1.0 times.

Directions here are those of an environment map's own frame: +y is up. Radiance is linear sRGB in W / (m^2 sr nm), the
scale of Mitsuba's: white of 1 has the luminance of a spectrum of 1, 683 lm/W times 106.86 nm, which is 73 kcd/m^2.
"""

from __future__ import annotations

import datetime
import functools
import math
from typing import Any

import numpy as np
import torch

from .scene import values
from .scene.context import Context
from .spectrum import cie

TURBIDITY = (2.0, 10.0)  # the paper's simulations are for 2 to 6; at 11 the zenith is black at sunset
SUN_ANGLE = 0.5338  # degrees, the sun's diameter as seen from the earth
_SOLID_ANGLE = 2 * math.pi * (1 - math.cos(math.radians(SUN_ANGLE / 2)))
_MAX_HEIGHT = 1 << 12
# cd / m^2 of a spectrum of ones in W / (m^2 sr nm): 683 lm / W times the integral of the luminous efficiency in nm.
_LUMINANCE = 683.002 * 106.856895

# Appendix A.2: coefficients A to E of Perez's formula, slope and offset by turbidity, of Y, x and y.
_PEREZ = (
    ((0.1787, -1.4630), (-0.3554, 0.4275), (-0.0227, 5.3251), (0.1206, -2.5771), (-0.0670, 0.3703)),
    ((-0.0193, -0.2592), (-0.0665, 0.0008), (-0.0004, 0.2125), (-0.0641, -0.8989), (-0.0033, 0.0452)),
    ((-0.0167, -0.2608), (-0.0950, 0.0092), (-0.0079, 0.2102), (-0.0441, -1.6537), (-0.0109, 0.0529)),
)
# Chromaticity x and y at the zenith: rows by T^2, T, 1, columns by theta^3, theta^2, theta, 1.
_ZENITH = (
    ((0.00166, -0.00375, 0.00209, 0.0), (-0.02903, 0.06377, -0.03202, 0.00394), (0.11693, -0.21196, 0.06052, 0.25886)),
    ((0.00275, -0.00610, 0.00317, 0.0), (-0.04214, 0.08970, -0.04153, 0.00516), (0.15346, -0.26756, 0.06670, 0.26688)),
)

# Radiance of the sun above the atmosphere, 380 to 750 nm in steps of 10 nm, in 100 W / (m^2 sr nm).
_SUN = """
165.5 162.3 211.2 258.8 258.2 242.3 267.6 296.6 305.4 300.6 306.6 288.3 287.1 278.2 271.0 272.3 263.6 255.0 250.6 253.1
253.5 251.3 246.3 241.7 236.8 232.1 228.2 223.4 219.7 215.3 211.0 207.3 202.4 198.7 194.3 190.7 186.3 182.6
"""
# Absorption of ozone, 445 to 605 nm in steps of 5 nm and on to 790 nm in steps of 10 nm, in 1 / cm; none from 355 nm.
_OZONE = """
.003 .003 .004 .006 .008 .009 .012 .014 .017 .021 .025 .03 .035 .04 .045 .048 .057 .063 .07 .075 .08 .085 .095 .103
.110 .12 .122 .12 .118 .115 .12 .125 .130 .12 .105 .09 .079 .067 .057 .048 .036 .028 .023 .018 .014 .011 .010 .009
.007 .004 0 0
"""
# Water vapour, 690 to 750 nm in steps of 10 nm. (Mixed gases absorb beyond 759 nm, where the sun's table has ended.)
_WATER = ".016 .024 .0125 1.0 .87 .061 .001"


def sky(sun_direction: Any, turbidity: Any = 3.0, *, height: int = 512) -> torch.Tensor:
    """Radiance of a clear sky without its sun, as the texels of an environment map.

    ``tr.EnvironmentMap(data=tr.sky([0.3, 0.5, -1.0]))``. Differentiable in all but `height`: with
    ``params={"sky.data": tr.sky(direction, turbidity)}`` an image is, too.

    Args:
        sun_direction: towards the sun (3,), of any length; +y is up, and the sun is not below the horizon.
        turbidity: haze, from 2, very clear, over 3, clear, to 10. The model is made for 2 to 6.
        height: rows of the map, 2 to 4096; it has twice as many columns.

    Returns:
        (height, 2 height, 3), linear sRGB as the module says; zero below the horizon. What falls out of the gamut is
        clipped at zero.

    Raises:
        ValueError: naming the argument, for values out of range.
    """
    ctx = Context(path=("sky",))
    towards, turbidity = checked(sun_direction, turbidity, ctx)
    directions = _directions(map_height(height, ctx), towards)
    up = directions[..., 1].clamp(min=1e-3)  # at the horizon exp(B / cos) is zero anyway
    cosine = (directions * towards).sum(-1)
    gamma = _angle(torch.linalg.cross(directions, towards.expand_as(directions)), cosine)
    theta = _angle(torch.stack([towards[0], towards[2]]), towards[1])
    one = torch.ones_like(theta)
    zenith = (_zenith_luminance(theta, turbidity), *(_zenith_chromaticity(c, theta, turbidity) for c in _ZENITH))
    luminance, x, y = (
        z * _perez(c, turbidity, up, gamma, cosine) / _perez(c, turbidity, one, theta, towards[1])
        for c, z in zip(_PEREZ, zenith, strict=True)
    )
    luminance = luminance * (1000 / _LUMINANCE)
    xyz = torch.stack([x / y * luminance, luminance, (1 - x - y) / y * luminance], dim=-1)
    rgb = (xyz @ xyz.new_tensor(cie.XYZ_TO_RGB).T).clamp(min=0)
    return torch.where(directions[..., 1:2] > 0, rgb, torch.zeros_like(rgb))


def sun(sun_direction: Any, turbidity: Any = 3.0) -> torch.Tensor:
    """Irradiance (3,) by the sun, through a clear sky, of a plane that faces it: linear sRGB, differentiable.

    Of the losses on the way, by Rayleigh scattering, aerosols, ozone (0.35 cm) and water vapour (2 cm). With a
    directional light: ``{"type": "directional", "direction": -d, "irradiance": tr.daylight.sun(d)}``.

    Args:
        sun_direction, turbidity: as for `sky`.

    Raises:
        ValueError: naming the argument, for values out of range.
    """
    direction, turbidity = checked(sun_direction, turbidity, Context(path=("sun",)))
    theta = _angle(torch.stack([direction[0], direction[2]]), direction[1])
    wavelengths, radiance, ozone, water, to_rgb = (torch.as_tensor(a).to(direction) for a in _tables())
    micrometres = wavelengths / 1000
    # relative optical mass; at the horizon the sun's centre may be there to rounding only
    degrees = torch.rad2deg(theta).clamp(max=90.0)
    mass = 1 / (direction[1].clamp(min=0) + 0.15 * (93.885 - degrees) ** -1.253)
    depth = 0.008735 * micrometres**-4.08
    depth = depth + (0.04608 * turbidity - 0.04586) * micrometres**-1.3 + 0.35 * ozone
    vapour = 2.0 * water * mass
    depth = depth * mass + 0.2385 * vapour / (1 + 20.07 * vapour) ** 0.45
    return (to_rgb @ (radiance * torch.exp(-depth)) * _SOLID_ANGLE).clamp(min=0)


def sun_disc(
    sun_direction: Any, irradiance: Any, *, height: int = 512, sun_aperture: float = SUN_ANGLE
) -> torch.Tensor:
    """The sun as a bright disc in an environment map; add it to a `sky` of the same height.

    Its integral over the sphere is exact at any resolution; it is not smaller than about two texels. The map is
    differentiable in the irradiance and, since the edge is soft by a texel, in the direction.

    Args:
        sun_direction: as for `sky`.
        irradiance: of a plane that faces the sun, a colour (3,) such as `sun` gives: the integral.
        height: rows of the map.
        sun_aperture: its diameter in degrees, up to 90. The irradiance does not depend on it.

    Returns:
        (height, 2 height, 3), linear radiance.

    Raises:
        ValueError: naming the argument, for values out of range.
    """
    ctx = Context(path=("sun_disc",))
    direction, _ = checked(sun_direction, 3.0, ctx)
    rows = map_height(height, ctx)
    colour = values.vector(irradiance, ctx.at("irradiance")).to(direction)
    aperture = float(values.number(sun_aperture, ctx.at("sun_aperture")).detach())
    if not 0 < aperture <= 90:
        ctx.at("sun_aperture").error(f"expected degrees in (0, 90], got {aperture:g}")
    texel = math.pi / (rows - 1)
    radius = max(math.radians(aperture / 2), texel)
    # An edge linear in the square of the distance: smooth at the centre.
    distance = (_directions(rows, direction) - direction).square().sum(-1)
    weight = (0.5 + (radius**2 - distance) / (2 * radius * texel)).clamp(0, 1)
    total = (weight * _solid_angles(rows).to(weight)[:, None]).sum()
    return weight[..., None] * (colour / total)


def sun_position(
    latitude: float,
    longitude: float,
    timezone: float,
    year: int,
    month: int,
    day: int,
    hour: float,
    minute: float = 0.0,
    second: float = 0.0,
) -> tuple[float, float, float]:
    """Towards the sun at a place and time: the unit vector's parts to the east, to the north and up.

    Blanco-Muriel, Alarcon-Padilla, Lopez-Moratalla and Lara-Coira, "Computing the solar vector", Solar Energy 70
    (2001): to 0.01 degrees from 1999 to 2015, and little worse for decades around that. Refraction is left out.

    Args:
        latitude, longitude: degrees, to the north and the east.
        timezone: hours that the clock is ahead of universal time.
        year, month, day, hour, minute, second: what calendar (Gregorian) and clock show.

    Raises:
        ValueError: if there is no such day.
    """
    universal = hour + minute / 60 + second / 3600 - timezone
    # since noon of 1 January 2000
    days = (datetime.date(year, month, day) - datetime.date(2000, 1, 1)).days - 0.5 + universal / 24
    node = 2.1429 - 0.0010394594 * days
    anomaly = 6.2400600 + 0.0172019699 * days
    length = 4.8950630 + 0.017202791698 * days + 0.03341607 * math.sin(anomaly) + 0.00034894 * math.sin(2 * anomaly)
    length -= 0.0001134 + 0.0000203 * math.sin(node)
    tilt = 0.4090928 - 6.2140e-9 * days + 0.0000396 * math.cos(node)
    ascension = math.atan2(math.cos(tilt) * math.sin(length), math.cos(length))
    declination = math.asin(math.sin(tilt) * math.sin(length))
    sidereal = 6.6974243242 + 0.0657098283 * days + universal
    turned = math.radians(15 * sidereal + longitude) - ascension
    north = math.radians(latitude)
    height = math.cos(north) * math.cos(turned) * math.cos(declination) + math.sin(declination) * math.sin(north)
    zenith = math.acos(max(-1.0, min(1.0, height)))
    zenith += 6371.01 / 149597890 * math.sin(zenith)  # parallax
    azimuth = math.atan2(
        -math.sin(turned) * math.cos(declination),
        math.sin(declination) * math.cos(north) - math.cos(declination) * math.sin(north) * math.cos(turned),
    )
    return math.sin(azimuth) * math.sin(zenith), math.cos(azimuth) * math.sin(zenith), math.cos(zenith)


# ---------------------------------------------------------------------------------------------------------- arguments
def checked(direction: Any, turbidity: Any, ctx: Context) -> tuple[torch.Tensor, torch.Tensor]:
    """Unit vector towards the sun and turbidity, of one dtype."""
    given = values.vector(direction, ctx.at("sun_direction"))
    haze = values.number(turbidity, ctx.at("turbidity"))
    dtype = torch.promote_types(given.dtype, haze.dtype) if isinstance(turbidity, torch.Tensor) else given.dtype
    given, haze = given.to(dtype), haze.to(dtype=dtype, device=given.device)
    length = torch.linalg.vector_norm(given)
    if not 0 < float(length.detach()) < math.inf:
        ctx.at("sun_direction").error(f"expected a finite direction that is not zero, got {given.tolist()}")
    unit = given / length
    if not float(unit[1].detach()) > -1e-6:
        ctx.at("sun_direction").error(
            f"the sun is below the horizon: {math.degrees(math.asin(float(unit[1].detach()))):.4g} degrees"
        )
    low, high = TURBIDITY
    if not low <= float(haze.detach()) <= high:
        ctx.at("turbidity").error(f"expected {low:g} to {high:g}, got {float(haze.detach()):g}")
    return unit, haze


def map_height(height: Any, ctx: Context) -> int:
    """The number of rows of the sky's map, checked."""
    rows = values.integer(height, ctx.at("height"), minimum=2)
    if rows > _MAX_HEIGHT:
        ctx.at("height").error(f"expected at most {_MAX_HEIGHT} rows, got {rows}")
    return rows


# -------------------------------------------------------------------------------------------------------- the map
def _directions(rows: int, like: torch.Tensor) -> torch.Tensor:
    """The directions (rows, 2 rows, 3) of the texels of an environment map."""
    settings = {"dtype": like.dtype, "device": like.device}
    theta = torch.arange(rows, **settings) * (math.pi / (rows - 1))
    phi = (torch.arange(2 * rows, **settings) + 0.5) * (math.pi / rows)
    sine, cosine = torch.sin(theta)[:, None], torch.cos(theta)[:, None]
    x, z = sine * torch.sin(phi), -sine * torch.cos(phi)
    return torch.stack([x, cosine.expand_as(x), z], dim=-1)


def _solid_angles(rows: int) -> torch.Tensor:
    """The integral (rows,) over the sphere of a texel's share in the bilinear map, for each row."""
    step = math.pi / (rows - 1)
    theta = torch.arange(rows, dtype=torch.float64) * step
    share = torch.sin(theta) * (2 * (1 - math.cos(step)) / step)
    share[0] = share[-1] = 1 - math.sin(step) / step
    return share * (math.pi / rows)


def _angle(across: torch.Tensor, along: torch.Tensor) -> torch.Tensor:
    """The angle of a vector to an axis; its derivative where that is zero is taken to be zero."""
    squared = across.square().sum(-1)
    parallel = squared == 0
    length = torch.where(parallel, torch.ones_like(squared), squared).sqrt()
    return torch.atan2(torch.where(parallel, torch.zeros_like(length), length), along)


# ------------------------------------------------------------------------------------------------------ the model
def _perez(
    coefficients: Any, turbidity: torch.Tensor, up: torch.Tensor, gamma: torch.Tensor, cosine: torch.Tensor
) -> torch.Tensor:
    """Perez's formula (eq. 3) at a cosine `up` to the zenith and an angle `gamma`, with its cosine, to the sun."""
    a, b, c, d, e = (slope * turbidity + offset for slope, offset in coefficients)
    return (1 + a * torch.exp(b / up)) * (1 + c * torch.exp(d * gamma) + e * cosine * cosine)


def _zenith_luminance(theta: torch.Tensor, turbidity: torch.Tensor) -> torch.Tensor:
    """In kcd / m^2, of the sun's angle to the zenith."""
    chi = (4 / 9 - turbidity / 120) * (math.pi - 2 * theta)
    return (4.0453 * turbidity - 4.9710) * torch.tan(chi) - 0.2155 * turbidity + 2.4192


def _zenith_chromaticity(table: Any, theta: torch.Tensor, turbidity: torch.Tensor) -> torch.Tensor:
    powers = torch.stack([theta**3, theta**2, theta, torch.ones_like(theta)])
    return torch.stack([turbidity**2, turbidity, torch.ones_like(turbidity)]) @ powers.new_tensor(table) @ powers


@functools.lru_cache(maxsize=1)
def _tables() -> tuple[Any, ...]:
    """Wavelengths (K,) in nm; there the sun's radiance, the absorption of ozone and of water; weights (3, K) of RGB."""
    known = np.arange(380.0, 751.0, 10.0)
    grid = np.arange(380.0, 751.0, 5.0)
    radiance = np.interp(grid, known, 100 * np.array(_SUN.split(), np.float64))
    places = np.concatenate([[355.0], np.arange(445.0, 606.0, 5.0), np.arange(610.0, 791.0, 10.0)])
    ozone = np.interp(grid, places, np.array(["0", *_OZONE.split()], np.float64))
    water = np.interp(grid, [689.0, *np.arange(690.0, 751.0, 10.0)], np.array(["0", *_WATER.split()], np.float64))
    # Linear in the values at the wavelengths: one column each.
    columns = [cie.rgb_of_spectrum(grid, row, emission=True) for row in np.eye(len(grid))]
    return grid, radiance, ozone, water, np.stack(columns, axis=1)
