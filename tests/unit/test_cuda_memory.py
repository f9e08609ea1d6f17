"""Memory of cards that PyTorch gives: what its functions are asked for, by a callback as the core calls it."""

from __future__ import annotations

import ctypes
from types import SimpleNamespace

import pytest
import small_scene
import torch

import torchrender as tr
from torchrender import backends, devices
from torchrender.cuda import memory
from torchrender.cuda.memory import Request, use_memory

PLACE = (1 << 47) - 256


@pytest.fixture
def serve():
    """What the core is given."""
    given: list[int] = []
    use_memory(SimpleNamespace(use_cuda_memory=given.append))
    return ctypes.CFUNCTYPE(None, ctypes.POINTER(Request))(given[0])


@pytest.fixture
def asked(monkeypatch):
    """A stand-in for PyTorch's functions: what they are asked for, and an error that they raise if there is one."""
    found = SimpleNamespace(calls=[], error=None)

    def alloc(size, device, stream):
        found.calls.append((size, device, stream))
        if found.error is not None:
            raise found.error
        return PLACE

    def delete(address):
        found.calls.append(address)
        if found.error is not None:
            raise found.error

    monkeypatch.setattr(torch.cuda, "caching_allocator_alloc", alloc)
    monkeypatch.setattr(torch.cuda, "caching_allocator_delete", delete)
    monkeypatch.setattr(torch.cuda, "empty_cache", lambda: found.calls.append("empty"))
    monkeypatch.setattr(devices, "_with_memory", {"scalar"})
    return found


def test_memory_is_taken_and_given_back(serve, asked):
    taking = Request(1000, 1, 77, None, 0)
    serve(taking)
    assert (taking.memory, taking.served) == (PLACE, 1)
    serve(Request(1000, 0, None, None, 0))
    giving = Request(0, 1, 77, PLACE, 0)
    serve(giving)
    assert giving.served == 1
    room = Request(0, 1, 77, None, 0)  # for the driver
    serve(room)
    assert (room.memory, room.served) == (None, 1)
    assert asked.calls == [(1000, 1, 77), (1000, 0, 0), PLACE, "empty"]
    devices.raise_error_of_memory()


def test_there_is_none(serve, asked):
    asked.error = torch.cuda.OutOfMemoryError("none left")
    taking = Request(1000, 0, None, None, 0)
    serve(taking)
    assert (taking.memory, taking.served) == (None, 1)
    devices.raise_error_of_memory()


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("CUDA error: an illegal address")], ids=type)
def test_errors_are_raised_when_the_core_returns(serve, asked, error):
    asked.error = error
    for request in (Request(1000, 0, None, None, 0), Request(0, 0, None, PLACE, 0)):
        serve(request)
        assert request.served == 0
        with pytest.raises(type(error)) as raised:
            devices.raise_error_of_memory()
        assert raised.value is error
    assert memory.errors == []


def test_a_call_raises_what_it_was_not_ended_for(serve, asked):
    """Giving memory back ends nothing."""
    scene = tr.load_dict(small_scene.ball_and_wall())
    asked.error = KeyboardInterrupt()
    serve(Request(0, 0, None, PLACE, 0))
    with pytest.raises(KeyboardInterrupt):
        tr.render(scene, spp=1)
    assert tr.render(scene, spp=1).isfinite().all()


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


def test_the_stream_of_the_moment(monkeypatch):
    """... of the card that a scene lies on, if that computes it."""
    scene = tr.load_dict(small_scene.ball_and_wall())
    native = scene.native(scene.layout(), [tuple(slot.tensor().shape) for slot in scene.layout().slots])
    monkeypatch.setattr(torch.cuda, "current_stream", lambda place: SimpleNamespace(cuda_stream=hash(place)))
    native.home = card = torch.device("cuda:1")
    with devices.chosen("cuda:1"):
        assert native._placed([], [], {}) == {"stream": hash(card)}
    for other in ("cuda:0", "emulated", "cpu"):
        with devices.chosen(other):
            assert native._placed([], [], {}) == {}
