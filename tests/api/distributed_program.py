"""Run by torchrun: every case by all processes, of which the first prints what each found as JSON.

A case renders alone and by the group, and returns numbers that `test_distributed.py` judges.
"""

from __future__ import annotations

import datetime
import json
import os
import sys
import traceback
import warnings
from collections.abc import Callable
from typing import Any

import torch
import torch.distributed as dist
import torch.nn.functional
from torch.autograd import forward_ad

import torchrender as tr

SIZE = 20


def room(**settings: Any) -> tr.Scene:
    """A textured sheet, a ball that covers part of it, a lamp and a sky."""
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE + 3, "rfilter": {"type": "box"}}
    camera = {"type": "perspective", "fov": 40, "to_world": tr.Transform.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0])}
    texture = {"type": "bitmap", "data": torch.rand(4, 4, 3, generator=torch.Generator().manual_seed(0))}
    paper = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": texture}}
    lamp = {"type": "rectangle", "to_world": tr.Transform.translate([0, 2, 1]).rotate([1, 0, 0], 90).scale(0.5)}
    scene = tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "camera": {**camera, "film": film},
            "sky": {"type": "constant", "radiance": 0.3},
            "sheet": {"type": "rectangle", "bsdf": paper},
            "ball": {"type": "sphere", "radius": 0.5, "center": [0.3, 0, 0.8]},
            "lamp": {**lamp, "emitter": {"type": "area", "radiance": 3.0}},
        },
        **settings,
    )
    scene.train_only("sheet.bsdf.*.data", "lamp.emitter.*", "ball.center")
    return scene


def of_filter(kind: str) -> Callable[[], tr.Scene]:
    def make() -> tr.Scene:
        scene = room()
        scene.camera.film.filter = tr.ReconstructionFilter(kind)
        return scene

    return make


def spectral() -> tr.Scene:
    return room(variant="spectral")


def outputs_of(found: Any) -> list[torch.Tensor]:
    return list(found) if isinstance(found, tuple) else [found]


def difference(found: torch.Tensor, expected: torch.Tensor) -> float:
    """The largest one, relative to the largest number; infinite numbers have to be the same."""
    found, expected = found.detach(), expected.detach()
    if not found.is_floating_point():
        return float((found != expected).sum())
    finite = torch.isfinite(expected)
    if found.shape != expected.shape or not torch.equal(finite, torch.isfinite(found)):
        return float("inf")
    if not bool(finite.any()):
        return 0.0
    scale = expected[finite].abs().max().clamp(min=1e-30)
    return float((found[finite] - expected[finite]).abs().max() / scale)


def gradients(scene: tr.Scene, images: list[torch.Tensor]) -> list[torch.Tensor]:
    """Of a loss that no output leaves out, by the parameters."""
    scene.zero_grad()
    generator = torch.Generator().manual_seed(7)
    loss = torch.zeros(())
    for image in images:
        if image.requires_grad:
            weight = torch.rand(image.shape, generator=generator)
            loss = loss + (torch.where(torch.isfinite(image), image, 0.0) * weight).sum()
    loss.backward()
    return [p.grad for p in scene.parameters() if p.grad is not None]


def like_alone(make: Callable[[], tr.Scene], group: Any, split: str = "samples", **settings: Any) -> dict[str, float]:
    """How far image and gradient of the group are from those of one process."""
    scene = make()
    settings = {"spp": 7, "spp_grad": 5, "seed": 3, **settings}
    alone = outputs_of(tr.render(scene, **settings))
    expected = gradients(scene, alone)
    shared = outputs_of(tr.distributed.render(scene, group=group, split=split, **settings))
    found = gradients(scene, shared)
    assert len(found) == len(expected) > 0
    return {
        "image": max(difference(a.detach(), b.detach()) for a, b in zip(shared, alone, strict=True)),
        "gradient": max(difference(a, b) for a, b in zip(found, expected, strict=True)),
        "size": max(float(g.abs().max()) for g in expected),
    }


def tiles_like_alone(make: Callable[[], tr.Scene], group: Any, **settings: Any) -> dict[str, float]:
    """Without outlines, of which every tile has samples of its own."""
    return like_alone(make, group, "tiles", visibility=False, **settings)


def features(group: Any) -> dict[str, float]:
    learned = torch.rand(3, 3, 5, generator=torch.Generator().manual_seed(1)).requires_grad_()
    scene = room()
    found = []
    for render in (tr.render, lambda *a, **k: tr.distributed.render(*a, group=group, **k)):
        image = render(scene, outputs=("features",), features={"sheet": learned}, spp=7, spp_grad=5, seed=2).features
        (gradient,) = torch.autograd.grad(image.square().sum(), learned)
        found.append((image.detach(), gradient))
    (image, gradient), (shared, of_shared) = found
    size = float(gradient.abs().max())
    return {"image": difference(shared, image), "gradient": difference(of_shared, gradient), "size": size}


