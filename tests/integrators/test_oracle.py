"""The native renderer against the path tracer in PyTorch: the same image and the same derivatives, to rounding; and
outputs of first hits against tests/oracle/outputs.py."""

from __future__ import annotations

import functools
import warnings

import pytest
import reference_scenes
import torch
from in_torch import SPP, InTorch, assert_equal, differentiable, render
from oracle.bsdf import MODELS, in_pytorch
from oracle.media import MEDIA
from oracle.outputs import first_hits
from oracle.phases import PHASES
from oracle.scenes import SCENES
from torch.autograd import forward_ad

import torchrender as tr
from torchrender.scene.declaration import models
from torchrender.wavefront.emitters import EMITTERS
from torchrender.wavefront.lights import LIGHT_SHAPES
from torchrender.wavefront.sensors import SENSORS
from torchrender.wavefront.textures import TEXTURES
from torchrender.wavefront.volumes import VOLUMES

LAYERS = ("twosided", "blendbsdf", "normalmap", "bumpmap")  # torchrender/wavefront/layers.py
SURFACES = {"bsdf": (*MODELS, *LAYERS), "emitter": EMITTERS, "texture": TEXTURES, "volume": VOLUMES, "sensor": SENSORS}
SURFACES["shape"] = (*LIGHT_SHAPES, "heightfield", "bsplinecurve", "linearcurve", "sdfgrid")  # the last cannot emit
ENTRIES = {**SURFACES, "phase": PHASES, "medium": MEDIA}
OF_LIGHT = {("emitter", "directionalarea"), ("sensor", "irradiancemeter")}  # see test_particle_oracle.py
BENT = {("medium", "gradientindex")}  # see gradientindex/test_bent_oracle.py


@pytest.fixture(autouse=True)
def bsdfs_in_pytorch():
    with in_pytorch():
        yield


@pytest.mark.parametrize(
    ("category", "kind"), [m for m in models() if m[0] != "attribute" and m not in OF_LIGHT | BENT]
)
def test_every_model_has_an_entry(category, kind):
    place = "torchrender/wavefront" if category in set(SURFACES) - {"bsdf"} else "tests/oracle"
    assert kind in ENTRIES[category], f"{place} has no {category} {kind!r}: add its few lines of PyTorch"


CASES = [(name, variant) for name in SCENES for variant in ("rgb", "mono")]


@functools.cache
def scene_of(name: str, variant: str) -> tr.Scene:
    return tr.load_dict(SCENES[name](), dtype=torch.float64, variant=variant)


def test_scenes_contain_every_model():
    packed = [scene_of(name, "rgb").layout().objects for name in SCENES]
    used = {(category, row[0]) for objects in packed for category in objects for row in objects[category]}
    # others: test_media.py
    expected = {m for m in models() if m[0] in (*SURFACES, "attribute")} - OF_LIGHT
    assert used == expected


@pytest.mark.parametrize(("name", "variant"), CASES)
def test_image(name, variant):
    scene = scene_of(name, variant)
    native, found = (
        tr.render(scene, integrator=i, spp=SPP, seed=5, outputs=("rgb", "alpha"))
        for i in (scene.integrator, InTorch(scene.integrator))
    )
    assert found.rgb.abs().max() > 0.01
    assert_equal(native.rgb, found.rgb, "image")
    assert_equal(native.alpha, found.alpha, "alpha")


def assert_equal_gradients(scene: tr.Scene, values: dict[str, torch.Tensor]) -> int:
    """Of both renderers; the number of those that are not zero."""
    values = {n: v.requires_grad_() for n, v in values.items()}
    weight = torch.from_numpy(reference_scenes.weight(*scene.sensors[0].film.window[2:], scene.channels))
    found, expected = (
        torch.autograd.grad((render(scene, values, integrator=i) * weight).mean(), list(values.values()))
        for i in (InTorch(scene.integrator), scene.integrator)
    )
    for parameter, a, b in zip(values, found, expected, strict=True):
        assert_equal(a, b, parameter)
    return sum(bool(b.any()) for b in expected)


@pytest.mark.parametrize(("name", "variant"), CASES)
def test_gradients(name, variant):
    """Reverse mode of every parameter that has a derivative, of samples of their own."""
    scene = scene_of(name, variant)
    values = differentiable(scene)
    assert assert_equal_gradients(scene, values) > len(values) / 3


@pytest.mark.parametrize("wanted", ["bsdf.weight", "bsdf.reflectance", "lamp.emitter", "specular_reflectance"])
def test_gradients_of_some_parameters(wanted):
    """Which a derivative is wanted of decides over the choice of layers and over Russian roulette."""
    scene = scene_of("layers", "rgb")
    assert assert_equal_gradients(scene, {n: v for n, v in differentiable(scene).items() if wanted in n}) > 0


@pytest.mark.parametrize("name", SCENES)
def test_forward_mode(name):
    """The derivative of the image along one direction in all parameters."""
    scene = scene_of(name, "rgb")
    generator = torch.Generator().manual_seed(9)
    values = differentiable(scene)
    tangents = {n: torch.randn(v.shape, generator=generator, dtype=v.dtype) for n, v in values.items()}
    with forward_ad.dual_level():
        dual = {n: forward_ad.make_dual(v, tangents[n]) for n, v in values.items()}
        found, expected = (
            forward_ad.unpack_dual(render(scene, dual, integrator=i)).tangent
            for i in (InTorch(scene.integrator), scene.integrator)
        )
    assert expected.abs().max() > 0.01
    assert_equal(found, expected, "tangent of the image")


@pytest.mark.parametrize("name", SCENES)
def test_outputs_and_their_gradients(name):
    """What is known of the first hit, and its derivative in every parameter at once."""
    scene = scene_of(name, "rgb")
    values = {n: v.requires_grad_() for n, v in differentiable(scene).items()}
    expected = first_hits(scene, spp=SPP, seed=5, params=values)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about moving edges, which are no part of either
        shown = {"params": values, "outputs": tuple(expected), "visibility": False}
        native = tr.render(scene, spp=SPP, seed=5, correlated=True, **shown)
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
