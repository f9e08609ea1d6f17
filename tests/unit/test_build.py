"""What building says: how much is compiled, that it goes on, and nothing where nothing is to be done."""

from __future__ import annotations

import os
import platform
import pty
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("setuptools")
pytest.importorskip("ninja")
ROOT = Path(__file__).resolve().parents[2]

# Takes a fifth of a second for a file and makes none.
COMPILER = """#!/bin/sh
while [ $# -gt 0 ]; do
    case "$1" in
        -fsyntax-only) exit 0 ;;
        -o) out="$2" ;;
        -MF) rules="$2" ;;
    esac
    shift
done
sleep 0.2
[ -z "$rules" ] || echo "$out:" > "$rules"
echo > "$out"
"""
SOURCES = ("accel/accel.cpp", "host/scene.cpp", "bindings/module.cpp")
HEADER = "precompiled.h"  # compiled first, for all of them


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project with this one's setup.py, four files to compile, and a compiler that compiles nothing."""
    for name in ("setup.py", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path / name)
    text = (tmp_path / "setup.py").read_text()
    assert "STILL = 30" in text
    (tmp_path / "setup.py").write_text(text.replace("STILL = 30", "STILL = 0.12"))
    for name in (HEADER, *SOURCES):
        (tmp_path / "csrc" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "csrc" / name).write_text("")
    (tmp_path / "torchrender").mkdir()
    (tmp_path / "torchrender" / "__init__.py").write_text("")
    (tmp_path / "compiler").write_text(COMPILER)
    (tmp_path / "compiler").chmod(0o755)
    return tmp_path


def environment(project: Path) -> dict[str, str]:
    build = {"CXX": str(project / "compiler"), "TORCHRENDER_BUILD_ISA": "scalar", "MAX_JOBS": "2", "TERM": "xterm"}
    return {**os.environ, **build}


COMMAND = [sys.executable, "setup.py", "-q", "build_ext", "--inplace"]


def built(project: Path) -> list[str]:
    """What a build writes into a pipe, in lines."""
    done = subprocess.run(COMMAND, cwd=project, env=environment(project), capture_output=True, text=True, check=True)
    assert done.stdout == ""
    return done.stderr.splitlines()


def test_progress_in_a_pipe(project):
    lines = built(project)
    assert lines[0] == "torchrender: compiling 4 files, 2 at a time"
    finished = [line for line in lines if line.startswith("[")]
    assert [line.partition("]")[0] for line in finished] == ["[1/5", "[2/5", "[3/5", "[4/5", "[5/5"]
    assert finished[0].endswith(f"compile scalar/{HEADER}")
    assert {line.partition("compile ")[2] for line in finished[1:4]} == {f"scalar/{name[:-4]}" for name in SOURCES}
    assert finished[4].startswith("[5/5] link ")
    still = [line for line in lines if line not in finished][1:]
    assert still and all(re.fullmatch(r"torchrender: still compiling, \d+ s so far", line) for line in still)
    assert list((project / "torchrender").glob("_core_scalar*"))


def test_a_second_build_says_nothing_and_a_changed_file_is_one(project):
    (project / "compiler").write_text(COMPILER.replace("sleep 0.2", ""))
    built(project)
    assert built(project) == []
    (project / "csrc" / SOURCES[0]).write_text("int changed;\n")
    assert built(project)[0] == "torchrender: compiling 1 file"
    (project / "csrc" / HEADER).write_text("int changed;\n")
    assert built(project)[0].startswith("torchrender: compiling 4 files")


def test_no_precompiled_header_for_ccache(project):
    (project / "compiler").rename(project / "ccache")
    subprocess.run(COMMAND, cwd=project, env=environment(project) | {"CXX": str(project / "ccache")}, check=True)
    assert not list(project.rglob("*.gch"))
    assert "precompiled.h" not in next((project / "build").rglob("build.ninja")).read_text()


def test_progress_in_a_terminal(project):
    """Ninja's own line, which is written over, and no others in between."""
    ours, theirs = pty.openpty()
    with subprocess.Popen(COMMAND, cwd=project, env=environment(project), stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        written = b""
        while True:
            try:
                part = os.read(ours, 4096)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            written += part
    os.close(ours)
    text = written.decode()
    assert process.returncode == 0 and text.startswith("torchrender: compiling 4 files, 2 at a time\r\n")
    assert "\r[0/5] compile scalar/" in text and "[5/5] link " in text and "still compiling" not in text


def test_a_failed_build_ends_in_a_sentence(project):
    (project / "compiler").write_text(COMPILER.replace("sleep 0.2", "echo 'this is wrong'; exit 1"))
    done = subprocess.run(COMMAND, cwd=project, env=environment(project), capture_output=True, text=True)
    assert done.returncode != 0 and "this is wrong" in done.stderr
    assert done.stderr.splitlines()[-1].startswith("torchrender: the native modules could not be compiled")


@pytest.mark.skipif(not shutil.which("make"), reason="needs make")
@pytest.mark.parametrize(
    ("goals", "steps"),
    [
        (["test"], ["1/3: virtual environment and packages", "2/3: native modules", "3/3: tests"]),
        (["demo"], ["1/3: virtual environment and packages", "2/3: native modules", "3/3: two tutorials"]),
        ([], ["1/2: virtual environment and packages", "2/2: native modules"]),
        (["lint"], []),
    ],
)
def test_steps_of_make(goals, steps, tmp_path):
    """In an environment that is made already; `true` is its Python."""
    shutil.copy(ROOT / "Makefile", tmp_path)
    for name in ("setup.py", "pyproject.toml", "constraints.txt"):
        (tmp_path / name).write_text("")
    (tmp_path / "csrc").mkdir()
    (tmp_path / "env" / "bin").mkdir(parents=True)
    for name in ("python", "clang-format"):
        (tmp_path / "env" / "bin" / name).symlink_to(shutil.which("true"))
    for name in (".created", ".tools", ".installed"):
        (tmp_path / "env" / name).write_text("")
    command = ["make", "--no-print-directory", *goals, "VENV=env", 'PYTEST_ARGS=-k "a or b"']
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if line.startswith("torchrender ")]
    assert lines == [f"torchrender {step}" for step in steps]


