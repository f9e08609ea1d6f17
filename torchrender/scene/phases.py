"""Phase functions that need more than their declaration: tables, and blends of two others."""

from __future__ import annotations

from typing import Any

import torch

from ..errors import describe
from . import values
from .context import Context
from .declaration import Field
from .plugin import Plugin
from .registry import register


@register
class TabulatedPhase(Plugin):
    """A phase function given by numbers over the cosine of the angle by which light is turned, linear in between.

    The numbers may have any scale: they are divided by their integral over the sphere, which their derivative knows.

    Args:
        values: numbers (N,) that are not negative, N >= 2, at cosines at equal distances from -1 (backward) to 1
            (forward): a sequence, a tensor, or a string in which commas or spaces separate them. The derivative with
            respect to zeros that lie next to each other lacks what is scattered into the angles between them.
    """

    category, type = "phase", "tabphase"

    def convert_tensor(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        numbers = values.floating(values.numbers(value, ctx) if isinstance(value, str) else value, ctx)
        if numbers.ndim != 1 or len(numbers) < 2:
            ctx.error(f"expected at least two numbers, of shape (N,), got {describe(value)}")
        return numbers.contiguous()

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        if getattr(self, "values", None) is None:
            ctx.error("tabphase: 'values' is missing")

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        if not bool((self.values.detach() > 0).any()):
            ctx.at("values").error("one of the numbers must be positive")

    def derivative_of(self, field: Field) -> str:
        zero = self.values.detach() == 0
        if bool((zero[1:] & zero[:-1]).any()):
            return (
                "interior, without scattering into angles between two zeros; zero where light that comes from there is"
            )
        return super().derivative_of(field)


@register
class BlendPhase(Plugin):
    """Two phase functions, blended: (1 - weight) of the first and `weight` of the second.

    Args:
        weight: the share of the second, 0 to 1: a number or a volume of one channel; default 0.5.
        phase_0, phase_1: the two. Nested phase functions may have any name; the first one given is the first. Neither
            may be a blend itself.
    """

    category, type = "phase", "blendphase"
    parts = ("phase_0", "phase_1")

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        properties.setdefault("weight", {"type": "constvolume", "value": 0.5})
        return properties

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        given = [name for name in self.parts if self._child(name) is not None]
        waiting = [name for name, _ in self._references if name is None or name in self.parts]
        if len(given) + len(waiting) != len(self.parts):
            ctx.error(f"blendphase: expected two nested phase functions, got {len(given) + len(waiting)}")

    def __setattr__(self, name: str, value: Any) -> None:
        if value is None and name in self.parts and self.__dict__.get("_built", False):
            Context(path=(type(self).__name__, name)).error("None removes a part, but a blend has two")
        super().__setattr__(name, value)

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        for name in self.parts:
            child = self._child(name)
            if child is not None and child.type == self.type:
                ctx.at(name).error("a blendphase cannot be part of another: both parts are plain phase functions")
        weight = self._child("weight")
        for name, tensor in weight.texels() if weight is not None else ():
            if tensor.ndim and tensor.shape[-1] != 1:
                ctx.at("weight").at(name).error(f"expected one channel, got {tensor.shape[-1]}")
