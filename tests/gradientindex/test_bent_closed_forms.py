"""Rays through media whose rays are known: rod, Luneburg's ball, Maxwell's fish-eye, and a ramp."""

from __future__ import annotations

import math

import pytest
import torch
from bent_scenes import DOUBLE, beam, centers, glass, square_box

import torchrender as tr

STEPS = [1.0, 0.5, 0.25, 0.125, 0.0625]
# A spline whose control values are the samples of x^2 is x^2 and this, in voxels, everywhere (de Boor, 1978)
OF_SQUARES = {"cubic": 1 / 3, "quadratic": 1 / 4}


def ball_index(size: int, half: float, interpolation: str = "cubic") -> torch.Tensor:
    """Control values of n^2 = 2 - r^2, exactly, as far as n^2 is above 0.2."""
    x, y, z = centers(size, half)
    square = 2 - (x * x + y * y + z * z) + 3 * OF_SQUARES[interpolation] * (2 * half / size) ** 2
    return square.clamp(min=0.2).sqrt()


def rod(interpolation: str, step: float = 1.0, size: int = 24) -> tuple[tr.Scene, float, float]:
    """n^2 = n0^2 (1 - a^2 r^2) around the z axis, held exactly: the grid is larger than the cube."""
    n0, a, half = 1.5, 0.4, 1.5
    x, y, _ = centers(size, half)
    square = n0**2 * (1 - a**2 * (x * x + y * y - 2 * OF_SQUARES[interpolation] * (2 * half / size) ** 2))
    scene = glass(square.sqrt(), "null", to_world=square_box(half), interpolation=interpolation, step=step)
    return scene, n0, a


def through_rod(o: torch.Tensor, d: torch.Tensor, n0: float, a: float) -> tuple[torch.Tensor, ...]:
    """Position, direction and optical path at z = 1 of rays that come in at z = -1.

    In dt = ds / n positions are those of a harmonic oscillator, p_z is constant.
    """
    d = d / d.norm(dim=1, keepdim=True)
    x = o + d * ((-1 - o[:, 2:]) / d[:, 2:])
    p = d * (n0 * (1 - a**2 * x[:, :2].square().sum(1)).sqrt())[:, None]
    w, t = n0 * a, 2 / p[:, 2:]
    cos, sin = torch.cos(w * t), torch.sin(w * t)
    at = torch.cat([x[:, :2] * cos + p[:, :2] / w * sin, torch.ones_like(t)], 1)
    to = torch.cat([p[:, :2] * cos - w * x[:, :2] * sin, p[:, 2:]], 1)
    # the integral of n^2 dt, n^2 = n0^2 - w^2 r^2
    xx, pp, xp = x[:, :2].square(), p[:, :2].square() / w**2, x[:, :2] * p[:, :2] / w
    square = xx * (t / 2 + sin * cos / (2 * w)) + pp * (t / 2 - sin * cos / (2 * w)) + xp * sin**2 / w
    optical = n0**2 * t[:, 0] - w**2 * square.sum(1)
    return at, to / to.norm(dim=1, keepdim=True), optical


def slope_of(errors: list[float]) -> float:
    x, y = torch.tensor(STEPS).log2(), torch.tensor(errors).log2()
    return float(((x - x.mean()) * (y - y.mean())).sum() / (x - x.mean()).square().sum())


@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
def test_errors_in_a_rod_are_of_second_order(interpolation):
    o, d = beam(50)
    d = d + torch.tensor([0.1, -0.2, 0.0], dtype=DOUBLE)
    errors = []
    for step in STEPS:
        scene, n0, a = rod(interpolation, step)
        rays = tr.gradientindex.trace(scene, "lens", o, d)
        assert bool(rays.valid.all())
        exact = through_rod(o, d, n0, a)
        found = (rays.position, rays.direction, rays.optical_path)
        errors.append([float((f - e).abs().max()) for f, e in zip(found, exact)])
    position, direction, path = ([float(e) for e in column] for column in zip(*errors))
    assert slope_of(position) == pytest.approx(2, abs=0.15)
    assert slope_of(direction) == pytest.approx(2, abs=0.15)
    # that of paths is as large as tau (1 - tau) also says, tau the part of the last step, which jumps from step to step
    assert all(e < 2e-4 * step**2 for e, step in zip(path, STEPS))
    assert position[-1] < 1e-6 and direction[-1] < 2e-7


@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_luneburg_ball_makes_a_point(interpolation, axis):
    """Parallel rays meet at the antipode, after equal optical paths; R is 28 voxels."""
    half = 32 / 28
    scene = glass(
        ball_index(64, half, interpolation),
        "null",
        shape="sphere",
        to_world=square_box(half),
        interpolation=interpolation,
    )
    o, _ = beam(200, width=1.3)
    d = torch.tensor([[0.0, 0.0, 1.0]], dtype=DOUBLE).expand(len(o), 3)
    rays = tr.gradientindex.trace(scene, "lens", o.roll(axis + 1, 1), d.roll(axis + 1, 1))
    assert bool(rays.valid.all())
    antipode = d.roll(axis + 1, 1)
    spot = float((rays.position - antipode).norm(dim=1).max())
    entry = -(1 - o[:, :2].square().sum(1)).sqrt()
    path = rays.optical_path + (entry + 1)  # from a plane wave that touches the ball
    assert spot < 1e-4
    assert float((path - path.mean()).abs().max()) < 1e-5
    assert float(path.mean()) == pytest.approx(math.pi / 2 + 1, abs=3e-4)  # a step is a thirtieth


