"""Images and gradients against references made by another renderer, by z-test.

`data/references.npz` holds small scenes, one for each group of models (see `reference_scenes.py`),
`data/comparison.npz` the Cornell box and the textured sphere of the benchmark; means and the variances of the means.

The statistic is z = (ours - theirs) / sqrt(our variance + their variance) per entry, where our variance comes from
independent runs. It is Student distributed with at least RUNS - 1 degrees of freedom; the limits below are passed by
chance with a probability of less than 1e-3 per test, and the seeds are fixed.
"""

from __future__ import annotations

from pathlib import Path

import brushed_scenes
import hair_scenes
import layer_scenes
import numpy as np
import pytest
import reference_scenes
import torch
from reference_checks import LESS_ROUNDING, ROUNDING, RUNS, blocks, check, check_sum, gradient_runs

import torchrender as tr

DATA = Path(__file__).resolve().parents[1] / "data"
SCENES = Path(__file__).resolve().parents[2] / "scenes"
ALL = {**reference_scenes.SCENES, **layer_scenes.SCENES, **brushed_scenes.SCENES, **hair_scenes.SCENES}


@pytest.fixture(scope="module")
def references() -> dict[str, np.ndarray]:
    return {
        key: value
        for name in ("references", "layer_references", "brushed_references", "hair_references")
        for key, value in np.load(DATA / f"{name}.npz").items()
    }


@pytest.fixture(scope="module")
def comparison() -> dict[str, np.ndarray]:
    return dict(np.load(DATA / "comparison.npz"))


@pytest.mark.parametrize("name", list(ALL))
def test_image(name: str, references: dict[str, np.ndarray]) -> None:
    scene = tr.load_dict(ALL[name]().scene)
    with torch.no_grad():
        runs = [blocks(tr.render(scene, spp=32, seed=run), reference_scenes.BLOCK) for run in range(RUNS)]
    share = 16 * 1024 / (RUNS * 32)
    # The reference's Gaussian filter is a polynomial fit, which deviates by up to 4e-4 of the peak.
    systematic = 5e-4 if name == "film" else 1e-5
    check(name, runs, references[f"{name}.mean"], references[f"{name}.var"], share, systematic)


@pytest.mark.parametrize("name", list(reference_scenes.CAMERAS))
def test_image_of_another_camera(name: str) -> None:
    stored = np.load(DATA / "camera_references.npz")
    scene = tr.load_dict(reference_scenes.CAMERAS[name]().scene)
    with torch.no_grad():
        runs = [blocks(tr.render(scene, spp=32, seed=run), reference_scenes.BLOCK) for run in range(RUNS)]
    check(name, runs, stored[f"{name}.mean"], stored[f"{name}.var"], 16 * 1024 / (RUNS * 32))


WITH_GRADIENTS = [name for name, make in ALL.items() if make().gradients]


@pytest.mark.parametrize("name", WITH_GRADIENTS)
def test_gradient(name: str, references: dict[str, np.ndarray]) -> None:
    description = ALL[name]()
    runs = gradient_runs(tr.load_dict(description.scene), list(description.gradients), spp=32)
    share = 16 * 512 / (RUNS * 32)
    systematic = 5e-4 if name == "film" else LESS_ROUNDING
    for parameter, mine in runs.items():
        mean, variance = references[f"{name}.grad.{parameter}"], references[f"{name}.gradvar.{parameter}"]
        check(f"{name}, {parameter}", mine, mean, variance, share, systematic)
        check_sum(f"{name}, {parameter}", mine, references[f"{name}.gradsum.{parameter}"], share, systematic)


COMPARISON = {
    "cornell_box": ("cornell_box.xml", {}),
    "textured_sphere": ("textured_sphere.xml", {"texture": "textures/blocks_32.exr"}),
}


@pytest.mark.parametrize("name", list(COMPARISON))
def test_comparison_image(name: str, comparison: dict[str, np.ndarray]) -> None:
    file, arguments = COMPARISON[name]
    scene = tr.load_file(SCENES / file, **arguments)
    with torch.no_grad():
        runs = [blocks(tr.render(scene, spp=8, seed=run), 8) for run in range(RUNS)]
    check(name, runs, comparison[f"{name}.mean"], comparison[f"{name}.var"], 4096 / (RUNS * 8))


@pytest.mark.parametrize("name", list(COMPARISON))
def test_comparison_gradient(name: str, comparison: dict[str, np.ndarray]) -> None:
    file, arguments = COMPARISON[name]
    scene = tr.load_file(SCENES / file, **arguments)
    names = [key.split(".", 2)[2] for key in comparison if key.startswith(f"{name}.grad.")]
    runs = gradient_runs(scene, names, spp=8)
    share = 2048 / (RUNS * 8)
    for parameter, mine in runs.items():
        mean, variance = comparison[f"{name}.grad.{parameter}"], comparison[f"{name}.gradvar.{parameter}"]
        check(f"{name}, {parameter}", mine, mean, variance, share, ROUNDING)
        check_sum(f"{name}, {parameter}", mine, comparison[f"{name}.gradsum.{parameter}"], share, ROUNDING)


def test_the_test_notices_a_small_error(references: dict[str, np.ndarray]) -> None:
    """An image that is wrong by 2 % fails, as does one whose rows are upside down."""
    scene = tr.load_dict(reference_scenes.SCENES["shapes"]().scene)
    with torch.no_grad():
        runs = [blocks(tr.render(scene, spp=32, seed=run), reference_scenes.BLOCK) for run in range(RUNS)]
    mean, variance = references["shapes.mean"], references["shapes.var"]
    share = 16 * 1024 / (RUNS * 32)
    with pytest.raises(AssertionError):
        check("brighter", [1.02 * run for run in runs], mean, variance, share)
    with pytest.raises(AssertionError):
        check("upside down", [run[::-1] for run in runs], mean, variance, share)
