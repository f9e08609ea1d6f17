"""What `tr.gradientindex.trace` refuses and warns of, and rays that it has nothing to say about."""

from __future__ import annotations

import math
import warnings

import pytest
import torch
import torch_bsdfs
from bent_scenes import BOX, DOUBLE, beam, glass, number_of, random_index

import torchrender as tr

UP = torch.tensor([[0.1, 0.2, -3.0]], dtype=DOUBLE), torch.tensor([[0.0, 0.0, 1.0]], dtype=DOUBLE)


def trace(scene, rays=UP, shape="lens", **named):
    return tr.gradientindex.trace(scene, shape, *rays, **named)


def rows(numbers: list[list[float]]) -> torch.Tensor:
    return torch.tensor(numbers, dtype=DOUBLE)


# ------------------------------------------------------------------------------------------------------- arguments
@pytest.mark.parametrize(
    ("bsdf", "what"),
    [
        *((name, f"null or dielectric as the boundary .*got {name}") for name in ("roughdielectric", "diffuse")),
        ("thindielectric", "lens.bsdf: expected null or dielectric as the boundary of the medium, got thindielectric"),
        ({"type": "mask", "opacity": 0.5, "x": {"type": "null"}}, "lens.bsdf: .* got mask"),
        ({"type": "dielectric", "int_ior": 1.7}, "lens.bsdf: .* leave out int_ior and ext_ior"),
        ({"type": "dielectric", "ext_ior": 1.3}, "lens.bsdf: .* leave out int_ior and ext_ior"),
    ],
)
def test_boundaries(bsdf, what):
    with pytest.raises(ValueError, match=r"gradientindex\.trace: " + what.replace("null or", ".*null or", 1)):
        trace(glass(1.5, bsdf))


def test_a_boundary_in_pytorch():
    scene = glass(1.5)
    scene["lens"].bsdf = torch_bsdfs.Lambert()
    with pytest.raises(ValueError, match=r"lens\.bsdf: expected null or dielectric, got one written in PyTorch"):
        trace(scene)


def test_shapes():
    scene = glass(
        1.5, others={"ball": {"type": "sphere"}, "fog": {"type": "sphere", "interior": {"type": "homogeneous"}}}
    )
    with pytest.raises(ValueError, match="the scene has no shape 'lenz'; did you mean 'lens'"):
        trace(scene, shape="lenz")
    with pytest.raises(TypeError, match=r"shape: expected the name of a shape, got 3 \(int\)"):
        trace(scene, shape=3)
    with pytest.raises(ValueError, match="ball: expected a gradientindex medium as its interior, got none"):
        trace(scene, shape="ball")
    with pytest.raises(ValueError, match="fog: expected a gradientindex medium as its interior, got homogeneous"):
        trace(scene, shape="fog")


@pytest.mark.parametrize(
    ("o", "d", "what"),
    [
        (torch.zeros(3), torch.zeros(3), r"gradientindex\.trace: origins: expected shape \(N, 3\)"),
        (torch.zeros(2, 3), torch.zeros(1, 3), r"origins have shape \(2, 3\), but directions \(1, 3\)"),
        (torch.zeros(2, 3), torch.zeros(2, 3, dtype=torch.complex64), r"directions: expected shape \(N, 3\)"),
    ],
)
def test_rays_that_are_none(o, d, what):
    with pytest.raises((TypeError, ValueError), match=what):
        trace(glass(1.5), (o, d))
    with pytest.raises(TypeError, match=r"gradientindex\.trace: scene: expected a Scene, got 3 \(int\)"):
        trace(3)


@pytest.mark.parametrize(
    ("medium", "what"),
    [
        ({"step": 0.0}, r"step: 0 is outside the range"),
        ({"step": 2.5}, r"step: 2.5 is outside the range"),
        ({"max_steps": -1}, r"max_steps: expected an integer between 0 and 1000000000, got -1"),
        ({"filename": "index.vol"}, "give one of index and filename; got index and filename"),
        ({"to_world": tr.Transform.scale([1, 1, 0])}, "to_world: the matrix is singular"),
        ({"interpolation": "nearest"}, "'nearest' has no continuous gradient"),
        ({"interpolation": "quintic"}, "interpolation: .*'quintic'"),
        ({"index_base": -2.0}, "index: expected positive indices of refraction"),
        ({"sigma_t": -1.0}, "sigma_t"),
        ({"ext_ior": 0.0}, "ext_ior"),
        ({"albedo": 0.5}, "albedo"),
    ],
)
def test_media(medium, what):
    with pytest.raises(ValueError, match=what):
        glass(1.5, **medium)


