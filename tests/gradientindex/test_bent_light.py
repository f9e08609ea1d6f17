"""Absorption and emission of media that bend light: closed forms, the oracle, derivatives of rays and of pictures."""

from __future__ import annotations

import math

import pytest
import torch
from bent_scenes import BOX, DOUBLE, beam, centers, difference, direction_like, glass, in_both_modes, random_index
from bent_scenes import number_of as number_of_rays
from gradientindex_scenes import INDEX, T, derivatives, seen, thrown
from oracle.bend import Glow, Phi, trace_box

import torchrender as tr

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
ONE = {"sky": {"type": "constant", "radiance": 1.0}}
WIDE = T.translate([-1.2, -1.1, -1.3]) @ T.rotate([1, 2, 3], 10) @ T.scale([2.4, 2.3, 2.5])


def grid(channels: int = 3, seed: int = 5, size: tuple[int, int, int] = (5, 4, 6), **more: object) -> dict:
    """A volume of random values from 0.2 to 0.8, whose cube is not that of the index."""
    values = 0.2 + 0.6 * torch.rand(*size, channels, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE)
    return {"type": "gridvolume", "data": values, "to_world": WIDE, **more}


def upwards(n: int = 3) -> tuple[torch.Tensor, torch.Tensor]:
    o = torch.tensor([[0.1, 0.2, -3.0], [-0.3, 0.05, -3.0], [0.4, -0.6, -3.0]], dtype=DOUBLE)[:n]
    return o, torch.tensor([[0.0, 0.0, 1.0]], dtype=DOUBLE).expand(n, 3).contiguous()


# ---------------------------------------------------------------------------------------------------- closed forms
def test_a_constant_medium_is_exact():
    """Through 2 of it, sigma and eps the same everywhere: also where steps do not fit."""
    sigma, eps = torch.tensor([0.3, 0.0, 4.0], dtype=DOUBLE), torch.tensor([0.5, 0.7, 0.2], dtype=DOUBLE)
    for step in (1.0, 0.37, 1.9):
        scene = glass(1.4, "null", sigma_t=sigma.tolist(), emission=eps.tolist(), step=step, scale=0.5)
        found = tr.gradientindex.trace(scene, "lens", *upwards())
        x = sigma
        mean = torch.where(x > 0, -torch.expm1(-x) / x.clamp(min=1e-9), 1.0)
        assert torch.allclose(found.transmittance, torch.exp(-x).expand(3, 3), rtol=1e-12)
        assert torch.allclose(found.emission, (eps / 1.4**2 * 2 * mean).expand(3, 3), rtol=1e-12)


def test_a_dark_medium_emits_nothing():
    found = tr.gradientindex.trace(glass(random_index(8), "null", sigma_t=0.4), "lens", *upwards())
    assert not bool(found.emission.any())
    assert torch.allclose(found.transmittance[:, 0], torch.exp(-0.4 * found.length), rtol=1e-12)


@pytest.mark.parametrize("bsdf", ["null", "dielectric"])
def test_a_grid_of_one_value_is_a_constant(bsdf):
    """Rays and pictures."""
    colour = torch.tensor([0.3, 0.9, 0.1], dtype=DOUBLE)
    volume = {"type": "gridvolume", "data": colour.expand(3, 2, 4, 3).contiguous(), "to_world": WIDE}
    index = random_index(8)
    glow = {**volume, "data": torch.full_like(volume["data"], 0.2)}
    plain, gridded = {"sigma_t": colour.tolist(), "emission": [0.2] * 3}, {"sigma_t": volume, "emission": glow}
    a, b = (tr.gradientindex.trace(glass(index, bsdf, **m), "lens", *beam(20)) for m in (plain, gridded))
    assert torch.allclose(a.transmittance, b.transmittance, rtol=1e-12)
    assert torch.allclose(a.emission, b.emission, rtol=1e-12)
    dark = tr.gradientindex.trace(glass(index, bsdf, sigma_t=colour.tolist()), "lens", *beam(20))
    assert torch.allclose(dark.transmittance, b.transmittance, rtol=1e-12)
    images = [tr.render(seen(index, bsdf, **m), spp=2, seed=0) for m in (plain, gridded)]
    assert torch.allclose(*images, rtol=1e-11)


def test_emission_along_parabolas():
    """n^2 = a + b x: a ray is a parabola, on which the integral of ds / n^2 is one of dt / n. Of second order."""
    a, b, half = 2.0, 0.5, 1.3
    errors = []
    for step in (1.0, 0.5):
        x, _, _ = centers(20, half)
        to_world = T.translate([-half] * 3) @ T.scale(2 * half)
        scene = glass(torch.sqrt(a + b * x), "null", to_world=to_world, emission=0.8, step=step)
        o, d = upwards()
        found = tr.gradientindex.trace(scene, "lens", o, d)
        p_z = torch.sqrt(a + b * o[:, 0])  # d x / d t = p, p_z constant, from z = -1 to 1
        t = 2 / p_z
        expected = 0.8 * torch.asinh(b / 2 * t / p_z) / (b / 2)
        errors.append(float((found.emission[:, 0] - expected).abs().max()))
    assert errors[0] < 2e-4
    assert 3 < errors[0] / errors[1] < 5


