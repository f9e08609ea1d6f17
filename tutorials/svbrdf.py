"""Measure how a flat sample reflects light: maps of colours, roughness and normals, from photographs under a flash.

    python tutorials/svbrdf.py            # full run
    python tutorials/svbrdf.py --demo     # the same, smaller

A camera looks straight down at a sample, and a small lamp is moved around above it; each place gives a photograph.
Every texel is seen from one direction and lit from a few, and has ten unknown numbers: a diffuse colour, a specular
colour, a roughness, and a normal of any length. What the mirror direction of a lamp hits shows its highlight, whose
height and width tell specular colour and roughness apart, and whose place tells the normal; all other photographs of
that texel show its diffuse colour, and by their differences the normal again. Texels that no highlight came near leave
roughness undecided, which is why many places of the lamp are better than few, and why the maps are found coarse to
fine: what a highlight says is first shared by the texels around it.

Lamp and sample are all there is, so that a path has two segments, and one sample a pixel is nearly free of noise: this
is an optimisation of 128 x 128 x 10 numbers in which noise plays no part.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import kornia
import torch
from command_line import at_least_one
from pictures import save, save_curves
from torch.nn.utils import parametrize

import torchrender as tr


@dataclass(frozen=True)
class Map:
    """An unknown map: the texture's place in the scene, its range, and where its channels start."""

    texture: str
    low: float
    high: float
    start: tuple[float, ...]


MAPS = {
    "diffuse": Map("sample.bsdf.nested_bsdf.diffuse_reflectance", 0.0, 1.0, (0.3, 0.3, 0.3)),
    "specular": Map("sample.bsdf.nested_bsdf.specular_reflectance", 0.0, 1.0, (0.1, 0.1, 0.1)),
    "roughness": Map("sample.bsdf.nested_bsdf.roughness", 0.005, 0.3, (0.1,)),
    "normals": Map("sample.bsdf.normalmap", 0.0, 1.0, (0.5, 0.5, 0.9)),
}
DISTANCE = 2.5  # of the lamp from the middle of the sample, whose sides are 2 long
EXPOSURE = -2.0  # of the saved photographs, in stops


def sample_maps(size: int) -> dict[str, torch.Tensor]:
    """The maps to be found, (size, size, channels): a tiled floor, glazed and dull tiles, with metal between them."""
    centres = (torch.arange(size) + 0.5) / size
    v, u = torch.meshgrid(centres, centres, indexing="ij")
    turn = 2 * math.pi
    # Tiles of a soft edge: 1 in the middle, 0 in the joints.
    across = [torch.sigmoid(40 * (0.34 - (4 * x % 1 - 0.5).abs())) for x in (u, v)]
    tile = (across[0] * across[1])[..., None]
    dull = ((4 * u).floor() + (4 * v).floor()).remainder(2)[..., None]
    cloud = (torch.sin(turn * (u + 0.3 * torch.sin(turn * v))) * torch.cos(turn * 2 * v + 2 * u))[..., None]
    blue, red = torch.tensor([0.15, 0.3, 0.5]), torch.tensor([0.5, 0.2, 0.1])
    glaze = blue + (red - blue) * (0.5 + 0.5 * cloud)
    diffuse = tile * glaze + (1 - tile) * 0.06
    specular = tile * (0.08 - 0.04 * dull) + (1 - tile) * torch.tensor([0.5, 0.42, 0.3])
    roughness = tile * (0.02 + 0.06 * dull + 0.01 * cloud) + (1 - tile) * 0.04
    # Tiles are domed; joints are flat.
    lean = [tile[..., 0] * (4 * x % 1 - 0.5) for x in (u, v)]
    normals = torch.stack([*lean, torch.ones_like(u)], dim=2)
    return {
        "diffuse": diffuse,
        "specular": specular.expand(size, size, 3).clone(),
        "roughness": roughness,
        "normals": unit(normals) * 0.5 + 0.5,
    }


