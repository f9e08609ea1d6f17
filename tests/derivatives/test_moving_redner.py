"""Shadows, triangles and cameras that are found again from an image, as in Redner's tests of its edge sampling.

Statistical tests are at 1 % for all of this file together, by Sidak's correction over its cases. First the derivative
at the start, against differences; then the loop: Adam with Redner's step sizes, 200 steps, and 4 samples a pixel of
32 x 32, where it has 256 x 256. Over the last half the step size falls to a fiftieth, since with so few pixels noise
keeps the constant one away from where it leads to. Losses of the start and the end are of 1024 samples a pixel, the
same as of the target, so that noise has no part in them.

The loss hardly changes where a camera moves and turns at once. It is therefore given by its place and the point that it
looks at, takes 500 steps of .1 with 8 samples, and forgets squares of the gradient sooner; above the shadow it has to
come within .1 of the truth, from 9 away, which is what Redner's 64 times as many pixels make .02.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
import torch
from moving_suites import DOUBLE, by_theta, check, diffuse, glowing, rendered, sheet

import torchrender as tr

# Renders only; how the native code is compiled does not matter to motions.
pytestmark = [pytest.mark.once, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]

SIZE = 32
Values = dict[str, torch.Tensor]


def look(position: torch.Tensor, direction: torch.Tensor, up: tuple[float, float, float]) -> torch.Tensor:
    """A camera's matrix, differentiable: +x left, +y up, +z where it looks."""
    z = direction / direction.norm()
    x = torch.linalg.cross(torch.tensor(up).to(z), z)
    x = x / x.norm()
    matrix = torch.stack([x, torch.linalg.cross(z, x), z, position], 1)
    return torch.cat([matrix, torch.tensor([[0.0, 0, 0, 1]]).to(z)])


@dataclass
class Case:
    objects: Callable[[], dict]
    start: dict[str, list]  # by parameter, or name of what `params` takes
    truth: dict[str, list]
    lr: float
    params: Callable[[Values], Values] = dict
    camera: dict = field(default_factory=dict)
    image: Callable[..., torch.Tensor] = rendered
    steps: int = 200
    loop: dict = field(default_factory=lambda: {"spp": 4})
    beta: float = 0.999  # of Adam's mean of squares
    limit: float = 0.01
    near: dict[str, float] = field(default_factory=dict)  # how near the truth the end has to be
    step: float = 0.05  # of the differences, a part of the way to the truth
    spp: int = 64
    spp_visibility: int | tuple[int, int] | None = None
    differences_spp: int = 128

    def scene(self, rfilter: str = "box") -> tr.Scene:
        film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": rfilter}, "sample_border": True}
        return tr.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": 2},
                "camera": {"type": "perspective", "fov": 45, **self.camera, "film": film},
                **self.objects(),
            },
        )

    def render(self, scene: tr.Scene, values: Values, **settings) -> torch.Tensor:
        return self.image(scene, self.params(values), **settings)


# Of a camera's place and of where it looks: quiet samples, and steps that follow the gradient's size.
POSE_LOOP: dict = {"steps": 500, "loop": {"spp": 8, "sampler": "sobol"}, "beta": 0.95}


def tensors(values: dict[str, list]) -> Values:
    return {name: torch.tensor(value, dtype=DOUBLE) for name, value in values.items()}


def level(half: float, y: float) -> list:
    """The corners of a square that faces down."""
    return [[-half, y, -half], [half, y, -half], [-half, y, half], [half, y, half]]


def upright(half: float, z: float) -> list:
    """The corners of a square that faces +z."""
    return [[-half, -half, z], [half, -half, z], [-half, half, z], [half, half, z]]


def at(position: list, target: list, up: tuple[float, float, float] = (0, 1, 0)) -> dict:
    return {"to_world": tr.Transform.look_at(position, target, up)}


def shadow(half: float = 2, blocker: float = 3, lamp: float = 5, radiance: float = 1000) -> dict:
    grey = diffuse(0.5)
    return {
        "floor": sheet(level(half, 0), bsdf=grey),
        "blocker": sheet(level(0.5, blocker), bsdf=grey),
        "lamp": sheet(level(0.1, lamp), emitter=glowing(radiance)),
    }


