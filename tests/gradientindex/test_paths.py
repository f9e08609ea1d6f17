"""Paths from the camera through media that bend them: closed forms, and derivatives against differences."""

from __future__ import annotations

import math

import pytest
import torch
from bent_scenes import BOX, DOUBLE, random_index
from gradientindex_scenes import INDEX, T, derivatives, seen, thrown

import torchrender as tr

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
ONE = {"sky": {"type": "constant", "radiance": 1.0}}
GLOWING = {
    "ball": {
        "type": "sphere",
        "radius": 0.4,
        "center": [0.1, 0.2, 0.0],
        "bsdf": {"type": "diffuse", "reflectance": 0.6},
        "emitter": {"type": "area", "radiance": [2.0, 1.0, 0.5]},
    },
    "floor": {
        "type": "rectangle",
        "to_world": T.translate([0, -1.5, 0]) @ T.rotate([1, 0, 0], -90) @ T.scale(5),
        "bsdf": {"type": "diffuse", "reflectance": 0.5},
    },
}


def test_a_furnace_is_one():
    """Whatever the index does, with a boundary that is matched: radiance goes as n^2, there and back."""
    scene = seen(random_index(8), back=ONE)
    assert torch.allclose(tr.render(scene, spp=16, seed=0), torch.ones((), dtype=DOUBLE), atol=1e-12)


@pytest.mark.parametrize("shape", ["cube", "sphere"])
def test_a_dielectric_furnace_is_one(shape):
    """Fresnel's shares leave nothing out, but for paths that are caught for longer than they are followed."""
    scene = seen(random_index(6, 0.02), "dielectric", shape, size=8, back=ONE)
    image = tr.render(scene, integrator=tr.PathTracer(200, 1000), spp=64, seed=0)
    assert float(image.max()) < 1 + 1e-9
    assert float(image.median()) == pytest.approx(1, abs=1e-9)
    assert float(image.mean()) > 0.995


def test_a_constant_index_is_a_dielectric():
    """Image and derivatives of a cube of glass, with the same random numbers; none of these rays comes to an edge."""
    scene = seen(torch.full((4, 4, 4), 1.5), "dielectric", "cube")
    described = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 8},
        "lens": {"type": "cube", "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}},
        "camera": scene["camera"],
        "sky": scene["sky"],
    }
    glass = tr.load_dict(described, dtype=DOUBLE)
    names = {"index": INDEX, "ext_ior": "lens.interior_medium.ext_ior"}
    values = {n: scene.get_parameter(p).detach().clone().requires_grad_() for n, p in names.items()}
    image = tr.render(scene, spp=4, seed=1, params={names[n]: v for n, v in values.items()})
    eta = glass.get_parameter("lens.bsdf.eta").detach().clone().requires_grad_()
    expected = tr.render(glass, spp=4, seed=1, params={"lens.bsdf.eta": eta})
    assert torch.allclose(image, expected, atol=1e-12)
    weight = torch.rand(image.shape, generator=torch.Generator().manual_seed(0), dtype=DOUBLE)
    by_index, by_outside = torch.autograd.grad((image * weight).sum(), list(values.values()))
    (by_eta,) = torch.autograd.grad((expected * weight).sum(), eta)
    assert float(by_index.sum()) == pytest.approx(float(by_eta), rel=1e-9)
    assert float(by_outside) == pytest.approx(-1.5 * float(by_eta), rel=1e-9)


def test_the_tracer_by_its_other_name():
    scene = seen(random_index(6))
    assert torch.equal(
        tr.render(scene, integrator=tr.GradientIndexTracer(4), spp=2, seed=0),
        tr.render(scene, integrator=tr.PathTracer(4), spp=2, seed=0),
    )


def test_a_lamp_in_glass_is_seen_with_the_square_of_the_index():
    scene = seen(torch.full((1, 1, 1), 1.4, dtype=DOUBLE), back=GLOWING, size=11)
    image = tr.render(scene, integrator=tr.PathTracer(2, 99), spp=4, seed=0)
    expected = torch.tensor([2.0, 1.0, 0.5], dtype=DOUBLE) / 1.4**2
    assert torch.allclose(image[5, 5], expected, rtol=1e-9)


