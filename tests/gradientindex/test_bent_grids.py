"""Grids that are turned, mirrored, sheared, long or uneven; single precision; and rays at edges."""

from __future__ import annotations

import warnings

import pytest
import torch
from bent_scenes import (
    BOX,
    DOUBLE,
    beam,
    difference,
    direction_like,
    glass,
    in_both_modes,
    number_of,
    random_index,
    square_box,
)

import torchrender as tr

TURN = tr.Transform.rotate([1, 2, 3], 40) @ tr.Transform.rotate([0, 1, 0], 25)
MIRROR = tr.Transform.scale([1, -1, 1])


def matrix(transform: object) -> torch.Tensor:
    return torch.as_tensor(getattr(transform, "matrix", transform), dtype=DOUBLE)


def sheared(amount: float = 0.3) -> torch.Tensor:
    """The cube of side 4 around the origin, with axes that are not at right angles."""
    shear = torch.eye(4, dtype=DOUBLE)
    shear[0, 1], shear[1, 2], shear[2, 0] = amount, -0.5 * amount, 0.7 * amount
    return shear @ matrix(square_box(2.0))


@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
@pytest.mark.parametrize("moved", [TURN, MIRROR, TURN @ MIRROR], ids=["turned", "mirrored", "both"])
def test_turning_everything_turns_the_rays(moved, interpolation):
    index, (o, d) = random_index(9), beam(60)
    ball = {"type": "sphere", "radius": 0.9}
    straight = glass(index, shape=ball, interpolation=interpolation)
    turned = glass(index, shape=ball, interpolation=interpolation, to_world=matrix(moved) @ matrix(BOX))
    turn = matrix(moved)[:3, :3]
    a = tr.gradientindex.trace(straight, "lens", o, d)
    b = tr.gradientindex.trace(turned, "lens", o @ turn.T, d @ turn.T)
    assert bool(a.valid.all()) and torch.equal(a.valid, b.valid) and torch.equal(a.steps, b.steps)
    assert torch.allclose(a.position @ turn.T, b.position, rtol=0, atol=1e-11)
    assert torch.allclose(a.direction @ turn.T, b.direction, rtol=0, atol=1e-11)
    assert torch.allclose(a.optical_path, b.optical_path, rtol=1e-11)
    assert torch.allclose(a.length, b.length, rtol=1e-11)


def test_a_constant_force_in_a_sheared_grid():
    """n^2 = 2.25 + 2 f . x, exactly, in any affine grid: rays are parabolas in dt = ds / n."""
    force = torch.tensor([0.15, -0.1, 0.05], dtype=DOUBLE)
    place, size = sheared(), 14
    line = (torch.arange(size, dtype=DOUBLE) + 0.5) / size
    z, y, x = torch.meshgrid(line, line, line, indexing="ij")
    centers = torch.stack([x, y, z, torch.ones_like(x)], -1) @ place.T
    index = (2.25 + 2 * (centers[..., :3] * force).sum(-1)).sqrt()
    o, d = beam(40)
    d = d / d.norm(dim=1, keepdim=True)
    at = o + d * ((-1 - o[:, 2:]) / d[:, 2:])
    p = d * (2.25 + 2 * (at * force).sum(1, keepdim=True)).sqrt()
    # -1 + p_z t + f_z t^2 / 2 = 1
    t = 4 / (p[:, 2:] + (p[:, 2:].square() + 4 * force[2]).sqrt())
    errors = []
    for step in (1.0, 0.5, 0.25):
        scene = glass(index, "null", to_world=place, step=step)
        rays = tr.gradientindex.trace(scene, "lens", o, d)
        assert bool(rays.valid.all())
        position, velocity = at + p * t + force * t * t / 2, p + force * t
        off = (rays.position - position).norm(dim=1).max()
        turned = (rays.direction - velocity / velocity.norm(dim=1, keepdim=True)).norm(dim=1).max()
        errors.append((float(off), float(turned)))
        # a chord of the parabola is an eighth of f dt^2 from it at most; its last kick makes the velocity exact
        assert float(off) < 0.25 * float(force.norm()) * (step * 4 / size / 1.2) ** 2
    assert errors[-1][0] < 2e-4 and errors[-1][1] < 1e-4


