"""Recover the colours of the Cornell box from one picture of it.

    python tutorials/cornell_box.py            # full run
    python tutorials/cornell_box.py --demo     # the same, fewer iterations

We render a target picture of a room, forget the colours of its walls, floor and boxes, start again from grey, and
let gradient descent change them until the rendered picture matches the target. The gradients come from the path
tracer itself: light that bounces from the red wall onto the white box takes part in the answer.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import torch
from command_line import at_least_one
from pictures import save, save_curves, save_signed

import torchrender as tr

SCENE = Path(__file__).resolve().parent.parent / "scenes" / "cornell_box.xml"

# The unknown surfaces. The lamp's own surface is left out: it reflects next to nothing into the picture.
SURFACES = {
    "floor": "floor",
    "ceil": "ceiling and back wall",
    "red": "red wall",
    "green": "green wall",
    "box": "boxes",
}


def run(
    folder: Path,
    *,
    resolution: int = 256,
    spp: int = 16,
    iterations: int = 150,
    target_spp: int = 512,
    rate: float = 0.08,
) -> dict[str, float]:
    """The whole program; returns the largest error of each surface's albedo.

    Args:
        folder: where the pictures go.
        resolution: pixels along either side of the film.
        spp: samples a pixel of every iteration, for the picture and for its derivative.
        iterations: steps of the optimiser.
        target_spp: samples a pixel of the target picture.
        rate: learning rate at the start; it falls to zero along a cosine.
    """
    folder.mkdir(parents=True, exist_ok=True)

    # A scene is a torch.nn.Module; `resolution` fills the $resolution that the scene file leaves open.
    scene = tr.load_file(SCENE, resolution=resolution)
    renderer = tr.Renderer(scene, spp=spp)

    # Its parameters have names. These are the ones we pretend not to know.
    names = [f"{surface}.reflectance.value" for surface in SURFACES]
    truth = {name: scene.get_parameter(name).detach().clone() for name in names}

    # The target: the same renderer, more samples. Different seeds give independent noise, so take one that no
    # iteration uses. `passes` averages independent passes without needing more memory.
    with torch.no_grad():
        target = renderer(seed=1_000_000, spp=64, passes=max(1, target_spp // 64))
    save(target, folder, "target")

    # train_only() makes exactly these parameters require gradients and hands them to us. Start from grey.
    albedos = scene.train_only(*names)
    with torch.no_grad():
        for albedo in albedos:
            albedo.fill_(0.5)
        save(renderer(seed=1_000_001, spp=64), folder, "start")

    # Bright pixels are the noisy ones. Dividing by the target makes the error relative, so that the dark corners speak,
    # too; the weights are constants, so the gradient stays unbiased.
    weight = 1 / (target + 0.1)
    # A short memory of Adam's second moment lets the steps follow the gradients while they shrink.
    optimiser = torch.optim.Adam(albedos, lr=rate, betas=(0.7, 0.9))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    curves: dict[str, list[float]] = {"loss": [], "largest albedo error": []}
    # Every iterate still carries the noise of the last few gradients; the mean of the last third has less of it.
    average = [torch.zeros_like(albedo) for albedo in albedos]
    first_averaged = iterations - max(1, iterations // 3)

    bar = tr.progress(range(iterations), desc="Cornell box")
    for iteration in bar:
        optimiser.zero_grad()
        # A new seed each time: the noise of different iterations is independent and averages out. By default the
        # derivative is estimated from samples of its own, which makes the gradient of this squared error unbiased.
        image = renderer(seed=iteration)
        loss = ((image - target) * weight).square().mean()
        loss.backward()
        optimiser.step()
        schedule.step()
        with torch.no_grad():
            for albedo in albedos:
                albedo.clamp_(0.001, 0.999)  # a surface reflects neither less than nothing nor more than everything
            if iteration >= first_averaged:
                for mean, albedo in zip(average, albedos, strict=True):
                    mean += albedo / (iterations - first_averaged)
        error = max(float((p.detach() - truth[n]).abs().max()) for n, p in zip(names, albedos, strict=True))
        curves["loss"].append(loss.item())
        curves["largest albedo error"].append(error)
        bar.set_postfix(loss=f"{loss.item():.3g}", error=f"{error:.4f}")

    with torch.no_grad():
        for albedo, mean in zip(albedos, average, strict=True):
            albedo.copy_(mean)  # an edit in place: the next rendering sees it
        save(renderer(seed=1_000_002, spp=64), folder, "result")

    # Forward mode answers another question: how does every pixel change if the red wall becomes brighter? The red
    # floor in front of it and the left sides of the boxes light up, and so does, faintly, the whole room.
    red = scene.get_parameter("red.reflectance.value")

    def picture(value: torch.Tensor) -> torch.Tensor:
        return renderer(seed=1_000_003, spp=64, params={"red.reflectance.value": value})

    _, derivative = torch.func.jvp(picture, (red.detach(),), (torch.ones_like(red),))
    save_signed(derivative, folder, "derivative_red_wall")
    save_curves(curves, folder / "loss.png", "Cornell box: 15 albedos from one picture")

    errors = {}
    for name, (surface, title) in zip(names, SURFACES.items(), strict=True):
        found, true = scene.get_parameter(name).detach(), truth[name]
        errors[surface] = float((found - true).abs().max())
        values = "  ".join(f"{f:.4f} ({t:.4f})" for f, t in zip(found.tolist(), true.tolist(), strict=True))
        print(f"{title:>22}: {values}   largest error {errors[surface]:.4f}")
    print(f"albedos found (true); largest error of all: {max(errors.values()):.4f}")
    return errors


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="fewer iterations, a noisier target: well under a minute")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser")
    parser.add_argument("--spp", type=at_least_one, default=16, help="samples a pixel and iteration (default 16)")
    parser.add_argument("--resolution", type=at_least_one, default=256, help="pixels along a side (default 256)")
    parser.add_argument("--output", type=Path, default=Path("output/cornell_box"), help="folder for the pictures")
    options = parser.parse_args(argv)
    iterations = options.iterations or (60 if options.demo else 150)
    start = time.perf_counter()
    run(
        options.output,
        resolution=options.resolution,
        spp=options.spp,
        iterations=iterations,
        target_spp=256 if options.demo else 512,
    )
    print(f"pictures are in {options.output}; {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
