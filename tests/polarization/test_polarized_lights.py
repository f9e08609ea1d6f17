"""Lights whose own light is polarised: seen directly, by what they light, and with derivatives."""

from __future__ import annotations

import cmath
import math

import pytest
import torch
from polarized_derivatives import along, check, room

import torchrender as tr

pytestmark = [pytest.mark.core, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]
T = tr.Transform
STOKES = [0.5, 0.3, -0.4]
ROUGH = {"type": "roughconductor", "eta": 0.5, "k": 3.43, "alpha": 0.4}


def lamp_view(roll: float, **emitter) -> tr.Scene:
    """A square lamp seen straight on, turned counter-clockwise by `roll` degrees as the camera sees it."""
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    camera = {"type": "perspective", "fov": 1e-3, "to_world": T.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]), "film": film}
    lamp = {"type": "area", "radiance": 2.0, **emitter}
    return tr.load_dict(
        {
            "type": "scene",
            "sensor": camera,
            "lamp": {"type": "rectangle", "to_world": T.rotate([0, 0, 1], roll), "emitter": lamp},
        },
        dtype=torch.float64,
    )


@pytest.mark.parametrize("depth", [1, 4])
@pytest.mark.parametrize("roll", [0, 25, 90])
def test_a_lamp_is_seen(roll, depth):
    scene = lamp_view(roll, stokes=STOKES)
    scene.integrator = tr.PathTracer(max_depth=depth)
    found = tr.render(scene, spp=4, seed=0, outputs=("stokes",)).stokes[0, 0, 0]
    turned = complex(*STOKES[:2]) * cmath.exp(2j * math.radians(roll))
    expected = 2 * torch.tensor([1, turned.real, turned.imag, STOKES[2]], dtype=torch.float64)
    assert torch.allclose(found, expected, atol=1e-6), (found, expected)
    assert float(tr.render(scene, spp=4, seed=0).mean()) == pytest.approx(2.0)  # intensities alone


@pytest.mark.parametrize("name", ["lamp.emitter.stokes", "lamp.emitter.radiance.value", "lamp.to_world"])
def test_derivatives_of_a_lamp_that_is_seen(name):
    scene = lamp_view(25, stokes=STOKES)
    direction = along(scene, name)
    if name == "lamp.to_world":  # turned about its normal, so that nothing else moves
        matrix = scene.lamp.to_world.detach()
        direction = torch.zeros_like(matrix)
        direction[:3, :3] = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]], dtype=torch.float64) @ matrix[:3, :3]
    check(scene, name, direction)


def lit_room(lamp: dict, plate: bool) -> tr.Scene:
    """A rough metal ball over grey under a small lamp far away alone: polarised by itself, or by a plate before it."""
    frame = T.look_at([-8, -12, 10], [0, 0, 0], [0.2, 0, 1])
    more = {"lamp": {"type": "rectangle", "to_world": frame, "emitter": lamp}}
    if plate:
        before = frame @ T.translate([0, 0, 0.5]) @ T.scale(1.5)
        more["plate"] = {"type": "rectangle", "to_world": before, "bsdf": {"type": "polarizer", "theta": 0.0}}
    scene = room(ROUGH, {"type": "diffuse", "reflectance": 0.3}, **more)
    scene.integrator = tr.PathTracer(max_depth=4 if plate else 3, rr_depth=100)
    scene.sky.scale = 0.0
    return scene


def test_a_polarised_lamp_is_one_behind_a_polariser():
    """An independent way to the same light: what passes a polariser before an unpolarised lamp.

    Emitter sampling does not pass plates, so that the second way is noisy; the lamp is far away, where its rays are
    straight on. z of I, Q, U and V over 16 seeds: 6 by chance in less than 2e-4 of the cases (15 degrees of freedom at
    least); the other polarisation is told apart.
    """
    means, variances = [], []
    for plate, lamp in ((True, {}), (False, {"stokes": [1, 0, 0]}), (False, {"stokes": [-1, 0, 0]})):
        scene = lit_room({"type": "area", "radiance": 4000.0 if plate else 2000.0, **lamp}, plate)
        spp = 4096 if plate else 256
        runs = [tr.render(scene, spp=spp, seed=s, outputs=("stokes",)).stokes.mean((0, 1, 2)) for s in range(16)]
        means.append(torch.stack(runs).mean(0))
        variances.append(torch.stack(runs).var(0) / 16)
    z = [float(((means[k] - means[0]) / (variances[k] + variances[0] + 1e-12).sqrt()).abs().max()) for k in (1, 2)]
    assert z[0] < 6 < z[1], (z, means)


