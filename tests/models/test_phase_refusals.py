"""What phase functions refuse, and what edits of them do."""

from __future__ import annotations

import math

import pytest
import torch
from phase_cases import AXIS, GRID, PHASES, directions, name_of, phase_parameters, probe_of, scene_of

import torchrender as tr
from torchrender import backends

HG = {"type": "hg", "g": 0.1}


@pytest.mark.parametrize(
    ("phase", "message"),
    [
        ({"type": "tabphase"}, "'values' is missing"),
        ({"type": "tabphase", "values": "1"}, r"values: expected at least two numbers, of shape \(N,\)"),
        ({"type": "tabphase", "values": [[1.0, 2.0]]}, r"values: expected at least two numbers, of shape \(N,\)"),
        ({"type": "tabphase", "values": "1, two"}, "values: expected numbers, got '1, two'"),
        ({"type": "tabphase", "values": [1.0, -0.5]}, r"values: -0.5 is outside the range \[0, inf\]"),
        ({"type": "tabphase", "values": [0.0, 0.0]}, "values: one of the numbers must be positive"),
        ({"type": "tabphase", "values": [1.0, math.nan]}, "values: has values that are not finite"),
        ({"type": "hg", "g": 1.0}, "g: 1 is outside the range"),
        ({"type": "blendphase", "a": HG}, "expected two nested phase functions, got 1"),
        ({"type": "blendphase", "a": HG, "b": HG, "c": HG}, "blendphase"),
        (
            {"type": "blendphase", "a": HG, "b": {"type": "blendphase", "a": HG, "b": HG}},
            "phase_1: a blendphase cannot be part of another",
        ),
        (
            {"type": "blendphase", "a": HG, "b": HG, "weight": {"type": "gridvolume", "data": torch.ones(2, 2, 2, 3)}},
            "weight.data: expected one channel, got 3",
        ),
        ({"type": "sggx"}, "the phase 'sggx' is not supported"),
    ],
)
def test_what_is_refused(phase, message):
    with pytest.raises(ValueError, match=message) as error:
        scene_of(phase)
    assert str(error.value).startswith("ball.interior")


@pytest.mark.parametrize(
    ("phase", "suffix", "value", "message"),
    [
        ("table", "values", [1.0, -1, 1, 1, 1], "'values': expected finite numbers that are not negative, got -1"),
        ("table", "values", [0.0] * 5, "'values': expected a positive number among them, got only zeros"),
        ("blend", "value", 1.5, "'weight': expected numbers from 0 to 1, got 1.5"),
        ("blend in a grid", "data", GRID - 1, "'weight': expected numbers from 0 to 1, got -"),
    ],
)
def test_values_that_an_edit_has_spoilt(phase, suffix, value, message):
    probe = probe_of(PHASES[phase])
    (tensor,) = [t for n, t in phase_parameters(probe.scene).items() if n.endswith(suffix)]
    good = tensor.detach().clone()
    with torch.no_grad():
        tensor.copy_(torch.as_tensor(value))
    with pytest.raises(ValueError, match=message) as error:
        probe.eval(AXIS, AXIS)
    assert str(error.value).startswith(name_of(probe.scene))
    with torch.no_grad():
        tensor.copy_(good)
    assert probe.eval(AXIS, AXIS) > 0


def test_edits_reach_the_tables():
    probe = probe_of(PHASES["table"])
    (tensor,) = phase_parameters(probe.scene).values()
    probe.eval(AXIS, AXIS)
    with torch.no_grad():
        tensor.copy_(torch.tensor([1.0, 2, 3, 4, 5]))
    expected = probe_of({"type": "tabphase", "values": [1, 2, 3, 4, 5]}).eval(AXIS, directions(9, 41))
    torch.testing.assert_close(probe.eval(AXIS, directions(9, 41)), expected)


def test_parts_are_replaced_but_not_removed():
    scene = scene_of(PHASES["blend"], torch.float64)
    blend = next(m for m in scene.modules() if isinstance(m, tr.BlendPhase))
    with pytest.raises(ValueError, match=r"BlendPhase\.phase_1: None removes a part"):
        blend.phase_1 = None
    with pytest.raises(ValueError, match=r"BlendPhase\.phase_1: a blendphase cannot be part of another"):
        blend.phase_1 = tr.BlendPhase(a={"type": "isotropic"}, b={"type": "isotropic"})
    blend.phase_1 = tr.Isotropic()
    expected = 0.7 * probe_of({"type": "hg", "g": 0.6}).eval(AXIS, AXIS) + 0.3 / (4 * math.pi)
    torch.testing.assert_close(tr.testing.PhaseProbe(scene, name_of(scene)).eval(AXIS, AXIS), expected)


def test_the_core_refuses_blends_of_blends():
    """Whoever packs scenes without the classes gets the place in the scene, too."""
    scene = scene_of(PHASES["blend"])
    layout = scene.layout()
    objects = {category: list(rows) for category, rows in layout.objects.items()}
    kind, numbers, path = objects["phase"][-1]
    objects["phase"][-1] = (kind, [*numbers[:2], len(objects["phase"]) - 1], path)
    handle = backends.ready(torch.float64).Scene("rgb", "float64")
    with pytest.raises(ValueError, match=r"field 'phase_1': expected a phase function that is no blend itself"):
        handle.build(objects, [tuple(slot.tensor().shape) for slot in layout.slots], [])


def test_the_probe_says_what_is_there():
    scene = scene_of(PHASES["blend"])
    with pytest.raises(ValueError, match=r"no phase function 'ball'; there are ball\.interior"):
        tr.testing.PhaseProbe(scene, "ball")
