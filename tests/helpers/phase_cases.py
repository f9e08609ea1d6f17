"""Phase functions, and probes that evaluate them."""

from __future__ import annotations

import inspect
import math

import pytest
import torch

import torchrender as tr

AXIS = torch.nn.functional.normalize(torch.tensor([0.3, -0.5, 0.6], dtype=torch.float64), dim=0)
PLACE = torch.tensor([0.3, 0.62, 0.45], dtype=torch.float64)  # where the grid below is neither 0 nor 1
TABLE = [0.4, 0.1, 0.7, 2.0, 0.9]
GRID = torch.rand(2, 3, 4, 1, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
GRID[0, 0, 0], GRID[1, 2, 3] = 0, 1
PHASES = {
    "isotropic": {"type": "isotropic"},
    "forward": {"type": "hg", "g": 0.7},
    "backward": {"type": "hg", "g": -0.45},
    "even": {"type": "hg", "g": 0.0},
    "nearly even": {"type": "hg", "g": 1e-5},
    "rayleigh": {"type": "rayleigh"},
    "table": {"type": "tabphase", "values": TABLE},
    "table with zeros": {"type": "tabphase", "values": "0, 0, 1, 0.5, 0, 2"},
    "blend": {
        "type": "blendphase",
        "weight": {"type": "constvolume", "value": 0.3},
        "first": {"type": "hg", "g": 0.6},
        "second": {"type": "rayleigh"},
    },
    "blend in a grid": {
        "type": "blendphase",
        "weight": {"type": "gridvolume", "data": GRID},
        "first": {"type": "tabphase", "values": TABLE},
        "second": {"type": "hg", "g": -0.2},
    },
}
ARITHMETIC = {"double": (torch.float64, False), "single": (torch.float32, False), "packets": (torch.float32, True)}


def scene_of(phase: dict, dtype: torch.dtype = torch.float64, variant: str = "rgb") -> tr.Scene:
    medium = {"type": "homogeneous", "phase": phase}
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium}
    return tr.load_dict({"type": "scene", "ball": ball}, dtype=dtype, variant=variant)


def name_of(scene: tr.Scene) -> str:
    """The name of the outermost phase function, which is packed after those that it contains."""
    return scene.layout().objects["phase"][-1][2]


class probe_of:
    """A probe of a phase function that computes in this arithmetic."""

    def __init__(self, phase: dict, arithmetic: str = "double", variant: str = "rgb") -> None:
        dtype, self.packets = ARITHMETIC[arithmetic]
        scene = scene_of(phase, dtype, variant)
        self.probe = tr.testing.PhaseProbe(scene, name_of(scene))

    def __getattr__(self, name: str):
        found = getattr(self.probe, name)

        def call(*args):
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(tr.backends, "PACKETS", self.packets)
                return found(*args)

        return call if inspect.ismethod(found) else found


def uniform(*shape: int, seed: int = 1) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def directions(n: int, seed: int) -> torch.Tensor:
    normal = torch.randn(n, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return torch.nn.functional.normalize(normal, dim=1)


def at_cosines(cosine: torch.Tensor) -> torch.Tensor:
    """Directions (N, 3) at these cosines (N,) to +z."""
    sine = torch.sqrt((1 - cosine) * (1 + cosine))
    return torch.stack([sine, torch.zeros_like(sine), cosine], dim=1)


UP = torch.tensor([0.0, 0, 1], dtype=torch.float64)


def over_the_sphere(probe: tr.testing.PhaseProbe, factor=torch.ones_like) -> float:
    """Integral over the sphere of the value times a factor of the cosine: Gauss' rule on intervals that narrow towards
    both poles and end where tables have corners."""
    edges = {1 - 2.0 ** (-k / 2) for k in range(72)} | {-1.0, 1.0}
    edges |= {-e for e in edges} | {2 * i / n - 1 for n in (4, 5) for i in range(n)}
    edges = torch.tensor(sorted(edges), dtype=torch.float64)
    x = torch.tensor([-0.9061798459386640, -0.5384693101056831, 0, 0.5384693101056831, 0.9061798459386640]).double()
    w = torch.tensor([0.2369268850561891, 0.4786286704993665, 128 / 225, 0.4786286704993665, 0.2369268850561891])
    half = (edges[1:] - edges[:-1])[:, None] / 2
    cosine = ((edges[1:] + edges[:-1])[:, None] / 2 + half * x).flatten()
    value = probe.eval(UP, at_cosines(cosine), PLACE)
    return float(2 * math.pi * (value * factor(cosine) * (half * w.double()).flatten()).sum())


def phase_parameters(scene: tr.Scene) -> dict[str, torch.Tensor]:
    return {n: t for n, t in scene.named_parameters() if n.startswith(name_of(scene))}
