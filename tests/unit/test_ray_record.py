"""Rays that are kept and traced again by Embree alone: the same rays, the same hits, at every query width."""

from __future__ import annotations

import pytest
import torch
from small_scene import ball_and_wall

import torchrender as tr
from torchrender import backends

pytestmark = pytest.mark.core

CLOSEST = ("camera", "bounce")


def recorded(dtype: torch.dtype, limit: int = 1 << 20):
    """A scene's native half, the record of an image and a derivative, and the core's own counts of their rays."""
    scene = tr.load_dict(ball_and_wall(height=24, width=32, spp=4), dtype=dtype)
    (colour,) = scene.train_only("red.reflectance.value")
    tr.render(scene, seed=1)  # makes the native scene
    handle, record = scene._native.handle, backends.core().RayRecord(limit)
    handle.record_rays(record)
    tr.render(scene, seed=2).sum().backward()
    assert colour.grad is not None
    rays = {kind: sum(s[kind] for s in scene.statistics.values()) for kind in ("closest_rays", "shadow_rays")}
    handle.record_rays(None)
    return handle, record, rays


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_same_rays_hit_the_same(dtype):
    handle, record, rays = recorded(dtype)
    counts = record.counts()
    assert sum(counts[kind]["rays"] for kind in CLOSEST) == rays["closest_rays"]
    assert sum(counts[kind]["rays"] for kind in ("camera shadow", "bounce shadow")) == rays["shadow_rays"]
    assert all(0 < c["hits"] < c["rays"] and c["left_out"] == 0 for c in counts.values())
    for kind, count in counts.items():
        for width in (1, 4):
            for threads, coherent in ((1, False), (3, False), (1, True)):
                replay = handle.replay_rays(record, kind, width, coherent, threads, 2)
                assert len(replay["seconds"]) == 2
                # Packets and single rays may differ at an edge, by rounding.
                assert abs(replay["hits"] - count["hits"]) <= 2, (kind, width, threads, coherent)


def test_what_is_beyond_the_limit_is_counted():
    everything = recorded(torch.float32)[1].counts()
    some = recorded(torch.float32, limit=1500)[1].counts()
    for kind, count in some.items():
        assert count["rays"] <= 1500
        assert count["rays"] + count["left_out"] == everything[kind]["rays"]
    assert any(count["left_out"] for count in some.values())


def test_a_record_that_was_taken_away_stays_as_it_is():
    scene = tr.load_dict(ball_and_wall())
    tr.render(scene, seed=1)
    handle, record = scene._native.handle, backends.core().RayRecord(1000)
    handle.record_rays(record)
    tr.render(scene, seed=1)
    handle.record_rays(None)
    before = record.counts()
    assert before["camera"]["rays"] > 0
    tr.render(scene, seed=1)
    assert record.counts() == before


def test_wrong_arguments_are_refused():
    handle, record, _ = recorded(torch.float32)
    with pytest.raises(ValueError, match="width: expected 1, 4, 8 or 16"):
        handle.replay_rays(record, "camera", 3, False, 1, 1)
    with pytest.raises(ValueError, match="kind: expected camera, bounce, camera shadow or bounce shadow, got light"):
        handle.replay_rays(record, "light", 1, False, 1, 1)
