"""Find index, absorption and roughness of a metal from one picture of a ball of it, with and without polarisation.

    python tutorials/polarised_ball.py
    python tutorials/polarised_ball.py --material W
    python tutorials/polarised_ball.py --material glass
    python tutorials/polarised_ball.py --material plastic

A rough ball of metal mirrors a sky. How much light it sends to a pixel, and how that is polarised, follows from its
index of refraction eta - i k, three of each in red, green and blue, and from its roughness alpha. The sky is known from
a panorama that was taken some time before; since then it has changed by a smooth factor, the exponential of nine
spherical harmonics, whose coefficients are unknown, too. Pixels beside the ball do not count.

A camera of intensities takes one for the other: a ball that mirrors less at its middle than at its rim looks like one
under a sky that is darker behind the camera. Its loss is a valley, and noise decides where in the valley one ends. The
degree of polarisation is a ratio, which the brightness of unpolarised light does not change; a camera of Stokes vectors
(I, Q, U, V) sees index and sky apart. A ball of rough glass, or of plastic, of whose base three colours are unknown, is
another choice.

The same optimisation, Adam from the same start, runs on the Stokes picture and on its intensity alone; derivatives of
all four components come from one pass. Adam scales each number by itself, and does well where these are what is seen
one by one. So a metal is given by its reflectance at right angles, which any picture shows, and by a number that tells
metals of equal reflectance apart (Gulbrandsen, "Artist Friendly Metallic Fresnel", JCGT 3(4), 2014).

With polarisation 200 steps are enough; without it they are far from the end of the valley. (Of plastic they are too few
for either camera: a brighter base under a darker sky is a valley for both.) Beside what is found stands
what noise allows at best, however many steps there are, by derivatives in forward mode (the
Cramér-Rao bound). Pictures show both losses over a plane of eta and k, each point with the sky that suits it best.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import torch
from command_line import at_least_one, given, reported
from pictures import save_curves

import torchrender as tr

CAMERAS = {"Stokes": slice(0, 4), "intensity": slice(0, 1)}  # the components that a camera has
CHANGE = torch.tensor([-0.1, 0.15, -0.1, 0.12, 0.1, -0.08, 0.07, 0.1, -0.12])  # of the sky, true
ROUGHNESS = 0.15  # true
PAINT = [0.55, 0.2, 0.1]  # of plastic's base, true
SKY_HEIGHT = 64  # texels of the panorama


def directions() -> torch.Tensor:
    """(SKY_HEIGHT, 2 SKY_HEIGHT, 3): where the texels of a panorama are, y upwards."""
    size = SKY_HEIGHT
    axes = (torch.arange(size) + 0.5) / size * math.pi, (torch.arange(2 * size) + 0.5) / size * math.pi
    down, around = torch.meshgrid(*axes, indexing="ij")
    return torch.stack([around.sin() * down.sin(), down.cos(), -around.cos() * down.sin()], -1)


def panorama() -> torch.Tensor:
    """Texels (SKY_HEIGHT, 2 SKY_HEIGHT, 3): blue with clouds, the sun behind haze, and a chequered ground."""
    towards = directions()
    x, y, z = towards[..., None].unbind(-2)
    blue = torch.tensor([0.35, 0.55, 0.95]) + torch.tensor([0.5, 0.35, 0.05]) * torch.exp(-3 * y.clamp(min=0))
    waves = torch.sin(5 * x + 2 * torch.sin(3 * z)) * torch.sin(4 * z - 3 * y + 1)
    clouds = torch.sigmoid(8 * (waves + 0.5 * torch.sin(9 * x - 7 * z + 5 * y) - 0.45))
    sun = torch.nn.functional.normalize(torch.tensor([-0.5, 0.55, -0.67]), dim=0)
    haze = torch.exp(-(1 - towards @ sun) / 0.012)[..., None]
    sky = blue + clouds * (1.1 - 0.7 * blue) + torch.tensor([9.0, 7.5, 5.5]) * haze
    away = (-y).clamp(min=0.08)
    tiles = torch.sign(torch.sin(2.2 * x / away) * torch.sin(2.2 * z / away)) * torch.sigmoid((-y - 0.12) / 0.03)
    ground = torch.tensor([0.22, 0.17, 0.12]) * (1 + 0.45 * tiles)
    return torch.lerp(ground, sky, torch.sigmoid(y / 0.02))


def harmonics() -> torch.Tensor:
    """(SKY_HEIGHT, 2 SKY_HEIGHT, 9): spherical harmonics up to the second order, not normalised."""
    x, y, z = directions().unbind(-1)
    return torch.stack([torch.ones_like(x), x, y, z, x * y, y * z, x * z, x * x - z * z, (3 * y * y - 1) / 2], -1)


class Metal:
    """What of the unknown is of a metal: logits of reflectance r and edge tint g of three colours, logarithm of alpha.

    For r and g from 0 to 1 eta is between the least and the largest index that a metal of this reflectance can have.
    """

    axes = "eta / true", "k / true"

    def __init__(self, name: str) -> None:
        self.bsdf = {"type": "roughconductor", "material": name, "alpha": ROUGHNESS}
        self.start = self.unknown(torch.full((3,), 1.0), torch.full((3,), 2.0), 0.4)

    def true(self, scene: tr.Scene) -> torch.Tensor:
        values = scene.ball.bsdf
        return self.unknown(values.eta.value.detach(), values.k.value.detach(), ROUGHNESS)

    @staticmethod
    def unknown(eta: torch.Tensor, k: torch.Tensor, alpha: float) -> torch.Tensor:
        r = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
        least, most = (1 - r) / (1 + r), (1 + r.sqrt()) / (1 - r.sqrt())
        return torch.cat([r.logit(), ((most - eta) / (most - least)).logit(), torch.tensor([alpha]).log()])

    @staticmethod
    def numbers(unknown: torch.Tensor) -> dict[str, torch.Tensor]:
        """eta (3,), k (3,) and alpha ()."""
        r, g = torch.sigmoid(unknown[:3]), torch.sigmoid(unknown[3:6])
        eta = torch.lerp((1 + r.sqrt()) / (1 - r.sqrt()), (1 - r) / (1 + r), g)
        square = (r * (eta + 1) ** 2 - (eta - 1) ** 2) / (1 - r)
        return {"eta": eta, "k": square.clamp(min=1e-8).sqrt(), "alpha": unknown[6].exp()}

    @staticmethod
    def params(unknown: torch.Tensor) -> dict[str, torch.Tensor]:
        return {f"ball.bsdf.{name}.value": value for name, value in Metal.numbers(unknown).items()}

    @staticmethod
    def plane(unknown: torch.Tensor, first: float, second: float) -> torch.Tensor:
        """The unknown with other eta and k, so many times as large."""
        eta, k, alpha = Metal.numbers(unknown).values()
        return Metal.unknown(first * eta, second * k, float(alpha))


class Glass:
    """What of the unknown is of rough glass: logarithms of eta - 1 and alpha."""

    axes = "(eta - 1) / true", "alpha / true"

    def __init__(self) -> None:
        self.bsdf = {"type": "roughdielectric", "int_ior": 1.5168, "ext_ior": 1.0, "alpha": ROUGHNESS}
        self.start = torch.tensor([0.3, 0.4]).log()

    def true(self, scene: tr.Scene) -> torch.Tensor:
        return torch.tensor([0.5168, ROUGHNESS]).log()

    @staticmethod
    def numbers(unknown: torch.Tensor) -> dict[str, torch.Tensor]:
        """eta and alpha ()."""
        return {"eta": 1 + unknown[0].exp(), "alpha": unknown[1].exp()}

    @staticmethod
    def params(unknown: torch.Tensor) -> dict[str, torch.Tensor]:
        numbers = Glass.numbers(unknown)
        return {"ball.bsdf.eta": numbers["eta"], "ball.bsdf.alpha.value": numbers["alpha"]}

    @staticmethod
    def plane(unknown: torch.Tensor, first: float, second: float) -> torch.Tensor:
        """The unknown with other eta - 1 and alpha, so many times as large."""
        return unknown + torch.nn.functional.pad(torch.tensor([first, second]).log(), (0, len(unknown) - 2))


class Plastic(Glass):
    """What of the unknown is of plastic: that of its coat, and logits of its base's reflectance in three colours."""

    def __init__(self) -> None:
        super().__init__()
        self.bsdf |= {"type": "pplastic", "diffuse_reflectance": {"type": "rgb", "value": PAINT}}
        self.start = torch.cat([self.start, torch.full((3,), 0.3).logit()])

    def true(self, scene: tr.Scene) -> torch.Tensor:
        return torch.cat([super().true(scene), torch.tensor(PAINT).logit()])

    @staticmethod
    def numbers(unknown: torch.Tensor) -> dict[str, torch.Tensor]:
        """eta and alpha (), base (3,)."""
        return {**Glass.numbers(unknown), "base": torch.sigmoid(unknown[2:5])}

    @staticmethod
    def params(unknown: torch.Tensor) -> dict[str, torch.Tensor]:
        base = Plastic.numbers(unknown)["base"]
        return {**Glass.params(unknown), "ball.bsdf.diffuse_reflectance.value": base}


