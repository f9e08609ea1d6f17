"""The inverse problems: their scenes, what is unknown in them, and how exactly it is to be found."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

import torchrender as tr
from scenes import make_media

from .inverse_caustic import caustic
from .inverse_shadows import shadows
from .inverse_shapes import monkey, pose
from .inverse_task import Task, Unknown, View, around, camera
from .media import RR_DEPTH, SMOKE, Loaded
from .rows import SCENES

PRB = {"type": "prb", "rr_depth": 100}


@dataclass(frozen=True)
class Problem:
    """A problem: its words, the relative error on held-out pictures to be reached, and what makes it.

    `make` takes whether it is to be small. `setting` is where a search begins, `own` what it has besides for a program,
    and `others` what a search tries for a program, besides what it always does. An `optional` one has to be named.
    """

    name: str
    title: str
    target: float
    make: Callable[[bool], Task]
    setting: dict[str, Any]
    optional: bool = False
    own: dict[str, dict[str, Any]] = field(default_factory=dict)
    others: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    def goal(self, quick: bool) -> float:
        """The error to be reached; small problems have few pixels, and more noise."""
        return self.target * (3 if quick else 1)


def painted(size: int) -> torch.Tensor:
    """A texture (size, size, 3) from 0.1 to 0.9: coloured waves, and the same of a few texels' length."""
    centres = (torch.arange(size) + 0.5) / size
    v, u = torch.meshgrid(centres, centres, indexing="ij")
    turn = 2 * math.pi
    bands = torch.sin(turn * (5 * u + 0.2 * torch.sin(turn * 3 * v)))
    waves = torch.sin(turn * (4 * v + 0.3 * torch.sin(turn * 2 * u)))
    spots = torch.cos(turn * 16 * u) * torch.cos(turn * 16 * v)
    channels = [0.5 + 0.25 * bands + 0.1 * spots, 0.5 + 0.25 * waves - 0.1 * spots, 0.5 + 0.3 * bands * waves]
    return torch.stack(channels, dim=-1).clamp(0.1, 0.9)


