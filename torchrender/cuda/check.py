"""A card beside the CPU, step by step: rays, images and gradients with every BSDF, what repeats, what it costs."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch

from .. import devices
from ..backends import scene_core
from ..integrators import PathTracer
from ..loaders.dict import load_dict, load_file
from ..queries import ray_intersect, ray_occluded
from ..render import render
from ..renderer import Renderer
from ..scene.declaration import models
from ..scene.derivatives import moves_rays
from ..scene.scene import Scene
from ..transform import Transform

FAR = 1e-3
"""Pixels that differ by more than this, relative to their own value and the mean, are counted."""
MOST_FAR = 0.01
"""... and that share of them is allowed: rounding sends a few paths another way."""
MOST_OFF = 0.03
"""Of gradients, relative to their largest number: the same few paths, of which some weigh much.

With the principled BSDF the CPU's packets and single numbers differ by 0.018.
"""

MOST_OFF_IN_DOUBLE = 1e-6
"""... in double precision, in which rounding sends no path another way."""

STEPS = ("versions", "rays", "repeats", "images", "outputs", "gradients", "edges", "double", "moved", "rates")
STEPS += ("kernels", "sanitizers")
OUTPUTS = ("depth", "position", "shading_normal", "uv", "dp_du", "albedo", "roughness", "shape_id")

ROWS = {
    "Cornell box": ("cornell_box.xml", {}),
    "sphere, texture 512": ("textured_sphere.xml", {"texture": "textures/blocks_512.exr"}),
    "sphere, texture 1024": ("textured_sphere.xml", {"texture": "textures/blocks_1024.exr"}),
    "monkey, texture 512": ("textured_monkey.xml", {"texture": "textures/blocks_512.exr"}),
    "monkey, texture 1024": ("textured_monkey.xml", {"texture": "textures/blocks_1024.exr"}),
}

_KERNELS = """
import json, sys
import torchrender as tr
from torchrender.backends import scene_core
from torchrender.cuda.check import train_all
scene = tr.load_file(sys.argv[1], resolution=256, spp=16, **json.loads(sys.argv[2]))
train_all(scene, but_what_moves=True)
for seed in range(3):
    image = tr.render(scene, integrator=tr.PathTracer(max_depth=5, rr_depth=100), spp=16, seed=seed)
    of_image = scene_core().cuda_kernel_times()
    image.sum().backward()
    of_gradient = scene_core().cuda_kernel_times()
print("KERNELS", json.dumps([of_image, of_gradient]))
"""
_SMALL = """
import torch, torchrender as tr
from torchrender.cuda.check import room
scene = tr.load_dict(room({"type": "roughconductor", "alpha": 0.2}, size=16))
tr.render(scene, integrator=tr.PathTracer(max_depth=4), spp=4, seed=1)
scene.train_only("ball.bsdf.alpha.value", "ball.center", "sensor.to_world")
tr.render(scene, integrator=tr.PathTracer(max_depth=4), spp=4, seed=1).sum().backward()
tr.ray_occluded(scene, torch.zeros(100, 3), torch.randn(100, 3))
"""


def room(bsdf: dict[str, Any], size: int = 64) -> dict[str, Any]:
    """A ball of a material over a floor, under a lamp, a point and a sky."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "gaussian"}}
    place = Transform.look_at([0, 1.5, 5.0], [0, 0, 0], [0, 1, 0])
    down = Transform.translate([1, 3, 0]) @ Transform.rotate([1, 0, 0], 90) @ Transform.scale(0.5)
    floor = Transform.translate([0, -1, 0]) @ Transform.rotate([1, 0, 0], -90) @ Transform.scale(4)
    checks = {"type": "checkerboard", "to_uv": Transform.scale(8)}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 5},
        "sensor": {"type": "perspective", "fov": 45, "to_world": place, "film": film},
        "ball": {"type": "sphere", "bsdf": bsdf},
        "block": {"type": "cube", "to_world": Transform.translate([2, -0.5, -1]) @ Transform.scale(0.5)},
        "floor": {"type": "rectangle", "to_world": floor, "bsdf": {"type": "diffuse", "reflectance": checks}},
        "lamp": {"type": "rectangle", "to_world": down, "emitter": {"type": "area", "radiance": 8.0}},
        "spot": {"type": "point", "position": [-2, 2, 2], "intensity": 6.0},
        "sky": {"type": "constant", "radiance": 0.3},
    }


