"""The scene of a glass plate that throws a picture, and the pictures it is to throw.

    python scenes/make_caustics.py FOLDER     # draws the pictures

Light falls straight down, through the flat back of a plate of glass and out through its wavy front, on a white screen;
a camera between plate and screen looks at that. The front's heights decide what is seen: they are what is sought. The
numbers are those of Mitsuba's tutorial on caustics. The functions give dicts for `torchrender.load_dict`, and arrays.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

THICKNESS = 0.087  # of the plate, whose sides are 2 long
DISTANCE = 7.0  # from the front of the plate to the screen
MAX_DEPTH = 4  # light, back, front, screen, camera: four segments
CAMERA = 4.65  # the camera's distance from the front, towards the screen
FOV = 45.0
BAYER = 32  # texels along a side of the coloured light
LENS = "lens.heights"  # the name of what is sought

# Columns: where x, y, z and the origin of an object go. The front faces down: +z becomes -y.
FACING_DOWN = [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]
FACING_UP = [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]


def turned(matrix, *, scale: tuple[float, float, float] = (1, 1, 1), to: tuple[float, float, float] = (0, 0, 0)):
    """A 4x4 matrix, as nested lists: scale, then this matrix, then translate."""
    result = np.asarray(matrix, float) @ np.diag([*scale, 1.0])
    result[:3, 3] += to
    return result.tolist()


def bayer(size: int = BAYER, value: float = 2.2) -> np.ndarray:
    """Light of three colours side by side: (size, size, 3), in each 2x2 texels one red, one green, one blue, one black.

    A lens of glass without dispersion bends all colours alike; only light that starts at different places can become
    a picture in colours.
    """
    texels = np.zeros((size, size, 3), np.float32)
    texels[1::2, 1::2, 0] = value
    texels[0::2, 1::2, 1] = value
    texels[0::2, 0::2, 2] = value
    return texels


def plate() -> dict[str, dict[str, Any]]:
    """The five flat faces around the front, each a rectangle of glass that faces outwards."""
    half = THICKNESS / 2
    glass = {"type": "ref", "id": "glass"}
    axes = {"right": (1, 0), "left": (-1, 0), "near": (0, 1), "far": (0, -1)}
    faces = {"back": turned(FACING_UP, to=(0, THICKNESS, 0))}
    for name, (x, z) in axes.items():
        # The rectangle's x runs along the side, its y up, its normal outwards.
        matrix = [[z, 0, x, 0], [0, 1, 0, 0], [-x, 0, z, 0], [0, 0, 0, 1]]
        faces[name] = turned(matrix, scale=(1, half, 1), to=(x, half, z))
    return {name: {"type": "rectangle", "to_world": matrix, "bsdf": glass} for name, matrix in faces.items()}


def caustics(
    lens: Any, *, colour: bool = True, resolution: int = 128, spp: int = 64, max_depth: int = MAX_DEPTH
) -> dict[str, Any]:
    """The scene as a dict.

    Args:
        lens: the plate's front: heights (H, W) of a height field, zero being flat, positive towards the screen; or any
            shape in its place, as a dict or object that refers to the BSDF "glass".
        colour: light in red, green and blue squares, or grey light.
        resolution: pixels along a side of the picture.
        spp: samples a pixel.
        max_depth: longest path, in segments.
    """
    glass = {"type": "ref", "id": "glass"}
    if getattr(lens, "ndim", 0) == 2:
        lens = {"type": "heightfield", "heights": lens, "to_world": FACING_DOWN, "bsdf": glass}
    texels = {"type": "bitmap", "data": bayer(), "raw": True, "filter_type": "nearest"}
    grey = {"type": "rgb", "value": [0.8, 0.8, 0.8]}
    return {
        "type": "scene",
        "integrator": {"type": "ptracer", "max_depth": max_depth},
        "sensor": {
            "type": "perspective",
            "fov": FOV,
            "near_clip": 1,
            "far_clip": 1000,
            # looks down with +z up in the picture
            "to_world": [[1, 0, 0, 0], [0, 0, -1, -CAMERA], [0, 1, 0, 0], [0, 0, 0, 1]],
            "film": {
                "type": "hdrfilm",
                "width": resolution,
                "height": resolution,
                "pixel_format": "rgb",
                "component_format": "float32",
                # Its slope is what the light's motion over the picture is differentiated by.
                "rfilter": {"type": "gaussian"},
            },
            "sampler": {"type": "independent", "sample_count": spp},
        },
        "glass": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0, "specular_reflectance": 0.0},
        "lens": lens,
        **plate(),
        "screen": {
            "type": "rectangle",
            "to_world": turned(FACING_UP, scale=(5, 5, 5), to=(0, -DISTANCE, 0)),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}},
        },
        "lamp": {
            "type": "rectangle",
            "to_world": turned(FACING_DOWN, to=(0, 5, 0)),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}},
            "emitter": {"type": "directionalarea", "radiance": texels if colour else grey},
        },
    }


def over(image: np.ndarray, where: np.ndarray, colour: Any) -> None:
    """Paint where something is: `colour` is (3,) or (..., 3)."""
    image[where] = np.broadcast_to(np.asarray(colour, float), image.shape)[where]


def positions(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates x (to the right) and y (upwards) from -1 to 1 of the centres of pixels: (1, size) and (size, 1)."""
    axis = (2 * np.arange(size) + 1) / size - 1
    return axis[None, :], -axis[:, None]