def albedos(quick: bool) -> Task:
    """Five colours of the Cornell box from one picture; another camera judges."""
    resolution = 24 if quick else 256
    scene = tr.load_file(SCENES / "cornell_box.xml", resolution=resolution)
    names = [f"{name}.reflectance.value" for name in ("floor", "ceil", "red", "green", "box")]
    return Task(
        scene,
        [Unknown(name, np.full(3, 0.5), linear=True) for name in names],
        [View(0)],
        [View(camera((0.5, 0.5, 2.6), 60, resolution // 2, (-0.1, -0.2, 0.0)))],
        {**PRB, "max_depth": 5},
        judge_spp=4,
    )


def texture(quick: bool, size: int) -> Task:
    """The monkey's texture from ten pictures around it; two others judge."""
    resolution = 24 if quick else 256
    name = "monkey.bsdf.brdf_0.reflectance.data"
    scene = tr.load_file(SCENES / "textured_monkey.xml", resolution=resolution)
    with torch.no_grad():
        scene.get_submodule("monkey.bsdf.brdf_0.reflectance").data = torch.nn.Parameter(
            painted(size), requires_grad=False
        )
    scene["sky"] = {"type": "constant", "radiance": 0.5}
    del scene["camera"]
    count = 10
    for i in range(count):
        scene[f"view{i}"] = camera(around(360 * i / count, (5, 40)[i % 2], 4.3), 36, resolution)
    others = [camera(around(azimuth, 20, 4.3), 36, resolution) for azimuth in (18, -54)]
    return Task(
        scene,
        [Unknown(name, np.full((size, size, 3), 0.5), linear=True)],
        [View(i) for i in range(count)],
        [View(other) for other in others],
        {**PRB, "max_depth": 5},
        judge_spp=4,
    )


def landscape(height: int) -> torch.Tensor:
    """An evening sky with a sun above hills: radiance (height, 2 height, 3). Row 0 looks up."""
    v, u = torch.meshgrid(torch.linspace(0, 1, height), (torch.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    turn, up = 2 * math.pi, 0.5 - v
    horizon = 0.05 + 0.035 * torch.sin(3 * turn * u + 1) + 0.02 * torch.sin(7 * turn * u)
    sky = torch.sigmoid(40 * (up - horizon))[..., None]
    dusk = torch.exp(-6 * (up - horizon).clamp(min=0))[..., None]
    clouds = torch.sin(turn * (3 * u + 2 * up)) + torch.sin(
        turn * (2 * u - 5 * up) + 2 * torch.sin(turn * (2 * u + up))
    )
    above = (dusk * torch.tensor([1.0, 0.55, 0.25]) + (1 - dusk) * torch.tensor([0.12, 0.25, 0.6])) * (
        1 + 0.35 * clouds[..., None]
    )
    fields = torch.sin(turn * 6 * u + 2 * torch.sin(turn * 3 * up)) * torch.cos(turn * 5 * up)
    below = torch.tensor([0.1, 0.28, 0.05]) + torch.tensor([0.26, -0.06, 0.05]) * (0.5 + 0.5 * fields[..., None])
    sun = torch.exp(-(((u - 0.58) * 2) ** 2 + (up - 0.14) ** 2) / 0.003)[..., None]
    return above * sky + below * (1 - sky) + 2.5 * sun * torch.tensor([1.0, 0.8, 0.5])


def environment(quick: bool) -> Task:
    """The sky and the roughness of a ball of silver from twelve pictures of it; two other views of the ball judge.

    The pictures show the sky behind the ball, sharp, and in the ball, blurred.
    """
    resolution, height = (24, 16) if quick else (128, 64)
    ball = {
        "type": "sphere",
        "bsdf": {"type": "roughconductor", "material": "Ag", "distribution": "ggx", "alpha": 0.15},
    }
    count = 12
    scene = tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, "rr_depth": 100},
            **{
                f"view{i}": camera(around(360 * i / count, (5, -20, 30)[i % 3], 3.5), 60, resolution)
                for i in range(count)
            },
            "metal": ball,
            "sky": {"type": "envmap", "data": landscape(height)},
        }
    )
    others = [camera(around(azimuth, 20, 3.0), 25, resolution) for azimuth in (15, 200)]
    return Task(
        scene,
        [
            Unknown("sky.data", np.full((height, 2 * height, 3), 0.4), low=1e-3, high=100.0, linear=True),
            Unknown("metal.bsdf.alpha.value", np.array(0.4), low=0.02, high=1.0),
        ],
        [View(i) for i in range(count)],
        [View(other) for other in others],
        {**PRB, "max_depth": 2},
        dark=0.1,
    )


def tiles(size: int) -> dict[str, torch.Tensor]:
    """Maps of a tiled floor, (size, size, channels): colour, roughness, and normals as a normal map has them."""
    centres = (torch.arange(size) + 0.5) / size
    v, u = torch.meshgrid(centres, centres, indexing="ij")
    turn = 2 * math.pi
    # Tiles of a soft edge: 1 in the middle, 0 in the joints; domed.
    across = [torch.sigmoid(40 * (0.34 - (4 * x % 1 - 0.5).abs())) for x in (u, v)]
    tile = (across[0] * across[1])[..., None]
    dull = ((4 * u).floor() + (4 * v).floor()).remainder(2)[..., None]
    cloud = (torch.sin(turn * (u + 0.3 * torch.sin(turn * v))) * torch.cos(turn * 2 * v + 2 * u))[..., None]
    blue, red = torch.tensor([0.15, 0.3, 0.5]), torch.tensor([0.6, 0.25, 0.1])
    lean = [0.8 * tile[..., 0] * (4 * x % 1 - 0.5) for x in (u, v)]
    normals = torch.nn.functional.normalize(torch.stack([*lean, torch.ones_like(u)], dim=2), dim=2)
    return {
        "colour": tile * (blue + (red - blue) * (0.5 + 0.5 * cloud)) + (1 - tile) * 0.1,
        "roughness": tile * (0.5 + 0.15 * dull + 0.05 * cloud) + (1 - tile) * 0.8,
        "normals": normals * 0.5 + 0.5,
    }


def material(quick: bool) -> Task:
    """Maps of colour, roughness and normals of a flat sample from 32 pictures, each by a lamp elsewhere.

    Pictures by four lamps that were at none of these places judge.
    """
    size = 16 if quick else 128

    def map_of(name: str) -> dict[str, Any]:
        return {"type": "bitmap", "data": tiles(size)[name], "raw": True, "wrap_mode": "clamp"}

    scene = tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, "rr_depth": 100},
            "camera": camera((0.0, 0.0, 4.0), 2 * math.degrees(math.atan(1 / 4)), size),
            "sample": {
                "type": "rectangle",
                "bsdf": {
                    "type": "normalmap",
                    "normalmap": map_of("normals"),
                    "bsdf": {
                        "type": "principled",
                        "specular": 0.5,
                        "base_color": map_of("colour"),
                        "roughness": map_of("roughness"),
                    },
                },
            },
            "lamp": {"type": "point", "position": [0, 0, 2.5], "intensity": 20.0},
        }
    )
    count = 32

    def lamp(number: float) -> View:
        """On a spiral from straight above to 70 degrees aside, which covers the sphere around the sample evenly."""
        z, turn = 1 - 0.65 * number / (count - 1), number * math.pi * (3 - math.sqrt(5))
        r = math.sqrt(1 - z * z)
        return View(0, {"lamp.position": [2.5 * r * math.cos(turn), 2.5 * r * math.sin(turn), 2.5 * z]})

    layers, flat = "sample.bsdf", np.tile(np.float32([0.5, 0.5, 1.0]), (size, size, 1))
    return Task(
        scene,
        [
            Unknown(f"{layers}.nested_bsdf.base_color.data", np.full((size, size, 3), 0.3), linear=True),
            Unknown(f"{layers}.nested_bsdf.roughness.data", np.full((size, size, 1), 0.5), low=0.3),
            # Bounds that keep normals on the viewer's side.
            Unknown(f"{layers}.normalmap.data", flat, low=[0.2, 0.2, 0.75], high=[0.8, 0.8, 1.0], scale=0.5),
        ],
        [lamp(number) for number in range(count)],
        [lamp(number) for number in (2.5, 8.5, 14.5, 20.5)],
        {**PRB, "max_depth": 2},
        dark=0.1,
    )