MATERIALS = {"glass": Glass, "plastic": Plastic}  # all others are metals


class Experiment:
    """The ball under its sky, and pictures of it for an unknown (N,): of the material, then of the sky (9,)."""

    def __init__(self, material: Metal | Glass, resolution: int) -> None:
        self.material, self.count = material, len(material.start)
        self.panorama, self.harmonics = panorama(), harmonics()
        self.scene = tr.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": 8},
                "camera": {
                    "type": "perspective",
                    "fov": 30,
                    "to_world": tr.Transform.look_at([0, 0.9, 4.2], [0, 0, 0], [0, 1, 0]),
                    "film": {
                        "type": "hdrfilm",
                        "width": resolution,
                        "height": resolution,
                        "rfilter": {"type": "box"},
                    },
                    "sampler": {"type": "sobol"},
                },
                "sky": {"type": "envmap", "bitmap": self.panorama},
                "ball": {"type": "sphere", "bsdf": material.bsdf},
            }
        )
        self.true = torch.cat([material.true(self.scene), CHANGE])
        self.start = torch.cat([material.start, torch.zeros(9)])
        with torch.no_grad():
            shapes = tr.render(self.scene, spp=1, seed=0, outputs=("shape_id",)).shape_id
        self.ball = shapes >= 0  # (H, W)

    def picture(self, unknown: torch.Tensor, spp: int, seed: int, **settings: Any) -> torch.Tensor:
        """(H, W, 3, 4): Stokes vectors of three colours."""
        factor = torch.exp(self.harmonics @ unknown[self.count :])[..., None]
        params = {**self.material.params(unknown[: self.count]), "sky.data": self.panorama * factor}
        return tr.render(self.scene, spp=spp, seed=seed, params=params, outputs=("stokes",), **settings).stokes

    def errors(self, unknown: torch.Tensor) -> dict[str, float]:
        """Relative errors of the index, as a complex number and the largest of the colours, and of alpha."""
        found, true = (self.material.numbers(x[: self.count]) for x in (unknown, self.true))
        index, secret = (torch.complex(n["eta"], n.get("k", torch.zeros_like(n["eta"]))) for n in (found, true))
        alpha = abs(float(found["alpha"] / true["alpha"]) - 1)
        return {"index": float(((index - secret).abs() / secret.abs()).max()), "alpha": alpha}

    def derivatives(self, first: int, spp: int) -> torch.Tensor:
        """(pixels of the ball, 3, 4, n): the picture's at the truth by all of the unknown from number `first` on."""
        columns = [
            torch.func.jvp(lambda x: self.picture(x, spp, 7), (self.true,), (direction,))[1][self.ball]
            for direction in torch.eye(len(self.true))[first:]
        ]
        return torch.stack(columns, -1)

    def allowed(self, components: slice, jacobian: torch.Tensor, noise: float) -> dict[str, torch.Tensor]:
        """Standard deviations of the material's numbers that the noise of a picture allows at best."""
        seen = jacobian[:, :, components].reshape(-1, jacobian.shape[-1]).double()
        covariance = torch.linalg.inv(seen.T @ seen)[: self.count, : self.count] * noise**2
        slopes = torch.func.jacrev(self.material.numbers)(self.true[: self.count])
        return {n: ((s.double() @ covariance) * s.double()).sum(-1).sqrt() for n, s in slopes.items()}


