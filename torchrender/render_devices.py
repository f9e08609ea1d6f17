"""What of `render` other devices than the CPU do not have yet: an error by name, before any work is done."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch

from .devices import device
from .first_hit_call import FEATURES, PATH_OUTPUTS, STOKES_OUTPUTS
from .integrators import DirectIllumination, Integrator, ParticleTracer, PathTracer, Stack, VolumetricPathTracer
from .scene.packing import Layout
from .scene.scene import Scene

_INTEGRATORS = (PathTracer, DirectIllumination, VolumetricPathTracer, ParticleTracer)


def check_device(scene: Scene, packed: Layout, names: Sequence[str], integrator: Integrator) -> None:
    """RuntimeError unless the chosen device renders these outputs of a scene by this integrator."""
    if device() != "cpu":
        _refuse(_missing(scene, packed, names, integrator))


def _refuse(missing: Iterator[str]) -> None:
    for what in missing:
        raise RuntimeError(
            f"render: TORCHRENDER_BACKEND={device()} does not have {what}; with TORCHRENDER_BACKEND=cpu, or without "
            "it, everything is there"
        )


def _missing(scene: Scene, packed: Layout, names: Sequence[str], integrator: Integrator) -> Iterator[str]:
    """What is not there, with what is."""
    inner = integrator.integrator if isinstance(integrator, Stack) else integrator
    if inner is not None and not isinstance(inner, _INTEGRATORS):
        there = ", ".join(kind.__name__ for kind in _INTEGRATORS)
        yield f"the integrator {type(inner).__name__} yet, but {there}, and AOV, Depth and Moment around them"
    for name in names:
        if name in (FEATURES, *STOKES_OUTPUTS):
            yield f"the output {name!r} yet, but {', '.join(PATH_OUTPUTS)} and those of first hits"
    if scene.dtype != torch.float32:
        yield f"{str(scene.dtype).removeprefix('torch.')} yet, but float32"
    if packed.spectral:
        yield "spectral scenes yet, but those in rgb and mono"
    if scene.polarized:
        yield "polarised light yet, but variants without it (rgb, mono)"
    if packed.bending:
        yield f"media that light bends in yet, such as {packed.objects['medium'][packed.bending[0]][2]}"
    if packed.torch_bsdfs:
        yield "BSDFs in Python (TorchBSDF), but the others"
