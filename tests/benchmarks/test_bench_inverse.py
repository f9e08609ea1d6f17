"""The inverse problems: small ones, the race of two programs, the search, and what programs are given."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import torchrender as tr
from bench import inverse_race
from bench.__main__ import main
from bench.inverse_loop import Loop
from bench.inverse_ours import OurLoop
from bench.inverse_problems import PROBLEMS
from bench.inverse_race import Run, race
from bench.inverse_search import Search, scaled
from bench.inverse_task import Task, Unknown, View, stride_of, with_free_sampler
from bench.peers import PeerError

SETTING = {"spp": 4, "spp_grad": 4, "rate": 0.05, "halving": 20, "sampler": "independent"}


def floor(resolution: int = 8) -> Task:
    """A floor under a lamp at two places: its colour is sought, and judged by a picture with the lamp at a third."""
    film = {"type": "hdrfilm", "width": resolution, "height": resolution, "rfilter": {"type": "box"}}
    scene = tr.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "to_world": tr.Transform.look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
                "film": film,
            },
            "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": [0.2, 0.4, 0.6]}},
            "lamp": {"type": "point", "position": [0, 0, 2], "intensity": 10.0},
        }
    )
    views = [View(0, {"lamp.position": [x, 0.0, 2.0]}) for x in (-1.0, 0.0, 1.0)]
    name = "floor.bsdf.reflectance.value"
    unknown = Unknown(name, np.full(3, 0.5, np.float32), linear=True)
    return Task(scene, [unknown], views[:2], views[2:], {"type": "prb"}, target_spp=64, judge_spp=4)


class InProcess:
    """A peer without a process."""

    def __init__(self, loop: Loop, title: str = "ours") -> None:
        self.loop, self.title, self.key, self.asked = loop, title, title, 0

    def ask(self, action: str, **arguments):
        self.asked += 1
        return getattr(self.loop, action.removesuffix("_inverse"))(**arguments)


def test_the_albedos_are_found(tmp_path):
    file, picture = tmp_path / "result.json", tmp_path / "plot.png"
    options = [
        "--quick",
        "--problem",
        "albedos",
        "--threads",
        "1",
        "--cap",
        "20",
        "--json",
        str(file),
        "--plot",
        str(picture),
    ]
    settings = tmp_path / "settings.json"
    settings.write_text(json.dumps({"albedos": {"torchrender": {**SETTING, "spp": 16, "spp_grad": 16}}}))
    assert main(["inverse", *options, "--settings", str(settings), "--folder", str(tmp_path / "pictures")]) == 0
    results, curve = json.loads(file.read_text())["tables"]
    (row,) = results["rows"]
    assert row["target reached"] == "yes" and row["error %"] <= 1.5 < 5 < row["error at the start %"]
    assert row["s"]["median"] > 0 and row["iterations"]["median"] > 5 and row["peak memory MiB"] > 50
    assert row["setting"].startswith("16 + 16 spp, rate 0.05 / 20, independent")
    assert curve["rows"][-1]["error"] * 100 == pytest.approx(row["error %"])
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "pictures" / "albedos.png").exists()


OF_PARAMETERS = [problem for problem in PROBLEMS[1:] if problem.name not in ("caustic", "pose", "monkey", "shadows")]


@pytest.mark.parametrize("problem", OF_PARAMETERS, ids=lambda problem: problem.name)
def test_every_problem_comes_nearer_to_the_truth(problem, tmp_path):
    task = problem.make(True)
    task.target_spp = 16
    task.write(tmp_path)
    loop = OurLoop(str(tmp_path))
    start = task.error({unknown.name: unknown.start for unknown in task.unknowns})
    loop.begin({**problem.setting, "spp": 8, "spp_grad": 8}, seed=0)
    loop.advance([40], str(tmp_path / "found"))
    with np.load(tmp_path / "found0.npz") as found:
        values = {name: found[name] for name in found.files}
    assert task.error(values) < 0.8 * start
    assert task.error({name: value.numpy() for name, value in task.truth.items()}) == 0
    for unknown in task.unknowns:
        assert values[unknown.name].shape == task.truth[unknown.name].shape == unknown.start.shape
        assert (values[unknown.name] >= np.float32(unknown.low)).all()
        assert (values[unknown.name] <= np.float32(unknown.high)).all()


@pytest.mark.parametrize(
    "problem", [p for p in PROBLEMS if p.name in ("texture512", "environment", "material")], ids=lambda p: p.name
)
def test_what_light_is_linear_in_is_found_by_least_squares(problem, tmp_path):
    task = problem.make(True)
    task.target_spp = 16
    task.write(tmp_path)
    loop = OurLoop(str(tmp_path))
    loop.begin({**problem.setting, "spp": 8, "spp_grad": 8, "damping": 3.0}, seed=0)
    moved = {unknown.name: unknown.linear for unknown in task.unknowns}
    assert sum(moved.values()) == 1
    by_light = [p for group in loop.squares.param_groups for p in group["params"]]
    by_adam = [p for group in loop.optimiser.param_groups for p in group["params"]] if loop.optimiser else []
    for name, linear in moved.items():
        assert any(loop.leaves[name] is p for p in (by_light if linear else by_adam))
    assert len(by_light) + len(by_adam) == len(moved)
    start = task.error({unknown.name: unknown.start for unknown in task.unknowns})
    loop.advance([20], str(tmp_path / "found"))
    with np.load(tmp_path / "found0.npz") as found:
        assert task.error(dict(found)) < 0.7 * start
        assert all((found[u.name] != u.start.astype(np.float32)).any() for u in task.unknowns)


@pytest.mark.parametrize(("name", "steps", "of_adam"), [("material", 16, 32), ("smoke64", 8, 8)])
def test_random_signs_need_fewer_steps_than_adam(name, steps, of_adam, tmp_path):
    """Of any of five rates."""
    problem = next(p for p in PROBLEMS if p.name == name)
    task = problem.make(True)
    task.target_spp = 64
    task.write(tmp_path)
    loop = OurLoop(str(tmp_path))

    def error(count, **setting):
        loop.begin({**problem.setting, "spp": 4, "spp_grad": 4, "halving": 1000, **setting}, seed=0)
        loop.advance([count], str(tmp_path / "found"))
        with np.load(tmp_path / "found0.npz") as found:
            return task.error(dict(found))

    found = error(steps, signs=10.0, damping=3.0)
    assert loop.optimiser is None
    assert 1.1 * found < min(error(of_adam, rate=rate) for rate in (0.0125, 0.025, 0.05, 0.1, 0.2))


def test_steps_by_some_pixels_find_the_same(tmp_path):
    task = floor()
    task.write(tmp_path)
    loop = OurLoop(str(tmp_path))
    loop.begin({**SETTING, "block": 4}, seed=0)
    drawn = np.stack([loop._pixels(seed) for seed in range(200)])
    assert drawn.shape == (200, 4, 2) and (loop._pixels(7) == drawn[7]).all()
    assert (drawn // 4 == [[0, 0], [0, 1], [1, 0], [1, 1]]).all()  # one of each square
    counts = np.bincount((drawn[..., 0] * 8 + drawn[..., 1]).ravel(), minlength=64)
    assert counts.min() > 0 and counts.max() < 40  # of 12.5 in the mean: by chance not so in one of 6000 tests
    loop.advance([60], str(tmp_path / "found"))
    with np.load(tmp_path / "found0.npz") as found:
        assert np.abs(found["floor.bsdf.reflectance.value"] - [0.2, 0.4, 0.6]).max() < 0.03
    place, pixels = loop.task["views"][1], loop._pixels(3)
    moved = {name: torch.tensor(value) for name, value in place["set"].items()}
    whole = loop.renderer(sensor=place["sensor"], view=1, seed=3, params=moved) - loop.images[1]
    assert loop._loss(1, 3).item() == pytest.approx(whole[pixels[:, 0], pixels[:, 1]].square().mean().item(), rel=1e-6)
    loop.begin({**SETTING, "block": 1}, seed=0)
    assert loop._pixels(0) is None
    with pytest.raises(ValueError, match="block: expected a divisor of height and width, got 3"):
        loop.begin({**SETTING, "block": 3}, seed=0)


def test_a_race_alternates_and_forgets_the_first_steps(tmp_path):
    task = floor()
    task.write(tmp_path)
    peers = [InProcess(OurLoop(str(tmp_path)), title) for title in ("one", "two")]
    runs = [Run(peer, task, SETTING, tmp_path, seed) for peer, seed in zip(peers, (1, 1), strict=True)]
    race(runs, 0.02, 60)
    one, two = runs
    assert one.reached(0.02) and two.reached(0.02)
    # The same seed and setting: the same steps, whatever their time.
    assert [(p.iterations, p.error) for p in one.points] == [(p.iterations, p.error) for p in two.points]
    assert one.last.seconds > 0 and one.points[0].iterations == 0
    assert all(a.seconds < b.seconds for a, b in zip(one.points, one.points[1:], strict=False))
    (found,) = one.found.values()
    assert np.abs(found - [0.2, 0.4, 0.6]).max() < 0.03
    # Once more in one go: to the same place, and that time counts.
    with np.load(tmp_path / "found_one_0.npz") as again:
        np.testing.assert_allclose(again["floor.bsdf.reflectance.value"], found, rtol=1e-5)
    assert one.seconds == one.whole["seconds"] != one.last.seconds and one.cpu == one.whole["cpu"]
    short = Run(peers[0], task, SETTING, tmp_path)
    race([short], 0.0, 0.0)
    assert short.points == short.points[:1]  # no time, no steps


def test_a_program_that_fails_is_out_of_the_race(tmp_path, monkeypatch):
    monkeypatch.setattr(inverse_race, "UNDISTURBED", 0.0)  # a look after each step
    task = floor()
    task.write(tmp_path)
    well, ill = (InProcess(OurLoop(str(tmp_path)), title) for title in ("well", "ill"))
    whole = ill.ask

    def ask(action: str, **arguments):
        if action == "advance_inverse" and ill.asked > 3:
            raise PeerError("ill: its process ended")
        return whole(action, **arguments)

    ill.ask = ask
    runs = [Run(peer, task, SETTING, tmp_path, 1) for peer in (well, ill)]
    race(runs, 0.02, 60)
    assert runs[0].outcome(0.02) == "yes" and runs[0].reached(0.02)
    assert runs[1].outcome(0.02) == "failed: ill: its process ended" and not runs[1].reached(1.0)
    assert len(runs[1].points) > 2
    assert not runs[1].whole and runs[1].seconds == runs[1].last.seconds
    late = Run(well, task, SETTING, tmp_path, 1)
    race([late], 0.0, 1e-6)
    assert late.outcome(0.0).startswith("not reached in") and late.outcome(0.0).endswith("%")


@pytest.mark.parametrize(("first", "expected"), [(3.0, [1]), (0.375, [1] * 8), (0.09375, [1] * 20 + [2] * 5 + [3])])
def test_looks_are_a_second_apart(first, expected, tmp_path):
    run = Run(SimpleNamespace(), None, SETTING, tmp_path, first=first)
    run.points = [inverse_race.Point(0, 0.0, 0.0, 1.0)]
    assert run._next_steps() == expected
    run.points = [inverse_race.Point(20, 40.0, 0.0, 1.0)]
    assert run._next_steps() == [2]


def test_rates_are_halved():
    loop = Loop.__new__(Loop)
    loop.setting, loop.seed, loop.iteration = {"rate": 0.8, "halving": 2}, 3, 0
    loop.task, loop.targets = {"stride": stride_of(5)}, np.zeros(5)
    steps = []
    loop._step = lambda view, seed, rate: steps.append((view, seed, rate))
    loop._steps(5)
    views, seeds, rates = zip(*steps, strict=True)
    assert sorted(views) == list(range(5)) and len(set(seeds)) == 5
    assert rates[::2] == pytest.approx((0.8, 0.4, 0.2))


class Counted:
    """A run whose time is known: least at the rate 0.1, with 2 to 4 samples, by Sobol' points."""

    def __init__(self, setting: dict, seed: int) -> None:
        self.setting, self.peer = setting, SimpleNamespace(title="counted")
        slowness = abs(np.log2(setting["rate"] / 0.1)) + (setting["sampler"] != "sobol")
        self.need = 10 * (1 + slowness) + 8 / setting["spp"] + setting["spp"] + setting["halving"] / 64
        if setting["sampler"] == "lucky":
            self.need = 1.0 if seed == 0 else 60.0
        self.last = SimpleNamespace(iterations=0, seconds=0.0, cpu=0.0, error=1.0)

    def begin(self) -> None:
        pass

    def check(self, target: float, cap: float) -> None:
        self.last.iterations += 1
        self.last.seconds += 0.25
        self.last.error = 0.0 if self.last.seconds >= self.need else 1.0

    def reached(self, target: float) -> bool:
        return self.last.error <= target

    def over(self, target: float, cap: float) -> bool:
        return self.reached(target) or self.last.seconds >= cap


