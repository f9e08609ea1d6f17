"""Small scenes for spectral rendering, one for each group of models, as plain dictionaries of numbers and arrays.

`bench/make_spectral_references.py` renders them in Mitsuba 3.9.1's spectral mode into
`tests/data/mitsuba_spectral.npz`, `tests/spectrum/test_mitsuba_references.py` renders them with torchrender and
compares. This module needs NumPy alone, so that both environments can import it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from reference_parts import (
    _camera,
    _diffuse,
    _floor,
    _lamp,
    _noise,
    _rgb,
    _scene,
    rotate,
    scale,
    translate,
)

SIZE = 32  # pixels along either side of the film
BLOCK = 8  # pixels along either side of the blocks over which references are averaged
PATH = {"type": "path", "max_depth": 5, "rr_depth": 100}
SKY = {"type": "constant", "radiance": _rgb(0.9, 0.8, 1.1)}


def _view(origin=(0.0, 1.0, 5.0), target=(0.0, 0.0, 0.0), fov=40.0, **film) -> dict:
    return _camera(origin, target, fov, film={"width": SIZE, "height": SIZE, **film})


def _texture(seed: int, height: int, width: int, low: float = 0.1, high: float = 0.9) -> dict:
    """Linear colours, which Mitsuba turns into spectra unless they are `raw`."""
    return {"type": "bitmap", "data": _noise(seed, height, width, low, high)}


def _ball(x: float, y: float, bsdf: dict, radius: float = 0.55) -> dict:
    return {"type": "sphere", "center": [x, y, 0.0], "radius": radius, "bsdf": bsdf}


def _measured(wavelengths: str, values: str) -> dict:
    return {"type": "irregular", "wavelengths": wavelengths, "values": values}


def _wall(place, reflectance) -> dict:
    return {"type": "rectangle", "to_world": place, "bsdf": _diffuse(reflectance)}


def _room(lamp: dict, white, left, right, tall, low) -> dict:
    """The Cornell box's arrangement with a larger lamp, an opening towards the camera."""
    place = translate(0, 0.99, 0) @ rotate("x", 90) @ scale(0.7)
    return {
        "floor": _wall(translate(0, -1, 0) @ rotate("x", -90), white),
        "ceiling": _wall(translate(0, 1, 0) @ rotate("x", 90), white),
        "back": _wall(translate(0, 0, -1), white),
        "left": _wall(translate(-1, 0, 0) @ rotate("y", 90), left),
        "right": _wall(translate(1, 0, 0) @ rotate("y", -90), right),
        "tall": {
            "type": "cube",
            "to_world": translate(-0.35, -0.4, -0.3) @ rotate("y", 17) @ scale(0.3, 0.6, 0.3),
            "bsdf": _diffuse(tall),
        },
        "low": {
            "type": "cube",
            "to_world": translate(0.35, -0.7, 0.3) @ rotate("y", -17) @ scale(0.3),
            "bsdf": _diffuse(low),
        },
        "lamp": {"type": "rectangle", "to_world": place, "emitter": {"type": "area", "radiance": lamp}},
    }


WHITE, RED, GREEN = _rgb(0.73, 0.73, 0.73), _rgb(0.63, 0.065, 0.05), _rgb(0.14, 0.45, 0.091)


def _cornell_box() -> dict:
    room = _room(_rgb(16.0, 15.0, 12.0), WHITE, RED, GREEN, WHITE, WHITE)
    return _scene(PATH, _view((0, 0, 3.9), fov=39), **room)


def _blackbody() -> dict:
    """A room of saturated colours by a lamp of 2700 K."""
    lamp = {"type": "blackbody", "temperature": 2700.0}
    blue = _rgb(0.08, 0.12, 0.7)
    return _scene(PATH, _view((0, 0, 3.9), fov=39), **_room(lamp, WHITE, RED, GREEN, blue, _rgb(0.9, 0.75, 0.05)))


