"""Tutorials with checkpoints, killed by SIGKILL at random moments and begun again: whether they end with the same bits.

``python -m bench kills [--kills 20] [--only NAME]``: every one runs once to its end at a small size, then again with
that many kills, after waits that are drawn evenly from half of the time that the first run took; each has to go on from
its checkpoint. Ends with status 1 if one differs.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import torch

from .arguments import positive
from .report import ROOT

TUTORIALS = ROOT / "tutorials"
SIZES: dict[str, dict[str, Any]] = {
    "caustics": {"size": 64, "resolution": 32, "colour": False, "spp": 16, "spp_grad": 16, "passes": 1,
                 "iterations": 40, "rate": 1e-3, "width_mm": 50.0, "verification_spp": 64},
    "smoke": {"size": 16, "resolution": 24, "views_per_step": 4, "spp": 8, "spp_grad": 4, "passes": 1,
              "iterations": 24, "target_spp": 64, "max_depth": 32, "rate": 0.6},
    "slab": {"size": [4, 16, 16], "resolution": 24, "spp": 8, "spp_grad": 8, "passes": 1, "iterations": 24,
             "target_spp": 128, "max_depth": 128},
    "luneburg": {"levels": 2, "iterations": 40, "rays": 60},
    "grin_cube": {"size": 40, "resolution": 32, "iterations": 60, "smoothness": 0.5, "verification_spp": 64},
    "schlieren": {"size": 20, "resolution": 20, "views": 12, "iterations": 4},
    "mesh_from_pictures": {"subdivisions": 3, "resolution": 32, "view_count": 6, "spp": 4, "iterations": 16,
                           "finer_iterations": 4, "target_spp": 16, "smoothness": 2.0, "points": 4000},
    "shadow_art": {"rings": 64, "corners": 16, "resolution": 32, "spp": 8, "iterations": 40, "smoothness": 2.0},
    "pose": {"part": "picture", "resolution": 32, "spp": 8, "iterations": 60, "target_spp": 256, "rate": 0.04},
    "shape_from_polarisation": {"size": 16, "resolution": 16, "spp": 8, "spp_photograph": 64, "iterations": 24},
    "many_machines": {"texture_size": 16, "resolution": 40, "view_count": 4, "spp": 4, "iterations": 30,
                      "target_spp": 32},
}  # fmt: skip
BY_ITSELF = ("schlieren",)  # saves after every iteration; the others are told to
PROGRAM = """
import json, pathlib, sys, torch
torch.set_num_threads(1)
sys.path.insert(0, {tutorials!r})
import {name}
print("RESULT" + json.dumps({name}.run(pathlib.Path(sys.argv[1]), **json.loads(sys.argv[2]))))
"""


def started(name: str, folder: Path) -> subprocess.Popen[str]:
    code = PROGRAM.format(tutorials=str(TUTORIALS), name=name)
    settings = dict(SIZES[name])
    if name not in BY_ITSELF:  # a tenth of the way is lost at most; drawing takes as long as iterations do
        settings["save_every"] = max(1, settings["iterations"] // 10)
    command = [sys.executable, "-c", code, str(folder), json.dumps(settings)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finished(process: subprocess.Popen[str]) -> dict[str, float]:
    """What the tutorial returns."""
    out, error = process.communicate()
    if process.returncode:
        raise SystemExit(f"a tutorial ended with status {process.returncode}:\n{error[-3000:]}")
    return json.loads(out.partition("RESULT")[2])


def checkpoints(folder: Path) -> dict[str, Any]:
    """The checkpoints in a folder by their names, without the settings, which `Checkpoint` compares itself."""
    found = {path.name: torch.load(path, weights_only=True) for path in folder.glob("*.pt")}
    for state in found.values():
        del state["settings"]
    return found


def equal(one: Any, two: Any) -> bool:
    """Whether two values of a checkpoint are, bit for bit in tensors: numbers and words, in dicts and lists."""
    if type(one) is not type(two):
        return False
    if isinstance(one, torch.Tensor):
        return one.dtype == two.dtype and one.shape == two.shape and one.numpy().tobytes() == two.numpy().tobytes()
    if isinstance(one, dict):
        return one.keys() == two.keys() and all(equal(one[key], two[key]) for key in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(two) and all(map(equal, one, two))
    return one == two or (one != one and two != two)


def same(first: Path, second: Path) -> bool:
    """Whether the checkpoints in two folders are equal, bit for bit."""
    return equal(checkpoints(first), checkpoints(second))


def kill(name: str, kills: int, seed: int) -> tuple[bool, int]:
    """Whether a tutorial ends alike, and how often it was killed before it was done."""
    chance = random.Random(f"{name} {seed}")
    with tempfile.TemporaryDirectory() as folder:
        whole, parts = Path(folder) / "whole", Path(folder) / "parts"
        begin = time.monotonic()
        expected = finished(started(name, whole))
        usual = time.monotonic() - begin
        killed = 0
        for _ in range(kills):
            process = started(name, parts)
            try:
                process.wait(chance.uniform(0, usual / 2))
            except subprocess.TimeoutExpired:
                process.kill()
                killed += 1
            process.communicate()
        found = finished(started(name, parts))
        return found == expected and same(whole, parts), killed


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench kills", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--kills", type=positive, default=20, help="of each tutorial (default 20)")
    parser.add_argument("--only", default="", help="only tutorials whose name contains this")
    parser.add_argument("--seed", type=int, default=0, help="of the moments (default 0)")
    options = parser.parse_args(arguments)
    status = 0
    for name in (n for n in SIZES if options.only in n):
        alike, killed = kill(name, options.kills, options.seed)
        print(f"{name}: killed {killed} times, {'the same bits' if alike else 'DIFFERENT'}", flush=True)
        status |= not alike
    return status
