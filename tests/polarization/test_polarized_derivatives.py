"""Derivatives of Stokes images: reverse mode, forward mode and central differences."""

from __future__ import annotations

import math

import pytest
import torch
from polarized_derivatives import along, check, modes, room, turning, two_means

import torchrender as tr

pytestmark = [pytest.mark.core, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]
T = tr.Transform
GOLD = {"type": "conductor", "eta": 0.5, "k": 3.43}
ALUMINIUM = {"type": "conductor", "eta": 1.37, "k": 7.62}
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}


def plate(distance: float, bsdf: dict) -> dict:
    origin = [3 - 0.6 * distance, -3.5 + 0.7 * distance, 2 - 0.5 * distance]
    pose = T.look_at(origin, [0.2, 0.1, -0.3], [0.3, 0.1, 1]) @ T.rotate([0, 1, 0], 25) @ T.scale(3)
    return {"type": "rectangle", "to_world": pose, "bsdf": bsdf}


MIRRORS = ["ball.bsdf.eta.value", "ball.bsdf.k.value", "floor.bsdf.k.value", "sky.data", "ball.center", "ball.radius"]


@pytest.mark.parametrize("name", MIRRORS)
def test_chains_of_mirrors(name):
    """Nothing that is sampled depends on these: differences of the same samples are exact."""
    scene = room(GOLD, ALUMINIUM)
    check(scene, name, along(scene, name))


def test_layers():
    """In `twosided`, `blendbsdf` and `normalmap` metals polarise as they do alone."""
    scene = room({"type": "twosided", "bsdf": GOLD}, {"type": "twosided", "bsdf": ALUMINIUM})
    alone = room(GOLD, ALUMINIUM)
    with torch.no_grad():
        images = [tr.render(s, spp=4, seed=1, outputs=("stokes",)).stokes for s in (scene, alone)]
    assert torch.equal(*images)
    name = "ball.bsdf.brdf_0.k.value"
    check(scene, name, along(scene, name))

    blend = room({"type": "blendbsdf", "weight": 0.4, "a": GOLD, "b": ALUMINIUM}, ALUMINIUM)
    modes(blend, "ball.bsdf.weight.value", torch.tensor(1.0, dtype=torch.float64))
    for name in ("ball.bsdf.bsdf_0.k.value", "ball.bsdf.bsdf_1.k.value"):
        check(blend, name, along(blend, name))

    generator = torch.Generator().manual_seed(1)
    normals = torch.rand(8, 8, 3, dtype=torch.float64, generator=generator) * 0.2 + torch.tensor([0.4, 0.4, 0.8])
    bitmap = {"type": "bitmap", "data": normals, "raw": True}
    bumpy = room({"type": "normalmap", "normalmap": bitmap, "bsdf": GOLD}, ALUMINIUM)
    for name in ("ball.bsdf.normalmap.data", "ball.bsdf.nested_bsdf.k.value"):
        check(bumpy, name, along(bumpy, name), tolerance=1e-3)  # texels are linear in pieces


def test_plates():
    scene = room(
        GOLD,
        ALUMINIUM,
        wave=plate(1.0, {"type": "retarder", "theta": 30.0, "delta": 70.0, "transmittance": 0.9}),
        filter=plate(1.6, {"type": "polarizer", "theta": 20.0}),
        second=plate(2.2, {"type": "retarder", "theta": 10.0, "delta": 120.0}),
        circle=plate(2.5, {"type": "circular"}),
    )
    one = torch.tensor(1.0, dtype=torch.float64)
    for name in ("wave.bsdf.theta.value", "wave.bsdf.delta.value", "wave.bsdf.transmittance.value"):
        check(scene, name, one)
    for name in ("wave", "filter"):
        matrix = getattr(scene, name).to_world.detach()
        check(scene, f"{name}.to_world", turning(matrix, matrix[:3, 2]))
    check(scene, "ball.bsdf.k.value", one)


def test_plates_whose_angles_are_textures():
    generator = torch.Generator().manual_seed(4)
    angles = torch.rand(16, 16, 1, generator=generator, dtype=torch.float64) * 90
    bitmap = {"type": "bitmap", "data": angles, "raw": True}
    scene = room(
        GOLD,
        ALUMINIUM,
        wave=plate(1.0, {"type": "retarder", "theta": bitmap, "delta": bitmap}),
        filter=plate(1.6, {"type": "polarizer", "theta": bitmap}),
    )
    for name in ("wave.bsdf.theta.data", "wave.bsdf.delta.data", "filter.bsdf.theta.data"):
        check(scene, name, along(scene, name))


def test_the_camera_is_rolled():
    """Q and U turn by twice the angle, and back: the image of intensity is the same, up to what is seen where."""
    scene = room(GOLD, ALUMINIUM)
    scene.sensors[0].film = tr.Film(1, 1, filter=tr.ReconstructionFilter("box"))
    scene.sensors[0].x_fov = 1e-4
    matrix = scene.sensors[0].to_world.detach()
    roll = turning(matrix, matrix[:3, 2])
    check(scene, "sensor.to_world", roll, tolerance=1e-5)
    with torch.no_grad():
        before = tr.render(scene, spp=4, seed=0, outputs=("stokes",)).stokes[0, 0, 0]
        scene.sensors[0].to_world = rolled(matrix, 20)
        after = tr.render(scene, spp=4, seed=0, outputs=("stokes",)).stokes[0, 0, 0]
    angle = math.radians(2 * 20)
    turned = complex(*before[1:3].tolist()) * complex(math.cos(angle), math.sin(angle))
    assert abs(complex(*after[1:3].tolist()) - turned) < 1e-5
    assert torch.allclose(after[[0, 3]], before[[0, 3]], atol=1e-5)


def rolled(matrix: torch.Tensor, degrees: float) -> torch.Tensor:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    roll = torch.eye(4, dtype=torch.float64)
    roll[0, 0], roll[0, 1], roll[1, 0], roll[1, 1] = c, -s, s, c
    return matrix @ roll


ROUGH = {**GOLD, "type": "roughconductor", "alpha": 0.3}
MATERIALS = {
    "rough metals": (ROUGH, {**ALUMINIUM, "type": "roughconductor", "alpha": 0.25}, "ball.bsdf.eta.value"),
    "rough metal on grey": (ROUGH, {"type": "diffuse"}, "ball.center"),
    "glass": (GLASS, ALUMINIUM, "ball.bsdf.eta"),
    "pane": ({**GLASS, "type": "thindielectric"}, ALUMINIUM, "ball.bsdf.eta"),
    "rough glass": ({**GLASS, "type": "roughdielectric", "alpha": 0.3}, ALUMINIUM, "ball.bsdf.alpha.value"),
}


def test_rough_metals():
    """Directions do not depend on the index."""
    ball, floor, name = MATERIALS["rough metals"]
    scene = room(ball, floor)
    check(scene, name, along(scene, name))


@pytest.mark.parametrize("case", MATERIALS)
def test_reverse_is_forward(case):
    ball, floor, name = MATERIALS[case]
    scene = room(ball, floor)
    modes(scene, name, along(scene, name))
    modes(scene, "ball.center", along(scene, "ball.center"))


@pytest.mark.parametrize("case", ["rough metal on grey", "pane"])
def test_means_of_derivatives(case):
    """Of what is sampled by parameters, means over 24 seeds against those of differences.

    z of I, Q and U, with 23 degrees of freedom: 4.5 by chance in less than 2e-4 of the cases; seeds are fixed.
    """
    ball, floor, name = MATERIALS[case]
    z, _ = two_means(room(ball, floor), name)
    assert float(z.abs().max()) < 4.5, z
