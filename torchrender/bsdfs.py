"""The native BSDF models as functions of tensors, without a scene: `native_bsdf`."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch

from . import backends
from .bsdf_functions import BsdfDirection, BsdfEvaluation, BsdfPoints, BsdfSampling
from .compiling import opaque
from .errors import describe, nearest
from .scene.context import Context
from .scene.conversion import decode, encode, static_value
from .scene.declaration import Field, models


class BsdfSamples(NamedTuple):
    """What `NativeBSDF.sample` gives for N points.

    `wo` (N, 3) the directions; `pdf` (N,) their densities per solid angle, or the probabilities of delta lobes, 0 where
    there is no sample; `eta` (N,) the index of refraction along `wo` over that along `wi`; `lobe` (N,) int64 the number
    of the lobe, for `eval`; `delta` (N,) bool whether that is a delta lobe; `value` (N, C) its value, with the cosine,
    or of a delta lobe its weight times its probability.
    """

    wo: torch.Tensor
    pdf: torch.Tensor
    eta: torch.Tensor
    lobe: torch.Tensor
    delta: torch.Tensor
    value: torch.Tensor


def native_bsdf(type: str, *, channels: int = 3, **choices: Any) -> NativeBSDF:
    """A native BSDF model as functions of tensors, differentiable by autograd, for integrators and losses of one's own.

    ::

        metal = tr.native_bsdf("roughconductor", distribution="ggx")
        alpha = torch.tensor(0.3, requires_grad=True)
        value = metal.eval({"alpha": alpha, "eta": 0.2, "k": 3.9}, wi, wo)  # (N, 3), with the cosine

    Directions are local unit vectors (N, 3): +z is the shading normal, `wi` points to where the path comes from, `wo`
    to where the light comes from. In models that follow the texture coordinates x is along dp/du. Everything is
    computed in the precision of `wi`, float32 or float64, on the CPU.

    Args:
        type: of a model as in scenes: "diffuse", "roughconductor", "principled", ... Models that contain others have no
            functions of their own.
        channels: C, of colours: 3, or 1.
        choices: the model's fields that are words or booleans, such as `distribution` and `nonlinear`.

    Returns:
        An object with the functions; its `fields` are the names of parameters.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    return NativeBSDF(type, channels, choices)


