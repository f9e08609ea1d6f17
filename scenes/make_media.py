"""Write the volumes of the scenes with participating media in this folder, and `smoke.xml` with its ring of cameras.

    python scenes/make_media.py

The files are committed, at a small size; run this only to change them. The functions give the volumes at any size, as
closed formulas of position: arrays (Z, Y, X, channels), float32, of a cube whose voxel (k, j, i) is centred at
x = (i + 0.5) / X and so on, y upwards.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
VIEWS = 9  # cameras around the smoke
ALBEDOS = (0.7, 0.99)  # of the slab, from black to white of the picture in it


def centres(*size: int) -> list[np.ndarray]:
    """Coordinates from -1 to 1 of the centres of voxels: one array a dimension, which broadcast to `size`."""
    axes = [(2 * np.arange(n) + 1) / n - 1 for n in size]
    return list(np.meshgrid(*axes, indexing="ij", sparse=True))


def vortex(a, b, c, at: tuple[float, float, float], radius: float, turns: float):
    """Turn (a, b) about the axis through `at` along c, by `turns` full turns there and less and less around it.

    Returns the coordinates (a, b) that points had before.
    """
    u, v = a - at[0], b - at[1]
    angle = 2 * math.pi * turns * np.exp(-(u * u + v * v + 0.5 * (c - at[2]) ** 2) / radius**2)
    cosine, sine = np.cos(angle), np.sin(angle)
    return at[0] + cosine * u - sine * v, at[1] + sine * u + cosine * v


# Centre (across, height, along the axis), radius and turns of swirls about axes along z and along x.
ABOUT_Z = [((0.25, -0.4, 0.0), 0.3, 0.3), ((-0.35, 0.0, 0.2), 0.4, -0.5), ((0.45, 0.3, -0.2), 0.45, 0.6)]
ABOUT_Z += [((-0.45, 0.55, 0.1), 0.4, -0.6)]
ABOUT_X = [((-0.25, -0.2, 0.1), 0.3, 0.3), ((0.4, 0.15, -0.2), 0.42, -0.5), ((-0.42, 0.45, 0.2), 0.45, 0.6)]
ABOUT_X += [((0.4, 0.55, 0.3), 0.4, -0.5)]


def smoke(size: int) -> np.ndarray:
    """A plume that rises from below and curls up: densities (size, size, size, 1) from 0 to 1, most of them 0."""
    z, y, x = (1.08 * axis for axis in centres(size, size, size))  # a margin around it
    for at, radius, turns in reversed(ABOUT_Z):
        x, y = vortex(x, y, z, at, radius, turns)
    for at, radius, turns in reversed(ABOUT_X):
        z, y = vortex(z, y, x, at, radius, turns)
    # small waves, each octave upon the one before
    for frequency, height in ((5.0, 0.05), (11.0, 0.025), (23.0, 0.012)):
        x = x + height * np.sin(frequency * y + 1.3 * frequency * z)
        z = z + height * np.sin(frequency * x - 0.9 * frequency * y)
    rise = np.clip((y + 0.95) / 1.75, 0, 1)  # 0 where the plume begins, 1 where it ends
    width = 0.13 + 0.25 * rise
    density = np.zeros(np.broadcast_shapes(x.shape, y.shape, z.shape))
    for strand in range(3):  # which wind around each other
        angle = 2 * math.pi * (strand / 3 + 0.6 * rise)
        away = 0.03 + 0.3 * rise**1.5
        distance2 = (x - away * np.cos(angle)) ** 2 + (z - away * np.sin(angle)) ** 2
        density += np.exp(-distance2 / width**2)
    ends = np.clip(12 * rise, 0, 1) * np.sqrt(np.clip(5 * (1 - rise), 0, 1))
    density = np.clip(density * ends - 0.35, 0, None) * (1.2 - 0.7 * rise)
    return np.clip(density, 0, 1).astype(np.float32)[..., None]


# Centres (x, y, z) and radii of the balls that the cloud is made of.
BALLS = [((0, -0.1, 0), 0.62), ((0.42, -0.2, 0.12), 0.45), ((-0.44, -0.22, -0.08), 0.46), ((0.1, 0.3, -0.12), 0.5)]
BALLS += [((-0.15, 0.15, 0.38), 0.42), ((0.15, -0.2, -0.46), 0.42)]


def cloud(size: int) -> np.ndarray:
    """A lumpy ball in an empty cube: densities (size, size, size, 1), 1 inside, thin at the rim, 0 outside."""
    z, y, x = centres(size, size, size)
    depth = np.full((size, size, size), -np.inf)  # below the surface
    for (cx, cy, cz), radius in BALLS:
        depth = np.maximum(depth, radius - np.sqrt((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2))
    waves = np.sin(9 * x + 2 * z) * np.sin(8 * y - 3 * x) * np.sin(10 * z + y)
    density = np.clip((depth + 0.05 * waves) / 0.3, 0, 1)
    return (density**2 * (3 - 2 * density)).astype(np.float32)[..., None]


def picture(height: int, width: int) -> np.ndarray:
    """A sun above hills and water, made of a few formulas: (height, width, 3) from 0 to 1, the first row on top."""
    y, x = centres(height, width)
    x, y = np.broadcast_arrays(x * width / height, -y)
    sky = (y + 1) / 2
    image = np.stack([0.95 - 0.6 * sky, 0.6 - 0.15 * sky, 0.45 + 0.4 * sky], -1)

    def paint(where, colour) -> None:
        image[where] = np.broadcast_to(np.asarray(colour, float), image.shape)[where]

    distance, direction = np.hypot(x - 0.25, y - 0.3), np.arctan2(y - 0.3, x - 0.25)
    rays = distance < 0.42 + 0.16 * np.cos(12 * direction)
    paint(rays, (0.98, 0.72, 0.25))
    paint(distance < 0.3, (1.0, 0.92, 0.55))
    for height_of, colour in (
        (-0.05 + 0.16 * np.sin(3.1 * x + 0.4) + 0.05 * np.sin(7.3 * x), (0.35, 0.3, 0.55)),
        (-0.2 + 0.12 * np.sin(4.2 * x + 2.2) + 0.04 * np.sin(9.1 * x), (0.15, 0.45, 0.25)),
    ):
        paint(y < height_of, colour)
    stripes = 0.5 + 0.5 * np.sin(40 * y + 2.5 * np.sin(6 * x))
    water = np.stack([0.1 + 0.35 * stripes, 0.3 + 0.35 * stripes, 0.55 + 0.35 * stripes], -1)
    paint(y < -0.45, water)
    return np.clip(image, 0, 1)


def slab_albedo(depth: int, height: int, width: int) -> np.ndarray:
    """The picture in the albedo of a block: (depth, height, width, 3), the same at every depth."""
    low, high = ALBEDOS
    front = low + (high - low) * picture(height, width)[::-1]  # rows upwards
    return np.broadcast_to(front, (depth, *front.shape)).astype(np.float32)


def write_vol(path: Path, volume: np.ndarray) -> None:
    """Write an array (Z, Y, X, channels) as a .vol file: Mitsuba's format, version 3, 32-bit floats, the unit cube."""
    z, y, x, channels = volume.shape
    header = struct.pack("<3sBiiiii6f", b"VOL", 3, 1, x, y, z, channels, 0, 0, 0, 1, 1, 1)
    path.write_bytes(header + np.ascontiguousarray(volume, "<f4").tobytes())


