"""Kernels ahead of time, with a compiler that is none: which are compiled, where they lie, and what is said."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import small_scene
import torch

import torchrender as tr
from torchrender import devices
from torchrender.cuda.__main__ import main
from torchrender.cuda.compile import compile_kernels

# Its machine code is the options that it was given.
FAKE = """
#include <cstring>
#include <string>
struct ProgramObject { std::string made; bool ptx = false; };
using Program = ProgramObject *;
extern "C" {
int nvrtcVersion(int *major, int *minor) { return *major = 12, *minor = 8, 0; }
int nvrtcCreateProgram(Program *p, const char *source, const char *, int, const char **, const char **) {
    return *p = new ProgramObject{source}, 0;
}
int nvrtcCompileProgram(Program p, int n, const char **options) {
    for (int i = 0; i < n; ++i) {
        if (!std::strcmp(options[i], "-arch=sm_7")) return 5;
        p->ptx |= !std::strncmp(options[i], "-arch=compute_", 14);
        p->made += std::string("\\n") + options[i];
    }
    return 0;
}
int nvrtcGetProgramLogSize(Program, size_t *size) { return *size = 1, 0; }
int nvrtcGetProgramLog(Program, char *) { return 0; }
int nvrtcGetCUBINSize(Program p, size_t *size) { return *size = p->ptx ? 0 : p->made.size(), 0; }
int nvrtcGetPTXSize(Program p, size_t *size) { return *size = p->made.size(), 0; }
int nvrtcGetPTX(Program p, char *to) { return std::memcpy(to, p->made.data(), p->made.size()), 0; }
int nvrtcGetCUBIN(Program p, char *to) { return std::memcpy(to, p->made.data(), p->made.size()), 0; }
int nvrtcDestroyProgram(Program *p) { return delete *p, 0; }
}
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    compiler = shutil.which("c++")
    if compiler is None:
        pytest.skip("there is no compiler, which makes that of this test")
    folder = tmp_path_factory.mktemp("nvrtc")
    (folder / "fake.cpp").write_text(FAKE)
    made = folder / "compiler.so"  # a process that has an NVRTC uses that
    subprocess.run([compiler, "-shared", "-fPIC", "-o", made, folder / "fake.cpp"], check=True, timeout=60)
    return made


@pytest.fixture
def nvrtc(library, monkeypatch):
    monkeypatch.setattr(devices, "_with_compiler", set())
    monkeypatch.delenv("TORCHRENDER_KERNELS", raising=False)
    monkeypatch.setenv("TORCHRENDER_NVRTC", str(library))
    return monkeypatch


def kernels(folder) -> dict[str, set[str]]:
    """By kernel the definitions of all scenes that it was compiled for."""
    found: dict[str, set[str]] = {}
    for path in folder.glob("*.cubin"):
        lines = path.read_bytes()[64:].decode().splitlines()  # a hash is in front
        name = next(line.split("sizeof(")[1].split(")")[0] for line in lines if line.startswith("static_assert"))
        name = name.removeprefix("tr::").removesuffix("<float>")
        found.setdefault(name, set()).update(x for x in lines if x.startswith(("-DTR", "-arch")))
    return found


def test_everything_that_a_scene_launches_is_compiled(nvrtc, tmp_path):
    scene = tr.load_dict(small_scene.ball_and_wall())
    scene.train_only("*.reflectance.value")
    trained = [name for name, p in scene.named_parameters() if p.requires_grad]
    first = compile_kernels(scene, 90, tmp_path, edges=False)
    assert first == len(list(tmp_path.iterdir())) > 20
    found = kernels(tmp_path)
    assert {"ShadeHits", "SweepVertices", "TracePaths", "TraceShadows", "AddToFilm", "IntersectRays"} <= set(found)
    assert "-arch=sm_90" in found["ShadeHits"]
    assert {"-DTR_MOTION=0", "-DTR_MOTION=1"} <= found["SweepVertices"]
    assert "-DTR_FORWARD=1" not in found["SweepVertices"] and "-DTR_FIXED_SUMS=1" not in found["SweepVertices"]
    assert compile_kernels(scene, 90, tmp_path, edges=False) == 0
    assert compile_kernels(scene, 90, tmp_path, forward=True, deterministic=True, edges=False) > 0
    assert {"-DTR_FORWARD=1", "-DTR_FIXED_SUMS=1"} <= kernels(tmp_path)["SweepVertices"]
    assert compile_kernels(scene, 90, tmp_path, outputs=True, edges=False) > 0
    more = {"EvaluateOutputs", "SweepOutputs", "AddOutputsToFilm", "CollectOutputs", "StartCentres"}
    assert more <= set(kernels(tmp_path))
    of_edges = {"FindSights", "FindEdges", "ChooseOutlines", "SweepPlaces"}
    assert not of_edges & set(kernels(tmp_path))
    assert compile_kernels(scene, 90, tmp_path) > 10
    assert of_edges <= set(kernels(tmp_path))
    double = tr.load_dict(small_scene.ball_and_wall(), dtype=torch.float64)
    compile_kernels(double, 90, tmp_path / "double", edges=False)
    assert {"ShadeHits<double>", "TracePaths<double>", "AddToFilm<double>"} <= set(kernels(tmp_path / "double"))
    assert compile_kernels(scene, 80, tmp_path / "others", edges=False) == first
    assert compile_kernels(scene, 90, tmp_path / "again", edges=False) == first  # another folder has its own
    assert [name for name, p in scene.named_parameters() if p.requires_grad] == trained
    assert not torch.are_deterministic_algorithms_enabled()
    assert float(tr.render(scene, spp=1).mean()) > 0  # on the CPU again


