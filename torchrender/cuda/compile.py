"""Kernels of a scene ahead of time: for machines that have no compiler of CUDA, or where nobody is to wait for it."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import torch

from .. import devices
from ..backends import scene_core
from ..queries import ray_intersect, ray_occluded
from ..render import render
from ..scene.scene import Scene
from .check import deterministic_algorithms, train_all

ENOUGH = 1 << 18
"""Samples of a derivative with which those of edges are shared out, which a few do not pay for: see visibility."""


def compile_kernels(
    scene: Scene,
    capability: int,
    folder: str | Path,
    *,
    outputs: bool = False,
    forward: bool = False,
    deterministic: bool = False,
    edges: bool = True,
    ptx: bool = False,
) -> int:
    """Compile what `tr.render`, its derivatives and ray queries launch for a scene on a card; returns how many are new.

    Kernels depend on the kinds of a scene's models, its sampler and its precision, not on its numbers, resolutions or
    samples. Set ``TORCHRENDER_KERNELS`` to the folder (several with ``:`` between them) where they are to be used.

    Args:
        scene: with the integrator and the sampler that it will be rendered with.
        capability: the card's compute capability without its point, such as 90 for an H100.
        folder: is made if it is not there; what is there is kept.
        outputs: also those of other outputs than images, such as depth.
        forward: also derivatives in forward mode.
        deterministic: also those under ``torch.use_deterministic_algorithms(True)``.
        edges: also those of edges that move, which derivatives by what moves have but with ``visibility=False``.
        ptx: in place of machine code make PTX, which the drivers of these and of later cards compile when it is used,
            where there are neither machine code for them nor NVRTC.

    Raises:
        RuntimeError: there is no NVRTC, or it does not know the capability; or cards do not have what the scene needs.
    """
    folder = Path(folder).resolve()
    before = kernels_in(folder)
    trained = [name for name, p in scene.named_parameters() if p.requires_grad]
    place = f"{'compute' if ptx else 'sm'}_{capability}"
    with devices.chosen(place), devices.compiling_into(scene_core(), folder), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pictures are black
        try:
            _launch(scene, ("rgb", "depth", "shape_id") if outputs else ("rgb",), forward, deterministic, edges)
        finally:
            scene.train_only(*trained)
    return kernels_in(folder) - before


def kernels_in(folder: Path) -> int:
    """How many lie there."""
    return sum(1 for _ in folder.glob("*.cubin"))


def _launch(scene: Scene, outputs: tuple[str, ...], forward: bool, deterministic: bool, edges: bool) -> None:
    """Calls that launch everything."""
    _, _, height, width = scene.film.window if scene.film is not None else (0, 0, 1, 1)
    samples = -(-ENOUGH // (height * width))

    def total(**settings: Any) -> torch.Tensor:
        found = render(scene, spp=1, spp_grad=samples, seed=0, outputs=outputs, visibility=edges, **settings)
        return torch.stack([x.sum() for x in found if x.is_floating_point()]).sum()

    rays = torch.zeros(1, 3), torch.ones(1, 3)
    ray_intersect(scene, *rays)
    ray_occluded(scene, *rays)
    scene.train_only()
    total()
    for what_moves in (False, True):
        names = train_all(scene, but_what_moves=not what_moves)
        if not names:
            continue
        for repeats in (False, True) if deterministic else (False,):
            with deterministic_algorithms(repeats):
                torch.autograd.grad(total(), [scene.get_parameter(name) for name in names], allow_unused=True)
        if forward:
            values = {name: scene.get_parameter(name).detach() for name in names}
            scene.train_only()
            torch.func.jvp(lambda params: total(params=params), (values,), (values,))