@pytest.mark.parametrize("name", ["index", "to_world", "index_scale"])
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_derivatives_in_a_sheared_grid(name, dtype):
    """Kicks are not along the gradient here; all six numbers of their matrix count."""
    place = sheared().to(dtype)
    scene = glass(random_index(20).to(dtype), "null", dtype, to_world=place)
    rays = tuple(r.to(dtype) for r in beam(40, width=0.8))
    x = scene.get_parameter(f"lens.interior.{name}").detach()
    along = direction_like(x)
    if name == "to_world":
        # steps are as long as the shortest side of voxels, which must not change: of the first column the length stays
        along[3] = 0
        lengths = (place[:3, :3] / 4).norm(dim=0)
        k = int(lengths.argmin())
        along[:3, k] -= place[:3, k] * (along[:3, k] * place[:3, k]).sum() / place[:3, k].square().sum()

    def f(value):
        return number_of(tr.gradientindex.trace(scene, "lens", *rays, params={f"lens.interior.{name}": value}))

    reverse, forward = in_both_modes(f, x, along)
    assert abs(reverse) > 0.1
    assert forward == pytest.approx(reverse, rel=1e-3 if dtype == torch.float32 else 1e-10)
    if dtype == DOUBLE:
        assert difference(f, x, along, 2e-6) == pytest.approx(reverse, rel=1e-6)


@pytest.mark.core
@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
def test_single_precision(interpolation):
    """Positions to 1e-4 of a voxel after some 70 steps, of rays that go in at equal places to the last bit."""
    index = random_index(64, 0.002)
    o, d = (r.float() for r in beam(300))
    results = []
    for dtype in (torch.float32, DOUBLE):
        scene = glass(index.float().to(dtype), "null", dtype, interpolation=interpolation)
        results.append(tr.gradientindex.trace(scene, "lens", o.to(dtype), d.to(dtype)))
    single, double = results
    assert torch.equal(single.valid, double.valid) and bool(double.valid.all())
    assert float((single.position - double.position).norm(dim=1).max()) < 1e-4 * 2 / 64
    assert float((single.direction - double.direction).norm(dim=1).max()) < 1e-5
    assert torch.allclose(single.optical_path.double(), double.optical_path, rtol=3e-6)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_longest_grids(axis, dtype):
    """1000 voxels along one axis, 1 along others: nothing overflows, straight rays come out where they should.

    In single precision places are multiples of 2^-20 voxels, here of the side: every drift may be half of that off.
    """
    shape = [1, 1, 1]
    shape[2 - axis] = 1000
    scene = glass(torch.full(shape, 1.5), "null", dtype)
    for o, d in ((beam(20)), (x * -1 for x in beam(20))):
        o, d = o.roll(axis + 1, 1), d.roll(axis + 1, 1)
        rays = tr.gradientindex.trace(scene, "lens", o, d)
        assert bool(rays.valid.all()) and int(rays.steps.min()) > 900
        d = d / d.norm(dim=1, keepdim=True)
        exact = o + d * ((1 - o * d.sign()) / d.abs())[:, axis : axis + 1]
        assert torch.allclose(
            rays.position.double(), exact, rtol=0, atol=1.05 * 1000 * 2**-20 if dtype == torch.float32 else 1e-9
        )


def test_fewest_voxels():
    """One along every axis; two, whose gradient is largest in the middle."""
    for shape in ((1, 1, 1), (2, 1, 1), (1, 2, 1), (1, 1, 2)):
        index = 1.5 + 0.01 * torch.arange(2, dtype=DOUBLE)[: max(shape)].reshape(shape)
        rays = tr.gradientindex.trace(glass(index, "null", step=0.2), "lens", *beam(10))
        assert bool(rays.valid.all())
        assert bool((rays.index > 1.5 - 1e-12).all()) and bool((rays.index < 1.51 + 1e-12).all())


@pytest.mark.core
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("shape", ["cube", "sphere"])
def test_hardly_a_ray_is_lost(shape, dtype):
    """From all sides, those that graze included: none of these is. Values are finite in any case."""
    n, generator = 8000, torch.Generator().manual_seed(8)
    o = torch.randn(n, 3, generator=generator, dtype=DOUBLE)
    o = 4 * o / o.norm(dim=1, keepdim=True)
    d = torch.rand(n, 3, generator=generator, dtype=DOUBLE) * 2 - 1 - o
    scene = glass(random_index(12, 0.01), "null", dtype, shape=shape)
    hits = tr.ray_intersect(scene, o, d)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tr.RangeWarning)
        rays = tr.gradientindex.trace(scene, "lens", o, d)
    lost = int((hits.valid & ~rays.valid).sum())
    assert lost == 0
    assert not bool((rays.valid & ~hits.valid).any())
    for found in rays[:6]:
        assert bool(torch.isfinite(found).all())


