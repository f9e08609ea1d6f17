"""Thousands of iterations in a process of its own: prints JSON with the growth of memory and of time of each case.

Arguments are the names of cases; without any all are run.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable
from statistics import median

import torch
from test_endurance import bumps, make_scene

import torchrender as tr

warnings.simplefilter("ignore", tr.RangeWarning)  # nobody keeps these textures in their range

TEXTURE = "sheet.bsdf.reflectance.data"
POSITIONS = "sheet.vertex_positions"


def resident() -> float:
    """Resident memory of this process in KiB."""
    with open("/proc/self/statm") as statm:
        return int(statm.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1024


def endure(step: Callable[[int], None], iterations: int) -> dict[str, float]:
    """Growth over `iterations`, after a fifth of them that do not count."""
    warmup, seconds = iterations // 5, []
    for i in range(warmup):
        step(i)
    before = resident()
    for i in range(iterations):
        start = time.process_time()
        step(warmup + i)
        seconds.append(time.process_time() - start)
    growth = (resident() - before) / iterations
    third = iterations // 3
    return {"KiB an iteration": growth, "late over early": median(seconds[-third:]) / median(seconds[:third])}


def texture_step() -> dict[str, float]:
    scene = make_scene()
    scene.sheet.bsdf.reflectance.data = torch.full((32, 32, 3), 0.5)
    optimizer = torch.optim.Adam(scene.train_only(TEXTURE), lr=1e-3)

    def step(i: int) -> None:
        optimizer.zero_grad()
        (tr.render(scene, spp=1, seed=i) - 0.5).square().mean().backward()
        optimizer.step()

    return endure(step, 700)


def moving_vertices() -> dict[str, float]:
    scene = make_scene(n=20)
    optimizer = torch.optim.Adam(scene.train_only(TEXTURE), lr=1e-3)
    positions = scene.get_parameter(POSITIONS)
    generator = torch.Generator().manual_seed(0)

    def step(i: int) -> None:
        with torch.no_grad():
            positions.copy_(bumps(20, 0.05 * i)[0])
            if i % 7 == 0:  # the first time a tree is built again
                positions[:, 2] += 0.2 * torch.randn(len(positions), generator=generator)
        optimizer.zero_grad()
        (tr.render(scene, spp=1, seed=i) - 0.5).square().mean().backward()
        optimizer.step()

    result = endure(step, 1500)
    assert scene.updates["mesh_refits"] > 500
    assert scene.updates["mesh_rebuilds"] >= 1
    return result


def builds() -> dict[str, float]:
    def step(i: int) -> None:
        scene = make_scene()
        scene.train_only(TEXTURE)
        tr.render(scene, spp=1, seed=i, crop=(0, 0, 4, 4)).sum().backward()

    return endure(step, 700)


def everything_changes() -> dict[str, float]:
    scene = make_scene()
    world = scene.camera.to_world.detach().clone()

    def step(i: int) -> None:
        size = 4 + 7 * i % 13
        scene.sheet.bsdf.reflectance.data = torch.full((size, size + 1, 3), 0.5)
        vertices, faces, texcoords = bumps(6 + 5 * i % 7)
        scene["sheet"] = tr.Mesh(vertices, faces, vertex_texcoords=texcoords, bsdf=scene.sheet.bsdf)
        with torch.no_grad():
            scene.camera.to_world.copy_(world)
            scene.camera.to_world[0, 3] = 0.01 * (i % 5)
        scene.train_only(TEXTURE)
        crop = (i % 4, i % 5, 4 + i % 5, 6 + i % 3)
        tr.render(scene, spp=1, seed=i, crop=crop).sum().backward()

    return endure(step, 700)


def network_output() -> dict[str, float]:
    scene = make_scene()
    network = torch.nn.Linear(4, 8 * 8 * 3)
    optimizer = torch.optim.SGD(network.parameters(), lr=1e-3)

    def step(i: int) -> None:
        optimizer.zero_grad()
        texture = torch.sigmoid(network(torch.ones(4))).reshape(8, 8, 3)
        tr.render(scene, spp=1, seed=i, params={TEXTURE: texture}).square().mean().backward()
        optimizer.step()

    return endure(step, 700)


def refused() -> dict[str, float]:
    scene = make_scene()

    def step(i: int) -> None:
        try:
            tr.render(scene, spp=1, seed=i, params={TEXTURE: torch.full((8, 8, 3), float("nan"))})
        except ValueError:
            return
        raise AssertionError("a texture that is not finite was rendered")

    return endure(step, 300)


def interrupted(scene: tr.Scene, run: Callable[[], object]) -> dict[str, object]:
    """A Ctrl-C half a second after the start of something that would not end."""
    reference = tr.render(scene, spp=1, seed=0)
    before, sent, peak = resident(), [], []

    def interrupt() -> None:
        for _ in range(10):
            time.sleep(0.05)
            peak.append(resident() - before)
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    try:
        run()
        raise AssertionError("it ended by itself")
    except KeyboardInterrupt:
        stopped = time.perf_counter()
    thread.join()
    return {
        "seconds until it stopped": stopped - sent[0],
        "MiB while running": max(peak) / 1024,
        "same image afterwards": torch.equal(reference, tr.render(scene, spp=1, seed=0)),
    }


def many_samples(derivative: bool, filter_type: str = "box") -> dict[str, object]:
    scene = make_scene()
    film = scene.camera.film
    film.width = film.height = 32
    film.filter = tr.ReconstructionFilter(filter_type)
    scene.train_only(TEXTURE)
    if not derivative:
        return interrupted(scene, lambda: tr.render(scene, spp=10**9, seed=0))
    loss = tr.render(scene, spp=1, spp_grad=10**9, seed=0).sum()
    return interrupted(scene, loss.backward)


def endless_paths() -> dict[str, object]:
    """Inside a white ball, without Russian roulette, no path ends."""
    scene = tr.load_dict(
        {
            "type": "scene",
            "camera": {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 8}},
            "ball": {
                "type": "sphere",
                "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 1.0}},
            },
            "bulb": {"type": "point", "position": [0, 0, 0.5]},
            "integrator": {"type": "path", "max_depth": 4},
        }
    )
    endless = tr.PathTracer(max_depth=-1, rr_depth=10**9)
    return interrupted(scene, lambda: tr.render(scene, spp=4, seed=0, integrator=endless))


def main() -> None:
    torch.set_num_threads(2)
    cases: dict[str, Callable[[], dict]] = {
        "many samples": lambda: many_samples(False),
        "many samples, derivative": lambda: many_samples(True),
        "many samples, derivative, wide filter": lambda: many_samples(True, "gaussian"),
        "endless paths": endless_paths,
        "texture step": texture_step,
        "moving vertices": moving_vertices,
        "builds": builds,
        "everything changes": everything_changes,
        "network output": network_output,
        "refused": refused,
    }
    results = {}
    for name, run in {n: cases[n] for n in sys.argv[1:] or cases}.items():
        start = time.perf_counter()
        results[name] = {**run(), "seconds": round(time.perf_counter() - start, 2)}
    print(json.dumps(results))


if __name__ == "__main__":
    main()
