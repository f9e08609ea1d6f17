"""Derivatives of bent rays by everything that they depend on: both modes against each other and against differences.

Rays go in and out through the same faces on both sides of a difference, where the map from what is given to where rays
come out is smooth: also where a ray needs a step more.
"""

from __future__ import annotations

import pytest
import torch
from bent_scenes import DOUBLE, beam, difference, direction_like, glass, in_both_modes, number_of, random_index

import torchrender as tr

# voxels are shortest along z, and no face of the cube lies where quadratic splines have kinks in their gradients
PLACED = tr.Transform.translate([-1.1, -1.2, -1.04]) @ tr.Transform.scale([2.2, 2.4, 2.08])
SIGMA = [0.1, 0.3, 0.2]


def cube(bsdf: str = "dielectric", interpolation: str = "cubic", dtype: torch.dtype = DOUBLE) -> tr.Scene:
    made = {"interpolation": interpolation, "index_base": 0.2, "index_scale": 0.9, "sigma_t": SIGMA}
    return glass((random_index(12) - 0.2) / 0.9, bsdf, dtype, to_world=PLACED, ext_ior=1.1, **made)


def sphere(bsdf: str = "dielectric", interpolation: str = "cubic", dtype: torch.dtype = DOUBLE) -> tr.Scene:
    placed = {"type": "sphere", "center": [0.05, -0.02, 0.04], "radius": 0.9}
    return glass(random_index(12), bsdf, dtype, shape=placed, interpolation=interpolation, sigma_t=SIGMA)


def tetrahedron(dtype: torch.dtype = DOUBLE) -> tr.Scene:
    """Rays along z come in through its base and go out through three faces."""
    corners = [[-1.0, -0.9, -0.8], [1.1, -0.8, -0.9], [0.1, 1.2, -0.7], [0.0, 0.1, 0.9]]
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    mesh = tr.Mesh(torch.tensor(corners), torch.tensor(faces), face_normals=True).to(dtype)
    return glass(random_index(12), "null", dtype, shape=mesh)


def by(scene: tr.Scene, name: str, rays: tuple[torch.Tensor, torch.Tensor]):
    """A number of rays as a function of a parameter or of the rays, and its value now."""
    rays = tuple(r.to(scene.dtype) for r in rays)
    if name in ("origins", "directions"):
        x = rays[name == "directions"]

        def of_rays(value):
            pair = (rays[0], value) if name == "directions" else (value, rays[1])
            return number_of(tr.gradientindex.trace(scene, "lens", *pair))

        return of_rays, x

    def of_parameter(value):
        return number_of(tr.gradientindex.trace(scene, "lens", *rays, params={f"lens.{name}": value}))

    return of_parameter, scene.get_parameter(f"lens.{name}").detach()


def narrow(n: int = 60) -> tuple[torch.Tensor, torch.Tensor]:
    return beam(n, width=0.8)


def check(scene: tr.Scene, name: str, along: torch.Tensor | None = None, step: float = 2e-6) -> None:
    f, x = by(scene, name, narrow())
    along = direction_like(x) if along is None else along
    reverse, forward = in_both_modes(f, x, along)
    assert abs(reverse) > 1e-2
    assert forward == pytest.approx(reverse, rel=1e-10)
    assert difference(f, x, along, step) == pytest.approx(reverse, rel=1e-6)


MEDIUM = ["index", "index_base", "index_scale", "sigma_t.value.value"]


@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
@pytest.mark.parametrize("bsdf", ["dielectric", "null"])
@pytest.mark.parametrize("name", ["origins", "directions", *(f"interior.{n}" for n in MEDIUM)])
def test_in_a_cube(name, bsdf, interpolation):
    check(cube(bsdf, interpolation), name)


@pytest.mark.parametrize("name", ["origins", "directions", "interior.index", "center", "radius", "to_world"])
@pytest.mark.parametrize("bsdf", ["dielectric", "null"])
def test_in_a_sphere(name, bsdf):
    scene = sphere(bsdf)
    along = None
    if name == "to_world":
        along = direction_like(torch.eye(4, dtype=DOUBLE))
        along[3] = 0
    check(scene, name, along)


def test_by_the_index_outside():
    check(cube(), "interior.ext_ior")
    f, x = by(cube("null"), "interior.ext_ior", narrow())
    assert not f(x.clone().requires_grad_()).requires_grad  # rays go straight on


@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
def test_by_the_place_of_the_grid(interpolation):
    """Of `to_world` but for what changes the length of steps, the shortest side of voxels: that counts as constant."""
    scene = cube(interpolation=interpolation)
    along = direction_like(torch.eye(4, dtype=DOUBLE))
    along[3], along[2, 2] = 0, 0
    check(scene, "interior.to_world", along)


