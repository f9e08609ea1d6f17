"""Installs a wheel into a new virtual environment without a compiler, and uses it: import, picture, gradient, tutorial.

    python release/smoke.py dist/torch_pathtracer-0.1.0-py3-none-manylinux_2_28_x86_64.whl \
        --python python3.12 --torch torch==2.13.0

`--here` uses it in the environment of this very Python, where it is installed already.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GRADIENT = """
import time
started = time.perf_counter()
import torch, torchrender as tr
scene = tr.load_dict({
    "type": "scene",
    "camera": {"type": "perspective", "fov": 40, "to_world": tr.Transform.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0])},
    "sky": {"type": "constant"},
    "ball": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.3, 0.1]}}},
})
(colour,) = scene.train_only("ball.bsdf.reflectance.value")
image = tr.render(scene, spp=16, size=(64, 64), seed=0)
image.mean().backward()
assert image.shape == (64, 64, 3) and bool((colour.grad > 0).all()), (image.shape, colour.grad)
print(f"first gradient after {time.perf_counter() - started:.1f} s")
empty = {"type": "scene", "camera": {"type": "perspective"}, "sky": {"type": "constant"}}
double = tr.load_dict(empty, dtype=torch.float64)
assert abs(tr.render(double, spp=1, size=(4, 4)).mean() - 1) < 1e-9
tr.show_config()
assert "site-packages" in tr.__file__, tr.__file__
"""
METADATA = """
import importlib.metadata, torchrender
assert importlib.metadata.version("torch-pathtracer") == torchrender.__version__
assert importlib.metadata.packages_distributions()["torchrender"] == ["torch-pathtracer"]
"""


def use(python: str, search: str) -> None:
    """With the programs in `search` alone."""
    environment = {k: v for k, v in os.environ.items() if k not in ("CXX", "CC", "PYTHONPATH")} | {"PATH": search}
    with tempfile.TemporaryDirectory() as folder:
        for name in ("tutorials", "scenes"):
            shutil.copytree(ROOT / name, Path(folder) / name)
        for command in (
            [python, "-c", METADATA],
            [python, "-c", GRADIENT],
            [str(Path(python).parent / "torchrender"), "--version"],
            [python, "tutorials/cornell_box.py", "--demo"],
        ):
            subprocess.run(command, cwd=folder, env=environment, check=True, stdin=subprocess.DEVNULL)


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path, nargs="?")
    parser.add_argument("--python", default=sys.executable, help="that the environment is made from")
    parser.add_argument("--torch", nargs="+", default=["torch"], help="requirements that are installed first")
    parser.add_argument("--here", action="store_true")
    options = parser.parse_args()
    if options.here:
        use(sys.executable, str(Path(sys.executable).parent))
        return
    if options.wheel is None:
        parser.error("which wheel? make wheels builds one into dist/")
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([options.python, "-m", "venv", folder], check=True)
        python = f"{folder}/bin/python"
        pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        subprocess.run([*pip, *options.torch], check=True)
        started = time.monotonic()
        subprocess.run([*pip, *options.torch, str(options.wheel)], check=True)
        print(f"the wheel and what it needs besides torch: {time.monotonic() - started:.0f} s")
        subprocess.run([*pip, "matplotlib"], check=True)  # what the tutorials draw with
        subprocess.run([python, "-m", "pip", "check", "--disable-pip-version-check"], check=True)
        use(python, f"{folder}/bin")


if __name__ == "__main__":
    main()
