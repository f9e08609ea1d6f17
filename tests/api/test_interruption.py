"""Ctrl-C with ``on_interrupt="return"``: a picture of fewer samples, which are among those of the whole."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import warnings
from pathlib import Path

import pytest
import torch

import torchrender as tr
from torchrender import interruption
from torchrender.scene.native import NativeScene

ROOT = Path(__file__).parents[2]


def make(rfilter: str = "box", **settings) -> tr.Scene:
    film = {"type": "hdrfilm", "width": 8, "height": 6, "rfilter": {"type": rfilter}}
    sampler = {"type": "independent", "sample_count": 16}  # of which the first are those of a smaller number
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "camera": {"type": "perspective", "to_world": tr.Transform().translate([0, 0, 4]).rotate([0, 1, 0], 180)}
            | {"film": film, "sampler": sampler},
            "red": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.1, 0.1]}},
            "wall": {"type": "rectangle", "bsdf": {"type": "ref", "id": "red"}},
            "lamp": {"type": "point", "position": [0, 1, 3]},
        },
        **settings,
    )


@pytest.fixture
def parts(monkeypatch):
    """Parts are small: of 48 pixels the first ones have 4 samples each."""
    monkeypatch.setattr(interruption, "PART", 200)


@pytest.fixture
def press(monkeypatch):
    """press(n): Ctrl-C during the n-th call of the core that renders from now on, which changes nothing then."""
    original = NativeScene.call
    left = []

    def call(self, name, *arguments):
        if name == "render" and left:
            left[0] -= 1
            if left[0] == 0:
                left.clear()
                signal.raise_signal(signal.SIGINT)
        return original(self, name, *arguments)

    monkeypatch.setattr(NativeScene, "call", call)
    return left.append


def interrupted(scene, text, **settings):
    with pytest.warns(tr.InterruptionWarning, match=re.escape(f"interrupted: the picture has {text}")):
        return tr.render(scene, on_interrupt="return", **settings)


# ----------------------------------------------------------------------------------------------------- uninterrupted
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize("sampler", tr.SAMPLERS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_parts_are_the_same_picture(parts, rfilter, sampler, dtype):
    scene = make(rfilter, dtype=dtype)
    names = ("rgb", "alpha", "variance", "second_moment", "depth")
    settings = {"spp": 50, "seed": 3, "sampler": sampler, "outputs": names}
    assert len(interruption.part_ends(50, 48)) > 8
    whole, found = tr.render(scene, **settings), tr.render(scene, on_interrupt="return", **settings)
    for name in names:
        torch.testing.assert_close(getattr(found, name), getattr(whole, name), rtol=2e-6, atol=1e-9)
    assert torch.equal(found.rgb, tr.render(scene, on_interrupt="return", **settings).rgb)


@pytest.mark.parametrize(
    "settings",
    [
        {"integrator": "ptracer"},
        {"integrator": "volpath"},
        {"integrator": {"type": "direct", "emitter_samples": 2, "bsdf_samples": 1}},
        {"pixels": [[0, 3], [5, 7], [0, 3]]},
        {"crop": (1, 2, 3, 4)},
        {"passes": 3},
        {"correlated": True},
        {"integrator": tr.WavefrontPathTracer(), "passes": 2},
    ],
    ids=str,
)
def test_parts_of_all_kinds_are_the_same_picture(parts, settings):
    scene = make("tent")
    settings = {"spp": 30, "seed": 3, **settings}
    (colour,) = scene.train_only("red.*")
    found = []
    for mode in ("raise", "return"):
        colour.grad = None
        image = tr.render(scene, on_interrupt=mode, **settings)
        image.sum().backward()
        found.append((image.detach(), colour.grad))
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-6)


def test_parts():
    assert interruption.part_ends(16, 256 * 256) == [16]  # a million paths
    assert interruption.part_ends(40, 256 * 256) == [16, 32, 40]
    ends = interruption.part_ends(4096, 256 * 256)
    sizes = [b - a for a, b in zip([0, *ends], ends, strict=False)]
    assert ends[-1] == 4096 and len(ends) < 50 and all(n <= max(16, e // 8) for n, e in zip(sizes, ends, strict=True))
    assert interruption.part_ends(3, 1 << 30) == [1, 2, 3]
    assert len(interruption.part_ends(1 << 32, 1)) < 200


# ------------------------------------------------------------------------------------------------------- interrupted
@pytest.mark.parametrize(
    ("integrator", "dtype"),
    [("path", torch.float32), ("ptracer", torch.float64)],  # light tracing sums up in the scene's precision
)
def test_ctrl_c_returns_samples_of_the_whole(monkeypatch, integrator, dtype):
    """Independent samples are numbered: those that are done are the picture of so many samples."""
    monkeypatch.setattr(interruption, "PART", 1 << 12)  # of which some are done by then on any machine
    scene = make("gaussian", dtype=dtype)
    settings = {"seed": 5, "integrator": integrator, "sampler": "independent"}
    tr.render(scene, spp=1, **settings)  # what comes later is no first call
    timer = threading.Timer(0.7, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.warns(tr.InterruptionWarning) as caught:
        found = tr.render(scene, spp=10**9, **settings, on_interrupt="return", progress=True)
    timer.join()
    done = int(re.search(r"the picture has (\d+) of 1000000000 samples a pixel", str(caught[0].message))[1])
    expected = tr.render(scene, spp=done, **settings)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("sampler", ["stratified", "sobol"])
def test_a_part_of_a_pattern_is_unbiased(parts, press, sampler):
    """Samples of a pattern are permuted: any part of them is spread over all of it.

    The mean of 400 pictures, each of a part of a pattern, against 400 whole ones; significance 0.001.
    """
    scene = make("tent")

    def partly(seed):
        press(4)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tr.InterruptionWarning)
            return tr.render(scene, spp=64, seed=seed, sampler=sampler, on_interrupt="return")

    mean, variance = tr.testing.mean_and_variance(partly, range(400))
    other, other_variance = tr.testing.mean_and_variance(
        lambda seed: tr.render(scene, spp=64, seed=1000 + seed, sampler=sampler), range(400)
    )
    result = tr.testing.z_test(mean, other, variance=variance, reference_variance=other_variance, significance=0.001)
    assert result, result.message


def test_other_outputs_have_the_same_samples(parts, press):
    scene, names = make(), ("rgb", "alpha", "variance", "second_moment", "depth", "albedo")
    press(3)
    found = interrupted(scene, "8 of 64 samples a pixel (12.500%)", spp=64, seed=2, outputs=names)
    expected = tr.render(scene, spp=8, seed=2, outputs=names)
    for name in names:
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), rtol=2e-6, atol=1e-9)
    press(3)
    moments = interrupted(scene, "8 of 64 samples", spp=64, seed=2, integrator=tr.Moment(tr.PathTracer(max_depth=3)))
    torch.testing.assert_close(moments[..., :3], expected.rgb)
    torch.testing.assert_close(moments[..., 3:], expected.second_moment)


def test_passes_that_are_complete(press):
    scene = make()
    names, settings = ("rgb", "variance", "depth"), {"spp": 4, "seed": 2}
    press(4)
    found = interrupted(scene, "12 of 20 samples a pixel (60.000%)", passes=5, outputs=names, **settings)
    expected = tr.render(scene, passes=3, outputs=names, **settings)
    for name in names:
        torch.testing.assert_close(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("correlated", [False, True])
def test_gradients_have_the_passes_of_the_picture(press, correlated):
    scene = make()
    (colour,) = scene.train_only("red.*")
    settings = {"spp": 4, "seed": 2, "correlated": correlated}
    press(3)
    image = interrupted(scene, "8 of 20 samples", passes=5, **settings)
    expected = tr.render(scene, passes=2, **settings)
    torch.testing.assert_close(image, expected)
    found, wanted = (torch.autograd.grad(i.square().sum(), colour)[0] for i in (image, expected))
    torch.testing.assert_close(found, wanted)
    assert float(found.abs().min()) > 0


def test_gradients_of_a_part_have_all_samples(parts, press):
    scene = make()
    (colour,) = scene.train_only("red.*")
    press(2)
    image = interrupted(scene, "4 of 64 samples", spp=64, seed=2)
    whole = tr.render(scene, spp=64, seed=2)
    found, wanted = (torch.autograd.grad(i.sum(), colour)[0] for i in (image, whole))
    torch.testing.assert_close(found, wanted)
    press(2)
    value = colour.detach()
    with pytest.warns(tr.InterruptionWarning):
        _, tangent = torch.func.jvp(
            lambda x: tr.render(scene, spp=64, seed=2, params={"red.reflectance.value": x}, on_interrupt="return"),
            (value,),
            (torch.ones_like(value),),
        )
    assert float(tangent.sum()) == pytest.approx(float(wanted.sum()), rel=1e-4)


def test_views_that_were_not_begun_have_a_part(parts, press):
    scene = make()
    scene["right"] = tr.PerspectiveCamera.look_at([1, 0, 4], [0, 0, 0], size=(6, 8))
    settings = {"sensor": ["camera", "right", "camera"], "seed": 2, "sampler": "independent"}
    press(3)
    batch = interrupted(scene, "16 of 192 samples", spp=64, **settings)
    for view, sensor, spp in zip(batch, settings["sensor"], (8, 4, 4), strict=True):
        torch.testing.assert_close(view, tr.render(scene, sensor=sensor, spp=spp, seed=2, sampler="independent"))
    value = scene.get_parameter("red.reflectance.value").detach()
    press(3)
    params = [{"red.reflectance.value": value * s} for s in (1.0, 0.5, 1.0)]
    with pytest.warns(tr.InterruptionWarning) as caught:
        other = tr.render(scene, spp=64, params=params, on_interrupt="return", **settings)
    assert len(caught) == 1 and "16 of 192" in str(caught[0].message)
    torch.testing.assert_close(other[1], 0.5 * batch[1])
    torch.testing.assert_close(other[::2], batch[::2])


def test_wavefront_passes(monkeypatch):
    scene, integrator = make(), tr.WavefrontPathTracer(chunk=48)
    settings = {"spp": 4, "seed": 2, "integrator": integrator}
    from torchrender.wavefront.path import WavefrontTracer

    original, calls = WavefrontTracer.trace, []

    def trace(self, *arguments):
        calls.append(1)
        if len(calls) == 10:  # the second chunk of the third pass
            signal.raise_signal(signal.SIGINT)
        return original(self, *arguments)

    expected = tr.render(scene, passes=2, **settings)
    monkeypatch.setattr(WavefrontTracer, "trace", trace)
    torch.testing.assert_close(interrupted(scene, "8 of 16 samples", passes=4, **settings), expected)
    calls[:] = [1] * 8
    with pytest.raises(KeyboardInterrupt):
        tr.render(scene, passes=4, on_interrupt="return", **settings)


def test_what_raises(parts, press):
    scene = make()
    (colour,) = scene.train_only("red.*")
    for settings in ({"on_interrupt": "return"}, {"on_interrupt": "raise", "passes": 2}, {}):
        press(1)
        with pytest.raises(KeyboardInterrupt):
            tr.render(scene, spp=64, **settings)
    press(2)
    with pytest.raises(KeyboardInterrupt):
        tr.render(scene, spp=4, passes=2, on_interrupt="raise")
    image = tr.render(scene, spp=4, spp_grad=10**9, seed=0, on_interrupt="return")
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        image.sum().backward()
    timer.join()
    assert colour.grad is None
    for make_it in (lambda **k: tr.render(scene, **k), lambda **k: tr.Renderer(scene, **k)):
        with pytest.raises(ValueError, match="render: on_interrupt: expected 'raise' or 'return', got 'keep'"):
            make_it(on_interrupt="keep")


def test_renderer_and_loop(parts, press):
    layer = tr.Renderer(make(), spp=64, seed=1, on_interrupt="return")
    press(2)
    with pytest.warns(tr.InterruptionWarning):
        image = layer()
    torch.testing.assert_close(image, layer(spp=4, on_interrupt="raise"))
    with warnings.catch_warnings():  # as a training loop that wants to stop there
        warnings.simplefilter("error", tr.InterruptionWarning)
        press(2)
        with pytest.raises(tr.InterruptionWarning):
            layer()


def test_bars_end_with_what_is_done(parts, press, monkeypatch):
    module = sys.modules["torchrender.progress"]
    original, made = module.progress, []

    def quiet(*arguments, **options):
        made.append(original(*arguments, **{**options, "disable": False, "file": open(os.devnull, "w")}))
        return made[-1]

    monkeypatch.setattr(module, "progress", quiet)
    tr.render(make(), spp=64, passes=2, progress=True, on_interrupt="return")
    assert made[0].n == pytest.approx(2) and made[0].total == 2
    press(3)
    interrupted(make(), "8 of 128 samples", spp=64, passes=2, progress=True)
    assert made[1].n == pytest.approx(8 / 64)


def test_the_command(tmp_path):
    path = tmp_path / "a.exr"
    arguments = ["render", ROOT / "scenes" / "cornell_box.xml", "-o", path, "--size", "16x12", "--spp", "100000000"]
    command = [sys.executable, "-m", "torchrender", *map(str, arguments), "--on-interrupt", "return"]
    program = f"""
import signal, sys, threading, os
import torchrender.interruption as interruption
from torchrender.cli import main
from torchrender.scene.native import NativeScene
original, calls = NativeScene.call, []
def call(self, *arguments):
    calls.append(1)
    if len(calls) == 3:
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
    return original(self, *arguments)
NativeScene.call = call
sys.exit(main({command[3:]!r}))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, cwd=ROOT)
    assert done.returncode == 130, done.stderr
    assert re.match(r"torchrender: warning: the rendering was interrupted: .* of 100000000 samples", done.stderr)
    assert done.stdout.startswith(f"{path}: 16 x 12 pixels")
    image = tr.io.read_image(path)
    expected = tr.render(tr.load_file(arguments[1]), spp=256, seed=1, size=(12, 16))
    assert float((image - expected).square().mean().sqrt()) < 0.3 * float(expected.square().mean().sqrt())
