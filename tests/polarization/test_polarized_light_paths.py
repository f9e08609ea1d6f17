"""Polarised light along paths from the lights: the images and the derivatives of paths from the camera."""

from __future__ import annotations

import math

import pytest
import torch
from moving_differences import agrees, compare
from polarized_derivatives import along, check, image, modes, turning
from shadow_scenes import room

import torchrender as tr

pytestmark = [pytest.mark.core, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]
T = tr.Transform
STOKES = [0.5, 0.3, -0.4]
GOLD = {"type": "roughconductor", "eta": 0.5, "k": 3.43, "alpha": 0.4}
ALUMINIUM = {"type": "roughconductor", "eta": 1.37, "k": 7.62, "alpha": 0.5}
BALLS = {
    "metal": GOLD,
    "glass": {"type": "roughdielectric", "int_ior": 1.5, "ext_ior": 1.0, "alpha": 0.4},
    "plastic": {"type": "roughplastic", "alpha": 0.3, "diffuse_reflectance": 0.6},
    "pplastic": {"type": "pplastic", "alpha": 0.3, "diffuse_reflectance": 0.6},
    "blend": {"type": "blendbsdf", "weight": 0.4, "a": GOLD, "b": {"type": "diffuse"}},
    "grey": {"type": "diffuse"},
}
ABOVE = T.look_at([-0.5, -3.5, 1], [0, 0, 0], [0.2, 0, 1])
BELOW = T.look_at([0.3, 0, -1.3], [0.5, -0.2, -2.5], [0.2, 1, 0])
SPOT = {"type": "spot", "intensity": 20.0, "cutoff_angle": 60.0, "beam_width": 30.0, "stokes": STOKES}
LAMPS = {
    "area": {"type": "rectangle", "to_world": ABOVE, "emitter": {"type": "area", "radiance": 8.0, "stokes": STOKES}},
    "point": {"type": "point", "position": [-0.5, -3.5, 1], "intensity": 20.0, "stokes": STOKES},
    "spot": {**SPOT, "to_world": ABOVE, "cutoff_angle": 25.0, "beam_width": 20.0},
    "directional": {"type": "directional", "to_world": ABOVE, "irradiance": 3.0, "stokes": STOKES},
    "projector": {
        "type": "projector",
        "to_world": ABOVE,
        "fov": 45.0,
        "irradiance": {"type": "bitmap", "data": torch.ones(4, 4, 1).double(), "raw": True},
        "scale": 20.0,
        "stokes": STOKES,
    },
}


def scene_of(ball: dict, lamp: dict, floor: dict | None = None, depth: int = 2, **objects) -> tr.Scene:
    """The middle of a ball, lit by a lamp, or by what a floor reflects of one below the ball: no edge is in sight."""
    pose = T.look_at([2.5, -2.5, -1.5] if floor else [2.5, -2.5, 1.5], [0.1, -0.1, -0.2], [0.3, 0.1, 1])
    film = {"type": "hdrfilm", "width": 4, "height": 4, "sample_border": True}
    objects |= {"ball": {"type": "sphere", "bsdf": ball}, "lamp": lamp}
    if floor:
        objects["floor"] = {"type": "rectangle", "to_world": T.translate([0, 0, -2.5]) @ T.scale(20), "bsdf": floor}
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "ptracer", "max_depth": depth, "rr_depth": 100},
            "sensor": {"type": "perspective", "fov": 14, "to_world": pose, "film": film},
            **objects,
        },
        dtype=torch.float64,
    )


def over_floor(ball: str) -> tr.Scene:
    return scene_of(BALLS[ball], {**SPOT, "to_world": BELOW}, ALUMINIUM, 3)


def both_ways(scene: tr.Scene, run, samples: tuple[int, int], seeds: int = 12) -> torch.Tensor:
    """z of the means of pixels by paths from the lights and from the camera, of a scene in single precision."""
    means, variances = [], []
    depth = scene.integrator.max_depth
    for integrator, spp in zip((tr.ParticleTracer, tr.PathTracer), samples, strict=True):
        scene.integrator = integrator(max_depth=depth, rr_depth=100)
        found = torch.stack([run(seed, spp).mean((0, 1, 2)) for seed in range(seeds)])
        means.append(found.mean(0))
        variances.append(found.var(0) / seeds)
    size = means[1].abs().max()
    assert float(size) > 1e-4
    assert float(variances[0].max().sqrt()) < 0.2 * float(size)  # sharp enough to tell something
    return (means[0] - means[1]) / (variances[0] + variances[1] + (1e-9 * size) ** 2).sqrt()


