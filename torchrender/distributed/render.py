"""`render` by the processes of a group."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, overload

import torch
import torch.distributed as dist

from ..errors import describe, nearest
from ..render import render as render_alone
from ..render_arguments import count
from ..render_types import OutputNames, Outputs, RenderSettings
from ..scene.scene import Scene
from ..seeds import seeds
from ..shares import sharing
from .collectives import Group
from .samples import SampleShare
from .tiles import TileShare

if TYPE_CHECKING:
    from typing_extensions import Unpack

SPLITS = ("samples", "tiles")
Split: TypeAlias = Literal["samples", "tiles"]
# What all processes have to ask for alike, as numbers that they compare.
_ALIKE = ("split", "spp", "spp_grad", "outputs", "parameters that require gradients")


@overload
def render(
    scene: Scene,
    *,
    group: dist.ProcessGroup | None = None,
    split: Split = "samples",
    to: int | None = None,
    outputs: None = None,
    **settings: Unpack[RenderSettings],
) -> torch.Tensor: ...


@overload
def render(
    scene: Scene,
    *,
    group: dist.ProcessGroup | None = None,
    split: Split = "samples",
    to: int | None = None,
    outputs: OutputNames,
    **settings: Unpack[RenderSettings],
) -> Outputs: ...


def render(
    scene: Scene,
    *,
    group: dist.ProcessGroup | None = None,
    split: str = "samples",
    to: int | None = None,
    **settings: Any,
) -> torch.Tensor | Outputs | None:
    """`torchrender.render` by all processes of a group: all call it alike, and have the whole image and gradient.

    The image and its gradient are those of one process with the same seed, to rounding, for any number of processes:
    samples are numbered, and their numbers, not processes, choose their random numbers. Scenes and parameters are
    replicated, as with `torch.nn.parallel.DistributedDataParallel`, and so is the loss: every process calls
    ``backward()``, in which gradients are summed, so that each has those that one process alone would have. They are no
    shares: averaging them once more over the same processes, as DDP does, changes nothing.

    Args:
        scene: the same on every process.
        group: of processes; None takes all of them (`torch.distributed.init_process_group` comes first). It has to
            reduce tensors on the CPU, as gloo does.
        split: ``"samples"``: each process traces spp / n samples of every pixel; work is shared evenly, memory is not
            shared. ``"tiles"``: each renders a band of 1 / n of the rows; its work and memory go with its band.
        to: tiles: the only process, a number in the group, that is given the whole; others return None. Without
            gradients.
        settings: those of `torchrender.render`. The seed is that of the group's first process. ``on_interrupt`` is
            ``"raise"``. Shares of samples have no ``"variance"``, no `WavefrontPathTracer`, and several passes with the
            box filter alone; tiles no light tracing and no `pixels`. With `adaptive_grad`, and for moving outlines in
            tiles, which samples a gradient has depends on the number of processes; its expectation does not.

    Returns:
        what `torchrender.render` does. ``scene.statistics["distributed"]`` counts ``"collectives"`` and ``"bytes"``
        that this process has sent into them, of the image and later of its derivative.

    Raises:
        TypeError, ValueError: as `torchrender.render`; also where processes ask for different things.
        RuntimeError: without a process group; from the group itself, after its timeout, where a process has failed.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"distributed.render: scene: expected a Scene (see load_file), got {describe(scene)}")
    if split not in SPLITS:
        raise ValueError(f"distributed.render: split: expected one of {', '.join(SPLITS)}, got {describe(split)}")
    accepted = [name for name in inspect.signature(render_alone).parameters if name != "scene"]
    for name in settings:
        if name not in accepted:
            raise TypeError(f"distributed.render: unknown argument {name!r}; {nearest(name, accepted)}")
    if not dist.is_available() or not dist.is_initialized():
        raise RuntimeError(
            "distributed.render: there is no process group: call torch.distributed.init_process_group('gloo') in a "
            "program that torchrun starts"
        )
    processes = _group(group)
    if settings.get("on_interrupt", "raise") != "raise":
        raise ValueError("distributed.render: on_interrupt: only 'raise', since processes are interrupted one by one")
    if to is not None:
        to = count("to", to, 0, processes.size - 1)
        if split != "tiles" or _trained(scene, settings):
            raise ValueError(
                "distributed.render: to: one process is given the whole of tiles, without gradients (torch.no_grad()); "
                "leave it out, and all are"
            )
    share = SampleShare(processes) if split == "samples" else TileShare(processes, to)
    correlated = settings.get("correlated", False)
    with sharing(share):
        first, second = seeds(settings.get("seed"), settings.get("seed_grad"), bool(correlated))
        first, second = _agreed(processes, first, second, _alike(scene, split, settings))
        settings |= {"seed": first, "seed_grad": None if correlated else second}
        if processes.rank and settings.get("progress") is None:
            settings["progress"] = False
        found = render_alone(scene, **settings)
    scene.statistics["distributed"] = processes.statistics
    return found if to in (None, processes.rank) else None


def _group(group: dist.ProcessGroup | None) -> Group:
    """The group, if this process belongs to it and it takes tensors on the CPU."""
    if group is not None and not isinstance(group, dist.ProcessGroup):
        if group == dist.GroupMember.NON_GROUP_MEMBER:
            raise ValueError("distributed.render: group: this process is not one of the group's")
        raise TypeError(f"distributed.render: group: expected a torch.distributed.ProcessGroup, got {describe(group)}")
    chosen = dist.group.WORLD if group is None else group
    assert chosen is not None
    processes = Group(chosen)
    backends = str(dist.get_backend_config(processes.group))  # such as "cpu:gloo,cuda:nccl"
    if "cpu:" not in backends:
        raise ValueError(
            f"distributed.render: group: images and gradients lie on the CPU, which this group ({backends}) does not "
            "reduce; init_process_group('cpu:gloo,cuda:nccl') has a backend for each"
        )
    return processes


def _trained(scene: Scene, settings: dict[str, Any]) -> int:
    """How many numbers may be asked for a gradient."""
    if not torch.is_grad_enabled():
        return 0
    params = settings.get("params") or {}
    given = [t for mapping in (params if isinstance(params, (list, tuple)) else [params]) for t in mapping.values()]
    tensors = [*scene.parameters(), *given]
    return sum(t.numel() for t in tensors if isinstance(t, torch.Tensor) and t.requires_grad)


def _alike(scene: Scene, split: str, settings: dict[str, Any]) -> list[int]:
    """A number for each of `_ALIKE`."""
    numbers = [settings.get(name) for name in ("spp", "spp_grad")]
    outputs = settings.get("outputs") or ()
    return [
        SPLITS.index(split),
        *(n if isinstance(n, int) else -1 for n in numbers),
        len(outputs) if isinstance(outputs, (list, tuple)) else -1,
        _trained(scene, settings),
    ]


def _agreed(group: Group, first: int, second: int, alike: list[int]) -> tuple[int, int]:
    """The seeds of the group's first process. ValueError, on every process, if they ask for different things."""
    signed = [seed - (1 << 64) if seed >> 63 else seed for seed in (first, second)]
    everyone = group.numbers([*signed, *alike])
    for i, name in enumerate(_ALIKE, 2):
        found = [numbers[i] for numbers in everyone]
        if len(set(found)) > 1:
            raise ValueError(f"distributed.render: {name}: processes have different ones: {found}")
    return everyone[0][0] % (1 << 64), everyone[0][1] % (1 << 64)
