"""Images of participating media: closed forms, quadratures, plane layers, and what must not change a result.

Images of single lines are compared with deterministic results by Student's test, a right renderer failing each with
probability `media_truth.SIGNIFICANCE`; seeds are fixed.
"""

from __future__ import annotations

import copy
import itertools
import math
import os
import subprocess
import sys

import media_scenes as ms
import media_truth as truth
import numpy as np
import pytest
import torch
from media_truth import assert_mean, cameras, lines, pencil, scene, seen
from oracle.media import NOTHING, Media, Tracer
from oracle.path import camera_samples
from oracle.phases import PHASES
from oracle.volumes import VOLUMES
from oracle.world import World

import torchrender as tr

DOUBLE = torch.float64
COLOURS = {"rgb": [0.2, 0.6, 1.2], "mono": 0.9}


def colour(values) -> dict | float:
    return {"type": "rgb", "value": values} if isinstance(values, list) else values


def ball(medium: dict, kind: str = "homogeneous", **more) -> dict:
    """A medium in a ball of radius 1 at the origin."""
    return {"type": "sphere", "bsdf": {"type": "null"}, "interior": {"type": kind, **medium}, **more}


def sky(radiance=1.0) -> dict:
    return {"type": "constant", "radiance": colour(radiance)}


def random_grid(seed: int, shape=(3, 4, 5, 1), high: float = 3.0, **more) -> dict:
    """A grid whose cells are empty to a third, turned and sheared, larger than the ball in some directions."""
    data = np.maximum(ms.noise(seed, shape, -0.5 * high, high), 0)
    shear = np.eye(4)
    shear[0, 1] = 0.3
    to_world = ms.rotate("x", 20) @ shear @ ms.scale(0.9, 0.6, 1.1) @ ms.UNIT_TO_CUBE
    return ms.grid(data, ms.translate(0.1, 0, 0) @ to_world, **more)


# ------------------------------------------------------------------------------------------------------ absorption only
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("variant", ["rgb", "mono"])
def test_absorption_of_a_constant(variant, dtype):
    """Beer and Lambert's law along chords of a ball, of which one misses."""
    heights = [0.0, 0.5, 0.9, 1.1]
    origins = np.array([[h, 0.0, 4.0] for h in heights])
    medium = {"sigma_t": colour(COLOURS[variant]), "scale": 1.3, "albedo": 0.0}
    objects = {**cameras(origins, origins - [0, 0, 4]), "ball": ball(medium), "sky": sky(2.0)}
    chords = 2 * torch.tensor([max(0.0, 1 - h * h) for h in heights], dtype=DOUBLE).sqrt()
    expected = 2 * torch.exp(-chords[:, None] * 1.3 * torch.tensor(COLOURS[variant]).reshape(1, -1))
    assert_mean(seen(scene(objects, variant=variant, dtype=dtype)), expected)


GRIDS = [
    {"filter_type": "trilinear", "wrap_mode": "clamp"},
    {"filter_type": "nearest", "wrap_mode": "clamp"},
    {"filter_type": "trilinear", "wrap_mode": "repeat"},
    {"filter_type": "trilinear", "wrap_mode": "mirror"},
]


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("settings", GRIDS)
def test_absorption_of_grids(settings, channels):
    origins, targets = lines(8, 1)
    grid = random_grid(2, (3, 4, 5, channels), **settings)
    medium = {"sigma_t": grid, "scale": 0.6, "albedo": 0.0}
    objects = {**cameras(origins, targets), "ball": ball(medium, "heterogeneous"), "sky": sky()}
    expected = truth.transmittance(scene(objects, dtype=DOUBLE), origins, targets)
    assert 0.05 < expected.min() < expected.max() < 0.9
    assert_mean(seen(scene(objects)), expected)


def test_exact_depths_are_those_of_many_points():
    """The quadrature of these tests against a sum over 20000 points."""
    origins, targets = lines(3, 4)
    for settings in GRIDS:
        medium = {"sigma_t": random_grid(3, **settings)}
        objects = {**cameras(origins, targets), "ball": ball(medium, "heterogeneous")}
        (some,) = Media(World(scene(objects, dtype=DOUBLE))).all
        a, b = torch.tensor(origins), torch.tensor(2 * targets - origins)
        t = (torch.arange(20000, dtype=DOUBLE) + 0.5) / 20000
        for i in range(3):
            sums = some.extinction(a[i] + (b[i] - a[i]) * t[:, None]).mean(0) * (b[i] - a[i]).norm()
            torch.testing.assert_close(some.optical_depth(a[i : i + 1], b[i : i + 1])[0], sums, rtol=5e-3, atol=0)


