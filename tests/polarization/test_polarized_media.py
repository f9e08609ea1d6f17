"""Polarised light in participating media: closed forms, a plain simulation, and derivatives."""

from __future__ import annotations

import math

import pytest
import torch
from media_truth import assert_mean, pencil
from polarized_derivatives import along, check, modes, sky, turning
from polarized_scenes import room
from polarized_simulation import Ball
from torch.autograd import forward_ad

import torchrender as tr

pytestmark = [pytest.mark.core, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]
T = tr.Transform
DOUBLE = torch.float64
GOLD = {"type": "conductor", "eta": 0.183, "k": 3.43}
RAYLEIGH = {"type": "rayleigh"}


def rgb(*values: float) -> dict:
    return {"type": "rgb", "value": list(values)}


def medium(sigma_t=1.0, albedo=0.8, phase=None, **more) -> dict:
    return {
        "type": "homogeneous",
        "sigma_t": sigma_t,
        "albedo": albedo,
        "phase": phase or {"type": "isotropic"},
        **more,
    }


def ball(inside: dict, **more) -> dict:
    return {"type": "sphere", "bsdf": {"type": "null"}, "interior": inside, **more}


def load(objects: dict, depth: int = -1, dtype=DOUBLE, **settings) -> tr.Scene:
    integrator = {"type": "volpath", "max_depth": depth, "rr_depth": 1000, **settings}
    return tr.load_dict({"type": "scene", "integrator": integrator, **objects}, dtype=dtype)


def stokes(scene: tr.Scene, spp: int = 4, seed: int = 0, **settings) -> torch.Tensor:
    with torch.no_grad():
        return tr.render(scene, spp=spp, seed=seed, outputs=("stokes",), **settings).stokes


# --------------------------------------------------------------------------------------------------------------- images
def test_without_media_it_is_the_image_of_paths():
    """The same random numbers; `circular` last, so that V is there, too."""
    gold = {**GOLD, "type": "roughconductor", "alpha": 0.3}
    film = {"type": "rectangle", "to_world": T.translate([0, 0, 1.5]) @ T.scale(0.7), "bsdf": {"type": "circular"}}
    scene = tr.load_dict(room(gold, GOLD, film=film), dtype=DOUBLE)
    paths = stokes(scene)
    assert torch.allclose(stokes(scene, integrator=tr.VolumetricPathTracer(5, 100)), paths, rtol=1e-10, atol=1e-12)
    assert float(paths[..., 1:].abs().amax((0, 1, 2)).min()) > 1e-3


def fog_and_diffuse_things() -> dict:
    """Nothing polarises here; a wall that does not scatter within a fog, which emits, too."""
    return {
        "sensor": {**pencil([0, -4, 0.3], [0, 0, 0], 8), "fov": 30.0},
        "fog": ball(medium(rgb(0.5, 1.0, 2.0), 0.7, emission=rgb(0.1, 0.2, 0.1))),
        "core": ball(medium(3.0, 0.9), radius=0.4),
        "floor": {"type": "rectangle", "to_world": T.translate([0, 0, -1.2]) @ T.scale(3)},
        "lamp": {"type": "point", "position": [1, -1, 2], "intensity": 5.0},
        "sky": {"type": "constant", "radiance": 0.3},
    }


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_unpolarised_light_has_the_image_of_intensities(dtype):
    """Of more than 64 segments, too."""
    objects = fog_and_diffuse_things()
    objects["core"]["interior"] = medium(60.0, 0.999)
    scene = load(objects, dtype=dtype)
    found = stokes(scene)
    with torch.no_grad():
        image = tr.render(scene, spp=4, seed=0)
    assert torch.allclose(found[..., 0], image, rtol=1e-4 if dtype is torch.float32 else 1e-11)
    assert float(found[..., 1:].abs().max()) == 0.0


def test_a_mirror_behind_an_absorbing_fog():
    """The fog takes its share of each colour, the mirror polarises as without it, boundaries change nothing."""
    angle, sigma = math.radians(65), torch.tensor([0.2, 0.5, 1.0], dtype=DOUBLE)
    camera = pencil([0, -4 * math.sin(angle), 4 * math.cos(angle)], [0, 0, 0], 64)
    plane = {"type": "rectangle", "to_world": T.scale(100), "bsdf": GOLD}
    objects = {"sensor": camera, "plane": plane, "sky": {"type": "constant"}}
    clear = stokes(load(objects))[0, 0]
    objects["fog"] = ball(medium(rgb(*sigma.tolist()), 0.0))
    scene = load(objects)
    runs = stokes(scene, spp=16, sampler="independent").flatten(0, 1)
    assert_mean(runs, torch.exp(-2 * sigma)[:, None] * clear, precision=0.1)
    sure = runs[..., 0] > 0
    assert torch.allclose((runs[..., 1] / runs[..., 0])[sure], (clear[:, 1] / clear[:, 0]).mean(), rtol=1e-4)


