"""The 16 entries of Mueller matrices against those that Mitsuba 3.9.1 evaluates and samples, stored in
`data/mueller_references.npz` (see bench/make_mueller_references.py).

Those of tests/oracle are compared, which test_stokes_oracle.py compares with the native ones.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from mueller_cases import DELTA, PERPENDICULAR, SMOOTH, directions
from oracle.bsdf import MODELS
from oracle.bsdf.common import Polarising
from oracle.mueller import DEPOLARISER
from oracle.polarized import on_implicit_axes
from oracle.world import World
from reference_parts import DATA

import torchrender as tr
from torchrender.wavefront.bsdf import Bsdf
from torchrender.wavefront.world import At


@pytest.fixture(scope="module")
def references() -> dict[str, np.ndarray]:
    with np.load(DATA / "mueller_references.npz") as file:
        return dict(file)


def bsdf_of(description: dict, n: int) -> Bsdf:
    film = {"type": "hdrfilm", "width": 1, "height": 1}
    objects = {"sensor": {"type": "perspective", "film": film}, "square": {"type": "rectangle", "bsdf": description}}
    world = World(tr.load_dict({"type": "scene", **objects}, variant="mono", dtype=torch.float64))
    (record,) = world.records["bsdf"]
    nowhere = torch.zeros(n, dtype=torch.int64)
    return MODELS[record.type](world, record, At(nowhere, nowhere, *torch.zeros(2, n, 2, dtype=torch.float64)))


def mueller(bsdf: Bsdf, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
    matrix = DEPOLARISER
    if isinstance(bsdf, Polarising):
        matrix = on_implicit_axes(bsdf.parts(wi, wo, lobe), wi, wo)[:, 0]
    return bsdf.eval(wi, wo, lobe)[..., None] * matrix


def lobes(bsdf: Bsdf, wi: torch.Tensor) -> torch.Tensor:
    """What is reflected and what passes, (2, n, 4, 4)."""
    found = torch.zeros(2, len(wi), 4, 4, dtype=torch.float64)
    for u in (0.0, 1 - 1e-9):
        s = bsdf.sample(wi, torch.full((len(wi), 4), u, dtype=torch.float64))
        rows = (s.pdf > 0).nonzero()[:, 0]
        passes = (s.wo[rows, 2] * wi[rows, 2] < 0).long()
        found[passes, rows] = mueller(bsdf, wi, s.wo, s.lobe)[rows]
    return found


@pytest.mark.parametrize("name", [*SMOOTH, *DELTA, *PERPENDICULAR])
def test_matrices(name, references):
    wi, wo = (torch.from_numpy(w) for w in directions(name))
    bsdf = bsdf_of({**SMOOTH, **DELTA, **PERPENDICULAR}[name], len(wi))
    found = mueller(bsdf, wi, wo, torch.zeros(len(wi), dtype=torch.int64))[None] if name in SMOOTH else lobes(bsdf, wi)
    expected = torch.from_numpy(references[name]).double()
    assert (found - expected).abs().max() < 1e-5, (found - expected).abs().amax((0, 1))
    assert expected[..., 0, 0].max() > 0.1
