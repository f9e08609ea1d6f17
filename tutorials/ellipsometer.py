"""Measure index and absorption of a metal with an ellipsometer whose parts are not quite where their labels say.

    python tutorials/ellipsometer.py
    python tutorials/ellipsometer.py --material Al --wavelength 546.1

Light of one wavelength passes a polariser at 45 degrees, is reflected off a metal, and comes to a camera through a wave
plate and an analyser. Reflection weakens the light across the plane of incidence by |r_s|, that in it by |r_p|, and
shifts one against the other: their ratio r_p / r_s = tan(psi) exp(i Delta) tells the index n and the absorption k. A
camera sees intensities alone. So each of its pixels looks through a wave plate of another angle: all pixels together
see how much light there is of every polarisation. Three pictures are taken, at three angles of incidence.

The arms of the instrument are a scene, plates and all, and nothing but that is fitted to the pictures: derivatives by
the metal go through the same paths as those by the analyser's angle or the plate's retardance. So what is not known of
the instrument is found with the metal: how bright the lamp is, where the analyser and the wave plate have their zeros,
and how much the plate retards. Six unknowns are a case for forward mode and for steps of Levenberg and Marquardt.

The same fit that trusts the labels, with the metal and the lamp as its unknowns, finds an n of gold that is 16 % off,
the calibrated one 2 %. What the noise of the pictures allows (standard deviations) stands beside what is found.
"""

from __future__ import annotations

import argparse
import cmath
import math
from pathlib import Path

import torch
from command_line import at_least_one, given, reported
from pictures import save_curves

import torchrender as tr

T = tr.Transform
ANGLES = (65.0, 72.0, 79.0)  # of incidence, degrees
PIXELS = 24  # of a picture, each behind a wave plate of its own angle
NAMES = ("n", "k", "lamp", "analyser", "wave plate", "retardance")
TRUE = torch.tensor([0.8, -3.0, 2.0, 95.0], dtype=torch.float64)  # lamp; degrees: two zeros, and the retardance
LABELS = torch.tensor([1.0, 0.0, 0.0, 90.0], dtype=torch.float64)  # of the same
FITS = {"calibrated": 6, "by the labels": 3}  # how many of the unknowns are looked for
WIDTH = 0.1  # of what the camera sees, its half


def towards(angle: float) -> list[float]:
    """From +z by an angle in degrees towards +y."""
    return [0.0, math.sin(math.radians(angle)), math.cos(math.radians(angle))]


def square(angle: float, distance: float, half: float, **more: object) -> dict:
    """A square in the direction of that angle, which faces the middle of the sample; its horizontal is along x."""
    place = [distance * x for x in towards(angle)]
    return {"type": "rectangle", "to_world": T.look_at(place, [0, 0, 0], towards(angle + 90)) @ T.scale(half), **more}


def instrument(angle: float, material: str, wavelength: float) -> tr.Scene:
    """Both arms and the sample, seen along parallel rays: the pixels of a picture differ by their wave plates alone."""
    film = {"type": "hdrfilm", "width": PIXELS, "height": 1, "rfilter": {"type": "box"}}
    view = T.look_at([2 * x for x in towards(-angle)], [0, 0, 0], towards(90 - angle)) @ T.scale(WIDTH)
    turned = {"type": "bitmap", "data": turns()[None, :, None], "raw": True, "filter_type": "nearest"}
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 6, "rr_depth": 100},
            "camera": {"type": "orthographic", "to_world": view, "near_clip": 1e-3, "film": film},
            "analyser": square(-angle, 1.8, 1, bsdf={"type": "polarizer"}),
            "wave": square(-angle, 1.6, WIDTH, bsdf={"type": "retarder", "theta": turned}),
            "sample": {
                "type": "rectangle",
                "to_world": T.scale(9),
                "bsdf": {"type": "conductor", "material": material},
            },
            "polariser": square(angle, 1.5, 1, bsdf={"type": "polarizer", "theta": 45.0}),
            "lamp": square(angle, 2, 1, emitter={"type": "area", "radiance": 1.0}),
        },
        variant="mono_polarized",
        wavelength=wavelength,
        dtype=torch.float64,
    )


def turns() -> torch.Tensor:
    """(PIXELS,) angles of the wave plates in degrees, over half a turn."""
    return torch.arange(PIXELS, dtype=torch.float64) / PIXELS * 180


def pictures(scenes: list[tr.Scene], unknown: torch.Tensor) -> torch.Tensor:
    """(angles, PIXELS) intensities, of which one sample a pixel knows all: no path has a choice."""
    n, k, lamp, analyser, wave, retardance = unknown
    params = {
        "sample.bsdf.eta.value": n[None],
        "sample.bsdf.k.value": k[None],
        "lamp.emitter.radiance.value": lamp[None],
        "analyser.bsdf.theta.value": analyser[None],
        "wave.bsdf.theta.data": (turns() + wave)[None, :, None],
        "wave.bsdf.delta.value": retardance[None],
    }
    # (plates face the sample: the camera sees them from behind)
    return torch.stack([tr.render(scene, spp=1, params=params)[0, :, 0].flip(0) for scene in scenes])