def forward_mode(group: Any) -> dict[str, float]:
    scene = room()
    name = "lamp.emitter.radiance.value"
    value = scene.get_parameter(name).detach()
    found = []
    for render in (tr.render, lambda *a, **k: tr.distributed.render(*a, group=group, **k)):
        with forward_ad.dual_level():
            dual = forward_ad.make_dual(value, torch.ones_like(value))
            image = render(scene, spp=7, spp_grad=5, seed=2, params={name: dual})
            found.append(forward_ad.unpack_dual(image))
    alone, shared = found
    return {
        "image": difference(shared.primal, alone.primal),
        "gradient": difference(shared.tangent, alone.tangent),
        "size": float(alone.tangent.detach().abs().max()),
    }


def own_camera(group: Any) -> dict[str, float]:
    """A camera that is no part of the scene, with a gradient, and parameters of a network."""
    scene = room()
    weight = torch.full((3,), 0.4, requires_grad=True)
    turn = torch.zeros(3, requires_grad=True)
    found = []
    for render in (tr.render, lambda *a, **k: tr.distributed.render(*a, group=group, **k)):
        look = tr.Transform.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0]).matrix.float()
        world = torch.cat([torch.cat([tr.rotation.so3_exp(turn) @ look[:3, :3], look[:3, 3:]], 1), look[3:]])
        camera = tr.PerspectiveCamera(to_world=world, fov=40, film=tr.Film(width=SIZE, height=SIZE))
        params = {"lamp.emitter.radiance.value": torch.sigmoid(weight) * 4}
        image = render(scene, sensor=[camera, 0], size=(16, 16), params=params, spp=6, seed=2)
        found.append((image.detach(), *torch.autograd.grad(image.square().sum(), (weight, turn))))
    alone, shared = found
    errors = [difference(a, b) for a, b in zip(shared, alone, strict=True)]
    return {"image": errors[0], "gradient": max(errors[1:]), "size": float(alone[2].abs().max())}


def unbiased(group: Any) -> dict[str, float]:
    """The gradient of a squared error at its least, in standard errors from 0; and with the image's own samples."""
    scene = room()
    (radiance,) = scene.train_only("lamp.emitter.radiance.value")
    with torch.no_grad():
        target = tr.render(scene, spp=1024, seed=1000)

    def gradient(seed: int, **settings: Any) -> torch.Tensor:
        image = tr.distributed.render(scene, group=group, spp=2, seed=seed, **settings)
        return torch.autograd.grad((image - target).square().sum(), radiance)[0].sum().double()

    found = {}
    for name, settings in {"z": {}, "z of shared samples": {"correlated": True}}.items():
        runs = torch.stack([gradient(seed, **settings) for seed in range(24)])
        found[name] = float(runs.mean() / (runs.std() / 24**0.5))
    return found


def adaptive(group: Any) -> dict[str, float]:
    """Samples of a gradient where it is large: others for other numbers of processes, of the same expectation."""
    scene = room()
    (radiance,) = scene.train_only("lamp.emitter.radiance.value")
    weight = torch.zeros(SIZE + 3, SIZE, 1)
    weight[5:9, 4:12] = torch.rand(4, 8, 1, generator=torch.Generator().manual_seed(3)) + 0.2

    def gradient(image: torch.Tensor) -> torch.Tensor:
        return torch.autograd.grad((image * weight).sum(), radiance)[0].sum().double()

    settings = {"spp": 1, "spp_grad": 4, "adaptive_grad": True}
    runs = torch.stack([gradient(tr.distributed.render(scene, group=group, seed=s, **settings)) for s in range(24)])
    truth = gradient(tr.render(scene, spp=1, spp_grad=4096, seed=1000))
    return {"z": float((runs.mean() - truth) / (runs.std() / 24**0.5))}


def one_gathers(group: Any) -> dict[str, float]:
    scene = room()
    with torch.no_grad():
        whole = tr.render(scene, spp=3, seed=1, outputs=("rgb", "variance", "shape_id"))
        found = tr.distributed.render(
            scene, group=group, split="tiles", to=0, spp=3, seed=1, outputs=("rgb", "variance", "shape_id")
        )
    if dist.get_rank(group) != 0:
        assert found is None
        return {}
    return {"image": max(difference(a, b) for a, b in zip(found, whole, strict=True)), "gradient": 0.0, "size": 1.0}


