"""Threads, forks, signals and imports: rendering in the programs that people have."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import fresh_python
import pytest
import torch

import torchrender as tr

ROOT = Path(__file__).resolve().parents[2]

SCENE = """
import torch, torchrender as tr
def make(size=12, **settings):
    return tr.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "camera": {"type": "perspective", "fov": 40.0, "to_world": tr.Transform.look_at([0, 0, 4], [0, 0, 0]),
                   "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}},
        "sky": {"type": "constant"},
        "ball": {"type": "sphere",
                 "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.3, 0.1]}}},
    }, **settings)
"""
namespace: dict = {}
exec(SCENE, namespace)
make = namespace["make"]


def python(code: str, timeout: int = 120, spawns: bool = False) -> str:
    """What `code`, which may use ``make()``, prints in a process of its own; what spawns others is an interpreter."""
    if spawns:
        command = [sys.executable, "-c", SCENE + code]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=timeout)
    else:
        done = fresh_python.run(SCENE + code, timeout=timeout)
    assert done.returncode == 0, done.stderr
    return done.stdout


# --------------------------------------------------------------------------------------------------------- threads
def test_two_scenes_in_two_threads():
    scenes = [make(), make(16)]
    expected = [tr.render(scene, spp=4, seed=7) for scene in scenes]
    failures = []

    def work(i: int) -> None:
        for _ in range(20):
            if not torch.equal(tr.render(scenes[i], spp=4, seed=7), expected[i]):
                failures.append(i)

    run_threads([lambda: work(0), lambda: work(1)])
    assert not failures


def test_one_scene_in_two_threads_with_parameters_of_their_own():
    scene = make()
    name = "ball.bsdf.reflectance.value"
    colours = [torch.tensor([0.1, 0.2, 0.3]), torch.tensor([0.9, 0.5, 0.2])]

    def gradient(colour: torch.Tensor) -> torch.Tensor:
        leaf = colour.clone().requires_grad_()
        tr.render(scene, spp=4, seed=7, params={name: leaf}).square().sum().backward()
        return leaf.grad

    kept = torch.get_num_threads()
    torch.set_num_threads(2)
    expected = [gradient(c) for c in colours]
    torch.set_num_threads(kept)
    failures = []

    def work(i: int) -> None:
        torch.set_num_threads(2)  # torch's number belongs to a thread
        for _ in range(20):
            if not torch.equal(gradient(colours[i]), expected[i]):
                failures.append(i)

    run_threads([lambda: work(0), lambda: work(1)])
    assert not failures


def run_threads(functions) -> None:
    errors = []

    def guarded(function) -> None:
        try:
            function()
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=guarded, args=(f,)) for f in functions]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise errors[0]


def test_first_scene_in_a_thread():
    code = """
import threading
found = []
def work():
    scene = make()
    scene.train_only("ball.bsdf.*")
    image = tr.render(scene, spp=4, seed=1)
    image.sum().backward()
    found.append((scene, image.detach()))
thread = threading.Thread(target=work); thread.start(); thread.join()
scene, image = found[0]
print(torch.equal(tr.render(scene, spp=4, seed=1), image))
"""
    assert python(code) == "True\n"


def test_the_interpreter_is_free_while_it_renders():
    scene = make(64)
    scene.train_only("ball.bsdf.*")
    ticks, stop = [], threading.Event()

    def tick() -> None:
        while not stop.wait(0.002):
            ticks.append(time.perf_counter())

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        begin = time.perf_counter()
        image = tr.render(scene, spp=1024, seed=0)
        middle = time.perf_counter()
        image.sum().backward()
        end = time.perf_counter()
    finally:
        stop.set()
        thread.join()
    for start, finish in ((begin, middle), (middle, end)):
        inside = [t for t in ticks if start < t < finish]
        # 2 ms apart where cores are free; a tenth of that is progress, and impossible while the lock is held.
        assert finish - start > 0.05 and len(inside) >= (finish - start) / 0.02


def test_threads_are_those_of_torch():
    code = """
import os, threading
def native():
    return len(os.listdir("/proc/self/task"))
torch.set_num_threads(1)
before = native()
tr.render(make(64), spp=16)
alone = native() - before
torch.set_num_threads(3)
tr.render(make(64), spp=16)
print(alone, native() - before)
"""
    if not Path("/proc/self/task").exists():
        pytest.skip("counts the threads that Linux lists")
    alone, three = map(int, python(code).split())
    assert alone <= 1 and three <= 3  # the calling thread may wait for signals meanwhile


# ----------------------------------------------------------------------------------------------------------- forks
class Views(torch.utils.data.Dataset):
    """Renders in whatever process asks: what a training set of synthetic pictures does."""

    def __init__(self, scene: tr.Scene) -> None:
        self.scene = scene

    def __len__(self) -> int:
        return 4

    def __getitem__(self, index: int) -> torch.Tensor:
        return tr.render(self.scene, spp=4, seed=index, layout="chw")


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_data_loader_workers(context):
    if context == "fork" and not hasattr(os, "fork"):
        pytest.skip("no fork here")
    code = """