def test_a_search_finds_the_fastest_setting(capsys):
    search = Search(Counted, 0.5, 200.0)
    best = search.search({**SETTING, "rate": 0.4, "spp": 16, "spp_grad": 1}, "torchrender")
    assert (best["rate"], best["sampler"]) == (pytest.approx(0.1), "sobol")
    assert best["spp"] in (2, 4) and best["halving"] in (5, 10)
    settings = [trial.setting for trial in search.trials]
    assert all(settings.count(setting) == 1 for setting in settings)
    lost = [trial for trial in search.trials if not trial.reached]
    assert lost and max(trial.seconds for trial in lost) <= search.trials[0].seconds + 0.25
    assert scaled(SETTING, "spp", 0.125) is None and scaled(SETTING, "samples", 0.5)["spp_grad"] == 2
    assert scaled(SETTING, "views", 2) is None and scaled({**SETTING, "smoothness": 3.0}, "smoothness", 0.5)


def test_a_search_tries_what_a_problem_names():
    other = {"sampler": "sobol", "views": 8}
    search = Search(Counted, 0.5, 200.0)
    search.search(SETTING, "no such program", [other])
    assert [{**trial.setting, **other} == trial.setting for trial in search.trials].count(True) == 1


def test_a_search_is_not_taken_in_by_one_lucky_run():
    lucky = {"sampler": "lucky"}
    found = [Search(Counted, 0.5, 200.0, runs=runs).search(SETTING, "no such program", [lucky]) for runs in (1, 3)]
    assert [setting["sampler"] == "lucky" for setting in found] == [True, False]


