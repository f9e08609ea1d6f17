"""Design an achromatic doublet: three radii of crown and flint, sharp for three colours at once.

    python tutorials/achromat.py
    python tutorials/achromat.py --crown N-BAK4 --flint SF10

A lens of one glass bends blue light more than red, which therefore meets at different distances. Two lenses that are
cemented to each other, one of crown, one of flint, can undo that: thin ones of powers P1 and P2 do if

    P1 + P2 = P,   P1 / V1 + P2 / V2 = 0,

with Abbe's numbers V1, V2. That leaves the shape open, thickness out, and spherical aberration, which blurs light of
one colour, too. So these radii, with equal sides of the crown, are where the search for better ones begins.

What counts is the mean square of how far light lands from the axis of a screen, in three bands of 4 nm around the
lines F, d and C. Light is traced from the lamp (`tr.ParticleTracer`) through the three surfaces, height fields that
PyTorch makes of three curvatures, to an irradiancemeter with three bands. Derivatives come through the chain of
refractions, with each band's index. The thin achromat has no colours, either, but its focus elsewhere; a thick one that
is as sharp on the screen is found in a few steps. The samples are the same in all steps, so that L-BFGS can search
lines. A single lens of crown gets the same treatment for its two curvatures.
"""

from __future__ import annotations

import argparse
import math
import warnings
from pathlib import Path
from typing import Any

import torch
from command_line import at_least_one, given, reported
from pictures import save_curves

import torchrender as tr
from torchrender.spectrum.indices import BLUE, RED, YELLOW

LINES = {"F": BLUE, "d": YELLOW, "C": RED}
FOCUS = 8.0  # distance of the screen from the lens's front; also the focal length of the first guess
THICKNESS = (0.25, 0.15)  # of crown and flint, on the axis
STOP = 0.8  # radius of the beam
SCREEN = 0.03  # half the side of what the meter sees
SIZE = 64  # heights along a side of a surface, which reaches from -1 to 1
SURFACES = ("first", "second", "third")


def index_and_number(name: str) -> tuple[float, float]:
    """n_d and Abbe's number of a glass."""
    table = tr.spectrum.glass(name)
    at = YELLOW - 360
    return float(torch.lerp(table[int(at)], table[int(at) + 1], at % 1)), float(tr.spectrum.abbe_number(table))


def thin(crown: str, flint: str) -> torch.Tensor:
    """(3,): curvatures of the thin achromat whose crown has equal sides."""
    (n1, v1), (n2, v2) = index_and_number(crown), index_and_number(flint)
    power1, power2 = v1 / (v1 - v2) / FOCUS, v2 / (v2 - v1) / FOCUS
    first = power1 / (n1 - 1) / 2
    return torch.tensor([first, -first, -first - power2 / (n2 - 1)])


def heights(curvature: torch.Tensor) -> torch.Tensor:
    """(SIZE, SIZE) of a sphere over the square, from its vertex along z."""
    axis = (torch.arange(SIZE) + 0.5) / SIZE * 2 - 1
    square = axis[:, None] ** 2 + axis**2
    return curvature * square / (1 + torch.sqrt(1 - curvature**2 * square))


