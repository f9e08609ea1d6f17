"""One image by three processes: `distributed_program.py` renders, alone and shared, what is compared here."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import torchrender as tr

PROGRAM = Path(__file__).with_name("distributed_program.py")
LIKE_ALONE = [
    *("box", "no sample for some", "gaussian", "lanczos", "stratified", "sobol", "correlated", "passes", "outputs"),
    *("outputs, gaussian", "aovs", "pixels", "views", "light", "spectral", "stokes", "double", "features"),
    *("forward mode", "own camera", "tiles", "tiles, chw", "tiles, outputs", "tiles, few rows", "one gathers"),
    *("data parallel", "seed of the first"),
]
BIT_FOR_BIT = [name for name in LIKE_ALONE if name.startswith("tiles") or name == "one gathers"]

pytestmark = pytest.mark.skipif(not torch.distributed.is_available(), reason="this torch has no distributed package")


@pytest.fixture(scope="module")
def found() -> dict[str, dict]:
    """What every case gives, of one run."""
    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "3", str(PROGRAM)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(launch, capture_output=True, text=True, timeout=300, env=environment)
    assert done.returncode == 0, done.stderr[-4000:]
    return json.loads(done.stdout.partition("RESULTS")[2])


@pytest.mark.parametrize("case", LIKE_ALONE)
def test_image_and_gradient_are_those_of_one_process(found, case):
    result = found[case]
    assert "error" not in result, result["error"]
    # Rounding of sums in another order; wavelengths' colours have terms that nearly cancel.
    tolerance = 1e-13 if case == "double" else 1e-4 if case == "spectral" else 3e-6
    assert result["image"] <= (0 if case in BIT_FOR_BIT else tolerance), result
    assert result["gradient"] <= tolerance, result
    assert result["size"] > 0.01, result  # there is a gradient


def test_image_and_derivative_have_samples_of_their_own(found):
    # Of 24 runs with fixed seeds: 4 standard errors are exceeded with a probability of 6e-4 (Student's t).
    assert abs(found["unbiased"]["z"]) < 4, found["unbiased"]
    assert found["unbiased"]["z of shared samples"] > 10  # what it would be otherwise


def test_adaptive_gradients_are_unbiased(found):
    assert abs(found["adaptive"]["z"]) < 4, found["adaptive"]  # 24 runs, as above


def test_a_step_sends_the_image_and_the_gradient(found):
    # 23 x 20 pixels of three colours; a texture of 4 x 4 texels, a radiance, a centre; seven numbers of 64 bits.
    expected = 4 * (23 * 20 * 3 + 4 * 4 * 3 + 3 + 1) + 8 * 7
    assert found["bytes"] == {"collectives": 3, "bytes": expected}


def test_mistakes_are_named_on_all_processes(found):
    said = found["refusals"]
    for name, words in {
        "variance": "ValueError: distributed.render: outputs: 'variance' is not found from shares",
        "light": "ValueError: distributed.render: split: paths of ParticleTracer belong to no tile",
        "pixels": "ValueError: distributed.render: pixels: a list has no tiles",
        "split": "ValueError: distributed.render: split: expected one of samples, tiles, got 'views'",
        "to": "ValueError: distributed.render: to: one process is given the whole of tiles, without gradients",
        "interrupt": "ValueError: distributed.render: on_interrupt: only 'raise'",
        "wavefront": "ValueError: distributed.render: integrator: WavefrontPathTracer has no shares of samples",
        "different": "ValueError: distributed.render: spp: processes have different ones: [4, 5, 6]",
        "unknown": "TypeError: distributed.render: unknown argument 'samples'; did you mean",
        "group": "TypeError: distributed.render: group: expected a torch.distributed.ProcessGroup, got 'all'",
    }.items():
        assert said[name].startswith(words), (name, said[name])


def test_a_group_is_needed():
    scene = tr.load_dict({"type": "scene", "camera": {"type": "perspective"}, "sky": {"type": "constant"}})
    with pytest.raises(RuntimeError, match=r"distributed\.render: there is no process group: call"):
        tr.distributed.render(scene)
    with pytest.raises(TypeError, match=r"distributed\.render: scene: expected a Scene"):
        tr.distributed.render({"type": "scene"})


FAILING = """
import datetime, os, sys, torch, torchrender as tr
folder, rank = sys.argv[1], int(sys.argv[2])
torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/store", rank=rank, world_size=2,
                                     timeout=datetime.timedelta(seconds=20))
scene = tr.load_dict({"type": "scene", "camera": {"type": "perspective"}, "sky": {"type": "constant"}})
tr.distributed.render(scene, spp=2, seed=0, size=(4, 4))
if rank == 1:
    os._exit(3)
try:
    tr.distributed.render(scene, spp=2, seed=0, size=(4, 4))
except RuntimeError as error:
    print(type(error).__name__, flush=True)
    os._exit(0)  # gloo may abort where a group is let go whose connections are broken
"""


def test_a_process_that_ends_is_an_error_of_the_group(tmp_path):
    ranks = [
        subprocess.Popen([sys.executable, "-c", FAILING, str(tmp_path), str(rank)], stdout=subprocess.PIPE, text=True)
        for rank in range(2)
    ]
    printed = [rank.communicate(timeout=120)[0] for rank in ranks]
    assert [rank.returncode for rank in ranks] == [0, 3]
    assert printed[0].strip() in ("RuntimeError", "DistBackendError")
