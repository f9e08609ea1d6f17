"""What people look at: pictures in notebooks, progress bars, summaries, help."""

from __future__ import annotations

import ast
import contextlib
import inspect
import re
import sys
import time
import types
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
import pytest
import torch

import torchrender as tr
from torchrender.scene import stubs
from torchrender.scene.declaration import models


def make(**objects) -> tr.Scene:
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "camera": {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 6}},
            "red": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.1, 0.1]}},
            "wall": {"type": "rectangle", "bsdf": {"type": "ref", "id": "red"}},
            "lamp": {"type": "point", "position": [0, 1, 3]},
            "sky": {"type": "constant"},
            **objects,
        }
    )


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def notebook(monkeypatch):
    """A stand-in for IPython in a Jupyter kernel; returns what is displayed."""
    displayed = []
    shell = type("ZMQInteractiveShell", (), {})()
    ipython = types.ModuleType("IPython")
    ipython.get_ipython = lambda: shell
    ipython.version_info = (9, 0)
    display = types.ModuleType("IPython.display")
    display.display = displayed.append
    ipython.display = display
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    return displayed


# ---------------------------------------------------------------------------------------------------------- pictures
def test_show_in_a_notebook(notebook):
    image = torch.rand(4, 6, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    assert tr.show([image, torch.zeros(4, 2)]) is None
    (picture,) = notebook
    assert picture.size == (8, 4) and picture.mode == "RGB"
    assert picture._repr_png_().startswith(b"\x89PNG")  # what the notebook puts below the cell


def test_show_elsewhere_returns_the_picture(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    picture = tr.show(tr.render(make(), spp=1))
    assert picture.size == (8, 6) and picture.mode == "RGB"
    # Display values: the sRGB curve, rounded; twice as much light with an exposure of 1.
    assert tr.show(torch.full((1, 1, 3), 0.25)).getpixel((0, 0)) == (137, 137, 137)
    assert tr.show(torch.full((1, 1, 3), 0.125), exposure=1).getpixel((0, 0)) == (137, 137, 137)


class Recorder:
    """What `log_images` needs of a writer."""

    def __init__(self):
        self.images = []

    def add_image(self, tag, picture, step):
        self.images.append((tag, picture, step))


def test_log_images():
    generator = torch.Generator().manual_seed(0)
    image, batch = torch.rand(4, 6, 3, generator=generator), torch.rand(2, 4, 6, 3, generator=generator)
    rgba = torch.cat([image, image[..., :1]], -1).requires_grad_()
    cases = [image, [image, batch[0]], batch, batch.movedim(-1, 1), image.movedim(-1, 0), image[..., 0], rgba]
    for number, case in enumerate(cases):
        tr.log_images(writer := Recorder(), "found", case, number, exposure=1, tonemap="filmic")
        ((tag, picture, step),) = writer.images
        expected = torch.from_numpy(np.array(tr.show(case, 1, tonemap="filmic")))
        assert (tag, step) == ("found", number) and picture.dtype == torch.uint8
        assert torch.equal(picture.movedim(0, -1), expected)
    tr.log_images(writer, "last", image)
    assert writer.images[-1][2] is None


def test_log_images_refuses():
    writer = Recorder()
    with pytest.raises(TypeError, match=r"writer: expected a torch.utils.tensorboard.SummaryWriter.*, got str"):
        tr.log_images("runs", "a", torch.zeros(2, 2, 3), 0)
    for images, kind, message in (
        (torch.zeros(2, 2, 5), ValueError, "images: expected 1, 3 or 4 channels"),
        ([torch.zeros(2, 2, 3), torch.zeros(3, 2, 3)], ValueError, "images: expected images of one height"),
        ([], ValueError, "images: expected an image or a non-empty sequence"),
        ([1.0], TypeError, "images: expected tensors"),
    ):
        with pytest.raises(kind, match=message):
            tr.log_images(writer, "a", images, 0)
    with pytest.raises(ValueError, match="tonemap: expected 'srgb' or 'filmic'"):
        tr.log_images(writer, "a", torch.zeros(2, 2, 3), 0, tonemap="aces")
    assert not writer.images


def test_log_images_in_tensorboard(tmp_path):
    pytest.importorskip("tensorboard")
    from PIL import Image
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    from torch.utils.tensorboard import SummaryWriter

    image = torch.rand(4, 6, 3, generator=torch.Generator().manual_seed(0))
    with SummaryWriter(str(tmp_path)) as writer:
        tr.log_images(writer, "found", [image, image[..., :1]], 7)
    (event,) = EventAccumulator(str(tmp_path)).Reload().Images("found")
    picture = Image.open(BytesIO(event.encoded_image_string))
    assert event.step == 7 and np.array_equal(np.asarray(picture), np.asarray(tr.show([image, image[..., :1]])))


# ---------------------------------------------------------------------------------------------------------- progress
def test_progress_is_seen_where_somebody_watches(monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    assert list(tr.progress(range(3), desc="training")) == [0, 1, 2]
    assert "training" in terminal.getvalue() and "3/3" in terminal.getvalue()
    monkeypatch.setattr(sys, "stderr", silent := StringIO())
    assert list(tr.progress(range(3), desc="training")) == [0, 1, 2]
    assert silent.getvalue() == ""
    monkeypatch.setattr(sys, "stderr", None)  # as in programs without a console
    assert list(tr.progress(range(3))) == [0, 1, 2]


def test_progress_by_hand(monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    with tr.progress(total=4, desc="views") as bar:
        bar.update(3)
        bar.set_postfix(loss=0.5)
    assert "3/4" in terminal.getvalue() and "loss=0.5" in terminal.getvalue()
    monkeypatch.setattr(sys, "stderr", quiet := Terminal())
    list(tr.progress(range(3), disable=True))
    assert quiet.getvalue() == ""


def test_short_renderings_show_no_bar(monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    tr.render(make(), spp=1, passes=3)
    assert terminal.getvalue() == ""


@pytest.fixture
def bars(monkeypatch):
    """The arguments and final states of the bars that appear, none of which waits before it does."""
    made = []
    module = sys.modules["torchrender.progress"]
    original = module.progress

    def quick(*arguments, **options):
        bar = original(*arguments, **{**options, "delay": 0.0})
        made.append((options, bar))
        return bar

    monkeypatch.setattr(module, "progress", quick)
    return made


def test_long_renderings_show_a_bar(monkeypatch, bars):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    scene = make()
    scene.train_only("red.reflectance.value")
    image = tr.render(scene, spp=1, passes=3)
    image.sum().backward()
    assert [options["desc"] for options, _ in bars] == ["image", "derivative"]
    assert all(options["delay"] > 0 and bar.n == bar.total == 3 for options, bar in bars)
    assert "image: " in terminal.getvalue() and "left" in terminal.getvalue()


@pytest.mark.parametrize("integrator", ["path", "volpath", "ptracer", "direct"])
def test_bars_move_within_a_pass(monkeypatch, bars, integrator):
    monkeypatch.setattr(sys, "stderr", Terminal())
    seen = []

    def update(bar, n):
        seen.append(n)
        bar.n += n

    monkeypatch.setattr(sys.modules["tqdm"].tqdm, "update", update)
    tr.render(make(), spp=1 << 17, integrator=integrator, seed=0)
    assert len(seen) > 1 and all(n >= 0 for n in seen) and sum(seen) == pytest.approx(1)


def test_bars_by_wish(monkeypatch, bars):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    tr.render(make(), spp=1, passes=2, progress=False)
    assert not bars and terminal.getvalue() == ""
    monkeypatch.setattr(sys, "stderr", pipe := StringIO())
    tr.render(make(), spp=1, passes=2)
    assert not bars and pipe.getvalue() == ""
    tr.Renderer(make(), spp=1, passes=2, progress=True)()
    assert len(bars) == 1 and "image: " in pipe.getvalue()
    for shown in (True, False):
        monkeypatch.setattr(sys, "stderr", pipe := StringIO())
        tr.render(make(), spp=1, passes=2, integrator=tr.WavefrontPathTracer(), progress=shown)
        assert ("passes: " in pipe.getvalue()) == shown
    with pytest.raises(TypeError, match="progress: expected True, False or None, got 1"):
        tr.render(make(), progress=1)


# --------------------------------------------------------------------------------------------------------- summaries
def table(scene):
    """The rows of the parameters by name, each with its footnote behind it."""
    text = repr(scene)
    notes = {m[1]: " ".join(m[2].split()) for m in re.finditer(r"^  \[(\d+)\] (.*(?:\n      .*)*)", text, re.MULTILINE)}
    lines = [line for line in text.splitlines() if re.match(r"    \S", line)]
    return {line.split()[0]: re.sub(r" \[(\d+)\]", lambda m: f": {notes[m[1]]}", line) for line in lines}


def test_summary_fits_and_says_what_is_trained():
    scene = make()
    assert "No parameter requires a gradient" in repr(scene)
    assert max(len(line) for line in repr(scene).splitlines()) <= 100
    scene.train_only("red.*")
    assert "No parameter requires a gradient" not in repr(scene)


def test_summary_says_which_derivatives_there_are():
    scene = make()
    scene.train_only("red.*")
    rows = table(scene)
    assert rows["red.reflectance.value"].endswith("yes, requires grad")
    assert "3" in rows["red.reflectance.value"].split() and "[0.1, 0.6]" in rows["red.reflectance.value"]
    assert rows["lamp.position"].endswith("yes")  # nothing is missing in this scene
    scene["pane"] = tr.Rectangle(bsdf=tr.ThinDielectric())
    assert " yes: without the motion of edges that are seen in or through pane.bsdf" in table(scene)["camera.to_world"]
    del scene["pane"]
    assert " none: a probability" in rows["sky.sampling_weight"]
    assert " none: " in rows["camera.near_clip"]
    # Everything that state_dict holds is listed, except index arrays.
    listed = {n for n, _ in scene.named_parameters()}
    assert listed == set(rows)


def test_summary_agrees_with_what_rendering_does():
    scene = make()
    rows = table(scene)
    for name, parameter in scene.named_parameters():
        refused = False
        parameter.requires_grad_()
        try:
            with pytest.warns(tr.MissingTermWarning) if "without" in rows[name] else contextlib.nullcontext():
                tr.render(scene, spp=1)
        except tr.NotDifferentiableError:
            refused = True
        parameter.requires_grad_(False)
        assert refused == (" none: " in rows[name]), rows[name]


def test_summaries_are_quick():
    texels = torch.rand(512, 1024, 3, generator=torch.Generator().manual_seed(0))
    many = {f"ball{i}": {"type": "sphere", "center": [i, 0, 0]} for i in range(200)}
    scene = make(env={"type": "envmap", "data": texels}, **many)
    del scene["sky"]
    repr(scene)
    begin = time.perf_counter()
    text = repr(scene)
    assert time.perf_counter() - begin < 1.0
    assert "ball199.radius" in text


# -------------------------------------------------------------------------------------------------------------- help
def test_every_class_says_what_it_takes():
    for category, kind in models():
        if category == "attribute":
            continue
        cls = tr.scene.registry.plugin_class(category, kind)
        assert cls.__doc__ and len(cls.__doc__) > 20
        names = [p for p in inspect.signature(cls).parameters.values() if p.kind is not p.VAR_KEYWORD]
        accepted = [n for n in cls.parameter_names() if n not in cls.inert]
        assert {p.name for p in names} >= set(accepted), cls
        assert all(p.annotation is not p.empty for p in names), cls


def test_generated_types_are_up_to_date():
    path = Path(tr.__file__).parent / "_plugins.pyi"
    assert path.read_text() == stubs.stub(), "torchrender.scene.stubs.main() writes it"
    ast.parse(path.read_text())
    assert {"Diffuse", "AreaLight"} <= set(stubs.generated_classes())


def test_signatures():
    assert str(inspect.signature(tr.Diffuse)) == "(*, reflectance: 'TextureLike' = 0.5) -> 'Diffuse'"
    assert next(iter(inspect.signature(tr.Mesh).parameters)) == "vertices"
    assert inspect.signature(tr.Bitmap).parameters["filter_type"].default == "bilinear"
    assert "reflectance" in tr.Diffuse.__doc__
    with pytest.raises(TypeError):
        tr.Diffuse(0.5)


def test_every_public_name_is_documented():
    for name in tr.__all__:
        value = getattr(tr, name)
        assert getattr(value, "__doc__", None), name
    for name in (
        "tonemap",
        "show",
        "log_images",
        "ray_intersect",
        "ray_occluded",
        "rotation",
        "testing",
        "constraints",
        "optim",
        "io",
    ):
        assert getattr(tr, name).__doc__ and name in dir(tr)
