"""Find out which glass a prism is made of, by the rainbow that it throws.

    python tutorials/which_glass.py
    python tutorials/which_glass.py --glass "fused silica"

Light of a slit falls through a prism on a white screen, which a camera looks at. Glass bends blue more than red; how
much it bends light is its index n_d at the yellow line d, and how much that differs between red and blue is Abbe's
number V_d = (n_d - 1) / (n_F - n_C). The two name a glass in catalogues. The photograph has noise, and its red, green
and blue are those of any camera: nothing here measures wavelengths.

Paths start at the lamp (`tr.ParticleTracer`): the slit's light has one direction, which a path from the camera would
never meet. The index of the prism is a table by wavelength that PyTorch makes of a few numbers (`tr.spectrum.abbe`) and
hands over by `params=`; the derivative by it is how the light moves over the screen.

What is compared are three numbers, the columns at which the light's red, green and blue have their middle. Unlike
differences of pixels they say where to go even from rainbows that do not overlap the photograph's. A few numbers and
few unknowns are a case for forward mode and Gauss-Newton's steps. The first steps look for n_d and V_d by Cauchy's
formula n = A + B / wavelength^2. Real glass is not quite like that, which leaves V_d wrong by up to 4 %; so the last
steps have a third unknown that bends the curve between the lines F, d and C, and leaves what n_d and V_d mean.
"""

from __future__ import annotations

import argparse
import functools
import math
import warnings
from pathlib import Path

import torch
from command_line import at_least_one, given, reported
from pictures import save_curves

import torchrender as tr
from torchrender.spectrum.glasses import GLASSES
from torchrender.spectrum.indices import BLUE, RED, YELLOW

ANGLE = math.radians(45)  # between the two faces that light crosses
DESIGN = 1.6  # the index that light goes through symmetrically
HEIGHT = 0.5  # of the prism's section
DISTANCE = 4.0  # of the screen
SLIT = 0.01  # its width
INDEX = "prism.bsdf.eta.value"
TOO_STRONG = 1.9  # light with a higher index is reflected inside of this prism


def prism() -> tr.Mesh:
    """A bar along y whose section is an isosceles triangle. Catalogues have indices relative to air."""
    half = HEIGHT * math.tan(ANGLE / 2)
    section = [(-half, -HEIGHT / 2), (half, -HEIGHT / 2), (0, HEIGHT / 2)]
    vertices = torch.tensor([(x, y, z) for y in (-0.5, 0.5) for x, z in section])
    faces = [(0, 1, 2), (3, 5, 4), (0, 2, 5), (0, 5, 3), (1, 4, 5), (1, 5, 2), (0, 3, 4), (0, 4, 1)]
    glass = {"type": "dielectric", "int_ior": {"type": "abbe", "n_d": DESIGN, "V_d": 45}, "ext_ior": 1.0}
    return tr.Mesh(vertices, torch.tensor(faces), bsdf=glass)


def experiment(width: int, height: int) -> tr.Scene:
    """Slit, prism, screen and camera, in a dark room."""
    incidence = math.asin(DESIGN * math.sin(ANGLE / 2))
    rise = incidence - ANGLE / 2  # light goes up to the prism and down from it
    along = torch.tensor([math.cos(rise), 0.0, math.sin(rise)])
    away = along * torch.tensor([1.0, 1.0, -1.0])

    def towards(origin: torch.Tensor, target: torch.Tensor) -> tr.Transform:
        return tr.Transform.look_at(origin.tolist(), target.tolist(), [0, 1, 0])

    centre, screen = torch.zeros(3), DISTANCE * away
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "ptracer", "max_depth": 5},
            "camera": {
                "type": "perspective",
                "fov": 44,
                "to_world": towards(away, screen),
                # The slope of the filter is what the light's motion over the film is differentiated by.
                "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "gaussian"}},
            },
            "prism": prism(),
            "screen": {
                "type": "rectangle",
                "to_world": towards(screen, centre) @ tr.Transform.scale(3),
                "bsdf": {"type": "diffuse", "reflectance": 0.9},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": towards(-along, centre) @ tr.Transform.scale([SLIT / 2, 0.1, 1]),
                "bsdf": {"type": "diffuse", "reflectance": 0.0},
                "emitter": {"type": "directionalarea", "radiance": 100.0},
            },
        },
        variant="spectral",
    )