class Lens:
    """Lamp, surfaces and screen: what a lens of given curvatures throws on it."""

    def __init__(self, glasses: tuple[str, ...], resolution: int, spp: int) -> None:
        """Two glasses are a doublet, one is a single lens."""
        self.count, self.spp = len(glasses) + 1, spp
        places = [0.0, *THICKNESS[:-1], sum(THICKNESS)][-self.count :]
        places[0] = 0.0
        media: list[Any] = [1.0, *({"type": "glass", "name": name} for name in glasses), 1.0]
        surfaces = {
            SURFACES[i]: {
                "type": "heightfield",
                "heights": torch.zeros(SIZE, SIZE),
                "flip_normals": True,  # what is behind a surface comes after it
                "to_world": tr.Transform.translate([0, 0, places[i]]),
                "bsdf": {"type": "dielectric", "ext_ior": media[i], "int_ior": media[i + 1]},
            }
            for i in range(self.count)
        }
        bands = {
            name: {"type": "regular", "wavelength_min": at - 2, "wavelength_max": at + 2, "values": [1, 1]}
            for name, at in LINES.items()
        }
        film = {"type": "specfilm", "width": resolution, "height": resolution, "rfilter": {"type": "gaussian"}}
        self.scene = tr.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "ptracer", "max_depth": 6},
                **surfaces,
                "lamp": {
                    "type": "disk",
                    "to_world": tr.Transform.translate([0, 0, -1]).scale([STOP, STOP, 1]),
                    "bsdf": {"type": "diffuse", "reflectance": 0.0},
                    "emitter": {"type": "directionalarea", "radiance": 1.0},
                },
                "screen": {
                    "type": "rectangle",
                    "to_world": self.place(FOCUS),
                    "bsdf": {"type": "diffuse", "reflectance": 0.0},
                    "meter": {"type": "irradiancemeter", "film": {**film, **bands}},
                },
            },
            variant="spectral",
        )

    @staticmethod
    def place(distance: float) -> torch.Tensor:
        """The screen's matrix."""
        return tr.Transform.translate([0, 0, distance]).rotate([0, 1, 0], 180).scale([SCREEN, SCREEN, 1]).matrix

    def image(self, curvatures: torch.Tensor, distance: float = FOCUS, **settings: Any) -> torch.Tensor:
        """(H, W, 3): irradiance of the screen in three bands."""
        params = {f"{name}.heights": heights(c) for name, c in zip(SURFACES, curvatures, strict=False)}
        if distance != FOCUS:
            params["screen.to_world"] = self.place(distance)
        return tr.render(self.scene, spp=self.spp, seed=0, params=params, **settings)

    def squares(self, curvatures: torch.Tensor, distance: float = FOCUS, **settings: Any) -> torch.Tensor:
        """(3,): mean squared distances of light from the axis, by band."""
        image = self.image(curvatures, distance, **settings)
        axis = ((torch.arange(len(image)) + 0.5) / len(image) * 2 - 1) * SCREEN
        away = axis[:, None] ** 2 + axis**2
        filtered = (2 * SCREEN / len(image)) ** 2 / 2  # what the filter, of half a pixel, adds in both directions
        return (image * away[..., None]).sum((0, 1)) / image.sum((0, 1)) - filtered


def optimise(lens: Lens, start: torch.Tensor, iterations: int, name: str) -> tuple[torch.Tensor, list[float]]:
    """L-BFGS over the curvatures; those found, and the radius of the spots after every step."""
    scale = 0.02  # of what changes
    moved = torch.zeros_like(start).requires_grad_()
    optimiser = torch.optim.LBFGS([moved], max_iter=4, history_size=10, line_search_fn="strong_wolfe")
    curve: list[float] = []

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        loss = torch.log(lens.squares(start + scale * moved, correlated=True).mean().clamp(min=1e-10))
        loss.backward()
        return loss

    bar = tr.progress(range(iterations), desc=name)
    for _ in bar:
        curve.append(math.exp(optimiser.step(closure).item() / 2))
        bar.set_postfix(radius=f"{curve[-1]:.3g}")
    return (start + scale * moved).detach(), curve