@pytest.mark.parametrize("shape", [(9, 8, 7, 1), (1, 1, 20, 1), (64, 3, 5, 1)])
def test_single_dense_voxels(shape):
    """Lines near the one voxel of a grid that is not empty: a majorant that misses it lets light through."""
    rng = np.random.default_rng(5)
    for _ in range(6):
        voxel = [int(rng.integers(n)) for n in shape[:3]]
        data = np.zeros(shape, dtype=np.float32)
        data[tuple(voxel)] = 2.0
        center = 2 * (np.array(voxel[::-1]) + 0.5) / np.array(shape[2::-1]) - 1
        origins = center + np.array([3.0, 0.4, 0.2]) * [[1, 1, 1], [-1, -1, 1], [0.1, 5, -3]]
        targets = center + rng.uniform(-0.4, 0.4, (3, 3)) / np.array(shape[2::-1])
        medium = {"sigma_t": ms.grid(data, ms.UNIT_TO_CUBE), "albedo": 0.0, "type": "heterogeneous"}
        objects = {**cameras(origins, targets, 8), "box": ms.boundary(medium, np.eye(4)), "sky": sky()}
        view = scene(objects, variant="mono", dtype=DOUBLE)
        assert_mean(seen(view, spp=64), truth.transmittance(view, origins, targets), f"voxel {voxel} of {shape}")


def test_majorants_follow_the_voxels():
    """A grid that becomes denser in place, by another tensor, and through `scale`."""
    origins, targets = lines(4, 6)
    medium = {"sigma_t": random_grid(7, high=0.5), "albedo": 0.0}
    objects = {**cameras(origins, targets), "ball": ball(medium, "heterogeneous"), "sky": sky()}
    view = scene(objects)
    before = seen(view)
    density, scale = (view.get_parameter(f"ball.interior_medium.{n}") for n in ("sigma_t.data", "scale"))
    for change in ("in place", "params", "scale"):
        params = None
        with torch.no_grad():
            if change == "in place":
                density[1:, :, 2:] += 1.5
            elif change == "params":
                params = {"ball.interior_medium.sigma_t.data": density.flip(0) * 1.5}
            else:
                scale.mul_(2.0)
        exact = copy.deepcopy(view).double()
        doubled = None if params is None else {n: p.double() for n, p in params.items()}
        expected = truth.transmittance(exact, origins, targets, doubled)
        assert_mean(seen(view, params=params), expected, change)
        assert float((before.mean(0) - expected).abs().max()) > 0.1


# ----------------------------------------------------------------------------------------------- all that comes goes on
FURNACES = {
    "homogeneous": {"sigma_t": 3.0, "phase": {"type": "isotropic"}},
    "forward": {"sigma_t": 3.0, "phase": {"type": "hg", "g": 0.8}},
    "coloured": {"sigma_t": {"type": "rgb", "value": [0.2, 1.0, 4.0]}, "phase": {"type": "hg", "g": -0.4}},
    "grid": {"sigma_t": random_grid(8, high=8.0)},
    "coloured grid": {"sigma_t": random_grid(9, (3, 4, 5, 3), high=5.0, filter_type="nearest")},
}


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("name", FURNACES)
def test_white_furnace(name, dtype):
    """A medium of albedo 1 under a uniform sky cannot be seen, whether Russian roulette acts or not."""
    medium = {**FURNACES[name], "albedo": 1.0}
    kind = "homogeneous" if name in ("homogeneous", "forward", "coloured") else "heterogeneous"
    camera = ms.view(origin=(0.2, 0.5, 4.0), fov=30.0)
    for rr_depth in (3, 1000):
        view = scene({"camera": camera, "ball": ball(medium, kind), "sky": sky()}, rr_depth=rr_depth, dtype=dtype)
        image = tr.render(view, spp=16, seed=2).double()
        # blocks of 3 x 3 pixels are independent runs: all have the same mean
        runs = image.reshape(8, 3, 8, 3, 3).mean((1, 3)).reshape(64, 3)
        assert_mean(runs, torch.ones(3), f"{name}, roulette from {rr_depth}")


