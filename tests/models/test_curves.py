"""`bsplinecurve` and `linearcurve`: hits, coordinates, files, refusals, and what an optimiser does with them. The
renderer's images and derivatives of them are held against PyTorch in test_oracle.py and against differences in
test_motion_derivatives.py."""

from __future__ import annotations

import pytest
import torch

import torchrender as tr
from torchrender.curves import Segments

DOUBLE = torch.float64
# Two curves: five rows and four.
TEXT = """-1 0 0 0.2
0 0 0.3 0.3
1 0.5 0 0.2
2 0 0.2 0.1
3 0 0 0.2
4 1 0.5 0.2

0 3 0 0.2
1 3 0 0.2
2 3 0 0.2
3 3 0 0.2
"""
POINTS = torch.tensor([[float(x) for x in line.split()] for line in TEXT.splitlines() if line], dtype=DOUBLE)
# Mitsuba 3.9.1, llvm_ad_rgb: place (x, y) of a ray along -z from z = 5, distance, uv, normal
REFERENCE = {
    "bsplinecurve": [
        ((0.5, 0.1), 4.63038, (0.339013, 0.107249), (0.341385, -0.445591, 0.82759)),
        ((0.9, 0.3), 4.69755, (0.271535, 0.218832), (0.221147, -0.109983, 0.969019)),
        ((1.5, 0.1), 4.82311, (0.422035, 0.386632), (-0.243607, -0.846453, 0.473469)),
        ((2.2, 0.1), 4.74788, (0.183386, 0.546278), (0.07775, 0.39913, 0.913592)),
        ((1.2, 2.9), 4.82679, (0.333333, 0.8), (0.0, -0.5, 0.866026)),
    ],
    "linearcurve": [
        ((0.5, 0.1), 4.59875, (0.335489, 0.171017), (0.501015, -0.319432, 0.80433)),
        ((1.5, 0.1), 4.83558, (0.441562, 0.319618), (-0.394584, -0.842167, 0.367503)),
        ((2.2, 0.1), 4.77366, (0.0917954, 0.399846), (0.0102765, 0.83419, 0.551381)),
        ((1.2, 2.9), 4.82679, (0.333333, 0.775), (0.0, -0.5, 0.866026)),
        ((0.0, 3.05), 4.80635, (0.209785, 0.625), (0.0, 0.25, 0.968246)),
    ],
}


def scene_of(kind: str = "bsplinecurve", dtype: torch.dtype = DOUBLE, **properties) -> tr.Scene:
    return tr.load_dict({"type": "scene", "curve": {"type": kind, **properties}}, dtype=dtype)


def shoot(scene: tr.Scene, origins, directions):
    o, d = (torch.as_tensor(v, dtype=scene.dtype) for v in (origins, directions))
    return tr.ray_intersect(scene, o, d.expand_as(o))


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "curves.txt"
    path.write_text(TEXT)
    return path


@pytest.mark.core
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("kind", list(REFERENCE))
def test_hits_are_those_of_mitsuba(kind, dtype, file):
    scene = scene_of(kind, dtype, filename=str(file))
    places, t, uv, normal = (torch.tensor(column, dtype=dtype) for column in zip(*REFERENCE[kind]))
    hits = shoot(scene, torch.nn.functional.pad(places, (0, 1), value=5.0), [0.0, 0, -1])
    for ours, theirs in ((hits.t, t), (hits.uv, uv), (hits.normal, normal)):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=2e-5)
    view = {"type": "orthographic", "to_world": tr.Transform.look_at([1, 1.5, 5], [1, 1.5, 0], [0, 1, 0]).scale(2)}
    scene["camera"] = {**view, "film": {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}}
    outputs = tr.render(scene, spp=1, outputs=("uv", "shading_normal", "position", "prim_id", "distance"), seed=1)
    seen = outputs.distance.isfinite()
    o = outputs.position[seen] + torch.tensor([0, 0, 1.0], dtype=dtype)
    again = shoot(scene, o, [0.0, 0, -1])  # in PyTorch what the core has written into the outputs
    assert int(seen.sum()) > 300
    close = again.t.sub(1).abs() < 1e-4  # not the few that graze
    assert float(close.double().mean()) > 0.98
    for ours, theirs in ((again.uv, outputs.uv), (again.normal, outputs.shading_normal)):
        torch.testing.assert_close(ours[close], theirs[seen][close], rtol=0, atol=5e-3)


