"""Looking at volumes: three orthogonal projections, and a strip of pictures from all around."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import torch

import torchrender as tr

SCENES = Path(__file__).resolve().parent.parent / "scenes"
sys.path.append(str(SCENES))  # the script that makes the scenes' volumes is not a part of the package
import make_media  # noqa: E402


def volume_of(values) -> torch.Tensor:
    """A volume (Z, Y, X, C) that `make_media` has made, as a tensor."""
    return torch.from_numpy(values.copy())


def projections(density: torch.Tensor, depth: float) -> torch.Tensor:
    """What is left of light that crosses a cube of (n, n, n, 1) densities: along z, along x and along y from above.

    Args:
        density: extinction in a cube of side 1, up to the factor `depth`.
        depth: optical depth of a density of 1 all the way.

    Returns:
        (n, 3 n, 3): three pictures side by side, white where there is nothing.
    """
    volume = density.detach()[..., 0]
    front = volume.mean(0).flip(0)  # rows: y from the top, columns: x
    side = volume.mean(2).T.flip(0, 1)  # seen from +x: z runs to the left
    above = volume.mean(1)  # rows: z, towards the front at the bottom, columns: x
    return torch.exp(-depth * torch.cat([front, side, above], 1))[..., None].expand(-1, -1, 3)


def turntable(
    renderer: tr.Renderer, resolution: int, count: int = 8, spp: int = 64, **settings: object
) -> torch.Tensor:
    """Pictures from `count` sides, one beside the other: (resolution, count * resolution, 3).

    Args:
        renderer: of a scene around the origin.
        resolution: pixels along a side of each picture.
        count: pictures in the full turn.
        spp: samples a pixel.
        **settings: more for the renderer, such as ``params``.
    """
    strip = []
    for i in range(count):
        origin = make_media.camera_position(360 * i / count, 12.0, 4.6)
        camera = tr.PerspectiveCamera.look_at(origin, (0, 0, 0), fov=29, size=(resolution, resolution), filter="box")
        with torch.no_grad():
            strip.append(renderer(sensor=camera, spp=spp, passes=1, seed=3_000_000 + i, **settings))
    return torch.cat(strip, 1)


def psnr(found: torch.Tensor, true: torch.Tensor) -> float:
    """Peak signal-to-noise ratio in dB, the peak being 1."""
    return -10 * math.log10(max(float((found - true).square().mean()), 1e-20))