def valleys(experiment: Experiment, span: torch.Tensor, spp: int, noise: float) -> dict[str, torch.Tensor]:
    """(n, n) losses over the plane of the material, at `span` times its true numbers, for both cameras.

    The sky is the one that suits each point best: what its derivatives span is taken from the residuals.
    """
    sky = experiment.derivatives(experiment.count, spp)
    bases = {n: torch.linalg.qr(sky[:, :, c].reshape(-1, sky.shape[-1])).Q for n, c in CAMERAS.items()}
    found: dict[str, list[float]] = {name: [] for name in CAMERAS}
    with torch.no_grad():
        target = experiment.picture(experiment.true, spp, 0)[experiment.ball]
        for second in tr.progress(span.tolist(), desc="valleys"):
            for first in span.tolist():
                material = experiment.material.plane(experiment.true[: experiment.count], first, second)
                unknown = torch.cat([material, CHANGE])
                residual = experiment.picture(unknown, spp, 0)[experiment.ball] - target
                for name, components in CAMERAS.items():
                    values = residual[:, :, components].reshape(-1)
                    values = values - bases[name] @ (bases[name].T @ values)
                    found[name].append(float(values.square().sum()) / noise**2)
    return {name: torch.tensor(values).reshape(len(span), -1) for name, values in found.items()}