class NativeBSDF:
    """The functions of a native BSDF model; made by `native_bsdf`.

    Each takes `params`, the continuous fields that the model declares, by their names: colours are broadcast to (N, C),
    everything else, textures of which the model wants one number among them, to (N,). What is missing has the declared
    default. Meanings and ranges are those of the scene's classes (``tr.RoughConductor``), of which the names that stand
    for others do not exist here: there are `eta` and `k`, and no materials. Ranges are not checked. The index and the
    roughness of `roughplastic`, of which a table is made, are one number each.

    Attributes:
        type, channels: as given.
        choices: values of all choices, by name.
        fields: names of parameters.
        colors: those of them that are colours.
    """

    def __init__(self, type: str, channels: int, choices: Mapping[str, Any]) -> None:
        self.type, self.channels = type, channels
        declared = _declared_fields(type)
        if isinstance(channels, bool) or channels not in (1, 3):
            raise ValueError(f"native_bsdf: channels: expected 1 or 3, got {describe(channels)}")
        static = {name: f for name, f in declared.items() if f.kind == "int"}
        for name in choices:
            if name not in static:
                hint = "is no choice: give it to eval, pdf and sample" if name in declared else nearest(name, static)
                raise ValueError(f"native_bsdf: {type!r} has no choice {name!r}; {hint}")
        defaults = {name: decode(f, int(f.default or 0)) for name, f in static.items()}
        self.choices = defaults | {
            name: static_value(static[name], value, Context(path=("native_bsdf", name)))
            for name, value in choices.items()
        }
        self._numbers = [encode(f, self.choices[name]) for name, f in static.items()]
        self._defaults = {name: f.default for name, f in declared.items() if f.kind != "int"}
        self._cores: dict[tuple[str, torch.dtype], Any] = {}
        core = self._core(torch.float32)
        names = core.fields
        self.fields, self.colors = tuple(names["all"]), tuple(names["colors"])
        # of roughplastic, for whose coating there is one table
        self._single = tuple(n for n in ("eta", "alpha") if core.tabulated)

    def __repr__(self) -> str:
        settings = self.choices if self.channels == 3 else {"channels": self.channels, **self.choices}
        return f"native_bsdf({', '.join([repr(self.type), *(f'{n}={v!r}' for n, v in settings.items())])})"

    def __reduce__(self) -> tuple[Any, ...]:  # the core's object is made anew, also by copy.deepcopy
        return functools.partial(native_bsdf, self.type, channels=self.channels, **self.choices), ()

    @opaque
    def eval(self, params: Mapping[str, Any], wi: Any, wo: Any, lobe: Any = None) -> torch.Tensor:
        """The value (N, C) times ``|cos(wo)|``, for radiance that travels from `wo` to `wi`.

        Differentiable in `params`, `wi` and `wo`, in reverse and forward mode; the first derivative only.

        Args:
            lobe: (N,) or (1,), integers: of which lobe, as `sample` gave it. Delta lobes have a value nowhere else but
                along the direction that was sampled: their weight times the probability of sampling them. If omitted,
                the value is that of the smooth lobes, 0 if there is none.
        """
        points, other = self._points("eval", params, wi, "wo", wo)
        smooth = "has_smooth_lobes" in models()["bsdf", self.type].flags
        if lobe is None and not smooth:
            return points.wi.new_zeros(len(points.wi), self.channels)
        return BsdfEvaluation.apply(points.functions, self._lobes(lobe, points.wi), points.wi, other, *points.params)

    @opaque
    def pdf(self, params: Mapping[str, Any], wi: Any, wo: Any) -> torch.Tensor:
        """The density (N,) per solid angle with which `sample` takes `wo` by smooth lobes; without derivatives."""
        points, other = self._points("pdf", params, wi, "wo", wo)
        return BsdfSampling.apply(points.functions, False, points.wi, other, *points.params)

    @opaque
    def sample(self, params: Mapping[str, Any], wi: Any, u: Any) -> BsdfSamples:
        """Directions from uniform numbers `u` (N, 3) in [0, 1).

        Everything is constant in derivatives, but for `wo` of delta lobes, which is differentiable in `wi` and in the
        numbers that turn it (`eta`): where the ray goes depends on them. An estimate of what is reflected of radiance
        L is ``eval(params, wi, s.wo, s.lobe) / s.pdf[:, None] * L(s.wo)`` where ``s.pdf > 0``.
        """
        points, numbers = self._points("sample", params, wi, "u", u)
        found = BsdfSampling.apply(points.functions, True, points.wi, numbers, *points.params)
        wo, pdf, eta, lobe, delta, value = found
        if "has_delta_lobes" in models()["bsdf", self.type].flags:
            wo = BsdfDirection.apply(points.functions, lobe, delta, wo, points.wi, *points.params)
        return BsdfSamples(wo, pdf, eta, lobe.long(), delta.bool(), value)

    # ------------------------------------------------------------------------------------------------------ arguments
    def _core(self, dtype: torch.dtype) -> Any:
        core = backends.core(dtype)
        key = (core.isa, dtype)
        if key not in self._cores:
            name = str(dtype).removeprefix("torch.")
            self._cores[key] = core.BsdfFunctions(self.type, name, self.channels, self._numbers)
        return self._cores[key]

    def _points(
        self, function: str, params: Mapping[str, Any], wi: Any, name: str, other: Any
    ) -> tuple[BsdfPoints, torch.Tensor]:
        """N rows of everything, in one precision."""
        where = f"{self!r}.{function}"
        wi = _tensor(f"{where}: wi", wi)
        if wi.dtype not in (torch.float32, torch.float64):
            raise TypeError(f"{where}: wi: expected float32 or float64, got {describe(wi)}")
        given = {"wi": wi, name: _tensor(f"{where}: {name}", other, wi.dtype)}
        for key, tensor in given.items():
            if tensor.ndim != 2 or tensor.shape[1] != 3:
                raise ValueError(f"{where}: {key}: expected shape (N, 3), got {describe(tensor)}")
        if not isinstance(params, Mapping):
            raise TypeError(f"{where}: params: expected tensors by name, got {describe(params)}")
        for key in params:
            if key not in self.fields:
                hint = "it is a choice of native_bsdf" if key in self.choices else nearest(str(key), self.fields)
                raise ValueError(f"{where}: params: there is no {key!r}; {hint}")
        values = {key: self._parameter(f"{where}: params: {key}", key, params, wi.dtype) for key in self.fields}
        rows = {key: tensor.shape[0] for key, tensor in given.items()}
        rows |= {f"params: {key}": v.shape[0] for key, v in values.items()}
        n = next((r for r in rows.values() if r != 1), 1)
        for key, r in rows.items():
            if r not in (1, n):
                raise ValueError(f"{where}: {key}: has {r} rows, where others have {n}")
        dense = [v.expand(n, *v.shape[1:]) for v in (*given.values(), *values.values())]
        return BsdfPoints(self._core(wi.dtype), dense[0], dense[2:]), dense[1]

    def _parameter(self, where: str, name: str, params: Mapping[str, Any], dtype: torch.dtype) -> torch.Tensor:
        """One row or a row a point: of a colour (N, C), of a number (N,)."""
        tensor = _tensor(where, params[name] if name in params else self._defaults[name], dtype)
        if name in self.colors:
            if tensor.ndim > 2 or (tensor.ndim > 0 and tensor.shape[-1] not in (1, self.channels)):
                expected = f"a number or a colour of shape ({self.channels},) or (N, {self.channels})"
                raise ValueError(f"{where}: expected {expected}, got {describe(tensor)}")
            rows = tensor.shape[0] if tensor.ndim == 2 else 1
            return tensor.expand(rows, self.channels)
        if name in self._single and tensor.numel() != 1:
            raise ValueError(f"{where}: expected one number, of which a table is made, got {describe(tensor)}")
        if tensor.ndim > 1:
            raise ValueError(f"{where}: expected a number or shape (N,), got {describe(tensor)}")
        return tensor.reshape(-1)

    def _lobes(self, lobe: Any, wi: torch.Tensor) -> torch.Tensor:
        """int32 (N,)."""
        tensor = torch.as_tensor(0 if lobe is None else lobe, device="cpu")
        if tensor.is_floating_point() or tensor.is_complex() or tensor.dtype == torch.bool:
            raise TypeError(f"{self!r}.eval: lobe: expected integers, got {describe(lobe)}")
        if tensor.ndim > 1 or (tensor.ndim == 1 and tensor.shape[0] not in (1, len(wi))):
            raise ValueError(f"{self!r}.eval: lobe: expected shape ({len(wi)},), got {describe(tensor)}")
        return tensor.to(torch.int32).expand(len(wi)).contiguous()