def rooms() -> dict[str, dict[str, Any]]:
    """One with each BSDF, one with a height field and a grid of distances, one that light paths light, two with media.

    These are a cloud, and a coloured ball that glows.
    """
    found = {kind: room({"type": kind}) for kind in _plain_bsdfs()}
    place = Transform.translate([-2, -0.5, 0]) @ Transform.rotate([1, 0, 0], -70) @ Transform.scale(0.8)
    waves = {"type": "heightfield", "heights": torch.sin(torch.arange(600.0)).reshape(20, 30) * 0.1, "to_world": place}
    z, y, x = torch.meshgrid(*(torch.linspace(-1, 1, n) for n in (12, 15, 18)), indexing="ij")
    distance = (x * x + y * y + z * z).sqrt() - 0.7 + 0.1 * torch.sin(5 * x + 3 * y)
    blob = {"type": "sdfgrid", "grid": distance[..., None], "to_world": Transform.translate([0.5, -1, 1])}
    found["heightfield"] = {**room({"type": "diffuse"}), "waves": waves, "blob": blob}
    found["light"] = {**room({"type": "plastic"}), "integrator": {"type": "ptracer", "max_depth": 5}}
    density = {"type": "gridvolume", "data": torch.sin(torch.arange(210.0)).reshape(5, 6, 7).relu(), "raw": True}
    density["to_world"] = Transform.translate([-1, -1, -1]) @ Transform.scale(2)
    forward = {"type": "hg", "g": 0.5}
    cloud = {"type": "heterogeneous", "sigma_t": density, "scale": 4.0, "albedo": 0.8, "phase": forward}
    colors = {"type": "rgb", "value": [0.3, 1.0, 2.0]}
    glowing = {"type": "homogeneous", "sigma_t": colors, "albedo": 0.7, "emission": 0.2}
    for name, medium in (("cloud", cloud), ("glow", glowing)):
        within = room({"type": "null"})
        within["ball"]["interior"] = medium
        found[name] = {**within, "integrator": {"type": "volpath", "max_depth": 8}}
    return found


def train_all(scene: Scene, but_what_moves: bool = False) -> list[str]:
    """Every parameter is to have a gradient, or those that do not move rays; returns their names."""
    slots = {slot.name: slot for slot in scene.layout().slots}
    names = [
        name
        for name, _ in scene.named_parameters()
        if not slots[name].refusal and not (but_what_moves and moves_rays(slots[name]))
    ]
    scene.train_only(*names)
    return names


@contextlib.contextmanager
def deterministic_algorithms(on: bool) -> Iterator[None]:
    """Whether torch is asked for them, inside."""
    before = torch.are_deterministic_algorithms_enabled(), torch.is_deterministic_algorithms_warn_only_enabled()
    torch.use_deterministic_algorithms(on)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before[0], warn_only=before[1])