def stokes_of(scene: tr.Scene):
    return lambda seed, spp: tr.render(scene, spp=spp, seed=seed, outputs=("stokes",)).stokes


@pytest.mark.parametrize("ball", BALLS)
def test_images(ball):
    """z of 4 means over 12 seeds, 11 degrees of freedom at least: 6 by chance in less than 4e-4 of the cases."""
    scene = over_floor(ball).to(torch.float32)
    z = both_ways(scene, stokes_of(scene), (2048, 64))
    assert float(z.abs().max()) < 6, z


@pytest.mark.parametrize("kind", LAMPS)
def test_lamps(kind):
    """As above; of every lamp, whose light has an axis of its own."""
    scene = scene_of(GOLD, LAMPS[kind]).to(torch.float32)
    z = both_ways(scene, stokes_of(scene), (4096, 64))
    assert float(z.abs().max()) < 6, z


def derivative(scene: tr.Scene, name: str, direction: torch.Tensor):
    """That of a sum over I, Q, U and V, in reverse mode."""
    base = dict(scene.named_parameters())[name].detach().clone()
    weights = torch.tensor([1.0, 0.7, -0.8, 0.9], dtype=torch.float64)

    def run(seed: int, spp: int) -> torch.Tensor:
        leaf = base.clone().requires_grad_()
        (image(scene, name, leaf, seed, spp).mean((0, 1, 2)) * weights).sum().backward()
        return (leaf.grad * direction).sum().expand(1, 1, 1, 1)

    return run


def rigid_or_random(scene: tr.Scene, name: str) -> torch.Tensor:
    """Frames turn and move; a frame of another shape has no meaning for most lights."""
    if not name.endswith("to_world"):
        return along(scene, name)
    direction = turning(dict(scene.named_parameters())[name].detach(), torch.tensor([1.0, 0.5, -0.3])) * 0.3
    direction[:3, 3] = torch.tensor([0.1, -0.05, 0.1])
    return direction


MOVED = [("metal", "floor.to_world"), ("metal", "sensor.to_world"), ("plastic", "ball.radius")]


@pytest.mark.parametrize(("ball", "name"), [*MOVED, ("blend", "ball.bsdf.weight.value")])
def test_derivatives_of_what_moves(ball, name):
    """Both kinds of paths, as above; forward and reverse mode are compared with each other."""
    scene = over_floor(ball)
    direction = rigid_or_random(scene, name)
    modes(scene, name, direction)
    scene = scene.to(torch.float32)
    z = both_ways(scene, derivative(scene, name, direction), (2048, 64))
    assert float(z.abs().max()) < 6, z


@pytest.mark.parametrize("kind", LAMPS)
def test_derivatives_of_lamps(kind):
    """Of their place or pose, as above; and of their Stokes vector by differences, which are exact."""
    scene = scene_of(GOLD, LAMPS[kind])
    stokes = "lamp.emitter.stokes" if kind == "area" else "lamp.stokes"
    check(scene, stokes, along(scene, stokes))
    name = "lamp.position" if kind == "point" else "lamp.to_world"
    direction = rigid_or_random(scene, name)
    modes(scene, name, direction)
    scene = scene.to(torch.float32)
    z = both_ways(scene, derivative(scene, name, direction), (2048, 64))
    assert float(z.abs().max()) < 6, z


def test_indices():
    """Rough metals are sampled by roughness alone: differences of the same samples are exact."""
    scene = over_floor("metal")
    for name in ("ball.bsdf.eta.value", "ball.bsdf.k.value", "floor.bsdf.k.value", "lamp.intensity.value"):
        check(scene, name, along(scene, name))


def test_edges():
    """Silhouettes and shadows in Stokes vectors that light paths bring, found by paths from the camera."""
    scene = room("rectangle", 2, {**GOLD, "alpha": 0.3})
    scene.integrator = tr.ParticleTracer(max_depth=3)
    weights = torch.tensor([0, 1.0, -1.5, 2.0], dtype=torch.float64)
    settings = {"show": lambda out: (out.stokes * weights).sum(-1), "outputs": ("stokes",)}
    derivatives, differences = compare(scene.to(torch.float32), "plate.to_world", 6, 512, 2e-2, **settings)
    passed, text = agrees(derivatives, differences, 0.02, 1)  # at 1 %
    assert passed, text
    assert float(differences.mean().abs()) > 5 * float(differences.std()) / len(differences) ** 0.5


