"""Moving outlines in the derivatives of outputs besides radiance: closed forms, and differences of many samples."""

from __future__ import annotations

import math

import pytest
import reference_scenes
import torch
import trimesh
from moving_differences import agrees, direction_of
from output_scenes import REAL

import torchrender as tr

DOUBLE = torch.float64
FOCAL = 8 / math.tan(math.radians(20))  # pixels, of 16
FILTERS = ({"type": "box"}, {"type": "tent"}, {"type": "lanczos"})
TESTS = 40  # of this file, among which SIGNIFICANCE of moving_differences is divided


def things(rfilter: dict, behind: bool = True, lens: bool = False) -> tr.Scene:
    """Shapes of each kind before each other, a plane behind them all or nothing."""
    to_world = tr.Transform.look_at([0.2, 0.1, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": rfilter}
    tilted = tr.Transform.translate([0.4, -0.6, 0]) @ tr.Transform.rotate([1, 1, 0], 30) @ tr.Transform.scale(0.4)
    corners = torch.tensor([[-0.9, -0.2, 0.6], [-0.1, -0.8, 0.4], [-0.2, 0.3, 0.9]])
    cube = trimesh.creation.box((2, 2, 2))
    turned = tr.Transform.rotate([1, 2, 0], 40).matrix[:3, :3].double()
    tint = torch.rand(3, 3, generator=torch.Generator().manual_seed(2))
    kind = {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3.5} if lens else {"type": "perspective"}
    scene: dict = {
        "type": "scene",
        "camera": {**kind, "fov": 40, "to_world": to_world, "film": film},
        "leaf": tr.Mesh(corners, torch.tensor([[0, 1, 2]]), attributes={"vertex_tint": tint}),
        "ball": {"type": "sphere", "center": [-0.5, 0.3, -0.4], "radius": 0.5, "bsdf": {"type": "diffuse"}},
        "plate": {"type": "disk", "to_world": tilted, "bsdf": {"type": "roughplastic", "alpha": 0.3}},
        "pipe": {"type": "cylinder", "p0": [-0.9, -0.9, -0.6], "p1": [0.9, -0.3, -0.9], "radius": 0.2},
        "cube": tr.Mesh(
            0.25 * torch.from_numpy(cube.vertices.copy()) @ turned + 0.5, torch.from_numpy(cube.faces.copy())
        ),
    }
    if behind:
        place = tr.Transform.translate([0, 0, -1.5]) @ tr.Transform.scale(5)
        scene["wall"] = {"type": "rectangle", "to_world": place, "bsdf": {"type": "diffuse", "reflectance": 0.2}}
    return tr.load_dict({**scene, "sky": {"type": "constant"}}, dtype=DOUBLE)


def weighted(found, names, mask: torch.Tensor) -> torch.Tensor:
    """A number of several outputs, with other weights for each and for each channel, where `mask` is."""
    total = torch.zeros((), dtype=DOUBLE)
    weight = torch.from_numpy(reference_scenes.weight(*mask.shape)).mean(-1)
    for i, name in enumerate(names):
        value = getattr(found, name)
        value = value[..., None] if value.dim() == 2 else value
        value = torch.where(mask[..., None], value, 0.0)
        total = total + (value * (1 + torch.arange(value.shape[-1])) * weight[..., None]).mean() * (1 + 0.3 * i)
    return total


def check(scene: tr.Scene, parameter: str, names: tuple[str, ...], step: float = 1e-3, spp: int = 400) -> None:
    scene = scene.to(torch.float32)  # packets take a fifth of the time
    value = scene.get_parameter(parameter).detach()
    direction = direction_of(parameter, value)
    with torch.no_grad():  # averages over few samples are biased, those over none are a constant
        mask = tr.render(scene, outputs=("alpha",), spp=256, seed=99).alpha > 0.2

    def f(x, seed, **more):
        return weighted(tr.render(scene, seed=seed, outputs=names, params={parameter: x}, **more), names, mask)

    derivatives, differences = [], []
    for seed in range(8):
        x = value.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(f(x, 90 + seed, spp=1, spp_grad=spp, seed_grad=seed), x)
        derivatives.append(float((gradient * direction).sum()))
        with torch.no_grad():
            change = f(value + step * direction, seed, spp=spp) - f(value - step * direction, seed, spp=spp)
        differences.append(float(change) / (2 * step))
    right, text = agrees(torch.tensor(derivatives), torch.tensor(differences), 0.01, TESTS)
    assert right, text


SHADING = ("depth", "position", "normal_camera", "albedo")  # uv jumps along meridians of round shapes


@pytest.mark.parametrize("behind", [True, False], ids=["wall", "nothing behind"])
@pytest.mark.parametrize(
    "parameter", ["leaf.vertex_positions", "ball.center", "plate.to_world", "pipe.to_world", "cube.vertex_positions",
                  "camera.to_world"]
)  # fmt: skip
def test_shapes(parameter, behind):
    check(things(FILTERS[0], behind), parameter, SHADING)


@pytest.mark.parametrize("rfilter", FILTERS[1:], ids=lambda f: f["type"])
@pytest.mark.parametrize("parameter", ["ball.center", "camera.to_world"])
def test_filters(rfilter, parameter):
    check(things(rfilter, behind=False), parameter, SHADING)


def test_lens():
    check(things(FILTERS[0], lens=True), "ball.center", SHADING)


@pytest.mark.parametrize("name", [n for n in REAL if n not in ("dp_du", "dp_dv")] + ["vertex_tint"])
def test_each_output(name):
    check(things(FILTERS[0]), "leaf.vertex_positions", (name,))


def frontal_disk(**settings) -> tr.Scene:
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    to_world = tr.Transform.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    wall = tr.Transform.translate([0, 0, -1]) @ tr.Transform.scale(5)
    return tr.load_dict(
        {
            "type": "scene",
            "camera": {"type": "perspective", "fov": 40, "to_world": to_world, "film": film},
            "disk": {"type": "disk", "to_world": tr.Transform.scale(0.6)},
            "wall": {"type": "rectangle", "to_world": wall},
            **settings,
        },
        dtype=DOUBLE,
    )


def test_a_frontal_disk():
    """The sum of depths is that of the wall, 5 a pixel, and the disk's area pi (f R / D)^2 times the difference -1."""
    scene = frontal_disk()
    (leaf,) = scene.train_only("disk.to_world")
    found = sum(
        torch.autograd.grad(tr.render(scene, outputs=("depth",), spp=64, seed=s).depth.sum(), leaf)[0] for s in range(4)
    )
    assert float(found[0, 0] + found[1, 1]) / 4 == pytest.approx(-2 * math.pi * (FOCAL / 4) ** 2 * 0.6, rel=5e-3)


def test_a_stack_of_outputs():
    """With the integrator `aov` what misses counts as zero: the sum over a disk alone grows by what its rim has.

    Depth is that along the ray there, from the near plane at 0.01.
    """
    scene = frontal_disk(integrator={"type": "aov", "aovs": "dd:depth"})
    del scene["wall"]
    (leaf,) = scene.train_only("disk.to_world")
    found = sum(torch.autograd.grad(tr.render(scene, spp=64, seed=s).sum(), leaf)[0] for s in range(4))
    at_rim = (4 - 0.01) * math.hypot(4, 0.6) / 4
    by_radius = 2 * math.pi * (FOCAL / 4) ** 2 * 0.6 * at_rim
    assert float(found[0, 0] + found[1, 1]) / 4 == pytest.approx(by_radius, rel=1e-4)


@pytest.mark.parametrize("pixels", [None, torch.tensor([[3, 4], [8, 8], [3, 4], [9, 5]])], ids=["image", "pixels"])
def test_forward_mode_has_the_same_samples(pixels):
    scene = things(FILTERS[1], behind=False)
    names = (*SHADING, "vertex_tint")
    where = {} if pixels is None else {"pixels": pixels.numpy()}
    value = scene.get_parameter("camera.to_world").detach()
    direction = direction_of("camera.to_world", value)

    def f(x):
        found = tr.render(scene, outputs=names, spp=8, seed=5, params={"camera.to_world": x}, passes=2, **where)
        parts = [getattr(found, n) for n in names]
        return torch.cat([torch.where(p.isfinite(), p, 0.0).flatten() for p in parts])

    _, tangent = torch.func.jvp(f, (value,), (direction,))
    weight = torch.randn(tangent.shape, generator=torch.Generator().manual_seed(1), dtype=DOUBLE)
    x = value.clone().requires_grad_()
    (gradient,) = torch.autograd.grad((f(x) * weight).sum(), x)
    assert float((tangent * weight).sum()) == pytest.approx(float((gradient * direction).sum()), rel=1e-9)


def test_a_common_motion_leaves_what_the_camera_has():
    """The camera and everything else moved alike: depths, normals of the camera's frame and uv do not change."""
    scene = things(FILTERS[0], behind=False)
    names = ["camera.to_world", "plate.to_world", "leaf.vertex_positions", "ball.center", "pipe.p0", "pipe.p1",
             "cube.vertex_positions"]  # fmt: skip
    leaves = scene.train_only(*names)
    found = tr.render(scene, outputs=("depth", "normal_camera", "uv"), spp=16, seed=2)
    loss = sum(torch.where(v.isfinite(), v, 0.0).square().sum() for v in found)
    by_x = [
        g[0, 3] if name.endswith("to_world") else g.reshape(-1, 3)[:, 0].sum()
        for name, g in zip(names, torch.autograd.grad(loss, leaves), strict=True)
    ]
    assert abs(float(sum(by_x))) < 1e-9 * max(abs(float(g)) for g in by_x)


def test_nothing_is_asked_for():
    scene = things(FILTERS[0])
    (leaf,) = scene.train_only("ball.bsdf.reflectance.value")
    found = tr.render(scene, outputs=("albedo",), spp=4, seed=1)
    torch.autograd.grad(found.albedo.sum(), leaf)
    assert "visibility_outputs" not in scene.statistics


def test_outputs_together_are_the_outputs_alone():
    """Their channels lie one after the other in the core, in its order."""
    scene = things(FILTERS[0])
    (leaf,) = scene.train_only("leaf.vertex_positions")
    names = ("vertex_tint", *reversed(REAL))  # another order
    everywhere = torch.ones(16, 16, dtype=torch.bool)

    def gradient(shown):
        found = tr.render(scene, outputs=shown, spp=4, seed=3)
        total = sum((0.3 * i + 1) * weighted(found, (n,), everywhere) for i, n in enumerate(names) if n in shown)
        return torch.autograd.grad(total, leaf)[0]

    alone = [gradient((name,)) for name in names]
    assert len({float(g.abs().sum()) for g in alone}) > len(names) // 2
    torch.testing.assert_close(gradient(names), sum(alone), rtol=1e-9, atol=1e-12)
