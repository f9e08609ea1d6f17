"""Images of participating media: closed forms, quadratures, plane layers, and what must not change a result.

Images of single lines are compared with deterministic results by Student's test, a right renderer failing each with
probability `media_truth.SIGNIFICANCE`; seeds are fixed.
"""

from __future__ import annotations

import copy
import math

import media_scenes as ms
import media_truth as truth
import numpy as np
import pytest
import torch
from media_objects import DOUBLE, LAMP, LIGHTS, STACKS, ball, colour, lamp, layers, random_grid, sky
from media_truth import assert_mean, cameras, lines, pencil, scene, seen
from oracle.film import camera_samples
from oracle.media import NOTHING, Media, Tracer
from oracle.world import World
from slab_truth import h_function, one_thread, vertical_radiance

import torchrender as tr

pytestmark = pytest.mark.once  # takes long; images of media at every instruction set: test_media_invariants

COLOURS = {"rgb": [0.2, 0.6, 1.2], "mono": 0.9}


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
        assert view.statistics["render"]["collisions"] > 0
        assert view.statistics["render"]["majorants_exceeded"] == 0


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
        assert view.statistics["render"]["majorants_exceeded"] == 0
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
        image = tr.render(view, spp=16, seed=2, sampler="independent").double()
        # blocks of 3 x 3 pixels are independent runs: all have the same mean
        runs = image.reshape(8, 3, 8, 3, 3).mean((1, 3)).reshape(64, 3)
        assert_mean(runs, torch.ones(3), f"{name}, roulette from {rr_depth}")


# ---------------------------------------------------------------------------------------------------- single scattering
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
@pytest.mark.parametrize("name", STACKS)
def test_plane_layers(name):
    """Any number of scatterings between layers and a floor, against discrete ordinates."""
    sigma, albedo, emission, g, floor = STACKS[name]
    with one_thread():
        values = [None if v is None else torch.tensor(v, dtype=DOUBLE) for v in (sigma, albedo, emission)]
        expected = torch.stack(vertical_radiance(*values, g, floor=floor))
    view = scene(layers(sigma, albedo, emission, g, floor), variant="mono")
    assert_mean(seen(view, spp=64), expected, systematic=1e-3)


def test_diffusion_limit():
    """A thick layer that only scatters: its transmittance is 4 / 3 / (t + 2 q), with Hopf's constant q at infinity, and
    what leaves it follows Chandrasekhar's H, which is 2.90781 for light that leaves vertically."""
    assert abs(h_function(1.0) - 2.90781) < 1e-5  # Chandrasekhar, Radiative Transfer, table XI
    depth = 12.0
    expected = math.sqrt(3) / 4 * 2.90781 * 4 / 3 / (depth + 2 * 0.710446)
    view = scene(layers([depth / 2] * 2, [1.0, 1.0]), rr_depth=10**6, variant="mono")
    found = seen(view, spp=128)
    assert_mean(found[:, 1], torch.tensor([expected]), systematic=1e-3)
    # and where nothing is lost, what does not pass is reflected; from below comes what the floor swallows
    assert 0.8 < float(found[:, 0].mean()) < 1.0


def test_reflection_of_a_semi_infinite_layer():
    """Under a uniform sky 1 - sqrt(1 - a) H(mu) comes back (Chandrasekhar's chapter V); from a distant point light
    a / 4 F / 2 H(1)^2."""
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
