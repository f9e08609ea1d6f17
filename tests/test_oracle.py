"""The native renderer against the path tracer in `oracle`: the same image and the same gradients, to rounding."""

from __future__ import annotations

import functools
import warnings

import oracle
import pytest
import reference_scenes
import torch
from oracle.bsdfs import BSDFS
from oracle.emitters import EMITTERS
from oracle.film import FILTERS
from oracle.scenes import SCENES, SIZE
from oracle.sensors import SENSORS
from oracle.shapes import SHAPES
from oracle.textures import TEXTURES

import torchrender as tr
from torchrender.scene.declaration import models
from torchrender.scene.film import FILTERS as NATIVE_FILTERS

ENTRIES = {"bsdf": BSDFS, "emitter": EMITTERS, "texture": TEXTURES, "sensor": SENSORS, "shape": SHAPES}
SPP = 4
RTOL = 1e-9  # of the largest number of an image or gradient,
ATOL = 1e-15  # since derivatives may cancel to zero


@pytest.mark.parametrize(("category", "kind"), [m for m in models() if m[0] != "attribute"])
def test_every_model_has_an_entry(category, kind):
    assert kind in ENTRIES[category], f"tests/oracle has no {category} {kind!r}: add its few lines of PyTorch"


def test_every_filter_has_an_entry():
    assert set(FILTERS) == set(NATIVE_FILTERS)


CASES = [(name, variant) for name in SCENES for variant in ("rgb", "mono")]


@functools.cache
def scene_of(name: str, variant: str) -> tr.Scene:
    return tr.load_dict(SCENES[name](), dtype=torch.float64, variant=variant)


def test_scenes_contain_every_model():
    packed = [scene_of(name, "rgb").layout().objects for name in SCENES]
    used = {(category, row[0]) for objects in packed for category in objects for row in objects[category]}
    assert used == set(models())


def assert_equal(native: torch.Tensor, expected: torch.Tensor, what: str) -> None:
    scale = float(expected.abs().max())
    difference = float((native - expected).abs().max())
    assert difference <= RTOL * scale + ATOL, f"{what}: {difference:.3g} of {scale:.3g}"


@pytest.mark.parametrize(("name", "variant"), CASES)
def test_image(name, variant):
    scene = scene_of(name, variant)
    native = tr.render(scene, spp=SPP, seed=5, outputs=("rgb", "alpha"))
    image, alpha = oracle.render(scene, spp=SPP, seed=5)
    assert image.abs().max() > 0.01
    assert_equal(native.rgb, image, "image")
    assert_equal(native.alpha, alpha, "alpha")


@pytest.mark.parametrize(("name", "variant"), CASES)
def test_gradients(name, variant):
    """Reverse mode of every parameter that has a derivative."""
    scene = scene_of(name, variant)
    layout = scene.layout()
    names = [n for n, i in layout.by_name.items() if not layout.slots[i].refusal]
    weight = torch.from_numpy(reference_scenes.weight(SIZE, SIZE, scene.channels))
    values = {n: scene.get_parameter(n).detach().clone().requires_grad_() for n in names}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        native = tr.render(scene, spp=SPP, seed=5, correlated=True, params=values)
    expected, _ = oracle.render(scene, spp=SPP, seed=5, params=values, derivative=True)
    given = torch.autograd.grad((native * weight).mean(), list(values.values()), allow_unused=True)
    wanted = torch.autograd.grad((expected * weight).mean(), list(values.values()), allow_unused=True)
    seen = 0
    for parameter, a, b in zip(names, given, wanted, strict=True):
        b = torch.zeros_like(values[parameter]) if b is None else b
        assert a is not None, parameter
        assert_equal(a, b, parameter)
        seen += bool(b.any())
    assert seen > len(names) / 3