# ---------------------------------------------------------------------------------------------------- single scattering
LAMP = (2.0, 1.0, 1.0), (0.0, 0.5, 0.0), (0.3, 0.0, -0.6)  # centre and half edges; it faces the ball
LIGHTS = {
    "point": (
        {"type": "point", "position": [1.5, 1.0, 1.2], "intensity": colour([9.0, 6.0, 3.0])},
        truth.point_light,
    ),
    "constant": (sky([0.5, 1.0, 2.0]), truth.constant_light),
    "area": (None, truth.square_light(*LAMP)),
}


def lamp(center, u, v, radiance) -> dict:
    """The rectangle of `square_light`."""
    matrix = np.eye(4)
    normal = np.cross(u, v)
    matrix[:3] = np.stack([u, v, normal / np.linalg.norm(normal), center], 1)
    emitter = {"type": "area", "radiance": colour(radiance)}
    return {"type": "rectangle", "to_world": matrix, "emitter": emitter}


SINGLE = {
    "homogeneous": {"sigma_t": colour([0.5, 1.0, 2.0]), "albedo": colour([0.9, 0.7, 0.5])},
    "grid": {
        "sigma_t": random_grid(10),
        "albedo": random_grid(11, (2, 3, 2, 3), high=0.9),
        "phase": {"type": "hg", "g": 0.6},
    },
}


@pytest.mark.parametrize(
    ("light", "medium"),
    [
        ("point", "homogeneous"),
        ("point", "grid"),
        ("constant", "homogeneous"),
        ("area", "homogeneous"),
        ("area", "grid"),
    ],
)
def test_single_scattering(light, medium):
    """At most two segments, in both precisions, against quadrature."""
    origins, targets = lines(4 if light == "point" else 2, 12)
    emitter, arriving = LIGHTS[light]
    kind = "homogeneous" if medium == "homogeneous" else "heterogeneous"
    phase = {"phase": {"type": "hg", "g": -0.4}} if light == "area" else {}
    light_object = lamp(*LAMP, [9.0, 6.0, 3.0]) if emitter is None else emitter
    objects = {**cameras(origins, targets), "ball": ball({**SINGLE[medium], **phase}, kind), "light": light_object}
    exact = scene(objects, 2, dtype=DOUBLE)
    nodes = 2 if medium == "grid" and light == "area" else 6
    expected = truth.along(exact, origins, targets, arriving, nodes=nodes)
    if light == "constant":
        expected = expected + truth.transmittance(exact, origins, targets) * torch.tensor([0.5, 1.0, 2.0])
    for view in (exact, scene(objects, 2)):
        assert_mean(seen(view, spp=64), expected, systematic=1e-3)


# ------------------------------------------------------------------------------------------------------------- emission
@pytest.mark.parametrize("sigma", [0.0, 1.5])
def test_emission_of_a_constant(sigma):
    """(1 - exp(-s l)) e / s, and e l where nothing absorbs."""
    heights = [0.0, 0.7]
    origins = np.array([[h, 0.0, 4.0] for h in heights])
    medium = {"sigma_t": sigma, "albedo": 0.0, "emission": colour([0.5, 1.0, 2.0])}
    view = scene({**cameras(origins, origins - [0, 0, 4]), "ball": ball(medium)})
    chords = 2 * torch.tensor([1 - h * h for h in heights], dtype=DOUBLE).sqrt()[:, None]
    shape = chords if sigma == 0 else (1 - torch.exp(-sigma * chords)) / sigma
    assert_mean(seen(view), shape * torch.tensor([0.5, 1.0, 2.0]))


@pytest.mark.parametrize("albedo", [0.0, 0.8])
def test_emission_of_grids(albedo):
    """Emission and extinction on different grids; only the first segment, whatever the albedo."""
    origins, targets = lines(4, 13)
    medium = {
        "sigma_t": random_grid(14),
        "albedo": albedo,
        "emission": random_grid(15, (4, 2, 3, 3), filter_type="nearest"),
    }
    objects = {**cameras(origins, targets), "ball": ball(medium, "heterogeneous")}
    view = scene(objects, 1)
    # kinks of the emission are not among the quadrature's nodes
    expected = truth.along(scene(objects, dtype=DOUBLE), origins, targets, nodes=60)
    assert_mean(seen(view), expected, systematic=5e-3)


