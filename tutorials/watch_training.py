"""Watch an inversion in TensorBoard: its loss, its pictures and its parameters, while it runs.

    python tutorials/watch_training.py           # in another terminal: tensorboard --logdir output/watch_training

A ball stands on a floor under a lamp. We photograph it, forget the colours of ball and floor, the roughness of the
ball's coat and the colour of the lamp, start somewhere else, and let gradient descent find all ten numbers from the one
picture.

What is new here is how to look at it. `tr.log_images` hands linear pictures, tone mapped, to whatever has an
`add_image`: that is TensorBoard's `SummaryWriter`, if TensorBoard is installed (pip install tensorboard), else a few
lines of our own, which write PNG files and a table.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path
from typing import Any

import torch
from command_line import at_least_one

import torchrender as tr
from torchrender.image import false_colors, srgb_to_linear

BALL, FLOOR = "ball.bsdf.diffuse_reflectance.value", "floor.bsdf.reflectance.value"
ALPHA, LAMP = "ball.bsdf.alpha", "lamp.intensity.value"
UNKNOWN = (BALL, FLOOR, ALPHA, LAMP)
START = {BALL: [0.5, 0.5, 0.5], FLOOR: [0.3, 0.3, 0.3], ALPHA: 0.25, LAMP: [8.0, 8.0, 8.0]}


class Files:
    """What a `SummaryWriter` does here, without TensorBoard: scalars in a table, pictures as PNG files."""

    def __init__(self, log_dir: str) -> None:
        self.folder = Path(log_dir)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.file = (self.folder / "scalars.csv").open("w", newline="")
        self.table = csv.writer(self.file)
        self.table.writerow(["tag", "step", "value"])

    def add_scalar(self, tag: str, value: float, step: int) -> None:
        self.table.writerow([tag, step, float(value)])

    def add_image(self, tag: str, image: torch.Tensor, step: int) -> None:
        picture = image.movedim(0, -1).float() / 255
        tr.io.write_image(self.folder / f"{tag.replace('/', '_')}_{step:04d}.png", picture, raw=True)

    def close(self) -> None:
        self.file.close()


def make_writer(folder: Path) -> Any:
    """TensorBoard's writer, or ours and a sentence that says how to have the other one."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        print(f"TensorBoard is not installed (pip install tensorboard): pictures and a table are in {folder}")
        return Files(str(folder))
    return SummaryWriter(str(folder))


def make_scene(resolution: int) -> tr.Scene:
    def colour(*rgb: float) -> dict[str, Any]:
        return {"type": "rgb", "value": list(rgb)}

    film = {"type": "hdrfilm", "width": resolution, "height": resolution, "rfilter": {"type": "box"}}
    look = tr.Transform().look_at(origin=[0, 2.2, 5], target=[0, 0.8, 0], up=[0, 1, 0])
    coat = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.1, "diffuse_reflectance": colour(0.7, 0.15, 0.1)}
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "camera": {"type": "perspective", "fov": 35, "to_world": look, "film": film},
            "ball": {"type": "sphere", "center": [0, 1, 0], "bsdf": coat},
            "floor": {
                "type": "rectangle",
                "to_world": tr.Transform().rotate([1, 0, 0], -90).scale(4),
                "bsdf": {"type": "diffuse", "reflectance": colour(0.2, 0.4, 0.6)},
            },
            "lamp": {"type": "point", "position": [2, 4, 3], "intensity": colour(16.0, 14.0, 12.0)},
            "sky": {"type": "constant", "radiance": 0.3},
        }
    )


def run(
    folder: Path,
    *,
    resolution: int = 96,
    spp: int = 16,
    iterations: int = 200,
    target_spp: int = 1024,
    rate: float = 0.08,
    picture_every: int = 20,
) -> dict[str, float]:
    """The whole program; returns the largest error of each parameter, relative to its largest value.

    Args:
        folder: where the logs go.
        resolution: pixels along either side of the film.
        spp: samples a pixel of every iteration, for the picture and for its derivative.
        iterations: steps of the optimiser.
        target_spp: samples a pixel of the target picture.
        rate: learning rate at the start; it falls to zero along a cosine.
        picture_every: iterations from one logged picture to the next.
    """
    scene = make_scene(resolution)
    renderer = tr.Renderer(scene, spp=spp)
    truth = {name: scene.get_parameter(name).detach().clone() for name in UNKNOWN}
    with torch.no_grad():
        target = renderer(seed=1_000_000, spp=target_spp)

    scene.train_only(*UNKNOWN)
    parameters = {name: scene.get_parameter(name) for name in UNKNOWN}
    with torch.no_grad():
        for name, parameter in parameters.items():
            parameter.copy_(torch.as_tensor(START[name]))

    # A lamp of 16 and a roughness of 0.1 need steps of different sizes: of each a part of what it starts with.
    groups = [{"params": [p], "lr": rate * float(p.detach().mean())} for p in parameters.values()]
    optimiser = torch.optim.Adam(groups, betas=(0.8, 0.95))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)

    writer = make_writer(folder)
    bar = tr.progress(range(iterations), desc="watched")
    for iteration in bar:
        optimiser.zero_grad()
        image = renderer(seed=iteration)
        difference = (image - target) / (target + 0.1)
        loss = difference.square().mean()
        loss.backward()

        # Scalars are numbers by step; a name with a slash puts them into one group.
        writer.add_scalar("loss", loss.item(), iteration)
        writer.add_scalar("learning rate", schedule.get_last_lr()[0], iteration)
        for name, parameter in parameters.items():
            assert parameter.grad is not None
            writer.add_scalar(f"gradient/{name}", float(parameter.grad.norm()), iteration)
            for i, value in enumerate(parameter.detach().flatten().tolist()):
                writer.add_scalar(f"{name}/{'rgb'[i] if parameter.numel() > 1 else 'value'}", value, iteration)
        # Pictures are linear light: log_images encodes them for the screen and puts them side by side. False colours
        # are meant for the screen as they are, so they are made linear first.
        if iteration % picture_every == 0 or iteration == iterations - 1:
            tr.log_images(writer, "pictures/result_target", [image, target], iteration)
            error = false_colors(difference.detach().abs().mean(-1))
            tr.log_images(writer, "pictures/error", srgb_to_linear(error), iteration)

        optimiser.step()
        schedule.step()
        with torch.no_grad():
            for name, parameter in parameters.items():
                parameter.clamp_(0.01, 100.0 if name == LAMP else 0.95)
        bar.set_postfix(loss=f"{loss.item():.3g}")
    writer.close()

    errors = {}
    for name, true in truth.items():
        found = parameters[name].detach()
        errors[name] = float((found - true).abs().max() / true.max())
        values = "  ".join(f"{f:.3f} ({t:.3f})" for f, t in zip(found.flatten(), true.flatten(), strict=True))
        print(f"{name:>36}: {values}")
    print(f"found (true); largest relative error {max(errors.values()):.3f}")
    return errors


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--iterations", type=at_least_one, default=200, help="steps of the optimiser (default %(default)s)"
    )
    parser.add_argument("--resolution", type=at_least_one, default=96, help="pixels along a side (default %(default)s)")
    parser.add_argument("--output", type=Path, default=Path("output/watch_training"), help="folder for the logs")
    options = parser.parse_args(argv)
    start = time.perf_counter()
    run(options.output, resolution=options.resolution, iterations=options.iterations)
    print(f"logs are in {options.output}; {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