def test_kernels_that_are_there_need_no_compiler(nvrtc, tmp_path):
    scene = tr.load_dict(small_scene.ball_and_wall())
    compile_kernels(scene, 90, tmp_path, edges=False)
    nvrtc.setenv("TORCHRENDER_NVRTC", "/nowhere/libnvrtc.so")
    nvrtc.setenv("TORCHRENDER_KERNELS", str(tmp_path))
    with devices.chosen("sm_90"):
        tr.render(scene, spp=1)
    nvrtc.setenv("TORCHRENDER_CACHE", str(tmp_path / "cache"))
    with devices.chosen("sm_80"):
        for _ in range(2):
            with pytest.raises(RuntimeError, match=r"no NVRTC to compile tr::\w+(<float>)? with, for sm_80"):
                tr.render(scene, spp=1)
    nvrtc.setenv("TORCHRENDER_KERNELS", f"{tmp_path}:/nowhere")
    nvrtc.setattr(devices, "_with_compiler", set())
    with devices.chosen("sm_90"), pytest.raises(ValueError, match="TORCHRENDER_KERNELS: there is no folder /nowhere"):
        tr.render(scene, spp=1)


@pytest.mark.parametrize("integrator", ["path", "ptracer", "volpath"])
def test_kernels_of_edges_that_are_there_need_no_compiler(nvrtc, tmp_path, integrator):
    """Also of few edges and of many, which look first how much each part brings."""
    given = small_scene.ball_and_wall(integrator={"type": integrator, "max_depth": 4})
    given["sensor"]["film"]["rfilter"] = {"type": "gaussian"}
    scene = tr.load_dict(given)
    compile_kernels(scene, 90, tmp_path, outputs=integrator != "ptracer", forward=True)
    nvrtc.setenv("TORCHRENDER_NVRTC", "/nowhere/libnvrtc.so")
    nvrtc.setenv("TORCHRENDER_KERNELS", str(tmp_path))
    nvrtc.setenv("TORCHRENDER_CACHE", str(tmp_path / "cache"))
    nvrtc.setattr(devices, "_with_compiler", set())
    scene.train_only("ball.to_world")
    outputs = ("rgb",) if integrator == "ptracer" else ("rgb", "depth")
    matrix = scene.get_parameter("ball.to_world").detach()

    def shown(matrix: torch.Tensor, samples: int) -> torch.Tensor:
        settings = {"params": {"ball.to_world": matrix}, "outputs": outputs, "spp": 1, "spp_grad": samples}
        return torch.stack([x.sum() for x in tr.render(scene, **settings)])

    with devices.chosen("sm_90"):
        for samples in (1, 4096):
            torch.func.vjp(lambda m, n=samples: shown(m, n), matrix)[1](torch.ones(len(outputs)))
            torch.func.jvp(lambda m, n=samples: shown(m, n), (matrix,), (matrix,))
        assert {"visibility"} <= set(scene.statistics)
    if integrator == "path":
        assert {"TakeOutlines", "WeighSights", "WeighEdges", "WeighOutlines"} <= set(kernels(tmp_path))


