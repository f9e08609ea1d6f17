"""Making a plate of glass out of heights: a closed surface in millimetres, and files that machines read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import trimesh

import torchrender as tr


def closed(front: np.ndarray, faces: np.ndarray, thickness: float) -> trimesh.Trimesh:
    """The surface of a plate with this front, a flat back at z = 0 and upright sides.

    Args:
        front: (V, 3) points of a disk-like surface with one border, seen from above, around z = 0.
        faces: (F, 3) its triangles, counterclockwise seen from above.
        thickness: what is added to z.

    Raises:
        ValueError: if the front goes through the back.
    """
    front = front + np.array([0, 0, thickness])
    if not front[:, 2].min() > 0:
        raise ValueError(f"the front goes through the back, at {front[:, 2].min():g}")
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    # An edge inside belongs to two triangles, one on the border to one.
    keys = edges.min(1) * len(front) + edges.max(1)
    order = np.argsort(keys)
    same = np.diff(keys[order]) == 0
    border = edges[order[~(np.append(same, False) | np.append(False, same))]]
    below = np.full(len(front), -1)
    rim = np.unique(border)
    below[rim] = len(front) + np.arange(len(rim))
    floor = front[rim] * np.array([1, 1, 0])
    centre = len(front) + len(rim)
    a, b = border.T
    parts = [faces, np.stack([b, a, below[a]], 1), np.stack([b, below[a], below[b]], 1)]
    parts.append(np.stack([below[b], below[a], np.full(len(a), centre)], 1))
    vertices = np.concatenate([front, floor, floor.mean(0, keepdims=True)])
    return trimesh.Trimesh(vertices, np.concatenate(parts), process=False)


def write_plate(
    folder: Path, heights: torch.Tensor, *, thickness: float, width_mm: float, resolution: int
) -> trimesh.Trimesh:
    """Write ``plate.stl`` and ``plate.ply``, the closed plate lying on its back, and its front as ``heights.png``
    (16 bits, black at the lowest point, white at the highest) and ``heights.exr``, all in millimetres.

    Args:
        folder: where they go.
        heights: (H, W) of the front, as `tr.HeightField` takes them, for a plate that is 2 wide.
        thickness: of the plate, where the heights are 0, in the same unit.
        width_mm: how wide the plate is to be, in millimetres.
        resolution: triangles along a side of the front.

    Returns:
        The closed surface.

    Raises:
        RuntimeError: if it is not watertight, or has not the volume of what lies under the heights.
    """
    scale = width_mm / 2
    vertices, faces, *_ = tr.heightfield.mesh(heights.detach().cpu(), resolution=(resolution, resolution))
    plate = closed(vertices.numpy().astype(np.float64) * scale, faces.numpy(), thickness * scale)
    under = plate.vertices[plate.faces[: len(faces)]]
    a, b = under[:, 1, :2] - under[:, 0, :2], under[:, 2, :2] - under[:, 0, :2]
    across = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    expected = float((across * under[:, :, 2].mean(1)).sum())
    if not plate.is_watertight or abs(plate.volume - expected) > 1e-6 * expected:
        raise RuntimeError(f"the plate is not closed: a volume of {plate.volume:g} mm^3, expected {expected:g}")
    for name in ("plate.stl", "plate.ply"):
        plate.export(folder / name)

    h, w = heights.shape
    v, u = torch.meshgrid((torch.arange(h) + 0.5) / h, (torch.arange(w) + 0.5) / w, indexing="ij")
    surface, *_ = tr.heightfield.evaluate(heights.detach().cpu(), torch.stack([u, v], -1))
    surface = surface.flip(0).float() * scale  # pictures begin above, where v is 1
    tr.io.write_image(folder / "heights.exr", surface)
    low, high = surface.min(), surface.max()
    tr.io.write_image(folder / "heights.png", (surface - low) / (high - low).clamp(min=1e-12), bits=16, raw=True)
    print(
        f"{folder / 'plate.stl'}: {width_mm:g} x {width_mm:g} x {plate.bounds[1, 2]:.3f} mm, "
        f"{plate.volume / 1000:.2f} cm^3, {len(plate.faces)} triangles, front from {low:.4f} to {high:.4f} mm"
    )
    return plate