POSE = T.look_at([-2, -3, 2.5], [0, 0, 0], [0.2, 0, 1])
LIGHTS = {
    "area": {"type": "rectangle", "to_world": POSE, "emitter": {"type": "area", "radiance": 8.0, "stokes": STOKES}},
    "point": {"type": "point", "position": [-2, -3, 2.5], "intensity": 20.0, "stokes": STOKES},
    "spot": {"type": "spot", "to_world": POSE, "intensity": 20.0, "cutoff_angle": 40.0, "stokes": STOKES},
    "directional": {"type": "directional", "to_world": POSE, "irradiance": 3.0, "stokes": STOKES},
    "projector": {
        "type": "projector",
        "to_world": POSE,
        "fov": 50.0,
        "irradiance": {"type": "bitmap", "data": torch.ones(4, 4, 1).double(), "raw": True},
        "scale": 20.0,
        "stokes": STOKES,
    },
}


def lit(kind: str) -> tr.Scene:
    scene = room(ROUGH, {"type": "conductor", "eta": 1.37, "k": 7.62}, light=LIGHTS[kind])
    scene.integrator = tr.PathTracer(max_depth=3, rr_depth=100)
    return scene


@pytest.mark.parametrize("kind", LIGHTS)
def test_intensities_do_not_know_of_it(kind):
    light = dict(LIGHTS[kind])
    if kind == "area":
        light["emitter"] = {k: v for k, v in light["emitter"].items() if k != "stokes"}
    light.pop("stokes", None)
    plain = room(ROUGH, {"type": "conductor", "eta": 1.37, "k": 7.62}, light=light)
    plain.integrator = tr.PathTracer(max_depth=3, rr_depth=100)
    scene = lit(kind)
    assert torch.equal(tr.render(scene, spp=4, seed=1), tr.render(plain, spp=4, seed=1))
    name = "light.emitter.stokes" if kind == "area" else "light.stokes"
    with torch.no_grad():
        images = [
            tr.render(scene, spp=4, seed=1, outputs=("stokes",), params={name: torch.tensor(s).double()}).stokes
            for s in ([0.0, 0, 0], STOKES, [-x for x in STOKES])
        ]
        without = tr.render(plain, spp=4, seed=1, outputs=("stokes",)).stokes
    # linear in the light
    torch.testing.assert_close(images[0], without, rtol=1e-12, atol=1e-14)
    torch.testing.assert_close((images[1] + images[2]) / 2, without, rtol=1e-10, atol=1e-12)
    assert float((images[1] - without).abs().max()) > 1e-3


@pytest.mark.parametrize("kind", LIGHTS)
def test_derivatives(kind):
    """Rough metals are sampled by roughness alone: differences of the same samples are exact."""
    scene = lit(kind)
    name = "light.emitter.stokes" if kind == "area" else "light.stokes"
    check(scene, name, along(scene, name))
    check(scene, "ball.bsdf.k.value", along(scene, "ball.bsdf.k.value"))
    if kind in ("spot", "directional"):  # turned about its axis: the light is the same but for its axis
        matrix = scene.light.to_world.detach()
        z = matrix[:3, 2].tolist()
        direction = torch.zeros_like(matrix)
        cross = torch.tensor([[0, -z[2], z[1]], [z[2], 0, -z[0]], [-z[1], z[0], 0]], dtype=torch.float64)
        direction[:3, :3] = cross @ matrix[:3, :3]
        check(scene, "light.to_world", direction)


@pytest.mark.parametrize("stokes", [[0.5, 0.5], [2.0, 0, 0], [0.9, 0.9, 0]])
def test_what_is_no_polarisation_is_refused(stokes):
    with pytest.raises(ValueError, match="stokes"):
        lamp_view(0, stokes=stokes)