def test_a_straight_spline_is_a_cylinder():
    """Collinear points at equal distances and equal radii: from the second to the last but one."""
    points = torch.tensor([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], dtype=DOUBLE)
    curve = scene_of(control_points=points, radii=0.4)
    cylinder = tr.load_dict(
        {"type": "scene", "c": {"type": "cylinder", "p0": [0, 0, 0], "p1": [2, 0, 0], "radius": 0.4}}, dtype=DOUBLE
    )
    generator = torch.Generator().manual_seed(1)
    target = torch.rand(500, 3, generator=generator, dtype=DOUBLE) * torch.tensor([3.0, 1, 1]) - 0.5
    o = target + 6 * torch.nn.functional.normalize(torch.randn(500, 3, generator=generator, dtype=DOUBLE), dim=1)
    a, b = (tr.ray_intersect(s, o, target - o) for s in (curve, cylinder))
    outside = b.valid & (((target - o) * b.normal).sum(1) < 0)  # through an open end a cylinder shows its inside
    assert int(outside.sum()) > 200
    assert torch.equal(a.valid[outside], b.valid[outside]) and not bool(a.valid[~b.valid].any())
    torch.testing.assert_close(a.t[outside], b.t[outside], rtol=1e-9, atol=0)
    torch.testing.assert_close(a.normal[outside], b.normal[outside])
    torch.testing.assert_close(a.uv[outside][:, 1], b.uv[outside][:, 1])


@pytest.mark.parametrize("seed", range(3))
def test_a_straight_segment_is_the_hull_of_its_spheres(seed):
    """Every hit has the least distance r to the segment's family of spheres, and none lies within one."""
    generator = torch.Generator().manual_seed(seed)
    ends = torch.rand(2, 3, generator=generator, dtype=DOUBLE)
    radii = torch.tensor([0.2, 0.35], dtype=DOUBLE)
    scene = scene_of("linearcurve", control_points=ends * torch.tensor([2.0, 1, 1]), radii=radii)
    target = torch.randn(800, 3, generator=generator, dtype=DOUBLE) * 0.4 + ends.mean(0) * torch.tensor([2.0, 1, 1])
    o = target + 6 * torch.nn.functional.normalize(torch.randn(800, 3, generator=generator, dtype=DOUBLE), dim=1)
    hits = tr.ray_intersect(scene, o, target - o)
    w = torch.linspace(0, 1, 4001, dtype=DOUBLE)[:, None]
    centers = (1 - w) * scene.curve.control_points[0] + w * scene.curve.control_points[1]
    p = hits.position[hits.valid].detach()
    gap = torch.cdist(p, centers) - ((1 - w) * radii[0] + w * radii[1])[:, 0]
    assert len(p) > 200
    assert float(gap.amin(1).abs().max()) < 1e-6
    # all that pass through a sphere of the family hit
    d = torch.nn.functional.normalize(target - o, dim=1)
    along = ((centers[::40] - o[:, None]) * d[:, None]).sum(2)
    apart = (o[:, None] + along[..., None] * d[:, None] - centers[::40]).norm(dim=2)
    inside = (apart < ((1 - w) * radii[0] + w * radii[1])[::40, 0] - 1e-5).any(1)
    assert bool(hits.valid[inside].all())