def unit(normals: torch.Tensor) -> torch.Tensor:
    return normals / torch.linalg.vector_norm(normals, dim=-1, keepdim=True)


def lamps(count: int) -> torch.Tensor:
    """Places of the lamp (count, 3) above the sample, on a spiral: the first straight above, the last 65 degrees off.

    Their heights are evenly spaced, so that they cover the sphere around the sample evenly.
    """
    i = torch.arange(count, dtype=torch.float32)
    z, turn = 1 - (1 - math.cos(math.radians(65))) * i / max(count - 1, 1), i * math.pi * (3 - math.sqrt(5))
    r = (1 - z * z).sqrt()
    return DISTANCE * torch.stack([r * turn.cos(), r * turn.sin(), z], dim=1)


def material(maps: dict[str, torch.Tensor]) -> dict[str, Any]:
    """The BSDF of the sample with textures of these maps."""

    def texture(name: str) -> dict[str, Any]:
        return {"type": "bitmap", "data": maps[name], "raw": True, "wrap_mode": "clamp"}

    return {
        "type": "normalmap",
        "normalmap": texture("normals"),
        "bsdf": {
            "type": "redner",
            "diffuse_reflectance": texture("diffuse"),
            "specular_reflectance": texture("specular"),
            "roughness": texture("roughness"),
        },
    }


def make_scene(resolution: int, maps: dict[str, torch.Tensor]) -> tr.Scene:
    """The sample under the camera, and a lamp."""
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "camera": {
                "type": "perspective",
                "fov": 2 * math.degrees(math.atan(1 / 4)),  # the sample fills the picture
                "to_world": tr.Transform.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": resolution, "height": resolution, "rfilter": {"type": "box"}},
            },
            "sample": {"type": "rectangle", "bsdf": material(maps)},
            "lamp": {"type": "point", "position": [0, 0, DISTANCE], "intensity": 20.0},
        }
    )


def psnr(found: torch.Tensor, true: torch.Tensor, peak: float = 1.0) -> float:
    """Peak signal-to-noise ratio in dB."""
    return float(kornia.metrics.psnr(found, true, peak))