@pytest.mark.parametrize("degrees", [15, 60, 90, 130])
def test_single_scattering_by_rayleigh(degrees):
    """DoLP is sin^2 / (1 + cos^2), across the plane of scattering: horizontal, under a sun in the vertical plane."""
    angle = math.radians(degrees)
    sun = {"type": "directional", "direction": [math.cos(angle), 0, -math.sin(angle)], "irradiance": 2.0}
    camera = {**pencil([3, 0, 0], [0, 0, 0], 4), "to_world": T.look_at([3, 0, 0], [0, 0, 0], [0, 0, 1])}
    scene = load({"sensor": camera, "sun": sun, "air": ball(medium(0.5, 0.9, RAYLEIGH))}, depth=2)
    out = stokes(scene, spp=16).mean((0, 1, 2))
    cosine = math.cos(angle)
    expected = (1 - cosine**2) / (1 + cosine**2)
    assert float(out[1] / out[0]) == pytest.approx(expected, abs=2e-5)
    assert float(out[2:].abs().max() / out[0]) < 2e-5
    # rolled by 30 degrees, Q turns into U
    camera["to_world"] = T.look_at([3, 0, 0], [0, 0, 0], [0, -math.sin(math.pi / 6), math.cos(math.pi / 6)])
    out = stokes(load({"sensor": camera, "sun": sun, "air": ball(medium(0.5, 0.9, RAYLEIGH))}, depth=2), spp=16)
    q, u = (out.mean((0, 1, 2))[1:3] / out.mean((0, 1, 2))[0]).tolist()
    assert math.hypot(q, u) == pytest.approx(expected, abs=2e-5)
    assert abs(math.atan2(u, q)) == pytest.approx(math.pi / 3, abs=1e-3)


BLEND = {"type": "blendphase", "weight": 0.7, "a": {"type": "hg", "g": 0.4}, "b": RAYLEIGH}
VIEW = T.look_at([2.5, 1.0, 0.5], [0.1, -0.2, 0.3], [0.2, 0.3, 1.0])
SUN = T.look_at([0, 0, 0], [0.3, -0.5, -0.8], [0.4, 0.2, 1.0])
SHARES = [0.5, -0.3, 0.6]
PLACES = {  # in a scene, of what the simulation has
    "to_world": "sensor.to_world",
    "center": "air.center",
    "radius": "air.radius",
    "irradiance": "sun.irradiance.value",
    "shares": "sun.stokes",
    "sigma": "air.interior_medium.sigma_t.value.value",
    "albedo": "air.interior_medium.albedo.value.value",
    "share": "air.interior_medium.phase_function.weight.value.value",
    "g": "air.interior_medium.phase_function.phase_0.g",
}


def sunny_ball(phase: dict, orders: int, shares: list[float]) -> tr.Scene:
    camera = {**pencil([1, 0, 0], [0, 0, 0], 48), "to_world": VIEW}
    sun = {"type": "directional", "to_world": SUN, "irradiance": 3.0, "stokes": shares}
    integrator = {"type": "volpath", "max_depth": orders + 1, "rr_depth": 1000}
    objects = {"sensor": camera, "sun": sun, "air": ball(medium(2.0, 0.9, phase))}
    return tr.load_dict({"type": "scene", "integrator": integrator, **objects}, variant="mono")


def simulated_ball(share: float, shares: list[float]) -> Ball:
    numbers = {"radius": 1.0, "irradiance": 3.0, "sigma": 2.0, "albedo": 0.9, "share": share, "g": 0.4}
    to_world = torch.tensor(VIEW.matrix.tolist(), dtype=DOUBLE)
    sun = torch.tensor(SUN.matrix.tolist(), dtype=DOUBLE)
    polarised = torch.tensor(shares, dtype=DOUBLE)
    vectors = {"center": torch.zeros(3, dtype=DOUBLE), "sun": sun, "shares": polarised, "to_world": to_world}
    return Ball(**vectors, **{name: torch.tensor(x, dtype=DOUBLE) for name, x in numbers.items()})