def test_by_vertices():
    check(tetrahedron(), "vertex_positions")
    scene = glass(random_index(12), to_world=PLACED)
    along = direction_like(scene["lens"].vertex_positions.detach())
    check(scene, "vertex_positions", along)  # of 1e-5 one of the rays changes to the other half of a face


def test_by_a_colour_of_extinction_and_by_each_output():
    """Derivatives of every output by itself, others not used."""
    scene, rays = cube(), narrow(20)
    index = scene["lens"].interior.index.detach()
    along = direction_like(index)
    for name in ("position", "direction", "optical_path", "length", "transmittance", "index"):
        weight = direction_like(getattr(tr.gradientindex.trace(scene, "lens", *rays), name), seed=5)

        def f(value, name=name, weight=weight):
            found = tr.gradientindex.trace(scene, "lens", *rays, params={"lens.interior.index": value})
            return (getattr(found, name) * weight).sum()

        reverse, forward = in_both_modes(f, index, along)
        assert abs(reverse) > 1e-3
        assert forward == pytest.approx(reverse, rel=1e-10)
        assert difference(f, index, along) == pytest.approx(reverse, rel=1e-6)


@pytest.mark.parametrize(
    "name",
    ["origins", "directions", *(f"interior.{n}" for n in ("index", "index_base", "to_world", "sigma_t.value.value"))],
)
@pytest.mark.parametrize("make", [cube, sphere])
@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
def test_both_modes_agree_in_single_precision(name, make, interpolation):
    """Packets of rays; as far off as sums of single precision are."""
    scene = make(interpolation=interpolation, dtype=torch.float32)
    f, x = by(scene, name, narrow(100))
    along = direction_like(x)
    if name.endswith("to_world"):
        along[3] = 0
    reverse, forward = in_both_modes(f, x, along)
    assert forward == pytest.approx(reverse, rel=1e-4)
    exact, _ = by(make(interpolation=interpolation), name, narrow(100))
    truth, _ = in_both_modes(exact, x.double(), along.double())
    assert reverse == pytest.approx(truth, rel=1e-3)


def test_parameters_of_the_scene():
    """`requires_grad` of the scene's own tensors, instead of `params`: the same gradients."""
    scene, rays = cube(), narrow(20)
    names = [f"lens.interior_medium.{n}" for n in (*MEDIUM, "to_world", "ext_ior")] + ["lens.vertex_positions"]
    trained = scene.train_only(*names)
    assert len(trained) == len(names)
    number_of(tr.gradientindex.trace(scene, "lens", *rays)).backward()
    given = {n: scene.get_parameter(n).detach().clone().requires_grad_() for n in names}
    wanted = torch.autograd.grad(
        number_of(tr.gradientindex.trace(scene, "lens", *rays, params=given)), list(given.values())
    )
    for name, gradient in zip(names, wanted):
        assert bool(gradient.any()), name
        assert torch.equal(scene.get_parameter(name).grad, gradient), name


def test_a_longer_step_is_no_jump():
    """A difference across the place where a ray needs a step more: rays and derivatives go on."""
    scene = glass(random_index(12), "null")
    wide = torch.linspace(0, 0.15, 4001, dtype=DOUBLE)
    o = torch.stack([0.1 + 0 * wide, 0.2 + 0 * wide, -0.5 - wide], 1)
    d = torch.tensor([[0.2, 0.1, 1.0]], dtype=DOUBLE).expand_as(o)
    rays = tr.gradientindex.trace(scene, "lens", o, d)
    assert set(rays.steps.diff().unique().tolist()) == {0, 1}
    for found in (rays.position, rays.direction, rays.optical_path[:, None], rays.length[:, None]):
        change = found.diff(dim=0).norm(dim=1)
        at = rays.steps.diff() == 1
        assert float(change[at].max()) < 2 * float(change[~at].max())


def test_placing_both_shape_and_grid():
    """Moving the whole: derivatives by a common translation are those of the opposite one of the rays."""
    scene, rays = sphere(), narrow(20)
    move = torch.tensor([0.3, -0.2, 0.5], dtype=DOUBLE)

    def moved(amount):
        grid = scene["lens"].interior.to_world.detach().clone()
        grid[:3, 3] = grid[:3, 3] + amount * move
        center = scene["lens"].center.detach() + amount * move
        params = {"lens.interior.to_world": grid, "lens.center": center}
        found = tr.gradientindex.trace(scene, "lens", rays[0] + amount * move, rays[1], params=params)
        return number_of(found._replace(position=found.position - amount * move))

    zero = torch.zeros((), dtype=DOUBLE)
    reverse, forward = in_both_modes(moved, zero, torch.ones((), dtype=DOUBLE))
    assert abs(reverse) < 1e-10 and abs(forward) < 1e-10
