"""Rays through media whose index varies: derivatives against differences, both modes, and what is refused."""

from __future__ import annotations

import math

import pytest
import torch
from bent_scenes import DOUBLE, beam, difference, direction_like, glass, in_both_modes, number_of, random_index

import torchrender as tr


@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
@pytest.mark.parametrize("bsdf", ["dielectric", "null"])
def test_derivatives_by_the_index_are_those_of_the_rays(interpolation, bsdf):
    index = random_index(12)
    scene = glass(index, bsdf, interpolation=interpolation)
    rays = beam(100)

    def f(values):
        return number_of(tr.gradientindex.trace(scene, "lens", *rays, params={"lens.interior.index": values}))

    along = direction_like(index)
    reverse, forward = in_both_modes(f, index, along)
    assert abs(reverse) > 1
    assert forward == pytest.approx(reverse, rel=1e-10)
    assert difference(f, index, along) == pytest.approx(reverse, rel=1e-6)


def test_a_constant_index_is_a_slab():
    """Parallel, shifted, by Snell's law."""
    scene = glass(1.5, ext_ior=1.0)
    direction = torch.tensor([[math.sin(0.5), 0, math.cos(0.5)]], dtype=DOUBLE)
    rays = tr.gradientindex.trace(scene, "lens", torch.tensor([[-1.5, 0, -3.0]], dtype=DOUBLE), direction)
    inside = math.asin(math.sin(0.5) / 1.5)
    assert bool(rays.valid.all())
    assert torch.allclose(rays.direction, direction, atol=1e-12)
    assert float(rays.position[0, 0]) == pytest.approx(-1.5 + 2 * math.tan(0.5) + 2 * math.tan(inside), abs=1e-9)
    assert float(rays.length[0]) == pytest.approx(2 / math.cos(inside), abs=1e-9)
    assert float(rays.optical_path[0]) == pytest.approx(3 / math.cos(inside), abs=1e-9)


def test_integrators_say_what_bends_light():
    scene = glass(1.5)
    scene["sky"] = tr.load_dict({"type": "constant"})
    camera = tr.load_dict({"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4}})
    with pytest.raises(ValueError, match=r"VolumetricPathTracer does not bend light, as lens\.interior.*PathTracer"):
        tr.render(scene, sensor=camera, integrator=tr.VolumetricPathTracer(), spp=1)


@pytest.mark.parametrize(
    ("index", "what"),
    [
        (torch.ones(2, 2, 2, 3), r"index: expected control values of shape \(Z, Y, X\)"),
        (torch.zeros(2, 2, 2), "index: expected positive indices of refraction"),
        (torch.ones(1, 1, 1001), "at most 1000 voxels"),
    ],
)
def test_indices_that_are_none(index, what):
    with pytest.raises((TypeError, ValueError), match=what):
        glass(index)


def test_interpolation_has_a_continuous_gradient():
    with pytest.raises(ValueError, match="'trilinear' has no continuous gradient"):
        glass(1.5, interpolation="trilinear")


def test_a_mesh_refracts_by_its_vertex_normals():
    """A tetrahedron whose vertex normals are all vertical leaves directions as they are, as a slab does."""
    corners = torch.tensor([[-3.0, -3, 0], [3, -3, 0], [0, 4, 0], [0, 0, -2]], dtype=DOUBLE)
    faces = torch.tensor([[0, 1, 2], [1, 0, 3], [2, 1, 3], [0, 2, 3]])
    up = torch.tensor([[0.0, 0, 1]], dtype=DOUBLE)
    box = tr.Transform.translate([-1, -1, -1]) @ tr.Transform.scale(2)
    interior = {"type": "gradientindex", "index": 1.5, "ext_ior": 1.0, "to_world": box}
    direction = torch.tensor([[0.1, 0.2, 1.0]], dtype=DOUBLE)
    direction /= direction.norm()
    found = {}
    for normals in (None, up.expand(4, 3).contiguous()):
        lens = tr.Mesh(corners, faces, vertex_normals=normals, bsdf={"type": "dielectric"}, interior=interior)
        scene = tr.load_dict({"type": "scene", "lens": lens}, dtype=DOUBLE)
        rays = tr.gradientindex.trace(scene, "lens", torch.tensor([[0.3, 0.2, -4.0]], dtype=DOUBLE), direction)
        assert bool(rays.valid.all())
        found[normals is None] = rays.direction
    assert (found[True] - direction).norm() > 0.1  # by its faces it is a prism
    assert torch.allclose(found[False], direction, atol=1e-12)