def test_emission_scattered_many_times():
    """Glowing and scattering media with a surface in one, against a simulation without short cuts."""
    glow = {"sigma_t": 1.0, "albedo": colour([0.9, 0.6, 0.3]), "emission": random_grid(16, (3, 3, 3, 3))}
    glow["phase"] = {"type": "hg", "g": 0.4}
    objects = {
        "camera": pencil([0.4, 0.3, 4.0], [0.1, 0.0, 0.0], 32),
        "ball": ball(glow),
        "stone": {
            "type": "sphere",
            "center": [0.3, -0.2, -0.3],
            "radius": 0.4,
            "bsdf": {"type": "diffuse", "reflectance": colour([0.2, 0.5, 0.8])},
        },
    }
    view = scene(objects, dtype=DOUBLE)
    world = World(view)
    _, rays, _, _ = camera_samples(world, 3, 20, 0)
    plain = Tracer(world, -1, 3).trace(*rays[:2], NOTHING)
    ours = seen(view, spp=64)
    difference = float((plain.std(0) / math.sqrt(len(plain))).max())
    assert difference < 0.02 * float(plain.mean(0).max())
    spread = (ours[:, 0].var(0) / len(ours) + plain.var(0) / len(plain)).sqrt()
    z = (ours[:, 0].mean(0) - plain.mean(0)) / spread
    assert float(z.abs().max()) < 4.2, z  # three normal variables: 1e-4


# --------------------------------------------------------------------------------------------------------- plane layers
WIDE = 2000.0  # half the width of layers that stand for endless ones


def layers(sigma, albedo, emission=None, g: float = 0.0, floor: float = 0.0, size: int = 16) -> dict:
    """Layers of height 1 over a floor, under a sky of 1; cameras look straight down and, from below, straight up."""
    height = len(sigma)
    to_world = ms.translate(-WIDE, -WIDE, 0) @ ms.scale(2 * WIDE, 2 * WIDE, height)

    def grid(values) -> dict:
        return ms.grid(np.array(values, dtype=np.float32).reshape(height, 1, 1, 1), to_world, "nearest")

    medium = {
        "type": "heterogeneous",
        "sigma_t": grid(sigma),
        "albedo": grid(albedo),
        "phase": {"type": "hg", "g": g} if g else {"type": "isotropic"},
    }
    if emission is not None:
        medium["emission"] = grid(emission)
    box = ms.translate(0, 0, height / 2) @ ms.scale(WIDE, WIDE, height / 2)
    return {
        "above": pencil([0, 0, height + 1], [0, 0, 0], size),
        "below": pencil([0, 0, -0.25], [0, 0, 1], size),
        "box": ms.boundary(medium, box),
        "floor": {
            "type": "rectangle",
            "to_world": ms.translate(0, 0, -0.5) @ ms.scale(WIDE),
            "bsdf": {"type": "diffuse", "reflectance": floor},
        },
        "sky": sky(),
    }


STACKS = {
    "thin": ([0.1, 0.0, 0.2], [0.9, 0.5, 0.7], None, 0.0, 0.5),
    "middle": ([0.5, 1.5, 0.0, 0.3], [0.9, 0.6, 1.0, 1.0], [0.1, 0.0, 0.2, 0.05], 0.5, 0.3),
    "dense": ([4.0, 1.0, 3.0], [0.99, 0.9, 0.95], None, 0.0, 0.8),
    "backward": ([1.0, 2.0], [0.8, 0.9], [0.3, 0.0], -0.5, 0.0),
}


@pytest.mark.parametrize("name", STACKS)
def test_plane_layers(name):
    """Any number of scatterings between layers and a floor, against discrete ordinates."""
    from slab_truth import one_thread, vertical_radiance

    sigma, albedo, emission, g, floor = STACKS[name]
    with one_thread():
        values = [None if v is None else torch.tensor(v, dtype=DOUBLE) for v in (sigma, albedo, emission)]
        expected = torch.stack(vertical_radiance(*values, g, floor=floor))
    view = scene(layers(sigma, albedo, emission, g, floor), variant="mono")
    assert_mean(seen(view, spp=64), expected, systematic=1e-3)