def index_of(unknown: torch.Tensor) -> torch.Tensor:
    """The index by wavelength (471,) for n_d, 1 / V_d and a bend.

    The bend's curve is quadratic in y = 1 / wavelength^2 like a third term of Cauchy's formula, but 0 at the line d and
    equal at F and C. 1 / V_d is what light is spread in proportion to.
    """
    y, d, f, c = ((1000 / line) ** 2 for line in (tr.spectrum.wavelengths(unknown.dtype), YELLOW, BLUE, RED))
    return tr.spectrum.abbe(unknown[0], 1 / unknown[1]) + unknown[2] * ((y - f) * (y - c) - (d - f) * (d - c))


def middles(image: torch.Tensor, near: torch.Tensor) -> torch.Tensor:
    """(3,): the columns around which red, green and blue of an image (H, W, 3) lie, within the columns `near` (W,)."""
    light = image.sum(0) * near[:, None]
    columns = torch.arange(len(near), dtype=light.dtype)
    return columns @ light / light.sum(0)


def around(image: torch.Tensor) -> torch.Tensor:
    """(W,): ones where an image (H, W, 3) has a rainbow and half its width beside it, elsewhere zeros."""
    light = image.sum((0, 2))
    lit = (light > 0.01 * light.max()).nonzero()[:, 0]
    low, high, columns = int(lit.min()), int(lit.max()), torch.arange(len(light))
    margin = (high - low) // 2 + 2
    return ((columns >= low - margin) & (columns <= high + margin)).float()


def nearest(n_d: float, v_d: float) -> list[tuple[str, float, float]]:
    """Names, indices and Abbe's numbers of the catalogue, from the one that is most like these two.

    A thousandth of the index counts like 1 % of Abbe's number.
    """
    found = []
    for name in GLASSES:
        table = tr.spectrum.glass(name)
        v = float(tr.spectrum.abbe_number(table))
        at = YELLOW - 360
        n = float(torch.lerp(table[int(at)], table[int(at) + 1], at % 1))
        found.append((math.hypot((n - n_d) / 0.001, (v / v_d - 1) / 0.01), name, n, v))
    return [(name, n, v) for _, name, n, v in sorted(found)]


