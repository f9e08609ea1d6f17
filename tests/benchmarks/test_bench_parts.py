"""The parts of the benchmark program that decide something: statistics, fits, comparisons, recorded rays, peers."""

from __future__ import annotations

import argparse
import json
import sys
import warnings

import numpy as np
import pytest
import torch

import torchrender as tr
from bench import compare, kills, peers, plots, report
from bench.embree_alone import KINDS, QUERIES, EmbreeAlone, Pair
from bench.materials import ALL, MATERIALS, block_means, cases, z_scores
from bench.measured import Measured, fit_line, rounds
from bench.meshes import bumpy_sphere
from bench.ours import Ours
from bench.rows import ROWS
from bench.scaling import sample_rows
from bench.scene_arrays import arrays_of
from bench.variance import Reference, error_slope, samples_in, squared_error


def test_median_quartiles_and_error():
    measured = Measured.of([5.0, 1.0, 2.0, 3.0, 4.0])
    assert measured == Measured(3.0, 2.0, 4.0, 5)
    assert measured.spread == pytest.approx(1 / 3)
    assert str(measured) == "3 ± 33 %"
    assert str(measured.scaled(1000)) == "3e+03 ± 33 %"
    assert str(Measured.of([0.1234])) == "0.123"
    with pytest.raises(ValueError, match="no measurements"):
        Measured.of([])


def test_standard_error_of_a_median():
    """Against 4000 medians of 101 normal numbers: their deviation is known to 1.1 %, the estimate's mean to 0.2 %."""
    generator = np.random.default_rng(1)
    samples = generator.normal(100, 3, (4000, 101))
    actual = np.median(samples, axis=1).std() / 100
    estimated = np.mean([Measured.of(row).error for row in samples.tolist()])
    assert estimated == pytest.approx(actual, rel=0.05)  # more than four standard deviations: about 6e-5


def test_line_through_exact_points():
    x = [1, 10, 100, 1000]
    assert fit_line(x, [3 + 0.5 * value for value in x]) == pytest.approx((3, 0.5))
    with pytest.raises(ValueError, match="two different values"):
        fit_line([2, 2], [1, 1])


def test_relative_errors_leave_the_offset_to_the_short_ones():
    """A long measurement that is 2 % off must not move the offset by 2 % of itself."""
    offset, slope = fit_line([1, 2, 4, 100000], [2.0, 3.0, 5.0, 102001.0])
    assert offset == pytest.approx(1, abs=0.1)
    assert slope == pytest.approx(1, rel=0.03)


def test_rounds_alternate_and_the_first_do_not_count():
    calls = []

    def program(name):
        def run(number):
            calls.append((name, number))
            return {"step": float(number)}

        return run

    options = argparse.Namespace(warmup=2, rounds=3)
    found = rounds({"a": program("a"), "b": program("b")}, options)
    assert calls == [(name, number) for number in range(5) for name in "ab"]
    assert found == {"a": {"step": [2.0, 3.0, 4.0]}, "b": {"step": [2.0, 3.0, 4.0]}}


def test_table_leaves_empty_what_was_not_measured():
    rows = [{"scene": "a", "sum s": Measured(0.12345, 0.12, 0.13, 3)}, {"scene": "b", "ratio": 2.0, "sum s": None}]
    table = report.Table("t", ["scene"], rows, ["A note."])
    assert report.markdown(table).splitlines() == [
        "| scene | sum s | ratio |",
        "|---|---|---|",
        "| a | 0.123 ± 4 % |  |",
        "| b |  | 2 |",
        "",
        "A note.",
    ]


def document(**figures: Measured) -> dict:
    rows = [{"scene": "box", "texels": 4, **figures}]
    result = report.Result([report.Table("t", ["scene", "texels"], rows)])
    where = {"cpu": "x", "cores": 2, "load": 0.0}
    return json.loads(json.dumps(report.to_json("table2", result, {"threads": 2}, where)))


def test_compare_tells_slower_from_noise():
    before = document(
        steady=Measured(1.0, 0.99, 1.01, 11), noisy=Measured(1.0, 0.7, 1.3, 11), fast=Measured(1.0, 0.99, 1.01, 11)
    )
    after = document(
        steady=Measured(1.1, 1.09, 1.11, 11), noisy=Measured(1.1, 0.8, 1.4, 11), fast=Measured(0.8, 0.79, 0.81, 11)
    )
    verdicts = {row["figure"]: row["verdict"] for row in compare.compare(before, after, 0.05)}
    assert verdicts == {"steady": "worse", "noisy": "", "fast": "better"}
    assert all(row["verdict"] == "" for row in compare.compare(before, before, 0.0))
    assert compare.compare(before, after, 0.15)[0]["verdict"] == ""


