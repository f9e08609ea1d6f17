"""Values of BSDFs against those of Mitsuba 3.9.1, direction by direction, of which `bsdf_cases.py` has the scenes; and
of redner's material against redner 0.4.28."""

from __future__ import annotations

import bsdf_cases
import numpy as np
import pytest
import reference_scenes
import torch

import torchrender as tr

REFERENCES = {k: v for file in bsdf_cases.FILES for k, v in np.load(reference_scenes.DATA / file).items()}


def probe(bsdf: dict) -> tr.testing.BsdfProbe:
    scene = {"type": "scene", "camera": {"type": "perspective"}, "ball": {"type": "sphere", "bsdf": bsdf}}
    return tr.testing.BsdfProbe(tr.load_dict(scene, dtype=torch.float64), "ball.bsdf")


def directions() -> tuple[torch.Tensor, torch.Tensor]:
    """As stored, and of unit length to the last digit."""
    wi, wo = (torch.from_numpy(v).double() for v in bsdf_cases.directions())
    return torch.nn.functional.normalize(wi, dim=1), torch.nn.functional.normalize(wo, dim=1)


@pytest.mark.parametrize("name", bsdf_cases.ALL_SMOOTH)
def test_values(name):
    wi, wo = directions()
    expected = torch.from_numpy(REFERENCES[f"{name}.eval"]).double()
    value = probe(bsdf_cases.ALL_SMOOTH[name]).eval(wi, wo).value
    assert (expected > 0).double().mean() > 0.3
    # Mitsuba computes in single precision, and masks Beckmann facets by a rational fit of Smith's function; its weights
    # of luminance, which tints depend on, have more digits than the rounded ones of Rec. 709. What gets through a rough
    # coating is found by quadrature, with fewer nodes there; the Bessel function of hair is rounded, see test_hair.py.
    rtol = 6e-3 if "beckmann" in name or "hair" in name else 3e-3 if name.startswith("roughplastic") else 1e-4
    torch.testing.assert_close(value, expected, rtol=rtol, atol=1e-6 * float(expected.max()))


@pytest.mark.parametrize("name", bsdf_cases.DELTA)
def test_delta_lobes(name):
    """The weight of each lobe times its probability, whatever that is."""
    wi, _ = directions()
    of, bsdf = probe(bsdf_cases.DELTA[name]), bsdf_cases.DELTA[name]["type"]
    found = torch.zeros(2, len(wi), 3, dtype=torch.float64)
    for u in (0.0, 0.999999):
        sample = of.sample(wi, torch.full((1, 3), u, dtype=torch.float64))
        lobe = (sample.wo[:, 2] * wi[:, 2] < 0).long()
        rows = sample.delta & (sample.pdf > 0)
        value = sample.weight * sample.pdf[:, None]
        found[lobe[rows], rows.nonzero()[:, 0]] = value[rows]
        mirrored = wi * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
        torch.testing.assert_close(sample.wo[rows], torch.where(lobe[:, None] > 0, -wi, mirrored)[rows])
    expected = torch.from_numpy(REFERENCES[f"{name}.delta"]).double()
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)
    assert (expected[0] > 0).any() and (bsdf != "thindielectric" or (expected[1] > 0).any())


def test_redners_material():
    stored = {k: torch.from_numpy(v) for k, v in np.load(reference_scenes.DATA / "redner_material.npz").items()}
    for i in range(len(stored["wi"])):
        bsdf = {"type": "redner", "roughness": float(stored["roughness"][i])}
        for lobe in ("diffuse", "specular"):
            bsdf[f"{lobe}_reflectance"] = {"type": "rgb", "value": stored[lobe][i].tolist()}
        value = probe(bsdf).eval(stored["wi"][i : i + 1], stored["wo"][i : i + 1]).value[0]
        torch.testing.assert_close(value, stored["value"][i].double(), rtol=1e-3, atol=0)  # redner's lamp has a size