def test_diffusion_limit():
    """A thick layer that only scatters: its transmittance is 4 / 3 / (t + 2 q), with Hopf's constant q at infinity, and
    what leaves it follows Chandrasekhar's H, which is 2.90781 for light that leaves vertically."""
    from slab_truth import h_function

    assert abs(h_function(1.0) - 2.90781) < 1e-5  # Chandrasekhar, Radiative Transfer, table XI
    depth = 12.0
    expected = math.sqrt(3) / 4 * 2.90781 * 4 / 3 / (depth + 2 * 0.710446)
    view = scene(layers([depth / 2] * 2, [1.0, 1.0]), rr_depth=10**6, variant="mono")
    found = seen(view, spp=32)
    assert_mean(found[:, 1], torch.tensor([expected]), systematic=1e-3)
    # and where nothing is lost, what does not pass is reflected; from below comes what the floor swallows
    assert 0.8 < float(found[:, 0].mean()) < 1.0


def test_reflection_of_a_semi_infinite_layer():
    """Under a uniform sky 1 - sqrt(1 - a) H(mu) comes back (Chandrasekhar's chapter V); from a distant point light
    a / 4 F / 2 H(1)^2."""
    from slab_truth import h_function

    albedo, distance = 0.9, 400.0
    objects = layers([20.0] * 2, [albedo] * 2)
    view = scene(objects, variant="mono")
    expected = 1 - math.sqrt(1 - albedo) * h_function(albedo)
    assert_mean(seen(view)[:, 0], torch.tensor([expected]), systematic=1e-3)
    objects["sky"] = {"type": "point", "position": [0, 0, distance], "intensity": distance**2 * math.pi}
    expected = albedo / 8 * h_function(albedo) ** 2
    # the light's distance changes by 1 % on the way through the layers
    assert_mean(seen(scene(objects, variant="mono"))[:, 0], torch.tensor([expected]), systematic=0.02)


# ------------------------------------------------------------------------------------------ media, surfaces and cameras
def test_a_medium_inside_a_medium():
    """Along a line through two balls: what lies between, and what has no exterior given."""
    haze, dense = {"type": "ref", "id": "haze"}, {"type": "homogeneous", "sigma_t": 2.0, "albedo": 0.0}
    for exterior in ({"exterior": haze}, {}):
        objects = {
            **cameras(np.array([[0.0, 0.0, 4.0]]), np.zeros((1, 3))),
            "haze": {"type": "homogeneous", "sigma_t": 0.6, "albedo": 0.0},
            "large": {"type": "sphere", "bsdf": {"type": "null"}, "interior": haze},
            "small": {
                "type": "sphere",
                "radius": 0.4,
                "center": [0, 0, 0.2],
                "bsdf": {"type": "null"},
                "interior": dense,
                **exterior,
            },
            "sky": sky(),
        }
        # without an exterior there is nothing behind the small ball: its far side at z = -0.2
        depth = 0.6 * (0.4 + (0.8 if exterior else 0.0)) + 2.0 * 0.8
        assert_mean(seen(scene(objects)), math.exp(-depth) * torch.ones(3), str(exterior))


def test_a_shape_without_media_changes_nothing():
    """Curtains of `null` inside of a medium."""
    objects = {
        **cameras(np.array([[0.1, 0.0, 4.0]]), np.zeros((1, 3))),
        "ball": ball({"sigma_t": 0.8, "albedo": 0.0}),
        "sky": sky(),
    }
    plain = seen(scene(objects)).mean(0)
    for i, z in enumerate((-0.5, 0.2, 0.6)):
        objects[f"curtain{i}"] = {
            "type": "rectangle",
            "to_world": ms.translate(0, 0, z) @ ms.scale(3),
            "bsdf": {"type": "null"},
        }
    found = seen(scene(objects))
    assert_mean(found, plain, systematic=0.03)
    assert_mean(found, math.exp(-0.8 * 2 * math.sqrt(1 - 0.025**2)) * torch.ones(3), systematic=1e-3)