@pytest.mark.parametrize("kind", list(REFERENCE))
def test_rays_from_within_go_out_unseen(kind):
    scene = scene_of(kind, torch.float32, control_points=POINTS[:, :3], radii=POINTS[:, 3], segment_indices=[6])
    o = torch.tensor([[0.9 if kind == "linearcurve" else 1.5, 3.0, 0.0]]).expand(64, 3)
    d = torch.randn(64, 3, generator=torch.Generator().manual_seed(2))
    assert not bool(tr.ray_intersect(scene, o, d).valid.any())
    assert not bool(tr.ray_occluded(scene, o, d).any())
    assert bool(
        tr.ray_intersect(scene, o + torch.tensor([0.0, 0, 5]), torch.tensor([[0.0, 0, -1]]).expand(64, 3)).valid.all()
    )


def test_joints_and_ends_are_round():
    """A bend of two cones from all sides: nothing is seen through the joint, and both ends are closed."""
    scene = scene_of("linearcurve", control_points=[[0.0, 0, 0], [1, 0, 0], [1, 1, 0]], radii=[0.2, 0.4, 0.2])
    # just beyond the end; a ray along the axis begins within the cone for Embree, so beside it
    hits = shoot(
        scene, [[1.05, 5.0, 0.0], [-5.0, 0.1, 0], [1.2, -0.1, 5]], torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, -1]])
    )
    expected = [5 - 1 - (0.04 - 0.0025) ** 0.5, 5 - (0.04 - 0.01) ** 0.5, 5 - (0.16 - 0.05) ** 0.5]
    torch.testing.assert_close(hits.t, torch.tensor(expected, dtype=DOUBLE), rtol=0, atol=1e-9)
    assert hits.uv[:, 1].tolist() == [1.0, 0.0, 0.5]


def test_derivatives_of_points_by_their_coordinates():
    """`along` and `around` of the PyTorch functions, and dp_du, dp_dv of the outputs."""
    generator = torch.Generator().manual_seed(4)
    points, radii = (
        torch.randn(9, 4, 3, generator=generator, dtype=DOUBLE),
        torch.rand(9, 4, generator=generator, dtype=DOUBLE),
    )
    b1 = torch.rand(9, generator=generator, dtype=DOUBLE).requires_grad_()
    for straight, place in (
        (False, b1.detach()),
        (True, b1.detach()),
        (True, 1.2 + 0 * b1.detach()),
        (True, -0.1 + 0 * b1.detach()),
    ):
        b2 = place.clone().requires_grad_()
        radii_ = radii * 0.3 if straight else radii
        p, along, around = Segments(points, radii_, straight).evaluate(b1, b2)
        for k in range(3):
            by_1, by_2 = torch.autograd.grad(p[:, k].sum(), (b1, b2), retain_graph=True)
            torch.testing.assert_close(by_1, around[:, k])
            torch.testing.assert_close(by_2, along[:, k])


@pytest.mark.parametrize("kind", list(REFERENCE))
def test_derivatives_of_hits_of_any_mode(kind):
    scene = scene_of(kind, control_points=POINTS[:6, :3], radii=POINTS[:6, 3])
    o = torch.tensor([[x, y, 5.0] for (x, y), *_ in REFERENCE[kind] if y < 1], dtype=DOUBLE)
    d = torch.tensor([0.01, 0.02, -1], dtype=DOUBLE).expand_as(o).clone()
    met = tr.ray_intersect(scene, o, d).valid
    o, d = o[met], d[met]
    assert len(o) >= 2

    def outputs(points, radii, o, d):
        found = tr.ray_intersect(scene, o, d, params={"curve.control_points": points, "curve.radii": radii})
        return torch.cat([found.t[:, None], found.position, found.normal, found.uv], 1)

    inputs = [x.detach().clone().requires_grad_() for x in (scene.curve.control_points, scene.curve.radii, o, d)]
    assert torch.autograd.gradcheck(outputs, inputs, atol=1e-5, check_forward_ad=True, fast_mode=True)
    assert torch.autograd.gradgradcheck(lambda r: outputs(inputs[0], r, o, d), inputs[1:2], atol=1e-4, fast_mode=True)


