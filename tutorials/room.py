"""Recover the light of a room and the colours of everything in it from a few pictures.

    python tutorials/room.py            # full run
    python tutorials/room.py --demo     # the same, fewer iterations

A closed room with a lamp at the ceiling: every surface is lit by every other one, so that a yellow wall makes the white
one beside it look yellow, and no surface's colour can be read from a picture alone. Path tracing accounts for that, and
its derivative solves for all of them at once; this set-up is known as inverse path tracing (Azinovic, Li, Kaplanyan and
Niessner, CVPR 2019). The geometry is known; unknown are the albedos of six walls and three objects and the radiance of
the lamp, 30 numbers in all.

Twice the light on surfaces half as bright looks nearly the same. Nearly: light that came by way of n surfaces carries n
albedos and one radiance, so that pictures with much indirect light tell. What decides it here is simpler, the lamp is
seen in some of the pictures, and its pixels are its radiance. `--hidden` turns the cameras away from it and from the
ceiling: then the proportion of direct and indirect light alone tells, which takes three times as many steps, and the
ceiling, known only by the light it sends down, is found to 0.1 where all else is found to 0.01.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import torch
from command_line import at_least_one
from pictures import save, save_curves
from torch.nn.utils import parametrize

import torchrender as tr

RADIANCE = "lamp.emitter.radiance.value"
ALBEDOS = {
    "floor": (0.45, 0.32, 0.20),
    "ceiling": (0.80, 0.80, 0.78),
    "left": (0.65, 0.20, 0.12),
    "right": (0.15, 0.35, 0.60),
    "back": (0.75, 0.70, 0.45),
    "front": (0.60, 0.60, 0.60),
    "chest": (0.25, 0.50, 0.25),
    "table": (0.55, 0.40, 0.60),
    "ball": (0.80, 0.55, 0.15),
}
LAMP = (16.0, 13.0, 9.0)


def make_room(resolution: int, hidden: bool) -> tr.Scene:
    """The room, 4 wide, 3 high and 5 deep, with four cameras in its corners, which look at the lamp or below it."""

    def white(name: str) -> dict:
        return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(ALBEDOS[name])}}

    at, turn = tr.Transform.translate, tr.Transform.rotate
    x, y, z = [1, 0, 0], [0, 1, 0], [0, 0, 1]
    walls = {  # rectangles over [-1, 1]^2 that face +z
        "floor": turn(x, -90).scale([2, 2.5, 1]),
        "ceiling": at([0, 3, 0]).rotate(x, 90).scale([2, 2.5, 1]),
        "left": at([-2, 1.5, 0]).rotate(y, 90).scale([2.5, 1.5, 1]),
        "right": at([2, 1.5, 0]).rotate(y, -90).scale([2.5, 1.5, 1]),
        "back": at([0, 1.5, -2.5]).scale([2, 1.5, 1]),
        "front": at([0, 1.5, 2.5]).rotate(y, 180).scale([2, 1.5, 1]),
    }
    objects = {
        name: {"type": "rectangle", "to_world": to_world, "bsdf": white(name)} for name, to_world in walls.items()
    }
    objects["chest"] = {
        "type": "cube",
        "to_world": at([-1.1, 0.5, -1.5]).rotate(y, 20).scale([0.5, 0.5, 0.5]),
        "bsdf": white("chest"),
    }
    objects["table"] = {
        "type": "cube",
        "to_world": at([0.9, 0.3, 0.6]).rotate(y, -15).scale([0.6, 0.3, 0.6]),
        "bsdf": white("table"),
    }
    objects["ball"] = {"type": "sphere", "center": [0.9, 0.95, 0.6], "radius": 0.35, "bsdf": white("ball")}
    objects["lamp"] = {
        "type": "rectangle",
        "to_world": at([0, 2.98, 0]).rotate(z, 10).rotate(x, 90).scale([0.5, 0.5, 1]),
        "bsdf": {"type": "diffuse", "reflectance": 0.0},
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(LAMP)}},
    }
    height = 0.2 if hidden else 1.3  # of what the cameras look at
    film = {"type": "hdrfilm", "width": resolution, "height": resolution, "rfilter": {"type": "box"}}
    corners = ((-1.8, 2.2), (1.8, 2.2), (1.8, -2.2), (-1.8, -2.2))
    cameras = {
        f"view{i}": {
            "type": "perspective",
            "fov": 50 if hidden else 85,
            "to_world": tr.Transform.look_at([a, 1.7, b], [-0.1 * a, height, -0.1 * b], y),
            "film": film,
        }
        for i, (a, b) in enumerate(corners)
    }
    return tr.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 12}, **cameras, **objects})


def run(
    folder: Path,
    *,
    resolution: int = 128,
    spp: int = 16,
    iterations: int = 200,
    target_spp: int = 1024,
    rate: float = 0.2,
    hidden: bool = False,
) -> dict[str, float]:
    """The whole program; returns the largest error of an albedo and the largest relative one of the radiance.

    Args:
        folder: where the pictures go.
        resolution: pixels along either side of a picture.
        spp: samples a pixel of every iteration, for the pictures and for their derivative.
        iterations: steps of the optimiser; each looks at two of the four pictures.
        target_spp: samples a pixel of the given pictures.
        rate: learning rate at the start; it falls to zero along a cosine.
        hidden: do not show the lamp.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scene = make_room(resolution, hidden)
    views = list(range(4))
    renderer = tr.Renderer(scene, spp=spp)
    with torch.no_grad():
        targets = renderer(sensor=views, seed=1_000_000, spp=64, passes=max(1, target_spp // 64))
    for view in views:
        save(targets[view], folder, f"target{view}")

    # Albedos between 0 and 1: `parametrize` makes each out of a number without bounds, and the scene sees the result.
    numbers = []
    for name in ALBEDOS:
        texture = scene[name].bsdf.reflectance
        texture.value = torch.nn.Parameter(torch.full((3,), 0.5))
        parametrize.register_parametrization(texture, "value", tr.constraints.UnitInterval())
        numbers.append(texture.parametrizations.value.original.requires_grad_())
    # A radiance may be a hundred times what one thinks: its logarithm is what makes steps of the right size. `params=`
    # takes the result of any computation in place of a parameter.
    log_radiance = torch.zeros(3, requires_grad=True)

    def pictures(sensors: list[int], **settings: int) -> torch.Tensor:
        return renderer(sensor=sensors, params={RADIANCE: log_radiance.exp()}, **settings)

    def errors() -> dict[str, float]:
        albedos = [scene[name].bsdf.reflectance.value.detach() for name in ALBEDOS]
        difference = [(a - torch.tensor(ALBEDOS[n])).abs().max().item() for n, a in zip(ALBEDOS, albedos, strict=True)]
        relative = (log_radiance.detach().exp() / torch.tensor(LAMP) - 1).abs().max().item()
        return {"albedo": max(difference), "radiance": relative}

    with torch.no_grad():
        save(pictures([0], seed=1_000_001)[0], folder, "start")
    start = errors()

    # Errors in units of what is to be expected of them: of a pixel's noise, which the renderer estimates from its
    # samples, and of a fiftieth of its radiance. The lamp's pixels have no noise at all and count most, which settles
    # the radiance first; with relative errors alone it and the albedos would drift to the answer together, for long.
    # The weights are constants of the given pictures, so that the gradient stays unbiased.
    with torch.no_grad():
        noise = renderer(sensor=views, seed=1_000_003, spp=64, outputs=("variance",)).variance * (64 / spp)
    weight = (noise.mean(-1, keepdim=True) + (0.02 * (targets.mean(-1, keepdim=True) + 0.1)).square()).rsqrt()
    weight = weight / weight.mean()
    optimiser = torch.optim.Adam([*numbers, log_radiance], lr=rate, betas=(0.8, 0.95))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    curves: dict[str, list[float]] = {"loss": [], "largest albedo error": [], "largest relative radiance error": []}
    generator = torch.Generator().manual_seed(0)
    # The mean of the last third of the steps has less noise than the last one.
    settled = [torch.zeros_like(number) for number in (*numbers, log_radiance)]
    first_averaged = iterations - max(1, iterations // 3)

    bar = tr.progress(range(iterations), desc="room")
    for iteration in bar:
        optimiser.zero_grad()
        chosen = torch.randperm(4, generator=generator)[:2].tolist()
        loss = ((pictures(chosen, seed=iteration) - targets[chosen]) * weight[chosen]).square().mean()
        loss.backward()
        optimiser.step()
        schedule.step()
        if iteration >= first_averaged:
            with torch.no_grad():
                for mean, number in zip(settled, (*numbers, log_radiance), strict=True):
                    mean += number / (iterations - first_averaged)
        now = errors()
        for name, value in zip(curves, (loss.item(), now["albedo"], now["radiance"]), strict=True):
            curves[name].append(value)
        bar.set_postfix(loss=f"{loss.item():.3g}", albedo=f"{now['albedo']:.3f}", radiance=f"{now['radiance']:.3f}")

    with torch.no_grad():
        for number, mean in zip((*numbers, log_radiance), settled, strict=True):
            number.copy_(mean)
        save(pictures([0], seed=1_000_002, spp=64)[0], folder, "result")
    save_curves(curves, folder / "loss.png", "Room: nine albedos and the lamp")
    for name, true in ALBEDOS.items():
        found = scene[name].bsdf.reflectance.value.detach().tolist()
        print(f"{name:>9}: " + "  ".join(f"{f:.4f} ({t:.2f})" for f, t in zip(found, true, strict=True)))
    lamp = log_radiance.detach().exp().tolist()
    print("     lamp: " + "  ".join(f"{f:.3f} ({t:.0f})" for f, t in zip(lamp, LAMP, strict=True)))
    end = errors()
    print(
        f"found (true); largest error of an albedo {end['albedo']:.4f}, of the radiance {100 * end['radiance']:.2f} %"
    )
    return {f"{name}, {when}": e[name] for when, e in (("start", start), ("end", end)) for name in e}


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="fewer iterations, smaller pictures")
    parser.add_argument("--hidden", action="store_true", help="do not show the lamp")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser")
    parser.add_argument("--spp", type=at_least_one, default=16, help="samples a pixel and iteration (default 16)")
    parser.add_argument("--resolution", type=at_least_one, help="pixels along a side of a picture")
    parser.add_argument("--output", type=Path, default=Path("output/room"), help="folder for the pictures")
    options = parser.parse_args(argv)
    start = time.perf_counter()
    run(
        options.output,
        resolution=options.resolution or (64 if options.demo else 128),
        spp=options.spp,
        iterations=options.iterations or (100 if options.demo else 200),
        target_spp=512 if options.demo else 1024,
        hidden=options.hidden,
    )
    print(f"pictures are in {options.output}; {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
