"""Recover the light around a scene from pictures of two balls.

    python tutorials/environment_map.py            # full run
    python tutorials/environment_map.py --demo     # the same, fewer iterations

A ball of rough metal and a white ball stand in an unknown landscape. Two photographs of them, cut out along the balls,
are all that is given; found is an environment map of 64 x 128 texels, with which another object is lit that was never
photographed.

What determines it: the metal mirrors nearly all directions, but blurs them by its roughness; the white ball sees each
half of the sky as one number, which fixes how bright it is in all. What the blur takes away nothing brings back, and
the noise of the pictures would be amplified in its place. Two things are known beforehand and stand in for it.
Radiance is positive: the optimiser moves x and the map is log(1 + e^x), so that no texel can be paid for by a negative
neighbour. And without evidence a map is smooth: differences of neighbouring texels cost a little, the same per solid
angle everywhere, for the texels near the poles are many and small.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import torch
from command_line import at_least_one
from glass_ball import panorama
from pictures import save, save_curves
from torch.nn.utils import parametrize

import torchrender as tr

SKY = "sky.data"


def make_scene(width: int, objects: dict[str, dict]) -> tr.Scene:
    """Objects in the middle of a panorama, in front of two cameras that do not see the sky itself."""
    height = width * 5 // 8
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    cameras = {
        name: {
            "type": "perspective",
            "fov": 42,
            "to_world": tr.Transform.look_at(origin, [0, 0, 0], [0, 1, 0]),
            "film": film,
        }
        for name, origin in (("front", [0, 0.6, -6]), ("back", [1.5, 1.5, 5.6]))
    }
    sky = {"type": "envmap", "data": torch.ones(2, 4, 3)}
    integrator = {"type": "path", "max_depth": 4, "hide_emitters": True}
    return tr.load_dict({"type": "scene", "integrator": integrator, **cameras, **objects, "sky": sky})


def balls(alpha: float) -> dict[str, dict]:
    """What is photographed: a ball of rough silver and a white one."""
    metal = {"type": "roughconductor", "material": "Ag", "alpha": alpha}
    white = {"type": "diffuse", "reflectance": 0.8}
    return {
        "metal": {"type": "sphere", "center": [-1.05, 0, 0], "bsdf": metal},
        "white": {"type": "sphere", "center": [1.05, 0, 0], "bsdf": white},
    }


def another_object() -> dict[str, dict]:
    """What is lit with the map that was found: a lacquered cube on a grey plate."""
    turn = tr.Transform.rotate([0, 1, 0], 35).rotate([1, 0, 0], 20)
    lacquer = {"type": "roughplastic", "alpha": 0.1, "diffuse_reflectance": {"type": "rgb", "value": [0.5, 0.08, 0.05]}}
    plate = {"type": "diffuse", "reflectance": 0.4}
    flat = tr.Transform.translate([0, -1.1, 0]).rotate([1, 0, 0], -90).scale(1.6)
    return {
        "cube": {"type": "cube", "to_world": turn.scale(0.75), "bsdf": lacquer},
        "plate": {"type": "disk", "to_world": flat, "bsdf": {"type": "twosided", "bsdf": plate}},
    }


def roughness_of(sky: torch.Tensor) -> torch.Tensor:
    """The mean over all directions of the squared gradient of a map (H, W, 3), by angles, of its square root.

    The square root lets a step in the dark count as much as a larger one in the light. Row i of a map lies at the angle
    pi i / (H - 1) from above, the first and the last one are the poles.
    """
    height, width = sky.shape[:2]
    value = sky.sqrt()
    down = torch.pi / (height - 1)
    middle = (torch.arange(height - 1) + 0.5) * down  # angles between the rows
    rows = torch.sin(middle)[:, None, None] * ((value[1:] - value[:-1]) / down).square()
    sine = torch.sin(torch.arange(1, height - 1) * down)[:, None, None]
    around = value[1:-1] - value[1:-1].roll(1, 1)
    columns = (around / (2 * torch.pi / width)).square() / sine  # an angle of sine * step, an area of sine
    return down * (rows.mean((1, 2)).sum() + columns.mean((1, 2)).sum()) / 2


def map_error(found: torch.Tensor, true: torch.Tensor) -> float:
    """The root mean square of the difference of two maps over all directions, relative to that of the true one."""
    sine = torch.sin(torch.linspace(0, torch.pi, len(true)))[:, None, None]
    return math.sqrt(float((sine * (found - true).square()).sum() / (sine * true.square()).sum()))


def run(
    folder: Path,
    *,
    size: int = 64,
    width: int = 160,
    alpha: float = 0.08,
    spp: int = 32,
    iterations: int = 240,
    target_spp: int = 1024,
    rate: float = 0.1,
    smoothness: float = 3e-4,
) -> dict[str, float]:
    """The whole program; returns relative errors of the map, and of a picture in its light, at the start and the end.

    Args:
        folder: where the pictures go.
        size: rows of the map, which has twice as many columns; at least 16 and a power of two.
        width: pixels along the longer side of a picture.
        alpha: roughness of the metal.
        spp: samples a pixel of every rendered picture and of its derivative.
        iterations: steps of the optimiser.
        target_spp: samples a pixel of the given pictures.
        rate: learning rate at the start; it falls to zero along a cosine.
        smoothness: weight of the roughness of the map.
    """
    folder.mkdir(parents=True, exist_ok=True)
    truth = panorama(size)
    scene = make_scene(width, balls(alpha))
    views = [0, 1]
    renderer = tr.Renderer(scene, spp=spp)
    passes = max(1, target_spp // 64)
    with torch.no_grad():
        known = {"spp": 64, "passes": passes, "params": {SKY: truth}}
        targets = renderer(sensor=views, seed=1_000_000, **known)  # (views, H, W, 3)
    for name, target in zip(("front", "back"), targets, strict=True):
        save(target, folder, f"target_{name}")
    save(truth, folder, "map_target")

    # A coarse grey map. The parameter is x, `scene.sky.data` the positive map that is made of it.
    rows = 16
    scene.sky.data = torch.nn.Parameter(torch.full((rows, 2 * rows, 3), 0.3))
    parametrize.register_parametrization(scene.sky, "data", tr.constraints.Positive())
    x = scene.sky.parametrizations.data.original.requires_grad_()
    other = make_scene(width, another_object())
    other_renderer = tr.Renderer(other, spp=64, passes=passes)

    def relit(sky: torch.Tensor, seed: int) -> torch.Tensor:
        with torch.no_grad():
            return other_renderer(seed=seed, params={SKY: sky})

    new_view = relit(truth, 2_000_000)
    save(new_view, folder, "relit_target")

    def errors() -> dict[str, float]:
        found = tr.optim.resample(scene.sky.data.detach(), truth.shape[:2], ("clamp", "repeat"))
        difference = relit(found, 2_000_001) - new_view
        return {"map": map_error(found, truth), "relit": float(difference.norm() / new_view.norm())}

    start = errors()

    # Bright pixels are the noisy ones: count errors relative to the picture. Constant weights leave the gradient
    # unbiased. Where there is no ball there is nothing, in both pictures.
    weight = 1 / (targets + 0.1)
    optimiser = torch.optim.Adam([x], lr=rate, betas=(0.9, 0.95))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    levels = int(math.log2(size // rows)) + 1
    grow_at = {round(iterations * 0.6 * level / levels) for level in range(1, levels)}
    curves: dict[str, list[float]] = {"loss": []}

    bar = tr.progress(range(iterations), desc="environment map")
    for iteration in bar:
        if iteration in grow_at:
            rows *= 2
            # Rows end at the poles, columns go round. The optimiser's moments grow along.
            wrap = ("clamp", "repeat")
            x = tr.optim.upsample(scene, SKY, (rows, 2 * rows), optimiser, wrap_mode=wrap)
        optimiser.zero_grad()
        images = renderer(sensor=views, seed=iteration)
        loss = ((images - targets) * weight).square().mean()
        (loss + smoothness * roughness_of(scene.sky.data)).backward()
        optimiser.step()
        schedule.step()
        curves["loss"].append(loss.item())
        bar.set_postfix(loss=f"{loss.item():.3g}", map=f"{rows}x{2 * rows}")

    found = scene.sky.data.detach()
    end = errors()
    with torch.no_grad():
        save(renderer(sensor=0, seed=1_000_001, spp=64, passes=4), folder, "result_front")
    save(found, folder, "map_result")
    save(relit(found, 2_000_001), folder, "relit_result")
    save_curves(curves, folder / "loss.png", f"Environment map: {rows} x {2 * rows} texels")
    for name, what in (("map", "the map"), ("relit", "a picture of another object in its light")):
        print(f"error of {what}: {100 * start[name]:.1f} % at the start, {100 * end[name]:.1f} % now")
    return {f"{name}, {when}": e[name] for when, e in (("start", start), ("end", end)) for name in e}


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="fewer iterations, smaller pictures")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser")
    parser.add_argument("--alpha", type=float, default=0.08, help="roughness of the metal (default 0.08)")
    parser.add_argument("--spp", type=at_least_one, default=32, help="samples a pixel and iteration (default 32)")
    parser.add_argument("--output", type=Path, default=Path("output/environment_map"), help="folder for the pictures")
    options = parser.parse_args(argv)
    start = time.perf_counter()
    run(
        options.output,
        width=96 if options.demo else 160,
        alpha=options.alpha,
        spp=options.spp,
        iterations=options.iterations or (100 if options.demo else 240),
        target_spp=512 if options.demo else 1024,
    )
    print(f"pictures are in {options.output}; {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