class Check:
    """The report, and whether everything in it passed."""

    def __init__(self, card: str, out: Path, commit: str, only: Sequence[str] = STEPS) -> None:
        self.card, self.out, self.commit, self.only, self.good = card, out, commit, only, True
        self.report: dict[str, Any] = {}

    def step(self, name: str, work: Callable[[], dict[str, Any]]) -> None:
        if name not in self.only:
            return
        begin = time.perf_counter()
        try:
            found = work()
        except Exception as error:  # the others are still worth knowing
            traceback.print_exc()
            found = {"passed": False, "error": f"{type(error).__name__}: {error}"[:2000]}
        self.good = self.good and found.get("passed", True)
        self.report[name] = {**found, "seconds": round(time.perf_counter() - begin, 2)}
        self.report["passed"] = self.good
        self.out.write_text(json.dumps(self.report, indent=1) + "\n")
        said = "done" if "passed" not in found else "passed" if found["passed"] else "FAILED"
        print(f"{name}: {said} ({self.report[name]['seconds']} s)", flush=True)

    def both(self, call: Callable[[], Any]) -> tuple[Any, Any]:
        """What the CPU finds in the card's tree, and what the card finds."""
        with devices.chosen("tree"):
            expected = call()
        return expected, call()

    def versions(self) -> dict[str, Any]:
        core = scene_core()
        name = _said(["nvidia-smi", "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader"])
        sources = hashlib.sha256()
        for path in sorted(p for part in ("core", "device") for p in (devices.kernels() / part).rglob("*.*")):
            sources.update(path.read_bytes())
        return {
            "date": time.strftime("%Y-%m-%d"),
            "commit": self.commit,
            "kernels": sources.hexdigest(),
            "card": name,
            "machine": f"{platform.machine()}, {os.cpu_count()} processors",
            "torch": torch.__version__,
            "python": platform.python_version(),
            "cuda": devices.report(core)["cuda"],
        }

    def rays(self) -> dict[str, Any]:
        scene = load_dict(rooms()["heightfield"])
        generator = torch.Generator().manual_seed(1)
        o = 3 * torch.randn(300_000, 3, generator=generator)
        d = torch.randn(300_000, 3, generator=generator) - o
        a, b = self.both(lambda: ray_intersect(scene, o, d))
        hidden = [x.double().mean().item() for x in self.both(lambda: ray_occluded(scene, o, d))]
        same = {name: (getattr(a, name) == getattr(b, name)).double().mean().item() for name in ("t", "shape_id")}
        return {"passed": min(same.values()) > 0.9999 and hidden[0] == hidden[1], "same": same, "occluded": hidden}

    def images(self) -> dict[str, Any]:
        """`rooms`, with the CPU's walk through the same tree: equal but for the rounding of elementary functions."""
        found, passed = {}, True
        for kind, described in rooms().items():
            scene = load_dict(described)
            a, b = self.both(lambda scene=scene: render(scene, spp=16, seed=3))
            again = render(scene, spp=16, seed=3)
            far = ((a - b).abs() > FAR * (a.abs() + a.mean())).any(-1).double().mean().item()
            off = (b.mean() / a.mean() - 1).item()
            found[kind] = {"far": far, "mean off by": off, "repeats": torch.equal(b, again)}
            passed = passed and far <= MOST_FAR and abs(off) < 1e-3 and torch.equal(b, again)
        return {"passed": passed, "images": found}

    def outputs(self) -> dict[str, Any]:
        """Of first hits, and their gradients by all parameters, relative to the largest numbers; the same twice."""
        scene = load_dict(room({"type": "principled"}))
        names = train_all(scene)

        def values() -> list[torch.Tensor]:
            found = render(scene, outputs=OUTPUTS, spp=16, seed=3, visibility=False)
            shown = [torch.where(x.isfinite(), x, 0.0) for x in found]
            weighted = [x * torch.linspace(0.5, 1.5, x.numel()).reshape(x.shape) for x in shown[:-1]]
            loss = torch.cat([x.flatten() for x in weighted]).sum()
            of = torch.autograd.grad(loss, [scene.get_parameter(n) for n in names], allow_unused=True)
            return [*(x.detach().float() for x in shown), *(g for g in of if g is not None)]

        expected, got = self.both(values)
        with deterministic_algorithms(True):
            repeats = all(torch.equal(a, b) for a, b in zip(values(), values(), strict=True))
        off = _off(expected, got)
        return {"passed": off < MOST_OFF and repeats, "off by": off, "of": len(got), "repeats": repeats}

    def gradients(self) -> dict[str, Any]:
        """Of `rooms`, by all parameters: the largest difference from the CPU's, of its largest number.

        Of what moves, whose gradients cancel, of the largest number of those; without edges, see `edges`.
        """
        found, passed = {}, True
        for kind, described in rooms().items():
            scene = load_dict(described)
            names = train_all(scene)

            def gradients(scene: Scene = scene, names: list[str] = names) -> list[torch.Tensor]:
                image = render(scene, spp=16, seed=3, visibility=False)
                weights = torch.linspace(0.5, 1.5, image.numel()).reshape(image.shape)
                return list(torch.autograd.grad((image * weights).sum(), [scene.get_parameter(n) for n in names]))

            expected, got = self.both(gradients)
            size = {name: a.abs().max().item() for name, a in zip(names, expected, strict=True)}
            moves = {slot.name for slot in scene.layout().slots if moves_rays(slot)}
            moved = max(size[name] for name in names if name in moves)
            off = {
                name: (b - a).abs().max().item() / (moved if name in moves else size[name])
                for name, a, b in zip(names, expected, got, strict=True)
                if size[name] > 0
            }
            worst = max(off, key=lambda name: off[name])
            found[kind] = {"off by": off[worst], "in": worst, "of": len(off)}
            passed = passed and all(x < MOST_OFF for x in off.values())  # which NaN is not, but may not be the worst
        return {"passed": passed, "gradients": found}

    def edges(self) -> dict[str, Any]:
        """What edges add to gradients by what moves them, of some of `rooms`, as in `gradients`; the same twice.

        Of images, of light paths and through a cloud, too, and of an output besides.
        """
        found, passed, described = {}, True, rooms()
        images = ("diffuse", "roughplastic", "dielectric", "heightfield", "light", "cloud")
        for kind, output in (*((image, "rgb") for image in images), ("diffuse", "albedo")):
            scene = load_dict(described[kind])
            moving = {slot.name for slot in scene.layout().slots if moves_rays(slot)}
            names = [name for name in train_all(scene) if name in moving]
            scene.train_only(*names)

            def gradients(scene: Scene = scene, names: list[str] = names, output: str = output) -> list[torch.Tensor]:
                off = []
                for edges in (True, False):
                    (seen,) = render(scene, spp=4, spp_grad=16, seed=3, outputs=(output,), visibility=edges)
                    off.append(torch.autograd.grad(seen.square().sum(), [scene.get_parameter(n) for n in names]))
                return [a - b for a, b in zip(*off, strict=True)]

            expected, got = self.both(gradients)
            with deterministic_algorithms(True):
                repeats = all(torch.equal(a, b) for a, b in zip(gradients(), gradients(), strict=True))
            largest = max(a.abs().max().item() for a in expected)
            off = {n: (b - a).abs().max().item() / largest for n, a, b in zip(names, expected, got, strict=True)}
            worst = max(off, key=lambda name: off[name])
            told = kind if output == "rgb" else f"{output} of {kind}"
            found[told] = {"off by": off[worst], "in": worst, "of": len(off), "repeats": repeats}
            passed = passed and repeats and all(x < MOST_OFF for x in off.values())
        return {"passed": passed, "edges": found}

    def double(self) -> dict[str, Any]:
        """Images and their gradients by all parameters in double precision, without edges, as those of `gradients`."""
        off, described = {}, rooms()
        for kind in ("principled", "light", "cloud"):
            scene = load_dict(described[kind], dtype=torch.float64)
            parameters = [scene.get_parameter(name) for name in train_all(scene)]

            def values(scene: Scene = scene, parameters: list[torch.nn.Parameter] = parameters) -> list[torch.Tensor]:
                image = render(scene, spp=8, seed=3, visibility=False)
                return [image.detach(), *torch.autograd.grad(image.square().sum(), parameters)]

            off[kind] = _off(*self.both(values))
        return {"passed": all(x < MOST_OFF_IN_DOUBLE for x in off.values()), "off by": off}

    def moved(self, place: str | None = None, size: int = 64) -> dict[str, Any]:
        """A scene that lies on the card (or at `place`): images and gradients, also of changed numbers, bit for bit.

        It has textures and a sky, which stay there. Also on a stream of its own, and the seconds that it takes to get
        an image and gradients, beside a scene on the CPU, by the same card.
        """
        place = place or self.card
        if place.startswith("cuda") and not torch.cuda.is_available():
            return {"none": "this PyTorch has no CUDA"}
        generator = torch.Generator().manual_seed(1)
        texels = [{"type": "bitmap", "raw": True, "data": torch.rand(64, 64, 3, generator=generator)} for _ in "ab"]
        given = room({"type": "plastic", "diffuse_reflectance": texels[0]}, size=size)
        given["lamp"]["emitter"]["radiance"] = texels[1]
        given["sky"] = {"type": "envmap", "bitmap": torch.rand(16, 32, 3, generator=generator)}
        found, seconds = [], {}
        for lies in ("cpu", place):
            with devices.chosen("" if lies == self.card else self.card), deterministic_algorithms(True):
                scene = load_dict(given, device=lies)
                parameters = [scene.get_parameter(name) for name in train_all(scene, but_what_moves=True)]

                def image(seed: int, scene: Scene = scene) -> torch.Tensor:
                    scene.zero_grad()
                    rendered = render(scene, spp=16, seed=seed)
                    rendered.sum().backward()
                    return rendered.detach()

                seconds[lies] = _median(image, 3)
                values = [image(3), *(p.grad.clone() for p in parameters if p.grad is not None)]
                with torch.no_grad():
                    for parameter in parameters:
                        parameter.mul_(0.5)  # a step of an optimiser would round otherwise
                values.append(image(4))
                stream = torch.cuda.Stream() if lies.startswith("cuda") else None
                with torch.cuda.stream(stream):
                    values.append(image(5) + 0)
                if stream is not None:
                    torch.cuda.current_stream().wait_stream(stream)
                found.append([*values, *(p.grad.clone() for p in parameters if p.grad is not None)])
        same = all(b.device == torch.device(place) and torch.equal(b.to("cpu"), a) for a, b in zip(*found, strict=True))
        return {"passed": same, "of": len(found[0]), "seconds": seconds}

    def repeats(self) -> dict[str, Any]:
        """Equal bits in parts of a film, with lists of pixels, and in batches: 512 samples of these pixels are many."""
        scene = load_dict(room({"type": "roughplastic"}, size=128))
        settings = {"integrator": PathTracer(max_depth=5), "spp": 128, "seed": 3}
        whole = render(scene, **settings)
        part = render(scene, crop=(20, 30, 40, 50), **settings)
        pixels = torch.tensor([[3, 4], [100, 7], [64, 64]])
        listed = render(scene, pixels=pixels, **settings)
        same = torch.equal(part, whole[20:60, 30:80]) and torch.equal(listed, whole[pixels[:, 0], pixels[:, 1]])
        digest = hashlib.sha256(whole.numpy().tobytes()).hexdigest()
        return {"passed": same and torch.equal(whole, render(scene, **settings)), "image": digest}

    def rates(self, scenes: Path) -> dict[str, Any]:
        """Seconds, warm, whole calls: images of 256 x 256 pixels and 16 samples, with gradients, of 1024 x 1024 and 64.

        Gradients are those by everything that does not move.
        """
        found = {}
        for name, (file, arguments) in ROWS.items():
            begin = time.perf_counter()
            scene = load_file(scenes / file, resolution=256, spp=16, **arguments)
            renderer = Renderer(scene, integrator=PathTracer(max_depth=5, rr_depth=100), spp=16)
            with torch.no_grad():
                renderer(seed=0)
                first = time.perf_counter() - begin
                small = _median(lambda seed, renderer=renderer: renderer(seed=seed), 30)
                large = _median(lambda seed, renderer=renderer: renderer(seed=seed, spp=64, size=(1024, 1024)), 3)
            rays = scene.statistics["render"]
            count = rays["closest_rays"] + rays["shadow_rays"]
            found[name] = {"first": first, "small": small, "large": large, "rays a second, large": count / large}
            train_all(scene, but_what_moves=True)
            found[name]["small with gradient"] = _median(lambda seed, r=renderer: r(seed=seed).sum().backward(), 30)
            if self.card.startswith("cuda") and torch.cuda.is_available():
                renderer.to(self.card)
                there = _median(lambda seed, r=renderer: r(seed=seed).sum().backward(), 30)
                found[name]["small with gradient, on the card"] = there
        return found

    def kernels(self, scenes: Path) -> dict[str, Any]:
        """Milliseconds of kernels, 256 x 256 pixels of 16 samples, waiting after every launch: images, gradients."""
        found = {}
        for name in ("Cornell box", "monkey, texture 512"):
            file, arguments = ROWS[name]
            out = self._run([sys.executable, "-c", _KERNELS, str(scenes / file), json.dumps(arguments)])
            line = next(line for line in out.splitlines() if line.startswith("KERNELS "))
            times = json.loads(line.removeprefix("KERNELS "))
            for what, of in zip(("image", "gradient"), times, strict=True):
                each = {kernel: [int(n), round(1e3 * seconds, 3)] for kernel, (n, seconds) in of.items()}
                found[f"{name}, {what}"] = each
        return found

    def sanitizers(self) -> dict[str, Any]:
        tool = shutil.which("compute-sanitizer")
        if tool is None:
            return {"none": "there is no compute-sanitizer"}
        found = {}
        for kind in ("memcheck", "racecheck", "initcheck", "synccheck"):
            out = self._run([tool, "--tool", kind, "--error-exitcode", "7", sys.executable, "-c", _SMALL])
            found[kind] = next((line for line in reversed(out.splitlines()) if "SUMMARY" in line), "no summary")
        return {"passed": all("0 errors" in line or "0 hazards" in line for line in found.values()), **found}

    def _run(self, command: list[str]) -> str:
        environment = {**os.environ, "TORCHRENDER_BACKEND": self.card, "TORCHRENDER_CUDA_SYNC": "1"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240, check=False)
        if done.returncode not in (0, 7):
            raise RuntimeError(f"{command[0]} returned {done.returncode}: {(done.stdout + done.stderr)[-1500:]}")
        return done.stdout


