"""Benchmarks beside another state of torchrender. Here it is the same one: with equal seeds it finds equal numbers."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import torchrender as tr
from bench import peers, report
from bench.__main__ import main
from bench.compare import OTHERS
from bench.ours import Ours
from bench.rows import ROWS

TINY = ["--resolution", "16", "--spp", "2", "--rounds", "2", "--warmup", "0", "--threads", "1"]
TITLE = "torchrender before"


def run(tmp_path: Path, *arguments: str) -> dict:
    """What a benchmark writes as JSON."""
    file = tmp_path / "result.json"
    assert main([*arguments, "--peer", f"torchrender={sys.executable}", "--json", str(file)]) == 0
    return json.loads(file.read_text())


def tables(tmp_path: Path, *arguments: str) -> list[list[dict]]:
    return [table["rows"] for table in run(tmp_path, *arguments)["tables"]]


def ratio(rows: list[dict], name: str) -> float:
    """Of the medians of the programs in two rows."""
    ours, before = rows
    assert (ours["program"], before["program"]) == ("ours", TITLE)
    return before[f"{name} s"]["median"] / ours[f"{name} s"]["median"]


def test_table2(tmp_path):
    result = run(tmp_path, "table2", *TINY, "--only", "Cornell", "--set", "correlated=True")
    (row,), (ratios,) = (table["rows"] for table in result["tables"])
    for name, column in (("image", "image alone s"), ("sum", "sum s")):
        expected = row[f"{TITLE} {column}"]["median"] / row[column]["median"]
        assert ratios[f"{TITLE} {name} / ours"] == pytest.approx(expected)
    assert result["versions"]["torchrender"] == tr.__version__
    assert result["versions"][TITLE].startswith(tr.__version__)
    assert f"{TITLE} sum s".startswith(OTHERS)  # not a figure of this state, for `compare`


def test_gradients_have_the_settings_of_this_state(tmp_path):
    """The same numbers of a sampler that is not the default."""
    options = [*TINY, "--only", "Cornell", "--rounds", "1"]
    (rows,) = tables(tmp_path, "gradients", *options, "--set", "sampler=sobol")
    assert [row["gradient"] for row in rows] == [row[f"{TITLE} gradient"] for row in rows]
    plain = Ours.of_row(ROWS[0], 16, 2).gradient(0, 2)[0]
    assert rows[0]["gradient"] != float(plain[0].sum())


def test_materials_that_no_other_program_has(tmp_path):
    options = ["--only", "redner", "--seeds", "2", "--check-spp", "2"]
    (time,), (image,), gradients = tables(tmp_path, "materials", *TINY, *options)
    assert time[f"{TITLE} / ours, image"]["n"] == time[f"{TITLE} / ours, sum"]["n"] == 2
    assert image[f"{TITLE}: difference of the means %"] == 0
    assert all(row["gradient"] == row[f"{TITLE} gradient"] for row in gradients)


def test_media(tmp_path):
    options = ["--size", "6", "--spp-grad", "1", "--passes", "2", "--seconds", "1", "--target", "8", "--rounds", "1"]
    iteration, reconstruction = tables(tmp_path, "smoke", *TINY, *options)
    assert iteration[1]["sum / ours"] == pytest.approx(ratio(iteration, "sum"))
    assert reconstruction[1]["iterations"] > 2 and reconstruction[1]["not finite, gradient"] == 0
    (slab,) = tables(tmp_path, "slab", *TINY, "--size", "2", "6", "6", "--spp-grad", "1", "--passes", "2")
    assert slab[1]["forward / ours"] == pytest.approx(ratio(slab, "forward"))
    options = ["--size", "6", "--part", "time", "variance", "--seeds", "2", "--reference", "8"]
    time, variance = tables(tmp_path, "volume_gradients", *TINY, *options)
    assert time[1]["forward / ours"] == pytest.approx(ratio(time, "forward"))
    assert variance[0]["deviation of a voxel"] == variance[1]["deviation of a voxel"] > 0


def test_caustics_in_passes(tmp_path):
    options = ["--size", "12", "--spp-grad", "2", "--passes", "2", "--part", "time"]
    (time,) = tables(tmp_path, "caustics", *TINY, *options)
    assert time[0]["distance after"] == time[1]["distance after"] > 0
    assert time[1]["sum / ours"] == pytest.approx(ratio(time, "sum"))


OLDER = f"""
import sys
sys.path.insert(0, {str(peers.FOLDER)!r})
from serving import serve


class Server:
    version, import_seconds = "0.0", 0.0

    def __init__(self, threads):
        pass

    def load(self, **arguments):
        raise ValueError("no model redner")


serve(Server)
"""


def test_a_material_that_is_new_has_no_ratio(tmp_path, monkeypatch, capsys):
    server = tmp_path / "server.py"
    server.write_text(OLDER)
    known = dataclasses.replace(peers.KNOWN["torchrender"], server=str(server))
    monkeypatch.setitem(peers.KNOWN, "torchrender", known)
    ((row,),) = tables(tmp_path, "materials", *TINY, "--only", "redner")
    assert row["material"] == "redner" and not any(TITLE in column for column in row)
    assert f"redner: {TITLE}: ValueError: no model redner" in capsys.readouterr().out


def test_commits_of_checkouts_and_of_installed_copies(tmp_path):
    def git(*arguments: str) -> str:
        names = ["-c", "user.name=a", "-c", "user.email=a@b"]
        done = subprocess.run(["git", *names, *arguments], cwd=tmp_path, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    package, copy = tmp_path / "package", tmp_path / "env" / "package"
    for folder in (package, copy):
        folder.mkdir(parents=True)
        (folder / "__init__.py").write_text("")
    assert report.commit_of(package) == ""
    git("init", "-q")
    git("add", "package")
    git("commit", "-qm", "first")
    assert report.commit_of(package) == git("rev-parse", "--short", "HEAD")
    assert report.commit_of(copy) == ""
    (package / "__init__.py").write_text("1\n")
    assert report.commit_of(package).endswith("-dirty")
    assert report.commit_of(tmp_path / "none") == ""


def test_this_torchrender_is_not_passed_on_by_the_environment(monkeypatch, tmp_path):
    """What PYTHONPATH names here is not what the other interpreter is to run."""
    (tmp_path / "torchrender.py").write_text("raise ImportError('the wrong one')\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    with peers.Peers([("torchrender", sys.executable)], 1) as (peer,):
        assert peer.version.startswith(tr.__version__) and peer.key == TITLE


def test_visibility_finds_the_same_derivatives(tmp_path):
    options = ["--differences", "2", "--difference-spp", "2", "--only", "receiver"]
    efficiency, (ours, before), _ = tables(tmp_path, "visibility", *TINY, *options)
    assert [row["program"] for row in efficiency] == ["ours", TITLE]
    assert before["program"] == TITLE and ours["derivative"] != 0
    assert before["derivative"] == pytest.approx(ours["derivative"], rel=1e-4)
