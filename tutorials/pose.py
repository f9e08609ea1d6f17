"""Find where things are: an object from its picture, an object from its shadow alone, a camera from silhouettes.

    python tutorials/pose.py            # where the monkey is, from its picture before a wall
    python tutorials/pose.py shadow     # the same from its shadow on the wall: the monkey itself is not in the picture
    python tutorials/pose.py camera     # where the camera is, from the monkey's mask: inside or outside
    python tutorials/pose.py --demo     # any of them smaller

Unknown are six numbers, three of rotation and three of place; the shape is known, and so are the lights. Most of what
the pictures say about them is in outlines: where the monkey ends before the wall, and where its shadow ends. A
derivative inside of surfaces, alone, knows nothing of that; of a mask and of a shadow it is zero. The renderer's
derivatives contain how outlines move: nothing has to be asked for.

The optimiser is Adam, whose steps become shorter; the mean of its last iterates has less noise than each of them.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import torch
from checkpoints import Checkpoint
from command_line import at_least_one, given, reported
from mesh_from_pictures import monkey
from pictures import save, save_curves, save_signed

import torchrender as tr

# Rotation vector in radians (0.25 long) and translation: what is to be found. The search begins at zero.
TRUE = (0.11, -0.20, 0.10, 0.15, -0.10, 0.20)
WALL = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.7}}
CLAY = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": [0.7, 0.4, 0.25]}}
PARTS = ("picture", "shadow", "camera")


def make_scene(part: str, resolution: int) -> tr.Scene:
    """The monkey at its first guess, lights, and the camera of one of the `PARTS`."""
    vertices, faces = monkey()
    mesh = tr.Mesh(vertices, faces, bsdf=CLAY)
    mesh.compute_normals()
    scene: dict[str, Any] = {"type": "scene", "object": mesh}
    if part == "shadow":
        # The camera stands between object and wall and has the object behind it.
        scene["wall"] = WALL | {"to_world": tr.Transform.translate([0, 0, -5]) @ tr.Transform.scale(8)}
        scene["lamp"] = {"type": "point", "position": [0.0, 0.0, 8.0], "intensity": 300.0}
        view: dict[str, Any] = {"origin": (0.0, 0.0, -1.5), "target": (0.0, 0.0, -5.0), "fov": 80.0}
    else:
        if part == "picture":
            scene["wall"] = WALL | {"to_world": tr.Transform.translate([0, 0, -2]) @ tr.Transform.scale(6)}
        scene["lamp"] = {"type": "point", "position": [-3.0, 4.0, 6.0], "intensity": 120.0}
        scene["sky"] = {"type": "constant", "radiance": 0.2}
        view = {"origin": (0.0, 0.0, 6.0), "target": (0.0, 0.0, 0.0), "fov": 36.0}
    scene["camera"] = tr.PerspectiveCamera.look_at(**view, size=(resolution, resolution), filter="box")
    return tr.load_dict(scene)


def moved(numbers: torch.Tensor, name: str, still: torch.Tensor) -> dict[str, torch.Tensor]:
    """The parameter `name`, vertices (V, 3) or a camera's matrix, after the motion that six numbers are."""
    turn, shift = tr.rotation.so3_exp(numbers[:3]), numbers[3:]
    if still.shape != (4, 4):
        return {name: still @ turn.T + shift}
    rigid = torch.cat([torch.cat([turn, shift[:, None]], 1), torch.tensor([[0.0, 0.0, 0.0, 1.0]])])
    # About the origin, where the monkey is. A camera that turns where it stands shows nearly what one shows that steps
    # aside, and the way to the answer is a long and narrow valley.
    return {name: rigid @ still}


def errors(numbers: torch.Tensor) -> dict[str, float]:
    """The angle in radians between the rotation and the true one, and the distance from the true place."""
    true = torch.tensor(TRUE)
    between = tr.rotation.so3_exp(numbers[:3].double()).T @ tr.rotation.so3_exp(true[:3].double())
    angle = torch.linalg.vector_norm(tr.rotation.so3_log(between))
    return {"angle": float(angle), "translation": float(torch.linalg.vector_norm(numbers[3:] - true[3:]))}


