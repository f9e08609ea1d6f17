"""``print(scene)``: objects, and each parameter with shape, dtype, range and which derivatives it has."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from ..integrators import VolumetricPathTracer
from .derivatives import describe_derivative, refusal_of
from .packing import Layout, pack, top_level

if TYPE_CHECKING:
    from .scene import Scene


def summarise(scene: Scene) -> str:
    """A readable summary of `scene`."""
    lines = [f"Scene, variant {scene.variant}, {str(scene.dtype).removeprefix('torch.')}, {scene.device}"]
    for name, plugin in top_level(scene):
        extra = plugin.extra_repr()
        lines.append(f"  {name}: {plugin.category} {plugin.type}" + (f" ({extra})" if extra else ""))
    integrator = scene.integrator
    if integrator is not None:
        lines.append(f"  integrator: {integrator!r}")
    volumetric = isinstance(integrator, VolumetricPathTracer)
    rows = []
    layout = pack(scene, ())
    for slot in layout.slots:
        tensor = slot.tensor().detach()
        shape = "x".join(str(n) for n in tensor.shape) or "number"
        derivative = describe_derivative(refusal_of(slot, volumetric), slot.caveat)
        if slot.tensor().requires_grad:
            derivative += ", requires grad"
        rows.append((slot.name, shape, str(tensor.dtype).removeprefix("torch."), _range(tensor), derivative))
    rows += _of_torch(layout)
    if rows:
        widths = [max(len(row[i]) for row in rows) for i in range(4)]
        lines.append("  parameters:")
        for row in rows:
            cells = [cell.ljust(width) for cell, width in zip(row[:4], widths, strict=True)]
            lines.append("    " + "  ".join([*cells, row[4]]))
    return "\n".join(lines)


def _of_torch(layout: Layout) -> list[tuple[str, str, str, str, str]]:
    """Parameters of BSDFs that are written in PyTorch."""
    rows = []
    for row, module in layout.torch_bsdfs.items():
        path = layout.objects["bsdf"][row][2]
        for name, tensor in module.named_parameters():
            shape = "x".join(str(n) for n in tensor.shape) or "number"
            derivative = "by autograd" + (", requires grad" if tensor.requires_grad else "")
            dtype = str(tensor.dtype).removeprefix("torch.")
            rows.append((f"{path}.{name}", shape, dtype, _range(tensor.detach()), derivative))
    return rows


def _range(tensor: torch.Tensor) -> str:
    if tensor.numel() == 0:
        return "empty"
    low, high = (float(x) for x in torch.aminmax(tensor))
    return f"{low:.4g}" if low == high else f"[{low:.4g}, {high:.4g}]"