def fit(
    scenes: list[tr.Scene], measured: torch.Tensor, start: torch.Tensor, count: int, iterations: int, noise: float
) -> tuple[list[torch.Tensor], list[float], torch.Tensor]:
    """All estimates of the first `count` unknowns, their chi-squares, and the standard deviations that noise leaves.

    n, k and the lamp are positive: steps are of their logarithms.
    """

    def unknown(x: torch.Tensor) -> torch.Tensor:
        return torch.cat([torch.cat([x[:3].exp(), x[3:]]), start[count:]])

    def residual(x: torch.Tensor) -> torch.Tensor:
        return ((pictures(scenes, unknown(x)) - measured) / noise).flatten()

    x = torch.cat([start[:3].log(), start[3:count]])
    damping, found = 1e-2, [unknown(x)]
    with torch.no_grad():
        chi2 = [float(residual(x).square().sum())]
    for _ in range(iterations):
        columns = [torch.func.jvp(residual, (x,), (unit,)) for unit in torch.eye(count, dtype=x.dtype)]
        r, jacobian = columns[0][0], torch.stack([column for _, column in columns], 1)
        normal = jacobian.T @ jacobian
        step = torch.linalg.solve(normal + damping * torch.diag(normal.diagonal()), -jacobian.T @ r)
        with torch.no_grad():
            tried = float(residual(x + step).square().sum())
        if tried < chi2[-1]:
            x, damping = x + step, damping / 5
        else:
            tried, damping = chi2[-1], damping * 5
        found.append(unknown(x))
        chi2.append(tried)
    slopes = torch.cat([x[:3].exp(), torch.ones_like(x[3:])])
    return found, chi2, torch.linalg.inv(normal).diagonal().sqrt() * slopes


def psi_and_delta(n: float, k: float, angle: float) -> tuple[float, float]:
    """Ellipsometric angles in degrees, with Verdet's signs (Muller, Surface Science 16, 1969)."""
    c, s2, index2 = math.cos(math.radians(angle)), math.sin(math.radians(angle)) ** 2, complex(n, -k) ** 2
    q = cmath.sqrt(index2 - s2)
    ratio = (index2 * c - q) / (index2 * c + q) * (c + q) / (c - q)
    return math.degrees(math.atan(abs(ratio))), math.degrees(cmath.phase(ratio)) % 360


def save_fit(measured: torch.Tensor, fitted: dict[str, torch.Tensor], path: Path) -> None:
    """Draw what the pixels saw, and what each fit says that they see."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(ANGLES), figsize=(11, 3.4), layout="constrained", sharey=True)
    for i, (axis, angle) in enumerate(zip(axes, ANGLES, strict=True)):
        axis.plot(turns(), measured[i], "o", color="black", markersize=4, label="measured")
        for (name, values), style in zip(fitted.items(), ("-", "--"), strict=True):
            axis.plot(turns(), values[i], style, label=name)
        axis.set(title=f"{angle:g} degrees", xlabel="angle of the wave plate, degrees")
    axes[0].set_ylabel("intensity")
    axes[0].legend()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def run(
    folder: Path, *, material: str = "Au", wavelength: float = 632.8, iterations: int = 15, noise: float = 5e-4
) -> dict[str, dict[str, float]]:
    """The whole program; returns the relative errors of n and k of both fits.

    Args:
        folder: where diagrams go.
        material: a metal's name.
        wavelength: of the lamp, nm.
        iterations: steps of each fit.
        noise: standard deviation of a pixel, relative to the lamp of the labels.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scenes = [instrument(angle, material, wavelength) for angle in ANGLES]
    metal = scenes[0].sample.bsdf
    true = torch.cat([metal.eta.value.detach().mean()[None], metal.k.value.detach().mean()[None], TRUE])
    chance = torch.Generator().manual_seed(0)
    with torch.no_grad():
        clean = pictures(scenes, true)
    measured = clean + noise * torch.randn(clean.shape, generator=chance, dtype=clean.dtype)

    start = torch.cat([torch.tensor([1.0, 3.0], dtype=torch.float64), LABELS])
    result, curves, fitted = {}, {}, {}
    print(f"{'':>16}{'':>12}" + "".join(f"{name:>12}" for name in NAMES))
    print(f"{'true':>28}" + "".join(f"{value:12.4f}" for value in true.tolist()))
    for name, count in FITS.items():
        found, chi2, deviations = fit(scenes, measured, start, count, iterations, noise)
        errors = [(x[:2] / true[:2] - 1).abs().tolist() for x in found]
        curves[name] = [max(e) for e in errors]
        result[name] = dict(zip(NAMES, errors[-1], strict=False))
        with torch.no_grad():
            fitted[name] = pictures(scenes, found[-1])
        print(f"{name:>16}{'found':>12}" + "".join(f"{value:12.4f}" for value in found[-1].tolist()))
        print(f"{'noise leaves':>28}" + "".join(f"{value:12.4f}" for value in deviations.tolist()))
        misfit = math.sqrt(chi2[-1] / measured.numel())
        print(f"{'relative error':>28}" + "".join(f"{100 * e:10.2f} %" for e in errors[-1]), end="")
        print(f"; pixels are off by {misfit:.1f} times their noise")
        psi, delta = psi_and_delta(*found[-1][:2].tolist(), ANGLES[1])
        print(f"{'psi, Delta':>28}{psi:12.3f}{delta:12.3f} degrees at {ANGLES[1]:g}")
    save_curves(curves, folder / "error.png", f"Relative error of n or k of {material}, the larger one")
    save_fit(measured, fitted, folder / "fit.png")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--material", help="a metal, such as Au (the default), Al, Cu, W")
    parser.add_argument("--wavelength", type=float, help="of the lamp, nm (default 632.8)")
    parser.add_argument("--iterations", type=at_least_one, help="steps of each fit (default 15)")
    parser.add_argument("--output", type=Path, default=Path("output/ellipsometer"), help="folder for the results")
    options = parser.parse_args(argv)
    with reported(parser, "diagrams", options.output):
        run(options.output, **given(options, "material", "wavelength", "iterations"))


if __name__ == "__main__":
    main()