def assert_equal_means(ours: torch.Tensor, plain: torch.Tensor, precision: float) -> None:
    """z of I, Q, U and, where there is some, V: 4.2 by chance in 1.1e-4 of the cases; seeds are fixed."""
    error = (ours.var(0) / len(ours) + plain.var(0) / len(plain)).sqrt()
    used = error > 0
    z = (ours.mean(0) - plain.mean(0))[used] / error[used]
    assert float(z.abs().max()) < 4.2, (z, plain.mean(0))
    assert float(error.max()) < precision * float(plain.mean(0).abs().max()), (error, plain.mean(0))


@pytest.mark.parametrize("case", ["rayleigh", "blend"])
def test_multiple_scattering_is_that_of_a_plain_simulation(case):
    """Four orders of scattering in a ball, with matrices and angles of a textbook."""
    phase, share, shares = (RAYLEIGH, 1.0, [0.0] * 3) if case == "rayleigh" else (BLEND, 0.7, SHARES)
    runs = stokes(sunny_ball(phase, 4, shares), spp=64).flatten(0, 2).double()
    if case == "rayleigh":
        assert float(runs[:, 3].abs().max()) == 0.0  # nothing makes light circular
    plain = simulated_ball(share, shares).samples(4, 30_000)
    assert_equal_means(runs, plain, 0.01)
    assert float(plain.mean(0)[1:3].abs().max()) > 0.1 * float(plain.mean(0)[0])


@pytest.mark.parametrize("name", PLACES)
def test_derivatives_of_multiple_scattering(name):
    """Those of the simulation by dual numbers, of what is sampled by parameters and of what moves."""
    scene, simulation = sunny_ball(BLEND, 3, SHARES), simulated_ball(0.7, SHARES)
    base = getattr(simulation, name)
    direction = torch.randn(base.shape, generator=torch.Generator().manual_seed(5), dtype=DOUBLE)
    if name == "to_world":
        direction = turning(base, torch.tensor([0.2, 1.0, -0.4], dtype=DOUBLE))
        direction[:3, 3] = torch.tensor([0.3, -0.2, 0.4])
    with forward_ad.dual_level():
        setattr(simulation, name, forward_ad.make_dual(base, direction))
        plain = forward_ad.unpack_dual(simulation.samples(3, 8_000)).tangent
        value = dict(scene.named_parameters())[PLACES[name]].detach()
        dual = forward_ad.make_dual(value.clone(), direction.to(value.dtype).reshape(value.shape))
        out = tr.render(scene, params={PLACES[name]: dual}, spp=64, seed=1, outputs=("stokes",))
        ours = forward_ad.unpack_dual(out.stokes).tangent.flatten(0, 2).double()
    assert_equal_means(ours, plain, 0.15)


def test_plates_in_media_are_crossed_by_paths_alone():
    """Malus' law behind a fog; light of a point behind a plate is not found, as without polarisation."""
    camera = pencil([0, 0, 4], [0, 0, 0], 4)
    turned = [{"type": "polarizer", "theta": theta} for theta in (0.0, 40.0)]
    plates = {
        f"p{i}": {"type": "rectangle", "to_world": T.translate([0, 0, 0.3 * i]), "bsdf": bsdf}
        for i, bsdf in enumerate(turned)
    }
    objects = {"sensor": camera, **plates, "sky": {"type": "constant"}, "fog": ball(medium(1e-9, 0.0), radius=2)}
    found = stokes(load(objects))[..., 0]
    assert torch.allclose(found, torch.full_like(found, 0.5 * math.cos(math.radians(40)) ** 2), atol=1e-6)
    objects["fog"] = ball(medium(1.0, 0.9, RAYLEIGH), center=[0, 0, 2])
    objects["sky"] = {"type": "point", "position": [0, 0, -1], "intensity": 5.0}
    wide = {**plates["p0"], "to_world": T.scale(50)}
    assert float(stokes(load({**objects, "p0": wide}), spp=16).abs().max()) == 0.0


def test_scene_files_and_other_integrators():
    objects = {
        "sensor": pencil([0, 0, 4], [0, 0, 0], 2),
        "sky": {"type": "constant"},
        "air": ball(medium(phase=RAYLEIGH)),
    }
    nested = {"type": "stokes", "nested": {"type": "volpath", "max_depth": 3}}
    scene = tr.load_dict({"type": "scene", "integrator": nested, **objects})
    assert tr.render(scene, spp=2).shape == (2, 2, 3, 4)
    table = load({**objects, "air": ball(medium(phase={"type": "tabphase", "values": "1, 2, 1"}))})
    with pytest.warns(UserWarning, match=r"air.interior_medium.phase_function \(tabphase\): what this scatters is"):
        stokes(table)