def data_parallel(group: Any) -> dict[str, float]:
    """Inside of DistributedDataParallel, whose mean over processes leaves the whole gradient as it is."""

    class Lit(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.scene = room()

        def forward(self, shared: bool) -> torch.Tensor:
            if shared:
                return tr.distributed.render(self.scene, group=group, spp=6, seed=4)
            return tr.render(self.scene, spp=6, seed=4)

    module = Lit()
    expected = gradients(module.scene, [module(False)])
    parallel = torch.nn.parallel.DistributedDataParallel(module, process_group=group)
    found = gradients(module.scene, [parallel(True)])
    error = max(difference(a, b) for a, b in zip(found, expected, strict=True))
    return {"image": 0.0, "gradient": error, "size": max(float(g.abs().max()) for g in expected)}


def seed_of_the_first(group: Any) -> dict[str, float]:
    torch.manual_seed(dist.get_rank())
    image = tr.distributed.render(room(), group=group, spp=4)
    everyone = [torch.empty_like(image) for _ in range(dist.get_world_size(group))]
    dist.all_gather(everyone, image.detach(), group=group)
    torch.manual_seed(0)
    expected = tr.render(room(), spp=4).detach()
    return {"image": max(difference(e, expected) for e in everyone), "gradient": 0.0, "size": 1.0}


def bytes_of_a_step(group: Any) -> dict[str, float]:
    scene = room()
    tr.distributed.render(scene, group=group, spp=4, seed=0).sum().backward()
    return dict(scene.statistics["distributed"])


def refusals(group: Any) -> dict[str, str]:
    """What is said, on every process alike, and before any work."""
    scene, rank = room(), dist.get_rank(group)
    asked: dict[str, dict[str, Any]] = {
        "variance": {"outputs": ("rgb", "variance")},
        "light": {"integrator": "ptracer", "split": "tiles"},
        "pixels": {"pixels": [[0, 0]], "split": "tiles"},
        "split": {"split": "views"},
        "to": {"to": 0},
        "interrupt": {"on_interrupt": "return"},
        "wavefront": {"integrator": tr.WavefrontPathTracer()},
        "different": {"spp": 4 + rank},
        "unknown": {"samples": 4},
        "group": {"group": "all"},
    }
    said = {}
    for name, settings in asked.items():
        try:
            tr.distributed.render(scene, **{"group": group, **settings})
            said[name] = "rendered"
        except (TypeError, ValueError) as error:
            said[name] = f"{type(error).__name__}: {error}"
    return said


OUTPUTS = ("rgb", "alpha", "second_moment", "depth", "position", "albedo", "uv", "shape_id", "duv_dx")
CASES: dict[str, Callable[[Any], dict]] = {
    "box": lambda g: like_alone(room, g),
    "no sample for some": lambda g: like_alone(room, g, spp=2, spp_grad=1),
    "gaussian": lambda g: like_alone(of_filter("gaussian"), g),
    "lanczos": lambda g: like_alone(of_filter("lanczos"), g, spp=16),
    "stratified": lambda g: like_alone(room, g, sampler="stratified"),
    "sobol": lambda g: like_alone(room, g, sampler="sobol", spp=8, spp_grad=8),
    "correlated": lambda g: like_alone(room, g, correlated=True, spp_grad=None),
    "passes": lambda g: like_alone(room, g, passes=2),
    "outputs": lambda g: like_alone(room, g, outputs=OUTPUTS),
    "outputs, gaussian": lambda g: like_alone(of_filter("gaussian"), g, outputs=OUTPUTS),
    "aovs": lambda g: like_alone(room, g, integrator=tr.AOV("dd:depth,nn:sh_normal", tr.PathTracer(max_depth=2))),
    "pixels": lambda g: like_alone(room, g, pixels=[[11, 10], [12, 2], [11, 10]]),
    "views": lambda g: like_alone(room, g, sensor=[0, 0], layout="bchw"),
    "light": lambda g: like_alone(of_filter("gaussian"), g, integrator="ptracer", visibility=False),
    "spectral": lambda g: like_alone(spectral, g, visibility=False),
    "stokes": lambda g: like_alone(room, g, outputs=("rgb", "stokes", "dolp"), visibility=False),
    "double": lambda g: like_alone(lambda: room(dtype=torch.float64), g),
    "features": features,
    "forward mode": forward_mode,
    "own camera": own_camera,
    "tiles": lambda g: tiles_like_alone(room, g),
    "tiles, chw": lambda g: tiles_like_alone(room, g, sensor=[0, 0], layout="bchw", crop=(2, 3, 11, 9)),
    "tiles, outputs": lambda g: tiles_like_alone(of_filter("gaussian"), g, outputs=(*OUTPUTS, "variance")),
    "tiles, few rows": lambda g: tiles_like_alone(room, g, crop=(5, 0, 2, 9)),
    "one gathers": one_gathers,
    "data parallel": data_parallel,
    "seed of the first": seed_of_the_first,
    "unbiased": unbiased,
    "adaptive": adaptive,
    "bytes": bytes_of_a_step,
    "refusals": refusals,
}  # fmt: skip


def main() -> None:
    dist.init_process_group("gloo", timeout=datetime.timedelta(seconds=120))
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", "render: two processes of the group have the same seed")
    warnings.simplefilter("ignore", tr.MissingTermWarning)
    results: dict[str, Any] = {}
    for name in sys.argv[1:] or CASES:
        try:
            results[name] = CASES[name](dist.group.WORLD)
        except Exception:  # the same on all processes, which go on together
            results[name] = {"error": traceback.format_exc()}
    if dist.get_rank() == 0:
        print("RESULTS" + json.dumps(results))
    dist.barrier()
    dist.destroy_process_group()
    # DistributedDataParallel keeps the group and its threads alive. The last of them to leave the barrier may end the
    # process with SIGABRT while Python closes down (PyTorch's issue 190489): nothing is left for Python to do here.
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
