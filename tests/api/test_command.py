"""The command `torchrender`: what it writes, what it says, and its statuses."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

import torchrender as tr
from torchrender.cli import main

BOX = Path(__file__).parents[2] / "scenes" / "cornell_box.xml"


def run(capsys, *arguments):
    """Status, standard output, standard error."""
    try:
        status = main([str(a) for a in arguments])
    except SystemExit as ended:  # of wrong arguments
        status = ended.code
    out, err = capsys.readouterr()
    return status, out, err


@pytest.fixture(autouse=True)
def warnings_as_before(monkeypatch):
    import warnings

    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # which the command replaces


def test_render(capsys, tmp_path):
    path = tmp_path / "a.exr"
    options = ("--spp", 2, "--size", "20x12", "--seed", 5, "-D", "max_depth=3")
    status, out, err = run(capsys, "render", BOX, "-o", path, *options)
    assert (status, err) == (0, "") and out.startswith(f"{path}: 20 x 12 pixels, ")
    expected = tr.render(tr.load_file(BOX, max_depth=3), spp=2, seed=5, size=(12, 20))
    assert torch.equal(tr.io.read_image(path), expected)


def test_render_options(capsys, tmp_path):
    path, scene = tmp_path / "a.exr", tr.load_file(BOX, variant="mono", dtype=torch.float64)
    options = ("--spp", 2, "--size", "8x8", "--variant", "mono", "--double", "--integrator", "direct", "--quiet")
    assert run(capsys, "render", BOX, "-o", path, *options, "--sensor", "0") == (0, "", "")
    expected = tr.render(scene, spp=2, seed=0, size=(8, 8), integrator="direct")
    torch.testing.assert_close(tr.io.read_image(path), expected.float())
    name = next(n for n, m in scene._modules.items() if m in scene.sensors)
    assert run(capsys, "render", BOX, "-o", tmp_path / "b.exr", *options, "--sensor", name)[0] == 0
    assert torch.equal(tr.io.read_image(tmp_path / "b.exr"), tr.io.read_image(path))


def test_exposure_is_for_pictures(capsys, tmp_path):
    options = ("--spp", 2, "--size", "8x8", "--quiet", "--exposure", "-1")
    for name in ("a.png", "a.exr"):
        assert run(capsys, "render", BOX, "-o", tmp_path / name, *options)[0] == 0
    linear = tr.io.read_image(tmp_path / "a.exr")
    shown = tr.io.read_image(tmp_path / "a.png")
    assert float((shown - (linear / 2).clamp(0, 1)).abs().max()) < 0.01


def test_filmic_pictures(capsys, tmp_path):
    options = ("--spp", 2, "--size", "8x8", "--quiet", "--tonemap", "filmic")
    for name in ("a.png", "a.exr"):
        assert run(capsys, "render", BOX, "-o", tmp_path / name, *options)[0] == 0
    assert run(capsys, "view", tmp_path / "a.exr", "-o", tmp_path / "b.png", "--exposure", 0, *options[-2:])[0] == 0
    expected = tr.tonemap(tr.io.read_image(tmp_path / "a.exr"), curve="filmic")
    for name in ("a.png", "b.png"):
        assert float((tr.io.read_image(tmp_path / name, raw=True) - expected).abs().max()) < 0.003


def test_further_channels_have_names(capsys, tmp_path):
    path = tmp_path / "a.xml"
    nested = '<integrator type="moment"><integrator type="path"/></integrator>'
    path.write_text(f'<scene version="3.0.0">{nested}<sensor type="perspective"/><emitter type="constant"/></scene>')
    assert run(capsys, "render", path, "-o", tmp_path / "a.exr", "--spp", 2, "--size", "4x4", "--quiet") == (0, "", "")
    assert set(tr.io.read_channels(tmp_path / "a.exr")) == {"R", "G", "B", "m2.R", "m2.G", "m2.B"}


STOKES = """<scene version="3.0.0"><integrator type="stokes"><integrator type="path"/></integrator>
<sensor type="perspective"><transform name="to_world"><lookat origin="0,-3,0" target="0,0,0" up="0,0,1"/></transform>
{film}</sensor><emitter type="constant"/>
<shape type="sphere"><bsdf type="conductor"><string name="material" value="Cr"/></bsdf></shape></scene>"""
BANDS = """<film type="specfilm"><spectrum name="blue" value="450:1, 500:1"/><spectrum name="red" value="600:1, 650:1"/>
</film>"""


@pytest.mark.parametrize(
    ("variant", "film", "colours"), [("rgb", "", "RGB"), ("mono", "", "Y"), ("spectral", BANDS, ("blue", "red"))]
)
def test_stokes_vectors_have_names(capsys, tmp_path, variant, film, colours):
    path, options = tmp_path / "a.xml", ("--spp", 2, "--size", "6x5", "--quiet", "--variant", variant)
    path.write_text(STOKES.format(film=film))
    assert run(capsys, "render", path, "-o", tmp_path / "a.exr", *options) == (0, "", "")
    expected = tr.render(tr.load_file(path, variant=variant), spp=2, seed=0, size=(5, 6))
    assert expected.shape == (5, 6, len(colours), 4) and float(expected[..., 1].abs().max()) > 0.01
    stored = tr.io.read_image(tmp_path / "a.exr", channels=tr.polarization.channel_names(colours))
    assert torch.equal(stored.unflatten(-1, expected.shape[2:]), expected)
    assert set(tr.io.read_channels(tmp_path / "a.exr")) == {f"S{i}.{c}" for i in range(4) for c in colours}
    if variant == "rgb":
        assert run(capsys, "render", path, "-o", tmp_path / "a.pfm", *options) == (0, "", "")
        assert torch.equal(tr.io.read_image(tmp_path / "a.pfm"), expected[..., 0])


def test_bands_have_names(capsys, tmp_path):
    path = tmp_path / "a.xml"
    path.write_text(STOKES.format(film=BANDS).replace("stokes", "direct").replace('<integrator type="path"/>', ""))
    options = ("--spp", 2, "--size", "6x5", "--quiet", "--variant", "spectral")
    assert run(capsys, "render", path, "-o", tmp_path / "a.exr", *options) == (0, "", "")
    assert set(tr.io.read_channels(tmp_path / "a.exr")) == {"blue", "red"}


def test_info_and_convert(capsys, tmp_path):
    status, out, err = run(capsys, "info", BOX)
    assert (status, out, err) == (0, f"{tr.load_file(BOX)}\n", "")
    copy = tmp_path / "folder" / "box.xml"
    assert run(capsys, "convert", BOX, "-o", copy) == (0, f"{copy}\n", "")
    settings = {"spp": 1, "seed": 0, "size": (4, 4)}
    assert torch.equal(tr.render(tr.load_file(copy), **settings), tr.render(tr.load_file(BOX), **settings))


def test_compare(capsys, tmp_path):
    image = torch.full((6, 5, 3), 0.5)
    other = image.clone()
    other[2, 3] = 1.5
    for name, content in (("a", image), ("b", other)):
        tr.io.write_image(tmp_path / f"{name}.exr", content)
    a, b = tmp_path / "a.exr", tmp_path / "b.exr"
    status, out, err = run(capsys, "compare", b, a, "-o", tmp_path / "d.png", "--limit", 0.1)
    assert err == "relative to the second 0.365148: above the limit 0.1\n"
    found = {line[:26].strip(): line[26:] for line in out.splitlines()}
    error = (1 / 30) ** 0.5
    assert status == 1  # beyond the limit
    assert float(found["root mean square error"]) == pytest.approx(error, rel=1e-5)
    assert float(found["relative to the second"]) == pytest.approx(2 * error, rel=1e-5)
    assert float(found["largest difference"]) == 1
    assert float(found["mean difference"]) == pytest.approx(1 / 30, rel=1e-5)
    picture = tr.io.read_image(tmp_path / "d.png", raw=True)
    assert picture.shape == (6, 5, 3) and float(picture[2, 3].min()) > 0.8 and int((picture.sum(-1) > 0).sum()) == 1
    status, _, err = run(capsys, "compare", b, a, "--limit", 0.4)
    assert status == 0 and err == ""
    assert run(capsys, "compare", a, a, "--limit", 0)[0] == 0
    tr.io.write_image(b, image[:3])
    assert run(capsys, "compare", a, b) == (1, "", f"torchrender: {a} is (6, 5, 3), but {b} is (3, 5, 3)\n")


def test_view(capsys, tmp_path):
    tr.io.write_image(tmp_path / "a.exr", torch.linspace(0, 8, 300).reshape(10, 10, 3))
    status, out, _ = run(capsys, "view", tmp_path / "a.exr")
    assert status == 0 and out == f"{tmp_path / 'a.png'} (exposure -2.99 stops)\n"
    assert 0.9 < float(tr.io.read_image(tmp_path / "a.png").max()) <= 1
    run(capsys, "view", tmp_path / "a.png", "--exposure", 0)
    assert (tmp_path / "a_view.png").is_file()


ERRORS = {
    "no file": (("render", "nothing.xml", "-o", "a.png"), 1, "torchrender: load_file: no such file: nothing.xml\n"),
    "no folder": (("render", BOX, "-o", "nowhere/a.png"), 1, "torchrender: path: no such folder: nowhere\n"),
    "format": (("render", BOX, "-o", "a.gif"), 1, "torchrender: a.gif: unknown image format '.gif'"),
    "parameter": (("info", BOX, "-D", "size=3"), 1, "the scene has no parameter $size; known here: max_depth"),
    "definition": (("info", BOX, "-D", "size"), 1, "torchrender: -D: expected NAME=VALUE, got 'size'\n"),
    "camera": (("render", BOX, "-o", "a.png", "--sensor", "x"), 1, "the scene has no camera 'x'"),
    "integrator": (("render", BOX, "-o", "a.png", "--integrator", "pathh"), 1, "did you mean 'path'"),
    "size": (("render", BOX, "-o", "a.png", "--size", "64"), 2, "expected WIDTHxHEIGHT, such as 640x480, got '64'"),
    "samples": (("render", BOX, "-o", "a.png", "--spp", "0"), 2, "expected at least 1, got 0"),
    "samples in words": (("render", BOX, "-o", "a.png", "--spp", "x"), 2, "--spp: expected an integer, got 'x'"),
    "seed": (("render", BOX, "-o", "a.png", "--seed", "1.5"), 2, "--seed: expected an integer, got '1.5'"),
    "exposure": (("view", "a.exr", "--exposure", "x"), 2, "--exposure: expected a number, got 'x'"),
    "command": (("draw",), 2, "invalid choice: 'draw'"),
}


@pytest.mark.parametrize("name", ERRORS)
def test_errors_are_one_sentence(capsys, tmp_path, monkeypatch, name):
    arguments, status, text = ERRORS[name]
    monkeypatch.chdir(tmp_path)
    found, out, err = run(capsys, *arguments)
    assert found == status and out == "" and text in err
    assert status == 2 or err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_interruption(capsys, tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(tr, "render", interrupted)
    assert run(capsys, "render", BOX, "-o", tmp_path / "a.png") == (130, "", "torchrender: interrupted\n")


def test_python_m_torchrender():
    command = [sys.executable, "-m", "torchrender", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == f"torchrender {tr.__version__}\n"


def test_a_reader_that_has_seen_enough():
    command = f"{sys.executable} -m torchrender info {BOX} | head -n 1"
    done = subprocess.run(["bash", "-c", f"set -o pipefail; {command}"], capture_output=True, text=True, check=False)
    assert done.stdout.startswith("Scene, variant rgb") and done.stderr == "" and done.returncode in (0, 141)