# ---------------------------------------------------------------------------------------------------------- derivatives
def haze(phase: dict, sigma=1.2, depth: int = 6, **more) -> tr.Scene:
    """A gold ball and a wave plate in a ball of haze over a mirror; all of it is seen at once."""
    camera = {
        **pencil([3, -3.5, 2], [0.2, 0.1, -0.3], 4),
        "fov": 12.0,
        "to_world": T.look_at([3, -3.5, 2], [0.2, 0.1, -0.3], [0.3, 0.1, 1]),
    }
    inside = {"type": "ref", "id": "air"}
    plate = T.look_at([0.9, -1.0, 0.4], [0.2, 0.1, -0.3], [0.3, 0.1, 1]) @ T.scale(0.4)
    return load(
        {
            "sensor": camera,
            "air": medium(sigma, rgb(0.9, 0.8, 0.6), phase, emission=rgb(0.05, 0.1, 0.2)),
            "shell": {**ball(inside), "radius": 1.5},
            "gold": {"type": "sphere", "radius": 0.6, "bsdf": GOLD, "exterior": inside},
            "wave": {
                "type": "rectangle",
                "to_world": plate,
                "bsdf": {"type": "retarder", "theta": 30.0, "delta": 70.0},
            },
            "floor": {"type": "rectangle", "to_world": T.translate([0, 0, -1.6]) @ T.scale(9), "bsdf": GOLD},
            "sky": {"type": "envmap", "bitmap": sky()},
            "lamp": {"type": "point", "position": [0.3, -1.0, 2.2], "intensity": rgb(6.0, 5.0, 4.0)},
            **more,
        },
        depth,
    )


EXACT = [
    "air.albedo.value.value",
    "air.emission.value.value",
    "gold.bsdf.k.value",
    "wave.bsdf.theta.value",
    "sky.scale",
    "lamp.intensity.value",
]


@pytest.mark.parametrize("name", EXACT)
def test_differences_of_the_same_samples(name):
    scene = haze(RAYLEIGH, rgb(0.7, 1.2, 2.0))
    check(scene, name, along(scene, name))


@pytest.mark.parametrize("phase", [RAYLEIGH, {"type": "hg", "g": 0.4}, BLEND], ids=["rayleigh", "hg", "blend"])
@pytest.mark.parametrize("sigma", [1.2, rgb(0.7, 1.2, 2.0)], ids=["grey", "coloured"])
def test_reverse_is_forward(phase, sigma):
    """Of what is sampled by parameters, and of what moves."""
    scene = haze(phase, sigma)
    names = ["air.sigma_t.value.value", "gold.center", "lamp.position", "sensor.to_world", "shell.radius"]
    if phase is BLEND:
        names += ["air.phase_function.weight.value.value", "air.phase_function.phase_0.g"]
    for name in names:
        assert float(modes(scene, name, along(scene, name))[1][..., 1:3].abs().max()) > 1e-5, name


def test_paths_of_many_blocks():
    """The albedo, the mirror behind and, of forward mode, a place, where paths are longer than 64 segments."""
    scene = haze(RAYLEIGH, 12.0, depth=200)
    scene.air.albedo.value.value = torch.full((3,), 0.97, dtype=DOUBLE)
    for name in ("air.albedo.value.value", "gold.bsdf.k.value"):
        check(scene, name, along(scene, name), tolerance=1e-5)
    for name in ("air.sigma_t.value.value", "lamp.position"):
        modes(scene, name, along(scene, name))


@pytest.mark.parametrize("phase", [RAYLEIGH, BLEND], ids=["rayleigh", "blend"])
def test_a_polarised_lamp_moves(phase):
    """Of scattering on both sides of a mirror: differences of the same samples are exact."""
    camera = {
        **pencil([3, -3.5, 2], [0.2, 0.1, 0.1], 2),
        "to_world": T.look_at([3, -3.5, 2], [0.2, 0.1, 0.1], [0.3, 0, 1]),
    }
    floor = {"type": "rectangle", "to_world": T.translate([0, 0, -1.3]) @ T.scale(500), "bsdf": GOLD}
    lamp = {"type": "point", "position": [0.3, -1.0, 2.2], "intensity": 6.0, "stokes": SHARES}
    scene = load({"sensor": camera, "floor": floor, "lamp": lamp, "air": ball(medium(0.9, 0.9, phase))}, 4)
    for name in ("lamp.position", "lamp.stokes", "lamp.intensity.value"):
        check(scene, name, along(scene, name), 1e-3)  # a wide step: rays are queried in single precision
