"""Which device is chosen, what is said of CUDA, and that nothing of it is loaded before it is asked for."""

from __future__ import annotations

import functools
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import fresh_python
import pytest
import small_scene
import torch

import torchrender as tr
from torchrender import backends, devices
from torchrender.scene.gather import check_place

ROOT = Path(__file__).resolve().parents[2]
ALONE = "ray queries, images and their derivatives (tr.ray_intersect, tr.ray_occluded, tr.render)"

# A driver that says its version, and has all functions that are looked for. As a process's NVRTC it says another.
FAKE = """
#include <cstdlib>
extern "C" int cuDriverGetVersion(int *version) { return *version = std::atoi(std::getenv("FAKE_CUDA")), 0; }
extern "C" int nvrtcVersion(int *major, int *minor) { return *major = 12, *minor = 8, 0; }
#define FUNCTION(name) extern "C" int name() { std::abort(); }
"""


VARIABLES = {k: v for k, v in os.environ.items() if not k.startswith("TORCHRENDER_")}


@pytest.fixture
def unchosen(monkeypatch):
    monkeypatch.setattr(devices, "_chosen", None)
    monkeypatch.delenv("TORCHRENDER_BACKEND", raising=False)
    monkeypatch.delenv("TORCHRENDER_NVRTC", raising=False)
    return monkeypatch


def test_the_cpu_is_used_unless_another_device_is_chosen(unchosen):
    assert backends.device() == "cpu"
    report = backends.devices()
    assert list(report) == ["cpu", "emulated", "cuda"]
    assert report["cpu"] == "used for everything"
    assert report["emulated"].endswith(f"has {ALONE}; TORCHRENDER_BACKEND=emulated chooses it")
    unchosen.setenv("TORCHRENDER_BACKEND", "emulated")
    assert backends.device() == "cpu"  # it was read


def test_the_emulated_device_is_chosen_by_a_variable(unchosen, capsys):
    unchosen.setenv("TORCHRENDER_BACKEND", " emulated ")
    assert backends.device() == "emulated"
    report = backends.devices()
    assert report["cpu"] == "not used, by TORCHRENDER_BACKEND=emulated; without it everything runs here"
    assert report["emulated"] == f"used by TORCHRENDER_BACKEND, has {ALONE} so far"
    text = tr.show_config()
    assert capsys.readouterr().out.strip() == text
    for name, sentence in report.items():
        assert f"\n{name:<12}{sentence}" in text and "\n" not in sentence


@pytest.mark.parametrize("name", ["gpu", "cuda:", "cuda:one", "tree"])
def test_other_devices_are_refused(unchosen, capsys, name):
    unchosen.setenv("TORCHRENDER_BACKEND", name)
    scene = tr.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    sentence = f"TORCHRENDER_BACKEND: expected cpu, emulated, cuda or cuda:NUMBER, got {name!r}"
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        tr.ray_intersect(scene, torch.zeros(1, 3), torch.ones(1, 3))
    assert f"problem     {sentence}" in tr.show_config()
    capsys.readouterr()


def test_tensors_elsewhere_than_the_scene_are_refused():
    scene = tr.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    for place in ("cuda:1", "meta"):
        tensor = SimpleNamespace(device=torch.device(place))
        sentence = f"ball.radius: lies on {place}, but the scene on cpu: use .to('cpu')"
        with pytest.raises(ValueError, match=re.escape(sentence)):
            check_place(scene, "ball.radius", tensor)
    with pytest.raises(ValueError, match=r"load_dict: device: PyTorch has no 'cuda:99' here: \w+"):
        tr.load_dict({"type": "scene"}, device="cuda:99")


