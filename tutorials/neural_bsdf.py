"""Fit a material that is a small neural network to pictures of a ball.

    python tutorials/neural_bsdf.py            # full run
    python tutorials/neural_bsdf.py --demo     # the same, fewer iterations

A ball of an unknown material was photographed under a small lamp, which stood somewhere else for each picture. What the
material does with light is a function of two directions, and a multilayer perceptron can be any such function. The
class `NeuralBSDF` below makes it a BSDF of the scene: `tr.WavefrontPathTracer` calls its `eval` for many paths at a
time, and the gradient of the loss runs through the renderer into the weights.

Two properties of real materials are built in. What is reflected is never negative, because the last layer is an
exponential. And light may go either way (Helmholtz reciprocity), because the network sees the two directions through
quantities that stay the same when they are exchanged. How bright the material is as a whole nothing but the pictures
says.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import torch
from command_line import at_least_one
from pictures import save, save_curves
from torch import nn

import torchrender as tr

LAMP = "lamp.position"
# What the pictures are of, and what we pretend not to know.
MATERIAL = {
    "type": "principled",
    "base_color": {"type": "rgb", "value": [0.55, 0.2, 0.08]},
    "metallic": 0.5,
    "roughness": 0.45,
    "specular": 0.6,
}


class NeuralBSDF(tr.TorchBSDF):
    """Isotropic reflection off the front, reciprocal and not negative.

    Args:
        width: neurons of each of the two hidden layers.
    """

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(6, width), nn.LeakyReLU(), nn.Linear(width, width), nn.LeakyReLU(), nn.Linear(width, 3)
        )

    def reflect(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        """The BRDF (N, 3) in 1 / sr, without the cosine."""
        half = torch.nn.functional.normalize(wi + wo, dim=1)
        # The tilt of the half vector, in which highlights are sharp, and the angle between it and the directions
        # (Rusinkiewicz 1998). Sum and product of the cosines tell how grazing the two are, but not which is which.
        tilt = (1 - half[:, 2]).clamp(min=0)
        across = (wi * half).sum(1)
        sum_, product = wi[:, 2] + wo[:, 2], wi[:, 2] * wo[:, 2]
        features = [torch.sqrt(tilt + 1e-6), torch.exp(-20 * tilt), across, (1 - across) ** 5, sum_, product]
        return torch.exp(self.layers(torch.stack(features, 1)) - 2)

    def eval(self, si: object, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        above = (wi[:, 2:] > 0) & (wo[:, 2:] > 0)
        return torch.where(above, self.reflect(wi, wo) * wo[:, 2:], 0.0)


def make_scene(bsdf: object, resolution: int) -> tr.Scene:
    """The ball in the dark and a lamp."""
    film = {"type": "hdrfilm", "width": resolution, "height": resolution, "rfilter": {"type": "box"}}
    return tr.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 30,
                "to_world": tr.Transform.look_at([0, 0, 4.2], [0, 0, 0]),
                "film": film,
            },
            "lamp": {"type": "point", "position": [0.0, 0.0, 5.0], "intensity": 40.0},
            "ball": {"type": "sphere", "bsdf": bsdf},
        }
    )


def make_room(bsdf: object, resolution: int) -> tr.Scene:
    """Where the material has not been seen: on a chequered floor under a lamp with a surface and a sky."""
    film = {"type": "hdrfilm", "width": resolution * 3 // 2, "height": resolution, "rfilter": {"type": "box"}}
    lamp = tr.Transform.look_at([2.5, 4, 2], [0, 0, 0])
    chequered = {"type": "checkerboard", "to_uv": tr.Transform.scale([6, 6, 1])}
    floor = tr.Transform.translate([0, -1, 0]) @ tr.Transform.rotate([1, 0, 0], -90) @ tr.Transform.scale(6)
    return tr.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 40,
                "to_world": tr.Transform.look_at([1.5, 1.2, 5.5], [0, 0, 0]),
                "film": film,
            },
            "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.3, 0.4, 0.5]}},
            "lamp": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": 8.0}},
            "floor": {"type": "rectangle", "to_world": floor, "bsdf": {"type": "diffuse", "reflectance": chequered}},
            "ball": {"type": "sphere", "bsdf": bsdf},
        }
    )


def lamp_positions(count: int) -> torch.Tensor:
    """Places (count, 3) around the ball: from beside the camera to beyond its side."""
    angle = torch.linspace(0.1, 2.0, count)
    turn = 2.4 * torch.arange(count)  # a golden angle: from all sides
    return 5 * torch.stack([angle.sin() * turn.cos(), angle.sin() * turn.sin(), angle.cos()], 1)


def compressed(image: torch.Tensor) -> torch.Tensor:
    """Radiance on a scale on which highlights do not count for everything."""
    return torch.log1p(10 * image)


def relative_error(found: torch.Tensor, true: torch.Tensor) -> float:
    """Root of the mean squared difference, in parts of the root mean square."""
    return float((found - true).square().mean().sqrt() / true.square().mean().sqrt())


def run(
    folder: Path,
    *,
    resolution: int = 96,
    lamps: int = 12,
    spp: int = 4,
    iterations: int = 400,
    room_spp: int = 64,
    rate: float = 1e-2,
) -> dict[str, float]:
    """The whole program.

    Args:
        folder: where the pictures go.
        resolution: pixels along either side of the pictures of the ball.
        lamps: number of pictures.
        spp: samples a pixel of every rendered picture and of its derivative.
        iterations: steps of the optimiser, one picture each.
        room_spp: samples a pixel of the picture in a new surrounding.
        rate: learning rate at the start; it falls to zero along a cosine.

    Returns:
        Relative errors (root mean square): of all pictures at the start (``start``) and at the end (``end``), and of
        the picture of a room that the training has not seen (``room``), which includes its noise. `reciprocity`: the
        largest relative change of the BRDF when directions are exchanged.
    """
    folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(0)  # of the network's weights; the renderer gets its seeds below
    positions = lamp_positions(lamps)
    given = make_scene(MATERIAL, resolution)
    with torch.no_grad():
        targets = torch.stack([tr.render(given, params={LAMP: p}, spp=64, seed=1_000_000) for p in positions])

    bsdf = NeuralBSDF()
    scene = make_scene(bsdf, resolution)
    renderer = tr.Renderer(scene, integrator=tr.WavefrontPathTracer(max_depth=2), spp=spp)
    shown = list(range(0, lamps, max(1, lamps // 4)))[:4]

    def render_all(seed: int) -> torch.Tensor:
        with torch.no_grad():
            return torch.stack([renderer(params={LAMP: p}, seed=seed, spp=16) for p in positions])

    images = render_all(1_000_001)
    result = {"start": relative_error(images, targets)}
    save(torch.cat(list(targets[shown]), 1), folder, "target")
    save(torch.cat(list(images[shown]), 1), folder, "start")

    optimiser = torch.optim.Adam(bsdf.parameters(), lr=rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    curves: dict[str, list[float]] = {"loss": []}
    bar = tr.progress(range(iterations), desc="neural BSDF")
    for iteration in bar:
        optimiser.zero_grad()
        lamp = iteration % lamps
        image = renderer(params={LAMP: positions[lamp]}, seed=iteration)
        loss = (compressed(image) - compressed(targets[lamp])).square().mean()
        loss.backward()
        optimiser.step()
        schedule.step()
        curves["loss"].append(loss.item())
        bar.set_postfix(loss=f"{loss.item():.3g}")

    images = render_all(1_000_002)
    result["end"] = relative_error(images, targets)
    save(torch.cat(list(images[shown]), 1), folder, "result")
    save_curves(curves, folder / "loss.png", "Neural BSDF: weights of a material")

    # The material is a part of any scene: it reflects a lamp that has a surface, a sky and the floor, and is reflected.
    with torch.no_grad():
        truth = tr.render(make_room(MATERIAL, resolution), integrator=tr.PathTracer(4), spp=1024, seed=1)
        room = tr.render(
            make_room(bsdf, resolution), integrator=tr.WavefrontPathTracer(4, chunk=1 << 15), spp=room_spp, seed=2
        )
        wi, wo = torch.nn.functional.normalize(torch.randn(2, 1000, 3), dim=2)
        wi, wo = (torch.cat([w[:, :2], w[:, 2:].abs()], 1) for w in (wi, wo))
        one, other = bsdf.reflect(wi, wo), bsdf.reflect(wo, wi)
    save(truth, folder, "room_target")
    save(room, folder, "room_result")
    result["room"] = relative_error(room, truth)
    result["reciprocity"] = float(((one - other) / one).abs().max())
    weights = sum(p.numel() for p in bsdf.parameters())
    print(f"{weights} weights are the material in {lamps} pictures")
    print(f"relative error of the pictures: {result['start']:.3f} at the start, {result['end']:.3f} now")
    print(f"relative error in a room that it was not trained in: {result['room']:.3f}, of which some is noise")
    print(f"largest change when light goes the other way: {result['reciprocity']:.1e}")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="fewer iterations: well under two minutes")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser")
    parser.add_argument("--spp", type=at_least_one, default=4, help="samples a pixel and iteration (default 4)")
    parser.add_argument(
        "--resolution", type=at_least_one, default=96, help="pixels along a side of a picture (default 96)"
    )
    parser.add_argument("--output", type=Path, default=Path("output/neural_bsdf"), help="folder for the pictures")
    options = parser.parse_args(argv)
    start = time.perf_counter()
    run(
        options.output,
        resolution=options.resolution,
        spp=options.spp,
        iterations=options.iterations or (120 if options.demo else 400),
        room_spp=16 if options.demo else 64,
    )
    print(f"pictures are in {options.output}; {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
