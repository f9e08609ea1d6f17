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
from oracle.media import MEDIA
from oracle.phases import PHASES
from oracle.scenes import ONLY_RGB, SCENES
from oracle.sensors import SENSORS
from oracle.shapes import SHAPES
from oracle.textures import TEXTURES
from oracle.volumes import VOLUMES
from torch.autograd import forward_ad

import torchrender as tr
from torchrender.scene.declaration import models
from torchrender.scene.film import FILTERS as NATIVE_FILTERS

SURFACES = {"bsdf": BSDFS, "emitter": EMITTERS, "texture": TEXTURES, "sensor": SENSORS, "shape": SHAPES}
ENTRIES = {**SURFACES, "volume": VOLUMES, "phase": PHASES, "medium": MEDIA}
OF_LIGHT = {("emitter", "directionalarea"), ("sensor", "irradiancemeter")}  # see test_particle_oracle.py
SPP = 4
RTOL = 1e-9  # of the largest number of an image or gradient,
ATOL = 1e-15  # since derivatives may cancel to zero


@pytest.mark.parametrize(("category", "kind"), [m for m in models() if m[0] != "attribute" and m not in OF_LIGHT])
def test_every_model_has_an_entry(category, kind):
    assert kind in ENTRIES[category], f"tests/oracle has no {category} {kind!r}: add its few lines of PyTorch"


def test_every_filter_has_an_entry():
    assert set(FILTERS) == set(NATIVE_FILTERS)


CASES = [(name, variant) for name in SCENES for variant in ("rgb", "mono") if variant == "rgb" or name not in ONLY_RGB]


@functools.cache
def scene_of(name: str, variant: str) -> tr.Scene:
    return tr.load_dict(SCENES[name](), dtype=torch.float64, variant=variant)


def test_scenes_contain_every_model():
    packed = [scene_of(name, "rgb").layout().objects for name in SCENES]
    used = {(category, row[0]) for objects in packed for category in objects for row in objects[category]}
    # others: test_media.py
    expected = {m for m in models() if m[0] in (*SURFACES, "attribute", "volume")} - OF_LIGHT
    assert used == expected


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


def differentiable(scene: tr.Scene) -> dict[str, torch.Tensor]:
    """Values of the parameters that have a derivative, by one of their names."""
    layout = scene.layout()
    first = {i: n for n, i in reversed(layout.by_name.items())}
    names = [n for i, n in first.items() if not layout.slots[i].refusal]
    return {n: scene.get_parameter(n).detach().clone() for n in names}


def render_both(scene: tr.Scene, values: dict[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
    """Native and expected image, attached to `values`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about moving edges, which are no part of either
        native = tr.render(scene, spp=SPP, seed=5, correlated=True, params=values)
    return native, oracle.render(scene, spp=SPP, seed=5, params=values, derivative=True)[0]


@pytest.mark.parametrize(("name", "variant"), CASES)
def test_gradients(name, variant):
    """Reverse mode of every parameter that has a derivative."""
    scene = scene_of(name, variant)
    values = {n: v.requires_grad_() for n, v in differentiable(scene).items()}
    native, expected = render_both(scene, values)
    weight = torch.from_numpy(reference_scenes.weight(*native.shape))
    given = torch.autograd.grad((native * weight).mean(), list(values.values()), allow_unused=True)
    wanted = torch.autograd.grad((expected * weight).mean(), list(values.values()), allow_unused=True)
    seen = 0
    for parameter, a, b in zip(values, given, wanted, strict=True):
        b = torch.zeros_like(values[parameter]) if b is None else b
        assert a is not None, parameter
        assert_equal(a, b, parameter)
        seen += bool(b.any())
    assert seen > len(values) / 3


@pytest.mark.parametrize("name", SCENES)
def test_forward_mode(name):
    """The derivative of the image along one direction in all parameters."""
    scene = scene_of(name, "rgb")
    generator = torch.Generator().manual_seed(9)
    values = differentiable(scene)
    tangents = {n: torch.randn(v.shape, generator=generator, dtype=v.dtype) for n, v in values.items()}
    with forward_ad.dual_level():
        dual = {n: forward_ad.make_dual(v, tangents[n]) for n, v in values.items()}
        native, expected = (forward_ad.unpack_dual(image).tangent for image in render_both(scene, dual))
    assert expected.abs().max() > 0.01
    assert_equal(native, expected, "tangent of the image")


@pytest.mark.parametrize("name", SCENES)
def test_outputs_and_their_gradients(name):
    """What is known of the first hit, and its derivative in every parameter at once."""
    scene = scene_of(name, "rgb")
    values = {n: v.requires_grad_() for n, v in differentiable(scene).items()}
    expected = oracle.first_hits(scene, spp=SPP, seed=5, params=values)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about moving edges, which are no part of either
        native = tr.render(scene, spp=SPP, seed=5, correlated=True, params=values, outputs=tuple(expected))
    generator = torch.Generator().manual_seed(3)
    given = wanted = torch.zeros(())
    for output, image in expected.items():
        hit = torch.isfinite(image)
        assert torch.equal(torch.isfinite(getattr(native, output)), hit)
        assert_equal(getattr(native, output)[hit], image[hit], output)
        weight = torch.rand(image.shape, generator=generator, dtype=image.dtype)[hit]
        given = given + (getattr(native, output)[hit] * weight).sum()
        wanted = wanted + (image[hit] * weight).sum()
    for parameter, a, b in zip(
        values,
        torch.autograd.grad(given, list(values.values()), allow_unused=True),
        torch.autograd.grad(wanted, list(values.values()), allow_unused=True),
        strict=True,
    ):
        b = torch.zeros_like(values[parameter]) if b is None else b
        assert_equal(torch.zeros_like(b) if a is None else a, b, parameter)
