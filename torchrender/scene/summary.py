"""``print(scene)``: objects, and each parameter with shape, range and whether it has derivatives and requires them."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import torch

from ..integrators import ParticleTracer, VolumetricPathTracer
from .derivatives import describe_derivative
from .moving_edges import moving_caveat
from .packing import Layout, pack, top_level
from .sensor import IrradianceMeter

if TYPE_CHECKING:
    from .scene import Scene

WIDTH = 100  # columns


def summarise(scene: Scene) -> str:
    """A readable summary of `scene`."""
    lines = [f"Scene, variant {scene.variant}, {_short(scene.dtype)}, {scene.device}"]
    for name, plugin in top_level(scene):
        extra = plugin.extra_repr()
        lines.append(f"  {name}: {plugin.category} {plugin.type}" + (f" ({extra})" if extra else ""))
    integrator = scene.integrator
    if integrator is not None:
        lines.append(f"  integrator: {integrator!r}")
    notes: list[str] = []
    layout = pack(scene, ())
    measures = bool(layout.sensors) and isinstance(layout.sensors[0], IrradianceMeter)
    outlines = not (layout.torch_bsdfs or measures)
    volumetric = isinstance(integrator, VolumetricPathTracer)
    particles = isinstance(integrator, ParticleTracer)
    rows = []
    for slot in layout.slots:
        tensor = slot.tensor()
        caveat = moving_caveat(layout, slot.caveat, outlines, particles, volumetric)
        derivative, note = describe_derivative(slot.refusal, caveat)
        if note and note not in notes:
            notes.append(note)
        derivative += f" [{notes.index(note) + 1}]" if note else ""
        rows.append(_row(scene, slot.name, tensor, derivative))
    rows += _of_torch(scene, layout)
    if rows:
        lines += _table([("parameters:", "", "", "derivative"), *rows])
    for i, note in enumerate(notes):
        mark = f"  [{i + 1}] "
        lines += textwrap.wrap(note, WIDTH, initial_indent=mark, subsequent_indent=" " * len(mark))
    if rows and not any(row[3].endswith(_WANTED) for row in rows):
        lines.append("  No parameter requires a gradient: scene.train_only(PATTERN, ...) says which do.")
    return "\n".join(lines)


_WANTED = ", requires grad"


def _row(scene: Scene, name: str, tensor: torch.Tensor, derivative: str) -> tuple[str, str, str, str]:
    shape = "x".join(str(n) for n in tensor.shape) or "number"
    if tensor.dtype != scene.dtype:
        shape += f" {_short(tensor.dtype)}"
    return name, shape, _range(tensor.detach()), derivative + (_WANTED if tensor.requires_grad else "")


def _table(rows: list[tuple[str, str, str, str]]) -> list[str]:
    """Lines in columns; a name too long for them has one to itself."""
    others = [max(len(row[i]) for row in rows) for i in (1, 2)]
    last = max(len(row[3]) for row in rows)
    room = max(20, WIDTH - sum(others) - last - 10)
    widest = min(room, max(len(row[0]) for row in rows))
    lines = []
    for n, (name, shape, values, derivative) in enumerate(rows):
        indent = "  " if n == 0 else "    "
        if len(name) > widest:
            lines.append(indent + name)
            name = ""
        cells = [name.ljust(widest + 4 - len(indent)), shape.ljust(others[0]), values.ljust(others[1]), derivative]
        lines.append((indent + "  ".join(cells)).rstrip())
    return lines


def _of_torch(scene: Scene, layout: Layout) -> list[tuple[str, str, str, str]]:
    """Parameters of BSDFs that are written in PyTorch."""
    rows = []
    for row, module in layout.torch_bsdfs.items():
        path = layout.objects["bsdf"][row][2]
        rows += [_row(scene, f"{path}.{name}", tensor, "by autograd") for name, tensor in module.named_parameters()]
    return rows


def _short(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")


def _range(tensor: torch.Tensor) -> str:
    if tensor.numel() == 0:
        return "empty"
    low, high = (float(x) for x in torch.aminmax(tensor))
    return f"{low:.4g}" if low == high else f"[{low:.4g}, {high:.4g}]"