def _plain_bsdfs() -> list[str]:
    wrappers = ("twosided", "blendbsdf", "mask", "normalmap", "bumpmap")
    return sorted(name for category, name in models() if category == "bsdf" and name not in wrappers)


def _said(command: list[str]) -> str | None:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=30, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def _off(expected: Sequence[torch.Tensor], got: Sequence[torch.Tensor]) -> float:
    """The largest difference of one of these, relative to its largest number; NaN where there is one."""
    pairs = zip(expected, got, strict=True)
    return torch.stack([((b - a).abs().max() / a.abs().max().clamp(min=1e-30)).double() for a, b in pairs]).max().item()


def _median(call: Callable[[int], object], n: int) -> float:
    times = []
    for seed in range(n):
        begin = time.perf_counter()
        call(seed)
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def check(card: str, out: Path, scenes: Path, commit: str, only: Sequence[str] = STEPS) -> bool:
    """Whether everything passed on this card (``"cuda:0"``), or these steps; the report is in `out`."""
    run = Check(card, out, commit, only)
    with devices.chosen(card):
        run.step("versions", run.versions)
        run.step("rays", run.rays)
        run.step("repeats", run.repeats)
        run.step("images", run.images)
        run.step("outputs", run.outputs)
        run.step("gradients", run.gradients)
        run.step("edges", run.edges)
        run.step("double", run.double)
        run.step("moved", run.moved)
        if scenes.is_dir():
            run.step("rates", lambda: run.rates(scenes))
            run.step("kernels", lambda: run.kernels(scenes))
        run.step("sanitizers", run.sanitizers)
    return run.good
