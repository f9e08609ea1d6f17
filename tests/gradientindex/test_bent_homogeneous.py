"""A constant index: rays are straight, and refracted as by a dielectric, at planes, spheres and meshes."""

from __future__ import annotations

import math

import pytest
import torch
from bent_scenes import DOUBLE, beam, glass

import torchrender as tr

OUTSIDE = 1.2


def refract(d: torch.Tensor, normal: torch.Tensor, eta: float) -> torch.Tensor:
    """Snell's law in angles, unlike the renderer's: the normal is against d, eta the index behind over that before."""
    cos = -(d * normal).sum(1, keepdim=True)
    across = d + cos * normal
    sin = across.norm(dim=1, keepdim=True)
    angle = torch.asin(sin / eta)
    return torch.where(sin > 0, across / sin.clamp(min=1e-300), across) * angle.sin() - normal * angle.cos()


def through_sphere(o: torch.Tensor, d: torch.Tensor, n: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The unit sphere: where rays come out, their directions, and lengths inside."""
    b = (o * d).sum(1)
    x = o + d * (-b - (b * b - o.square().sum(1) + 1).sqrt())[:, None]
    inside = refract(d, x, n / OUTSIDE)
    length = -2 * (x * inside).sum(1)
    y = x + inside * length[:, None]
    return y, refract(inside, -y, OUTSIDE / n), length


def fans(n: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays at several angles."""
    o, d = beam(n, width=1.4)
    turn = 0.3 * torch.randn(n, 3, generator=torch.Generator().manual_seed(3), dtype=DOUBLE)
    d = d + turn
    d = d / d.norm(dim=1, keepdim=True)
    return o - 2.5 * d + o.new_tensor([0, 0, 3]), d


@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
@pytest.mark.parametrize("n", [1.5, 0.9])
def test_a_sphere(interpolation, n):
    scene = glass(n, shape="sphere", ext_ior=OUTSIDE, interpolation=interpolation)
    o, d = fans(200)
    y, out, length = through_sphere(o, d, n)
    rays = tr.gradientindex.trace(scene, "lens", o, d)
    good = torch.isfinite(out).all(1)
    assert torch.equal(rays.valid, good)
    assert bool(good.all()) or n < OUTSIDE  # into less dense balls some are totally reflected
    assert int(good.sum()) > 100
    assert torch.allclose(rays.position[good], y[good], rtol=0, atol=1e-11)
    assert torch.allclose(rays.direction[good], out[good], rtol=0, atol=1e-11)
    assert torch.allclose(rays.length[good], length[good], rtol=0, atol=1e-11)
    assert torch.allclose(rays.optical_path[good], n * length[good], rtol=0, atol=1e-11)
    assert torch.allclose(rays.index[good], torch.full_like(length[good], n), rtol=0, atol=1e-13)


def test_a_slab_from_all_sides():
    """The cube: rays come in and out through opposite faces, and go on as they came."""
    n = 1.4
    scene = glass(torch.full((5, 6, 7), n, dtype=DOUBLE), ext_ior=OUTSIDE)
    for axis in range(3):
        for sign in (1.0, -1.0):
            o, d = (x.roll(axis + 1, 1) * sign for x in beam(50))
            rays = tr.gradientindex.trace(scene, "lens", o, d)
            assert bool(rays.valid.all())
            unit = d / d.norm(dim=1, keepdim=True)
            assert torch.allclose(rays.direction, unit, rtol=0, atol=1e-12)
            normal = torch.zeros(1, 3, dtype=DOUBLE)
            normal[0, axis] = -sign
            inside = refract(unit, normal.expand_as(unit), n / OUTSIDE)
            x = o + unit * ((-sign - o[:, axis]) / unit[:, axis])[:, None]
            y = x + inside * (2 / inside[:, axis].abs())[:, None]
            assert torch.allclose(rays.position, y, rtol=0, atol=1e-11)


def prism() -> tr.Mesh:
    """A wedge of 0.6 around the y axis, from x = -1 to its edge at x = 1, closed."""
    height = 2 * math.tan(0.3)
    corners = [[-1, -1, -height], [-1, -1, height], [1, -1, 0], [-1, 1, -height], [-1, 1, height], [1, 1, 0]]
    below, above, back = [[0, 5, 2], [0, 3, 5]], [[1, 5, 4], [1, 2, 5]], [[0, 4, 3], [0, 1, 4]]
    ends = [[0, 2, 1], [3, 4, 5]]
    return tr.Mesh(torch.tensor(corners, dtype=DOUBLE), torch.tensor([*below, *above, *back, *ends]), face_normals=True)


def test_a_prism():
    """The deviation by two planes, rays that miss the edge."""
    n = 1.45
    scene = glass(n, shape=prism(), ext_ior=OUTSIDE)
    o, d = beam(100, width=0.8)
    d = d / d.norm(dim=1, keepdim=True)
    rays = tr.gradientindex.trace(scene, "lens", o, d)
    assert bool(rays.valid.all())
    below = torch.tensor([[math.sin(0.3), 0, math.cos(0.3)]], dtype=DOUBLE) * torch.tensor([1.0, 1.0, -1.0])
    above = torch.tensor([[math.sin(0.3), 0, math.cos(0.3)]], dtype=DOUBLE)
    edge = torch.tensor([[1.0, 0, 0]], dtype=DOUBLE)
    x = o + d * (((edge - o) * below).sum(1) / (d * below).sum(1))[:, None]
    inside = refract(d, below.expand_as(d), n / OUTSIDE)
    y = x + inside * (((edge - x) * above).sum(1) / (inside * above).sum(1))[:, None]
    out = refract(inside, -above.expand_as(d), OUTSIDE / n)
    assert float((out - d).norm(dim=1).min()) > 0.1
    assert torch.allclose(rays.position, y, rtol=0, atol=1e-11)
    assert torch.allclose(rays.direction, out, rtol=0, atol=1e-11)


def test_small_differences_keep_their_precision_in_float32():
    """n - 1 of air, as a difference from `index_base`: the angle by which a gradient turns rays, to 2 in 1000.

    Velocities are multiples of 2^-28: a kick of 1e-6 is rounded by a thousandth, where 32 bits of n would know its
    gradient to a tenth only.
    """
    # n^2 linear in x, over a box of 2: p_x grows by 2 grad(n^2) / 2 / p_z
    line = (torch.arange(16, dtype=DOUBLE) + 0.5) / 16 * 4 - 2
    base, amount = 1.000277, 1e-5
    square = base**2 + amount * line
    wide = tr.Transform.translate([-2] * 3) @ tr.Transform.scale(4)
    turned = []
    for dtype in (torch.float32, DOUBLE):
        index = ((square.sqrt() - base) / 1e-5).expand(16, 16, 16).contiguous()
        scene = glass(index, "null", dtype, to_world=wide, index_base=base, index_scale=1e-5)
        rays = tr.gradientindex.trace(scene, "lens", [[0.1, 0.2, -2.0]], [[0.0, 0.0, 1.0]])
        turned.append(float(rays.direction[0, 0]))
    assert turned[1] == pytest.approx(amount / base**2, rel=1e-4)
    assert turned[0] == pytest.approx(turned[1], rel=2e-3)