def test_a_picture_is_what_rays_find():
    """What comes from behind, less what is absorbed, and what is emitted: by `trace` along the ray of a meter."""
    scene = seen(random_index(8), back=ONE, sigma_t=grid(), emission=grid(seed=6))
    o, to = torch.tensor([[3.0, 2.0, 4.0]], dtype=DOUBLE), torch.tensor([[0.1, 0.0, 0.2]], dtype=DOUBLE)
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    place = T.look_at(o[0].tolist(), to[0].tolist(), [0, 1, 0])
    meter = tr.load_dict({"type": "radiancemeter", "to_world": place, "film": film})
    found = tr.render(scene, sensor=meter, spp=1, seed=0)[0, 0]
    along = tr.gradientindex.trace(scene, "lens", o, to - o)
    assert torch.allclose(found, (along.transmittance + along.emission)[0], rtol=1e-6)
    assert 0.1 < float(along.transmittance[0, 0]) < 0.9


def test_black_bodies_hide_what_is_behind():
    """Emission eps = sigma B n^2 of an opaque medium: the radiance B outside, whatever the index."""
    scene = seen(1.3, back=ONE, size=4, sigma_t=300.0, emission=300.0 * 0.7 * 1.3**2)
    film = {"type": "hdrfilm", "width": 2, "height": 2}
    place = T.look_at([3, 2, 4], [0, 0, 0], [0, 1, 0])
    camera = tr.load_dict({"type": "perspective", "fov": 5, "to_world": place, "film": film})
    image = tr.render(scene, sensor=camera, spp=2, seed=0)
    assert torch.allclose(image, torch.full_like(image, 0.7), rtol=1e-9)


# -------------------------------------------------------------------------------------------------------- the oracle
@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
def test_values_and_gradients_of_the_oracle(interpolation):
    size = (9, 11, 8)  # voxels along z, y, x of [-1, 1]^3
    noise = torch.randn(size, generator=torch.Generator().manual_seed(1), dtype=DOUBLE)
    volumes = [grid(1)["data"], grid(1, seed=6)["data"]]
    leaves = [t.clone().requires_grad_() for t in (1.5 + 0.04 * noise, *volumes, *beam(40))]
    medium = {"sigma_t": {**grid(1), "to_world": BOX}, "emission": {**grid(1), "to_world": BOX}}
    scene = glass(leaves[0].detach(), "null", interpolation=interpolation, **medium)
    names = ("index", "sigma_t.data", "emission.data")
    params = {f"lens.interior.{n}": t for n, t in zip(names, leaves)}
    rays = tr.gradientindex.trace(scene, "lens", *leaves[3:], params=params)
    assert bool(rays.valid.all())

    voxels = torch.tensor(size[::-1], dtype=DOUBLE)
    phi = Phi(leaves[0], 3 if interpolation == "cubic" else 2)
    o, d = leaves[3], leaves[4] / leaves[4].norm(dim=1, keepdim=True)
    q = (o + d * ((-1 - o[:, 2]) / d[:, 2])[:, None] + 1) / 2 * voxels
    step = 2 / max(size) / (math.ceil(float(leaves[0].detach().max()) * 16) / 16)
    u = step * d * torch.sqrt(2 * phi(q)[0])[:, None] * voxels / 2
    glow = Glow(leaves[1][..., 0], leaves[2][..., 0], voxels, step)
    found = trace_box(phi, q, u, torch.diag((step * voxels / 2) ** 2), glow=glow)
    ours = rays.transmittance[:, 0], rays.emission[:, 0]
    theirs = torch.exp(-found.depth), found.emitted
    for a, b in zip(ours, theirs):
        assert torch.allclose(a, b, rtol=1e-10)
    weight = torch.linspace(0.5, 1.5, 40, dtype=DOUBLE)
    sums = [(weight * (torch.sin(a) + b.square())).sum() for a, b in (ours, theirs)]
    for a, b in zip(*(torch.autograd.grad(s, leaves) for s in sums)):
        assert float((a - b).norm()) < 1e-9 * float(b.norm())


# ------------------------------------------------------------------------------------------------------- derivatives
MEDIUM = {"sigma_t": grid(), "emission": grid(1, seed=6), "scale": 0.8}
OF_VOLUMES = [f"{volume}.{name}" for volume in ("sigma_t", "emission") for name in ("data", "to_world")]
OF_RAYS = ["index", "index_base", "to_world", "scale", *OF_VOLUMES]


