"""One model of a scene at a time: BSDFs and emitters evaluated and sampled by the functions that rendering uses.

Together with `chi2_test` they show that a sampler does what its density says:

    probe = BsdfProbe(scene, "ball.bsdf")
    wo, weight, pdf, *_ = probe.sample(wi, torch.rand(100000, 3))
"""

from __future__ import annotations

from collections import namedtuple
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
        entries = scene.layout().objects["bsdf"]
        names = [entry[2] for entry in entries]
        if name not in names:
            raise ValueError(f"BsdfProbe: name: no BSDF {name!r}; there are {', '.join(names)}")
        self.index = names.index(name)

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
