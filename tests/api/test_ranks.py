"""Processes of a group that have the same seed."""

import subprocess
import sys

import pytest
import torch

RANK = """
import sys, warnings
import torch
import torchrender as tr
folder, rank, seed = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/store", rank=rank, world_size=2)
torch.manual_seed(seed)
scene = tr.load_dict({"type": "scene", "camera": {"type": "perspective"}, "sky": {"type": "constant"}})
with warnings.catch_warnings(record=True) as found:
    warnings.simplefilter("always")
    for _ in range(2):
        tr.render(scene, spp=1, crop=(0, 0, 2, 2))
print([str(w.message) for w in found])
torch.distributed.barrier()
torch.distributed.destroy_process_group()
"""


@pytest.mark.skipif(not torch.distributed.is_available(), reason="this torch has no distributed package")
@pytest.mark.parametrize("seeds", [(0, 0), (0, 1)])
def test_equal_seeds_of_ranks_are_noticed(tmp_path, seeds):
    arguments = [[sys.executable, "-c", RANK, str(tmp_path), str(rank), str(seed)] for rank, seed in enumerate(seeds)]
    ranks = [subprocess.Popen(a, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for a in arguments]
    results = [rank.communicate(timeout=120) for rank in ranks]
    assert [rank.returncode for rank in ranks] == [0, 0], results
    text = "".join(out for out, _ in results)
    assert text.count("two processes of the group have the same seed") == (seeds[0] == seeds[1])
