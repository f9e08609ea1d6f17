"""Media seen along single lines, and what is to be seen there: quadratures in double precision, and tests of means."""

from __future__ import annotations

import math

import media_scenes as ms
import numpy as np
import torch
from oracle import phases
from oracle.media import NOTHING, Media
from oracle.world import World

import torchrender as tr

SIGNIFICANCE = 1e-4  # of each test of a mean here: so often a right renderer fails it


def pencil(origin, target, size: int = 16, **more) -> dict:
    """A camera all of whose rays are one line, to a few hundred-thousandths."""
    forward = np.subtract(target, origin)
    up = (1.0, 0.0, 0.0) if abs(forward[1]) > 0.9 * np.linalg.norm(forward) else (0.0, 1.0, 0.0)
    return {
        "type": "perspective",
        "fov": 1e-3,
        "near_clip": 1e-3,
        "to_world": ms.look_at(origin, target, up),
        "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        **more,
    }


def lines(count: int, seed: int, distance: float = 4.0, spread: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Origins and targets (count, 3) of lines from all around to near the origin."""
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(count, 3))
    origins *= distance / np.linalg.norm(origins, axis=1, keepdims=True)
    return origins, rng.uniform(-spread, spread, (count, 3))


def cameras(origins: np.ndarray, targets: np.ndarray, size: int = 16, **more) -> dict:
    return {f"camera{i}": pencil(o, t, size, **more) for i, (o, t) in enumerate(zip(origins, targets, strict=True))}


def scene(objects: dict, max_depth: int = -1, rr_depth: int = 5, *, variant="rgb", dtype=torch.float32, **settings):
    integrator = {"type": "volpath", "max_depth": max_depth, "rr_depth": rr_depth, **settings}
    return tr.load_dict({"type": "scene", "integrator": integrator, **objects}, variant=variant, dtype=dtype)


def seen(view: tr.Scene, spp: int = 32, seed: int = 1, **more) -> torch.Tensor:
    """Every pixel of every camera as one run of what they see: (runs, cameras, C), float64."""
    settings = {"sampler": "independent", "sensor": list(range(len(view.sensors))), **more}
    image = tr.render(view, spp=spp, seed=seed, **settings)
    return image.double().flatten(1, 2).permute(1, 0, 2)


def assert_mean(
    runs: torch.Tensor, expected: torch.Tensor, what: str = "mean", systematic: float = 1e-4, precision: float = 0.05
) -> None:
    """Student's test of the mean of independent runs (R, ...) against `expected`, entry by entry.

    Args:
        systematic: deviation that does not count, relative to the expected value and a hundredth of the largest one:
            rounding, the width of a pencil, the error of a quadrature.
        precision: largest standard error, relative to the largest expected value, with which this is a test at all.
    """
    runs, expected = (
        runs.detach().double().reshape(len(runs), -1),
        torch.as_tensor(expected).detach().double().flatten(),
    )
    assert runs.shape[1:] == expected.shape
    assert bool(torch.isfinite(runs).all()), f"{what}: values that are not finite"
    mean, error = runs.mean(0), runs.std(0) / math.sqrt(len(runs))
    assert float(error.max()) <= precision * float(expected.abs().max()), f"{what}: noise {error.max():.2g}"
    difference = mean - expected
    allowed = systematic * (expected.abs() + 0.01 * expected.abs().max())
    excess = (difference.abs() - allowed).clamp(min=0.0)
    p = torch.where(excess == 0, 1.0, tr.testing.student_p_value(excess / error, len(runs) - 1))
    level = tr.testing.sidak(SIGNIFICANCE, len(p))
    worst = int(p.argmin())
    assert float(p[worst]) >= level, (
        f"{what}: entry {worst}: {mean[worst]:.6g} instead of {expected[worst]:.6g}, "
        f"standard error {error[worst]:.2g}, z = {difference[worst] / error[worst]:.1f}"
    )


def difference_of_means(a: torch.Tensor, b: torch.Tensor, what: str) -> None:
    """Student's test that two renderings (R, ...) with different seeds have the same mean."""
    error = (a.var(0) / len(a) + b.var(0) / len(b)).sqrt()
    z = ((a.mean(0) - b.mean(0)) / error).flatten()
    assert float(error.max()) < 0.03 * float(a.mean(0).max())
    level = tr.testing.sidak(SIGNIFICANCE, len(z))
    assert bool((tr.testing.student_p_value(z, len(a) - 1) >= level).all()), f"{what}: {z}"


# ---------------------------------------------------------------------------------------------------------- quadratures
def sphere_rule(cosines: int, azimuths: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Directions (K, 3) and their solid angles (K,)."""
    x, w = np.polynomial.legendre.leggauss(cosines)
    z, phi = np.repeat(x, azimuths), np.tile((np.arange(azimuths) + 0.5) / azimuths * 2 * np.pi, cosines)
    r = np.sqrt(1 - z * z)
    directions = np.stack([r * np.cos(phi), r * np.sin(phi), z], 1)
    return torch.from_numpy(directions), torch.from_numpy(np.repeat(w, azimuths) * 2 * np.pi / azimuths)


def constant_light(world: World, media: Media, p: torch.Tensor, d: torch.Tensor, medium: torch.Tensor) -> torch.Tensor:
    """In-scattered light (N, C), over the albedo, of a constant sky that nothing but media attenuate."""
    directions, omega = sphere_rule(16, 24)
    n, k = len(p), len(directions)
    start, w = p.repeat_interleave(k, 0), directions.repeat(n, 1)
    through = media.between(start, start + 50 * w, medium.repeat_interleave(k))
    value = scattered(world, media, start, d.repeat_interleave(k, 0), w, medium.repeat_interleave(k))
    radiance = world.tensor("emitter", world.records["emitter"][0], "radiance").expand(world.channels)
    return (through * (value * omega.repeat(n))[:, None]).reshape(n, k, -1).sum(1) * radiance


def point_light(world: World, media: Media, p: torch.Tensor, d: torch.Tensor, medium: torch.Tensor) -> torch.Tensor:
    record = world.records["emitter"][0]
    target = world.tensor("emitter", record, "position").detach().expand(len(p), 3)
    w = torch.nn.functional.normalize(target - p, dim=1)
    falloff = scattered(world, media, p, d, w, medium) / (target - p).square().sum(1)
    intensity = world.tensor("emitter", record, "intensity").expand(world.channels)
    return media.between(p, target, medium) * falloff[:, None] * intensity


def square_light(center, edge_u, edge_v):
    """An area light: a parallelogram with half edges u and v that shines to the side of u x v."""
    center, u, v = (torch.tensor(x, dtype=torch.float64) for x in (center, edge_u, edge_v))
    normal = torch.linalg.cross(u, v)
    x, w = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(6))
    points = center + x[:, None, None] * u + x[None, :, None] * v
    weights = (w[:, None] * w[None, :]).flatten() * torch.linalg.vector_norm(normal)
    points, normal = points.reshape(-1, 3), normal / torch.linalg.vector_norm(normal)

    def light(world: World, media: Media, p: torch.Tensor, d: torch.Tensor, medium: torch.Tensor) -> torch.Tensor:
        n, k = len(p), len(points)
        start, at = p.repeat_interleave(k, 0), medium.repeat_interleave(k)
        to = points.repeat(n, 1) - start
        square = to.square().sum(1)
        w = to / square.sqrt()[:, None]
        cosine = (-(w * normal).sum(1)).clamp(min=0.0)
        through = media.between(start, start + 0.998 * to, at)  # just before the light
        value = scattered(world, media, start, d.repeat_interleave(k, 0), w, at) * cosine / square * weights.repeat(n)
        radiance = _texture_value(world)
        return (through * value[:, None]).reshape(n, k, -1).sum(1) * radiance

    return light


def _texture_value(world: World) -> torch.Tensor:
    texture = world.records["texture"][world.records["emitter"][0].field["radiance"]]
    return world.tensor("texture", texture, "value").expand(world.channels)


def scattered(
    world: World, media: Media, p: torch.Tensor, before: torch.Tensor, after: torch.Tensor, medium: torch.Tensor
) -> torch.Tensor:
    value = torch.zeros(len(p), dtype=torch.float64)
    for index, some in enumerate(media.all):
        rows = (medium == index).nonzero()[:, 0]
        value = value.index_add(0, rows, phases.evaluate(world, some.phase, p[rows], before[rows], after[rows]))
    return value


def along(
    view: tr.Scene, origins: np.ndarray, targets: np.ndarray, light=None, params=None, nodes: int = 4
) -> torch.Tensor:
    """Radiance (cameras, C) of at most one scattering and of emission, in one medium with a convex boundary of `null`.

    `light` is one of the functions above; without it, there is none. Light from behind the medium is left out.
    """
    world = World(view, params)
    media = Media(world)
    (medium,) = media.all
    o = torch.tensor(origins, dtype=torch.float64)
    d = torch.nn.functional.normalize(torch.tensor(targets, dtype=torch.float64) - o, dim=1)
    enter = world.intersect(o, d)
    a = (o + d * enter.t[:, None]).detach()
    leave = world.intersect(a + 1e-6 * d, d)
    assert bool((enter.valid & leave.valid).all())
    b = (a + d * (leave.t[:, None] + 1e-6)).detach()
    total = torch.zeros(len(o), world.channels, dtype=torch.float64)
    for i in range(len(o)):
        t, weight = medium.nodes(a[i : i + 1], b[i : i + 1], nodes)
        t, weight = t[weight > 1e-12], weight[weight > 1e-12]
        p = a[i] + (b[i] - a[i]) * t[:, None]
        weight = weight * torch.linalg.vector_norm(b[i] - a[i])
        through = torch.exp(-medium.optical_depth(a[i].expand_as(p), p))
        source = medium.emission(p)
        if light is not None:
            inside = torch.zeros(len(p), dtype=torch.int64)
            arriving = light(world, media, p, d[i].expand_as(p), inside)
            source = source + medium.extinction(p) * medium.albedo(p) * arriving
        total = total.index_add(0, torch.tensor([i]), (through * source * weight[:, None]).sum(0)[None])
    return total


def transmittance(view: tr.Scene, origins: np.ndarray, targets: np.ndarray, params=None) -> torch.Tensor:
    """Of everything along the lines, to far behind the targets: (cameras, C)."""
    media = Media(World(view, params))
    o, to = (torch.tensor(x, dtype=torch.float64) for x in (origins, targets))
    return media.between(o, o + 3 * (to - o), torch.full((len(o),), NOTHING))