def test_edges_end_no_ray_in_a_loop():
    """Rays into the cube within 1e-4 of its edges: hardly one is lost, none hangs or gives what is not a number."""
    n, generator = 5000, torch.Generator().manual_seed(9)
    signs = torch.randn(n, 3, generator=generator, dtype=DOUBLE).sign()
    along = torch.randint(3, (n,), generator=generator)
    free = torch.nn.functional.one_hot(along, 3).bool()
    at = signs * (1 - 1e-4 * torch.rand(n, 3, generator=generator, dtype=DOUBLE))
    at = torch.where(free, torch.rand(n, 3, generator=generator, dtype=DOUBLE) * 2 - 1, at)
    o = torch.randn(n, 3, generator=generator, dtype=DOUBLE)
    o = 4 * o / o.norm(dim=1, keepdim=True)
    for dtype in (torch.float32, DOUBLE):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tr.RangeWarning)
            rays = tr.gradientindex.trace(glass(random_index(12), "dielectric", dtype), "lens", o, at - o)
        assert all(bool(torch.isfinite(found).all()) for found in rays[:6])
        assert int(rays.valid.sum()) > 0.2 * n  # others are totally reflected


def above_a_road(step: float, dtype: torch.dtype = DOUBLE, **medium: object) -> tuple[tr.Scene, torch.Tensor]:
    """Layers of 2 cm of hot air, 400 m long: voxels of 5 m along z."""
    heights = (torch.arange(32, dtype=DOUBLE) + 0.5) * 0.02
    values = -2.3 * torch.exp(-heights / 0.1)
    index = values[None, :, None].expand(80, 32, 4).contiguous()
    place = tr.Transform.translate([-10, 0, 0]) @ tr.Transform.scale([20, 0.64, 400])
    box = {"type": "cube", "to_world": place @ tr.Transform.scale(0.5) @ tr.Transform.translate([1, 1, 1])}
    medium = {"index_base": 1.00027, "index_scale": 1e-5, "to_world": place, "step": step, **medium}
    return glass(index, "null", dtype, box, **medium), index


def flat_rays(n: int = 20) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays that come down at 4 to 6 mrad; the mirage is below 6.8."""
    angle = torch.linspace(-4e-3, -6e-3, n, dtype=DOUBLE)
    o = torch.tensor([0.0, 0.6, -1.0], dtype=DOUBLE).expand(n, 3)
    return o, torch.stack([torch.zeros_like(angle), torch.sin(angle), torch.cos(angle)], 1)


@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
def test_long_steps_through_long_voxels(interpolation):
    """A mirage: in layers p stays along them, rays come out as flat as they came in, and long steps find the same."""
    o, d = flat_rays()
    found = {}
    for step in (10.0, 100.0):
        scene, _ = above_a_road(step, interpolation=interpolation)
        rays = tr.gradientindex.trace(scene, "lens", o, d)
        assert bool(rays.valid.all()) and float(rays.steps.double().mean()) < 500 / (0.02 * step)
        assert torch.allclose(rays.index * rays.direction[:, 2], 1.00027 * d[:, 2], rtol=0, atol=1e-7)
        found[step] = rays
    up = found[10.0].direction[:, 1]
    assert torch.allclose(up, -d[:, 1], rtol=2e-3)  # less by what is left of the heat at the top
    assert torch.allclose(found[100.0].direction, found[10.0].direction, rtol=0, atol=1e-6)
    assert torch.allclose(found[100.0].position, found[10.0].position, rtol=0, atol=0.03)  # of 300 m


def test_derivatives_by_the_heat_of_a_road():
    o, d = flat_rays()
    scene, index = above_a_road(100.0)
    weight = torch.linspace(0.5, 1.5, len(o), dtype=DOUBLE)

    def f(values):
        rays = tr.gradientindex.trace(scene, "lens", o, d, params={"lens.interior.index": values})
        return (weight * (rays.direction[:, 1] * 1e3 + rays.position[:, 1])).sum()

    along = direction_like(index[0, :, 0])[None, :, None].expand_as(index).contiguous()
    reverse, forward = in_both_modes(f, index, along)
    assert abs(reverse) > 0.1
    assert forward == pytest.approx(reverse, rel=1e-9)
    assert difference(f, index, along, 1e-6) == pytest.approx(reverse, rel=1e-5)


@pytest.mark.parametrize(("step", "dtype", "most"), [(5.0, torch.float32, "4"), (257.0, DOUBLE, "256")])
def test_steps_that_are_too_long_for_a_precision(step, dtype, most):
    with pytest.raises(ValueError, match=rf"step: .*range.*{most}"):
        above_a_road(step, dtype)
