"""Facets that are rougher along one direction: against the isotropic models, in frames that are known, derivatives.

Values against Mitsuba, samplers, energy and precision are in test_bsdf_references.py and test_bsdfs.py, a scene in
test_references.py, what moves in test_motion_derivatives.py. Significance 0.01 for all statistical tests together.
"""

from __future__ import annotations

import copy
import math
import pickle

import bsdf_cases
import pytest
import torch
from bsdf_probes import directions, probe
from motion_scenes import SCENES, above, bitmap, camera, floor, lamp, scene
from moving_differences import agrees, compare
from uniform_numbers import uniform

import torchrender as tr
from torchrender import Transform

KINDS = [(kind, d) for kind in ("roughconductor", "roughdielectric") for d in ("beckmann", "ggx")]
METAL = {"type": "roughconductor", "material": "Cu", "distribution": "ggx"}
BRUSHED = {**METAL, "alpha_u": 0.2, "alpha_v": 0.6}
LACQUER = {"type": "principled", "base_color": 0.6, "metallic": 0.8, "roughness": 0.6, "anisotropic": 0.9}
FOIL = {"type": "principledthin", "base_color": 0.6, "spec_trans": 0.9, "roughness": 0.6, "anisotropic": 0.9}


# -------------------------------------------------------------------------------------------------------------- values
@pytest.mark.parametrize(("kind", "distribution"), KINDS)
def test_equal_roughness_is_that_of_the_isotropic_model(kind, distribution):
    settings = {"type": kind, "distribution": distribution}
    one, two = probe({**settings, "alpha": 0.3}), probe({**settings, "alpha_u": 0.3, "alpha_v": 0.3})
    wi, wo = directions(2000, 3), directions(2000, 4)
    for a, b in zip(one.eval(wi, wo), two.eval(wi, wo), strict=True):
        torch.testing.assert_close(b, a, rtol=1e-11, atol=1e-14)
        assert a.any()
    a, b = one.sample(wi, uniform(2000)), two.sample(wi, uniform(2000))
    torch.testing.assert_close(b.wo, a.wo, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(b.weight, a.weight, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(("kind", "distribution"), KINDS)
def test_exchanged_roughness_is_a_quarter_turn(kind, distribution):
    settings = {"type": kind, "distribution": distribution}
    along, across = (probe({**settings, "alpha_u": a, "alpha_v": b}) for a, b in ((0.1, 0.5), (0.5, 0.1)))
    wi, wo = directions(2000, 3), directions(2000, 4)
    turned = (torch.stack([-w[:, 1], w[:, 0], w[:, 2]], 1) for w in (wi, wo))
    here, there = along.eval(wi, wo), across.eval(*turned)
    torch.testing.assert_close(there.value, here.value, rtol=1e-9, atol=1e-14)
    torch.testing.assert_close(there.pdf, here.pdf, rtol=1e-9, atol=1e-14)
    assert float((across.eval(wi, wo).value - here.value).abs().max()) > 0.1 * float(here.value.max())


@pytest.mark.parametrize("bsdf", [LACQUER, FOIL], ids=["principled", "principledthin"])
def test_principled_is_as_rough_along_as_burley_says(bsdf):
    """Without `anisotropic` it is the isotropic model; of facets alone the density is that of the rough conductor."""
    wi, wo = directions(2000, 3), directions(2000, 4)
    one, two = probe({**bsdf, "anisotropic": 0.0}), probe({k: v for k, v in bsdf.items() if k != "anisotropic"})
    for a, b in zip(one.eval(wi, wo), two.eval(wi, wo), strict=True):
        assert torch.equal(a, b) and a.any()
    aspect = math.sqrt(1 - 0.9 * 0.9)
    rough = {"alpha_u": 0.36 / aspect, "alpha_v": 0.36 * aspect}
    both = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    metal = probe({**METAL, **rough}).eval(wi[both], wo[both]).pdf
    if bsdf is LACQUER:
        facets = probe({**bsdf, "metallic": 1.0}).eval(wi[both], wo[both]).pdf
        torch.testing.assert_close(facets, metal, rtol=1e-9, atol=0)
    changed = probe(bsdf).eval(wi, wo).value - two.eval(wi, wo).value
    assert float(changed.abs().max()) > 0.1


# -------------------------------------------------------------------------------------------------------------- frames
ORIGIN = Transform.translate([0.3, -0.2, 0.4])


def _rectangle(bsdf: dict) -> tuple[dict, list, list]:
    turn = Transform.rotate([0, 0, 1], 35)
    return {"type": "rectangle", "to_world": ORIGIN @ turn, "bsdf": bsdf}, [0.5, 0.2, 0], [1, 0, 0]


def _shaded_mesh(bsdf: dict) -> tuple[tr.Mesh, list, list]:
    """A rectangle with tilted normals, whose coordinates are turned by a third of a quarter."""
    corners = torch.tensor([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=torch.float64)
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    texcoords = corners[:, :2] @ torch.tensor([[c, s], [-s, c]], dtype=torch.float64).T
    up = torch.nn.functional.normalize(torch.tensor([[0.2, -0.1, 1.0]], dtype=torch.float64), dim=1).expand(4, 3)
    matrix = torch.as_tensor(ORIGIN.matrix)
    mesh = tr.Mesh(corners + matrix[:3, 3], [[0, 1, 2], [0, 2, 3]], up, texcoords, bsdf=bsdf)
    return mesh, [0.2, 0.1, 0], [c, s, 0]


def _sphere(bsdf: dict) -> tuple[dict, list, list]:
    """Round the axis: where x = sin, z = cos of an angle the tangent of the azimuth is y."""
    angle = math.radians(50)
    turn = Transform.rotate([0, 1, 0], -50)  # that point is brought to the top
    return {"type": "sphere", "to_world": ORIGIN @ turn, "bsdf": bsdf}, [math.sin(angle), 0, math.cos(angle)], [0, 1, 0]


def _disk(bsdf: dict) -> tuple[dict, list, list]:
    """Along the radius."""
    return {"type": "disk", "to_world": ORIGIN, "bsdf": bsdf}, [0.4, 0.3, 0], [0.8, 0.6, 0]


SHAPES = [(shape, side) for shape in (_rectangle, _shaded_mesh, _sphere, _disk) for side in (1, -1)]


SHAPES = [(BRUSHED, *c) for c in SHAPES if c != (_sphere, -1)]
SHAPES += [(LACQUER, _shaded_mesh, 1), (LACQUER, _sphere, 1), (LACQUER, _disk, -1), (FOIL, _shaded_mesh, 1)]


@pytest.mark.parametrize(("model", "shape", "side"), SHAPES)
def test_directions_are_those_of_the_texture_coordinates(model, shape, side):
    """One point under a point light, against the model's value in the frame that the shape has there."""
    bsdf = model if side > 0 else {"type": "twosided", "bsdf": model}
    thing, local, tangent = shape(bsdf)
    to_world = thing["to_world"] if isinstance(thing, dict) else ORIGIN
    matrix = torch.as_tensor(to_world.matrix, dtype=torch.float64)
    point = matrix[:3, :3] @ torch.tensor(local, dtype=torch.float64) + matrix[:3, 3]
    eye = point + torch.tensor([0.9, 0.4, 2.0 * side], dtype=torch.float64)
    light = point + torch.tensor([-0.8, 0.3, 1.5 * side], dtype=torch.float64)
    view = camera(eye.tolist(), point.tolist(), 0.01)
    lit = {"type": "point", "position": light.tolist(), "intensity": 1.0}
    loaded = tr.load_dict(scene(2, view, thing=thing, lamp=lit), dtype=torch.float64)
    found = tr.render(loaded, spp=1, seed=1).mean((0, 1))

    hit = tr.ray_intersect(loaded, eye[None], torch.nn.functional.normalize(point - eye, dim=0)[None])
    n = hit.shading_normal[0]
    u = matrix[:3, :3] @ torch.tensor(tangent, dtype=torch.float64)
    s = torch.nn.functional.normalize(u - n * (n @ u), dim=0)
    axes = torch.stack([s, torch.linalg.cross(n, s), n * side])
    wi, wo = (torch.nn.functional.normalize(axes @ (x - point), dim=0)[None] for x in (eye, light))
    expected = probe(model).eval(wi, wo).value[0] / (light - point).square().sum()
    torch.testing.assert_close(found, expected, rtol=2e-3, atol=0)
    other = probe(model).eval(wi[:, [1, 0, 2]], wo[:, [1, 0, 2]]).value[0] / (light - point).square().sum()
    assert bool(((other - expected).abs() > 0.1 * expected).all())  # another frame would show


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
def test_without_a_tangent_there_is_some_frame():
    """Texture coordinates that are all the same, and a tangent along the normal."""
    corners = torch.tensor([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=torch.float64)
    flat = torch.zeros(4, 2, dtype=torch.float64)
    along = torch.tensor([[1.0, 0, 1e-9]], dtype=torch.float64).expand(4, 3)
    for normals in (None, along):
        mesh = tr.Mesh(corners, [[0, 1, 2], [0, 2, 3]], normals, flat, bsdf=tr.RoughConductor(alpha_u=0.2, alpha_v=0.5))
        view = camera([1, 0.2, 2], [0, 0, 0], 30)
        loaded = tr.load_dict(scene(3, view, mesh=mesh, sky={"type": "constant"}), dtype=torch.float64)
        (positions,) = loaded.train_only("mesh.vertex_positions")
        image = tr.render(loaded, spp=4, seed=1, nan="raise")
        (gradient,) = torch.autograd.grad(image.sum(), positions)
        assert torch.isfinite(image).all() and torch.isfinite(gradient).all()


# --------------------------------------------------------------------------------------------------------- derivatives
TEXTURED = {
    **METAL,
    "alpha_u": bitmap(4, 4, 0.6),
    "alpha_v": bitmap(4, 4, 0.9),
}
VALUES = ("alpha_u.data", "alpha_v.data", "eta.value", "k.value", "specular_reflectance.value")


def textured_floor(bsdf: dict) -> tr.Scene:
    return tr.load_dict(scene(2, above(), floor=floor(bsdf), lamp=lamp("rectangle")), dtype=torch.float64)


@pytest.mark.parametrize("kind", ["metal", "glass", "lacquer"])
def test_derivatives_by_what_is_looked_up(kind):
    if kind == "metal":
        loaded, names, tests = textured_floor({**TEXTURED, "specular_reflectance": 0.7}), VALUES, 9
    elif kind == "lacquer":
        lacquer = {**LACQUER, "anisotropic": bitmap(4, 4, 0.6)}
        loaded, names, tests = textured_floor(lacquer), ("anisotropic.data", "roughness.value"), 9
    else:
        glass = {"type": "roughdielectric", "int_ior": 1.4, "alpha_u": bitmap(4, 4, 0.6), "alpha_v": 0.4}
        loaded, names, tests = textured_floor(glass), ("alpha_u.data", "alpha_v.value"), 9
    for name in names:
        derivatives, differences = compare(loaded, f"floor.bsdf.{name}", 8, 64, 2e-3)
        passed, text = agrees(derivatives, differences, 5e-3, tests)
        assert passed, f"{name}: {text}"
        assert differences.abs().mean() > 1e-4, name


def test_forward_and_reverse_mode_agree_on_values():
    loaded = textured_floor({**TEXTURED, "specular_reflectance": 0.7})
    names = [f"floor.bsdf.{name}" for name in VALUES]
    values = [loaded.get_parameter(name).detach() for name in names]

    def f(*tensors):
        return tr.render(loaded, spp=2, seed=5, params=dict(zip(names, tensors, strict=True)))

    result = tr.testing.dot_product_test(f, values, rtol=1e-10)
    assert result, result.message
    assert result.forward != 0


LIGHT_PATHS = {
    "along_floor": ("floor.bsdf.brdf_0.alpha_v.value", "floor.to_world"),
    "along_mesh": ("plane.bsdf.alpha_u.data", "plane.vertex_positions", "plane.vertex_texcoords"),
}


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize("name", LIGHT_PATHS)
def test_light_paths_find_what_camera_paths_find(name):
    """Image and derivatives of the particle tracer, of other samples: Student's test."""
    description = SCENES[name]()
    description["camera"]["film"] |= {"rfilter": {"type": "gaussian"}, "sample_border": True}
    loaded = tr.load_dict(description, dtype=torch.float64)
    names = LIGHT_PATHS[name]
    found = {}
    for integrator in (tr.PathTracer(max_depth=2, rr_depth=99), tr.ParticleTracer(max_depth=2, rr_depth=99)):
        rows = []
        for seed in range(12):
            values = {n: loaded.get_parameter(n).detach().clone().requires_grad_() for n in names}
            image = tr.render(loaded, integrator=integrator, spp=256, seed=seed, seed_grad=50 + seed, params=values)
            gradients = torch.autograd.grad(image.mean(), list(values.values()))
            generator = torch.Generator().manual_seed(1)
            change = [torch.randn(g.shape, generator=generator, dtype=g.dtype) for g in gradients]
            for c in change:
                if c.ndim == 2 and c.shape == (4, 4):
                    c[-1] = 0
            rows.append([float(image.detach().mean()), *(float((g * c).sum()) for g, c in zip(gradients, change))])
        found[type(integrator)] = torch.tensor(rows, dtype=torch.float64)
    a, b = found.values()
    error = ((a.var(0) + b.var(0)) / len(a)).sqrt()
    z = (a.mean(0) - b.mean(0)).abs() / error
    assert float(z.max()) < 4.5, (names, a.mean(0), b.mean(0), error)
    assert bool((a.mean(0).abs() > 5 * error).all()), (names, a.mean(0), error)  # something is measured


# --------------------------------------------------------------------------------------------------------------- class
def test_two_roughnesses_make_another_class():
    made = tr.RoughConductor(alpha_u=0.1, alpha_v=0.4, material="Au")
    assert isinstance(made, tr.AnisotropicConductor) and isinstance(made, tr.RoughConductor)
    assert not isinstance(tr.RoughConductor(alpha=0.1), tr.AnisotropicConductor)
    assert isinstance(tr.RoughDielectric(alpha_u=0.1, alpha_v=0.4), tr.AnisotropicDielectric)
    assert made.type == "roughconductor"
    names = {"alpha_u.value", "alpha_v.value", "eta.value", "k.value"}  # as Mitsuba names them
    assert {n for n, _ in made.named_parameters()} == names
    for again in (
        copy.deepcopy(made),
        pickle.loads(pickle.dumps(made)),
        tr.AnisotropicConductor(alpha_u=0.1, alpha_v=0.4),
    ):
        assert type(again) is tr.AnisotropicConductor
        assert float(again.alpha_v.value) == pytest.approx(0.4)


@pytest.mark.parametrize("name", bsdf_cases.ANISOTROPIC)
def test_saved_scenes_come_back(name, tmp_path):
    ball = {"type": "sphere", "bsdf": bsdf_cases.ANISOTROPIC[name]}
    loaded = tr.load_dict({"type": "scene", "camera": {"type": "perspective"}, "ball": ball})
    loaded.save(tmp_path / "a.xml")
    again = tr.load_file(tmp_path / "a.xml")
    assert type(again.ball.bsdf) is type(loaded.ball.bsdf)
    assert {n: v.tolist() for n, v in again.ball.bsdf.named_parameters()} == {
        n: v.tolist() for n, v in loaded.ball.bsdf.named_parameters()
    }
    assert repr(again.ball.bsdf) == repr(loaded.ball.bsdf)