def run(
    folder: Path,
    *,
    size: int = 128,
    resolution: int = 128,
    lamp_count: int = 24,
    lamps_per_step: int = 4,
    spp: int = 2,
    iterations: int = 600,
    target_spp: int = 64,
    rate: float = 0.1,
) -> dict[str, float]:
    """The whole program; returns the PSNR in dB of each map, and of a photograph with the lamp at a new place.

    Args:
        folder: where the pictures go.
        size: texels along either side of the maps; at least 16 and a power of two.
        resolution: pixels along either side of a photograph.
        lamp_count, lamps_per_step: photographs that are given, and how many of them an iteration looks at.
        spp: samples a pixel of the rendered pictures and of their derivative.
        iterations: steps of the optimiser.
        target_spp: samples a pixel of the given photographs.
        rate: learning rate at the start; it falls to zero along a cosine.
    """
    folder.mkdir(parents=True, exist_ok=True)
    truth = sample_maps(size)
    scene = make_scene(resolution, truth)
    places = lamps(lamp_count)
    new_place = torch.tensor([0.8, -0.6, 2.2])

    def photograph(place: torch.Tensor, seed: int, spp: int = spp) -> torch.Tensor:
        # The lamp is moved for this one picture only.
        return tr.render(scene, seed=seed, spp=spp, params={"lamp.position": place})

    with torch.no_grad():
        targets = [photograph(place, 1_000_000 + i, target_spp) for i, place in enumerate(places)]
        new_target = photograph(new_place, 2_000_000, target_spp)
    save(targets[0], folder, "target_first", EXPOSURE)
    save(targets[-1], folder, "target_last", EXPOSURE)
    for name, value in truth.items():
        save(value.expand(-1, -1, 3), folder, f"{name}_target")

    # Grey maps of 16 x 16 texels. Each is made of numbers without bounds, so that it stays in its range.
    texels = 16
    for unknown in MAPS.values():
        texture = scene.get_submodule(unknown.texture)
        texture.data = torch.nn.Parameter(torch.tensor(unknown.start).expand(texels, texels, -1).clone())
        parametrize.register_parametrization(texture, "data", tr.constraints.ScaledSigmoid(unknown.low, unknown.high))
    numbers = [scene.get_submodule(m.texture).parametrizations.data.original for m in MAPS.values()]

    def found() -> dict[str, torch.Tensor]:
        maps = {
            name: tr.optim.resample(scene.get_submodule(m.texture).data.detach(), (size, size), "clamp")
            for name, m in MAPS.items()
        }
        return {**maps, "normals": unit(maps["normals"] * 2 - 1) * 0.5 + 0.5}  # their length means nothing

    def quality() -> dict[str, float]:
        with torch.no_grad():
            picture = photograph(new_place, 2_000_001, 16)
        maps = {name: psnr(value, truth[name]) for name, value in found().items()}
        return {**maps, "new picture": psnr(picture, new_target, float(new_target.max()))}

    start = quality()
    with torch.no_grad():
        save(photograph(places[0], 1_000_000, 16), folder, "start", EXPOSURE)

    optimiser = torch.optim.Adam(numbers, lr=rate, betas=(0.9, 0.95))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    levels = int(math.log2(size // texels)) + 1
    grow_at = {round(iterations * 0.6 * level / levels) for level in range(1, levels)}
    generator = torch.Generator().manual_seed(0)
    curves: dict[str, list[float]] = {"loss": []}

    bar = tr.progress(range(iterations), desc="SVBRDF")
    for iteration in bar:
        if iteration in grow_at:
            texels *= 2
            for unknown in MAPS.values():
                # the texture, and the moments that the optimiser has of it
                tr.optim.upsample(scene, f"{unknown.texture}.data", (texels, texels), optimiser)
        optimiser.zero_grad()
        chosen = torch.randperm(lamp_count, generator=generator)[:lamps_per_step].tolist()
        loss = torch.zeros(())
        for n, i in enumerate(chosen):
            image = photograph(places[i], iteration * lamps_per_step + n)
            # A highlight is a hundred times brighter than what is around it: count errors relative to the photograph.
            loss = loss + ((image - targets[i]) / (targets[i] + 0.1)).square().mean() / len(chosen)
        loss.backward()
        optimiser.step()
        schedule.step()
        curves["loss"].append(loss.item())
        bar.set_postfix(loss=f"{loss.item():.3g}", maps=f"{texels}x{texels}")

    end = quality()
    for name, value in found().items():
        save(value.expand(-1, -1, 3), folder, f"{name}_result")
    with torch.no_grad():
        save(photograph(new_place, 2_000_001, 64), folder, "result_new", EXPOSURE)
    save(new_target, folder, "target_new", EXPOSURE)
    save_curves(curves, folder / "loss.png", f"SVBRDF: {len(MAPS)} maps of {size} x {size} texels")
    for name, value in end.items():
        print(f"PSNR, {name:>12}: {start[name]:.1f} dB at the start, {value:.1f} dB now")
    return {f"{name}, {when}": q[name] for when, q in (("start", start), ("end", end)) for name in q}


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="smaller maps, fewer iterations")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser")
    parser.add_argument("--size", type=at_least_one, help="texels along a side of the maps")
    parser.add_argument("--lamps", type=at_least_one, default=24, help="photographs (default 24)")
    parser.add_argument("--output", type=Path, default=Path("output/svbrdf"), help="folder for the pictures")
    options = parser.parse_args(argv)
    size = options.size or (64 if options.demo else 128)
    start = time.perf_counter()
    run(
        options.output,
        size=size,
        resolution=size,
        lamp_count=options.lamps,
        iterations=options.iterations or (300 if options.demo else 600),
    )
    print(f"pictures are in {options.output}; {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
