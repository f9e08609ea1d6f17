"""Measure how hot the air is above a road by one photograph of its mirage.

    python tutorials/mirage.py             # 192 x 128 pixels, 80 iterations
    python tutorials/mirage.py --large     # and the mirage in 768 x 512

Above a road in the sun air is hot, and the road seems to be a mirror: hot air bends flat rays upwards before they meet
the road. How deep they get depends on how flat they are, so that the mirage shows the temperature at all heights, if
what it mirrors is known. Here that is a row of lorries at 420 m, the eye is 0.9 m above the road, and the air is 30 °C,
and 60 °C close to the road. `scenes/make_mirage.py` has the scene, and says how air becomes an index of refraction.

The derivative of a picture by the temperatures goes through every bent way (`tr.PathTracer`). What it does not have is
the motion of edges that are seen through the air: here the line where the mirage ends and the road begins. So pixels
that show the road do not count, and the search begins with air that is too hot, whose mirage reaches beyond that line.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path
from typing import Any

import torch
from command_line import at_least_one, given, reported
from pictures import save, save_curves

import torchrender as tr

sys.path.append(str(Path(__file__).resolve().parent.parent / "scenes"))  # which is not a part of the package
from make_mirage import AMBIENT, INDEX, ROAD, TOP, heat, index_of, layers, mirage

KNOTS = (0.0, 0.03, 0.07, 0.12, 0.2, 0.3, 0.45, TOP)  # metres, at which the temperature is sought


def between(y: torch.Tensor, log_heat: torch.Tensor) -> torch.Tensor:
    """How much hotter than 30 °C the air is at heights, from logarithms at the knots, linear between two of them."""
    knots = torch.tensor(KNOTS, dtype=y.dtype)
    right = torch.searchsorted(knots, y).clamp(1, len(knots) - 1)
    part = (y - knots[right - 1]) / (knots[right] - knots[right - 1])
    return torch.exp(torch.lerp(log_heat[right - 1], log_heat[right], part.clamp(0, 1)))


def without_road(photograph: torch.Tensor) -> torch.Tensor:
    """(H, W, 1): 1 for pixels that count; those that show the road, by its colour, or are close to such do not."""
    road = ((photograph - ROAD).abs().amax(-1) < 0.03).double()
    near = torch.nn.functional.max_pool2d(road[None], 5, stride=1, padding=2)[0]
    return 1 - near[..., None]


def distance(image: torch.Tensor, photograph: torch.Tensor, counts: torch.Tensor, levels: int = 4) -> torch.Tensor:
    """The mean squared difference where pixels count, and those of pictures of half the size, a quarter, and so on.

    By these what is far from where it belongs finds its way.
    """
    difference = ((image - photograph) * counts).movedim(-1, 0)[None]
    total = difference.square().mean()
    for _ in range(levels - 1):
        difference = torch.nn.functional.avg_pool2d(difference, 2)
        total = total + difference.square().mean()
    return total


def save_temperatures(found: dict[str, torch.Tensor], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    y = torch.linspace(0, TOP, 200, dtype=torch.float64)
    figure, axes = pyplot.subplots(figsize=(5, 4))
    for name, log_heat in found.items():
        axes.plot(AMBIENT - 273.15 + between(y, log_heat.detach()), y, label=name)
    axes.plot(AMBIENT - 273.15 + heat(y), y, "k--", label="truth")
    axes.set(xlabel="temperature in °C", ylabel="height in m")
    axes.grid(True, alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)


def run(
    folder: Path,
    *,
    resolution: int = 128,
    spp: int = 4,
    iterations: int = 80,
    rate: float = 0.1,
    noise: float = 0.01,
    large: bool = False,
) -> dict[str, float]:
    """The whole program; returns errors of the temperatures, root mean squares over 0 to 0.5 m in kelvin.

    Args:
        folder: where pictures go.
        resolution: pixels along the height of the photograph, which is half as wide again.
        spp: samples a pixel of pictures and derivatives in the search; the photograph has 64.
        iterations: steps of the optimiser.
        rate: the learning rate, of logarithms of temperatures; it falls to a tenth.
        noise: standard deviation of the photograph's noise, in radiance.
        large: render a large picture of the mirage, too.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scene = tr.load_dict(mirage(3 * resolution // 2, resolution), dtype=torch.float64)
    # The motion of the line between mirage and road is missing, see above.
    warnings.filterwarnings("ignore", category=tr.MissingTermWarning)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        photograph = tr.render(scene, spp=64, seed=1_000_000)
    photograph = photograph + noise * torch.randn(photograph.shape, generator=generator, dtype=torch.float64)
    counts = without_road(photograph)
    save(photograph, folder, "photograph")
    save(photograph * counts, folder, "what counts")

    y, knots = layers(), torch.tensor(KNOTS, dtype=torch.float64)
    start = torch.log(36 * torch.exp(-knots / 0.12))
    log_heat = torch.nn.Parameter(start.clone())
    optimiser = torch.optim.Adam([log_heat], lr=rate, betas=(0.9, 0.95))
    fall = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda i: 0.1 ** (i / iterations))
    curves: dict[str, list[float]] = {"squared error": []}

    def picture(**settings: Any) -> torch.Tensor:
        return tr.render(scene, params={INDEX: index_of(between(y, log_heat))}, **settings)

    def error() -> float:
        low = torch.linspace(0, 0.5, 101, dtype=torch.float64)
        return float((between(low, log_heat.detach()) - heat(low)).square().mean().sqrt())

    with torch.no_grad():
        save(picture(spp=16, seed=1), folder, "start")
    result = {"start": error()}
    bar = tr.progress(range(iterations), desc="mirage")
    for _ in bar:
        optimiser.zero_grad()
        loss = distance(picture(spp=spp, spp_grad=spp, seed=generator), photograph, counts)
        loss.backward()
        optimiser.step()
        fall.step()
        curves["squared error"].append(loss.item())
        bar.set_postfix(loss=f"{loss.item():.3g}")
    result["end"] = error()
    with torch.no_grad():
        save(picture(spp=16, seed=1), folder, "result")
    save_curves(curves, folder / "loss.png", "Mirage: squared error of the photograph")
    save_temperatures({"start": start, "found": log_heat}, folder / "temperature.png")
    if large:
        with torch.no_grad():
            scene = tr.load_dict(mirage(768, 512), dtype=torch.float64)
            save(tr.render(scene, spp=64, seed=0), folder, "mirage")
    told = ", ".join(f"{value:.2f} K at the {name}" for name, value in result.items())
    print(f"temperature between 0 and 0.5 m, off by (rms): {told}; it varies by {heat(torch.tensor(0.0)):.0f} K")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--large", action="store_true", help="render the mirage in 768 x 512 pixels, too")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser (default 80)")
    parser.add_argument("--resolution", type=at_least_one, help="pixels along the height (default 128)")
    parser.add_argument("--output", type=Path, default=Path("output/mirage"), help="folder for the results")
    options = parser.parse_args(argv)
    with reported(parser, "results", options.output):
        run(options.output, large=options.large, **given(options, "iterations", "resolution"))


if __name__ == "__main__":
    main()