def save_valleys(maps: dict[str, torch.Tensor], span: torch.Tensor, labels: tuple[str, str], path: Path) -> None:
    """Draw the contours of losses (n, n), a panel for each camera."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(maps), figsize=(9, 4), layout="constrained", sharey=True)
    high = max(float(values.max()) for values in maps.values())
    levels = [high * 2.0 ** (k - 16) for k in range(17)]
    for axis, (name, values) in zip(axes, maps.items(), strict=True):
        axis.contourf(span, span, values, levels=[0, *levels], cmap="viridis")
        axis.contour(span, span, values, levels=levels, colors="white", linewidths=0.4)
        axis.plot(1, 1, "+", color="red")
        axis.set(title=f"loss, {name}", xlabel=labels[0])
    axes[0].set_ylabel(labels[1])
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def false_colours(stokes: torch.Tensor) -> torch.Tensor:
    """Intensity, Q, U and degree of linear polarisation of a picture (H, W, 3, 4) beside each other."""
    parts = [tr.tonemap(stokes[..., 0]), *(tr.polarization.false_color(stokes, component) for component in (1, 2))]
    return torch.cat([*parts, tr.polarization.dolp(stokes)], 1).clamp(0, 1)


def run(
    folder: Path,
    *,
    material: str = "Cr",
    resolution: int = 128,
    spp: int = 8,
    spp_photograph: int = 1024,
    iterations: int = 200,
    rate: float = 0.1,
    noise: float = 0.01,
    points: int = 21,
) -> dict[str, dict[str, float]]:
    """The whole program; returns relative errors of index and roughness by camera.

    Args:
        folder: where pictures go.
        material: a metal's name, "glass" or "plastic".
        resolution: pixels along either side of the photograph.
        spp, spp_photograph: samples a pixel of a step, of the photograph.
        iterations: steps of the optimiser for each camera.
        rate: the learning rate of the first steps, in logits and logarithms.
        noise: standard deviation of each component at a pixel; white in the sun is about 1.
        points: of the losses' pictures along either side; 0 for none.
    """
    folder.mkdir(parents=True, exist_ok=True)
    chosen = MATERIALS[material]() if material in MATERIALS else Metal(material)
    experiment = Experiment(chosen, resolution)
    chance = torch.Generator().manual_seed(0)
    with torch.no_grad():
        clean = experiment.picture(experiment.true, min(spp_photograph, 64), 1000, passes=-(-spp_photograph // 64))
    photograph = clean + noise * torch.randn(clean.shape, generator=chance)
    tr.io.write_image(folder / "photograph.exr", photograph)
    tr.io.write_image(folder / "photograph.png", false_colours(photograph), raw=True)

    curves: dict[str, list[float]] = {}
    result, found = {}, {}
    for name, components in CAMERAS.items():
        unknown = experiment.start.clone().requires_grad_()
        optimiser = torch.optim.Adam([unknown], lr=rate, betas=(0.9, 0.95))
        slower = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations, rate / 100)
        curve = curves.setdefault(f"index, {name}", [])
        bar = tr.progress(range(iterations), desc=name)
        for step in bar:
            optimiser.zero_grad()
            residual = (experiment.picture(unknown, spp, step) - photograph)[experiment.ball][..., components]
            loss = residual.square().mean() / noise**2
            loss.backward()
            optimiser.step()
            slower.step()
            curve.append(experiment.errors(unknown.detach())["index"])
            bar.set_postfix(loss=f"{loss.item():.3g}", error=f"{curve[-1]:.3g}")
        found[name], result[name] = unknown.detach(), experiment.errors(unknown.detach())
        save_curves(curves, folder / "error.png", f"Relative error of the index of {material}")
        with torch.no_grad():
            tr.io.write_image(
                folder / f"{name.lower()}.png", false_colours(experiment.picture(found[name], 64, 1001)), raw=True
            )

    small = experiment if resolution <= 32 else Experiment(chosen, 32)
    jacobian = small.derivatives(0, 16)
    level = noise * 32 / resolution if small is not experiment else noise  # fewer pixels stand for as much light
    print("true:", told(chosen.numbers(experiment.true)))
    for name, components in CAMERAS.items():
        print(f"{name}:", told(chosen.numbers(found[name])))
        print("  noise allows:", told(small.allowed(components, jacobian, level)))
        print("  relative errors:", ", ".join(f"{n} {100 * e:.2f} %" for n, e in result[name].items()))
    if points:
        span = torch.linspace(0.5, 1.5, points)
        save_valleys(valleys(small, span, 16, level), span, chosen.axes, folder / "valleys.png")
    return result


def told(numbers: dict[str, torch.Tensor]) -> str:
    """Numbers by name as text."""
    return ", ".join(f"{n} {' '.join(f'{v:.4f}' for v in x.reshape(-1).tolist())}" for n, x in numbers.items())


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--material", help="a metal, such as Cr (the default), W, Au, or glass, plastic")
    parser.add_argument("--iterations", type=at_least_one, help="steps for each camera (default 200)")
    parser.add_argument("--output", type=Path, default=Path("output/polarised_ball"), help="folder for the results")
    options = parser.parse_args(argv)
    with reported(parser, "results", options.output):
        run(options.output, **given(options, "material", "iterations"))


if __name__ == "__main__":
    main()
