"""Which parameters of a scene are to be trained: chosen by patterns of names, among those that have derivatives."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from typing import TYPE_CHECKING

from torch import nn

from ..errors import NotDifferentiableError, describe, nearest
from .packing import canonical

if TYPE_CHECKING:
    from .scene import Scene


def train_only(scene: Scene, patterns: Sequence[str]) -> list[nn.Parameter]:
    """See `Scene.train_only`."""
    if len(patterns) == 1 and not isinstance(patterns[0], str):
        patterns = tuple(patterns[0])
    names = parameters_by_every_name(scene)
    layout = scene.layout()
    refusals = {n: layout.slots[i].refusal for n, i in layout.by_name.items()}
    following = {id(m._parameters.get("vertex_normals")) for m in layout.smooth_meshes}
    chosen: dict[int, nn.Parameter] = {}
    for pattern in patterns:
        if not isinstance(pattern, str):
            raise TypeError(f"train_only: expected glob patterns, got {describe(pattern)}")
        found = [n for n in names if fnmatch.fnmatchcase(n, pattern)]
        found = found or [n for n in names if fnmatch.fnmatchcase(n, canonical(pattern))]
        if not found:
            raise ValueError(f"train_only: no parameter matches {pattern!r}; {nearest(pattern, names)}")
        usable = [n for n in found if not refusals.get(n)]
        if not pattern.rpartition(".")[2].strip("*?"):
            usable = [n for n in usable if not n.endswith(".to_uv")] or usable
        if not pattern.endswith("vertex_normals"):
            usable = [n for n in usable if id(names[n]) not in following] or usable
        if not usable:
            raise NotDifferentiableError(
                f"train_only: {pattern!r} matches only parameters without a derivative: {', '.join(found)} "
                f"({refusals[found[0]]})"
            )
        chosen.update((id(names[n]), names[n]) for n in usable)
    for parameter in names.values():
        parameter.requires_grad_(id(parameter) in chosen)
    return list(chosen.values())


def parameters_by_every_name(scene: nn.Module) -> dict[str, nn.Parameter]:
    """Parameters by each of their names: those of a material also below the shapes that use it."""
    found: dict[str, nn.Parameter] = {}

    def walk(module: nn.Module, prefix: str) -> None:
        for name, parameter in module._parameters.items():
            if parameter is not None:
                found[prefix + name] = parameter
        for name, child in module._modules.items():
            if child is not None:
                walk(child, f"{prefix}{name}.")

    walk(scene, "")
    return found