def test_given_pictures_and_cameras(tmp_path):
    task = floor()
    task.dark = 0.1
    task.write(tmp_path)
    targets, weights = np.load(tmp_path / "targets.npy"), np.load(tmp_path / "weights.npy")
    assert targets.shape == weights.shape == (2, 8, 8, 3)
    np.testing.assert_allclose(weights * (targets + 0.1), 1, rtol=1e-5)
    # Light by inverse squares, of the lamp above the middle: E = I cos / r^2, radiance albedo E / pi.
    middle = targets[1, 3:5, 3:5].mean((0, 1))
    np.testing.assert_allclose(middle, np.float32([0.2, 0.4, 0.6]) * 10 / 4 / np.pi, rtol=0.03)
    text = (tmp_path / "scene.xml").read_text()
    assert text.count("<sampler") == text.count("<sensor") == 1 and 'type="$sampler"' in text
    assert tr.load_file(tmp_path / "scene.xml", sampler="stratified").sensors
    assert with_free_sampler('<scene version="3.0.0"><sensor><sampler type="a"><b/></sampler></sensor></scene>') == (
        '<scene version="3.0.0"><default name="sampler" value="independent"/>'
        '<sensor><sampler type="$sampler"/></sensor></scene>'
    )


def test_mitsuba_with_one_thread_is_refused(capsys):
    assert main(["inverse", "--threads", "1", "--peer", "mitsuba=/no/such/python"]) == 2
    assert "needs two threads" in capsys.readouterr().err


def test_strides_come_to_every_picture():
    for count in (1, 2, 6, 9, 10, 16, 32):
        stride = stride_of(count)
        assert {i * stride % count for i in range(count)} == set(range(count))


def test_the_judge_weighs_as_the_loss_does():
    task = floor()
    name = task.unknowns[0].name
    half = {name: 0.5 * task.truth[name].numpy()}
    assert task.error(half) == pytest.approx(0.5, rel=1e-5)  # half the albedo, half the light
    task.dark = 0.1
    assert task.error(half) == pytest.approx(0.5, rel=1e-5)
    assert torch.equal(task.weight_of(torch.tensor([0.9])), torch.tensor([1.0]))