def test_absorption_is_that_of_the_way():
    """Through the middle of a ball, of diameter 2."""
    scene = seen(1.5, back=ONE, size=1, sigma_t=[0.3, 0.7, 0.1])
    camera = tr.load_dict(
        {
            "type": "orthographic",
            "to_world": T.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]) @ T.scale([1e-3, 1e-3, 1]),
            "film": {"type": "hdrfilm", "width": 1, "height": 1},
        }
    )
    image = tr.render(scene, sensor=camera, spp=4, seed=0)[0, 0]
    expected = torch.exp(-2 * torch.tensor([0.3, 0.7, 0.1], dtype=DOUBLE))
    assert torch.allclose(image, expected, rtol=1e-5)


CASES = {
    "index": ({}, INDEX),
    "quadratic": ({"interpolation": "quadratic"}, INDEX),
    "half steps": ({"step": 0.5}, INDEX),
    "base": ({}, "lens.interior_medium.index_base"),
    "scale": ({}, "lens.interior_medium.index_scale"),
    "place": ({}, "lens.interior_medium.to_world"),
    "absorption": ({"sigma_t": [0.3, 0.7, 0.1]}, "lens.interior_medium.sigma_t.value.value"),
    "index, absorbing": ({"sigma_t": [0.3, 0.7, 0.1]}, INDEX),
    "radius": ({}, "lens.radius"),
    "center": ({}, "lens.center"),
}


@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_the_image(name):
    medium, parameter = CASES[name]
    reverse, forward, difference = derivatives(seen(random_index(8), **medium), parameter, spp_visibility=0)
    assert abs(reverse) > 1e-3
    assert forward == pytest.approx(reverse, rel=1e-9)
    assert difference == pytest.approx(reverse, rel=2e-5)


@pytest.mark.parametrize("depth", [2, 3])
def test_derivatives_with_a_lamp_inside(depth):
    """Seen, and by the light that it scatters inside."""
    scene = seen(random_index(8), back=GLOWING)
    found = derivatives(scene, INDEX, integrator=tr.PathTracer(depth, 99))
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    assert found[2] == pytest.approx(found[0], rel=1e-6)


def test_everything_together_is_at_rest():
    """Medium, lens and camera shifted together, below a sky: what each of them changes cancels, sample by sample."""
    scene = seen(random_index(8))
    theta = torch.zeros((), dtype=DOUBLE, requires_grad=True)
    shift = torch.tensor([0.3, -0.5, 0.2], dtype=DOUBLE)
    names = ("lens.interior_medium.to_world", "camera.to_world")
    params = {"lens.center": scene.get_parameter("lens.center").detach() + theta * shift}
    alone = []
    for name in names:
        change = torch.zeros(4, 4, dtype=DOUBLE)
        change[:3, 3] = shift
        params[name] = scene.get_parameter(name).detach() + theta * change
    for chosen in (params, {n: v for n, v in params.items() if n == names[0]}):
        image = tr.render(scene, spp=4, seed=2, params=chosen, spp_visibility=0)
        alone.append(float(torch.autograd.grad(image[..., 1].square().sum(), theta, retain_graph=True)[0]))
    assert abs(alone[0]) < 1e-9 * abs(alone[1])


