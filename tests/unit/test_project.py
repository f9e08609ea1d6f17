"""The project around the code: what importing costs and prints, what the native modules export, who includes whom."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import fresh_python
import pytest
from packaging.requirements import Requirement
from packaging.version import Version

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

CORNELL = """
scene = tr.load_dict({
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 4},
    "camera": {"type": "perspective", "fov": 40.0, "film": {"type": "hdrfilm", "width": 32, "height": 32},
               "to_world": tr.Transform.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])},
    "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}},
    "ball": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.3, 0.1]}}},
})
parameter, = scene.train_only("ball.bsdf.reflectance.value")
image = tr.render(scene, spp=16, seed=1)
image.mean().backward()
assert parameter.grad.abs().sum() > 0
"""


VARIABLES = {k: v for k, v in os.environ.items() if not k.startswith("TORCHRENDER_")}


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``code`` in a fresh interpreter in the repository's root."""
    variables = VARIABLES | environment
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=variables, capture_output=True, text=True)


def checked(code: str) -> str:
    """What ``code`` prints that comes after ``import torch``, as it does in ``import torchrender``."""
    done = fresh_python.run(code, VARIABLES)
    assert done.returncode == 0, done.stderr
    return done.stdout


# --- importing -------------------------------------------------------------------------------------------------------


def test_import_adds_at_most_half_a_second() -> None:
    # of the processor, so that other programs do not count
    code = "import torch, time; t = time.process_time(); import torchrender; print(time.process_time() - t)"
    assert any(float(checked(code)) <= 0.5 for _ in range(3))


def test_import_leaves_heavy_packages_alone() -> None:
    code = "import sys, torch; before = set(sys.modules); import torchrender; print(*sorted(set(sys.modules) - before))"
    added = {name.partition(".")[0] for name in checked(code).split()}
    heavy = {"trimesh", "kornia", "matplotlib", "OpenEXR", "imageio", "PIL", "scipy", "embreex", "drjit", "mitsuba"}
    assert not added & heavy


@pytest.mark.parametrize("order", ["torch, torchrender", "torchrender, torch", "numpy, torchrender"])
def test_import_is_silent_in_any_order(order: str) -> None:
    done = python(f"import {order}", PYTHONWARNINGS="error::DeprecationWarning:torchrender")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("first", ["torch", "trimesh", "embreex.rtcore_scene", "kornia", "OpenEXR"])
def test_render_works_after_importing_others_first(first: str) -> None:
    # Other owners of Embree, TBB or OpenMP in the process must not disturb, whichever comes first.
    code = f"import {first}\nimport torch, torchrender as tr\n{CORNELL}\nprint(image.mean().item() > 0)"
    done = fresh_python.run(code, VARIABLES) if first == "torch" else python(code)
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr


@pytest.mark.parametrize("later", ["trimesh", "embreex.rtcore_scene", "kornia"])
def test_others_work_after_rendering(later: str) -> None:
    assert checked(f"import torchrender as tr\n{CORNELL}\nimport {later}\nprint('fine')") == "fine\n"


def test_rendering_prints_nothing() -> None:
    done = fresh_python.run(f"import torchrender as tr\n{CORNELL}", VARIABLES)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_first_gradient_comes_within_a_second() -> None:
    code = f"import time, torch, torchrender as tr; t = time.perf_counter()\n{CORNELL}\nprint(time.perf_counter() - t)"
    assert any(float(checked(code)) <= 1.0 for _ in range(3))