def run(
    folder: Path,
    *,
    part: str = "picture",
    resolution: int = 128,
    spp: int = 16,
    iterations: int = 150,
    target_spp: int = 1024,
    rate: float = 0.025,
    save_every: int = 25,
    restart: bool = False,
) -> dict[str, float]:
    """The whole program; returns the errors of angle (radians) and translation, and the first of each.

    Args:
        folder: where pictures and the checkpoint go.
        part: one of `PARTS`.
        resolution: pixels along either side of the picture.
        spp: samples a pixel of a step's picture, and of its derivative.
        iterations: steps of the optimiser.
        target_spp: samples a pixel of the given picture.
        rate: learning rate at the start; it falls to zero along a cosine.
        save_every: iterations after which pictures and checkpoint are written.
        restart: begin anew, whatever checkpoint there is.

    Raises:
        ValueError: for another part, or a checkpoint of other settings.
    """
    if part not in PARTS:
        raise ValueError(f"part: expected one of {', '.join(PARTS)}, got {part!r}")
    folder.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {
        "part": part,
        "resolution": resolution,
        "samples": [spp, target_spp],
        "iterations": iterations,
        "rate": rate,
    }
    checkpoint = Checkpoint(folder / "checkpoint.pt", settings, restart)
    state = checkpoint.load()
    scene = make_scene(part, resolution)
    name = "camera.to_world" if part == "camera" else "object.vertex_positions"
    still = scene.get_parameter(name).detach().clone()
    shown = "alpha" if part == "camera" else "rgb"  # of the camera's picture we know the mask only
    # Light that surfaces send each other is left out, of the given picture, too.
    renderer = tr.Renderer(scene, integrator=tr.DirectIllumination(), outputs=(shown,), sampler="sobol")

    def picture(numbers: torch.Tensor, seed: int | torch.Generator, spp: int) -> torch.Tensor:
        (image,) = renderer(seed=seed, spp=spp, params=moved(numbers, name, still))
        return image if image.dim() == 3 else image[..., None].expand(-1, -1, 3)

    with torch.no_grad():
        target = picture(torch.tensor(TRUE), 1_000_000, target_spp)
        save(target, folder, "target")
        save(picture(torch.zeros(6), 1_000_001, 64), folder, "start")

    numbers = torch.nn.Parameter(torch.zeros(6) if state is None else state["numbers"])
    optimiser = torch.optim.Adam([numbers], lr=rate, betas=(0.9, 0.95))
    generator = torch.Generator().manual_seed(0)  # all chance in the loop comes from here
    curves: dict[str, list[float]] = {"loss": [], **{key: [] for key in errors(numbers.detach())}}
    last: list[torch.Tensor] = []  # the last fifth of the iterates
    first = 0
    if state is not None:
        curves, first = checkpoint.restore(state, iterations, optimiser, generator)
        last = state["last"]
    scene.rebuild()

    bar = tr.progress(range(first, iterations), desc=f"pose from {part}", initial=first, total=iterations)
    for iteration in bar:
        for group in optimiser.param_groups:
            group["lr"] = rate * 0.5 * (1 + math.cos(math.pi * iteration / iterations))
        optimiser.zero_grad()
        # Picture and derivative come from independent samples, which makes the gradient of the squared error unbiased.
        image = picture(numbers, generator, spp)
        loss = (image - target).square().mean()
        loss.backward()
        optimiser.step()
        if iteration >= iterations - max(1, iterations // 5):
            last.append(numbers.detach().clone())
        curves["loss"].append(loss.item())
        for key, value in errors(numbers.detach()).items():
            curves[key].append(value)
        bar.set_postfix(loss=f"{loss.item():.3g}", angle=f"{curves['angle'][-1]:.4f}")

        done = iteration + 1
        if done % save_every == 0 or done == iterations:
            save(torch.cat([image.detach(), target], dim=1), folder, "progress")
            save_curves(curves, folder / "loss.png", f"Pose from {part}: distance from the truth")
            checkpoint.save(
                iteration=done,
                numbers=numbers.detach(),
                optimiser=optimiser.state_dict(),
                random=generator.get_state(),
                curves=curves,
                last=last,
            )
            scene.rebuild()  # as in a process that begins here: an interrupted run finds the same bits

    found = torch.stack(last).mean(0)
    with torch.no_grad():
        save(picture(found, 1_000_002, 64), folder, "result")
    # Forward mode: what a turn about the upward axis does to the picture.
    turn = torch.tensor([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    _, derivative = torch.func.jvp(lambda numbers: picture(numbers, 1_000_003, 64), (found,), (turn,))
    save_signed(derivative, folder, "derivative_turn")
    result = errors(found)
    before = errors(torch.zeros(6))
    print(f"{'':>12}{'found':>36}{'true':>36}{'error':>10}{'at the start':>14}")
    for key, rows in {"angle": slice(0, 3), "translation": slice(3, 6)}.items():
        texts = [" ".join(f"{x:9.4f}" for x in values) for values in (found[rows].tolist(), TRUE[rows])]
        print(f"{key:>12}{texts[0]:>36}{texts[1]:>36}{result[key]:10.4f}{before[key]:14.4f}")
    return result | {f"start {key}": value for key, value in before.items()}


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("part", nargs="?", choices=PARTS, default="picture", help="what is given (default picture)")
    parser.add_argument("--demo", action="store_true", help="64 x 64 pixels, fewer steps and samples")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser (default 150)")
    parser.add_argument("--resolution", type=at_least_one, help="pixels along a side (default 128)")
    parser.add_argument("--spp", type=at_least_one, help="samples a pixel and step (default 16)")
    parser.add_argument("--restart", action="store_true", help="begin anew where a checkpoint is found")
    parser.add_argument("--output", type=Path, help="folder for the results (default output/pose_PART)")
    options = parser.parse_args(argv)
    settings: dict[str, Any] = {"part": options.part}
    if options.demo:
        settings |= {"resolution": 64, "spp": 8, "iterations": 80, "target_spp": 256}
    settings |= given(options, "iterations", "resolution", "spp")
    folder = options.output or Path("output") / f"pose_{options.part}"
    with reported(parser, "pictures", folder):
        run(folder, restart=options.restart, **settings)


if __name__ == "__main__":
    main()
