"""`tr.denoise`: Open Image Denoise, which is optional."""

import sys
from pathlib import Path

import pytest
import torch

import torchrender as tr

IMAGE = torch.zeros(4, 4, 3)


@pytest.fixture(scope="module")
def found():
    pytest.importorskip("pyoidn")
    scene = tr.load_file(Path(__file__).parents[2] / "scenes" / "cornell_box.xml")
    settings = {"size": (64, 64), "outputs": ("rgb", "albedo", "shading_normal")}
    return scene, tr.render(scene, spp=4, seed=0, **settings), tr.render(scene, spp=1024, seed=1, **settings).rgb


def error(image, reference):
    """Of what is shown, so that the lamp does not outweigh everything."""
    return float((tr.tonemap(image) - tr.tonemap(reference)).square().mean())


def test_noise_falls(found):
    _, noisy, reference = found
    plain = tr.denoise(noisy.rgb)
    guided = tr.denoise(noisy.rgb, albedo=noisy.albedo, normal=noisy.shading_normal)
    assert error(plain, reference) < 0.2 * error(noisy.rgb, reference)
    assert error(guided, reference) < error(plain, reference)


def test_shapes_types_and_batches(found):
    _, noisy, _ = found
    one = tr.denoise(noisy.rgb, albedo=noisy.albedo, quality="fast")
    assert one.shape == noisy.rgb.shape and one.dtype == torch.float32
    double = tr.denoise(noisy.rgb.double()[None], albedo=noisy.albedo.double()[None], quality="fast")
    assert double.dtype == torch.float64
    torch.testing.assert_close(double[0].float(), one)
    grey = tr.denoise(noisy.rgb[..., :1], albedo=noisy.albedo[..., :1], normal=noisy.shading_normal)
    assert grey.shape == (64, 64, 1)
    broken = noisy.rgb.clone()
    broken[3, 3] = float("nan")
    assert bool(torch.isfinite(tr.denoise(broken)).all())


def test_gradients_by_reattach(found):
    scene, *_ = found
    (albedo,) = scene.train_only("red.reflectance.value")
    image = tr.render(scene, spp=4, seed=0, size=(64, 64))
    smooth = tr.denoise(image)
    assert not smooth.requires_grad
    attached = tr.reattach(smooth, image)
    assert torch.equal(attached, smooth)
    attached.sum().backward()
    expected = torch.autograd.grad(tr.render(scene, spp=4, seed=0, size=(64, 64)).sum(), albedo)[0]
    torch.testing.assert_close(albedo.grad, expected)


def test_without_the_library(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    with pytest.raises(ImportError, match=r"needs Open Image Denoise, which is not installed .*: pip install pyoidn"):
        tr.denoise(IMAGE)


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        ({"image": [1.0]}, TypeError, "image: expected a floating-point tensor"),
        ({"image": IMAGE[..., :2]}, ValueError, r"image: expected shape \(H, W, C\)"),
        ({"image": IMAGE, "albedo": IMAGE[:2]}, ValueError, r"albedo: expected \(4, 4\) pixels of 3 channels"),
        ({"image": IMAGE, "albedo": IMAGE, "normal": IMAGE[..., :1]}, ValueError, "normal: expected"),
        ({"image": IMAGE, "normal": IMAGE}, ValueError, "normal: only together with albedo"),
        ({"image": IMAGE, "albedo": 3}, TypeError, "albedo: expected a floating-point tensor, got 3"),
        ({"image": IMAGE, "quality": "best"}, ValueError, "quality: expected one of default, fast, balanced, high"),
    ],
)
def test_arguments(arguments, kind, message):
    with pytest.raises(kind, match=f"denoise: {message}"):
        tr.denoise(**arguments)