import sys
sys.path[:0] = ["tests/api", "tests/helpers"]
if __name__ == "__main__":
    from test_layer_processes import Views
    scene = make()
    tr.render(scene, spp=4)  # threads and Embree are at work already when the workers start
    here = torch.stack([Views(scene)[i] for i in range(4)])
    workers = 2 if CONTEXT == "fork" else 1
    loader = torch.utils.data.DataLoader(
        Views(scene), batch_size=2, num_workers=workers, multiprocessing_context=CONTEXT)
    print(torch.equal(torch.cat(list(loader)), here))
""".replace("CONTEXT", repr(context))
    assert python(code, spawns=context == "spawn") == "True\n"


def test_gradients_and_shared_memory_in_forked_processes():
    code = """
import os
scene = make()
(colour,) = scene.train_only("ball.bsdf.*")
tr.render(scene, spp=4, seed=1).sum().backward()
expected, colour.grad = colour.grad.clone(), None
statuses = []
for _ in range(2):
    child = os.fork()
    if child == 0:
        # Autograd's own threads do not survive a fork: on the CPU backward() runs in the calling thread.
        tr.render(scene, spp=4, seed=1).sum().backward()
        os._exit(0 if torch.equal(colour.grad, expected) else 1)
    statuses.append(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
tr.render(scene, spp=4, seed=1).sum().backward()
print(statuses, torch.equal(colour.grad, expected))

# Parameters in shared memory: edited by one process, rendered by another.
scene.share_memory()
before = tr.render(scene, spp=4, seed=1)
child = os.fork()
if child == 0:
    with torch.no_grad():
        scene.sky.radiance.value.mul_(2)
    os._exit(0)
os.waitpid(child, 0)
with torch.no_grad():
    scene.sky.radiance.value.add_(0)  # version counters do not cross processes: say here that there was an edit
print(torch.equal(tr.render(scene, spp=4, seed=1), 2 * before))
"""
    if not hasattr(os, "fork"):
        pytest.skip("no fork here")
    assert python(code) == "[0, 0] True\nTrue\n"


# --------------------------------------------------------------------------------------------------------- signals
def test_control_c_within_half_a_second():
    code = """
import os, signal, threading, time
scene = make(64)
(colour,) = scene.train_only("ball.bsdf.*")
before = tr.render(scene, spp=4, seed=1)
for long in ({"spp": 10**8}, {"spp": 4, "spp_grad": 10**8}):
    sent = []
    def interrupt():
        time.sleep(0.3)
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)
    threading.Thread(target=interrupt).start()
    try:
        tr.render(scene, seed=0, **long).sum().backward()
        print("finished")
    except KeyboardInterrupt:
        print(time.perf_counter() - sent[0])
    colour.grad = None
    print(torch.equal(tr.render(scene, spp=4, seed=1), before))
    tr.render(scene, spp=4, seed=1).sum().backward()
    print(bool((colour.grad > 0).all()))
"""
    forward, same, gradient, backward, same_again, gradient_again = python(code, timeout=60).split()
    assert float(forward) < 0.5 and float(backward) < 0.5
    assert {same, gradient, same_again, gradient_again} == {"True"}


# --------------------------------------------------------------------------------------------------------- imports
OTHERS = ["matplotlib.pyplot", "numpy", "kornia", "trimesh", "OpenEXR"]


@pytest.mark.parametrize("order", ["first", "last"])
def test_import_order(order):
    # What others bring along (OpenMP, other standard libraries, Embree) must not disturb, whichever comes first.
    ours, theirs = "import torchrender as tr", "\n".join(f"import {name}" for name in OTHERS)
    lines = [theirs, ours] if order == "first" else [ours, theirs]
    code = (
        "\n".join(lines)
        + SCENE
        + (
            "\nscene = make(); scene.train_only('ball.bsdf.*')"
            "\nimage = tr.render(scene, spp=4, seed=3); image.sum().backward()"
            "\nimport json; print(json.dumps(image.flatten().tolist()))"
        )
    )
    environment = {**os.environ, "MPLBACKEND": "agg"}
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == tr.render(make(), spp=4, seed=3).flatten().tolist()


def test_nothing_is_printed_and_nothing_logged():
    code = """
import logging
logging.basicConfig(level=logging.DEBUG)  # would show what any logger says
scene = make()
scene.train_only("ball.bsdf.*")
for it in tr.progress(range(2), desc="training"):
    tr.render(scene, spp=4, passes=2).sum().backward()
tr.render(scene, sensor=[0, 0], spp=4)
"""
    done = fresh_python.run(SCENE + code)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