def test_camera_and_surfaces_inside_a_medium():
    """A lamp and a lit wall seen through fog around the camera: exp(-s (r + r')) as often as light passes it."""
    fog = {"type": "ref", "id": "fog"}
    objects = {
        "camera0": pencil([0, 0, 0], [0, 0, -1], medium=fog),
        "camera1": pencil([0, 0, 0], [0, 1, 0], medium=fog),
        "fog": {"type": "homogeneous", "sigma_t": colour([0.1, 0.3, 0.9]), "albedo": 0.0},
        "end": {"type": "sphere", "radius": 30.0, "bsdf": {"type": "null"}, "interior": fog},
        "wall": {
            "type": "rectangle",
            "to_world": ms.translate(0, 0, -2) @ ms.scale(5),
            "bsdf": {"type": "diffuse", "reflectance": 0.5},
            "exterior": fog,
        },
        "lamp": {
            "type": "sphere",
            "center": [0, 3, 0],
            "radius": 0.5,
            "emitter": {"type": "area", "radiance": 4.0},
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "exterior": fog,
        },
        "bulb": {"type": "point", "position": [0, 0, -1], "intensity": 7.0},
    }
    sigma = torch.tensor([0.1, 0.3, 0.9], dtype=DOUBLE)
    view = scene(objects, 2)
    lit = 0.5 / math.pi * 7.0 * torch.exp(-sigma * 3)  # the bulb is 1 before the wall, the camera 2
    found = seen(view, spp=64)
    assert_mean(found[:, 1], 4 * torch.exp(-2.5 * sigma))
    # the lamp lights the wall, too: at (0, 0, -2) it is sqrt(13) away
    distance = math.sqrt(13)
    omega = math.pi * 0.25 / 13  # projected solid angle of a sphere seen from outside, all above the horizon
    lamp_light = 0.5 / math.pi * 4.0 * omega * 2 / distance * torch.exp(-sigma * (distance - 0.5 + 2))
    assert_mean(found[:, 0], lit + lamp_light, systematic=0.01)


def test_occluders_in_a_medium_cast_shadows():
    """Light that an opaque ball holds back does not arrive, that behind glass only by the glass itself."""
    objects = {
        **cameras(np.array([[0.0, 0.0, 4.0]]), np.zeros((1, 3))),
        "ball": ball({"sigma_t": 1.0, "albedo": 0.9}),
        "shell": {"type": "sphere", "radius": 0.2, "center": [0, 1.5, 0], "bsdf": {"type": "diffuse"}},
        "bulb": {"type": "point", "position": [0, 1.5, 0], "intensity": 5.0},
    }
    assert float(seen(scene(objects)).abs().max()) == 0.0
    objects["shell"]["bsdf"] = {"type": "null"}
    assert float(seen(scene(objects)).mean()) > 0.05


# ---------------------------------------------------------------------------------------- equal media, equal renderings
def difference_of_means(a: torch.Tensor, b: torch.Tensor, what: str) -> None:
    """Two renderings with different seeds have the same mean: normal, 1e-4 together."""
    error = (a.var(0) / len(a) + b.var(0) / len(b)).sqrt()
    z = ((a.mean(0) - b.mean(0)) / error).flatten()
    assert float(error.max()) < 0.03 * float(a.mean(0).max())
    level = tr.testing.sidak(truth.SIGNIFICANCE, len(z))
    assert bool((tr.testing.student_p_value(z, len(a) - 1) >= level).all()), f"{what}: {z}"


def cloud(**medium) -> dict:
    origins, targets = lines(3, 17)
    return {
        **cameras(origins, targets, 24),
        "ball": ball({"sigma_t": 2.0, "albedo": colour([0.9, 0.8, 0.5]), **medium}, "heterogeneous"),
        "bulb": {"type": "point", "position": [1.5, 1.0, 1.2], "intensity": 9.0},
        "sky": sky([0.3, 0.5, 0.7]),
    }