@pytest.mark.parametrize("name", ["origins", "directions", *OF_RAYS])
def test_derivatives_of_rays(name):
    """By differences, within the cells of all grids: those of a trilinear one have kinks between them."""
    scene, rays = glass(random_index(12), "null", **MEDIUM), beam(60, width=0.8)
    if name in ("origins", "directions"):
        x = rays[name == "directions"]

        def of(value):
            return (rays[0], value) if name == "directions" else (value, rays[1])

        def f(value):
            return number_of_rays(tr.gradientindex.trace(scene, "lens", *of(value)))
    else:
        x = scene.get_parameter(f"lens.interior_medium.{name}").detach()

        def f(value):
            return number_of_rays(tr.gradientindex.trace(scene, "lens", *rays, params={f"lens.interior.{name}": value}))

    along = direction_like(x)
    if name.endswith("to_world"):
        along[3] = 0
        if name == "to_world":  # whose columns are the length of steps
            along.fill_diagonal_(0)
    reverse, forward = in_both_modes(f, x, along)
    assert abs(reverse) > 1e-3
    assert forward == pytest.approx(reverse, rel=1e-9)
    assert difference(f, x, along, 1e-6) == pytest.approx(reverse, rel=1e-6)


OF_PICTURES = [INDEX, *(f"lens.interior_medium.{n}" for n in OF_RAYS[2:]), "lens.radius"]


@pytest.mark.parametrize("name", OF_PICTURES)
def test_derivatives_of_pictures(name):
    reverse, forward, found = derivatives(seen(random_index(8), size=8, **MEDIUM), name, spp=2, spp_visibility=0)
    assert abs(reverse) > 1e-3
    assert forward == pytest.approx(reverse, rel=1e-9)
    assert found == pytest.approx(reverse, rel=2e-6 if name != "lens.radius" else 2e-5)


@pytest.mark.parametrize("name", ["emission.value.value", "sigma_t.value.value", "index"])
def test_derivatives_of_a_constant_glow(name):
    scene = seen(random_index(8), "dielectric", size=6, sigma_t=[0.3, 0.1, 0.6], emission=[0.5, 0.2, 0.1])
    found = derivatives(scene, f"lens.interior_medium.{name}", spp=2, integrator=tr.PathTracer(3, 99), spp_visibility=0)
    assert abs(found[0]) > 1e-3
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    if name != "index":  # by which Fresnel's choices flip
        assert found[2] == pytest.approx(found[0], rel=1e-6)


@pytest.mark.parametrize("name", ["sigma_t.data", "scale", "index"])
def test_derivatives_of_light_paths(name):
    scene = thrown(random_index(8, 0.01), sigma_t=grid(), scale=0.8)
    reverse, forward, found = derivatives(scene, f"lens.interior_medium.{name}", spp=8)
    assert abs(reverse) > 1e-3
    assert forward == pytest.approx(reverse, rel=1e-9)
    assert found == pytest.approx(reverse, rel=2e-4)  # the film's filter has a finite support


def test_single_precision():
    """Packets, too: pictures and gradients beside those in double precision."""
    made = seen(random_index(8), size=8, **MEDIUM)
    weight = torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(0), dtype=DOUBLE)
    results = []
    for scene in (made, made.to(torch.float32)):
        names = [f"lens.interior_medium.{n}" for n in ("index", "sigma_t.data", "emission.data", "emission.to_world")]
        leaves = [scene.get_parameter(n).detach().clone().requires_grad_() for n in names]
        image = tr.render(scene, spp=4, seed=0, params=dict(zip(names, leaves)), spp_visibility=0)
        gradients = torch.autograd.grad((image * weight.to(image.dtype)).sum(), leaves)
        results.append([image.detach().double(), *(g.double() for g in gradients)])
    for a, b in zip(*results):
        assert float((a - b).norm()) < 2e-3 * float(a.norm())


def test_spectra():
    """A grey medium before a white sky, in a spectral scene and in one of colours: noise of 64 samples apart."""
    images = []
    for variant in ("rgb", "spectral"):
        inside = {"type": "gradientindex", "index": random_index(8), "to_world": BOX, "sigma_t": grid(1)}
        inside["emission"] = 0.3
        camera = {"type": "perspective", "fov": 30, "to_world": T.look_at([3, 2, 4], [0, 0, 0], [0, 1, 0])}
        camera["film"] = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
        described = {
            "type": "scene",
            "lens": {"type": "sphere", "bsdf": {"type": "null"}, "interior": inside},
            "camera": camera,
            **ONE,
        }
        scene = tr.load_dict(described, variant=variant, dtype=DOUBLE)
        images.append(tr.render(scene, spp=64, seed=0).mean((0, 1)))
    assert torch.allclose(*images, rtol=0.03)


# -------------------------------------------------------------------------------------------------------- what is not
def test_light_paths_do_not_begin_in_a_glow():
    scene = thrown(1.5, emission=1.0)
    with pytest.raises(ValueError, match=r"\.emission: light paths do not begin in a medium.*PathTracer"):
        tr.render(scene, spp=1, seed=0)


@pytest.mark.parametrize("bad", [{"sigma_t": -1.0}, {"emission": -1.0}, {"scale": -1.0}])
def test_numbers_below_zero(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        tr.render(seen(1.5, **bad), spp=1, seed=0)
    name = next(iter(bad))
    scene = seen(1.5, sigma_t=grid(), emission=grid())
    parameter = "lens.interior_medium." + (name if name == "scale" else f"{name}.data")
    value = -scene.get_parameter(parameter).detach()
    with pytest.raises(ValueError, match=name):
        tr.render(scene, spp=1, seed=0, params={parameter: value})