def test_a_card_computes_the_scenes_that_lie_on_it(unchosen):
    card = torch.device("cuda:1")
    assert (devices.device(card), devices.device()) == ("cuda:1", "cpu")
    scenes = [tr.load_dict(small_scene.ball_and_wall(), variant=variant) for variant in ("spectral", "rgb")]
    for scene in scenes:
        scene._device = card  # there may be none to bring it to
    sentence = "render: a scene on cuda:1 does not have spectral scenes yet, but those in rgb and mono; with "
    with pytest.raises(RuntimeError, match=f"^{sentence}TORCHRENDER_BACKEND=cpu everything is there$"):
        tr.render(scenes[0], spp=1)
    unchosen.setenv("TORCHRENDER_NVRTC", "/nowhere/libnvrtc.so")
    # (an image would need memory of the card's)
    depth = functools.partial(tr.render, scenes[1], outputs=("depth",), spp=1)
    for function in (depth, lambda: tr.ray_occluded(scenes[1], [[0, 0, 3]], [[0, 0, 1]])):
        with pytest.raises(RuntimeError, match=r"NVRTC|driver"):
            function()
    with devices.chosen("cpu"):
        assert devices.device(card) == "cpu"


def test_a_process_of_its_own_and_its_children():
    code = """
import os, torch
def cuda():  # libraries of it in this process
    maps = open("/proc/self/maps") if os.path.exists("/proc/self/maps") else ()
    return {line.split("/")[-1] for line in maps if "cuda.so" in line or "nvrtc" in line}
before = cuda()
import torchrender as tr
camera = {"type": "perspective", "to_world": tr.Transform.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])}
camera["film"] = {"type": "hdrfilm", "width": 4, "height": 4}
shapes = {"ball": {"type": "sphere"}, "floor": {"type": "rectangle"}}
scene = tr.load_dict({"type": "scene", "camera": camera, "sky": {"type": "constant"}, **shapes})
o, d = torch.tensor([[0.0, 0.1, 3.0], [0.9, 0.9, 3.0], [3.0, 3.0, 3.0]]), torch.tensor([[0.0, 0.0, -1.0]]).expand(3, 3)
first = tr.ray_intersect(scene, o, d)
image = tr.render(scene, spp=2, seed=1)
print(first.shape_id.tolist(), tr.ray_occluded(scene, o, d).tolist(), cuda() == before, tr.backends.device())
print(bool(image.any()))
for moved in (False, True):
    child = os.fork()
    if child == 0:
        params = {"ball.radius": torch.tensor(2.0)} if moved else None
        again = tr.ray_intersect(scene, o, d, params=params)
        good = again.shape_id.tolist() == [0, 0, -1] if moved else torch.equal(again.t, first.t)
        good = good and torch.equal(tr.render(scene, spp=2, seed=1, params=params), image) != moved
        del scene
        os._exit(0 if good else 1)
    print(os.waitpid(child, 0)[1])
print(torch.equal(tr.ray_intersect(scene, o, d).t, first.t))
"""
    done = fresh_python.run(code, VARIABLES | {"TORCHRENDER_BACKEND": "emulated"})
    assert done.returncode == 0, done.stderr
    out = done.stdout.splitlines()
    assert out == ["[0, 1, -1] [True, True, False] True emulated", "True", "0", "0", "True"]


