"""What integrators do not have of scenes, sensors and outputs: an error or a warning before any work is done."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from .errors import NotDifferentiableError, warn_once
from .integrators import Stack, WavefrontPathTracer
from .scene.boundaries import check_phases, warn_of_open_boundaries
from .scene.packing import Layout, bending_boundary, record, records
from .scene.scene import Scene
from .scene.sensor import IrradianceMeter, Sensor


def check_media(scene: Scene, packed: Layout, tensors: list[torch.Tensor], volumetric: bool) -> None:
    """Media that are in the scene: whether they are rendered, in their range, and within closed boundaries."""
    if volumetric:
        check_phases(packed, tensors)
        warn_of_open_boundaries(scene, packed)
    elif _scattering(packed):
        text = "the scene has media, which this integrator leaves out; VolumetricPathTracer ('volpath') renders them"
        warn_once(scene.warned, "media", text)


def _scattering(packed: Layout) -> bool:
    """Whether there are media in which light goes straight on."""
    return len(packed.objects["medium"]) > len(packed.bending)


def check_bending(packed: Layout, tensors: list[torch.Tensor], integrator: Any, follows: bool) -> None:
    """Light that bends: whether the integrator `follows` it, and what bounds it."""
    if not follows:
        raise ValueError(
            f"render: integrator: {type(integrator).__name__} does not bend light, as "
            f"{packed.objects['medium'][packed.bending[0]][2]} (gradientindex) does; PathTracer does, and "
            "tr.gradientindex.trace follows rays"
        )
    for camera in records(packed, "sensor"):
        if camera.field.get("medium", -1) in packed.bending:
            raise ValueError(
                f"render: {camera.path}.medium: a camera cannot be in a gradientindex medium: put it outside; "
                "tr.gradientindex.trace follows rays that begin inside"
            )
    for shape in records(packed, "shape"):
        if shape.field.get("exterior", -1) in packed.bending:
            raise ValueError(f"render: {shape.path}.exterior: a gradientindex medium has to be the interior of shapes")
        if shape.field.get("interior", -1) in packed.bending:
            bending_boundary(packed, tensors, shape.field["bsdf"], f"render: {shape.path}.bsdf")


def check_light(packed: Layout, names: Sequence[str], adaptive_grad: bool) -> None:
    """What light tracing does not have."""
    if _scattering(packed):
        raise ValueError(
            "render: integrator: ParticleTracer does not trace through media that scatter, which the scene has; "
            "VolumetricPathTracer ('volpath') does"
        )
    for medium in (record(packed, "medium", number) for number in packed.bending):
        if medium.field["emission"] >= 0:
            raise ValueError(
                f"render: {medium.path}.emission: light paths do not begin in a medium, so that ParticleTracer would "
                "miss what it emits; PathTracer finds that"
            )
    for name in ("alpha", "variance", "second_moment"):
        if name in names:
            raise ValueError(f"render: outputs: ParticleTracer has no {name!r}; a path tracer has it")
    if adaptive_grad:
        raise ValueError(
            "render: adaptive_grad: light paths belong to no pixel, so that ParticleTracer has no such choice"
        )


def check_torch_bsdfs(
    packed: Layout, params: Any, names: Sequence[str], stack: Stack | None, integrator: Any, shows_radiance: bool
) -> tuple[Any, dict[str, torch.Tensor]]:
    """Refuses what BSDFs written in PyTorch are no part of; else `params` without theirs, and theirs."""
    from .wavefront.function import refuse_torch_bsdfs, split_params

    if shows_radiance and not isinstance(integrator, WavefrontPathTracer):
        does_not = f"which {type(integrator).__name__} does not evaluate; WavefrontPathTracer(...) does"
        refuse_torch_bsdfs(packed, f"render: integrator: {{}}, {does_not}")
    if "albedo" in names or (stack is not None and "albedo" in stack.outputs()):
        refuse_torch_bsdfs(packed, "render: outputs: {}, which has no 'albedo'")
    return split_params(packed, params)


def check_wavefront(packed: Layout, names: Sequence[str], adaptive_grad: bool) -> None:
    """What the path tracer in PyTorch does not have."""
    from .wavefront.function import check_scene

    check_scene(packed)
    for name in ("variance", "second_moment"):
        if name in names:
            raise ValueError(f"render: outputs: WavefrontPathTracer has no {name!r}; PathTracer has it")
    if adaptive_grad:
        raise ValueError("render: adaptive_grad: WavefrontPathTracer has no such choice; PathTracer has it")


def check_sensor(
    camera: Sensor, light: bool, names: Sequence[str], stack: Stack | None, tensors: list[torch.Tensor], packed: Layout
) -> None:
    """Sensors that the integrator has no way to: `light` says whether it is light tracing."""
    if isinstance(camera, IrradianceMeter):
        _check_meter(camera, light, names, stack, tensors, packed)
    elif light and camera.kind() != ("perspective",):
        distorted = camera.type == "perspective" and getattr(camera, "distortion", None) is not None
        raise ValueError(
            "render: sensor: ParticleTracer connects light to a perspective camera without distortion, or measures "
            f"it with an irradiancemeter, but this is a sensor of type {camera.type!r}"
            + (" with distortion" if distorted else "")
        )


def _check_meter(
    meter: IrradianceMeter, light: bool, names: Sequence[str], stack: Any, tensors: list[torch.Tensor], packed: Layout
) -> None:
    """What can be measured, and differentiated, on a surface."""
    others = [name for name in names if name != "rgb"] or (["aovs"] if stack is not None else [])
    if others:
        raise ValueError(f"render: outputs: an irradiancemeter has no {others[0]!r}, but 'rgb'")
    if not light:
        raise ValueError("render: sensor: an irradiancemeter is measured by ParticleTracer ('ptracer')")
    slot = packed.slot_of.get((id(meter.shape), "vertex_texcoords"))
    if slot is not None and tensors[slot].requires_grad and torch.is_grad_enabled():
        raise NotDifferentiableError(
            f"{packed.slots[slot].name}: an irradiancemeter has no derivative with respect to the texture coordinates "
            "of its surface; switch their requires_grad off"
        )


def warn_of_beams(scene: Scene, packed: Layout) -> None:
    """One UserWarning for a scene whose light comes in beams that paths from the camera do not find."""
    if any(kind == "directionalarea" for kind, _, _ in packed.objects["emitter"]):
        text = "the scene has a directionalarea light, whose beams only ParticleTracer ('ptracer') finds"
        warn_once(scene.warned, "directionalarea", text)