def _environment() -> dict:
    """A textured sphere on a textured floor in an environment map of one hue.

    Mitsuba interpolates the coefficients of the map's spectra and their factors, not the spectra: between texels of
    unlike hues there are others then, whose blocks of 8 x 8 pixels differ by up to 25 % in a map of random colours.
    """
    data = _noise(5, 8, 16, 0.1, 1.5, 1) * np.array([0.6, 0.8, 1.0], np.float32)
    sky = {"type": "envmap", "data": data, "to_world": rotate("y", 40), "scale": 0.8}
    ball = {"type": "sphere", "radius": 0.9, "bsdf": _diffuse(_texture(3, 8, 16))}
    return _scene(PATH, _view(), ball=ball, floor=_floor(_texture(4, 4, 4)), sky=sky)


def _metals(rough: bool) -> dict:
    names = {"gold": "Au", "copper": "Cu", "carbon": "a-C"}
    kind = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.25} if rough else {"type": "conductor"}
    balls = {
        name: _ball(1.2 * i - 1.2, -0.3, {**kind, "material": material})
        for i, (name, material) in enumerate(names.items())
    }
    return _scene(PATH, _view(), **balls, floor=_floor(_rgb(0.3, 0.5, 0.7)), sky=SKY)


def _daylight() -> dict:
    """Measured reflectances in a coloured light of daylight's spectrum."""
    sawtooth = {
        "type": "regular",
        "wavelength_min": 360.0,
        "wavelength_max": 830.0,
        "values": "0.1 0.9 0.2 0.8 0.3 0.7",
    }
    pink = _measured("360 420 480 530 600 660 830", "0.6 0.5 0.25 0.1 0.7 0.9 0.95")
    notch = _measured("400 550 560 590 600 700", "0.8 0.9 0.05 0.05 0.9 0.7")
    sky = {"type": "constant", "radiance": {"type": "d65", "scale": 1.5, "color": _rgb(0.9, 0.8, 0.5)}}
    return _scene(
        PATH,
        _view(),
        one=_ball(-1.2, -0.3, _diffuse(pink)),
        two=_ball(0.0, -0.3, _diffuse(notch)),
        three=_ball(1.2, -0.3, _diffuse(_rgb(0.2, 0.7, 0.3))),
        floor=_floor(sawtooth),
        sky=sky,
    )


def _lines() -> dict:
    """The same shapes in lamps that are spectra: a narrow line of 589 nm and a broad one."""
    line = _measured("360 586 587 588 590 591 592 830", "0 0 40 200 200 40 0 0")
    broad = {"type": "regular", "wavelength_min": 400.0, "wavelength_max": 700.0, "values": "0 1.0 0.6 0.8 0.4"}
    return _scene(
        PATH,
        _view(),
        one=_ball(-1.0, -0.2, _diffuse(_rgb(0.8, 0.3, 0.1)), 0.8),
        two=_ball(1.0, -0.2, _diffuse(_rgb(0.2, 0.4, 0.9)), 0.8),
        floor=_floor(0.5),
        lamp=_lamp(line),
        sky={"type": "constant", "radiance": broad},
    )


def _fog(sigma_t, albedo, extinction: float) -> dict:
    """A cube of fog above a floor."""
    medium = {
        "type": "homogeneous",
        "sigma_t": sigma_t,
        "albedo": albedo,
        "scale": extinction,
        "phase": {"type": "hg", "g": 0.3},
    }
    place = translate(0, -0.1, 0) @ rotate("y", 30) @ scale(0.85)
    return _scene(
        {"type": "volpath", "max_depth": 12, "rr_depth": 100},
        _view(),
        fog={"type": "cube", "to_world": place, "bsdf": {"type": "null"}, "interior": medium},
        floor=_floor(_rgb(0.6, 0.5, 0.4)),
        sky=SKY,
    )


def _measured_fog() -> dict:
    sigma_t = _measured("360 450 550 650 830", "1.8 1.2 0.8 0.6 0.5")
    albedo = _measured("360 430 500 570 640 830", "0.3 0.9 0.95 0.6 0.95 0.99")
    return _fog(sigma_t, albedo, 1.5)


