"""The C interface of a compiled core: values go through it unchanged, mistakes are told of, objects are let go."""

from __future__ import annotations

import gc
import math
import signal
import time
import weakref

import pytest
import torch

import torchrender as tr
from torchrender import backends
from torchrender.library import Watch

INTEGERS = [s * (1 << n) + d for n in (0, 14, 15, 29, 30, 31, 32, 45, 60, 62) for s in (-1, 1) for d in (-1, 0, 1)]
VALUES = [
    [None, True, False],
    [*INTEGERS, 2**63 - 1, 2**63, 2**64 - 1, -(2**63)],
    [0.0, 0.1, -1e300, 5e-324, math.inf, -math.inf],
    ["", "wörter", "\U0001f4a1", "a\0b", "x" * 70000, b"", b"\0\xff"],
    [[], [[1, [2.5]], "a"], {}, {"b": 1, "a": {"": [None]}}],
]


@pytest.fixture
def core():
    return backends.core()


@pytest.mark.parametrize("values", VALUES, ids=["none", "integers", "floats", "texts", "containers"])
def test_values_come_back_as_they_were(core, values):
    back = core.echo(values)
    assert back == values and [type(b) for b in back] == [type(v) for v in values]


def test_some_values_come_back_otherwise(core):
    assert core.echo((1, (2,))) == [1, [2]]
    assert list(core.echo({"b": 1, "a": 2})) == ["b", "a"]
    assert math.copysign(1, core.echo(-0.0)) == -1 and math.isnan(core.echo(math.nan))


@pytest.mark.parametrize("value", [2**64, -(2**63) - 1, 1j, {1: 2}, {3}])
def test_other_values_are_refused(core, value):
    with pytest.raises(TypeError):
        core.echo(value)


def test_wrong_arguments_are_refused(core):
    with pytest.raises(TypeError, match="there is no function nothing"):
        core.nothing()
    with pytest.raises(TypeError, match="philox: expected 5 arguments, got 6"):
        core.philox(1, 2, 3, 4, 5, 6)
    with pytest.raises(TypeError, match="philox: expected an integer, got None"):
        core.philox(1, 2, 3, 4)
    with pytest.raises(TypeError, match="philox: expected an integer in range, got an integer"):
        core.philox(1, 2**32, 3, 4, 5)
    with pytest.raises(TypeError, match="philox: expected an integer in range, got an integer"):
        core.philox(-1, 2, 3, 4, 5)
    with pytest.raises(TypeError, match="philox: expected an integer, got a number"):
        core.philox(1.0, 2, 3, 4, 5)
    scene, sums = core.Scene("rgb", "float32"), core.FilmSums()
    with pytest.raises(TypeError, match=r"Scene\.record_rays: an object of another class than expected"):
        scene.record_rays(sums)
    with pytest.raises(TypeError, match="expected an object of this library, got an integer"):
        scene.record_rays(1)
    with pytest.raises(ValueError, match="max_depth: is missing"):
        scene.render({}, [], [], {})


def test_an_object_goes_with_its_last_reference(core):
    """Its memory, too, which a tensor keeps that was made of it."""
    scene = tr.load_dict(
        {
            "type": "scene",
            "camera": {"type": "perspective", "film": {"type": "hdrfilm", "width": 32, "height": 32}},
            "ball": {"type": "sphere", "center": [0, 0, 3], "emitter": {"type": "area"}},
        }
    )
    scene.train_only("ball.emitter.radiance.value")
    gc.collect()
    before = core.hit_bytes_in_use()
    image = tr.render(scene, spp=4, seed=0, correlated=True)
    assert core.hit_bytes_in_use() > before
    del image
    assert core.hit_bytes_in_use() == before

    store = core.HitStore(100)
    tensor, gone = torch.frombuffer(store, dtype=torch.uint8), weakref.ref(store)
    del store
    assert gone() is not None
    del tensor
    assert gone() is None


def test_signals_and_errors_end_a_call():
    """The handler runs when the core asks: what it raises comes out of the call, however often."""

    class Stop(Exception):
        pass

    def stop(*_):
        raise Stop

    scene = tr.load_dict({"type": "scene", "camera": {"type": "perspective"}, "sky": {"type": "constant"}})
    scene.layout()
    tr.render(scene, spp=1, size=(8, 8))
    previous = signal.signal(signal.SIGALRM, stop)
    try:
        for _ in range(3):
            started = time.monotonic()
            signal.setitimer(signal.ITIMER_REAL, 0.1)
            with pytest.raises(Stop):
                tr.render(scene, spp=1 << 20, size=(512, 512))
            assert time.monotonic() - started < 30
    finally:
        signal.signal(signal.SIGALRM, previous)
    assert tr.render(scene, spp=1, size=(8, 8)).sum() > 0


def test_a_watch_keeps_the_first_error():
    told = []

    def progress(done: float) -> None:
        told.append(done)
        if done > 0.5:
            raise RuntimeError(f"at {done}")

    watch = Watch(progress)
    assert [watch.callback(done) for done in (0.25, 0.75)] == [0, 1]
    assert told == [0.25, 0.75]
    with pytest.raises(RuntimeError, match=r"at 0\.75"):
        watch.fail()