def test_indices_that_have_become_none():
    """Checked before any ray is followed, for `params` and for what an optimisation has made of the scene's own."""
    scene = glass(torch.full((4, 4, 4), 1.5))
    for bad in (math.nan, math.inf):
        values = torch.full((4, 4, 4), 1.5, dtype=DOUBLE)
        values[1, 2, 3] = bad
        with pytest.raises(ValueError, match=r"lens: expected positive indices of refraction, got (nan|inf)"):
            trace(scene, params={"lens.interior.index": values})
    with pytest.raises(ValueError, match=r"gradientindex\.trace.*lens\.interior"):
        trace(scene, params={"lens.interior.indices": torch.ones(4, 4, 4, dtype=DOUBLE)})


# ------------------------------------------------------------------------------------------------------------- rays
def nothing_in(found: tr.gradientindex.BentRays, row: int) -> bool:
    return not bool(found.valid[row]) and not any(bool(x[row].any()) for x in found)


def test_rays_that_do_not_get_through():
    """Zero in their rows, and no derivative; others are as if they were alone."""
    scene = glass(
        random_index(8),
        others={"before": {"type": "sphere", "radius": 0.2, "center": [0.5, 0.5, -2.0]}},
    )
    nan = math.nan
    o = rows([[0.1, 0.2, -3], [0, 0, -3], [nan, 0, -3], [0, 0, -3], [5, 0, -3], [0.5, 0.5, -3], [0, 0, 0], [0, 0, 3]])
    d = rows([[0.1, 0, 1], [0, 0, 0], [0, 0, 1], [0, nan, 1], [0, 0, 1], [0, 0, 1], [0, 1, 1.02], [0, 0, 1]])
    o.requires_grad_(), d.requires_grad_()
    found = trace(scene, (o, d))
    assert found.valid.tolist() == [True] + 7 * [False]
    assert all(nothing_in(found, row) for row in range(1, 8))
    alone = trace(scene, (o[:1], d[:1]))
    assert all(torch.equal(a[:1], b) for a, b in zip(found, alone))
    gradients = torch.autograd.grad(number_of(found), (o, d))
    for gradient in gradients:
        assert bool(gradient[0].any())
        assert not bool(gradient[1:].any())  # NaN would be true


def test_no_rays():
    index = random_index(4).requires_grad_()
    found = trace(glass(1.5), (torch.zeros(0, 3), torch.zeros(0, 3)), params={"lens.interior.index": index[:1, :1, :1]})
    assert [tuple(x.shape) for x in found] == [(0, 3), (0, 3), (0,), (0,), (0, 1), (0, 1), (0,), (0,), (0,), (0,)]
    (gradient,) = torch.autograd.grad(number_of(found), index)
    assert not bool(gradient.any())


def test_total_reflection_on_the_way_out():
    """From the middle at angles around that of Snell's law."""
    scene = glass(1.5, ext_ior=1.0)
    angle = torch.linspace(0.1, 0.77, 68, dtype=DOUBLE)
    d = torch.stack([angle.sin(), 0 * angle, angle.cos()], 1)
    found = trace(scene, (torch.zeros_like(d), d))
    assert torch.equal(found.valid, 1.5 * angle.sin() < 1)
    assert torch.allclose(found.direction[found.valid][:, 0], 1.5 * angle.sin()[found.valid], atol=1e-12)