def test_ways_to_say_the_same(file):
    flat = {"control_points": POINTS[6:].flatten().tolist()}
    rows = {"control_points": POINTS[6:].numpy()}
    apart = {"control_points": POINTS[6:, :3].tolist(), "radii": 0.2}
    for given in (flat, rows, apart):
        scene = scene_of(**given)
        assert scene.curve.control_points.shape == (4, 3) and scene.curve.radii.tolist() == [0.2] * 4
        assert scene.curve.segment_indices.tolist() == [0]
    both = scene_of(filename=str(file))
    assert both.curve.segment_indices.tolist() == [0, 1, 2, 6]
    assert scene_of("linearcurve", filename=str(file)).curve.segment_indices.tolist() == [0, 1, 2, 3, 4, 6, 7, 8]
    curve = tr.BSplineCurve(control_points=POINTS, to_world=tr.Transform.translate([0, 0, 2]).scale(2))
    torch.testing.assert_close(
        curve.control_points.detach(), POINTS[:, :3].to(curve.radii.dtype) * 2 + torch.tensor([0, 0, 2.0])
    )
    torch.testing.assert_close(curve.radii.detach(), POINTS[:, 3].to(curve.radii.dtype))  # as in Mitsuba
    low, high = scene_of(**rows).curve.bounds()
    assert low.tolist() == pytest.approx([-0.2, 2.8, -0.2]) and high.tolist() == pytest.approx([3.2, 3.2, 0.2])


@pytest.mark.parametrize("kind", list(REFERENCE))
def test_saved_and_loaded(kind, tmp_path, file):
    scene = scene_of(kind, torch.float32, filename=str(file))
    scene.save(tmp_path / "scene.xml")
    again = tr.load_file(tmp_path / "scene.xml")
    bends = torch.diff(scene.curve.segment_indices, prepend=scene.curve.segment_indices[:1] - 2) != 1
    assert int(bends.sum()) == 2
    for name in ("control_points", "radii", "segment_indices"):
        assert torch.equal(getattr(again.curve, name), getattr(scene.curve, name))


REFUSED = [
    ({}, "give one of control_points and filename; got none"),
    ({"control_points": [[0.0, 0, 0, 1]] * 3}, r"curve.control_points: a bsplinecurve has at least 4, got 3"),
    ({"control_points": [[0.0, 0, 0]] * 4}, r"expected an array of shape \(N, 4\) or \(M, K, 4\), the radius in"),
    ({"control_points": [[0.0, 0, 0, 1]] * 4, "radii": 1}, r"control_points: expected an array of shape \(N, 3\)"),
    ({"control_points": [[0.0, 0, 0]] * 4, "radii": [1.0] * 3}, r"radii: expected one number or an array"),
    ({"control_points": [[0.0, 0, 0]] * 4, "radii": -1}, r"-1 is outside the range \[0, inf\] of radii"),
    ({"control_points": [[0.0, float("nan"), 0, 1]] * 4}, "control_points: has values that are not finite"),
    ({"control_points": [[0.0, 0, 0, 1]] * 4, "segment_indices": [1]}, "expected numbers from 0 to 0, got 1"),
    ({"control_points": [[0.0, 0, 0, 1]] * 4, "segment_indices": []}, "at least one segment|expected integers"),
    ({"control_points": [[0.0, 0, 0, 1]] * 4, "segment_indices": [0.5]}, r"expected integers of shape \(S,\)"),
    ({"control_points": [[0.0, 0, 0, 1]] * 4, "emitter": {"type": "area"}}, "curve.emitter: a curve cannot emit"),
    ({"control_points": [[0.0, 0, 0, 1]] * 4, "interior": {"type": "homogeneous"}}, "interior: rays meet a curve from"),
    ({"control_points": [[0.0, 0, 0, 1]] * 4, "radius": 1}, "no parameter 'radius'; did you mean 'radii'"),
]  # fmt: skip


