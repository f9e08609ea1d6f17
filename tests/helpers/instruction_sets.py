"""The same program at every compiled instruction set, in processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys

import torch

import torchrender as tr

PRINT = """
import sys, torch
sys.path.insert(0, sys.argv[1])
import {module} as scenes, torchrender as tr
for name in sorted(scenes.SCENES):
    print(name, *tr.render(tr.load_dict(scenes.SCENES[name]().scene), spp={spp}, seed=3).mean((0, 1)).tolist())
"""


def assert_equal_means(module: str, spp: int, rtol: float) -> None:
    """The mean colours of all scenes of a module of these tests are those of the first instruction set."""
    found = {}
    for isa in [i for i, s in tr.backends.status().items() if s.startswith(("used", "available"))]:
        result = subprocess.run(
            [sys.executable, "-c", PRINT.format(module=module, spp=spp), os.path.dirname(__file__)],
            env={**os.environ, "TORCHRENDER_ISA": isa},
            capture_output=True,
            text=True,
            check=True,
            timeout=300,
        )
        found[isa] = {line.split()[0]: list(map(float, line.split()[1:])) for line in result.stdout.splitlines()}
    assert found
    for means in found.values():
        for name, first in next(iter(found.values())).items():
            torch.testing.assert_close(torch.tensor(means[name]), torch.tensor(first), rtol=rtol, atol=1e-5)
