"""What the benchmark `build` reads from Ninja's log."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench import build, compare
from bench.__main__ import main

SECOND = 10**9
DAY = 1_700_000_000  # when the first run of the log began


def write(folder: Path, entries: list[tuple[float, float, int, str]], version: int = 7, script: bool = True) -> None:
    """A log of entries (start, end, when the run began, target), and the script of what is still built."""
    lines = [f"# ninja log v{version}"]
    for start, end, run, target in entries:
        clock = round((run + start) * SECOND) if version >= 6 else 0
        lines.append(f"{1000 * start:.0f}\t{1000 * end:.0f}\t{clock}\t{folder / target}\t0123456789abcdef")
    (folder / ".ninja_log").write_text("\n".join(lines) + "\n")
    if script:
        named = {target for *_, target in entries if "gone" not in target}
        text = "".join(f"build {folder / target}: compile /src/{target}\n  what = x\n" for target in sorted(named))
        (folder / "build.ninja").write_text(text)


ENTRIES = [
    (0.0, 2.0, DAY, "v2/cpu/a.o"),
    (0.0, 9.0, DAY, "v2/gone.o"),
    (0.0, 6.0, DAY, "avx2/cpu/a.o"),
    (2.0, 7.0, DAY, "avx2/host/b.o"),
    (7.0, 7.5, DAY, "_core_avx2.cpython.so"),
    (0.5, 4.5, DAY + 60, "avx2/cpu/a.o"),  # compiled again, a minute later
    (4.5, 5.0, DAY + 60, "_core_avx2.cpython.so"),
]


def run(folder: Path, *arguments: str) -> dict:
    file = folder / "result.json"
    assert main(["build", "--directory", str(folder), *arguments, "--json", str(file)]) == 0
    return json.loads(file.read_text())


@pytest.mark.parametrize("version", [5, 7])
def test_seconds_of_files_modules_and_the_newest_run(tmp_path, capsys, version):
    write(tmp_path, ENTRIES, version)
    (tmp_path / "_core_avx2.cpython.so").write_bytes(bytes(3 * 2**20))
    files, modules, newest = (table["rows"] for table in run(tmp_path)["tables"])
    assert [(row["file"], row["avx2 s"], row["v2 s"], row["sum s"]["median"]) for row in files] == [
        ("cpu/a", 4, 2, 6),
        ("host/b", 5, None, 5),
    ]
    assert sum(row["%"] for row in files) == pytest.approx(100)
    by_name = {row["module"]: row for row in modules}
    assert list(by_name) == ["avx2", "v2", "all"]
    assert (by_name["avx2"]["objects"], by_name["avx2"]["compile s"]["median"], by_name["avx2"]["link s"]) == (
        2,
        9,
        0.5,
    )
    assert by_name["avx2"]["size MiB"]["median"] == 3 and by_name["v2"]["size MiB"] is None
    assert (by_name["all"]["objects"], by_name["all"]["compile s"]["median"]) == (3, 11)
    (row,) = newest
    assert (row["made"], row["seconds of all s"], row["wall s"]["median"], row["at once"]) == (2, 4.5, 4.5, 1)
    printed = capsys.readouterr().out
    assert "\nsum: 3 objects, 11 processor seconds, 3.0 MiB linked; newest run: 2 files in 4 s\n" in printed


def test_paths_with_blanks_and_colons_are_those_of_the_log(tmp_path):
    folder = tmp_path / "a b"
    folder.mkdir()
    write(folder, [(0.0, 2.0, DAY, "v2/cpu/a.o")])
    script = folder / "build.ninja"
    script.write_text(script.read_text().replace("a b", "a$ b"))
    assert run(folder)["tables"][0]["rows"][0]["file"] == "cpu/a"


def test_a_folder_without_a_script_counts_everything(tmp_path):
    write(tmp_path, ENTRIES, script=False)
    files = run(tmp_path, "--only", "GONE")["tables"][0]["rows"]
    assert [(row["file"], row["sum s"]["median"]) for row in files] == [("gone", 9)]


def test_builds_are_compared(tmp_path):
    write(tmp_path, ENTRIES)
    before = run(tmp_path)
    write(tmp_path, [*ENTRIES, (0.0, 8.0, DAY + 99, "avx2/host/b.o")])
    worse = {row["row"] for row in compare.compare(before, run(tmp_path), 0.05) if row["verdict"] == "worse"}
    assert worse == {"files, host/b", "modules, avx2", "modules, all", "run, newest"}


def test_folders_without_a_build_are_refused(tmp_path):
    with pytest.raises(SystemExit, match=r"expected a folder with Ninja's log, got .*; make build makes it"):
        main(["build", "--directory", str(tmp_path)])
    (tmp_path / ".ninja_log").write_text("# ninja log v7\n")
    with pytest.raises(SystemExit, match="--directory: expected a folder that something was compiled in"):
        main(["build", "--directory", str(tmp_path)])


def test_linked_files_belong_to_their_module():
    names = ("_core_v2.cpython-311.so", "native_tests_v2", "v2/host/a.o", "v2/precompiled.h.gch")
    edges = [build.Edge(name, 0, 1, 0) for name in names]
    assert {edge.module for edge in edges} == {"v2"}
    assert [edge.is_object for edge in edges] == [False, False, True, True]
    assert [edge.file for edge in edges[2:]] == ["host/a", "precompiled.h"]