def save_rainbows(rows: dict[str, torch.Tensor], path: Path) -> None:
    """Draw strips (H, W, 3) below each other, cut to where there is light, each exposed for itself."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    lit = torch.stack([image.sum((0, 2)) > 0.05 * image.sum((0, 2)).max() for image in rows.values()]).any(0).nonzero()
    low, high = max(int(lit.min()) - 10, 0), min(int(lit.max()) + 11, len(next(iter(rows.values()))[0]))
    figure, axes = pyplot.subplots(len(rows), 1, figsize=(9, 0.75 * len(rows)), layout="constrained", squeeze=False)
    for axis, (name, image) in zip(axes[:, 0], rows.items(), strict=True):
        axis.imshow(tr.tonemap(image[:, low:high] * (1.5 / image.max())), aspect="auto", interpolation="nearest")
        axis.set(xticks=[], yticks=[])
        axis.set_ylabel(name, rotation=0, ha="right", va="center")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def run(
    folder: Path,
    *,
    glass: str = "SF10",
    width: int = 512,
    height: int = 16,
    spp: int = 256,
    iterations: int = 8,
    noise: float = 0.001,
) -> dict[str, float | str]:
    """The whole program; returns the index, Abbe's number, its relative error, and the name that was found.

    Args:
        folder: where pictures go.
        glass: what the prism is made of, which the rest does not know.
        width, height: pixels of the film.
        spp: samples a pixel of each step; the photograph and the last two steps have four times as many.
        iterations: steps, the first half of them without the bend.
        noise: standard deviation of the photograph's noise, for its brightest value.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # The warning is of edges seen through the prism: those of the beam, which pass through it whole.
    warnings.filterwarnings("ignore", category=tr.MissingTermWarning)
    scene = experiment(width, height)
    secret = tr.spectrum.glass(glass).float()
    if float(secret[int(YELLOW) - 360]) > TOO_STRONG:
        raise ValueError(f"glass: the light of this prism is reflected inside of {glass}")

    def picture(table: torch.Tensor, samples: int, seed: int) -> torch.Tensor:
        return tr.render(scene, spp=samples, spp_grad=max(samples // 4, 1), seed=seed, params={INDEX: table})

    def seen(samples: int, seed: int, window: torch.Tensor, unknown: torch.Tensor) -> torch.Tensor:
        return middles(picture(index_of(unknown), samples, seed), window)

    with torch.no_grad():
        photograph = picture(secret, 4 * spp, 1000)
    chance = torch.Generator().manual_seed(0)
    photograph = photograph + noise * photograph.max() * torch.randn(photograph.shape, generator=chance)
    everywhere, near = torch.ones(width), around(photograph)
    target = middles(photograph, near)

    unknown = torch.tensor([DESIGN, 1 / 45, 0.0])
    curve: list[float] = []
    for step in tr.progress(range(iterations), desc="glass"):
        samples = spp if step < iterations - 2 else 4 * spp
        bent = step >= iterations // 2
        window = near if bent else everywhere  # at first the rainbow may lie anywhere
        columns = []
        for direction in torch.eye(3)[: 3 if bent else 2]:
            now, derivative = torch.func.jvp(functools.partial(seen, samples, step, window), (unknown,), (direction,))
            columns.append(derivative)
        jacobian = torch.stack(columns, 1).double()
        change = torch.linalg.lstsq(jacobian, (target - now).double()[:, None]).solution[:, 0]
        unknown[: len(change)] += change.float()
        unknown[0].clamp_(1.25, TOO_STRONG)
        unknown[1].clamp_(1 / 150, 1 / 15)
        curve.append(float((target - now).abs().max()))

    found, v_d = index_of(unknown), float(1 / unknown[1])
    names = nearest(float(unknown[0]), v_d)
    true = float(tr.spectrum.abbe_number(secret.double()))
    with torch.no_grad():
        rows = {"photograph": photograph, "found": picture(found, spp, 1001)}
        rows |= {name: picture(tr.spectrum.glass(name).float(), spp, 1002) for name in ("N-BK7", "F2", "N-SF5", "SF10")}
    save_rainbows(rows, folder / "rainbows.png")
    tr.io.write_image(folder / "photograph.exr", photograph)
    save_curves({"columns": curve}, folder / "loss.png", "Distance of the colours' middles")
    print(f"found n_d {float(unknown[0]):.4f}, V_d {v_d:.2f} (true {true:.2f}, {100 * (v_d / true - 1):+.2f} %)")
    for name, n, v in names[:3]:
        print(f"  {name}: {n:.4f}, {v:.2f}")
    return {"index": float(unknown[0]), "abbe": v_d, "error": abs(v_d / true - 1), "glass": names[0][0]}


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--glass", help="what the prism is made of (default SF10)")
    parser.add_argument("--iterations", type=at_least_one, help="steps (default 8)")
    parser.add_argument("--output", type=Path, default=Path("output/which_glass"), help="folder for the results")
    options = parser.parse_args(argv)
    with reported(parser, "results", options.output):
        run(options.output, **given(options, "glass", "iterations"))


if __name__ == "__main__":
    main()
