"""Recover the index of refraction of a glass ball from a picture of the landscape that is seen in it.

    python tutorials/glass_ball.py            # full run
    python tutorials/glass_ball.py --demo     # the same, smaller

A ball of glass hangs under an open sky, and shows the landscape behind it upside down. How much the rays are bent, and
how much light is reflected at each of the surfaces, depends on one number, which we forget and find again. The
derivative follows chains of refractions and reflections: a change of the index turns every ray inside of the ball,
moves the point where it leaves, turns it again, and so changes where on the horizon a pixel looks.

The sky is an environment map without sharp edges, and the outline of the ball does not depend on its glass. So nothing
sharp moves, and this derivative is complete. What is not simple is the loss: seen from a wrong index the picture is
scrambled, and following it downhill ends in the next valley. Blurred pictures have wider valleys, so we go from coarse
to fine.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from pathlib import Path

import torch
from command_line import at_least_one
from kornia.filters import gaussian_blur2d
from pictures import save, save_curves, save_signed

import torchrender as tr

ETA = "ball.bsdf.eta"


def panorama(height: int = 128) -> torch.Tensor:
    """An evening sky above hills, as a latitude-longitude map of radiance (height, 2 height, 3). Row 0 looks up."""
    v, u = torch.meshgrid(torch.linspace(0, 1, height), (torch.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    turn = 2 * math.pi
    up = 0.5 - v  # half turns above the horizon
    horizon = (
        0.05 + 0.035 * torch.sin(3 * turn * u + 1) + 0.02 * torch.sin(7 * turn * u) + 0.01 * torch.sin(13 * turn * u)
    )
    sky = torch.sigmoid(60 * (up - horizon))[..., None]
    dusk = torch.exp(-6 * (up - horizon).clamp(min=0))[..., None]
    above = dusk * torch.tensor([1.0, 0.55, 0.25]) + (1 - dusk) * torch.tensor([0.12, 0.25, 0.6])
    clouds = torch.sin(turn * (3 * u + 2 * up)) + torch.sin(
        turn * (2 * u - 5 * up) + 2 * torch.sin(turn * (2 * u + up))
    )
    above = above * (1 + 0.35 * clouds[..., None])
    fields = torch.sin(turn * 6 * u + 2 * torch.sin(turn * 3 * up)) * torch.cos(turn * 5 * up + torch.sin(turn * 3 * u))
    meadow, earth = torch.tensor([0.10, 0.28, 0.05]), torch.tensor([0.36, 0.22, 0.10])
    below = meadow + (earth - meadow) * (0.5 + 0.5 * fields[..., None])
    sun = torch.exp(-(((u - 0.58) * 2) ** 2 + (up - 0.14) ** 2) / 0.0012)[..., None]
    return above * sky + below * (1 - sky) + 9 * sun * torch.tensor([1.0, 0.8, 0.5])


def make_scene(resolution: int, eta: float) -> tr.Scene:
    """A ball of glass in front of the camera, in the middle of the panorama."""
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 8},
            "camera": {
                "type": "perspective",
                "fov": 36,
                "to_world": tr.Transform.look_at([0, 0.15, -4], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": resolution, "height": resolution, "rfilter": {"type": "box"}},
            },
            "ball": {"type": "sphere", "bsdf": {"type": "dielectric", "eta": eta}},
            "sky": {"type": "envmap", "data": panorama()},
        }
    )


def blur(image: torch.Tensor, sigma: float) -> torch.Tensor:
    """A picture (H, W, 3) without its details: a Gaussian of `sigma` pixels."""
    if sigma <= 0:
        return image
    reach = 2 * math.ceil(3 * sigma) + 1
    # kornia takes (B, C, H, W)
    return gaussian_blur2d(image.movedim(-1, 0)[None], (reach, reach), (sigma, sigma))[0].movedim(0, -1)


def run(
    folder: Path,
    *,
    resolution: int = 160,
    true_eta: float = 1.52,
    start_eta: float = 1.2,
    spp: int = 16,
    iterations: int = 120,
    target_spp: int = 256,
    rate: float = 0.02,
) -> dict[str, float]:
    """The whole program; returns the index at the start, the one found, and the true one.

    Args:
        folder: where the pictures go.
        resolution: pixels along either side of the picture.
        true_eta, start_eta: indices of refraction of the glass, relative to the air around it.
        spp: samples a pixel of every rendered picture and of its derivative.
        iterations: steps of the optimiser.
        target_spp: samples a pixel of the given picture.
        rate: learning rate at the start; it falls to zero along a cosine.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scene = make_scene(resolution, true_eta)
    renderer = tr.Renderer(scene, spp=spp)
    with torch.no_grad():
        target = renderer(seed=1_000_000, spp=target_spp)
    save(target, folder, "target")

    # The renderer warns that the motion of edges seen through glass is missing in such derivatives. Here it is zero.
    warnings.filterwarnings("ignore", category=tr.MissingTermWarning)
    (eta,) = scene.train_only(ETA)
    with torch.no_grad():
        eta.fill_(start_eta)
        save(renderer(seed=1_000_001, spp=64), folder, "start")

    optimiser = torch.optim.Adam([eta], lr=rate, betas=(0.8, 0.95))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    curves: dict[str, list[float]] = {"loss": [], "error of the index": []}
    # Every step carries the noise of its own picture: the mean of the last third has less of it.
    settled: list[float] = []

    bar = tr.progress(range(iterations), desc="glass ball")
    for iteration in bar:
        # From an eighth of the picture down to nothing, in the first two thirds.
        sigma = resolution / 8 * max(0.0, 1 - 1.5 * iteration / iterations) ** 2
        sigma = sigma if sigma > 0.4 else 0.0
        optimiser.zero_grad()
        image = renderer(seed=iteration)
        # The sun is a hundred times brighter than the hills and would drown them: count errors relative to the picture
        # that is given. These weights are constants, so that the gradient stays unbiased.
        wanted = blur(target, sigma)
        difference = (blur(image, sigma) - wanted) / (wanted + 0.25)
        loss = difference.square().mean()
        loss.backward()
        optimiser.step()
        schedule.step()
        with torch.no_grad():
            eta.clamp_(1.01, 3.0)
        curves["loss"].append(loss.item())
        curves["error of the index"].append(abs(eta.item() - true_eta))
        if iteration >= iterations - max(1, iterations // 3):
            settled.append(eta.item())
        bar.set_postfix(loss=f"{loss.item():.3g}", eta=f"{eta.item():.4f}")

    found = sum(settled) / len(settled)
    with torch.no_grad():
        eta.fill_(found)
        save(renderer(seed=1_000_002, spp=64), folder, "result")

    def picture(value: torch.Tensor) -> torch.Tensor:
        return renderer(seed=1_000_003, spp=64, params={ETA: value})

    # Forward mode: how does every pixel change with the index, relative to its brightness?
    image, derivative = torch.func.jvp(picture, (eta.detach(),), (torch.ones_like(eta),))
    save_signed(derivative / (image + 0.25), folder, "derivative_eta")
    save_curves(curves, folder / "loss.png", "Glass ball: one index of refraction")

    print(f"index of refraction: {start_eta:.4f} at the start, {found:.4f} found, {true_eta:.4f} true")
    return {"start": start_eta, "found": found, "true": true_eta}


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="a smaller picture, fewer iterations: well under a minute")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser")
    parser.add_argument("--spp", type=at_least_one, default=16, help="samples a pixel and iteration (default 16)")
    parser.add_argument("--resolution", type=at_least_one, help="pixels along a side of the picture")
    parser.add_argument("--output", type=Path, default=Path("output/glass_ball"), help="folder for the pictures")
    options = parser.parse_args(argv)
    start = time.perf_counter()
    run(
        options.output,
        resolution=options.resolution or (96 if options.demo else 160),
        spp=options.spp,
        iterations=options.iterations or (60 if options.demo else 120),
    )
    print(f"pictures are in {options.output}; {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
