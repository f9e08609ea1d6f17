"""One model of a scene at a time: BSDFs, phase functions and emitters, by the functions that rendering uses.

Together with `chi2_test` they show that a sampler does what its density says:

    probe = BsdfProbe(scene, "ball.bsdf")
    wo, weight, pdf, *_ = probe.sample(wi, torch.rand(100000, 3))
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping
from typing import Any

import torch

from ..scene.gather import gather
from ..scene.scene import Scene

BsdfEvaluation = namedtuple("BsdfEvaluation", "value pdf")
BsdfSamples = namedtuple("BsdfSamples", "wo weight pdf eta delta")
EmitterSamples = namedtuple("EmitterSamples", "direction distance pdf radiance")
EmitterDensity = namedtuple("EmitterDensity", "pdf radiance")


class BsdfProbe:
    """A BSDF of a scene, by itself.

    Directions are local, (N, 3) unit vectors: +z is the normal, `wi` points to the viewer, `wo` to the light.

    Args:
        scene: a built scene.
        name: path of a shape's BSDF, such as ``"ball.bsdf"`` or the name of a top-level BSDF.

    Raises:
        ValueError: there is no BSDF of that name; the message lists those there are.
    """

    def __init__(self, scene: Scene, name: str) -> None:
        self.scene = scene
        self.index = _index(scene, "bsdf", name, "BsdfProbe: name: no BSDF")

    def eval(self, wi: Any, wo: Any, uv: Any = None) -> BsdfEvaluation:
        """Value (N, C), the BSDF times ``|cos(wo)|``, and density per solid angle (N,), both without delta lobes."""
        wi, wo, uv = self._directions(wi, wo, uv)
        out = _new(self.scene, len(wi), value=_channels(self.scene), pdf=0)
        _probe(self.scene, "bsdf", self.index, len(wi), {"wi": wi, "wo": wo, "uv": uv, **out})
        return BsdfEvaluation(**out)

    def sample(self, wi: Any, u: Any, uv: Any = None) -> BsdfSamples:
        """Samples from uniform numbers `u` (N, 3).

        Returns:
            `wo` (N, 3); `weight` (N, C), value over density; `pdf` (N,), density, the probability of a delta lobe,
            or 0 where there is no sample; `eta` (N,), relative index passed; `delta` (N,) bool.
        """
        wi, u, uv = self._directions(wi, u, uv)
        out = _new(self.scene, len(wi), wo=3, weight=_channels(self.scene), pdf=0, eta=0)
        delta = torch.empty(len(wi), dtype=torch.uint8)
        _probe(self.scene, "bsdf_sample", self.index, len(wi), {"wi": wi, "u": u, "uv": uv, "delta": delta, **out})
        return BsdfSamples(**out, delta=delta.bool())

    def _directions(self, wi: Any, other: Any, uv: Any) -> tuple[torch.Tensor, ...]:
        wi, other = _rows(self.scene, "wi", wi, 3), _rows(self.scene, "wo or u", other, 3)
        n = max(len(wi), len(other))
        uv = _rows(self.scene, "uv", torch.zeros(1, 2) if uv is None else uv, 2)
        return tuple(_expand(t, n) for t in (wi, other, uv))


class PhaseProbe:
    """A phase function of a scene, by itself.

    Directions are unit vectors (N, 3) in world space: `d` is the one that light or a path travels in before it
    scatters, `wo` the one afterwards. `positions` (N, 3) are where it scatters, which only the weight of a blend asks.

    Args:
        scene: a built scene.
        name: path of a medium's phase function, such as ``"ball.interior_medium.phase_function"``, or the name of a
            top-level one.

    Raises:
        ValueError: there is no phase function of that name; the message lists those there are.
    """

    def __init__(self, scene: Scene, name: str) -> None:
        self.scene = scene
        self.index = _index(scene, "phase", name, "PhaseProbe: name: no phase function")

    def eval(self, d: Any, wo: Any, positions: Any = None) -> torch.Tensor:
        """Value (N,), which is the density per solid angle with which `sample` takes `wo`."""
        rows = self._rows(d, wo, positions)
        out = _new(self.scene, len(rows["p"]), value=0)
        self._call("phase", rows, out)
        return out["value"]

    def sample(self, d: Any, u: Any, positions: Any = None) -> torch.Tensor:
        """Directions (N, 3) from uniform numbers `u` (N, 3), of which the first chooses a part of a blend."""
        rows = self._rows(d, u, positions)
        rows["u"] = rows.pop("wo")
        out = _new(self.scene, len(rows["p"]), wo=3)
        self._call("phase_sample", rows, out)
        return out["wo"]

    def reverse(self, d: Any, wo: Any, adjoint: Any, positions: Any = None) -> dict[str, torch.Tensor]:
        """Gradients of the sum over ``adjoint * value``, with `adjoint` (N, C), by the names of all parameters."""
        rows = self._rows(d, wo, positions, adjoint)
        tensors = gather(self.scene, self.scene.layout(), None)
        gradients = [torch.zeros_like(t.detach()) for t in tensors]
        self._call("phase_reverse", rows, {str(i): t for i, t in enumerate(gradients)})
        return {name: gradients[i] for name, i in self.scene.layout().by_name.items()}

    def forward(
        self, d: Any, wo: Any, adjoint: Any, tangents: Mapping[str, torch.Tensor], positions: Any = None
    ) -> torch.Tensor:
        """``adjoint * derivative`` (N, C) of the value in the direction of `tangents`, by the names of parameters."""
        rows = self._rows(d, wo, positions, adjoint)
        by_name = self.scene.layout().by_name
        given = {str(by_name[name]): t.to(self.scene.dtype).contiguous() for name, t in tangents.items()}
        out = _new(self.scene, len(rows["p"]), derivative=_channels(self.scene))
        self._call("phase_forward", {**rows, **given}, out)
        return out["derivative"]

    def _rows(self, d: Any, wo: Any, positions: Any, adjoint: Any = None) -> dict[str, torch.Tensor]:
        positions = torch.zeros(1, 3) if positions is None else positions
        rows = {
            "d": _rows(self.scene, "d", d, 3),
            "wo": _rows(self.scene, "wo or u", wo, 3),
            "p": _rows(self.scene, "positions", positions, 3),
        }
        if adjoint is not None:
            rows["g"] = _rows(self.scene, "adjoint", adjoint, _channels(self.scene))
        n = max(len(t) for t in rows.values())
        return {name: _expand(t, n) for name, t in rows.items()}

    def _call(self, what: str, rows: dict[str, torch.Tensor], out: dict[str, torch.Tensor]) -> None:
        _probe(self.scene, what, self.index, len(rows["p"]), {**rows, **out})


def sample_emitters(scene: Scene, positions: Any, u: Any) -> EmitterSamples:
    """Emitter samples at `positions` (N, 3) from uniform numbers `u` (N, 3).

    Returns:
        `direction` (N, 3), `distance` (N,), infinite for environments, `pdf` (N,) per solid angle times the probability
        of the emitter (0: nothing arrives), `radiance` (N, C) arriving if nothing is in between.
    """
    positions, u = _rows(scene, "positions", positions, 3), _rows(scene, "u", u, 3)
    n = max(len(positions), len(u))
    positions, u = _expand(positions, n), _expand(u, n)
    out = _new(scene, n, d=3, distance=0, pdf=0, radiance=_channels(scene))
    _probe(scene, "emitter_sample", 0, n, {"p": positions, "u": u, **out})
    return EmitterSamples(out["d"], out["distance"], out["pdf"], out["radiance"])


def emitter_density(scene: Scene, positions: Any, directions: Any) -> EmitterDensity:
    """Density (N,) with which `sample_emitters` takes these directions (N, 3), and the radiance (N, C) from there."""
    positions, directions = _rows(scene, "positions", positions, 3), _rows(scene, "directions", directions, 3)
    n = max(len(positions), len(directions))
    positions, directions = _expand(positions, n), _expand(directions, n)
    out = _new(scene, n, pdf=0, radiance=_channels(scene))
    _probe(scene, "emitter_pdf", 0, n, {"p": positions, "d": directions, **out})
    return EmitterDensity(**out)


def _index(scene: Scene, category: str, name: str, missing: str) -> int:
    names = [entry[2] for entry in scene.layout().objects[category]]
    if name not in names:
        raise ValueError(f"{missing} {name!r}; there are {', '.join(names) or 'none'}")
    if category == "bsdf" and names.index(name) in scene.layout().torch_bsdfs:
        raise ValueError(f"BsdfProbe: name: {name} is a BSDF written in PyTorch, which the core does not evaluate")
    return names.index(name)


def _channels(scene: Scene) -> int:
    return scene.channels


def _rows(scene: Scene, name: str, value: Any, columns: int) -> torch.Tensor:
    tensor = torch.as_tensor(value, dtype=scene.dtype).detach()
    if tensor.ndim == 1:
        tensor = tensor[None]
    if tensor.ndim != 2 or tensor.shape[1] != columns:
        raise ValueError(f"{name}: expected shape (N, {columns}), got {tuple(tensor.shape)}")
    return tensor


def _expand(tensor: torch.Tensor, n: int) -> torch.Tensor:
    if len(tensor) not in (1, n):
        raise ValueError(f"expected 1 or {n} rows, got {len(tensor)}")
    return tensor.expand(n, tensor.shape[1]).contiguous()


def _new(scene: Scene, n: int, **columns: int) -> dict[str, torch.Tensor]:
    return {k: torch.empty((n, c) if c else (n,), dtype=scene.dtype) for k, c in columns.items()}


def _probe(scene: Scene, what: str, index: int, n: int, arrays: dict[str, torch.Tensor]) -> None:
    layout = scene.layout()
    params = [t.detach() for t in gather(scene, layout, None)]
    native = scene.native(layout, [tuple(t.shape) for t in params])
    native.call("probe", params, what, index, n, {name: t.data_ptr() for name, t in arrays.items()})