def glossy() -> dict:
    """A blocker between an almost smooth mirror, of roughness 5e-4 = alpha^2, and a large lamp."""
    mirror = {"type": "roughconductor", "distribution": "ggx", "alpha": 5e-4**0.5, "material": "none"}
    lamp = [[-2, 0, 4], [-2, 12, 4], [2, 0, 4], [2, 12, 4]]
    return {
        "floor": sheet(level(4, 0), bsdf={"type": "twosided", "bsdf": mirror}),
        "blocker": sheet([[0, 1, 0.5], [0, 3, 0.5], [0.8, 1, 0.5], [0.8, 3, 0.5]], bsdf=diffuse(0.5)),
        "lamp": sheet(lamp, emitter=glowing(0.5)),
    }


def triangles(*corners: list, z: float = -7, radiance: float = 20, colours: tuple = (0.5,)) -> dict:
    """One or two, and a lamp behind the camera."""
    found: dict = {"lamp": sheet(upright(1, z), emitter=glowing(radiance))}
    for name, where, colour in zip(("first", "second"), corners, colours):
        found[name] = sheet(
            where, bsdf=diffuse({"type": "rgb", "value": colour} if isinstance(colour, list) else colour)
        )
    return found


def before_a_pattern(scene: tr.Scene, params: Values, **settings) -> torch.Tensor:
    """The image over a background, by its coverage."""
    found = tr.render(scene, params=params, outputs=("rgb", "alpha"), **settings)
    y, x = torch.meshgrid(*[torch.linspace(0, 6, SIZE, dtype=DOUBLE)] * 2, indexing="ij")
    pattern = torch.stack([0.5 + 0.3 * torch.sin(x + c) * torch.cos(y - c) for c in range(3)], -1)
    return found.rgb + (1 - found.alpha[..., None]) * pattern


def by_pose(up: tuple[float, float, float]) -> Callable[[Values], Values]:
    return lambda values: {"camera.to_world": look(values["position"], values["target"] - values["position"], up)}


def by_shift(values: Values) -> Values:
    return {"lamp.vertex_positions": torch.tensor(level(0.1, 5), dtype=DOUBLE) + values["shift"]}


FLOOR, BLOCKER, FIRST, SECOND = (f"{n}.vertex_positions" for n in ("floor", "blocker", "first", "second"))
FROM_ABOVE, FROM_BEHIND = at([0, 2, -5], [0, 0, 0]), at([0, 0, -5], [0, 0, 0])
TRIANGLE = [[-1.7, 1, 0], [1, 1, 0], [-0.5, -1, 0]]
OTHER = [[-1, 1.5, 1], [0.2, 1.5, 1], [0.2, -1.5, 1]]
CLIPPED = [[-1.3, 1, 0], [1, 1, 0], [-0.5, -2, -7]]
MOVED = [[-2, 1.5, 0.3], [0.9, 1.2, -0.3], [-0.4, -1.4, 0.2]]
GREEN, RED = [0.35, 0.75, 0.35], [0.75, 0.35, 0.35]
CASES = {
    "shadow_blocker": Case(
        shadow,
        {BLOCKER: [[-0.2, 3.5, -0.8], [0.4, 2.8, -0.8], [-0.8, 3, 0.3], [0.3, 3.2, 1]]},
        {BLOCKER: level(0.5, 3)},
        1e-2,
        camera=FROM_ABOVE,
        step=0.1,
    ),
    "shadow_receiver": Case(shadow, {FLOOR: level(2, -0.2)}, {FLOOR: level(2, 0)}, 1e-2, camera=FROM_ABOVE, step=0.1),
    "shadow_light": Case(
        shadow,
        {"shift": [-0.4, -0.4, -0.4]},
        {"shift": [0.0, 0, 0]},
        1e-2,
        by_shift,
        camera=FROM_ABOVE,
        near={"shift": 0.02},
        differences_spp=256,
    ),
    "shadow_camera": Case(
        lambda: shadow(20, 10, 15, 5000),
        {"position": [-2.0, 7, 2], "target": [0.0, 0, 0]},
        {"position": [0.0, 9, 0], "target": [0.0, 0, 0]},
        0.1,
        by_pose((0, 0, 1)),
        near={"position": 0.1},
        **POSE_LOOP,
        spp_visibility=(16, 24),
        differences_spp=256,
    ),
    "shadow_glossy": Case(
        glossy,
        {BLOCKER: [[-0.6, 0.9, 0.4], [-0.8, 3.3, 0.7], [0.2, 1.1, 0.6], [0.3, 3.2, 0.4]]},
        {BLOCKER: [[0, 1, 0.5], [0, 3, 0.5], [0.8, 1, 0.5], [0.8, 3, 0.5]]},
        2e-2,
        camera=at([0, 2, -4], [0, -2, 0]),
        limit=0.05,
        step=0.1,
        spp=16,
        spp_visibility=(4, 96),
        differences_spp=64,
    ),
    "two_triangles": Case(
        lambda: triangles(TRIANGLE, OTHER, colours=(GREEN, RED)),
        {
            FIRST: [[-1.3, 1.5, 0.1], [1.5, 0.7, -0.2], [-0.8, -1.1, 0.2]],
            SECOND: [[-0.5, 1.2, 1.2], [0.3, 1.7, 1], [0.5, -1.8, 1.3]],
        },
        {FIRST: TRIANGLE, SECOND: OTHER},
        5e-2,
        camera=FROM_BEHIND,
    ),
    "single_triangle": Case(lambda: triangles(TRIANGLE), {FIRST: MOVED}, {FIRST: TRIANGLE}, 5e-2, camera=FROM_BEHIND),
    "single_triangle_camera": Case(
        lambda: triangles(TRIANGLE, z=-9, radiance=30),
        {"position": [0.0, 0, -3], "target": [-0.5, -0.5, 0]},
        {"position": [0.0, 0, -5], "target": [0.0, 0, 0]},
        0.1,
        by_pose((0, 1, 0)),
        near={"position": 0.02},
        **POSE_LOOP,
        step=0.025,
    ),
    "single_triangle_camera_fisheye": Case(
        lambda: triangles(TRIANGLE, z=-9, radiance=30),
        {"position": [0.5, -0.5, -3]},
        {"position": [0.0, 0, -1]},
        5e-2,
        lambda v: {"camera.to_world": look(v["position"], torch.tensor([0.0, 0, 1], dtype=DOUBLE), (0, 1, 0))},
        camera={"type": "fisheye", "fov": 180},
        near={"position": 0.02},
    ),
    "single_triangle_clipped": Case(
        lambda: triangles(CLIPPED),
        {FIRST: [[-1, 1.5, 0.3], [0.9, 1.2, -0.3], [0, -3, -6.5]]},
        {FIRST: CLIPPED},
        2e-2,
        camera=FROM_BEHIND,
    ),
    "single_triangle_background": Case(
        lambda: triangles(TRIANGLE),
        {FIRST: MOVED},
        {FIRST: TRIANGLE},
        5e-2,
        camera=FROM_BEHIND,
        image=before_a_pattern,
    ),
}


