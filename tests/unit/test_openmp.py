"""The core's threads are those of PyTorch's OpenMP, or its own: the numbers are the same."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import torch

import torchrender as tr
from torchrender import backends, openmp

PROGRAM = """
import runpy
numbers = runpy.run_path("tests/unit/test_openmp.py")["numbers"]
print([float(x.double().sum()).hex() for x in numbers(3)])
"""


@pytest.fixture
def own_threads():
    """What makes the core use threads of its own until the test ends."""
    core = backends.ready()
    yield lambda: core.use_openmp(0, 0, 0)
    core.use_openmp(*openmp.addresses())


def numbers(threads: int) -> list[torch.Tensor]:
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        scene = tr.load_file("scenes/cornell_box.xml", resolution=40)
        (red,) = scene.train_only("red.reflectance.value")
        image = tr.render(scene, spp=4, seed=1)
        image.square().mean().backward()
    finally:
        torch.set_num_threads(before)
    return [image.detach(), red.grad]


def test_pytorch_has_one():
    loops = "libgomp" in torch.__config__.parallel_info() or "OpenMP" in torch.__config__.parallel_info()
    if not (loops and sys.platform == "linux"):
        pytest.skip("this PyTorch runs its loops without GNU's OpenMP")
    assert all(openmp.addresses())


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_equal_numbers_by_own_threads(own_threads, threads):
    shared = numbers(threads)
    own_threads()
    for one, other in zip(shared, numbers(threads), strict=True):
        assert torch.equal(one, other)


def test_a_team_that_is_too_small_is_filled_up():
    """OpenMP gives fewer threads than it is asked for where it may not have more."""
    found = {"none": f"{[float(x.double().sum()).hex() for x in numbers(3)]}\n"}
    for limit in ("1", "2"):
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM],
            env=os.environ | {"OMP_THREAD_LIMIT": limit},
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr
        found[limit] = done.stdout
    assert len(set(found.values())) == 1