def save_focus(lines: dict[str, torch.Tensor], distances: torch.Tensor, path: Path) -> None:
    """Draw the radius of spots (n, 3) over the distance of the screen (n,), a panel for each lens."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(lines), figsize=(4 * len(lines), 3.4), layout="constrained", sharey=True)
    for axis, (name, radii) in zip(axes, lines.items(), strict=True):
        for values, line, colour in zip(radii.T, LINES, ("tab:blue", "tab:olive", "tab:red"), strict=True):
            axis.plot(distances, values, label=line, color=colour)
        axis.set(title=name, xlabel="distance of the screen", ylim=(0, None))
        axis.grid(True, alpha=0.3)
    axes[0].set_ylabel("radius of the spot (rms)")
    axes[0].legend()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def save_spots(images: dict[str, torch.Tensor], path: Path) -> None:
    """Draw spots (H, W, 3), the three bands as blue, green and red, each exposed for itself."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(images), figsize=(3 * len(images), 3.2), layout="constrained")
    for axis, (name, image) in zip(axes, images.items(), strict=True):
        axis.imshow(tr.tonemap(image.flip(-1) / image.quantile(0.999)).clamp(0, 1), interpolation="nearest")
        axis.set(xticks=[], yticks=[], title=name)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def run(
    folder: Path,
    *,
    crown: str = "N-BK7",
    flint: str = "F2",
    resolution: int = 48,
    spp: int = 8,
    iterations: int = 4,
    points: int = 9,
) -> dict[str, float]:
    """The whole program; returns the radius of the spots (rms over three bands) of four lenses, by their names.

    Args:
        folder: where pictures go.
        crown, flint: names of glasses; the crown's Abbe number is larger.
        resolution: pixels of the meter along either side.
        spp: light paths a pixel.
        iterations: times four steps of L-BFGS.
        points: distances of the screen in the picture of foci.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (n1, v1), (_, v2) = index_and_number(crown), index_and_number(flint)
    if v1 < v2 + 5:
        raise ValueError(
            f"crown: expected a glass with a larger Abbe number than {flint} ({v2:.1f}), got {crown} ({v1:.1f})"
        )
    # The warning is of the edges of the beam, which passes through the lens whole.
    warnings.filterwarnings("ignore", category=tr.MissingTermWarning)
    single, doublet = Lens((crown,), resolution, spp), Lens((crown, flint), resolution, spp)
    bent = 1 / FOCUS / (n1 - 1) / 2
    lenses = {"thin single lens": (single, torch.tensor([bent, -bent])), "thin achromat": (doublet, thin(crown, flint))}
    curves = {}
    for name, lens in (("single lens", single), ("achromat", doublet)):
        found, curves[name] = optimise(lens, lenses[f"thin {name}"][1], iterations, name)
        lenses[name] = lens, found
    save_curves(curves, folder / "loss.png", "Radius of the spots (rms)")

    result, images, foci = {}, {}, {}
    distances = FOCUS + torch.linspace(-0.2, 0.2, points)
    with torch.no_grad():
        for name, (lens, curvatures) in tr.progress(lenses.items(), desc="foci"):
            images[name] = lens.image(curvatures)
            squares = lens.squares(curvatures).clamp(min=0)
            result[name] = float(squares.mean().sqrt())
            bands = ", ".join(f"{line} {value:.5f}" for line, value in zip(LINES, squares.sqrt().tolist(), strict=True))
            print(f"{name}: radius {result[name]:.5f} ({bands})")
            print(f"  curvatures {', '.join(f'{c:.4f}' for c in curvatures.tolist())}")
            if points and name != "thin single lens":
                radii = [lens.squares(curvatures, d).clamp(min=0).sqrt() for d in distances.tolist()]
                foci[name] = torch.stack(radii)
    save_spots(images, folder / "spots.png")
    if foci:
        save_focus(foci, distances, folder / "focus.png")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--crown", help="glass of the first lens (default N-BK7)")
    parser.add_argument("--flint", help="glass of the second lens (default F2)")
    parser.add_argument("--iterations", type=at_least_one, help="times four steps of L-BFGS (default 4)")
    parser.add_argument("--output", type=Path, default=Path("output/achromat"), help="folder for the results")
    options = parser.parse_args(argv)
    with reported(parser, "results", options.output):
        run(options.output, **given(options, "crown", "flint", "iterations"))


if __name__ == "__main__":
    main()