def exactly(case: Case, scene: tr.Scene, values: Values) -> torch.Tensor:
    """The same samples in every call."""
    with torch.no_grad():
        return case.render(scene, values, spp=1024, seed=10**6, sampler="sobol")


@pytest.mark.parametrize("name", CASES)
def test_derivatives_at_the_start(name):
    """Of the loss, whose slope by the image is the weight, on the straight way to the truth.

    Weights are steps, and differences across one, where edges lie along rows of pixels, are no derivatives: the filter
    is smooth.
    """
    case = CASES[name]
    scene, start, truth = case.scene("gaussian"), tensors(case.start), tensors(case.truth)
    weight = 1000 * (exactly(case, scene, start) - exactly(case, scene, truth))

    def image(scene, theta, **settings):
        values = {n: v + theta["theta"] * (truth[n] - v) for n, v in start.items()}
        return case.render(scene, values, **settings)

    settings = {"spp": case.spp, "spp_visibility": case.spp_visibility, "differences_spp": case.differences_spp}
    found = by_theta(scene, None, image=image, weight=weight, step=case.step, seeds=8, **settings)
    check(*found, 0.02, len(CASES))


@pytest.mark.parametrize("name", CASES)
def test_loops(name):
    case = CASES[name]
    scene = case.scene().to(torch.float32)
    truth = tensors(case.truth)

    target = exactly(case, scene, truth)
    values = {n: v.clone().requires_grad_() for n, v in tensors(case.start).items()}
    first = float((exactly(case, scene, values) - target).square().sum())
    optimizer = torch.optim.Adam(values.values(), lr=case.lr, betas=(0.9, case.beta))
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda t: min(1.0, 0.02 + 1.9 * (1 - t / case.steps)))
    for t in range(case.steps):
        optimizer.zero_grad()
        (case.render(scene, values, seed=t, **case.loop) - target).square().sum().backward()
        optimizer.step()
        schedule.step()
    last = float((exactly(case, scene, values) - target).square().sum())
    off = {n: float((values[n].detach() - truth[n]).abs().max()) for n in values}
    print(f"{name}: {first:.4g} -> {last:.3g}, {last / first:.2%}, off by {off}")
    assert last <= case.limit * first
    for n, limit in case.near.items():
        assert off[n] <= limit
