"""Train a small network whose output is the texture of a rendered object.

    python tutorials/neural_texture.py            # full run
    python tutorials/neural_texture.py --demo     # the same, fewer iterations

Four cameras photograph a painted planet. We do not store its map in texels, but in the weights of a network that says
the colour at any longitude and latitude: periodic Fourier features and a small multilayer perceptron. In every
iteration the network paints a bitmap, the bitmap is rendered, and the gradient of the loss runs through the path tracer
into the bitmap, and through the bitmap into the weights. Nothing has to be registered for that: `params=` takes any
tensor in the place of a scene's parameter, leaf or not.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import torch
from command_line import at_least_one
from pictures import save, save_curves
from torch import nn

import torchrender as tr

TEXTURE = "planet.bsdf.reflectance.data"


def texel_centres(height: int) -> torch.Tensor:
    """Texture coordinates (u, v) of the texel centres of a map of `height` x 2 `height` texels: (H, W, 2) in [0, 1]."""
    v, u = torch.meshgrid(
        (torch.arange(height) + 0.5) / height, (torch.arange(2 * height) + 0.5) / (2 * height), indexing="ij"
    )
    return torch.stack([u, v], dim=-1)


def painted_planet(uv: torch.Tensor) -> torch.Tensor:
    """The map to be found: reflectance (..., 3) in [0, 1] at texture coordinates `uv` (..., 2). Land, sea and ice."""
    longitude, colatitude = 2 * math.pi * uv[..., 0], math.pi * uv[..., 1]
    x, y = torch.sin(colatitude) * torch.cos(longitude), torch.sin(colatitude) * torch.sin(longitude)
    z = torch.cos(colatitude)
    # Waves on the sphere, bent by slower ones; where they are high there is land. It has no seam where u jumps.
    height = torch.sin(3 * x + 2 * torch.sin(2 * y + 1)) + torch.sin(4 * y - 2 * torch.sin(3 * z)) * torch.cos(3 * z)
    height = height + 0.4 * torch.sin(9 * x + 4 * torch.sin(5 * z)) * torch.cos(8 * y)
    land = torch.sigmoid(12 * (height - 0.1))[..., None]
    mountains = torch.sigmoid(8 * (height - 1.0))[..., None]
    ice = torch.sigmoid(30 * (z.abs() - 0.92))[..., None]
    sea, meadow, rock = (torch.tensor(c) for c in ((0.04, 0.12, 0.42), (0.16, 0.42, 0.08), (0.55, 0.40, 0.24)))
    colour = sea * (1 - land) + land * (meadow * (1 - mountains) + rock * mountains)
    return colour * (1 - ice) + 0.85 * ice


class NeuralTexture(nn.Module):
    """A colour for every texture coordinate: (..., 2) in, reflectance (..., 3) in (0, 1) out.

    The coordinates are turned into waves cos(2 pi k.uv), sin(2 pi k.uv) of random frequencies k (Tancik et al. 2020):
    without them a perceptron learns smooth functions only. The frequencies are whole numbers, so that the texture
    repeats itself as the bitmap in the renderer does.

    Args:
        waves: number of frequencies.
        bandwidth: their standard deviation, in waves across the texture.
        width: neurons of each of the two hidden layers.
    """

    def __init__(self, waves: int = 48, bandwidth: float = 2.5, width: int = 64) -> None:
        super().__init__()
        self.register_buffer("frequencies", torch.round(bandwidth * torch.randn(waves, 2)))
        self.layers = nn.Sequential(
            nn.Linear(2 * waves, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 3)
        )

    def forward(self, uv: torch.Tensor) -> torch.Tensor:
        phase = 2 * math.pi * uv @ self.frequencies.T
        return torch.sigmoid(self.layers(torch.cat([phase.cos(), phase.sin()], dim=-1)))


def make_scene(resolution: int, height: int) -> tr.Scene:
    """A planet under two lamps and a faint sky; four cameras around its equator and a fifth between two of them."""
    scene = {
        "type": "scene",
        "sky": {"type": "constant", "radiance": 0.3},
        "sun": {
            "type": "sphere",
            "center": [4.0, 5.0, 3.0],
            "radius": 1.0,
            "emitter": {"type": "area", "radiance": 18.0},
        },
        "moon": {
            "type": "sphere",
            "center": [-5.0, 2.0, -3.0],
            "radius": 1.5,
            "emitter": {"type": "area", "radiance": 6.0},
        },
        "planet": {
            "type": "sphere",
            "to_world": tr.Transform.rotate([1, 0, 0], -90),  # the poles of texture coordinates are at +z and -z
            "bsdf": {
                "type": "diffuse",
                "reflectance": {"type": "bitmap", "data": torch.full((height, 2 * height, 3), 0.5), "raw": True},
            },
        },
    }
    for i, (azimuth, elevation) in enumerate([(0, 20), (90, -20), (180, 20), (270, -20), (45, 0)]):
        a, e = math.radians(azimuth), math.radians(elevation)
        origin = [3.6 * math.cos(e) * math.sin(a), 3.6 * math.sin(e), 3.6 * math.cos(e) * math.cos(a)]
        scene[f"view{i}"] = tr.PerspectiveCamera.look_at(
            origin, [0, 0, 0], fov=35, size=(resolution, resolution), filter="box"
        )
    return tr.load_dict(scene)


def psnr(found: torch.Tensor, true: torch.Tensor, weight: torch.Tensor | float = 1.0) -> float:
    """Peak signal-to-noise ratio in dB; the peak is 1. `weight` (H, W, 1) has the mean 1."""
    return -10 * math.log10(float(((found - true).square() * weight).mean()))


def run(
    folder: Path,
    *,
    resolution: int = 160,
    height: int = 96,
    spp: int = 16,
    iterations: int = 240,
    target_spp: int = 256,
    rate: float = 2e-2,
) -> dict[str, float]:
    """The whole program.

    Args:
        folder: where the pictures go.
        resolution: pixels along either side of every picture.
        height: rows of the bitmap that the network paints; it has twice as many columns.
        spp: samples a pixel of every rendered picture; its derivative takes half as many.
        iterations: steps of the optimiser.
        target_spp: samples a pixel of the given pictures.
        rate: learning rate at the start; it falls to zero along a cosine.

    Returns:
        PSNR in dB of the texture at the start (``start``) and at the end (``end``), and of the fifth picture, which the
        training has not seen (``new view``).
    """
    folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(0)  # of the network's weights; the renderer gets its seeds below
    scene = make_scene(resolution, height)
    renderer = tr.Renderer(scene, integrator=tr.PathTracer(hide_emitters=True), spp=spp, spp_grad=max(1, spp // 2))
    uv = texel_centres(height)
    painted = painted_planet(uv)
    area = torch.sin(math.pi * uv[..., 1:])  # of a texel on the planet: those near the poles are small
    area = area / area.mean()
    given, new = [0, 1, 2, 3], 4

    with torch.no_grad():
        # The pictures are taken of the planet itself: of a finer map than the network will ever paint.
        planet = {TEXTURE: painted_planet(texel_centres(512))}
        targets = renderer(sensor=[*given, new], seed=1_000_000, spp=target_spp, params=planet)
    save(targets[new], folder, "target")
    save(painted, folder, "texture_target")

    network = NeuralTexture()
    optimiser = torch.optim.Adam(network.parameters(), lr=rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    result = {"start": psnr(network(uv).detach(), painted, area)}
    curves: dict[str, list[float]] = {"loss": []}

    bar = tr.progress(range(iterations), desc="neural texture")
    for iteration in bar:
        optimiser.zero_grad()
        texture = network(uv)  # (H, W, 3), with a history
        views = [iteration % 2, 2 + iteration % 2]  # two opposite ones, in turns
        images = renderer(sensor=views, seed=iteration, params={TEXTURE: texture})
        loss = (images - targets[views]).square().mean()
        loss.backward()
        optimiser.step()
        schedule.step()
        curves["loss"].append(loss.item())
        bar.set_postfix(loss=f"{loss.item():.3g}")

    with torch.no_grad():
        texture = network(uv)
        # A network has no resolution: the new view is rendered from a bitmap four times as fine.
        fine = {TEXTURE: network(texel_centres(4 * height))}
        seen = renderer(sensor=new, seed=1_000_001, spp=target_spp, params=fine)
    save(seen, folder, "result")
    save(texture, folder, "texture_result")
    save_curves(curves, folder / "loss.png", "Neural texture: a network inside the render")

    result["end"] = psnr(texture, painted, area)
    result["new view"] = psnr(tr.tonemap(seen), tr.tonemap(targets[new]))
    weights = sum(p.numel() for p in network.parameters())
    print(f"{weights} weights paint a map of {height} x {2 * height} texels")
    print(f"PSNR of the map: {result['start']:.1f} dB at the start, {result['end']:.1f} dB now")
    print(f"PSNR of a picture from a new side: {result['new view']:.1f} dB")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="fewer iterations: well under a minute")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser")
    parser.add_argument("--spp", type=at_least_one, default=16, help="samples a pixel and iteration (default 16)")
    parser.add_argument(
        "--resolution", type=at_least_one, default=160, help="pixels along a side of a picture (default 160)"
    )
    parser.add_argument("--output", type=Path, default=Path("output/neural_texture"), help="folder for the pictures")
    options = parser.parse_args(argv)
    start = time.perf_counter()
    run(
        options.output,
        resolution=options.resolution,
        spp=options.spp,
        iterations=options.iterations or (60 if options.demo else 240),
        target_spp=64 if options.demo else 256,
    )
    print(f"pictures are in {options.output}; {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
