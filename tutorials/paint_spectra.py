"""Recover the reflectances of paints, by wavelength, from photographs of a chart under three lamps.

    python tutorials/paint_spectra.py

A camera sees red, green and blue, three numbers of a spectrum. Two paints that look alike by daylight may differ in
another light; whoever matches paints or prints has to know. Under daylight, standard illuminant A (a bulb) and a white
LED the same camera has nine numbers of each paint, enough for a smooth reflectance of 31 samples to be predicted in a
light that was not photographed, a lamp of narrow lines.

The chart stands beside a red wall and below a lamp that is near: light is uneven, and coloured by what the wall
throws back, in the photographs as in the renderings that they are compared with. The reflectances are tables of
`tr.spectrum.regular`, handed to the scene by `params=`. The loss is the squared error of nine numbers of each paint and
how far its samples are from smooth; gradients come from the renderer. Some ways to change a reflectance are seen a
thousand times as well as others, too many for gradient descent. But the loss is nearly quadratic, and a rendering of a
white chart gives second derivatives that are good enough for Newton's steps. Renderings have noise, so steps are half
as long, and the mean of the last ones counts.

What is compared with: the reflectance that daylight's red, green and blue alone stand for (`tr.spectrum.upsample`).
At the end all pairs of paints are listed that look alike by daylight, but not in the lines' light.

Paints and lamps are made up: sums of bumps and edges that are smooth, and three pairs made to look alike by daylight.
The weight of smoothness was chosen with a view to the error on these paints.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
from typing import Any

import torch
from command_line import at_least_one, given, reported
from pictures import save_curves

import torchrender as tr

ROWS, COLUMNS = 4, 6
PATCHES = ROWS * COLUMNS
SAMPLES, FIRST, LAST = 31, 380.0, 730.0  # of a reflectance, from and to in nm
PIXELS = 10  # along a side of a patch; those at its border do not count
RGB_TO_XYZ = torch.tensor([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
ALIKE, DIFFERENT = 1.5, 4.0  # colour differences of metameric pairs, in one light and in another
LAMP = "lamp.emitter.radiance.value"


def bump(at: float, width: float) -> torch.Tensor:
    """A Gaussian over the wavelengths (471,)."""
    return torch.exp(-(((tr.spectrum.wavelengths(torch.float32) - at) / width) ** 2) / 2)


def edge(at: float, width: float) -> torch.Tensor:
    """From 0 to 1 over the wavelengths (471,), or from 1 to 0 if the width is negative."""
    return torch.sigmoid((tr.spectrum.wavelengths(torch.float32) - at) / width)


def paints() -> torch.Tensor:
    """The true reflectances (PATCHES, 471): greys, colours, mixtures, and three that look like others by daylight."""
    grey = [torch.full((471,), level) for level in (0.04, 0.09, 0.2, 0.36, 0.59, 0.88)]
    colours = [
        0.05 + 0.75 * edge(600, 12),  # red
        0.05 + 0.75 * edge(575, 15),  # orange
        0.06 + 0.75 * edge(515, 14),  # yellow
        0.05 + 0.35 * bump(530, 32),  # green
        0.05 + 0.45 * bump(490, 38),  # turquoise
        0.06 + 0.4 * bump(445, 32),  # blue
        0.06 + 0.3 * bump(430, 28) + 0.4 * edge(660, 15),  # violet
        0.1 + 0.5 * edge(620, 16) + 0.3 * bump(440, 35),  # pink
        0.3 + 0.3 * edge(590, 25),  # skin
    ]
    chance = torch.Generator().manual_seed(7)
    mixtures = []
    for _ in range(6):
        at, width, high = torch.rand(3, 3, generator=chance).unbind(1)
        bumps = [h * 0.4 * bump(400 + 300 * a, 25 + 35 * w) for a, w, h in zip(at, width, high, strict=True)]
        mixtures.append(0.12 + torch.stack(bumps).sum(0))
    bases = [grey[3], colours[8], mixtures[0]]
    return torch.stack([*grey, *colours, *mixtures, *(base + black(base) for base in bases)])


def black(base: torch.Tensor) -> torch.Tensor:
    """What can be added to a reflectance (471,) without a change by daylight, as large as reflectances may be.

    Of bumps 40 nm apart that is what daylight's red, green and blue of it are 0 of.
    """
    bumps = torch.stack([bump(at, 22) for at in range(420, 700, 40)])
    seen = tr.spectrum.to_rgb(bumps, tr.spectrum.d65(bumps))
    unseen = torch.linalg.svd(seen.T)[2][3:]  # of the combinations, those that have no colour
    lines = tr.spectrum.to_rgb(bumps, lamps()["lines"])
    most = torch.linalg.svd(unseen @ lines)[0][:, 0]  # of these, the one that is seen most by the lines' light
    change = most @ unseen @ bumps
    room = torch.minimum((0.95 - base) / change.abs(), (base - 0.02) / change.abs()).min()
    return 0.8 * room * change


def lamps() -> dict[str, torch.Tensor]:
    """Radiances (471,) of four lamps of equal luminance."""
    like = torch.zeros(())
    led = 0.9 * bump(452, 10) + bump(565, 52)
    lines = 0.06 * bump(580, 90) + 0.9 * bump(437, 4) + 0.5 * bump(490, 6) + bump(545, 4) + 1.1 * bump(611, 4)
    found = {"daylight": tr.spectrum.d65(like), "bulb": tr.spectrum.illuminant_a(like), "LED": led, "lines": lines}
    return {name: 130 * table / (RGB_TO_XYZ[1] @ tr.spectrum.to_rgb(table)) for name, table in found.items()}


def name_of(patch: int) -> str:
    return f"paint_{patch}.bsdf.reflectance.value"


def studio() -> tr.Scene:
    """The chart, of squares with sides of 1, a red wall on its right, a lamp on its left, and the camera."""
    x, y = (COLUMNS - 1) / 2, (ROWS - 1) / 2
    squares = {
        f"paint_{k}": {
            "type": "rectangle",
            "to_world": tr.Transform.translate([k % COLUMNS - x, y - k // COLUMNS, 0]).scale(0.5),
            "bsdf": {"type": "diffuse", "reflectance": torch.full((471,), 0.5)},
        }
        for k in range(PATCHES)
    }
    wall = tr.Transform.translate([x + 1.6, 0, 1.5]).rotate([0, 1, 0], -90).scale([1.5, 2, 1])
    lamp = tr.Transform.look_at([-5, 3, 5], [0, 0, 0], [0, 1, 0]).scale(0.7)
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "camera": {
                "type": "orthographic",
                "to_world": tr.Transform.look_at([0, 0, 10], [0, 0, 0], [0, 1, 0]).scale([COLUMNS / 2] * 2 + [1]),
                "film": {
                    "type": "hdrfilm",
                    "width": COLUMNS * PIXELS,
                    "height": ROWS * PIXELS,
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "sobol"},
            },
            "wall": {
                "type": "rectangle",
                "to_world": wall,
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.1, 0.08]}},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": lamp,
                "emitter": {"type": "area", "radiance": torch.ones(471)},
            },
            **squares,
        },
        variant="spectral",
    )


def means(image: torch.Tensor) -> torch.Tensor:
    """(PATCHES, 3): the colours of the squares in an image (H, W, 3), without their borders."""
    squares = image.reshape(ROWS, PIXELS, COLUMNS, PIXELS, 3)[:, 1:-1, :, 1:-1]
    return squares.mean((1, 3)).reshape(PATCHES, 3)


def tables_of(values: torch.Tensor) -> torch.Tensor:
    """Reflectances (..., 471) of samples (..., SAMPLES), the first and the last of which hold beyond.

    Without them a thousandth of a bulb's red would be missing, which nine numbers that differ little cannot bear.
    """
    nm = tr.spectrum.wavelengths(values.dtype)
    ends = values[..., :1] * (nm < FIRST) + values[..., -1:] * (nm > LAST)
    return tr.spectrum.regular(values, FIRST, LAST) + ends


def lab(rgb: torch.Tensor, white: torch.Tensor) -> torch.Tensor:
    """CIE 1976 L*, a*, b* of linear sRGB (..., 3) for an eye that takes `white` (..., 3) for white."""
    ratio = (rgb @ RGB_TO_XYZ.T / (white @ RGB_TO_XYZ.T)).clamp(min=1e-6)
    f = torch.where(ratio > (6 / 29) ** 3, ratio ** (1 / 3), ratio * (29 / 6) ** 2 / 3 + 4 / 29)
    return torch.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1)


def colours(reflectances: torch.Tensor, lamp: torch.Tensor) -> torch.Tensor:
    """L*, a*, b* (PATCHES, 3) of reflectances (PATCHES, 471) in the light of a lamp (471,)."""
    return lab(tr.spectrum.to_rgb(reflectances, lamp), tr.spectrum.to_rgb(lamp))


def metamers(reflectances: torch.Tensor) -> list[tuple[int, int, float, float]]:
    """Pairs that look alike by daylight and different in the lines' light, with both differences."""
    light = lamps()
    day, night = (torch.cdist(c, c) for c in (colours(reflectances, light[name]) for name in ("daylight", "lines")))
    pairs = itertools.combinations(range(PATCHES), 2)
    found = [(i, j, float(day[i, j]), float(night[i, j])) for i, j in pairs]
    return [pair for pair in found if pair[2] < ALIKE and pair[3] > DIFFERENT]