def test_rendering_in_a_forked_process() -> None:
    # The workers of a torch DataLoader are forked from a process that has rendered already.
    code = f"""
import os, torchrender as tr
{CORNELL}
child = os.fork()
if child == 0:
    again = tr.render(scene, spp=16, seed=1)
    os._exit(0 if (again == image).all() else 1)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    assert checked(code) == "0\n"


# --- native modules --------------------------------------------------------------------------------------------------

MODULES = sorted((ROOT / "torchrender").glob("_core_*.so"))


def test_native_modules_are_there() -> None:
    assert MODULES


@pytest.mark.skipif(sys.platform != "linux" or not shutil.which("nm"), reason="needs nm and ELF files")
@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.name.partition(".")[0])
def test_native_module_exports_its_interface_only(module: Path) -> None:
    # A visible template instance could be merged with one that was compiled for another processor.
    listed = subprocess.run(["nm", "-D", "--defined-only", module], capture_output=True, text=True, check=True).stdout
    assert {line.split()[-1] for line in listed.splitlines()} == {"tr_call", "tr_free", "tr_release"}


@pytest.mark.skipif(sys.platform != "linux" or not shutil.which("readelf"), reason="needs readelf and ELF files")
@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.name.partition(".")[0])
def test_native_module_links_against_system_libraries_only(module: Path) -> None:
    listed = subprocess.run(["readelf", "-d", module], capture_output=True, text=True, check=True).stdout
    needed = re.findall(r"\(NEEDED\).*\[(.*?)\]", listed)
    system = ("libstdc++", "libc++", "libm.", "libgcc_s", "libc.", "libdl.", "libpthread.", "ld-linux")
    assert needed and all(name.startswith(system) for name in needed)


def include_lines(folder: str) -> list[tuple[Path, str]]:
    files = [p for p in (ROOT / "csrc" / folder).rglob("*") if p.suffix in (".h", ".cpp", ".cu", ".cuh")]
    assert files
    return [(p, m) for p in files for m in re.findall(r'#\s*include\s*[<"]([^>"]+)[>"]', p.read_text())]


def test_core_includes_no_torch_python_embree_or_cuda_header() -> None:
    foreign = re.compile(r"torch|ATen|c10|Python\.h|embree|rtcore|cuda|thrust|omp\.h", re.IGNORECASE)
    assert not [(p.name, name) for p, name in include_lines("core") if foreign.search(name)]


def test_bindings_include_no_header_of_python() -> None:
    assert not [(p.name, name) for p, name in include_lines("bindings") if re.search(r"Python|pybind11|nanobind", name)]


@pytest.mark.parametrize(
    ("ring", "outer"),
    [
        ("core", ["accel", "device", "host", "cpu", "cuda", "bindings"]),
        ("accel", ["device", "cpu", "bindings"]),
        ("device", ["cpu", "bindings"]),
        ("cpu", ["bindings"]),
    ],
)
def test_includes_point_inward(ring: str, outer: list[str]) -> None:
    outside = tuple(f"{name}/" for name in outer)
    clean = [(p.name, re.sub(r"^(\.\./)+", "", name)) for p, name in include_lines(ring)]
    assert not [(file, name) for file, name in clean if name.startswith(outside)]


# --- building --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({"CXX": "no-such-compiler"}, ["no C++ compiler", "no-such-compiler", "apt install g++"]),
        ({"CXX": "false"}, ["cannot compile C++17", "false"]),
        ({"TORCHRENDER_BUILD_ISA": "sse9"}, ["TORCHRENDER_BUILD_ISA", "sse9"]),
    ],
)
def test_what_a_build_lacks_is_said_in_one_sentence(environment: dict[str, str], words: list[str]) -> None:
    pytest.importorskip("setuptools")
    done = subprocess.run(
        [sys.executable, "setup.py", "-q", "check_tools"],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
    )
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    assert done.returncode != 0 and len(lines) == 1 and lines[0].startswith("torchrender: ")
    assert all(word in lines[0] for word in words)


def test_pinned_versions_lie_in_the_declared_ranges() -> None:
    pins: dict[str, list[Version]] = {}
    for line in (ROOT / "constraints.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            pin = Requirement(line)
            assert [s.operator for s in pin.specifier] == ["=="], line
            pins.setdefault(pin.name.lower(), []).append(Version(next(iter(pin.specifier)).version))
    extras = [r for group in PROJECT["optional-dependencies"].values() for r in group]
    for declared in map(Requirement, PROJECT["dependencies"] + extras):
        if declared.name in ("torch", PROJECT["name"]):
            continue  # pinned by the Makefile; the project itself
        assert pins[declared.name.lower()], f"{declared} has no pin"
        assert all(declared.specifier.contains(version) for version in pins[declared.name.lower()]), declared


def test_version_is_the_same_everywhere() -> None:
    assert checked("import torchrender; print(torchrender.__version__)").strip() == PROJECT["version"]
    assert f"## {PROJECT['version']}" in (ROOT / "CHANGELOG.md").read_text()
