"""Native BSDF models by themselves: their parameters at random, and the same models in plain PyTorch."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import bsdf_cases
import torch
from oracle.bsdf import MODELS
from torch.nn.functional import normalize

import torchrender as tr
from torchrender.scene.conversion import encode
from torchrender.scene.declaration import Model, models
from torchrender.wavefront.bsdf import Bsdf
from torchrender.wavefront.world import Record

DECLARED: dict[str, Model] = {
    kind: model
    for (category, kind), model in models().items()
    if category == "bsdf" and "wraps_bsdfs" not in model.flags
}
# Models with each combination of their choices.
CASES = [
    (kind, dict(zip([f.name for f in choices], values, strict=True)))
    for kind, model in DECLARED.items()
    for choices in [[f for f in model.fields if f.kind == "int"]]
    for values in itertools.product(*((False, True) if f.boolean else f.choices or () for f in choices))
]
RANGES = {"eta": (1.2, 1.8), "k": (1.0, 4.0), "alpha": (0.2, 0.8), "alpha_u": (0.2, 0.8), "alpha_v": (0.2, 0.8)}


def parameters(kind: str, n: int, channels: int = 3, seed: int = 0) -> dict[str, torch.Tensor]:
    """Values in float64: colours (n, channels), other textures (n,), numbers ()."""
    generator = torch.Generator().manual_seed(seed)
    found = {}
    for field in DECLARED[kind].fields:
        if field.kind == "int":
            continue
        low, high = RANGES.get(field.name, (0.2, 0.9))
        color = field.name in tr.native_bsdf(kind).colors
        shape = (n, channels) if color else (n,) if field.kind == "texture" else ()
        found[field.name] = low + (high - low) * torch.rand(shape, generator=generator, dtype=torch.float64)
    return found


def pairs(n: int, seed: int = 3) -> tuple[torch.Tensor, torch.Tensor]:
    """Directions (n, 3) of all sides, many of them near to what smooth surfaces reflect and refract."""
    wi, wo = (normalize(torch.from_numpy(d).double(), dim=1) for d in bsdf_cases.directions(n, seed))
    return wi, wo


def in_plain_pytorch(kind: str, choices: dict, values: dict[str, torch.Tensor], channels: int = 3) -> Bsdf:
    """The model of `oracle.bsdf` with these parameters."""
    numbers = {f.name: encode(f, choices[f.name]) if f.kind == "int" else 0 for f in DECLARED[kind].fields}
    world = SimpleNamespace(
        channels=channels,
        kept={},
        tensor=lambda category, record, name: values[name],
        color=lambda category, record, name, at: values[name] if values[name].ndim == 2 else values[name][:, None],
    )
    return MODELS[kind](world, Record(kind, numbers, "alone"), None)  # pyright: ignore
