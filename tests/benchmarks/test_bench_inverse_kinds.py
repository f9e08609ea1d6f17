"""Small inverse problems whose unknowns are not parameters of the scene: a pose, a mesh, the heights of a plate."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from bench.inverse import start_of
from bench.inverse_loop import Grids
from bench.inverse_ours_kinds import loop_of
from bench.inverse_problems import PROBLEMS
from bench.inverse_shapes import POSE, posed

CHANGES = {
    "pose": {"spp": 8, "spp_grad": 8},
    "monkey": {"smoothness": 2.0},
    "shadows": {"smoothness": 2.0},
    "caustic": {"grown": 10, "rate": 1e-3},
}
LEFT = {"pose": 0.3, "monkey": 0.75, "shadows": 0.4, "caustic": 0.75}  # of the error at the start
STEPS = {"pose": 50, "monkey": 50, "shadows": 40, "caustic": 40}


@pytest.mark.parametrize("name", CHANGES)
def test_every_kind_comes_nearer_to_the_truth(name, tmp_path):
    (problem,) = [problem for problem in PROBLEMS if problem.name == name]
    task = problem.make(True)
    task.target_spp = 64
    task.write(tmp_path)
    loop = loop_of(str(tmp_path))
    start = task.error({unknown.name: unknown.start for unknown in task.unknowns})
    loop.begin({**problem.setting, **CHANGES[name]}, seed=0)
    loop.advance([STEPS[name]], str(tmp_path / "found"))
    with np.load(tmp_path / "found0.npz") as found:
        values = {key: found[key] for key in found.files}
    (unknown,) = task.unknowns
    assert values[unknown.name].shape == unknown.start.shape
    assert (values[unknown.name] >= np.float32(unknown.low)).all()
    assert (values[unknown.name] <= np.float32(unknown.high)).all()
    assert task.error(values) < LEFT[name] * start
    picture = task.shown([values])
    assert picture.dim() == 3 and bool(torch.isfinite(picture).all())


def make(name: str):
    (problem,) = [problem for problem in PROBLEMS if problem.name == name]
    return problem.make(True)


def test_a_pose_is_three_turns_and_a_shift():
    points = torch.randn(5, 3, generator=torch.Generator().manual_seed(1))
    x, y, z = POSE[:3]
    about_z = torch.tensor([[math.cos(z), -math.sin(z), 0], [math.sin(z), math.cos(z), 0], [0, 0, 1]])
    about_y = torch.tensor([[math.cos(y), 0, math.sin(y)], [0, 1, 0], [-math.sin(y), 0, math.cos(y)]])
    about_x = torch.tensor([[1, 0, 0], [0, math.cos(x), -math.sin(x)], [0, math.sin(x), math.cos(x)]])
    expected = (about_x @ about_y @ about_z @ points.T).T + torch.tensor(POSE[3:])
    torch.testing.assert_close(posed(torch.tensor(POSE), points), expected, atol=1e-5, rtol=1e-5)


def test_a_shifted_body_is_as_wrong_as_it_is_far():
    task = make("pose")
    assert task.error({"pose": np.float32(POSE)}) == 0
    extent = task.still.amax(0) - task.still.amin(0)
    shifted = np.float32(POSE) + np.float32([0, 0, 0, 0.3, 0, -0.4])
    assert task.error({"pose": shifted}) == pytest.approx(0.5 / float(extent.norm()), rel=1e-4)


def test_masks_of_a_body_that_is_half_as_large():
    task = make("monkey")
    (unknown,) = task.unknowns
    task.judged = task._judged({unknown.name: torch.from_numpy(unknown.start)})
    assert task.error({unknown.name: unknown.start}) == 0
    # A sphere of the radius r is seen as a disk of the radius tan(asin(r / distance)).
    share = (math.tan(math.asin(0.5 / 4.5)) / math.tan(math.asin(1 / 4.5))) ** 2
    assert task.error({unknown.name: unknown.start / 2}) == pytest.approx(1 - share, abs=0.02)


def test_shadows_that_are_drawn_are_those_that_are_wanted():
    """A wall of 1 has lamps of its own: what the lamp of the other one brings, and penumbrae, are 2 % of it."""
    task = make("shadows")
    assert torch.equal(task._targets(), task.judged) and task.judged.shape == (2, 24, 24, 3)
    start = {task.unknowns[0].name: torch.from_numpy(task.unknowns[0].start)}
    lit = task.picture(task.views[0], start, 1024, 0, sampler="sobol")
    torch.testing.assert_close(lit[0, 0], torch.full((3,), 1.02), rtol=0, atol=0.02)


def test_the_noise_of_pictures_is_not_an_error():
    task = make("caustic")
    (unknown,) = task.unknowns
    errors = []
    for spp in (16, 1024):
        task.judge_spp = spp
        errors.append(task.error({unknown.name: unknown.start}))
    few = task.picture(task.views[0], {unknown.name: torch.from_numpy(unknown.start)}, 16, 1)
    noisy = float((few - task.wanted).norm() / task.wanted.norm())
    assert noisy > 1.05 * errors[1]
    assert errors[0] == pytest.approx(errors[1], rel=0.025)


def test_grids_become_finer():
    grids = Grids.__new__(Grids)
    grids.task, grids.setting = {"size": 512, "coarsest": 32}, {"grown": 160, "smoothness": 2.0}
    grids.targets = np.zeros((1, 128, 128, 3))
    assert grids.sizes == [32, 64, 128, 256, 512]
    sizes = []
    for grids.iteration in (0, 9, 10, 39, 40, 89, 90, 159, 160, 1000):
        sizes.append(grids._size())
    assert sizes == [32, 32, 64, 64, 128, 128, 256, 256, 512, 512]
    assert grids._lambda(512) == 8.0


def test_views_of_a_step(tmp_path):
    task = make("monkey")
    task.target_spp = 1
    task.write(tmp_path)
    loop = loop_of(str(tmp_path))
    loop.setting = {"views": 3}
    seen = []
    for loop.iteration in range(4):
        seen += loop._views()
    assert sorted(seen) == sorted(3 * list(range(4)))  # 4 steps of 3 pictures, of which there are 4
    loop.setting = {"views": 5}
    with pytest.raises(ValueError, match="views: expected at most 4, got 5"):
        loop._views()


def test_settings_of_a_program():
    (pose,) = [problem for problem in PROBLEMS if problem.name == "pose"]
    mitsuba, ours = (SimpleNamespace(name=name) for name in ("mitsuba", "torchrender"))
    assert "spp_shadows" in start_of({}, pose, mitsuba) and "spp_shadows" not in start_of({}, pose, ours)
    stored = {"pose": {"mitsuba": {"spp_shadows": 64}}}
    assert start_of(stored, pose, mitsuba)["spp_shadows"] == 64