def _glass() -> dict:
    """Smooth glass, a pane of it, and rough metal whose index is a spectrum."""
    tint = _rgb(0.9, 0.7, 0.4)
    metal = {
        "type": "roughconductor",
        "alpha": 0.3,
        "distribution": "beckmann",
        "eta": _measured("360 500 600 830", "1.6 1.2 0.4 0.2"),
        "k": _measured("360 500 600 830", "1.5 2.2 3.0 5.0"),
        "specular_reflectance": _rgb(0.9, 0.95, 0.8),
    }
    pane = {"type": "thindielectric", "int_ior": 1.7, "specular_transmittance": _rgb(0.3, 0.8, 0.5)}
    return _scene(
        {**PATH, "max_depth": 8},
        _view(),
        ball=_ball(-1.0, -0.2, {"type": "dielectric", "int_ior": 1.5, "specular_transmittance": tint}, 0.7),
        metal=_ball(0.9, -0.3, metal, 0.7),
        pane={"type": "rectangle", "to_world": translate(0.2, 0.2, 1.6) @ scale(0.6), "bsdf": pane},
        floor=_floor(_texture(8, 4, 4)),
        sky=SKY,
    )


def _plastics() -> dict:
    """Coats over colours; principled without the tints, which Mitsuba takes from four wavelengths."""
    principled = {
        "type": "principled",
        "base_color": _rgb(0.8, 0.4, 0.1),
        "roughness": 0.4,
        "metallic": 0.4,
        "specular": 0.6,
        "clearcoat": 0.7,
        "clearcoat_gloss": 0.4,
        "sheen": 0.4,
        "flatness": 0.3,
    }
    rough = {
        "type": "roughplastic",
        "alpha": 0.2,
        "distribution": "ggx",
        "nonlinear": True,
        "diffuse_reflectance": _rgb(0.1, 0.5, 0.8),
        "specular_reflectance": _rgb(0.9, 0.8, 0.7),
    }
    return _scene(
        PATH,
        _view(),
        plastic=_ball(-1.2, -0.3, {"type": "plastic", "diffuse_reflectance": _rgb(0.7, 0.15, 0.3), "nonlinear": True}),
        rough=_ball(0.0, -0.3, rough),
        principled=_ball(1.2, -0.3, principled),
        floor=_floor(_rgb(0.5, 0.6, 0.3)),
        sky=SKY,
    )


def _bands() -> dict:
    """What a film of three bands sees of `_daylight`; its channels are in their order here, not that of names."""
    scene = _daylight()
    film = {
        **scene["sensor"]["film"],
        "type": "specfilm",
        "band_green": {"type": "irregular", "wavelengths": "470 530 560 610", "values": "0 1 0.8 0"},
        "band_all": {"type": "regular", "wavelength_min": 360.0, "wavelength_max": 830.0, "values": "0.2 0.2"},
        "a_red": {"type": "irregular", "wavelengths": "560 600 650 720", "values": "0 0.5 1 0"},
    }
    return {**scene, "sensor": {**scene["sensor"], "film": film}}


# Brightness, theirs over ours. Mitsuba divides by the constant 106.7503 what its film adds up; the integral of the same
# table of the observer's y is 106.857 nm: 1.0010. The unit of its daylight, of which lights in rgb are made, has nearly
# the same factor the other way round.
RGB, SPECTRA = 0.9999, 1.0010

# Each with its brightness.
SCENES: dict[str, tuple[Callable[[], dict], float]] = {
    "cornell_box": (_cornell_box, RGB),
    "environment": (_environment, RGB),
    "metals": (lambda: _metals(rough=False), RGB),
    "rough_metals": (lambda: _metals(rough=True), RGB),
    "blackbody": (_blackbody, SPECTRA),
    "daylight": (_daylight, RGB),
    "lines": (_lines, SPECTRA),
    "fog": (lambda: _fog(_rgb(0.3, 0.5, 0.9), _rgb(0.95, 0.8, 0.6), 2.5), RGB),
    "measured_fog": (_measured_fog, RGB),
    "glass": (_glass, RGB),
    "plastics": (_plastics, RGB),
}
# A specfilm divides by no constant, so that the unit of daylight remains.
BANDS = {"bands": (_bands, RGB / SPECTRA)}