def test_a_part_of_the_film():
    with torch.no_grad():
        whole = tr.render(over_floor("metal"), spp=8, seed=1, outputs=("stokes",)).stokes
        part = tr.render(over_floor("metal"), spp=8, seed=1, outputs=("stokes",), crop=(1, 0, 2, 3)).stokes
    assert torch.equal(part, whole[1:3, 0:3])


def bench_of(theta: float, **more) -> tr.Scene:
    """A polarised beam of irradiance 1 through a polariser onto a white screen, which the camera sees from behind."""
    beam = {"type": "directionalarea", "radiance": 1.0, "stokes": [0.6, 0.3, 0.5]}
    objects = {
        "beam": {"type": "rectangle", "to_world": T.translate([0, 0, -2]), "emitter": beam},
        "filter": {"type": "rectangle", "to_world": T.scale(4), "bsdf": {"type": "polarizer", "theta": theta}},
        "screen": {"type": "rectangle", "to_world": T.translate([0, 0, 2]) @ T.rotate([1, 0, 0], 180) @ T.scale(4)},
    }
    pose = T.look_at([0, 0.2, 1], [0, 0, 2], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 2, "height": 2, "sample_border": True}
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "ptracer", "max_depth": 4},
            "sensor": {"type": "perspective", "fov": 20, "to_world": pose, "film": film},
            **objects,
            **more,
        },
        dtype=torch.float64,
    )


@pytest.mark.parametrize("theta", [0.0, 30.0, 75.0])
def test_a_beam_through_a_polariser(theta):
    """Malus' law: of a beam (1 + Q cos 2a + U sin 2a) / 2 passes an axis at the angle a from the beam's.

    The axis is at -theta: as light comes from behind, the plate turns clockwise. The same samples without polarisation
    pass a half. Derivatives by the angle and by the vector.
    """
    q, u = 0.6, 0.3
    scene = bench_of(theta)
    with torch.no_grad():
        vector = {"beam.emitter.stokes": torch.zeros(3, dtype=torch.float64)}
        half = tr.render(scene, spp=16, seed=0, outputs=("stokes",), params=vector).stokes[..., 0]
        passed = tr.render(scene, spp=16, seed=0, outputs=("stokes",)).stokes[..., 0]
    angle = math.radians(-2 * theta)
    torch.testing.assert_close(passed, half * (1 + q * math.cos(angle) + u * math.sin(angle)), rtol=1e-10, atol=0)
    for name in ("filter.bsdf.theta.value", "beam.emitter.stokes"):
        check(scene, name, along(scene, name))


def test_plates():
    """Light through a polariser, a retarder and a circular polariser on its way to a ball; as above."""
    bsdfs = (
        {"type": "polarizer", "theta": 20.0},
        {"type": "retarder", "theta": 50.0, "delta": 70.0},
        {"type": "circular"},
    )
    turn = T.rotate([0, 1, 0], 15) @ T.rotate([0, 0, 1], 10) @ T.scale(1.5)
    plates = {
        f"plate_{k}": {"type": "rectangle", "to_world": ABOVE @ T.translate([0, 0, 0.5 * (k + 1)]) @ turn, "bsdf": bsdf}
        for k, bsdf in enumerate(bsdfs)
    }
    scene = scene_of(GOLD, LAMPS["area"], depth=5, **plates)
    z = both_ways(scene, stokes_of(scene), (4096, 1024))
    assert float(z.abs().max()) < 6, z


def test_a_meter_measures_intensity_alone():
    meter = {"type": "irradiancemeter", "film": {"type": "hdrfilm", "width": 2, "height": 2}}
    scene = tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "ptracer"},
            "screen": {"type": "rectangle", "bsdf": {"type": "diffuse"}, "sensor": meter},
            "lamp": {"type": "point", "position": [0, 0, 2.0], "intensity": 1.0},
        }
    )
    with pytest.raises(ValueError, match="an irradiancemeter has no 'stokes'"):
        tr.render(scene, spp=1, outputs=("stokes",))