def test_a_fish_eye_has_an_image():
    """n = 2 / (1 + r^2): rays from x meet at -x / |x|^2 (Born and Wolf, "Principles of Optics", section 4.2.2)."""
    errors = []
    for size in (32, 64, 128):
        x, y, z = centers(size, 1.5)
        index = tr.gradientindex.fit(2 / (1 + x * x + y * y + z * z))
        ball = {"type": "sphere", "radius": 1.25}
        scene = glass(index, "null", shape=ball, to_world=square_box(1.5))
        angle = torch.linspace(-1.2, 1.2, 500, dtype=DOUBLE)
        d = torch.stack([-angle.cos(), angle.sin() * 0.8, angle.sin() * 0.6], 1)
        o = torch.tensor([0.8, 0.0, 0.0], dtype=DOUBLE).expand_as(d)
        rays = tr.gradientindex.trace(scene, "lens", o, d)
        assert bool(rays.valid.all())
        off = (rays.position - torch.tensor([-1.25, 0, 0], dtype=DOUBLE)).norm(dim=1)
        errors.append(float(off.square().mean().sqrt()))
    assert errors[0] > 3.8 * errors[1] and errors[1] > 3.8 * errors[2]  # of second order, as steps are voxels
    assert errors[1] < 5e-4


def moment(rays: tr.gradientindex.BentRays) -> torch.Tensor:
    return torch.linalg.cross(rays.position, rays.direction * rays.index[:, None])


def test_the_moment_of_rays_around_a_center_stays():
    """Bouguer's invariant x cross n d, but for what |p| is off from n; exactly in its plane if all is symmetric."""
    o, d = beam(100, width=1.2)
    d = d / d.norm(dim=1, keepdim=True)
    half = 32 / 28
    x, y, z = centers(64, half)
    fish_eye = tr.gradientindex.fit(2 / (1 + x * x + y * y + z * z))
    for index, tolerance, turned in ((ball_index(64, half), 1e-6, 1e-12), (fish_eye, 1e-4, 1e-4)):
        scene = glass(index, "null", shape="sphere", to_world=square_box(half))
        rays = tr.gradientindex.trace(scene, "lens", o, d)
        assert bool(rays.valid.all())
        # n is 1 at the sphere of both: nothing but the direction's length is to be known
        before, after = torch.linalg.cross(o, d), moment(rays)
        assert float((after - before).norm(dim=1).max()) < tolerance
        plane = torch.linalg.cross(before, after).norm(dim=1) / before.square().sum(1)
        assert float(plane.max()) < turned


def test_a_steep_ramp_refracts():
    """From 1 to 1.5 over two voxels: Snell's law."""
    index = torch.ones(32, 1, 1, dtype=DOUBLE)
    index[15:17, 0, 0] = torch.tensor([1 + 1 / 6, 1 + 1 / 3], dtype=DOUBLE)
    index[17:] = 1.5
    voxels = tr.Transform.translate([-16, -16, -1]) @ tr.Transform.scale([32, 32, 2])
    for degrees in (10, 25, 40):
        angle = math.radians(degrees)
        scene = glass(index, "null", to_world=voxels, step=0.25)
        d = [[math.sin(angle), 0.0, math.cos(angle)]]
        rays = tr.gradientindex.trace(scene, "lens", [[-math.tan(angle), 0.0, -2.0]], d)
        assert bool(rays.valid[0])
        out = math.asin(float(rays.direction[0, 0]))
        assert out == pytest.approx(math.asin(math.sin(angle) / 1.5), abs=1e-4)


def test_absorption_is_by_length():
    scene, n0, a = rod("cubic", 0.0625)
    scene["lens"].interior.sigma_t = torch.tensor([0.0, 0.5, 2.0])
    o, d = beam(50)
    rays = tr.gradientindex.trace(scene, "lens", o, d)
    assert rays.transmittance.shape == (50, 3)
    sigma = torch.tensor([0.0, 0.5, 2.0], dtype=DOUBLE)
    assert torch.allclose(rays.transmittance, torch.exp(-sigma * rays.length[:, None]), rtol=1e-14, atol=0)
    # the length of the rod's path by Simpson's rule over dt, of ds = n dt
    d = d / d.norm(dim=1, keepdim=True)
    x = o + d * ((-1 - o[:, 2:]) / d[:, 2:])
    p = d * (n0 * (1 - a**2 * x[:, :2].square().sum(1)).sqrt())[:, None]
    w, n = n0 * a, 200
    t = 2 / p[:, 2:] * torch.linspace(0, 1, n + 1, dtype=DOUBLE)
    r2 = sum((x[:, k : k + 1] * (w * t).cos() + p[:, k : k + 1] / w * (w * t).sin()).square() for k in (0, 1))
    weight = torch.tensor([1.0, *[4.0, 2.0] * (n // 2 - 1), 4.0, 1.0], dtype=DOUBLE) / (3 * n)
    length = ((n0 * (1 - a**2 * r2).sqrt()) * weight).sum(1) * 2 / p[:, 2]
    assert torch.allclose(rays.length, length, rtol=0, atol=1e-6)
