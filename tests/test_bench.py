"""The benchmark program: its tables, its arguments, and how it does without the program that it compares with."""

from __future__ import annotations

import json
import sys

import pytest

from bench import table
from bench.__main__ import main
from bench.mitsuba_peer import Peer, connect
from bench.rows import ROWS


def test_rows_name_existing_files_and_parameters():
    import torchrender as tr

    for row in ROWS:
        scene = tr.load_file(row.path, resolution=8, **row.arguments)
        for name in row.parameters:
            assert scene.get_parameter(name).ndim in (1, 3), name
    shapes = [tr.load_file(row.path, **row.arguments).get_parameter(row.parameters[0]).shape[0] for row in ROWS[1:]]
    assert shapes == [512, 1024, 512, 1024]


def test_table_says_what_was_not_measured():
    rows = [{"scene": "a", "sum s": 0.12345}, {"scene": "b", "sum s": None}]
    assert table.markdown(["scene", "sum s", "peer"], rows).splitlines() == [
        "| scene | sum s | peer |",
        "|---|---|---|",
        "| a | 0.123 | not measured |",
        "| b | not measured | not measured |",
    ]


def test_without_the_peer_it_says_how_to_get_it(monkeypatch, capsys):
    monkeypatch.delenv("MITSUBA_PYTHON", raising=False)
    assert connect(None, 1) is None
    assert "pip install mitsuba==3.9.1" in capsys.readouterr().out
    assert connect("/no/such/python", 1) is None
    assert "/no/such/python" in capsys.readouterr().out


def test_an_environment_without_mitsuba_is_reported(tmp_path):
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\nexit 3\n")
    program.chmod(0o755)
    with pytest.raises(RuntimeError, match="ended with status 3"):
        Peer(str(program), 1)


@pytest.mark.parametrize(
    "arguments",
    [["table2", "--rounds", "0"], ["table2", "--spp", "-1"], ["table3"], ["table2", "--resolution", "wide"], []],
)
def test_wrong_arguments_end_before_any_work(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert "error" in capsys.readouterr().err


def test_small_table(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("MITSUBA_PYTHON", raising=False)
    file = tmp_path / "table.json"
    options = ["--resolution", "32", "--spp", "2", "--rounds", "2", "--warmup", "1", "--only", "Cornell"]
    main(["table2", *options, "--threads", "1", "--json", str(file)])
    result = json.loads(file.read_text())
    (row,) = result["rows"]
    assert row["scene"] == ROWS[0].name
    assert 0 < row["Embree alone s"] < row["sum s"] < 10
    assert "Mitsuba sum s" not in row
    assert "| Cornell box" in capsys.readouterr().out
    assert result["machine"]["python"] == ".".join(map(str, sys.version_info[:3]))


def test_small_startup(tmp_path, monkeypatch):
    monkeypatch.delenv("MITSUBA_PYTHON", raising=False)
    file = tmp_path / "startup.json"
    main(["startup", "--resolution", "32", "--spp", "2", "--only", "Cornell", "--threads", "1", "--json", str(file)])
    (row,) = json.loads(file.read_text())["rows"]
    assert 0 < row["first gradient s"] < 30
    assert 0 < row["peak MiB above torch"] < 1000


def test_small_overhead(tmp_path):
    file = tmp_path / "overhead.json"
    main(["overhead", "--rounds", "2", "--warmup", "1", "--only", "512", "--threads", "1", "--json", str(file)])
    rows = json.loads(file.read_text())["rows"]
    assert [row["scene"] for row in rows] == [ROWS[1].name, ROWS[3].name]
    for row in rows:
        assert 0 < row["forward ms"] < row["forward + backward ms"] < 100
        assert 0 < row["with a changed parameter ms"] < 100