def settings_of_build() -> dict[str, Any]:
    """What setup.py defines, which builds nothing here."""
    settings: dict[str, Any] = {"__name__": "setup", "__file__": str(ROOT / "setup.py")}
    exec((ROOT / "setup.py").read_text().rsplit("\nsetup(", 1)[0], settings)
    return settings


@pytest.mark.parametrize(
    ("there", "used"),
    [
        ({"g++": "12"}, "g++"),
        ({"g++": "12", "clang++": "13.0.1"}, "g++"),
        ({"clang++": "13.0.1"}, "clang++"),
        ({"g++": "12", "clang++": "17.0.6"}, "clang++"),
        ({"g++": "12", "clang++": "14.0.6", "clang++-16": "16.0.6", "clang++-21": "21.1.0"}, "clang++-21"),
        ({"g++": "12", "clang++": "no headers"}, "g++"),
        ({"g++": "12", "clang++-19": "19.1.7, no headers", "clang++-18": "18.1.8"}, "clang++-18"),
        ({"g++": "12", "clang++": "cannot run"}, "g++"),
    ],
)
def test_a_recent_clang_is_used_before_gcc(there, used, tmp_path, monkeypatch):
    for name, version in there.items():
        fails = int("no headers" in version)
        shell = "/no/shell" if version == "cannot run" else "/bin/sh"
        text = f'#!{shell}\n[ "$1" != -dumpversion ] || {{ echo {version}; exit 0; }}\nexit {fails}\n'
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    find_compiler = settings_of_build()["find_compiler"]
    assert find_compiler("scalar") == [used]
    if "g++" in there:  # clang may lack the sanitizers' libraries
        assert find_compiler("scalar", sanitize=True) == find_compiler("avx512") == ["g++"]
    monkeypatch.setenv("CXX", f"{next(iter(there))} -pipe")
    assert find_compiler("scalar") == [next(iter(there)), "-pipe"]


def test_another_version_of_the_compiler_compiles_everything_again(project):
    says = 'case "$1" in\n        -dM) echo "#define __VERSION__ \\"clang 19 (1~deb)\\""; exit 0 ;;'
    text = COMPILER.replace("sleep 0.2", "").replace('case "$1" in', says)
    (project / "compiler").write_text(text)
    built(project)
    assert built(project) == []
    (project / "compiler").write_text(text.replace("clang 19", "clang 20"))
    assert built(project)[0].startswith("torchrender: compiling 4 files")


def test_clang_is_told_where_its_precompiled_header_is(project):
    """It looks for none in the folders of -I."""
    says = COMPILER.replace('case "$1" in', 'case "$1" in\n        -dM) echo "#define __clang__ 1"; exit 0 ;;')
    (project / "compiler").write_text(says)
    built(project)
    (header,) = project.rglob("*.gch")
    lines = next((project / "build").rglob("build.ninja")).read_text().splitlines()
    sources = [i for i, line in enumerate(lines) if line.startswith("build ") and ".cpp" in line]
    compiled = [next(line for line in lines[i:] if line.startswith("  flags = ")) for i in sources]
    assert len(compiled) == len(SOURCES) and all(f"-include-pch {header} " in flags for flags in compiled)


@pytest.mark.skipif(platform.system() != "Linux" or not shutil.which("objdump"), reason="needs objdump, on Linux")
def test_what_older_linux_lacks_is_known():
    """What the modules need that is newer than manylinux_2_28 has to be in csrc/portable, for wheels."""
    oldest = {"GLIBC_2": 28, "GLIBCXX_3.4": 25, "CXXABI_1.3": 11}
    known = (ROOT / "csrc" / "portable" / "older_linux.cpp").read_text()
    modules = [str(path) for path in (ROOT / "torchrender").glob("_core_*.so")]
    assert modules
    table = subprocess.run(["objdump", "-T", *modules], capture_output=True, text=True, check=True).stdout
    needed = re.findall(r"\*UND\*.*\((\w+(?:\.\d)?)\.(\d+)[.\d]*\)\s+(\w+)$", table, re.MULTILINE)
    assert len(needed) > 100
    for name in {name for library, number, name in needed if int(number) > oldest.get(library, 1000)}:
        word = re.sub(r"^_ZSt\d+(\w+)v$", r"\1", name)  # a function of the namespace std
        assert re.search(rf'[ *]{word}\(| {word} =|"{word}"', known), name


# Files that between them use what core/math says of packets in a way of its own for each instruction set.
OF_PACKETS = ("tests/test_math.cpp", "cpu/render_light.cpp", "core/integrator/surface.cpp", "accel/face_list.cpp")


@pytest.mark.skipif(platform.machine() != "x86_64", reason="other processors have one instruction set")
@pytest.mark.parametrize("isa", ["v2", "avx2", "avx512"])
def test_sources_are_valid_for_every_instruction_set(isa):
    """A machine builds for its own one; wheels have all."""
    settings = settings_of_build()
    command = [
        *settings["find_compiler"](isa),
        *settings["compile_flags"](isa, False),
        "-fsyntax-only",
        "-x",
        "c++",
        "-",
    ]
    together = "\n".join(f'#include "{source}"' for source in OF_PACKETS)  # what they include is read once
    done = subprocess.run(command, input=together, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