def _declared_fields(type: Any) -> dict[str, Field]:
    """The fields of a model that has functions of its own."""
    known = {kind: m for (category, kind), m in models().items() if category == "bsdf"}
    if not isinstance(type, str):
        raise TypeError(f"native_bsdf: type: expected the name of a BSDF, got {describe(type)}")
    own = [kind for kind, m in known.items() if "wraps_bsdfs" not in m.flags]
    if type not in known:
        raise ValueError(f"native_bsdf: type: there is no BSDF {type!r}; {nearest(type, own)}")
    if type not in own:
        raise ValueError(
            f"native_bsdf: type: {type!r} contains other BSDFs and has no functions of its own; "
            f"those that have are {', '.join(own)}"
        )
    return {f.name: f for f in known[type].fields}


def _tensor(where: str, value: Any, dtype: torch.dtype | None = None) -> torch.Tensor:
    """`value` as a tensor on the CPU."""
    if not isinstance(value, torch.Tensor):
        try:
            return torch.as_tensor(value, dtype=dtype, device="cpu")
        except (TypeError, ValueError, RuntimeError) as error:
            raise TypeError(f"{where}: expected a tensor, got {describe(value)}") from error
    if value.device.type != "cpu":
        raise ValueError(f"{where}: lies on {value.device}; native BSDFs are computed on the CPU: use .to('cpu')")
    if value.is_complex():
        raise TypeError(f"{where}: expected real numbers, got {describe(value)}")
    return value if dtype is None else value.to(dtype)
