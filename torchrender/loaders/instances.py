"""`shapegroup` and `instance`: shapes that stand in a scene several times.

An instance becomes copies of its group's shapes when the scene is loaded: one shape by its own name where the group has
one, else ``NAME_MEMBER`` for each. Copies share material and media; each has parameters of its own. Positions and
normals of meshes are in world space, as everywhere, so that they follow the instance's `to_world` only once, when they
are made. (A tensor with ``requires_grad`` as `to_world` gets gradients through them, as that of a mesh does.)
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from ..errors import describe, nearest
from ..scene import registry, values
from ..scene.context import Context, Reference
from ..scene.curves import Curve
from ..scene.mesh import Mesh
from ..scene.plugin import Plugin

MAX_COPIES = 1 << 16  # shapes that all instances of a scene become
MAX_NUMBERS = 1 << 26  # vertices and faces of all of them


def expand_instances(objects: Mapping[str, Any], ctx: Context) -> dict[str, Any]:
    """The objects of a scene with copies in place of instances, and without groups.

    Args:
        objects: by id, as the dict of a scene has them.
        ctx: colour mode, precision and folder of the scene.

    Raises:
        ValueError: naming the instance, for a group that is not there, instances in groups, and too many copies.
    """
    if not any(_type(value) in ("instance", "shapegroup") for value in objects.values()):
        return dict(objects)
    groups: dict[str, dict[str, Plugin]] = {}
    for name, value in objects.items():
        if _type(value) == "shapegroup":
            members = _members(value, ctx.at(name))
            groups[name] = groups[str(value.get("id", name))] = members
    result: dict[str, Any] = {}
    total = [0, 0]
    for name, value in objects.items():
        if _type(value) == "shapegroup":
            continue
        copies = {name: value}
        if _type(value) == "instance":
            copies = _copies(str(value.get("id", name)), value, groups, ctx.at(name), total)
        for key, made in copies.items():
            if key in result:
                ctx.at(name).error(f"two objects have the id {key!r}")
            result[key] = made
    return result


def _type(value: Any) -> Any:
    return value.get("type") if isinstance(value, Mapping) else None


def _members(group: Mapping[str, Any], ctx: Context) -> dict[str, Plugin]:
    """The shapes of a group by name, each built once."""
    members: dict[str, Plugin] = {}
    for name, value in group.items():
        if name in ("type", "id"):
            continue
        at = ctx.at(str(name))
        if _type(value) in ("instance", "shapegroup"):
            at.error(f"a shapegroup holds shapes, and no {_type(value)} in turn")
        if not isinstance(value, (Mapping, Plugin)) or _type(value) == "ref":
            at.error(f"expected a shape (a dict or a built object), got {describe(value)}")
        if isinstance(value, Plugin):
            made = value
        else:
            made = registry.build({k: v for k, v in value.items() if k != "id"}, at, "shape")
        if made.category != "shape":
            at.error(f"expected a shape, got a {made.category} ({made.type})")
        if ctx.color is not None:
            made.adapt(ctx)
        members[str(value.get("id", name)) if isinstance(value, Mapping) else str(name)] = made
    if not members:
        ctx.error("the shapegroup is empty")
    return members


def _copies(
    name: str, instance: Mapping[str, Any], groups: dict[str, dict[str, Plugin]], ctx: Context, total: list[int]
) -> dict[str, Plugin]:
    """The shapes that an instance stands for; adds their number, and that of vertices and faces, to `total`."""
    members: dict[str, Plugin] | None = None
    double = Context(ctx.color, torch.float64, ctx.device, ctx.path, ctx.folder)
    matrix = torch.eye(4, dtype=torch.float64, device=ctx.device)
    for key, value in instance.items():
        if key in ("type", "id"):
            continue
        at = ctx.at(str(key))
        if key == "to_world":
            matrix = values.matrix(value, 4, double.at("to_world"))
            if abs(float(torch.linalg.det(matrix.detach()[:3, :3]))) == 0:
                at.error("the matrix is singular")
        elif isinstance(value, Reference) or _type(value) in ("ref", "shapegroup"):
            if members is not None:
                ctx.error("an instance has one shapegroup, got two")
            if isinstance(value, Mapping) and _type(value) == "shapegroup":
                members = _members(value, at)
                continue
            wanted = value.id if isinstance(value, Reference) else str(value.get("id"))
            if wanted not in groups:
                at.error(f"there is no shapegroup with the id {wanted!r}; {nearest(wanted, groups)}")
            members = groups[wanted]
        else:
            at.error("an instance has a shapegroup and to_world, and nothing else")
    if members is None:
        ctx.error("an instance needs a shapegroup, such as {'type': 'ref', 'id': NAME}")
    total[0] += len(members)
    total[1] += sum(len(m.vertex_positions) + len(m.faces) for m in members.values() if isinstance(m, Mesh))
    if total[0] > MAX_COPIES or total[1] > MAX_NUMBERS:
        ctx.error(
            f"too many instances: a scene has at most {MAX_COPIES} copies of shapes, of {MAX_NUMBERS} vertices and "
            "faces together"
        )
    alone = len(members) == 1
    return {name if alone else f"{name}_{key}": _copy(shape, matrix, ctx) for key, shape in members.items()}


def _own(tensor: torch.Tensor) -> torch.Tensor:
    """What a copy's own parameter is made from; tensors with a graph keep it."""
    return tensor.detach() if isinstance(tensor, torch.nn.Parameter) else tensor


def _copy(shape: Plugin, matrix: torch.Tensor, ctx: Context) -> Plugin:
    """`shape` moved by `matrix`, with the same children."""
    mirrored = float(torch.linalg.det(matrix.detach()[:3, :3])) < 0
    given: dict[str, Any] = {}
    for name, field in shape.fields().items():
        if field.kind == "int":
            given[name] = getattr(shape, name)
        elif shape._holds(field) and getattr(shape, name, None) is not None:
            given[name] = _own(getattr(shape, name))
    if isinstance(shape, Mesh):
        # what faces out does so in a mirror, too
        faces = shape.faces[:, [0, 2, 1]] if mirrored else shape.faces
        attributes = {name: _own(getattr(shape, name)) for name in shape.attribute_names}
        positions = given.pop("vertex_positions")
        if shape.computed_normals:
            given.pop("vertex_normals", None)
        made: Plugin = Mesh(
            vertices=positions, faces=faces, to_world=matrix, attributes=attributes, **given, _context=ctx
        )
        if shape.computed_normals:
            made.compute_normals()
    elif isinstance(shape, Curve):
        scale = torch.linalg.vector_norm(matrix[:3, :3], dim=0)
        if float((scale - scale.mean()).abs().max()) > 1e-4 * float(scale.mean()):
            ctx.error(
                f"an instance of a {shape.type} is turned, moved and scaled by one factor, which its matrix is not"
            )
        given["radii"] = given["radii"] * scale.mean().to(given["radii"].dtype)
        segments = shape.segment_indices
        made = type(shape)(**given, segment_indices=segments, to_world=matrix, _context=ctx)
    else:
        own = given["to_world"]
        given["to_world"] = values.rounded(matrix @ own.to(torch.float64), own, ctx)
        if shape.type == "sphere" and mirrored:  # one that is mirrored by its own matrix turns inside out
            given["flip_normals"] = not given["flip_normals"]
        made = type(shape)(**given, _context=ctx)
    made._modules.update(shape._modules)
    made.__dict__["_references"] = list(shape._references)
    return made
