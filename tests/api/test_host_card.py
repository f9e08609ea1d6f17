"""Kernels as cards get them, compiled for scenes whose facts are constants in them: what they compute is the CPU's.

Tests of the emulated device, whose kernels are for all scenes, run on a card that is the host (helpers/host_card.py),
by the launcher of cards. Some of them here; all with the variable TORCHRENDER_HOST_CARD, see there.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import host_card
import pytest

TESTS = (
    "test_emulated_outlines.py::test_materials[roughconductor]",  # surfaces, in both modes, and their edges
    "test_emulated_sights.py::test_outputs[names1]",
    "test_emulated_sights.py::test_media[cloud]",
    "test_emulated_sights.py::test_light_paths[lamp]",
)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the driver's library has another name there")
def test_kernels_of_scenes_compute_what_the_cpu_does(tmp_path, request):
    if shutil.which("c++") is None:
        pytest.skip("there is no compiler, which makes that card")
    folder = request.path.parent
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *(f"{folder}/{test}" for test in TESTS)]
    variables = {name: value for name, value in os.environ.items() if not name.startswith(("TORCHRENDER_", "PYTEST_"))}
    variables[host_card.VARIABLE] = str(tmp_path)
    done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=900, check=False)
    assert f"{len(TESTS)} passed" in done.stdout, done.stdout + done.stderr
    assert len(list(tmp_path.glob("kernel_*.so"))) > 100  # they were compiled for it
