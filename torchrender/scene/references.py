"""References between the objects of a scene, which are looked up by id when they are all there."""

from __future__ import annotations

from torch import nn

from ..errors import nearest
from .context import Context
from .editing import snapshot
from .plugin import Plugin


def resolve_references(scene: nn.Module, ctx: Context) -> None:
    """Replace all references below `scene` by the objects that they mean.

    ValueError names the place of one that means nothing, or leads back to itself; all objects are then as before.
    """
    by_id: dict[str, Plugin] = {}
    for module in scene.modules():
        identifier = module.__dict__.get("id")
        if isinstance(module, Plugin) and identifier is not None:
            by_id.setdefault(identifier, module)
    own = {name: module for name, module in scene._modules.items() if isinstance(module, Plugin)}
    by_id.update(own)
    for module in own.values():
        if key := module.__dict__.get("_key"):
            by_id.setdefault(key, module)

    def lookup(identifier: str, where: Context) -> Plugin:
        found = by_id.get(identifier) or by_id.get(identifier + "_")
        if found is None:
            where.error(f"there is no object with the id {identifier!r}; {nearest(identifier, by_id)}")
        return found

    pending: dict[int, tuple[Plugin, Context]] = {}
    for name, module in own.items():
        _collect(module, ctx.at(name), pending)
    restores = [snapshot(module) for module, _ in pending.values()]
    try:
        for module, where in pending.values():
            module.resolve(lookup, where)
        for name, module in own.items():
            _refuse_circles(module, ctx.at(name), set())
        for module, where in pending.values():
            module.check(where)
    except Exception:
        for restore in restores:  # objects that were to be shared can be used again, in a corrected scene
            restore()
        raise


def replace_references(scene: nn.Module, old: Plugin, new: Plugin) -> None:
    """Objects that use `old` use `new` from now on, where the category allows it."""
    for module in scene.modules():
        for child_name, child in module._modules.items():
            if child is old and module is not scene and new.category == old.category:
                module._modules[child_name] = new


def _collect(module: Plugin, ctx: Context, found: dict[int, tuple[Plugin, Context]]) -> None:
    """All objects below `module` that hold references, with their places."""
    if module._references:
        found.setdefault(id(module), (module, ctx))
    for name, child in module._modules.items():
        if isinstance(child, Plugin):
            _collect(child, ctx.at(name), found)


def _refuse_circles(module: Plugin, ctx: Context, above: set[int]) -> None:
    if id(module) in above:
        ctx.error("refers to itself")
    for name, child in module._modules.items():
        if isinstance(child, Plugin):
            _refuse_circles(child, ctx.at(name), above | {id(module)})