def test_compare_tells_tables_apart():
    rows = [[{"spp": 16, "step ms": Measured(t, t, t, 3)}] for t in (1.0, 2.0)]
    tables = [report.Table("t", ["spp"], r, part=part) for part, r in zip(("samples", "pixels"), rows, strict=True)]
    result = json.loads(json.dumps(report.to_json("scaling", report.Result(tables), {}, {})))
    assert [row["row"] for row in compare.compare(result, result, 0.05)] == ["samples, 16", "pixels, 16"]
    assert all(row["after / before"] == 1 for row in compare.compare(result, result, 0.05))


def test_compare_does_not_count_peers():
    before, after = (document(**{"Mitsuba sum s": Measured(t, t, t, 5), "sum s": Measured(1, 1, 1, 5)}) for t in (1, 2))
    assert [row["verdict"] for row in compare.compare(before, after, 0.05)] == ["(not ours)", ""]
    rows = [[{"program": who, "step ms": Measured(t, t, t, 3)} for who in ("ours", "Mitsuba")] for t in (1.0, 2.0)]
    results = [report.Result([report.Table("t", ["program"], r)]) for r in rows]
    before, after = (json.loads(json.dumps(report.to_json("scaling", result, {}, {}))) for result in results)
    assert [row["verdict"] for row in compare.compare(before, after, 0.05)] == ["worse", "(not ours)"]


def test_compare_ends_with_a_status(tmp_path, capsys):
    files = [tmp_path / "a.json", tmp_path / "b.json", tmp_path / "c.json", tmp_path / "d.json"]
    fast, slow = document(step=Measured(1, 1, 1, 5)), document(step=Measured(2, 2, 2, 5))
    slow["settings"]["threads"] = 1
    for file, content in zip(files, (fast, slow, {**fast, "benchmark": "rays"}, {"tables": []}), strict=True):
        file.write_text(json.dumps(content))
    assert compare.main([str(files[0]), str(files[1])]) == 1
    printed = capsys.readouterr().out
    assert "| box, 4 | step | 1 ± 0 % | 2 ± 0 % | 2 | 0 | worse |" in printed
    assert "threads: 2 before, 1 after" in printed
    assert compare.main([str(files[1]), str(files[0])]) == 0
    assert compare.main([str(files[0]), str(files[2])]) == 2
    assert "different benchmarks: table2 and rays" in capsys.readouterr().err
    assert compare.main([str(files[0]), str(files[3])]) == 2
    assert compare.main([str(files[0]), str(tmp_path / "none.json")]) == 2


def test_samples_that_a_time_is_enough_for():
    assert samples_in(0.5, [10, 20], [0.2, 0.3]) == pytest.approx(40)
    assert samples_in(0.05, [10, 20], [0.2, 0.3]) is None
    assert samples_in(0.5, [10], [0.1]) == pytest.approx(50)
    assert samples_in(0.5, [10, 20], [0.3, 0.3]) == 20


def test_slope_of_errors():
    offset, slope = error_slope([4, 16, 64], [1.0, 0.5, 0.25])
    assert (offset, slope) == pytest.approx((np.log(2), -0.5))
    assert error_slope([4], [1.0]) == pytest.approx((np.log(2), -0.5))
    image, gradient = [np.full((2, 2), 2.0)], [np.array([3.0, -3.0]), np.array([3.0])]
    assert squared_error([np.full((2, 2), 3.0)], image, "image") == pytest.approx(0.25)
    assert squared_error([np.array([3.0, -3.0]), np.array([0.0])], gradient, "gradient") == pytest.approx(1 / 3)


def test_noise_of_a_reference_is_that_of_the_mean_of_its_halves():
    """100000 numbers with deviation 0.1 around 2: the noise is known to 0.5 %, the limit is eight times that."""
    generator = np.random.default_rng(3)
    first, second = ([2 + 0.1 * generator.standard_normal(100000)] for _ in range(2))
    reference = Reference.of_halves(first, second, "image")
    assert reference.noise == pytest.approx(0.1**2 / 2 / 2**2, rel=0.04)
    truth = [np.full(100000, 2.0)]
    assert squared_error(reference.value, truth, "image") == pytest.approx(reference.noise, rel=0.04)


@pytest.mark.parametrize("count", [1000, 20000])
def test_mesh_of_many_triangles_is_closed(count):
    vertices, faces, normals = bumpy_sphere(count)
    assert abs(len(faces) / count - 1) < 0.1
    # Columns at the poles are one point: every edge then has two faces, with opposite directions.
    columns = np.flatnonzero(np.abs(vertices[:, 0]) + np.abs(vertices[:, 2]) < 1e-6)
    names = np.arange(len(vertices))
    for top in (True, False):
        pole = [i for i in columns if (vertices[i, 1] > 0) == top]
        names[pole] = pole[0]
    edges = {(int(a), int(b)) for f in names[faces] for a, b in zip(f, np.roll(f, -1), strict=True)}
    assert len(edges) == 3 * len(faces)
    assert all((b, a) in edges for a, b in edges)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    assert ((normals * vertices).sum(1) > 0).all()