def camera_position(azimuth: float, elevation: float, distance: float) -> tuple[float, float, float]:
    """A point around the origin; angles in degrees, azimuth 0 on the +z axis, towards +x."""
    a, e = math.radians(azimuth), math.radians(elevation)
    return (distance * math.cos(e) * math.sin(a), distance * math.sin(e), distance * math.cos(e) * math.cos(a))


SMOKE = """<?xml version="1.0" encoding="utf-8"?>
<!-- Smoke in a cube [-1, 1]^3 under a bright sky and a lamp, and cameras around it. By make_media.py. -->
<scene version="3.0.0">
    <default name="resolution" value="128"/>
    <default name="spp" value="64"/>
    <default name="max_depth" value="256"/>
    <default name="rr_depth" value="5"/>
    <default name="density" value="volumes/smoke_32.vol"/>

    <integrator type="volpath">
        <integer name="max_depth" value="$max_depth"/>
        <integer name="rr_depth" value="$rr_depth"/>
    </integrator>
{cameras}
    <emitter type="constant" id="sky">
        <rgb name="radiance" value="0.9, 0.95, 1"/>
    </emitter>
    <shape type="rectangle" id="lamp">
        <transform name="to_world">
            <rotate x="1" angle="90"/>
            <translate x="1" y="4" z="1"/>
        </transform>
        <bsdf type="diffuse">
            <rgb name="reflectance" value="0, 0, 0"/>
        </bsdf>
        <emitter type="area">
            <rgb name="radiance" value="6, 5.5, 4.5"/>
        </emitter>
    </shape>

    <shape type="cube" id="smoke">
        <bsdf type="null"/>
        <medium type="heterogeneous" name="interior">
            <volume type="gridvolume" name="sigma_t">
                <string name="filename" value="$density"/>
                <transform name="to_world">
                    <scale value="2"/>
                    <translate x="-1" y="-1" z="-1"/>
                </transform>
            </volume>
            <volume type="constvolume" name="albedo">
                <rgb name="value" value="0.6, 0.6, 0.6"/>
            </volume>
            <float name="scale" value="14"/>
        </medium>
    </shape>
</scene>
"""

CAMERA = """
    <sensor type="perspective" id="{name}">
        <float name="fov" value="29"/>
        <string name="fov_axis" value="x"/>
        <transform name="to_world">
            <lookat origin="{origin}" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="$resolution"/>
            <integer name="height" value="$resolution"/>
            <string name="component_format" value="float32"/>
            <rfilter type="box"/>
        </film>
        <sampler type="independent">
            <integer name="sample_count" value="$spp"/>
        </sampler>
    </sensor>
"""


def smoke_cameras() -> str:
    """The cameras of `smoke.xml`: `VIEWS` in a ring, and one that is kept back, above and between two of them."""
    places = [(f"view{i}", 360 * i / VIEWS, 12.0) for i in range(VIEWS)]
    places.append(("held_back", 180 / VIEWS, 25.0))
    text = ""
    for name, azimuth, elevation in places:
        origin = ", ".join(f"{value:.6g}" for value in camera_position(azimuth, elevation, 4.6))
        text += CAMERA.format(name=name, origin=origin)
    return text


def main() -> None:
    (HERE / "volumes").mkdir(exist_ok=True)
    write_vol(HERE / "volumes" / "smoke_32.vol", smoke(32))
    write_vol(HERE / "volumes" / "cloud_32.vol", cloud(32))
    write_vol(HERE / "volumes" / "slab_8x64x64.vol", slab_albedo(8, 64, 64))
    (HERE / "smoke.xml").write_text(SMOKE.format(cameras=smoke_cameras()))


if __name__ == "__main__":
    main()
