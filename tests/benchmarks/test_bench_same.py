"""The comparison of two states of torchrender: what counts as a difference, and the program as it is run."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import fresh_python
import numpy as np
import pytest

from bench import same
from bench.__main__ import main
from bench.same_arrays import compare, compare_files, difference

HERE = "float64/rgb/own"


# ------------------------------------------------------------------------------------------------------------- arrays
def test_differences_are_relative_to_the_largest_number_before():
    before = np.array([4.0, -8.0, np.inf, np.nan])
    assert difference(before.copy(), before, 0.0) == 0
    now = before + np.array([1e-9, 0, 0, 0])
    assert difference(now, before, 0.0) == pytest.approx(1e-9 / 8, rel=1e-6)
    assert difference(now, before, 100.0) == pytest.approx(1e-11, rel=1e-6)
    assert difference(np.array([4.0, -8, np.inf, 0]), before, 0.0) == np.inf
    assert difference(np.array([4.0, -8, -np.inf, np.nan]), before, 0.0) == np.inf
    assert difference(np.array([np.nan, -8, np.inf, np.nan]), before, 0.0) == np.inf
    assert difference(np.array([1e-30]), np.array([0.0]), 0.0) == np.inf
    assert difference(before[:3], before, 0.0) == difference(before.astype("f4"), before, 0.0) == np.inf
    assert difference(np.array([1, 2]), np.array([1, 3]), 1e9) == np.inf  # identifiers


def test_rounding_that_is_left_of_a_sum_counts_by_the_size_of_the_others():
    """A gradient that cancels to 1e-17 beside one of 1; of a call of its own it counts by itself."""
    names = [f"{HERE}/reverse all/a", f"{HERE}/reverse all/b", f"{HERE}/reverse values/b"]
    before = dict(zip(names, (np.array([1.0]), np.array([1e-17]), np.array([1e-17]))))
    now = dict(zip(names, (np.array([1.0]), np.array([3e-17]), np.array([3e-17]))))
    found = compare(now, before, {}, {})
    assert [found.sizes[name] for name in names] == pytest.approx([0, 2e-15, 2])
    assert found.worst("float64", "reverse") == (found.sizes[names[2]], names[2])
    assert found.worst("float64", "forward") is None and found.worst("float32", "reverse") is None


def test_single_precision_has_the_distance_to_double_as_a_measure():
    names = ["float32/rgb/own/reverse all/a", "float64/rgb/own/reverse all/a"]
    before = dict(zip(names, (np.array([1.001], "f4"), np.array([1.0]))))
    for size, beyond in ((2e-4, False), (2e-3, True)):
        now = {names[0]: (before[names[0]] + np.float32(size)).astype("f4"), names[1]: before[names[1]]}
        found = compare(now, before, {}, {})
        assert found.rounding == {names[0]: pytest.approx(1e-3, rel=1e-2)}
        assert same.report({"scene": found}, {"float32": 1e-5, "float64": 1e-12}) is not beyond


def test_what_is_refused_in_one_state_alone_is_a_difference():
    a, b = f"{HERE}/reverse all/ball.a", f"{HERE}/reverse all/ball.b"
    both = {a: np.ones(2), b: np.ones(2)}
    refusal = {f"{HERE}/parameter/ball.b": "NotDifferentiableError: no"}
    for now, before, said, said_before in ((both, {a: both[a]}, {}, refusal), ({a: both[a]}, both, refusal, {})):
        found = compare(now, before, said, said_before)
        assert len(found.refused) == 1 and "ball.b" in found.refused[0]
        assert not found.only_here and not found.only_before and found.sizes == {a: 0}
    calls = {f"{HERE}/reverse all": "RuntimeError: no"}
    assert len(compare(both, {}, {}, calls).refused) == 1
    image = {f"{HERE}/image": "ValueError: no"}
    assert len(compare({f"{HERE}/image/rgb": np.ones(2), **both}, {}, {}, image).refused) == 1


def test_words_of_refusals():
    key = f"{HERE}/parameter/ball.b"
    texts = ["ValueError: first", "ValueError: second", "NotDifferentiableError: second"]
    assert compare({}, {}, {key: texts[0]}, {key: texts[0]}) == compare({}, {}, {}, {})
    found = compare({}, {}, {key: texts[0]}, {key: texts[1]})
    assert len(found.reworded) == 1 and not found.refused
    found = compare({}, {}, {key: texts[1]}, {key: texts[2]})
    assert len(found.refused) == 1 and not found.reworded


def test_what_one_state_does_not_know_is_no_difference():
    old, new = f"{HERE}/outputs/depth", f"{HERE}/outputs/new"
    found = compare({old: np.ones(1), new: np.ones(1)}, {old: np.ones(1)}, {f"{HERE}/parameter/ball.new": "x"}, {})
    assert found.only_here == [f"{HERE}/parameter/ball.new", new] and not found.refused and not found.only_before


def test_scenes_that_one_state_does_not_load(tmp_path):
    files = [str(tmp_path / f"{i}.npz") for i in range(3)]
    for file, said in zip(files, ({}, {"scene": "ValueError: no model"}, {"scene": "ValueError: no such model"})):
        arrays = {} if said else {f"{HERE}/image/rgb": np.ones(3)}
        np.savez(file, said=np.array(json.dumps(said)), **arrays)
    assert compare_files(files[0], files[0]).sizes == {f"{HERE}/image/rgb": 0}
    assert len(compare_files(files[0], files[1]).only_here) == len(compare_files(files[1], files[0]).only_before) == 1
    assert len(compare_files(files[1], files[2]).reworded) == 1


# -------------------------------------------------------------------------------------------------------- the program
def program(tmp_path: Path, changes: dict[str, str]) -> str:
    """An interpreter whose program of the comparison is another one."""
    script, python = tmp_path / "changed.py", tmp_path / "python"
    script.write_text(
        "import sys\n"
        "sys.argv = sys.argv[1:]\n"
        "sys.path[0] = ''\n"
        "text = open(sys.argv[0]).read()\n"
        f"for old, new in {changes!r}.items():\n"
        "    assert old in text\n"
        "    text = text.replace(old, new)\n"
        "exec(compile(text, sys.argv[0], 'exec'), {'__name__': '__main__', '__file__': sys.argv[0]})\n"
    )
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{script}" "$@"\n')
    python.chmod(0o755)
    return str(python)


QUICK = ["same", "--quick", "--only", "small/", "--dtype", "float64"]


def test_a_state_is_equal_to_itself(capsys):
    assert main([*QUICK, "--peer", f"torchrender={sys.executable}"]) == 0
    printed = capsys.readouterr().out
    assert "| small/ball_and_wall | = | = | = | = |  |" in printed
    assert "\n1 scenes, " in printed and "bit-equal: 1 scenes" in printed and printed.endswith("\nalike\n")


def test_other_numbers_and_refusals_are_found_and_named(tmp_path, capsys):
    changes = {"SPP, SEED = 4, 5": "SPP, SEED = 4, 6"}
    changes["scene.train_only(name)"] = "scene.train_only(name if name != 'ball.radius' else 'sensor.near_clip')"
    assert main([*QUICK, "--peer", f"torchrender={program(tmp_path, changes)}"]) == 1
    printed = capsys.readouterr().out
    beyond = printed.partition("\nBeyond the limits:\n")[2].splitlines()
    assert "small/ball_and_wall: float64/rgb/own/" in beyond[0] and float(beyond[0].split()[0]) > 0.01
    assert "Refused in one state alone" in printed and "own/parameter/ball.radius, before: NotDiff" in printed
    assert "| 1 refused |" in printed and printed.endswith("\nnot alike\n")


def stub(tmp_path: Path, text: str) -> str:
    """An interpreter that does one thing whatever it is asked."""
    python = tmp_path / "stub"
    python.write_text(f"#!/bin/sh\n{text}\n")
    python.chmod(0o755)
    return str(python)


def test_a_program_that_ends_early_is_reported(tmp_path):
    python = stub(tmp_path, "echo last >&2; exit 3")
    with pytest.raises(SystemExit, match=r"(?s)stub ended with status 3:\nlast"):
        main([*QUICK, "--peer", f"torchrender={python}"])
    with pytest.raises(SystemExit, match="--peer: /no/such/python: No such file"):
        main([*QUICK, "--peer", "torchrender=/no/such/python"])


def test_scenes_that_are_not_found_fail(tmp_path, monkeypatch, capsys):
    """Neither state has any; the table of some is lost."""
    python = stub(tmp_path, """echo '{"version": "0.0", "scenes": [], "lost": ["small_scene: no"]}'""")
    monkeypatch.setattr(sys, "executable", python)
    with pytest.raises(SystemExit) as ended:
        main(["same", "--only", "small/no", "--peer", f"torchrender={python}"])
    assert ended.value.code == 2
    assert "--only: no scene's name contains 'small/no'; not found: small_scene: no" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "--peer: expected torchrender=PYTHON, once"),
        (["--peer", "mitsuba=python"], "--peer: expected torchrender=PYTHON, once"),
        (["--dtype", "float16"], "invalid choice: 'float16'"),
    ],
)
def test_wrong_arguments(arguments, message, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["same", *arguments])
    assert ended.value.code == 2 and message in capsys.readouterr().err


def test_all_scenes_of_the_tests_are_found():
    options = {"folder": "", "tests": str(same.ROOT / "tests"), "dtypes": [], "only": "no such", "quick": True}
    done = fresh_python.interpreter([sys.executable, str(same.PROGRAM), json.dumps(options)])
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["lost"] == []


# --------------------------------------------------------------------------------------------------- modules of tests
MODULES = {
    "unit/deep/first_scenes.py": "from second_scenes import A\nfrom package.third import B\nSCENES = {'a': A + B}\n",
    "models/second_scenes.py": "A = 1\n",
    "models/package/__init__.py": "",
    "models/package/third.py": "from .fourth import C as B\n",
    "models/package/fourth.py": "C = 2\n",
    "test_older.py": '''"""Its imports fail, and what it makes of them is not needed."""
from __future__ import annotations
import no_such_module.inside
import torchrender.no_such_module as other
from torchrender import no_such_name, Transform
from first_scenes import SCENES

class Derived(other.Base):
    pass

@other.mark.parametrize("x", [*no_such_name])
def test_nothing(x):
    assert no_such_module.inside.thing()

TABLE = {**SCENES, "place": Transform.scale(2.0)}
''',
}


def test_modules_of_tests_are_found_and_may_import_what_is_not_there(tmp_path):
    for name, text in MODULES.items():
        file = tmp_path / "tests" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    code = (
        "from pathlib import Path\nfrom bench.from_tests import use\n"
        f"use(Path({str(tmp_path / 'tests')!r}))\n"
        "from test_older import TABLE\n"
        "assert TABLE['a'] == 3 and TABLE['place'].matrix[0, 0] == 2, TABLE\n"
        "try:\n    import no_such_module\nexcept ImportError:\n    print('fine')\n"
    )
    done = fresh_python.run(code)
    assert (done.stdout, done.returncode) == ("fine\n", 0), done.stderr
