"""Rays that are kept and traced again by Embree alone: the same rays, the same hits, at every query width."""

from __future__ import annotations

import pytest
import torch
from small_scene import ball_and_wall

import torchrender as tr

pytestmark = pytest.mark.core
CLOSEST = ("camera", "bounce")


def recorded(dtype: torch.dtype, limit: int = 1 << 20):
    """A scene after an image and a derivative, both recorded, with the core's own counts of rays."""
    scene = tr.load_dict(ball_and_wall(height=24, width=32, spp=4), dtype=dtype)
    (colour,) = scene.train_only("red.reflectance.value")
    tr.render(scene, seed=1)  # makes the native scene
    handle = scene._native.handle
    handle.record_rays(limit)
    tr.render(scene, seed=2).sum().backward()
    assert colour.grad is not None
    rays = {kind: sum(s[kind] for s in scene.statistics.values()) for kind in ("closest_rays", "shadow_rays")}
    return handle, rays


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_same_rays_hit_the_same(dtype):
    handle, rays = recorded(dtype)
    counts = handle.recorded_rays()
    assert sum(counts[kind]["rays"] for kind in CLOSEST) == rays["closest_rays"]
    assert counts["shadow"]["rays"] == rays["shadow_rays"]
    assert all(0 < c["hits"] < c["rays"] and c["left_out"] == 0 for c in counts.values())
    for kind, count in counts.items():
        for width in (1, 4):
            for threads in (1, 3):
                replay = handle.replay_rays(kind, width, threads, 2)
                assert len(replay["seconds"]) == 2
                # Packets and single rays may differ at an edge, by rounding.
                assert abs(replay["hits"] - count["hits"]) <= 2, (kind, width, threads)


def test_what_is_beyond_the_limit_is_counted():
    everything = recorded(torch.float32)[0].recorded_rays()
    some = recorded(torch.float32, limit=1500)[0].recorded_rays()
    for kind, count in some.items():
        assert count["rays"] <= 1500
        assert count["rays"] + count["left_out"] == everything[kind]["rays"]
    assert any(count["left_out"] for count in some.values())


def test_the_record_ends():
    handle, _ = recorded(torch.float32)
    handle.record_rays(0)
    assert all(count["rays"] == 0 for count in handle.recorded_rays().values())
    with pytest.raises(RuntimeError, match="no rays are recorded"):
        handle.replay_rays("camera", 1, 1, 1)


def test_wrong_arguments_are_refused():
    handle, _ = recorded(torch.float32)
    with pytest.raises(ValueError, match="width: expected 1, 4, 8 or 16"):
        handle.replay_rays("camera", 3, 1, 1)
    with pytest.raises(ValueError, match="kind: expected camera, bounce or shadow, got light"):
        handle.replay_rays("light", 1, 1, 1)