def test_cards_without_kernels_of_their_own_take_ptx_of_older_ones(nvrtc, tmp_path):
    scene = tr.load_dict(small_scene.ball_and_wall())
    assert compile_kernels(scene, 80, tmp_path, ptx=True, edges=False) > 10
    assert "-arch=compute_80" in kernels(tmp_path)["ShadeHits"]
    nvrtc.setenv("TORCHRENDER_NVRTC", "/nowhere/libnvrtc.so")
    nvrtc.setenv("TORCHRENDER_KERNELS", str(tmp_path))
    nvrtc.setenv("TORCHRENDER_CACHE", str(tmp_path / "cache"))
    for place in ("sm_80", "sm_120"):
        with devices.chosen(place):
            tr.render(scene, spp=1)
    with (
        devices.chosen("sm_75"),
        pytest.raises(RuntimeError, match=r"no NVRTC to compile tr::\w+(<float>)? with, for sm_75"),
    ):
        tr.render(scene, spp=1)


def test_kernels_of_the_package(nvrtc, tmp_path):
    packs = tmp_path / "_packs"
    nvrtc.setattr(devices, "PACKS", packs)
    assert devices.compiled_before() == []
    scene = tr.load_dict(small_scene.ball_and_wall())
    compile_kernels(scene, 90, packs, edges=False)
    nvrtc.setenv("TORCHRENDER_NVRTC", "/nowhere/libnvrtc.so")
    nvrtc.setenv("TORCHRENDER_CACHE", str(tmp_path / "cache"))
    with devices.chosen("sm_90"):
        tr.render(scene, spp=1)
    assert f"without it there are the kernels in {packs} alone" in tr.backends.devices()["cuda"]


def test_an_installation_has_kernels_where_it_is_asked_to(nvrtc, tmp_path):
    """As setup.py has them compiled: by the package in another folder."""
    root = Path(tr.__file__).resolve().parent.parent
    package = tmp_path / "torchrender"
    shutil.copytree(root / "torchrender", package, ignore=shutil.ignore_patterns("__pycache__", "_packs"))
    shutil.copytree(root / "csrc" / "core", package / "_kernels" / "core")
    shutil.copytree(root / "csrc" / "device", package / "_kernels" / "device")

    def run(given: str) -> subprocess.CompletedProcess:
        code = "import pathlib, runpy, sys\nsys.argv = ['setup.py', '-q', '--version']\n"
        code += f"of = runpy.run_path('setup.py')\nof['compile_kernels'](pathlib.Path({str(package)!r}))"
        return subprocess.run(
            [sys.executable, "-c", code],
            cwd=root,
            env={**os.environ, "TORCHRENDER_CUDA": given},
            capture_output=True,
            text=True,
            timeout=300,
        )

    done = run("90")
    assert done.returncode == 0, done.stderr
    found = kernels(package / "_packs")["ShadeHits"]
    assert {"-arch=sm_90", "-arch=compute_90"} <= found
    assert not any("-arch=sm_80" in options for options in found)
    wrong = run("hopper")
    assert wrong.returncode != 0 and "TORCHRENDER_CUDA is hopper; expected 1 or capabilities" in wrong.stderr
    failing = run("7")
    assert failing.returncode != 0 and "TORCHRENDER_CUDA: kernels cannot be compiled" in failing.stderr


def test_the_command(nvrtc, tmp_path, capsys):
    scene = tmp_path / "scene.xml"
    tr.load_dict(small_scene.ball_and_wall()).save(scene)

    def run(*arguments: str) -> tuple[int, str, str]:
        nvrtc.setattr(sys, "argv", ["torchrender.cuda", "compile", *arguments])
        code = main()
        return code, *capsys.readouterr()

    into = tmp_path / "kernels"
    code, out, _ = run(str(scene), "--for", "80", "90", "--into", str(into))
    lines = out.splitlines()
    assert code == 0 and len(lines) == 2 and lines[1].startswith(f"{scene}, sm_90: {lines[0].split()[2]} new kernels, ")
    assert run(str(scene), "--for", "90", "--double", "--into", str(tmp_path / "double"))[0] == 0
    assert "ShadeHits<double>" in kernels(tmp_path / "double")
    code, _, error = run(str(scene), "--for", "7", "--into", str(into))
    assert code == 1 and error.startswith(f"{scene}, sm_7: NVRTC 12.8 cannot compile a kernel")
    code, _, error = run(str(tmp_path / "none.xml"), "--for", "90", "--into", str(into))
    assert code == 1 and "none.xml" in error
    nvrtc.setenv("TORCHRENDER_NVRTC", "/nowhere/libnvrtc.so")
    nvrtc.setattr(devices, "_with_compiler", set())
    code, _, error = run(str(scene), "--for", "90", "--into", str(into))
    assert code == 1 and "/nowhere/libnvrtc.so cannot be loaded" in error