def test_embree_alone_traces_what_the_renderer_asked():
    ours = Ours.of_row(ROWS[0], 24, 2)
    pair = Pair(ours, 1)
    ours.step(0)  # what comes later is not recorded
    for alone, kind in ((pair.image, "render"), (pair.derivative, "vjp")):
        ours.renderer(seed=0).square().mean().backward()
        statistics = ours.scene.statistics[kind]
        assert alone.rays == statistics["closest_rays"] + statistics["shadow_rays"]
        assert tuple(alone.queries) == KINDS
    times = pair.round()
    assert 0 < times["forward"] < times["sum"] < 10


def test_embree_alone_extrapolates_beyond_its_limit():
    ours = Ours.of_row(ROWS[0], 48, 4)
    whole, part = EmbreeAlone(ours, False, 1), EmbreeAlone(ours, False, 1, limit=4000)
    assert part.rays == whole.rays
    assert part.counts["bounce"]["left_out"] > 0
    part.handle = argparse.Namespace(replay_rays=lambda *_: {"seconds": [2.0, 3.0], "hits": 0})
    factor = part.count("bounce") / part.counts["bounce"]["rays"]
    assert factor > 1.5
    assert part.replay("bounce", QUERIES[0], 2) == pytest.approx([2 * factor, 3 * factor])


def test_block_means():
    image = np.arange(5 * 4 * 3, dtype=np.float32).reshape(5, 4, 3)
    means = block_means(image, 2)
    assert means.shape == (2, 2, 3)
    assert np.allclose(means[1, 0], image[2:4, :2].mean((0, 1)))
    assert np.allclose(block_means(image, 16), image[:4].mean((0, 1)))  # the largest square


def test_z_scores_of_equal_and_of_shifted_means():
    """Of 20000 differences: the root mean square is known to 0.6 % (Student's t, 18 degrees of freedom: 1.061)."""
    generator = np.random.default_rng(5)
    first, second = generator.normal(3, 0.1, (2, 10, 20000))
    assert np.sqrt((z_scores(first, second) ** 2).mean()) == pytest.approx((18 / 16) ** 0.5, rel=0.03)
    shifted = z_scores(first + 0.2, second)
    assert np.median(shifted) == pytest.approx(0.2 / (0.1 * (2 / 10) ** 0.5), rel=0.05)
    constant = np.full((4, 2), 2.0)
    assert np.isnan(z_scores(constant, constant)).all()
    assert np.allclose(z_scores(constant, constant * (1 + 1e-4), 1e-4), -1, rtol=1e-3)


def test_measured_materials_have_their_parameters():
    """All of them exist and have derivatives."""
    options = argparse.Namespace(resolution=8, spp=1, only="")
    found = cases(options)
    assert [case.name for case in found] == [*MATERIALS, ALL]
    for case in found:
        scene = tr.load_dict(case.scene)
        leaves = scene.train_only(*case.parameters)
        assert {id(leaf) for leaf in leaves} == {id(scene.get_parameter(name)) for name in case.parameters}, case.name
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tr.MissingTermWarning)  # light that would come through where none does
            tr.render(scene, seed=0).square().mean().backward()
        assert all(leaf.grad is not None and torch.isfinite(leaf.grad).all() for leaf in leaves), case.name
    (alone,) = cases(argparse.Namespace(resolution=8, spp=1, only="thindielectric"))
    assert alone.parameters[-1] == "floor.bsdf.reflectance.color0.value"


def test_arrays_of_a_scene():
    scene = tr.load_file(ROWS[1].path, resolution=8, **ROWS[1].arguments)
    arrays = arrays_of(scene)
    assert {key.partition(".")[0] for key in arrays} == {"to_world", "fov", "0", "1", "2"}
    assert arrays["0.colour"].shape == (512, 512, 3) and str(arrays["0.parameter"]) == ROWS[1].parameters[0]
    assert bool(arrays["0.two_sided"]) and not bool(arrays["2.two_sided"])
    assert arrays["1.radiance"].tolist() == [12, 12, 12] and "2.radiance" not in arrays
    # The rectangle's corners are hit where they should be: the lamp faces down.
    corners = arrays["1.vertices"]
    assert np.allclose(corners[:, 1], 3) and np.allclose(np.abs(corners[:, [0, 2]]), 1)
    a, b, c = corners[arrays["1.faces"][0]]
    assert np.cross(b - a, c - a)[1] < 0
    with pytest.raises(ValueError, match="ball: expected a mesh or a rectangle, got 'sphere'"):
        arrays_of(tr.load_dict({"type": "scene", "camera": {"type": "perspective"}, "ball": {"type": "sphere"}}))


