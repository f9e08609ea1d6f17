"""What media and glass need before they are rendered: phase functions in their range, closed shapes around them."""

from __future__ import annotations

import torch

from ..errors import warn_once
from .context import Context
from .curves import Curve
from .hashing import ODD, hash_places, mix
from .mesh import Mesh
from .packing import Layout
from .plugin import Plugin
from .scene import Scene
from .validation import check_range

_GLASS = ("dielectric", "roughdielectric", "anisotropicdielectric")


def check_phases(layout: Layout, tensors: list[torch.Tensor]) -> None:
    """ValueError for a number of a phase function that is out of its range, among this call's `tensors`.

    Objects check theirs when they are made; this is about edits in place and substitutes. (The core looks at volumes.)
    """
    for slot, tensor in zip(layout.slots, tensors, strict=True):
        if slot.kind == "float" and slot.module.category == "phase":
            check_range(tensor.detach(), slot.module.fields()[slot.attribute], Context(path=(slot.name,)), True)


def warn_of_open_boundaries(scene: Scene, layout: Layout) -> None:
    """One UserWarning for each mesh of `scene` that is the boundary of a medium and not closed.

    A medium is entered and left where a ray crosses a surface, so one whose boundary has holes leaks. Several meshes
    may close a boundary together. Where a rectangle, disk, cylinder, height field or grid of distances takes part,
    nothing is said: those have no edges in common with meshes that could be compared.
    """
    if layout.boundaries_seen:
        return
    layout.boundaries_seen = True
    groups: dict[int, list[tuple[str, Plugin]]] = {}
    for name, shape in scene._modules.items():
        if isinstance(shape, Plugin) and shape.category == "shape":
            for medium in {id(shape._modules.get(side)) for side in ("interior_medium", "exterior_medium")}:
                groups.setdefault(medium, []).append((name, shape))
    groups.pop(id(None), None)
    for group in groups.values():
        if any(shape.type in ("rectangle", "disk", "cylinder", "heightfield", "sdfgrid") for _, shape in group):
            continue
        loose = [(name, edge_sum(mesh)) for name, mesh in group if isinstance(mesh, Mesh)]
        if sum(total for _, total in loose) % 2**64 == 0:
            continue
        for name, total in loose:
            if total:
                text = (
                    f"{name}: the boundary of a medium, but not closed: some edge is not shared by two triangles that "
                    "turn the same way round, and the medium leaks there"
                )
                warn_once(scene.warned, f"{name}: open", text)


def warn_of_glass_on_curves(scene: Scene) -> None:
    """One UserWarning for each curve that refracts: its inside is not met, so that light bends once, not twice."""
    for name, shape in scene._modules.items():
        if isinstance(shape, Curve) and any(getattr(m, "type", None) in _GLASS for m in shape.modules()):
            text = (
                f"{name}: light that refracts into a curve leaves it unbent, since rays meet curves from outside only; "
                "a cylinder or a mesh is of glass on both sides, and hair has the BSDF 'hair'"
            )
            warn_once(scene.warned, f"{name}: glass", text)


def edge_sum(mesh: Mesh) -> int:
    """Zero if every edge of `mesh` is passed as often in one direction as in the other, which is what closed means.

    Vertices in one place count as one. An edge from a to b adds u(a) v(b) - u(b) v(a) with two hashes of places, which
    changes its sign with the direction; by chance the sum, modulo 2^64, vanishes with a probability of about 1e-19.
    """
    u = hash_places(mesh.vertex_positions)
    faces = mesh.faces.long()
    from_, to = u[faces], mix(u * ODD[2])[faces]
    following = [1, 2, 0]
    total = int((from_ * to[:, following] - from_[:, following] * to).sum())
    return (-total if mesh.flip_normals else total) % 2**64