def ridge(x: np.ndarray, seed: int, height: float, rough: float) -> np.ndarray:
    """A mountain's outline over x: waves whose heights fall with their lengths."""
    numbers = np.random.default_rng(seed)
    line = np.full(x.shape, height)
    for octave in range(1, 7):
        frequency = 1.7**octave
        line = line + rough * frequency**-0.9 * np.sin(2.2 * frequency * x + 6.3 * numbers.random())
    return line


def balloon(size: int) -> np.ndarray:
    """A striped balloon above mountains in the evening: (size, size, 3) from 0 to 1, the first row on top."""
    x, y = np.broadcast_arrays(*positions(size))
    up = np.clip((y + 0.55) / 1.55, 0, 1)[..., None]
    image = (1 - up) * np.array([0.95, 0.55, 0.28]) + up * np.array([0.12, 0.2, 0.5])
    glow = np.exp(-((x + 0.55) ** 2 + (y + 0.28) ** 2) / 0.16)[..., None]
    image = image + glow * np.array([0.5, 0.38, 0.1])
    over(image, np.hypot(x + 0.55, y + 0.28) < 0.17, (1.0, 0.92, 0.55))
    for number, (height, rough, colour) in enumerate(
        [
            (-0.3, 0.12, (0.55, 0.33, 0.4)),
            (-0.5, 0.13, (0.3, 0.2, 0.38)),
            (-0.75, 0.12, (0.1, 0.13, 0.22)),
        ]
    ):
        mist = np.clip((y + 1) / 1.2, 0, 1)[..., None]
        over(image, y < ridge(x[:1], number + 3, height, rough), np.array(colour) * (0.75 + 0.5 * mist))

    # The envelope is a circle that draws together below, to a mouth; its stripes are meridians, seen from the side.
    u, v = (x - 0.28) / 0.44, (y - 0.34) / 0.44
    width = np.where(v > 0, np.sqrt(np.clip(1 - v * v, 0, 1)), np.clip(1 - 0.6 * v * v, 0, 1))
    width = np.where(v > -1.22, width, 0) * (v < 1)
    inside = np.abs(u) < width
    angle = np.arcsin(np.clip(u / np.maximum(width, 1e-6), -1, 1))
    stripe = np.floor((angle / np.pi + 0.5) * 8).astype(int) % 4
    colours = np.array([(0.9, 0.1, 0.08), (1.0, 0.8, 0.15), (0.1, 0.45, 0.85), (0.95, 0.92, 0.85)])
    light = 0.35 + 0.65 * np.clip(np.cos(angle + 0.7), 0, 1) + 0.1 * v
    cloth = colours[stripe] * light[..., None]
    band = np.abs(v - 0.06 * np.cos(angle) + 0.28) < 0.07
    cloth[band] = np.array([0.06, 0.1, 0.3]) * light[band][..., None]
    image = np.where(inside[..., None], cloth, image)
    # ropes and basket
    for side in (-1, 1):
        rope = np.abs(u - side * (0.1 + 0.09 * (v + 1.6) / 0.4)) < 0.014
        over(image, rope & (v < -1.2) & (v > -1.62), (0.2, 0.12, 0.08))
    basket = (np.abs(u) < 0.13) & (np.abs(v + 1.7) < 0.1)
    weave = 0.75 + 0.25 * np.sign(np.sin(70 * u) * np.sin(70 * v))
    over(image, basket, np.array([0.5, 0.28, 0.12]) * weave[..., None])
    # birds: two arcs each
    for bx, by, wing in [(-0.62, 0.5, 0.1), (-0.4, 0.62, 0.08), (-0.75, 0.7, 0.065), (-0.32, 0.38, 0.055)]:
        across, above = (x - bx) / wing, (y - by) / wing
        arc = 0.55 * np.sqrt(np.clip(1 - (np.abs(across) - 0.75) ** 2 / 0.5625, 0, 1))
        thickness = 0.13 * np.clip(1.6 - np.abs(across), 0, 1)
        over(image, (np.abs(above - arc) < thickness) & (np.abs(across) < 1.5), (0.05, 0.06, 0.12))
    return np.clip(image, 0, 1)


