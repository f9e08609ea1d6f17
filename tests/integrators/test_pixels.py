"""Parts of an image, `pixels=` and `crop=`, and few pixels with many samples: the same numbers as the whole, bit for
bit, at any number of threads."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import threading
import time

import pytest
import reference_scenes
import torch

import torchrender as tr

pytestmark = pytest.mark.once  # takes long; parts of images are cut alike

# 70 samples: more than a chunk of 64, whose sums are merged in order.
FILTERS = [{"type": "box"}, {"type": "tent", "radius": 1.5}, {"type": "gaussian"}]
HEIGHT, WIDTH = 40, 37


def lit_room(rfilter: dict, height: int = HEIGHT, width: int = WIDTH, crop: dict | None = None, **settings) -> tr.Scene:
    """A textured floor, a ball and a lamp; film and filter as asked for."""
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": rfilter, **(crop or {})}
    description = dict(reference_scenes.SCENES["area"]().scene)
    description["sensor"] = {**description["sensor"], "film": film}
    return tr.load_dict(description, **settings)


@contextlib.contextmanager
def threads(number: int):
    kept = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(kept)


def some_pixels(count: int, height: int = HEIGHT, width: int = WIDTH) -> torch.Tensor:
    """Random ones, a group of neighbours, the corners, and repetitions of all kinds."""
    generator = torch.Generator().manual_seed(5)
    chosen = torch.stack([torch.randint(0, n, (count,), generator=generator) for n in (height, width)], 1)
    more = [[0, 0], [height - 1, width - 1], [0, width - 1], [15, 15], [15, 16], [16, 15], [16, 16], [0, 0]]
    return torch.cat([chosen, torch.tensor(more), chosen[:3]])


@pytest.mark.parametrize("rfilter", FILTERS, ids=lambda f: f["type"])
@pytest.mark.parametrize("spp", [3, 70])
def test_pixels_and_crops_equal_the_whole(rfilter, spp):
    scene = lit_room(rfilter)
    whole = tr.render(scene, spp=spp, seed=2)
    pixels = some_pixels(40)
    for number in (1, 2, 8):
        with threads(number):
            assert torch.equal(tr.render(scene, spp=spp, seed=2), whole)
            assert torch.equal(tr.render(scene, spp=spp, seed=2, pixels=pixels), whole[pixels[:, 0], pixels[:, 1]])
            assert torch.equal(tr.render(scene, spp=spp, seed=2, crop=(13, 5, 9, 30)), whole[13:22, 5:35])
            one = tr.render(scene, spp=spp, seed=2, pixels=pixels[:1])
            assert torch.equal(one, whole[pixels[:1, 0], pixels[:1, 1]])


def test_samples_stay_in_their_pixels():
    """In single precision a film position such as 700 + 0.99999 is 701: such samples still belong to pixel 700.

    Of 50000 samples a pixel about two are concerned in each direction.
    """
    scene = lit_room({"type": "box"}, height=1024, width=1024)
    around = tr.render(scene, spp=50_000, seed=1, crop=(799, 699, 3, 3))
    assert torch.equal(tr.render(scene, spp=50_000, seed=1, crop=(800, 700, 1, 1)), around[1:2, 1:2])


@pytest.mark.parametrize("sample_border", [False, True])
def test_pixels_count_from_the_corner_of_the_films_own_crop(sample_border):
    window = {"crop_offset_x": 9, "crop_offset_y": 14, "crop_width": 20, "crop_height": 11}
    scene = lit_room({"type": "gaussian"}, crop={**window, "sample_border": sample_border})
    whole = tr.render(scene, spp=4, seed=1)
    assert whole.shape == (11, 20, 3)
    every = torch.cartesian_prod(torch.arange(11), torch.arange(20))
    assert torch.equal(tr.render(scene, spp=4, seed=1, pixels=every).reshape(whole.shape), whole)


@pytest.mark.parametrize("variant", ["mono", "rgb"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_packets_and_numbers_agree_with_their_own_whole(variant, dtype, monkeypatch):
    scene = lit_room({"type": "tent"}, variant=variant, dtype=dtype)
    pixels = some_pixels(20)
    for packets in (True, False):
        monkeypatch.setattr(tr.backends, "PACKETS", packets)
        whole = tr.render(scene, spp=2, seed=2)
        assert torch.equal(tr.render(scene, spp=2, seed=2, pixels=pixels), whole[pixels[:, 0], pixels[:, 1]])


def test_layouts_batches_passes_alpha_and_no_pixels():
    scene = lit_room({"type": "box"})
    pixels = some_pixels(6)
    n, rows, columns = len(pixels), pixels[:, 0], pixels[:, 1]
    whole = tr.render(scene, spp=2, seed=2, passes=3, outputs=("rgb", "alpha"))
    found = tr.render(scene, spp=2, seed=2, passes=3, outputs=("rgb", "alpha"), pixels=pixels)
    assert torch.equal(found.rgb, whole.rgb[rows, columns]) and torch.equal(found.alpha, whole.alpha[rows, columns])
    expected = whole.rgb[rows, columns]
    for layout, result in (("chw", expected.T), ("bhwc", expected[None]), ("bchw", expected.T[None])):
        assert torch.equal(tr.render(scene, spp=2, seed=2, passes=3, pixels=pixels, layout=layout), result)
    batch = tr.render(scene, sensor=[0, 0], spp=2, seed=2, passes=3, pixels=pixels, outputs=("rgb", "alpha"))
    assert batch.rgb.shape == (2, n, 3) and batch.alpha.shape == (2, n)
    assert torch.equal(batch.rgb[1], expected)
    assert tr.render(scene, spp=2, pixels=torch.zeros(0, 2, dtype=torch.int64)).shape == (0, 3)
    for form in (pixels.int(), pixels.tolist(), pixels.numpy()):
        assert torch.equal(tr.render(scene, spp=2, seed=2, passes=3, pixels=form), expected)


@pytest.mark.parametrize("rfilter", FILTERS, ids=lambda f: f["type"])
def test_derivatives_of_pixels_are_those_of_the_whole(rfilter):
    """Reverse and forward mode; a repeated pixel counts as often as it is asked for."""
    scene = lit_room(rfilter, dtype=torch.float64)
    scene.train_only("*.reflectance.*", "*.radiance.*")
    names, parameters = zip(*((n, p) for n, p in scene.named_parameters() if p.requires_grad), strict=True)
    pixels = some_pixels(30)
    rows, columns = pixels[:, 0], pixels[:, 1]
    weight = torch.rand(len(pixels), 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    settings = {"spp": 3, "spp_grad": 70, "seed": 4}
    whole = torch.autograd.grad((tr.render(scene, **settings)[rows, columns] * weight).sum(), parameters)
    listed = torch.autograd.grad((tr.render(scene, pixels=pixels, **settings) * weight).sum(), parameters)
    torch.testing.assert_close(listed, whole, rtol=1e-9, atol=1e-12)  # sums of the same numbers in another order

    def image(values, **more):
        return tr.render(scene, params=dict(zip(names, values, strict=True)), **settings, **more)

    primals = tuple(p.detach() for p in parameters)
    tangents = tuple(torch.ones_like(p) for p in primals)
    _, whole_tangent = torch.func.jvp(lambda *v: image(v), primals, tangents)
    _, tangent = torch.func.jvp(lambda *v: image(v, pixels=pixels), primals, tangents)
    assert torch.equal(tangent, whole_tangent[rows, columns])
    reverse = sum(float(g.sum()) for g in listed)
    assert abs(float((tangent * weight).sum()) / reverse - 1) < 1e-9


def test_gradients_with_a_filter_repeat():
    """The sums of filter weights are made by all threads, and come out the same every time."""
    scene = lit_room({"type": "gaussian"})
    parameters = scene.train_only("*.reflectance.*")

    def gradient() -> torch.Tensor:
        image = tr.render(scene, spp=70, seed=4)
        return torch.cat([g.flatten() for g in torch.autograd.grad(image.square().sum(), parameters)])

    with threads(2):
        first, second = gradient(), gradient()
    with threads(1):
        alone = gradient()
    assert torch.equal(first, second)
    torch.testing.assert_close(first, alone, rtol=1e-4, atol=1e-4 * float(alone.abs().max()))


def test_time_goes_with_the_pixels_and_not_with_the_film():
    """Ten pixels of a film of 2**32: an image of it would not fit into memory."""
    scene = lit_room({"type": "gaussian"}, height=65536, width=65536)
    pixels = torch.tensor([[0, 0], [65535, 65535], [32768, 32767], [9, 60000], [60000, 9]]).repeat(2, 1)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    result = tr.render(scene, spp=4, seed=1, pixels=pixels)
    assert torch.equal(result[:5], result[5:])
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 * 1024  # kilobytes


def test_one_pixel_with_many_samples_uses_all_threads():
    scene = lit_room({"type": "box"}, height=1, width=1)
    with threads(4):
        all_threads, this_thread = time.process_time(), time.thread_time()
        first = tr.render(scene, spp=200_000, seed=1)
        others = time.process_time() - all_threads - (time.thread_time() - this_thread)
        assert others > 0.2 * (time.process_time() - all_threads)  # expected: three quarters
    with threads(1):
        assert torch.equal(tr.render(scene, spp=200_000, seed=1), first)


@pytest.mark.parametrize("derivative", [False, True])
@pytest.mark.parametrize("rfilter", FILTERS[::2], ids=lambda f: f["type"])
def test_a_thousand_million_samples_can_be_interrupted(rfilter, derivative):
    scene = lit_room(rfilter, height=1, width=1)
    scene.train_only("floor.bsdf.reflectance.*")
    image = tr.render(scene, spp=1, spp_grad=10**9, seed=1)  # what comes later is no first call
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    sent = []

    def press():
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(0.5, press)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        if derivative:
            image.sum().backward()
        else:
            tr.render(scene, spp=10**9, seed=1)
    assert time.perf_counter() - sent[0] < 0.5
    timer.join()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 * 1024  # kilobytes
    assert bool(torch.isfinite(tr.render(scene, spp=4, seed=1)).all())


def test_sample_numbers_have_32_bits():
    scene = lit_room({"type": "box"}, height=1, width=1)
    with pytest.raises(ValueError, match="spp: expected a number from 1 to 4294967296"):
        tr.render(scene, spp=2**32 + 1)


@pytest.mark.parametrize("form", ["tensor", "array"])
def test_edits_of_the_list_of_pixels_after_rendering_change_nothing(form):
    scene = lit_room(FILTERS[0])
    (colour,) = scene.train_only("floor.bsdf.reflectance.value")
    gradients = []
    for edit in (False, True):
        pixels = torch.tensor([[30, 10], [35, 20]])
        pixels = pixels.numpy() if form == "array" else pixels
        image = tr.render(scene, spp=2, seed=1, pixels=pixels)
        if edit:
            pixels[:] = 1 << 40
        gradients.append(torch.autograd.grad(image.sum(), colour)[0])
    assert bool((gradients[0] != 0).any()) and torch.equal(*gradients)
