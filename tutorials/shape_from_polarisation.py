"""Find the heights of a relief from one picture of a polarisation camera that looks down on it.

    python tutorials/shape_from_polarisation.py                # of plastic, 64 x 64 heights, 64 x 64 pixels
    python tutorials/shape_from_polarisation.py --material Cr  # of metal
    python tutorials/shape_from_polarisation.py --full         # 128 x 128 heights and pixels

A relief lies under a sky that is brighter on one side. How bright a point is says how far it leans to that side or away
from it; how far it leans across hardly matters. So a picture of intensities leaves the heights open: rows along the
light hang together by smoothness alone.

Reflected light is polarised across the plane in which it was reflected, light from inside of plastic along it, and
both the more the steeper the surface is. That gives the direction in which the surface leans, but for its sign: Q goes
with p^2 - q^2 and U with 2 p q, if p and q are the slopes. Shading has the sign of p, and with it U has that of q. At
flat heights, where the search begins, Q and U have no slope; optimising finds this order by itself, first what shading
says, then the rest.

The same optimisation runs on the Stokes picture and on its intensity alone: Adam over a height field, coarse to fine
and through large steps (`tr.optim.GridSmoothing`), with the derivatives of all components by all heights from one pass.
Q and U weigh more than I, whose renderings with few samples have ten times their noise. Both results are compared with
the true heights and normals. A run leaves pictures on its way, and goes on from its checkpoint when it is started
again.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import torch
from checkpoints import Checkpoint
from command_line import at_least_one, given, reported
from pictures import save_curves

import torchrender as tr

CAMERAS = {"Stokes": slice(0, 4), "intensity": slice(0, 1)}  # the components that a camera has
WEIGHTS = torch.tensor([1.0, 100.0, 100.0, 100.0])  # of squared errors, by the noise of renderings
COARSEST = 16  # heights along a side at the beginning
SLOWER = ((0.6, 0.5), (0.85, 0.2))  # parts of the run after which the rate is so many times its first
HEIGHTS = "relief.heights"
PLASTIC = {"type": "pplastic", "diffuse_reflectance": 0.3, "int_ior": 1.5, "ext_ior": 1.0, "alpha": 0.15}


def relief(size: int) -> torch.Tensor:
    """(size, size) true heights: a ring, a knob, a dent and waves, flat at the border."""
    axis = (torch.arange(size) + 0.5) / size * 2 - 1
    y, x = torch.meshgrid(axis, axis, indexing="ij")

    def bump(at: tuple[float, float], width: float) -> torch.Tensor:
        return torch.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * width**2))

    ring = torch.exp(-((torch.hypot(x + 0.15, y - 0.1) - 0.45) ** 2) / 0.012)
    heights = 0.08 * ring + 0.1 * bump((-0.15, 0.1), 0.16) - 0.09 * bump((0.55, -0.5), 0.17)
    heights = heights + 0.07 * bump((0.6, 0.6), 0.14) + 0.02 * torch.sin(9 * x + 5 * y) * bump((-0.5, -0.6), 0.3)
    return heights * (1 - x**8) * (1 - y**8)


def sky() -> dict[str, Any]:
    """Light from above, z, that is brighter towards +x."""
    size = 32
    axes = (torch.arange(size) + 0.5) / size * math.pi, (torch.arange(2 * size) + 0.5) / size * math.pi
    down, around = torch.meshgrid(*axes, indexing="ij")
    towards = torch.stack([around.sin() * down.sin(), around.cos() * down.sin(), down.cos()], -1)
    lamp = torch.nn.functional.normalize(torch.tensor([0.7, 0.0, 0.7]), dim=0)
    radiance = 0.5 * (1 + towards @ lamp) ** 2
    return {"type": "envmap", "bitmap": radiance[..., None], "to_world": tr.Transform.rotate([1, 0, 0], 90)}


def studio(bsdf: dict[str, Any], resolution: int) -> tr.Scene:
    """The relief, its sky and a camera above it."""
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "camera": {
                "type": "orthographic",
                "to_world": tr.Transform.look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": resolution, "height": resolution, "rfilter": {"type": "box"}},
                "sampler": {"type": "sobol"},
            },
            "sky": sky(),
            "relief": {"type": "heightfield", "heights": torch.zeros(2, 2), "bsdf": bsdf},
        },
        variant="mono",
    )


def sizes_of(size: int) -> list[int]:
    """The sizes of the grids, from the coarsest one on, each twice the one before."""
    sizes = [size]
    while sizes[0] % 2 == 0 and sizes[0] // 2 >= COARSEST:
        sizes.insert(0, sizes[0] // 2)
    return sizes


def normals(heights: torch.Tensor, steps: int) -> torch.Tensor:
    """(steps + 1, steps + 1, 3) unit normals on a regular grid."""
    _, z_u, z_v = tr.heightfield.grid(heights, (steps, steps))
    return torch.nn.functional.normalize(torch.stack([-z_u / 2, -z_v / 2, torch.ones_like(z_u)], -1), dim=-1)


def compare(heights: torch.Tensor, truth: torch.Tensor) -> dict[str, float]:
    """The error of heights relative to the true ones, both from their mean, and the mean angle between the normals."""
    steps = 128
    found, true = (tr.heightfield.grid(h, (steps, steps))[0] for h in (heights, truth))
    found, true = found - found.mean(), true - true.mean()
    cosine = (normals(heights, steps) * normals(truth, steps)).sum(-1).clamp(-1, 1)
    return {
        "heights": float((found - true).norm() / true.norm()),
        "normals": float(torch.rad2deg(torch.acos(cosine)).mean()),
    }


class Search:
    """Heights for one of the cameras, with large steps and an optimiser for their grid."""

    def __init__(self, u: torch.Tensor, rate: float, smoothness: float) -> None:
        self.rate, self.smoothness = rate, smoothness
        self.begin(u)

    def begin(self, u: torch.Tensor) -> None:
        self.u = torch.nn.Parameter(u)
        self.smoothing = tr.optim.GridSmoothing(self.smoothness * (len(u) / COARSEST) ** 2)
        # Derivatives by single heights are small, next to which Adam's usual epsilon would be large.
        self.optimiser = torch.optim.Adam([self.u], lr=self.rate, betas=(0.9, 0.95), eps=1e-16)

    def grow(self, size: int) -> None:
        """The same heights on a finer grid, with a new optimiser."""
        heights = tr.optim.resample(self.heights().detach(), (size, size), "clamp")
        self.begin(torch.zeros(size, size))
        self.u.data.copy_(self.smoothing.to_differential(heights))

    def heights(self) -> torch.Tensor:
        return self.smoothing.from_differential(self.u)


def save_heights(maps: dict[str, torch.Tensor], path: Path) -> None:
    """Draw heights as seen from above, with one scale."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(maps), figsize=(3.6 * len(maps) + 0.8, 3.6), layout="constrained")
    truth = maps["true"] - maps["true"].mean()
    for axis, (name, heights) in zip(axes, maps.items(), strict=True):
        surface = tr.heightfield.grid(heights, (128, 128))[0]
        limits = {"vmin": float(truth.min()), "vmax": float(truth.max())}
        axis.imshow(surface - surface.mean(), origin="lower", extent=(-1, 1, -1, 1), **limits)
        axis.set(xticks=[], yticks=[], title=name)
    figure.colorbar(axes[0].images[0], ax=list(axes), shrink=0.8)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def run(
    folder: Path,
    *,
    material: str = "plastic",
    size: int = 64,
    resolution: int = 64,
    spp: int = 16,
    spp_photograph: int = 1024,
    iterations: int = 240,
    rate: float = 0.01,
    smoothness: float = 1.0,
    noise: float = 0.001,
    save_every: int = 40,
    restart: bool = False,
) -> dict[str, dict[str, float]]:
    """The whole program; returns by camera the relative error of the heights and the mean angle of normals in degrees.

    Args:
        folder: where pictures, heights and checkpoints go.
        material: "plastic", or the name of a metal.
        size: heights along either side; the first grid is 16 wide, or as little more as halving leads to.
        resolution: pixels along either side.
        spp, spp_photograph: samples a pixel of a step and of the photograph.
        iterations: steps of the optimiser for each camera.
        rate: the learning rate of the first steps.
        smoothness: lambda of the large steps for the coarsest grid.
        noise: standard deviation of each component at a pixel; white is about 1.
        save_every: iterations after which pictures and a checkpoint are written.
        restart: begin anew, whatever checkpoint there is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {"material": material, "size": size, "resolution": resolution, "spp": spp}
    settings |= {"iterations": iterations, "rate": rate, "smoothness": smoothness, "noise": noise}
    metal = {"type": "roughconductor", "material": material, "alpha": 0.25}
    scene = studio(PLASTIC if material == "plastic" else metal, resolution)
    truth = relief(2 * size)

    def picture(heights: torch.Tensor, samples: int, seed: int, passes: int = 1) -> torch.Tensor:
        # A picture from above has no silhouettes or shadows that could move.
        settings: dict[str, Any] = {"spp": samples, "passes": passes, "params": {HEIGHTS: heights}, "visibility": False}
        return tr.render(scene, seed=seed, outputs=("stokes",), **settings).stokes[:, :, 0]

    with torch.no_grad():
        photograph = picture(truth, min(spp_photograph, 64), 1_000_000, -(-spp_photograph // 64))
    chance = torch.Generator().manual_seed(0)
    photograph = photograph + noise * torch.randn(photograph.shape, generator=chance)
    tr.io.write_image(folder / "photograph.exr", photograph[:, :, None])
    share = photograph / photograph[..., :1] * torch.tensor([1.0, 10.0, 10.0, 10.0])  # so that one sees it
    parts = [tr.tonemap(photograph[..., :1]).expand(-1, -1, 3)]
    parts += [tr.polarization.false_color(share, component) for component in (1, 2)]
    tr.io.write_image(folder / "photograph.png", torch.cat(parts, 1), raw=True)

    sizes = sizes_of(size)
    result, found, curves = {}, {"true": truth}, {}
    for name, components in CAMERAS.items():
        checkpoint = Checkpoint(folder / f"{name.lower()}.pt", settings, restart)
        state = checkpoint.load()
        search = Search(torch.zeros(sizes[0], sizes[0]) if state is None else state["u"], rate, smoothness)
        curve: dict[str, list[float]] = {"heights": [], "normals": []}
        first = 0
        if state is not None:
            curve, first = checkpoint.restore(state, iterations, search.optimiser)
        bar = tr.progress(range(first, iterations), desc=name, initial=first, total=iterations)
        for iteration in bar:
            finer = sizes[iteration * len(sizes) // iterations]
            if finer > len(search.u):
                search.grow(finer)
            for group in search.optimiser.param_groups:
                group["lr"] = rate * ([1.0] + [factor for part, factor in SLOWER if iteration >= part * iterations])[-1]
            search.optimiser.zero_grad()
            residual = picture(search.heights(), spp, iteration) - photograph
            loss = (residual.square() * WEIGHTS)[..., components].sum(-1).mean()
            loss.backward()
            search.optimiser.step()
            found[name] = search.heights().detach()
            errors = compare(found[name], truth)
            for key, value in errors.items():
                curve[key].append(value)
            bar.set_postfix(loss=f"{loss.item():.3g}", heights=f"{errors['heights']:.3g}", grid=finer)
            done = iteration + 1
            if done % save_every == 0 or done == iterations:
                save_heights(found, folder / "heights.png")
                checkpoint.save(
                    iteration=done, u=search.u.detach(), optimiser=search.optimiser.state_dict(), curves=curve
                )
        found[name] = search.heights().detach()
        result[name] = compare(found[name], truth)
        curves[f"heights, {name}"] = curve["heights"]
        tr.io.write_image(folder / f"{name.lower()}.exr", found[name])  # what tr.HeightField takes
    save_heights(found, folder / "heights.png")
    save_curves(curves, folder / "error.png", f"Relative error of {size} x {size} heights")
    for name, errors in result.items():
        print(f"{name}: heights are {100 * errors['heights']:.1f} % off, normals {errors['normals']:.2f} degrees")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--full", action="store_true", help="128 x 128 heights and pixels, 400 iterations")
    parser.add_argument("--material", help="plastic (the default), or a metal such as Cr")
    parser.add_argument("--iterations", type=at_least_one, help="steps for each camera (default 240)")
    parser.add_argument("--restart", action="store_true", help="begin anew where a checkpoint is found")
    parser.add_argument(
        "--output", type=Path, default=Path("output/shape_from_polarisation"), help="folder for the results"
    )
    options = parser.parse_args(argv)
    settings: dict[str, Any] = {"size": 128, "resolution": 128, "iterations": 400} if options.full else {}
    settings |= given(options, "material", "iterations")
    with reported(parser, "results", options.output):
        run(options.output, restart=options.restart, **settings)


if __name__ == "__main__":
    main()