def save_charts(charts: dict[str, torch.Tensor], path: Path) -> None:
    """Draw images (H, W, 3) beside each other, as the camera has them."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(charts), figsize=(3 * len(charts), 2.4), layout="constrained")
    for axis, (name, image) in zip(axes, charts.items(), strict=True):
        axis.imshow(tr.tonemap(image), interpolation="nearest")
        axis.set(xticks=[], yticks=[])
        axis.set_title(name, fontsize=9)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def save_reflectances(lines: dict[str, torch.Tensor], path: Path) -> None:
    """Draw reflectances (PATCHES, 471), a panel for each paint."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    nm = tr.spectrum.wavelengths()
    seen = (nm >= FIRST) & (nm <= LAST)
    figure, axes = pyplot.subplots(ROWS, COLUMNS, figsize=(11, 7), sharex=True, sharey=True, layout="constrained")
    for k, axis in enumerate(axes.flat):
        for name, tables in lines.items():
            axis.plot(nm[seen], tables[k][seen], label=name, linewidth=1)
        axis.set(ylim=(0, 1))
        axis.set_title(f"paint {k}", fontsize=8)
    axes[0, 0].legend(fontsize=7)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def run(
    folder: Path,
    *,
    spp: int = 128,
    spp_photograph: int = 4096,
    iterations: int = 24,
    noise: float = 0.001,
    smoothness: float = 1e-3,
) -> dict[str, float]:
    """The whole program.

    Args:
        folder: where pictures and the reflectances go.
        spp: samples a pixel of a step's three images.
        spp_photograph: samples a pixel of the photographs.
        iterations: steps; the mean over the second half of them counts.
        noise: standard deviation of the photographs' noise at a pixel; white is about 1.
        smoothness: the weight of squared second differences of the samples beside squared errors of the colours.

    Returns:
        The root mean square of errors of the reflectances from 420 to 680 nm, the mean and the largest difference of
        colour (CIE 1976) in the light that was not photographed, each also of daylight's three numbers ("daylight
        alone"), and how many pairs of paints that only look alike were found, missed, or named wrongly.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scene, light, truth = studio(), lamps(), paints()
    photographed = ["daylight", "bulb", "LED"]

    def picture(lamp: str, tables: torch.Tensor, samples: int, seed: int, **settings: Any) -> torch.Tensor:
        params = {LAMP: light[lamp], **{name_of(k): table for k, table in enumerate(tables)}}
        return tr.render(scene, spp=samples, seed=seed, params=params, range="ignore", **settings)

    with torch.no_grad():
        charts = {lamp: picture(lamp, truth, spp_photograph, 1000 + i) for i, lamp in enumerate(light)}
    chance = torch.Generator().manual_seed(0)
    photographs = {n: charts[n] + noise * torch.randn(charts[n].shape, generator=chance) for n in photographed}
    targets = {lamp: means(image) for lamp, image in photographs.items()}

    with torch.no_grad():
        ones = torch.ones(PATCHES, 471)
        white = {lamp: means(picture(lamp, ones, spp_photograph, 2000 + i)) for i, lamp in enumerate(light)}
    basis = tables_of(torch.eye(SAMPLES))
    seen = [
        tr.spectrum.to_rgb(basis, light[n]) * (white[n] / tr.spectrum.to_rgb(light[n]))[:, None] for n in photographed
    ]
    jacobian = torch.cat(seen, 2).double()  # (PATCHES, SAMPLES, 9), of the errors below
    bends = torch.eye(SAMPLES, dtype=torch.float64).diff(n=2, dim=0)
    hessian = jacobian @ jacobian.mT + smoothness * bends.T @ bends

    unknown = torch.full((PATCHES, SAMPLES), 0.4, requires_grad=True)
    mean = torch.zeros(PATCHES, SAMPLES)  # of the second half of the steps: less noise than the last one has
    curves: dict[str, list[float]] = {"photographs": [], "smoothness": []}
    for step in tr.progress(range(iterations), desc="paints"):
        tables = tables_of(unknown)
        errors = [means(picture(n, tables, spp, 3 * step + i)) - targets[n] for i, n in enumerate(photographed)]
        fidelity = torch.stack(errors).square().sum() / 2
        rough = smoothness * unknown.diff(n=2).square().sum() / 2
        (gradient,) = torch.autograd.grad(fidelity + rough, unknown)
        change = torch.linalg.solve(hessian, gradient.double()[..., None])[..., 0].float()
        with torch.no_grad():
            unknown -= change / 2
            if step >= iterations // 2:
                mean += unknown / (iterations - iterations // 2)
        curves["photographs"].append(fidelity.item() / PATCHES)
        curves["smoothness"].append(rough.item() / PATCHES)

    with torch.no_grad():
        found = tables_of(mean.clamp(0, 1))
        # What daylight's photograph alone says: its colours over those of a white chart there.
        *three, scale = tr.spectrum.upsample((targets["daylight"] / white["daylight"]).clamp(0.001, 0.999)).unbind(-1)
        simple = scale[:, None] * tr.spectrum.sigmoid(torch.stack(three, -1))
        predicted = {n: picture("lines", t, spp_photograph, 1003) for n, t in (("nine", found), ("three", simple))}

    inner = slice(420 - 360, 680 - 360 + 1)
    result = {}
    for name, tables, key in (("", found, "nine"), (" (daylight alone)", simple, "three")):
        result[f"rms{name}"] = (tables - truth)[:, inner].square().mean().sqrt().item()
        apart = (lab(means(predicted[key]), white["lines"]) - lab(means(charts["lines"]), white["lines"])).norm(dim=1)
        result[f"mean{name}"], result[f"largest{name}"] = apart.mean().item(), apart.max().item()
        print(
            f"reflectances{name}: {result[f'rms{name}']:.4f} off (rms); colours in the lines' light: "
            f"{result[f'mean{name}']:.2f} off (mean), {result[f'largest{name}']:.2f} (largest)"
        )
    pairs, known = metamers(found), {pair[:2] for pair in metamers(truth)}
    for i, j, day, night in pairs:
        print(f"paints {i} and {j}: {day:.1f} apart by daylight, {night:.1f} in the lines' light")
    result["pairs found"] = sum(pair[:2] in known for pair in pairs)
    result["pairs missed"] = len(known) - result["pairs found"]
    result["pairs wrong"] = len(pairs) - result["pairs found"]

    save_charts({**photographs, "lines, predicted": predicted["nine"], "lines": charts["lines"]}, folder / "charts.png")
    save_reflectances({"true": truth, "nine numbers": found, "daylight alone": simple}, folder / "reflectances.png")
    save_curves(curves, folder / "loss.png", "Reflectances of a chart")
    nm = tr.spectrum.wavelengths().tolist()
    with (folder / "reflectances.csv").open("w") as file:
        print("nm", *(f"paint {k}" for k in range(PATCHES)), sep=",", file=file)
        for i, row in enumerate(found.T.tolist()):
            if FIRST <= nm[i] <= LAST:
                print(f"{nm[i]:g}", *(f"{value:.4f}" for value in row), sep=",", file=file)
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--iterations", type=at_least_one, help="steps (default 24)")
    parser.add_argument("--output", type=Path, default=Path("output/paint_spectra"), help="folder for the results")
    options = parser.parse_args(argv)
    with reported(parser, "results", options.output):
        run(options.output, **given(options, "iterations"))


if __name__ == "__main__":
    main()