def smoke(quick: bool, size: int) -> Task:
    """Densities of smoke from nine pictures around it; a tenth camera judges."""
    resolution = 16 if quick else 128
    with Loaded(SMOKE, size) as volume:
        scene = tr.load_file(SCENES / SMOKE.file, resolution=resolution, **volume.arguments())
    return Task(
        scene,
        [Unknown(SMOKE.parameter, np.full((size, size, size, 1), 0.02))],
        [View(i) for i in range(make_media.VIEWS)],
        [View(make_media.VIEWS)],
        {"type": "prbvolpath", "max_depth": SMOKE.max_depth, "rr_depth": RR_DEPTH},
        target_spp=1024,
        judge_spp=64,
    )


def setting(spp: int, spp_grad: int, rate: float, halving: int, block: int | None = None) -> dict[str, Any]:
    """See `inverse_loop`; a block of None is for good."""
    numbers = {"spp": spp, "spp_grad": spp_grad, "rate": rate, "halving": halving, "sampler": "independent"}
    return numbers if block is None else {**numbers, "block": block}


# Samples of outlines. Ours are as many as it finds right, or as a search finds.
OUTLINES = {"mitsuba": {"spp_seen": 4, "spp_shadows": 4, "integrator": {"guiding": "none"}}}
GUIDING = {
    "mitsuba": [{"spp_shadows": 0}]
    + [{"integrator": {"guiding": guiding, "seeds": seeds}} for guiding in ("grid", "octree") for seeds in (16, 128)]
    + [{"integrator": {"type": "prb_projective", "max_depth": 2, "guiding": "none"}}],
    "torchrender": [
        {"renderer": {"spp_visibility": counts}} for counts in ([4, 4], [16, 4], [4, 16], [1, 1], [4, 0], [1, 0])
    ],
}

FROZEN: dict[str, list[dict[str, Any]]] = {"mitsuba": [{"frozen": True}]}  # of parameters that may be recorded

PROBLEMS = (
    Problem("albedos", "15 albedos of the Cornell box", 0.005, albedos, setting(1, 1, 0.05, 32, 1), others=FROZEN),
    Problem(
        "texture512",
        "texture of the monkey, 512²",
        0.07,
        lambda quick: texture(quick, 32 if quick else 512),
        setting(4, 4, 0.05, 10, 1),
        others=FROZEN,
    ),
    Problem(
        "texture2048",
        "texture of the monkey, 2048²",
        0.1,
        lambda quick: texture(quick, 64 if quick else 2048),
        setting(8, 8, 0.05, 20, 1),
        others=FROZEN,
    ),
    Problem("environment", "sky and roughness of a metal ball", 0.12, environment, setting(4, 4, 0.05, 60, 1)),
    Problem(
        "material",
        "colour, roughness and normals of a sample",
        0.15,
        material,
        setting(1, 1, 0.05, 64, 1),
        others=FROZEN,
    ),
    Problem(
        "smoke64",
        "densities of smoke, 64³, 9 views",
        0.1,
        lambda quick: smoke(quick, 12 if quick else 64),
        setting(4, 4, 0.05, 60),
    ),
    Problem(
        "smoke128",
        "densities of smoke, 128³, 9 views",
        0.1,
        lambda quick: smoke(quick, 16 if quick else 128),
        setting(4, 4, 0.05, 60),
        optional=True,
    ),
    Problem(
        "caustic",
        "heights of a plate that throws a picture, 512²",
        0.22,
        caustic,
        {**setting(32, 16, 3e-4, 200), "grown": 120, "smoothness": 1.0},
    ),
    Problem(
        "pose",
        "pose of a body, by it and its shadow",
        0.002,
        pose,
        setting(4, 4, 0.025, 30),
        own=OUTLINES,
        others=GUIDING,
    ),
    Problem(
        "monkey",
        "a sphere becomes a monkey, 16 views",
        0.03,
        monkey,
        {**setting(4, 4, 0.1, 60), "views": 4, "smoothness": 20.0},
        own=OUTLINES,
        others=GUIDING,
    ),
    Problem(
        "shadows",
        "one tube that throws two pictures, 128²",
        0.04,
        shadows,
        {**setting(16, 16, 0.2, 100), "views": 2, "smoothness": 10.0},
        own=OUTLINES,
        others=GUIDING,
    ),
)
