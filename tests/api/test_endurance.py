"""What a long optimisation relies on: what did not change is not made again, and memory and time stay as they are."""

from __future__ import annotations

import copy
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import torchrender as tr

PROGRAM = Path(__file__).resolve().parent / "endurance_program.py"


def bumps(n: int, phase: float = 0.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A wavy square of 2 (n - 1)^2 triangles: vertices, faces, texture coordinates."""
    u = torch.linspace(-1, 1, n)
    y, x = torch.meshgrid(u, u, indexing="ij")
    z = 0.1 * torch.sin(5 * x + phase) * torch.cos(4 * y)
    index = torch.arange(n * n).reshape(n, n)
    a, b, c, d = (i.reshape(-1) for i in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    faces = torch.cat([torch.stack([a, b, c], 1), torch.stack([b, d, c], 1)])
    return torch.stack([x, y, z], -1).reshape(-1, 3), faces, torch.stack([x, y], -1).reshape(-1, 2) / 2 + 0.5


def make_scene(n: int = 12, phase: float = 0.0, **settings) -> tr.Scene:
    vertices, faces, texcoords = bumps(n, phase)
    texture = {"type": "bitmap", "data": torch.full((8, 8, 3), 0.5), "raw": True}
    return tr.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 45,
                "to_world": tr.Transform.look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 16, "height": 12, "rfilter": {"type": "box"}},
            },
            "sky": {"type": "envmap", "data": torch.rand(4, 8, 3, generator=torch.Generator().manual_seed(1)) + 0.2},
            "ball": {"type": "sphere", "radius": 0.3, "center": [0, 0, 0.6]},
            "lamp": {
                "type": "rectangle",
                "to_world": tr.Transform.translate([0, 0, 2]).scale(0.2),
                "emitter": {"type": "area", "radiance": 2.0},
            },
            "sheet": tr.Mesh(
                vertices, faces, vertex_texcoords=texcoords, bsdf={"type": "diffuse", "reflectance": texture}
            ),
        },
        **settings,
    )


def edit(scene: tr.Scene, name: str) -> None:
    """Change every number of a parameter in place."""
    with torch.no_grad():
        scene.get_parameter(name).mul_(0.99)


def counts(scene: tr.Scene, seed: int = 0) -> dict[str, int]:
    tr.render(scene, spp=1, seed=seed)
    return scene.updates


def grown(before: dict[str, int], after: dict[str, int]) -> dict[str, int]:
    return {name: after[name] - before[name] for name in before if after[name] != before[name]}


# ---------------------------------------------------------------------------------------------- what is made again
def test_updates_are_counted_from_the_first_rendering():
    scene = make_scene()
    assert scene.updates == {}
    assert counts(scene) == {
        "scenes": 1,
        "meshes": 2,  # the sheet and the lamp
        "quadrics": 1,
        "tree_builds": 1,
        "mesh_refits": 0,
        "mesh_rebuilds": 0,
        "environments": 1,
        "height_fields": 0,
        "sdf_grids": 0,
    }


@pytest.mark.parametrize(
    "name",
    [
        None,
        "sheet.bsdf.reflectance.data",
        "sheet.bsdf.reflectance.to_uv",
        "sheet.vertex_texcoords",
        "ball.bsdf.reflectance.value",
        "lamp.emitter.radiance.value",
        "camera.x_fov",
    ],
)
def test_small_changes_make_nothing_again(name):
    scene = make_scene()
    before = counts(scene)
    for _ in range(3):
        if name is not None:
            edit(scene, name)
        assert grown(before, counts(scene)) == {}


def test_an_environment_map_makes_its_tables_again_and_nothing_else():
    scene = make_scene()
    before = counts(scene)
    edit(scene, "sky.data")
    assert grown(before, counts(scene)) == {"environments": 1}


def test_moved_vertices_refit_and_nothing_else():
    scene = make_scene()
    before = counts(scene)
    for _ in range(4):
        edit(scene, "sheet.vertex_positions")
        after = counts(scene)
    # A first motion builds in less time, a second one a tree for each mesh, which the following refit.
    assert grown(before, after) == {"meshes": 4, "tree_builds": 2, "mesh_refits": 2}


def test_rebuilt_scenes_are_those_of_a_new_process():
    scene = make_scene()
    first = counts(scene)
    for _ in range(4):
        edit(scene, "sheet.vertex_positions")
        counts(scene)
    assert scene.updates["mesh_refits"] > 0
    scene.rebuild()
    assert scene.updates == {}
    image = tr.render(scene, spp=16, seed=1)
    assert scene.updates == first
    assert torch.equal(image, tr.render(copy.deepcopy(scene), spp=16, seed=1))


def test_vertices_that_were_written_but_not_changed_do_not_count():
    scene = make_scene()
    before = counts(scene)
    with torch.no_grad():
        scene.get_parameter("sheet.vertex_positions").add_(0)
    assert grown(before, counts(scene)) == {}


def test_a_mesh_that_is_torn_apart_gets_a_new_tree():
    scene = make_scene(n=24)
    positions = scene.get_parameter("sheet.vertex_positions")
    for _ in range(3):
        edit(scene, "sheet.vertex_positions")
        before = counts(scene)
    with torch.no_grad():
        positions.copy_(positions[torch.randperm(len(positions), generator=torch.Generator().manual_seed(0))])
    assert grown(before, counts(scene)) == {"meshes": 1, "mesh_rebuilds": 1}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_refitted_scene_renders_like_a_new_one(dtype):
    scene = make_scene(n=20, dtype=dtype)
    for step in range(6):
        phase = 0.3 * step
        with torch.no_grad():
            scene.get_parameter("sheet.vertex_positions").copy_(bumps(20, phase)[0])
            scene.get_parameter("ball.center")[0] = 0.05 * step
            scene.get_parameter("lamp.to_world")[0, 3] = 0.1 * step
        fresh = make_scene(n=20, phase=phase, dtype=dtype)
        with torch.no_grad():
            fresh.get_parameter("ball.center")[0] = 0.05 * step
            fresh.get_parameter("lamp.to_world")[0, 3] = 0.1 * step
        assert torch.equal(tr.render(scene, spp=8, seed=step), tr.render(fresh, spp=8, seed=step))
    assert scene.updates["mesh_refits"] >= 4


def test_a_texture_of_another_size_leaves_geometry_and_environment_alone():
    scene = make_scene()
    before = counts(scene)
    for size in (4, 16, 5):
        scene.sheet.bsdf.reflectance.data = torch.full((size, size, 3), 0.5)
        after = counts(scene)
    assert grown(before, after) == {"scenes": 3}
    fresh = make_scene()
    fresh.sheet.bsdf.reflectance.data = torch.full((5, 5, 3), 0.5)
    assert torch.equal(tr.render(scene, spp=4, seed=3), tr.render(fresh, spp=4, seed=3))
    edit(scene, "sheet.vertex_positions")  # what was taken over goes on following its parameters
    edit(fresh, "sheet.vertex_positions")
    edit(scene, "sky.data")
    edit(fresh, "sky.data")
    assert torch.equal(tr.render(scene, spp=4, seed=3), tr.render(fresh, spp=4, seed=3))


def test_an_environment_of_another_size_leaves_geometry_alone():
    scene = make_scene()
    before = counts(scene)
    scene.sky.data = torch.full((6, 10, 3), 0.5)
    assert grown(before, counts(scene)) == {"scenes": 1, "environments": 1}
    fresh = make_scene()
    fresh.sky.data = torch.full((6, 10, 3), 0.5)
    assert torch.equal(tr.render(scene, spp=4, seed=3), tr.render(fresh, spp=4, seed=3))


def test_another_number_of_vertices_leaves_the_environment_alone():
    scene = make_scene()
    before = counts(scene)
    vertices, faces, texcoords = bumps(9)
    scene["sheet"] = tr.Mesh(vertices, faces, vertex_texcoords=texcoords, bsdf=scene.sheet.bsdf)
    assert grown(before, counts(scene)) == {"scenes": 1, "meshes": 2, "quadrics": 1, "tree_builds": 1}
    fresh = make_scene(n=9)
    assert torch.equal(tr.render(scene, spp=4, seed=3), tr.render(fresh, spp=4, seed=3))


def test_derivatives_of_earlier_images_survive_a_takeover():
    scene = make_scene()
    name = "sheet.bsdf.reflectance.data"
    textures = [torch.full((size, size, 3), 0.4).requires_grad_() for size in (3, 7)]
    alone = []
    for texture in textures:
        image = tr.render(make_scene(), spp=4, seed=5, params={name: texture})
        alone.append(torch.autograd.grad(image.sum(), texture)[0])
    images = [tr.render(scene, spp=4, seed=5, params={name: texture}) for texture in textures]
    for image, texture, expected in zip(images, textures, alone, strict=True):
        assert torch.equal(torch.autograd.grad(image.sum(), texture)[0], expected)


def test_a_failed_update_is_made_up_for():
    scene = make_scene()
    expected = tr.render(scene, spp=4, seed=1)
    positions, data = scene.get_parameter("sheet.vertex_positions"), scene.get_parameter("sky.data")
    for parameter in (positions, data):
        good = parameter.detach().clone()
        with torch.no_grad():
            parameter[1, 0] = float("nan")
        for _ in range(2):
            with pytest.raises(ValueError, match="has values that are not finite"):
                tr.render(scene, spp=4, seed=1)
        with torch.no_grad():
            parameter.copy_(good)
        assert torch.equal(tr.render(scene, spp=4, seed=1), expected)


# ------------------------------------------------------------------------------------------------- memory and time
def measured(*cases: str) -> dict[str, dict[str, float]]:
    """What `endurance_program.py` measures, in a process of its own: nothing that was freed earlier hides a leak."""
    # Waiting threads of OpenMP that spin would be counted as time.
    environment = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE"}
    command = [sys.executable, str(PROGRAM), *cases]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=environment)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stderr == ""
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def endured() -> dict[str, dict[str, float]]:
    """All cases."""
    return measured()


CASES = ["texture step", "moving vertices", "builds", "everything changes", "network output", "refused"]


@pytest.mark.parametrize("case", CASES)
def test_memory_stays_flat(endured, case):
    # The smallest thing that could leak in every iteration, a gradient or an image, has some KiB. What leaks does so
    # every time; what an allocator keeps depends on what came before.
    growth = [endured[case]["KiB an iteration"]]
    while min(growth) >= 1.0 and len(growth) < 3:
        growth.append(measured(case)[case]["KiB an iteration"])
    assert min(growth) < 1.0, growth


@pytest.mark.parametrize("case", CASES)
def test_time_of_an_iteration_stays_constant(endured, case):
    # What grows does so every time; what other programs do to caches and clocks, they do once.
    growth = [endured[case]["late over early"]]
    while min(growth) >= 1.6 and len(growth) < 3:
        growth.append(measured(case)[case]["late over early"])
    assert min(growth) < 1.6, growth


@pytest.mark.parametrize(
    "case",
    ["many samples", "many samples, derivative", "many samples, derivative, wide filter", "endless paths"],
)
def test_endless_renderings_can_be_interrupted(endured, case):
    # What does not listen does so every time; what other programs do to clocks, they do once.
    found = [endured[case]]
    while found[-1]["seconds until it stopped"] >= 0.5 and len(found) < 3:
        found.append(measured(case)[case])
    assert found[-1]["seconds until it stopped"] < 0.5, found
    assert all(run["MiB while running"] < 32 and run["same image afterwards"] is True for run in found), found