def test_a_dielectric_has_the_derivative_of_differences():
    """A cube, whose sides are vertical and out of sight of the beam: reflected or not, by the same random numbers.

    Those flip where Fresnel's share changes, so differences are of many samples: |z| < 4 has probability 6e-5.
    """
    scene = seen(random_index(6, 0.01), "dielectric", size=6)
    generator = torch.Generator().manual_seed(3)
    index, along = scene.get_parameter(INDEX).detach(), torch.randn(6, 6, 6, generator=generator, dtype=DOUBLE)
    integrator, step = tr.PathTracer(3, 99), 4e-3
    found, differences = [], []
    for seed in range(12):
        leaf = index.clone().requires_grad_()
        image = tr.render(scene, integrator=integrator, spp=1, spp_grad=512, seed=seed, params={INDEX: leaf})
        (gradient,) = torch.autograd.grad(image.sum(), leaf)
        found.append(float((gradient * along).sum()))
        with torch.no_grad():
            sides = [
                tr.render(scene, integrator=integrator, spp=4096, seed=seed, params={INDEX: index + s * step * along})
                for s in (1, -1)
            ]
        differences.append(float((sides[0] - sides[1]).sum()) / (2 * step))
    a, b = torch.tensor(found), torch.tensor(differences)
    z = float(a.mean() - b.mean()) / math.sqrt(float(a.var() + b.var()) / len(a))
    assert abs(z) < 4, (a.mean(), a.std(), b.mean(), b.std())


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"bsdf": {"type": "roughdielectric"}}, r"lens\.bsdf: expected null or dielectric.*got roughdielectric"),
        ({"bsdf": {"type": "diffuse"}}, r"lens\.bsdf: expected null or dielectric.*got diffuse"),
        ({"bsdf": {"type": "dielectric", "int_ior": 1.7}}, r"render: lens\.bsdf: .* leave out int_ior and ext_ior"),
    ],
)
def test_boundaries_that_are_none(change, what):
    scene = seen(1.5)
    interior = {"type": "gradientindex", "index": 1.5, "to_world": BOX}
    described = {"type": "scene", "lens": {"type": "sphere", "interior": interior, **change}, "sky": scene["sky"]}
    with pytest.raises(ValueError, match=what):
        tr.render(tr.load_dict(described, dtype=DOUBLE), sensor=scene["camera"], spp=1, seed=0)


def test_cameras_and_outsides_are_refused():
    medium = {"type": "gradientindex", "index": 1.5, "to_world": BOX}
    camera = {"type": "perspective", "medium": medium, "film": {"type": "hdrfilm", "width": 2, "height": 2}}
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "exterior": medium}
    for described, what in (
        ({"camera": camera, **ONE}, r"camera\.medium: a camera cannot be in a gradientindex medium"),
        ({"ball": ball, "camera": {**camera, "medium": None}, **ONE}, r"ball\.exterior: .* the interior of shapes"),
    ):
        objects = {k: {n: v for n, v in o.items() if v is not None} for k, o in described.items()}
        with pytest.raises(ValueError, match=what):
            tr.render(tr.load_dict({"type": "scene", **objects}, dtype=DOUBLE), spp=1, seed=0)


def test_rays_that_are_given_up_are_black_and_told_of():
    scene = seen(random_index(8), back=ONE, max_steps=2)
    with pytest.warns(RuntimeWarning, match="rays in gradientindex media took more than max_steps"):
        image = tr.render(scene, spp=4, seed=0)
    assert 0 <= float(image.min()) < 0.5
    assert float(image.max()) == pytest.approx(1.0)
    found = scene.statistics["render"]
    assert 0 < found["bent_rays_lost"] <= found["bent_rays"] <= 4 * 12 * 12


def test_no_ray_is_lost_at_edges(recwarn):
    """A wide lamp in front of a cube: reflected rays come to its edges, and leave by the next face at once."""
    steep = torch.linspace(1.3, 1.7, 12, dtype=torch.float32).expand(12, 12, 12).contiguous()
    scene = thrown(steep, "dielectric", size=128, dtype=torch.float32)
    tr.render(scene, spp=64, seed=0)
    found = scene.statistics["render"]
    assert found["bent_rays_lost"] <= 2e-6 * found["bent_rays"]
    assert not [w for w in recwarn if "max_steps" in str(w.message)]


def test_a_render_is_the_same_in_parts():
    """Crops and threads change nothing."""
    scene = seen(random_index(8), "dielectric")
    whole = tr.render(scene, spp=8, seed=4)
    part = tr.render(scene, spp=8, seed=4, crop=(3, 2, 5, 6))
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    alone = tr.render(scene, spp=8, seed=4)
    torch.set_num_threads(threads)
    assert torch.equal(whole, alone)
    assert torch.equal(part, whole[3:8, 2:8])