def test_homogeneous_and_equal_grid():
    plain = cloud()
    for kind, medium in {
        "homogeneous": {"type": "homogeneous"},
        "grid": {
            "sigma_t": ms.grid(np.full((3, 2, 4, 1), 2.0, np.float32), ms.scale(3) @ ms.translate(-0.5, -0.5, -0.5))
        },
        "albedo": {"albedo": ms.grid(np.tile(np.float32([0.9, 0.8, 0.5]), (2, 3, 2, 1)), np.eye(4))},
        "scale": {"sigma_t": 0.5, "scale": 4.0},
    }.items():
        objects = cloud(**medium)
        objects["ball"]["interior"].update(medium)
        difference_of_means(seen(scene(plain), seed=1), seen(scene(objects), seed=2), kind)


def test_coloured_extinction_and_three_grey_ones():
    values = [0.4, 1.5, 5.0]
    for data in (None, random_grid(18, (3, 3, 3, 3), high=6.0)):
        coloured = seen(scene(cloud(sigma_t=colour(values) if data is None else data)), seed=1)
        for c in range(3):
            grey = values[c] if data is None else {**data, "data": data["data"][..., c : c + 1]}
            difference_of_means(coloured[..., c], seen(scene(cloud(sigma_t=grey)), seed=5 + c)[..., c], f"channel {c}")


def test_mono_and_grey_rgb():
    objects = cloud(albedo=0.8)
    objects["sky"] = sky(0.5)
    difference_of_means(
        seen(scene(objects), seed=1)[..., :1], seen(scene(objects, variant="mono"), seed=2), "mono and rgb"
    )


# ------------------------------------------------------------------------------------------------------------- settings
def test_max_depth():
    """Depth 1 is what comes straight, depth 2 single scattering, and more is added until nothing is."""
    objects = cloud()
    origins, targets = lines(3, 17)
    exact = scene(objects, dtype=DOUBLE)
    straight = truth.transmittance(exact, origins, targets) * torch.tensor([0.3, 0.5, 0.7])
    assert float(tr.render(scene(objects, 0), spp=4, seed=1).abs().max()) == 0.0
    assert_mean(seen(scene(objects, 1)), straight)
    means = [seen(scene(objects, depth, 1000), spp=64).mean(0) for depth in (1, 2, 3, 6, 40, -1)]
    for less, more in itertools.pairwise(means[:-1]):
        assert bool((more > less).all())
    torch.testing.assert_close(means[-1], means[-2], rtol=0.02, atol=0)
    # the series of orders is that of the plain simulation
    world = World(exact)
    _, rays, _, _ = camera_samples(world, 3, 8, 0)
    plain = Tracer(world, 3, 4).trace(*rays[:2], NOTHING)
    difference_of_means(seen(scene(objects, 3), spp=16)[:, 0], plain, "depth 3")


def test_hide_emitters():
    """Emitters are hidden behind media and null boundaries as well; what media scatter remains."""
    objects = cloud()
    objects["lamp"] = lamp((0.0, 0.0, -3.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0), 2.0)
    objects["camera3"] = pencil([0.0, 0.0, 4.0], [0.0, 0.0, 0.0], 24)
    origins, targets = lines(3, 17)
    origins, targets = np.append(origins, [[0, 0, 4.0]], 0), np.append(targets, [[0, 0, 0.0]], 0)
    assert float(seen(scene(objects, 1, hide_emitters=True)).abs().max()) == 0.0
    exact = scene(objects, dtype=DOUBLE)
    light = torch.tensor([[0.3, 0.5, 0.7]] * 3 + [[2.0, 2.0, 2.0]], dtype=DOUBLE)
    through = truth.transmittance(scene(cloud(), dtype=DOUBLE), origins, targets)
    visible, hidden = seen(exact, seed=1), seen(scene(objects, hide_emitters=True), seed=2)
    difference_of_means(visible, hidden + through * light, "hidden")


def test_alpha():
    """Coverage of a medium is what it takes from light behind, that of a surface in it 1."""
    objects = cloud()
    objects["stone"] = {"type": "sphere", "radius": 0.3, "center": [0, 3.0, 0]}
    objects["camera3"] = pencil([0.0, 3.0, 4.0], [0.0, 3.0, 0.0], 24)
    objects["camera4"] = pencil([0.0, 6.0, 4.0], [0.0, 6.0, 0.0], 24)
    origins, targets = lines(3, 17)
    view = scene(objects)
    alpha = tr.render(view, spp=32, seed=1, sensor=[0, 1, 2, 3, 4], outputs=("rgb", "alpha")).alpha.double()
    through = truth.transmittance(scene(objects, dtype=DOUBLE), origins, targets)[:, :1]
    expected = torch.cat([1 - through, torch.tensor([[1.0], [0.0]])])
    assert_mean(alpha.flatten(1).T[..., None], expected)


