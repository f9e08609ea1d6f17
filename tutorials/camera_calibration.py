"""Calibrate a camera from one photograph of a known valley: pose, field of view and principal point.

    python tutorials/camera_calibration.py            # full run
    python tutorials/camera_calibration.py --demo     # the same, smaller

The photograph is an 8-bit PNG file with noise, made by the renderer from a camera that we then forget. What we know is
the valley (its ground, its colours, the sun), and roughly where we stood. Nine numbers are unknown: three of
rotation, three of position, the horizontal field of view, and the principal point.

Few unknowns and many pixels: this is a case for forward mode. One derivative image for each unknown makes the Jacobian,
and Gauss-Newton takes steps that gradient descent would need hundreds for, since a turn to the left and a principal
point to the right look almost the same. The Jacobian also says how well the photograph determines each number.

Nothing sharp moves in these pictures: the valley fills the view, and no slope hides another from the camera or the sun.
So the derivative inside of surfaces is the whole derivative, and outlines need not be looked for (`visibility=False`).
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path

import torch
from command_line import at_least_one
from pictures import save, save_curves, save_signed

import torchrender as tr

# The camera that took the photograph, and what we believe at the start: lengths, degrees, fractions of the film.
TRUE = {
    "origin": (0.3, 3.2, 3.0),
    "target": (0.1, 0.6, -1.0),
    "up": (0.05, 1.0, 0.0),
    "fov": 62.0,
    "principal_point": (0.03, -0.02),
}
GUESS = {
    "origin": (0.0, 3.5, 3.3),
    "target": (0.0, 0.6, -1.0),
    "up": (0.0, 1.0, 0.0),
    "fov": 66.0,
    "principal_point": (0.0, 0.0),
}
ASPECT = 4 / 3  # width / height of the photograph


def clouds(size: int, finest: float, seed: int) -> torch.Tensor:
    """Random waves, (size, size), periodic, mean 0, variance 1: strong long ones, hardly any beyond `finest` waves."""
    noise = torch.randn(size, size, generator=torch.Generator().manual_seed(seed))
    frequency = torch.fft.fftfreq(size, 1 / size)
    radius = torch.hypot(frequency[:, None], frequency[None, :]).clamp(min=1.0)
    strength = radius**-1.2 * torch.exp(-((radius / finest) ** 2))
    waves = torch.fft.ifft2(torch.fft.fft2(noise) * strength).real
    return (waves - waves.mean()) / waves.std()


def landscape(texels: int = 256, cells: int = 96) -> dict:
    """A valley of 14 x 14 units with fields, woods and bare rock, as the dict of a mesh with a texture.

    Its ground is curved upwards everywhere: the straight line between two points above it never goes below.
    """
    side = torch.linspace(0, 1, cells + 1)
    v, u = torch.meshgrid(side, side, indexing="ij")
    x, z = 14 * (u - 0.5), 14 * (0.5 - v)
    y = 0.13 * (x.square() + z.square()) + 0.2 * torch.sin(0.9 * x + 0.5) * torch.sin(0.8 * z + 1.5)
    vertices = torch.stack([x, y, z], dim=-1).reshape(-1, 3)
    first = (torch.arange(cells)[:, None] * (cells + 1) + torch.arange(cells)).reshape(-1)
    corner = torch.stack([first, first + 1, first + cells + 2, first + cells + 1], dim=1)
    faces = torch.cat([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]])

    wood = torch.sigmoid(4 * (clouds(texels, 36, seed=1) - 0.3))[..., None]
    field = torch.sigmoid(3 * clouds(texels, 40, seed=2))[..., None]
    rock = torch.sigmoid(4 * (clouds(texels, 36, seed=3) - 1.0))[..., None]
    colours = torch.tensor([[0.04, 0.13, 0.03], [0.22, 0.36, 0.08], [0.72, 0.58, 0.25], [0.62, 0.60, 0.58]])
    colour = colours[1] * field + colours[2] * (1 - field)
    colour = colour * (1 - wood) + colours[0] * wood
    colour = colour * (1 - rock) + colours[3] * rock
    return {
        "type": "mesh",
        "vertices": vertices,
        "faces": faces,
        # Smooth normals, so that the shade does not jump from face to face.
        "vertex_normals": tr.Mesh(vertices, faces).normals_from_positions(vertices),
        "vertex_texcoords": torch.stack([u, v], dim=-1).reshape(-1, 2),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "data": colour, "raw": True}},
    }


def make_camera(numbers: dict, height: int) -> tr.PerspectiveCamera:
    """The camera of `TRUE` or `GUESS` with a film of `height` rows. A box filter: a pixel sees its own square only."""
    x, y = numbers["principal_point"]
    return tr.PerspectiveCamera.look_at(
        numbers["origin"],
        numbers["target"],
        numbers["up"],
        fov=numbers["fov"],
        size=(height, round(ASPECT * height)),
        filter="box",
        principal_point_offset_x=x,
        principal_point_offset_y=y,
    ).float()


def make_scene() -> tr.Scene:
    """The valley under a sun that stands high, and no camera yet."""
    return tr.load_dict(
        {
            "type": "scene",
            "land": landscape(),
            "sun": {"type": "point", "position": [-5.0, 16.0, 1.0], "intensity": 900.0},
        }
    )


def camera_parameters(unknown: torch.Tensor, guess: tr.PerspectiveCamera) -> dict[str, torch.Tensor]:
    """What the nine unknowns make of the camera that we started from, by the names of its parameters.

    `unknown`: a turn about the camera's axes (3, radians), a step along them (3), the change of the field of view
    (radians), and that of the principal point (2, fractions of the film). All of them are of the order of 0.1.
    """
    step = torch.cat([tr.rotation.so3_exp(unknown[:3]), unknown[3:6, None]], dim=1)
    step = torch.cat([step, torch.tensor([[0.0, 0.0, 0.0, 1.0]])])
    return {
        "photo.to_world": guess.to_world.detach() @ step,
        "photo.x_fov": guess.x_fov.detach() + torch.rad2deg(unknown[6]),
        "photo.principal_point_offset_x": guess.principal_point_offset_x.detach() + unknown[7],
        "photo.principal_point_offset_y": guess.principal_point_offset_y.detach() + unknown[8],
    }


def linearise(
    picture: Callable[[torch.Tensor], torch.Tensor], unknown: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """The picture (H, W, 3), and its Jacobian (H, W, 3, 9) from one forward-mode derivative for each unknown."""
    columns = [torch.func.jvp(picture, (unknown,), (direction,)) for direction in torch.eye(len(unknown))]
    return columns[0][0], torch.stack([derivative for _, derivative in columns], dim=-1)


def readable(parameters: dict[str, torch.Tensor], height: int) -> dict[str, list[float]]:
    """A camera in numbers for people: rotation vector (degrees), position, field of view, principal point (pixels)."""
    matrix = parameters["photo.to_world"].double()
    x, y = (parameters[f"photo.principal_point_offset_{axis}"] for axis in "xy")
    return {
        "rotation (deg)": torch.rad2deg(tr.rotation.so3_log(matrix[:3, :3])).tolist(),
        "position": matrix[:3, 3].tolist(),
        "field of view (deg)": [float(parameters["photo.x_fov"])],
        "principal point (px)": [float(0.5 - x) * round(ASPECT * height), float(0.5 - y) * height],
    }


def errors(parameters: dict[str, torch.Tensor], true: tr.PerspectiveCamera, height: int) -> dict[str, float]:
    """How far a camera is from the true one, in the units of `readable`."""
    found, wanted = readable(parameters, height), readable(camera_parameters(torch.zeros(9), true), height)
    between = parameters["photo.to_world"][:3, :3].double() @ true.to_world.detach()[:3, :3].double().T
    distance = {name: math.dist(found[name], wanted[name]) for name in found}
    distance["rotation (deg)"] = math.degrees(float(torch.linalg.vector_norm(tr.rotation.so3_log(between))))
    return distance


def run(
    folder: Path,
    *,
    height: int = 144,
    spp: int = 8,
    steps: tuple[int, ...] = (6, 6, 8),
    noise: float = 0.02,
) -> dict[str, float]:
    """The whole program; returns the errors of the camera at the end, see `errors`.

    Args:
        folder: where the pictures go.
        height: rows of the photograph, divisible by 3 * 2 ** (len(steps) - 1): every resolution has whole pixels.
        spp: samples a pixel of the pictures; two of them make a step.
        steps: of Gauss-Newton at each resolution, from coarse to fine, each twice as fine as the one before. Coarse
            pictures are blurred, so that a step finds its way from further off.
        noise: standard deviation of the photograph's noise, relative to each pixel's light.
    """
    if height % (3 * 2 ** (len(steps) - 1)):
        raise ValueError(f"height: expected a multiple of {3 * 2 ** (len(steps) - 1)}, got {height}")
    folder.mkdir(parents=True, exist_ok=True)
    scene = make_scene()
    # Direct light only: what the slopes send each other would end at the rim of the valley, an edge.
    renderer = tr.Renderer(scene, integrator=tr.DirectIllumination(), spp=spp, spp_grad=spp, visibility=False)
    true = make_camera(TRUE, height)

    # Taking the photograph: noise and 8 bits, into a file and back. Writing encodes the sRGB curve, reading decodes it.
    with torch.no_grad():
        scene["photo"] = true
        light = renderer(seed=1_000_000, spp=256)
        light = light * (1 + noise * torch.randn(light.shape, generator=torch.Generator().manual_seed(0)))
        tr.io.write_image(folder / "photograph.png", light)
    photograph = tr.io.read_image(folder / "photograph.png")

    unknown = torch.zeros(9)
    guess = make_camera(GUESS, height)
    before = errors(camera_parameters(unknown, guess), true, height)
    curves: dict[str, list[float]] = {name: [] for name in before}
    settled: list[torch.Tensor] = []  # of the last resolution

    bar = tr.progress(total=sum(steps), desc="camera")
    for level, count in enumerate(steps):
        shrink = 2 ** (len(steps) - 1 - level)
        # A pixel of a coarse film with a box filter is the mean of the fine film's pixels that it covers.
        target = torch.nn.functional.avg_pool2d(photograph.movedim(-1, 0), shrink).movedim(0, -1)
        scene["photo"] = make_camera(GUESS, height // shrink)
        for step in range(count):
            halves = []
            for seed in (2 * (1000 * level + step), 2 * (1000 * level + step) + 1):

                def picture(unknown: torch.Tensor, seed: int = seed) -> torch.Tensor:
                    return renderer(seed=seed, params=camera_parameters(unknown, guess))

                image, jacobian = linearise(picture, unknown)
                halves.append((jacobian.reshape(-1, 9).double(), (target - image).reshape(-1).double()))
            if level == 0 and step == 0:
                save(image, folder, "start")
            # The square of a noisy Jacobian is too large on average, and steps that divide by it too short. The product
            # of two independent ones is right on average.
            (first, first_residual), (second, second_residual) = halves
            normal = (first.T @ second + second.T @ first) / 2
            right = (first.T @ second_residual + second.T @ first_residual) / 2
            # A little damping, relative to each unknown (Levenberg, Marquardt), keeps the first steps short.
            damping = (0.02 if level == 0 else 0.0) * torch.diag(normal.diagonal())
            change = torch.linalg.solve(normal + damping, right).float()
            unknown = unknown + change * (0.2 / torch.linalg.vector_norm(change)).clamp(max=1.0)
            loss = float((first_residual * second_residual).mean())  # without the renderer's noise
            for name, value in errors(camera_parameters(unknown, guess), true, height).items():
                curves[name].append(value)
            if level == len(steps) - 1 and step >= count // 2:
                settled.append(unknown)
            bar.update()
            bar.set_postfix(loss=f"{loss:.3g}", rotation=f"{curves['rotation (deg)'][-1]:.3f}")
    bar.close()

    # Every step carries the noise of its own picture: the mean of the last ones has less of it.
    unknown = torch.stack(settled).mean(0)
    found = camera_parameters(unknown, guess)
    after = errors(found, true, height)
    # The photograph's noise, which `loss` is the variance of, makes the unknowns uncertain (standard deviations).
    uncertain = (torch.linalg.inv(normal).diagonal() * loss).clamp(min=0).sqrt()

    with torch.no_grad():
        result = renderer(seed=1_000_001, spp=64, params=found)
    save(photograph, folder, "target")
    save(result, folder, "result")
    for name, column in {"turn": 1, "step": 3, "field_of_view": 6, "principal_point": 7}.items():
        save_signed(jacobian[..., column], folder, f"derivative_{name}")
    save_curves(curves, folder / "loss.png", "Camera: distance from the truth")

    found_numbers, true_numbers = readable(found, height), readable(camera_parameters(torch.zeros(9), true), height)
    print(f"{'':>22}{'found':>28}{'true':>28}{'error':>10}{'at the start':>14}")
    for name, error in after.items():
        texts = [" ".join(f"{x:8.4f}" for x in numbers[name]) for numbers in (found_numbers, true_numbers)]
        print(f"{name:>22}{texts[0]:>28}{texts[1]:>28}{error:10.4f}{before[name]:14.4f}")
    print(
        "standard deviations that the photograph allows: "
        f"turn {math.degrees(float(uncertain[:3].max())):.4f} degrees, position {float(uncertain[3:6].max()):.5f}, "
        f"field of view {math.degrees(float(uncertain[6])):.4f} degrees"
    )
    return after


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="a smaller photograph: well under a minute")
    parser.add_argument("--height", type=at_least_one, help="rows of the photograph, a multiple of 12")
    parser.add_argument("--spp", type=at_least_one, default=8, help="samples a pixel and picture (default 8)")
    parser.add_argument("--output", type=Path, default=Path("output/camera_calibration"), help="folder of the pictures")
    options = parser.parse_args(argv)
    start = time.perf_counter()
    run(options.output, height=options.height or (72 if options.demo else 144), spp=options.spp)
    print(f"pictures are in {options.output}; {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