@pytest.mark.parametrize(("given", "message"), REFUSED)
def test_refused(given, message):
    with pytest.raises(ValueError, match=message):
        scene_of(**given)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n", "line 1: expected x, y, z and a radius, got '1 2 3'"),
        ("0 0 0 1\n0 0 x 1\n", "line 2: expected x, y, z and a radius"),
        ("\n\n", "has no control points"),
        ("0 0 0 1\n1 0 0 1\n", "each curve of a bsplinecurve has at least 4 points, one has 2"),
    ],
)
def test_files_refused(text, message, tmp_path):
    (tmp_path / "bad.txt").write_text(text)
    with pytest.raises(ValueError, match=message):
        scene_of(filename=str(tmp_path / "bad.txt"))


def test_edits_are_checked():
    scene = scene_of(control_points=POINTS[:6])
    with pytest.raises(ValueError, match=r"expected an array of shape \(6, 3\).*for another number of points"):
        scene.curve.control_points = torch.zeros(5, 3)
    with torch.no_grad():
        scene.curve.radii[2] = -1.0
    with pytest.raises(ValueError, match=r"curve: field 'radii': expected numbers that are not negative"):
        shoot(scene, [[0.0, 0, 5]], [0.0, 0, -1])


def test_a_checkpoint_may_bring_more_points():
    fine, coarse = scene_of(control_points=POINTS), scene_of(control_points=POINTS[:5])
    coarse.load_state_dict(fine.state_dict())
    for name in ("control_points", "radii", "segment_indices"):
        assert torch.equal(getattr(coarse.curve, name), getattr(fine.curve, name))
    o = [[1.5, 3.0, 5.0]]
    assert torch.equal(shoot(coarse, o, [0.0, 0, -1]).t, shoot(fine, o, [0.0, 0, -1]).t)


def test_an_edit_moves_what_rays_meet():
    scene = scene_of("linearcurve", torch.float32, control_points=[[0.0, 0, 0], [1, 0, 0]], radii=0.2)
    assert float(shoot(scene, [[0.5, 0, 5.0]], [0.0, 0, -1]).t) == pytest.approx(4.8)
    for height in (1.0, 2.0, 3.0):  # built, built again, followed
        with torch.no_grad():
            scene.curve.control_points[:, 2] = height
        assert float(shoot(scene, [[0.5, 0, 5.0]], [0.0, 0, -1]).t) == pytest.approx(4.8 - height, abs=1e-5)


def test_radii_and_bends_are_found_from_shading():
    """A tube that fills the view, lit from one side: radii and control points by their shading alone."""
    points = torch.tensor([[-3.0, 0, 0], [-1, 0, 0], [0, 0, 0], [1, 0, 0], [3, 0, 0]], dtype=DOUBLE)
    scene = tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "camera": {
                "type": "perspective",
                "fov": 12,
                "to_world": tr.Transform.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 12, "height": 12},
            },
            "curve": {"type": "bsplinecurve", "control_points": points, "radii": 0.9},
            "lamp": {"type": "point", "position": [1.5, 2, 4], "intensity": 20.0},
        },
        dtype=DOUBLE,
    )
    true = (
        scene.curve.control_points.detach() + torch.tensor([0.0, 0, 0.15]) * torch.tensor([0.0, 1, -1, 1, 0])[:, None]
    )
    wide = torch.tensor([0.9, 1.0, 0.85, 0.95, 0.9], dtype=DOUBLE)
    target = tr.render(scene, spp=16, seed=1, params={"curve.control_points": true, "curve.radii": wide}).detach()
    points, radii = scene.curve.control_points.requires_grad_(), scene.curve.radii.requires_grad_()
    optimizer = torch.optim.Adam([points, radii], lr=0.01)
    losses = []
    for step in range(120):
        optimizer.zero_grad()
        image = tr.render(scene, spp=4, seed=step)
        loss = ((image - target) ** 2).mean()
        loss.backward()
        points.grad[:, :2] = 0  # the camera sees how far away the surface is, by its shading
        optimizer.step()
        losses.append(float(loss.detach()))
    assert sum(losses[-5:]) < 0.03 * sum(losses[:5])
