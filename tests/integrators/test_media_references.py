"""Images and gradients of participating media against references made by another renderer, by z-test.

Limits and their significance are those of `test_references.py`; scenes, see `media_scenes.py`. Gradients are compared
where no voxel is empty: the reference's estimator is biased where the density is zero.
"""

from __future__ import annotations

from pathlib import Path

import media_scenes
import numpy as np
import pytest
import reference_scenes
import torch
from reference_checks import LESS_ROUNDING, RUNS, blocks, check, check_sum, gradient_runs

import torchrender as tr

DATA = Path(__file__).resolve().parents[1] / "data"
WITH_GRADIENTS = [name for name, make in media_scenes.SCENES.items() if make().gradients]
SPP = 32


@pytest.fixture(scope="module")
def references() -> dict[str, np.ndarray]:
    return dict(np.load(DATA / "media_references.npz"))


def image_runs(name: str) -> list[np.ndarray]:
    scene = tr.load_dict(media_scenes.SCENES[name]().scene)
    with torch.no_grad():
        return [blocks(tr.render(scene, spp=SPP, seed=run), reference_scenes.BLOCK) for run in range(RUNS)]


@pytest.mark.parametrize("name", list(media_scenes.SCENES))
def test_image(name: str, references: dict[str, np.ndarray]) -> None:
    share = 16 * 1024 / (RUNS * SPP)
    check(name, image_runs(name), references[f"{name}.mean"], references[f"{name}.var"], share)


@pytest.mark.parametrize("name", WITH_GRADIENTS)
def test_gradient(name: str, references: dict[str, np.ndarray]) -> None:
    description = media_scenes.SCENES[name]()
    runs = gradient_runs(tr.load_dict(description.scene), list(description.gradients), spp=SPP)
    share = 16 * 512 / (RUNS * SPP)
    for parameter, mine in runs.items():
        mean, variance = references[f"{name}.grad.{parameter}"], references[f"{name}.gradvar.{parameter}"]
        check(f"{name}, {parameter}", mine, mean, variance, share, LESS_ROUNDING)
        sums = references[f"{name}.gradsum.{parameter}"]
        check_sum(f"{name}, {parameter}", mine, sums, share, LESS_ROUNDING)


def test_the_test_notices_a_small_error(references: dict[str, np.ndarray]) -> None:
    """A cloud whose light is wrong by 2 % fails, as does one that is upside down."""
    runs, share = image_runs("cloud"), 16 * 1024 / (RUNS * SPP)
    mean, variance = references["cloud.mean"], references["cloud.var"]
    with pytest.raises(AssertionError):
        check("brighter", [1.02 * run for run in runs], mean, variance, share)
    with pytest.raises(AssertionError):
        check("upside down", [run[::-1] for run in runs], mean, variance, share)
