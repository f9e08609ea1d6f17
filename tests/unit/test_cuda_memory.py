"""Memory of cards that PyTorch gives: what its functions are asked for, by callbacks as the core calls them."""

from __future__ import annotations

import ctypes
from types import SimpleNamespace

import pytest
import small_scene
import torch

import torchrender as tr
from torchrender import backends, devices
from torchrender.cuda.memory import use_memory


@pytest.fixture
def functions():
    """What the core is given: it takes a size and a card's number, and gives an address back."""
    given: list[int] = []
    use_memory(SimpleNamespace(use_cuda_memory=lambda *addresses: given.extend(addresses)))
    take = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)(given[0])
    return take, ctypes.CFUNCTYPE(None, ctypes.c_void_p)(given[1])


def test_memory_is_taken_and_given_back(functions, monkeypatch):
    take, give_back = functions
    asked: list[tuple[int, ...]] = []

    def alloc(size, device):
        asked.append((size, device))
        if size > 1000:
            raise torch.cuda.OutOfMemoryError("none left")
        return (1 << 47) - 256

    monkeypatch.setattr(torch.cuda, "caching_allocator_alloc", alloc)
    monkeypatch.setattr(torch.cuda, "caching_allocator_delete", lambda address: asked.append((address,)))
    assert take(1000, 1) == (1 << 47) - 256
    assert take(1001, 0) is None
    give_back((1 << 47) - 256)
    assert asked == [(1000, 1), (1001, 0), ((1 << 47) - 256,)]


def test_a_scene_on_a_card_shares_it(monkeypatch):
    """Not one that lies on the CPU, whichever card renders it. (There is none here, nor anything that compiles.)"""
    core, shared = backends.scene_core(torch.float32, torch.device("cuda:0")), []
    monkeypatch.setattr(devices, "_with_compiler", {core.isa})
    monkeypatch.setattr(devices, "_with_memory", set())
    monkeypatch.setattr("torchrender.cuda.memory.use_memory", shared.append)
    for place in ("cpu", "cuda:0"):
        scene = tr.load_dict(small_scene.ball_and_wall())
        scene._device = torch.device(place)
        with devices.chosen("cuda:0"), pytest.raises(RuntimeError):
            tr.ray_occluded(scene, [[0, 0, 3]], [[0, 0, 1]])
        assert bool(shared) == (place != "cpu")
    assert shared == [core]