def test_nvrtc_is_looked_for_in_packages_before_the_system(unchosen, tmp_path):
    library = tmp_path / "nvidia" / "cuda_nvrtc" / "lib"
    newer = tmp_path / "nvidia" / "cu13" / "lib"
    for folder, names in ((library, ["libnvrtc.so.12", "libnvrtc-builtins.so.12.2"]), (newer, ["libnvrtc.so.13"])):
        folder.mkdir(parents=True)
        for name in names:
            (folder / name).write_bytes(b"not a library")
    unchosen.syspath_prepend(tmp_path)
    found = list(devices.nvrtc_candidates())
    paths = [str(newer / "libnvrtc.so.13"), str(library / "libnvrtc.so.12")]
    assert found.index(paths[0]) < found.index(paths[1])
    assert found[-2:] == ["libnvrtc.so.13", "libnvrtc.so.12"]
    unchosen.setenv("TORCHRENDER_NVRTC", paths[1])
    assert list(devices.nvrtc_candidates()) == [paths[1]]
    assert f"; NVRTC at {paths[1]} cannot be loaded (" in backends.devices()["cuda"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the driver's library has another name there")
def test_what_there_is_of_cuda_is_said(unchosen, tmp_path):
    compiler = shutil.which("c++")
    if compiler is None:
        pytest.skip("there is no compiler, which makes the driver of this test")
    # the functions that are looked for
    declared = [
        line.split('"')[1] for line in (ROOT / "csrc/device/driver_api.h").read_text().splitlines() if ', "cu' in line
    ]
    compiled = "CreateProgram CompileProgram GetProgramLogSize GetProgramLog DestroyProgram"
    compiled += " GetCUBINSize GetCUBIN GetPTXSize GetPTX"
    names = [*declared, *(f"nvrtc{name}" for name in compiled.split())]
    source = FAKE + "\n".join(f"FUNCTION({name})" for name in names if name != "cuDriverGetVersion")
    (tmp_path / "fake.cpp").write_text(source)
    library = tmp_path / "libcuda.so.1"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, tmp_path / "fake.cpp"], check=True, timeout=60)
    code = """
import os, torchrender as tr
for version in ("11080", "12020"):
    os.environ["FAKE_CUDA"] = version
    print(tr.backends.devices()["cuda"])
"""
    none = f"has {ALONE}; scene.to('cuda') or TORCHRENDER_BACKEND=cuda chooses it; "
    nvrtc = f"NVRTC 12.8 at {library}"
    variables = VARIABLES | {"LD_LIBRARY_PATH": str(tmp_path), "TORCHRENDER_NVRTC": str(library)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    out = done.stdout.splitlines()
    old = "the NVIDIA driver is made for CUDA 11.8, expected at least 12.0; install driver 525 or newer"
    assert out == [f"{none}{old}; there is {nvrtc}", f"{none}there is an NVIDIA driver for CUDA 12.2; there is {nvrtc}"]


def test_a_card_that_is_chosen_is_asked_for(unchosen):
    unchosen.setenv("TORCHRENDER_BACKEND", "cuda")
    assert backends.device() == "cuda:0"
    with devices.chosen("cpu"):
        assert backends.device() == "cpu"
    report = backends.devices()
    assert report["cpu"] == "not used, by TORCHRENDER_BACKEND=cuda:0; without it everything runs here"
    assert report["cuda"].startswith(f"used by TORCHRENDER_BACKEND, has {ALONE} so far; ")
    unchosen.setenv("TORCHRENDER_NVRTC", "/nowhere/libnvrtc.so")
    unchosen.setattr(devices, "_with_compiler", set())
    scene = tr.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    with pytest.raises(RuntimeError, match=r"^NVRTC at /nowhere/libnvrtc\.so cannot be loaded"):
        tr.ray_occluded(scene, torch.zeros(1, 3), torch.ones(1, 3))


def test_kernels_are_compiled_from_the_sources_that_the_core_is_made_of():
    assert (devices.kernels() / "device" / "path_kernels.h").is_file()
    assert (devices.kernels() / "core" / "integrator" / "surface.cpp").is_file()


def test_the_page_claims_what_was_found_on_a_card():
    path = max((ROOT / "bench" / "device").glob("*.json"))
    found = json.loads(path.read_text())
    page = (ROOT / "docs" / "cuda.md").read_text()
    for step, of in found.items():  # what did not pass is said
        assert not isinstance(of, dict) or of.get("passed", True) or f"The step `{step}` did not pass" in page
    assert path.name in page
    card, driver = found["versions"]["card"].split(", ")[:2]
    assert card in page
    assert driver in page
    for name, rates in found["rates"].items():
        if name == "seconds":
            continue
        assert f"\n| {name} | {rates['small']:.4f} |" in page
        row = page.split(f"\n| {name} |")[1].splitlines()[0]
        assert f"| {rates['small with gradient']:.4f} | {rates['large']:.2f} |" in row