# ---------------------------------------------------------------------------------------- what must not change a result
def image_and_gradient(name: str, **settings) -> tuple[torch.Tensor, torch.Tensor]:
    view = tr.load_dict(ms.SCENES[name]().scene, **settings)
    words = ("medium.sigma_t", "medium.albedo", "phase_function.g", "reflectance", "radiance", "sky.data")
    names = [n for n, _ in view.named_parameters() if any(w in n for w in words) and not n.endswith("to_world")]
    parameters = view.train_only(*names)
    image = tr.render(view, spp=4, seed=3)
    gradients = torch.autograd.grad(image.square().mean(), parameters)
    return image.detach().double(), torch.cat([g.double().flatten() for g in gradients])


def most_agree(a: torch.Tensor, b: torch.Tensor, share: float, rtol: float = 1e-3) -> bool:
    """Paths are the same up to rounding; a few decide otherwise."""
    scale = b.abs().mean()
    return bool(((a - b).abs() <= rtol * (b.abs() + scale)).double().mean() >= share)


@pytest.mark.parametrize("name", list(ms.SCENES))
def test_precision_packets_and_threads(name, monkeypatch):
    single = image_and_gradient(name)
    double = image_and_gradient(name, dtype=DOUBLE)
    assert most_agree(single[0], double[0], 0.95)
    torch.testing.assert_close(single[1].sum(), double[1].sum(), rtol=0.05, atol=1e-6)
    kept = torch.get_num_threads()
    results = []
    try:
        for threads in (1, 2, 2, 5):
            torch.set_num_threads(threads)
            results.append(image_and_gradient(name))
    finally:
        torch.set_num_threads(kept)
    for image, _ in results:
        assert torch.equal(image, results[0][0])
    assert torch.equal(results[1][1], results[2][1])
    torch.testing.assert_close(results[0][1], results[1][1], rtol=1e-3, atol=1e-3 * float(results[0][1].abs().max()))
    monkeypatch.setattr(sys.modules["torchrender.render"], "PACKETS", False)
    numbers = image_and_gradient(name)
    assert most_agree(single[0], numbers[0], 0.95)
    torch.testing.assert_close(single[1].sum(), numbers[1].sum(), rtol=0.05, atol=1e-6)


PRINT_IMAGES = """
import sys, torch
sys.path.insert(0, sys.argv[1])
import media_scenes, torchrender as tr
for name, make in media_scenes.SCENES.items():
    print(name, *tr.render(tr.load_dict(make().scene), spp=8, seed=3).mean((0, 1)).tolist())
"""


def test_instruction_sets():
    """Each compiled instruction set gives the same images up to rounding, which turns few paths to others."""
    found = {}
    for isa in [i for i, s in tr.backends.status().items() if s.startswith(("used", "available"))]:
        result = subprocess.run(
            [sys.executable, "-c", PRINT_IMAGES, os.path.dirname(__file__)],
            env={**os.environ, "TORCHRENDER_ISA": isa},
            capture_output=True,
            text=True,
            check=True,
            timeout=300,
        )
        found[isa] = {line.split()[0]: list(map(float, line.split()[1:])) for line in result.stdout.splitlines()}
    assert found
    for means in found.values():
        for name, first in next(iter(found.values())).items():
            torch.testing.assert_close(torch.tensor(means[name]), torch.tensor(first), rtol=5e-3, atol=1e-5)


def test_scenes_contain_every_model():
    """What has an entry in the oracle is in a picture: those of surfaces are tested in test_oracle.py."""
    used = set()
    for make in ms.SCENES.values():
        objects = tr.load_dict(make().scene).layout().objects
        used |= {(category, row[0]) for category in ("volume", "phase", "medium") for row in objects[category]}
    models = {("volume", name) for name in VOLUMES} | {("medium", n) for n in ("homogeneous", "heterogeneous")}
    assert used >= models
    assert {kind for category, kind in used if category == "phase"} <= set(PHASES)