def test_fixed_cost_is_taken_off():
    options = argparse.Namespace(warmup=0, rounds=1, renderer=[])
    rows = sample_rows(ROWS[0], [(8, 1), (8, 64)], [], options)
    (small, large) = rows
    assert (small["samples"], large["samples"]) == (64, 4096)
    fixed = small["fixed cost, in ms"]
    for row in rows:  # two points: the line goes through both
        marginal = row["without the fixed cost, a sample, in ns"] * row["samples"] / 1e6
        assert row["step ms"].median == pytest.approx(fixed + marginal)
        assert row["of the fit's slope"] == pytest.approx(1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("blender=python", "expected one of mitsuba, redner, torchrender, got 'blender'"),
        ("mitsuba", "expected mitsuba=PYTHON, .*/pip install mitsuba==3.9.1"),
        ("redner=", "set REDNER_PYTHON"),
    ],
)
def test_peers_that_cannot_be_asked_for(text, message, monkeypatch):
    for name in peers.KNOWN:
        monkeypatch.delenv(f"{name.upper()}_PYTHON", raising=False)
    with pytest.raises(ValueError, match="(?s)" + message):
        peers.parse(text)


def test_a_peer_by_its_environment_variable(monkeypatch):
    monkeypatch.setenv("REDNER_PYTHON", "/env/bin/python")
    assert peers.parse("redner") == ("redner", "/env/bin/python")
    assert peers.parse("redner=/other/python") == ("redner", "/other/python")


def test_a_peer_is_given_once():
    with pytest.raises(peers.PeerError, match="mitsuba is given twice"):
        peers.Peers([("mitsuba", "a"), ("redner", "b"), ("mitsuba", "c")], 1)


def test_an_environment_without_the_peer_is_reported(tmp_path):
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\necho no module >&2\nexit 3\n")
    program.chmod(0o755)
    with pytest.raises(
        peers.PeerError, match=r"(?s)ended with status 3 \(no module\); .*/pip install mitsuba==3\.9\.1"
    ):
        peers.Peer("mitsuba", str(program), 1)
    program.write_text("#!/bin/sh\necho hello\n")
    with pytest.raises(peers.PeerError, match=r"(?s)Mitsuba: not an answer: 'hello'; .*/pip"):
        peers.Peer("mitsuba", str(program), 1)
    with pytest.raises(peers.PeerError, match="/no/such/python: No such file"):
        peers.Peer("redner", "/no/such/python", 1)


def test_errors_of_a_peer_are_passed_on(fake_peer):
    with peers.Peers([("mitsuba", sys.executable)], 1) as (peer,):
        assert (peer.title, peer.version) == ("Mitsuba", "0.0")
        assert peer.ask("forward", seed=0)["forward"] > 0
        with pytest.raises(peers.PeerError, match="Mitsuba: ValueError: no seed 666"):
            peer.ask("forward", seed=666)
        assert peer.ask("memory")["peak"] > 1
    assert peer.process.poll() == 0


def test_plots_say_what_they_need(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ImportError, match="pip install matplotlib"):
        plots.require_matplotlib()


def test_kills_see_other_bits(tmp_path):
    optimiser = {"param_groups": [{"line_search_fn": "strong_wolfe", "lr": 1.0, "params": [0]}]}
    state = {"settings": {"rate": 1.0}, "iteration": 3, "x": torch.tensor([1.0, float("nan")]), "optimiser": optimiser}
    for folder, changes in (
        ("whole", {}),
        ("alike", {"settings": {"rate": 2.0}}),  # which `Checkpoint` compares itself
        ("off", {"x": torch.tensor([1.0 + 2.0**-23, float("nan")])}),
        ("earlier", {"iteration": 2}),
        ("other", {"optimiser": {"param_groups": [{**optimiser["param_groups"][0], "line_search_fn": None}]}}),
    ):
        (tmp_path / folder).mkdir()
        torch.save(state | changes, tmp_path / folder / "checkpoint.pt")
    (tmp_path / "empty").mkdir()
    found = {f.name: kills.same(tmp_path / "whole", f) for f in tmp_path.iterdir()}
    assert found == {"whole": True, "alike": True, "off": False, "earlier": False, "other": False, "empty": False}
    assert set(kills.SIZES) >= set(kills.BY_ITSELF)
    tutorials = {path.stem for path in kills.TUTORIALS.glob("*.py") if "import Checkpoint" in path.read_text()}
    assert set(kills.SIZES) == tutorials
