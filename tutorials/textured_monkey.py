"""Recover a 512 x 512 texture from pictures of the object that wears it.

    python tutorials/textured_monkey.py            # full run
    python tutorials/textured_monkey.py --demo     # the same, fewer iterations

Cameras all around photograph Blender's monkey with a painted texture. We forget the texture and find it again by
gradient descent through the path tracer, coarse to fine: a small texture first, which learns quickly because many
pixels share a texel, then the same at twice the resolution, and so on.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import kornia
import torch
from command_line import at_least_one
from pictures import save, save_curves, save_signed

import torchrender as tr

SCENE = Path(__file__).resolve().parent.parent / "scenes" / "textured_monkey.xml"
TEXTURE = "monkey.bsdf.brdf_0.reflectance.data"


def painted_texture(size: int) -> torch.Tensor:
    """The texture to be found, (size, size, 3) linear reflectance in [0.1, 0.9]: wavy coloured bands and spots."""
    centres = (torch.arange(size) + 0.5) / size
    v, u = torch.meshgrid(centres, centres, indexing="ij")
    turn = 2 * math.pi
    bands = torch.sin(turn * (5 * u + 0.2 * torch.sin(turn * 3 * v)))
    waves = torch.sin(turn * (4 * v + 0.3 * torch.sin(turn * 2 * u)))
    spots = torch.cos(turn * 16 * u) * torch.cos(turn * 16 * v)
    channels = [0.5 + 0.25 * bands + 0.1 * spots, 0.5 + 0.25 * waves - 0.1 * spots, 0.5 + 0.3 * bands * waves]
    return torch.stack(channels, dim=-1).clamp(0.1, 0.9)


def add_cameras(scene: tr.Scene, count: int, resolution: int) -> list[int]:
    """Add `count` cameras to the scene, alternately low and high on a circle; returns their sensor indices."""
    first = len(scene.sensors)
    for i in range(count):
        azimuth, elevation = 2 * math.pi * i / count, math.radians((5, 40)[i % 2])
        origin = (
            4.3 * math.cos(elevation) * math.sin(azimuth),
            4.3 * math.sin(elevation),
            4.3 * math.cos(elevation) * math.cos(azimuth),
        )
        scene[f"view{i}"] = tr.PerspectiveCamera.look_at(
            origin, (0.0, 0.0, 0.0), fov=36.0, size=(resolution, resolution), filter="box"
        )
    return list(range(first, first + count))


def seen_texels(renderer: tr.Renderer, texture: torch.Tensor, views: list[int]) -> torch.Tensor:
    """Which texels the pictures determine: (H, W) bool.

    The derivative of the sum of all pictures by a texel is the amount of light that reaches the cameras by way of it.
    A texel counts as seen if that is at least a tenth of what the median lit texel has.
    """
    weight = torch.zeros(texture.shape[:2])
    for view in views:
        value = texture.detach().clone().requires_grad_()
        renderer(sensor=view, seed=2_000_000, spp=1, spp_grad=32, params={TEXTURE: value}).sum().backward()
        weight += value.grad.sum(-1)
    lit = weight[weight > 0.01 * weight.max()]
    return weight > 0.1 * lit.median()


def psnr(found: torch.Tensor, true: torch.Tensor, mask: torch.Tensor) -> float:
    """Peak signal-to-noise ratio in dB over the texels of `mask`; the peak is a reflectance of 1."""
    return float(kornia.metrics.psnr(found[mask], true[mask], 1.0))


def run(
    folder: Path,
    *,
    texture_size: int = 512,
    resolution: int = 256,
    view_count: int = 10,
    views_per_step: int = 2,
    spp: int = 16,
    iterations: int = 300,
    target_spp: int = 256,
    rate: float = 0.06,
    smoothness: float = 5e-4,
) -> dict[str, float]:
    """The whole program; returns the PSNR of the texture in dB at the start and at the end.

    Args:
        folder: where the pictures go.
        texture_size: texels along either side; at least 64 and a power of two.
        resolution: pixels along either side of every picture.
        view_count, views_per_step: pictures that are given, and how many of them an iteration looks at.
        spp: samples a pixel of the rendered pictures; their derivative takes half as many.
        iterations: steps of the optimiser.
        target_spp: samples a pixel of the given pictures.
        rate: learning rate at the start; it falls to zero along a cosine.
        smoothness: weight of the total variation of the texture.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scene = tr.load_file(SCENE, resolution=resolution)
    # A little light from everywhere, so that no side is dark. Editing a scene is assigning to it.
    scene["sky"] = {"type": "constant", "radiance": 0.5}
    views = add_cameras(scene, view_count, resolution)
    renderer = tr.Renderer(scene, spp=spp, spp_grad=max(1, spp // 2))

    # The given pictures. Indexing the batch of views by sensor gives (views, C, H, W), the layout that kornia takes.
    painted = painted_texture(texture_size)
    with torch.no_grad():
        targets = [
            renderer(sensor=view, seed=1_000_000, spp=target_spp, params={TEXTURE: painted}, layout="chw")
            for view in tr.progress(views, desc="pictures")
        ]
    targets = torch.stack(targets)
    mask = seen_texels(renderer, painted, views)
    save(targets[0].movedim(0, -1), folder, "target")
    save(painted, folder, "texture_target")

    # Start from a grey texture of an eighth of the size. A parameter may be replaced by one of another shape.
    size = max(texture_size // 8, 8)
    bitmap = scene["monkey"].bsdf.brdf_0.reflectance
    bitmap.data = torch.nn.Parameter(torch.full((size, size, 3), 0.5))
    (texture,) = scene.train_only(TEXTURE)
    with torch.no_grad():
        save(renderer(sensor=views[0], seed=1_000_001, spp=64), folder, "start")
        start_psnr = psnr(tr.optim.resample(texture, (texture_size, texture_size)), painted, mask)

    optimiser = torch.optim.Adam([texture], lr=rate, betas=(0.9, 0.95))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    levels = int(math.log2(texture_size // size)) + 1
    # Most of the time goes to the coarse levels, where it averages most noise; the finest only needs the details.
    grow_at = {round(iterations * 0.9 * level / (levels - 1)) for level in range(1, levels)}
    generator = torch.Generator().manual_seed(0)
    curves: dict[str, list[float]] = {"loss": []}

    bar = tr.progress(range(iterations), desc="textured monkey")
    for iteration in bar:
        if iteration in grow_at:
            size *= 2
            # The texture and the moments of its optimiser are resampled together, so that nothing is forgotten.
            texture = tr.optim.upsample(scene, TEXTURE, (size, size), optimiser)
        optimiser.zero_grad()
        chosen = torch.randperm(view_count, generator=generator)[:views_per_step].tolist()
        images = renderer(sensor=[views[i] for i in chosen], seed=iteration, layout="bchw")
        # The squared error, whose gradient is unbiased although the pictures are noisy (image and derivative come
        # from independent samples), and a little total variation, which keeps noise out of the finest texels.
        loss = (images - targets[chosen]).square().mean()
        variation = kornia.losses.total_variation(texture.movedim(-1, 0)[None], reduction="mean").mean()
        (loss + smoothness * variation).backward()
        optimiser.step()
        schedule.step()
        with torch.no_grad():
            texture.clamp_(0.0, 1.0)
        curves["loss"].append(loss.item())
        bar.set_postfix(loss=f"{loss.item():.3g}", texture=f"{size}x{size}")

    with torch.no_grad():
        found = tr.optim.resample(texture.detach(), (texture_size, texture_size))
        save(renderer(sensor=views[0], seed=1_000_002, spp=64), folder, "result")
    save(found, folder, "texture_result")
    save(torch.where(mask[..., None], found, 1.0), folder, "texture_result_seen")

    # Forward mode: how does the first picture change if the whole texture becomes redder?
    redder = torch.zeros_like(texture)
    redder[..., 0] = 1.0

    def picture(value: torch.Tensor) -> torch.Tensor:
        return renderer(sensor=views[0], seed=1_000_003, spp=32, spp_grad=32, params={TEXTURE: value})

    _, derivative = torch.func.jvp(picture, (texture.detach(),), (redder,))
    save_signed(derivative, folder, "derivative_red")
    save_curves(curves, folder / "loss.png", f"Textured monkey: {texture_size} x {texture_size} texels")

    result = {"start": start_psnr, "end": psnr(found, painted, mask), "seen": float(mask.float().mean())}
    print(f"seen texels: {100 * result['seen']:.0f} % of {texture_size} x {texture_size}")
    print(f"PSNR of the texture where it is seen: {result['start']:.1f} dB at the start, {result['end']:.1f} dB now")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="fewer iterations: well under a minute")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser")
    parser.add_argument("--spp", type=at_least_one, default=16, help="samples a pixel and iteration (default 16)")
    parser.add_argument(
        "--resolution", type=at_least_one, default=256, help="pixels along a side of a picture (default 256)"
    )
    parser.add_argument("--output", type=Path, default=Path("output/textured_monkey"), help="folder for the pictures")
    options = parser.parse_args(argv)
    start = time.perf_counter()
    run(
        options.output,
        resolution=options.resolution,
        spp=options.spp,
        iterations=options.iterations or (50 if options.demo else 300),
        target_spp=96 if options.demo else 256,
    )
    print(f"pictures are in {options.output}; {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