def nautilus(size: int) -> np.ndarray:
    """A shell cut open, chamber by chamber: (size, size, 3) from 0 to 1, all channels alike."""
    x, y = np.broadcast_arrays(*positions(size))
    u, v = x - 0.12, y + 0.1
    growth = np.log(3.1) / (2 * np.pi)  # a turn of the spiral is so many times as large as the one before
    angle, distance = np.arctan2(v, u), np.maximum(np.hypot(u, v), 1e-6)
    # The wall is at distance exp(growth * (angle + 2 pi k)): `turn` is 0 on one wall and 1 on the next one.
    phase = np.log(distance / 0.76) / growth - angle
    turn = phase / (2 * np.pi) - np.floor(phase / (2 * np.pi))
    around = angle + 2 * np.pi * (np.ceil(phase / (2 * np.pi)))  # grows along the spiral, 2 pi at a turn
    shell = (around < 2.4) & (around > -18)
    # chambers: walls that bow backwards, none in the last half turn, where the animal lives
    bow = around + 0.55 * np.sin(np.pi * turn) ** 1.3
    chamber = bow / 0.42 - np.floor(bow / 0.42)
    body = bow > -0.6
    shade = np.where(body, 0.35 + 0.5 * np.sin(np.pi * turn) ** 2, 0.16 + 0.74 * chamber**1.6)
    wall = (turn < 0.045) | (turn > 0.955) | (~body & (np.minimum(chamber, 1 - chamber) < 0.07))
    stripes = 0.5 + 0.5 * np.sin(9 * around + 3 * turn)
    shade = np.where(wall, 0.97, shade * np.where(body, 0.75 + 0.25 * stripes, 1.0))
    sea = 0.07 + 0.08 * (y + 1) / 2 + 0.03 * np.sin(26 * y + 3 * np.sin(4 * x) + 2 * x)
    image = np.where(shell, shade, sea)
    return np.repeat(np.clip(image, 0, 1)[..., None], 3, -1)


def target(size: int, *, colour: bool = True, supersampling: int = 4) -> np.ndarray:
    """The picture to be thrown: (size, size, 3) linear values from 0 to 1, float32, averages over each pixel."""
    fine = (balloon if colour else nautilus)(size * supersampling)
    shape = (size, supersampling, size, supersampling, 3)
    return fine.reshape(shape).mean((1, 3)).astype(np.float32)


def main(folder: Path, size: int = 512) -> None:
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    for name, colour in (("balloon", True), ("nautilus", False)):
        linear = target(size, colour=colour)
        encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        Image.fromarray(np.round(255 * encoded).astype(np.uint8)).save(folder / f"{name}.png")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "output/caustics"))