def test_origins_of_other_kinds():
    scene = glass(1.5)
    wanted = trace(scene, (rows([[0.0, 0.0, -3.0]]), rows([[0.0, 0.25, 1.0]])))
    for o, d in (
        (torch.tensor([[0, 0, -3]]), torch.tensor([[0, 0.25, 1]], dtype=torch.float16)),
        ([[0, 0, -3]], [[0, 0.25, 1]]),
        (torch.tensor([[0, 0, -3]], dtype=torch.float16).numpy(), torch.tensor([[0, 1, 4]]).numpy()),
    ):
        found = trace(scene, (o, d))
        assert found.position.dtype == DOUBLE
        assert all(torch.allclose(a, b) for a, b in zip(found, wanted))
    half = torch.tensor([[0, 0, -3]], dtype=torch.float16, requires_grad=True)
    trace(scene, (half, wanted.direction.detach())).position.sum().backward()
    assert half.grad is not None and half.grad.dtype == torch.float16 and bool(half.grad.any())


# ----------------------------------------------------------------------------------------------------- shapes inside
@pytest.mark.parametrize("center", [[0.0, 0.0, 0.0], [0.3, -0.2, 0.55], [-0.31, 0.12, -0.4]])
def test_small_shapes_inside_end_rays(center):
    """A sphere of a voxel's size, in the middle of blocks and at their borders: every ray that meets it."""
    radius, inside = 0.04, torch.full((48, 48, 48), 1.5)
    others = {"dot": {"type": "sphere", "radius": radius, "center": center}}
    scene = glass(inside, "null", others=others)
    generator = torch.Generator().manual_seed(6)
    o = torch.randn(400, 3, generator=generator, dtype=DOUBLE)
    o = 4 * o / o.norm(dim=1, keepdim=True)
    towards = rows([center]) + radius * 1.5 * (torch.rand(400, 3, generator=generator, dtype=DOUBLE) * 2 - 1)
    d = towards - o
    d = d / d.norm(dim=1, keepdim=True)
    found = trace(scene, (o, d))
    to = rows([center]) - o
    distance = torch.linalg.cross(to, d).norm(dim=1)
    assert bool(found.valid.all())
    assert torch.equal(found.shape_id == 1, distance < radius)  # n is constant: rays are straight
    assert 50 < int((found.shape_id == 1).sum()) < 350
    hit = found.shape_id == 1
    assert torch.allclose(
        (found.position[hit] - rows([center])).norm(dim=1), torch.full((int(hit.sum()),), radius).double()
    )
    assert torch.allclose(found.direction[hit], d[hit], atol=1e-12)


def test_a_plate_inside_ends_rays():
    """A thin plate in the middle; derivatives are those of its place."""
    plate = {"type": "rectangle", "to_world": tr.Transform.translate([0, 0, 0.3])}
    scene = glass(random_index(16), "null", others={"plate": plate})
    found = trace(scene, beam(50))
    assert bool(found.valid.all()) and bool((found.shape_id == 1).all())
    assert torch.allclose(found.position[:, 2], torch.full((50,), 0.3, dtype=DOUBLE), atol=1e-7)


# ---------------------------------------------------------------------------------------------------------- warnings
def test_rays_that_are_lost_through_a_hole():
    scene = tr.load_dict(
        {
            "type": "scene",
            "lens": {
                "type": "rectangle",
                "flip_normals": True,
                "interior": {"type": "gradientindex", "index": torch.full((8, 8, 8), 1.5), "to_world": BOX},
                "bsdf": {"type": "null"},
            },
        },
        dtype=DOUBLE,
    )
    with pytest.warns(tr.RangeWarning, match="1 of 1 rays went further beyond the grid than it is long.*closed"):
        found = trace(scene)
    assert nothing_in(found, 0)


def test_too_few_steps():
    o, d = beam(5)
    with pytest.warns(tr.RangeWarning, match="5 of 5 rays took more than max_steps steps"):
        found = trace(glass(torch.full((16,) * 3, 1.5), max_steps=15), (o, d))
    assert not bool(found.valid.any())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert bool(trace(glass(torch.full((16,) * 3, 1.5), max_steps=17), (o, d)).valid.all())


def test_an_index_that_changes_too_fast():
    rough = random_index(8, 0.3).clamp(min=1)
    with pytest.warns(tr.RangeWarning, match=r"\|p\| / n.*is off by .*%.*make `step` smaller"):
        trace(glass(rough, "null"), beam(50))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trace(glass(rough, "null", step=0.05), beam(50))


def test_nothing_warns_where_all_is_well():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trace(glass(random_index(12)), beam(100))
