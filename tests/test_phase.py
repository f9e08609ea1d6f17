"""Phase functions by themselves: samplers, values, integrals, derivatives, and what is refused.

Significance 0.01 for all chi-square tests and means of samples in this file together.
"""

from __future__ import annotations

import math

import pytest
import torch
from oracle import phases
from oracle.world import World

import torchrender as tr
from torchrender import backends

N = 60_000
CHI2_TESTS = 39  # chi-square tests below
MEANS = 9  # means of samples below

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


def probe_of(phase: dict, arithmetic: str = "double", variant: str = "rgb") -> tr.testing.PhaseProbe:
    dtype, packets = ARITHMETIC[arithmetic]
    scene = scene_of(phase, dtype, variant)
    return tr.testing.PhaseProbe(scene, name_of(scene), packets)


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


# ------------------------------------------------------------------------------------------------------------- samplers
@pytest.mark.parametrize("arithmetic", ARITHMETIC)
@pytest.mark.parametrize("name", PHASES)
def test_samples_follow_their_density(name, arithmetic):
    probe, exact = probe_of(PHASES[name], arithmetic), probe_of(PHASES[name])
    wo = probe.sample(AXIS, uniform(N, 3), PLACE)
    result = tr.testing.chi2_test(wo, lambda w: exact.eval(AXIS, w, PLACE), tests=CHI2_TESTS)
    assert result, result.message
    assert (probe.eval(AXIS, wo, PLACE) > 0).all()


def test_arithmetics_sample_alike():
    """The same numbers give the same directions, to rounding; 37 is no multiple of a packet's width."""
    for name, phase in PHASES.items():
        expected = probe_of(phase).sample(AXIS, uniform(37, 3), PLACE)
        for arithmetic in ("single", "packets"):
            found = probe_of(phase, arithmetic).sample(AXIS, uniform(37, 3), PLACE)
            torch.testing.assert_close(found.double(), expected, rtol=0, atol=3e-4, msg=f"{name}, {arithmetic}")


@pytest.mark.parametrize("arithmetic", ARITHMETIC)
@pytest.mark.parametrize("g", [-0.99, 0.99, 0.9999])
def test_narrow_lobes_are_sampled(g, arithmetic):
    """The share of the lobe within the angle of each sample is uniform, and independent of the azimuth; the share is
    the closed form of Henyey and Greenstein's cumulative distribution, in 1 - |cos|."""
    wo = probe_of({"type": "hg", "g": g}, arithmetic).sample(UP, uniform(N, 3)).double()
    cosine, a = wo[:, 2] * math.copysign(1, g), abs(g)
    squared = wo[:, :2].square().sum(1)
    t = torch.where(cosine > 0, squared / (1 + cosine), 1 - cosine)  # without cancellation
    share = (1 - a * a) / (2 * a) * (1 / (1 - a) - ((1 - a) ** 2 + 2 * a * t) ** -0.5)
    azimuth = torch.atan2(wo[:, 1], wo[:, 0]) / (2 * math.pi) % 1
    square = torch.stack([share.clamp(0, 1), azimuth], dim=1)
    result = tr.testing.chi2_test(square, lambda x: torch.ones(len(x)), domain="square", tests=CHI2_TESTS)
    assert result, result.message


@pytest.mark.parametrize("arithmetic", ARITHMETIC)
@pytest.mark.parametrize("g", [-0.9, -1e-5, 0.5])
def test_the_mean_cosine_of_samples_is_g(g, arithmetic):
    cosine = probe_of({"type": "hg", "g": g}, arithmetic).sample(AXIS, uniform(N, 3, seed=3)).double() @ AXIS
    # the mean of cos^2 is (1 + 2 g^2) / 3: that of the second Legendre polynomial is g^2
    z = (cosine.mean() - g) / math.sqrt((1 - g * g) / 3 / N)
    assert float(tr.testing.normal_p_value(z)) > tr.testing.sidak(0.01, MEANS), f"{float(z):.2f} standard errors"


def test_the_tails_of_uniform_numbers():
    """0 and the largest number below 1 give unit vectors in every arithmetic."""
    low, high = torch.zeros(1, 3), torch.full((1, 3), 1 - 2.0**-24)
    u = torch.cat(
        [
            torch.where(torch.tensor(bits), high, low)
            for bits in torch.cartesian_prod(*[torch.arange(2)] * 3).bool().tolist()
        ]
    )
    extremes = [{"type": "hg", "g": g} for g in (-0.9999, 0.9999)]
    for phase in (*PHASES.values(), *extremes):
        for arithmetic in ARITHMETIC:
            wo = probe_of(phase, arithmetic).sample(AXIS, u, PLACE).double()
            torch.testing.assert_close(wo.norm(dim=1), torch.ones(8, dtype=torch.float64), rtol=1e-6, atol=0)


# --------------------------------------------------------------------------------------------------------------- values
# By `eval_pdf` of Mitsuba 3.9.1 (scalar_rgb), for the angles 0, 30, ..., 180 degrees between the directions of travel.
MITSUBA = [
    (
        {"type": "hg", "g": 0.4},
        [0.30946800, 0.20933582, 0.10089020, 0.05350353, 0.03430698, 0.02650449, 0.02436045],
    ),
    (
        {"type": "hg", "g": -0.7},
        [0.00826064, 0.00913539, 0.01252259, 0.02231418, 0.05779891, 0.27753288, 1.50312912],
    ),
    ({"type": "hg"}, [3.58099103, 0.22331664, 0.03721120, 0.01364039, 0.00751636, 0.00544335, 0.00491219]),
    ({"type": "isotropic"}, [0.07957747] * 7),
    (
        {"type": "rayleigh"},
        [0.11936620, 0.10444543, 0.07460387, 0.05968310, 0.07460387, 0.10444543, 0.11936620],
    ),
    (
        {"type": "tabphase", "values": "0.5, 1.0, 2.0, 4.0"},
        [0.18189137, 0.16361475, 0.11368210, 0.06820926, 0.03978873, 0.02730557, 0.02273642],
    ),
    (
        {"type": "tabphase", "values": "0, 0.3, 0, 1.5, 1"},
        [0.13839561, 0.15693709, 0.20759340, 0.0, 0.04151868, 0.01112490, 0.0],
    ),
    (
        {
            "type": "blendphase",
            "weight": {"type": "constvolume", "value": 0.25},
            "a": {"type": "hg", "g": 0.4},
            "b": {"type": "rayleigh"},
        },
        [0.26194254, 0.18311322, 0.09431861, 0.05504842, 0.04438120, 0.04598973, 0.04811189],
    ),
]


@pytest.mark.parametrize("arithmetic", ARITHMETIC)
@pytest.mark.parametrize(("phase", "expected"), MITSUBA)
def test_values_of_mitsuba(phase, expected, arithmetic):
    angle = torch.deg2rad(torch.arange(0, 181, 30, dtype=torch.float64))
    found = probe_of(phase, arithmetic).eval(UP, at_cosines(torch.cos(angle)))
    torch.testing.assert_close(found.double(), torch.tensor(expected).double(), rtol=3e-6, atol=3e-8)


@pytest.mark.parametrize("name", PHASES)
def test_phase_functions_scatter_everything(name):
    assert over_the_sphere(probe_of(PHASES[name])) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("g", [-0.9999, -0.99, -0.5, -1e-4, 0, 1e-4, 0.3, 0.99, 0.9999])
def test_hg_has_integral_1_and_mean_cosine_g(g):
    probe = probe_of({"type": "hg", "g": g})
    assert over_the_sphere(probe) == pytest.approx(1, abs=1e-7)
    assert over_the_sphere(probe, lambda cosine: cosine) == pytest.approx(g, abs=1e-7)


@pytest.mark.parametrize("g", [-0.9999, -0.99, 0, 0.99, 0.9999])
def test_narrow_lobes_in_single_precision(g):
    """Relative accuracy at all angles, down to those that only the difference of the vectors resolves."""
    g = float(torch.tensor(g, dtype=torch.float32))
    t = torch.logspace(-11, math.log10(2), 60, dtype=torch.float64)[:-1]  # 1 - |cos|
    sine = torch.sqrt(t * (2 - t))
    wo = torch.stack([sine, torch.zeros_like(t), math.copysign(1, g) * (1 - t)], dim=1).float()
    expected = probe_of({"type": "hg", "g": g}).eval(UP, wo)
    for arithmetic in ("single", "packets"):
        found = probe_of({"type": "hg", "g": g}, arithmetic).eval(UP, wo)
        torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=0)


def test_the_scale_of_a_table_does_not_matter():
    wo = directions(50, 5)
    tables = [probe_of({"type": "tabphase", "values": [1000 * s * v for v in TABLE]}) for s in (0.001, 1.0)]
    torch.testing.assert_close(tables[0].eval(AXIS, wo), tables[1].eval(AXIS, wo), rtol=1e-12, atol=0)


def test_a_blend_follows_its_grid():
    """Between voxels the weight is interpolated, and the value is linear in it."""
    probe = probe_of(PHASES["blend in a grid"])
    wo = directions(1, 6)
    parts = [probe_of(PHASES[n]).eval(AXIS, wo) for n in ("table",)] + [
        probe_of({"type": "hg", "g": -0.2}).eval(AXIS, wo)
    ]
    centre = torch.tensor([[2.5 / 4, 1.5 / 3, 0.5 / 2], [3 / 4, 1.5 / 3, 0.5 / 2]])  # a voxel, and half way along x
    weight = torch.stack([GRID[0, 1, 2, 0], (GRID[0, 1, 2, 0] + GRID[0, 1, 3, 0]) / 2])
    torch.testing.assert_close(probe.eval(AXIS, wo, centre), (1 - weight) * parts[0] + weight * parts[1])


def test_weights_0_and_1_are_the_parts():
    wo, u = directions(20, 8), uniform(9, 3)
    for weight, part in ((0.0, "forward"), (1.0, "rayleigh")):
        blend = {"type": "blendphase", "weight": {"type": "constvolume", "value": weight}}
        probe = probe_of({**blend, "a": PHASES["forward"], "b": PHASES["rayleigh"]})
        torch.testing.assert_close(probe.eval(AXIS, wo), probe_of(PHASES[part]).eval(AXIS, wo))
        torch.testing.assert_close(probe.sample(AXIS, u), probe_of(PHASES[part]).sample(AXIS, u))


# ---------------------------------------------------------------------------------------------------------- derivatives
def phase_parameters(scene: tr.Scene) -> dict[str, torch.Tensor]:
    return {n: t for n, t in scene.named_parameters() if n.startswith(name_of(scene))}


WITH_PARAMETERS = [n for n in PHASES if n not in ("isotropic", "rayleigh")]


@pytest.mark.parametrize("variant", ["rgb", "mono"])
@pytest.mark.parametrize("name", WITH_PARAMETERS)
def test_derivatives_against_finite_differences(name, variant):
    probe = probe_of(PHASES[name], variant=variant)
    n = 40
    d, wo, p = directions(n, 11), directions(n, 12), uniform(n, 3, seed=13) * 1.2 - 0.1
    adjoint = uniform(n, probe.scene.channels, seed=14) - 0.3
    gradients = probe.reverse(d, wo, adjoint, p)
    checked = 0
    for path, tensor in phase_parameters(probe.scene).items():
        if path.endswith("to_world"):
            continue
        for i in range(tensor.numel()):
            number, h = tensor.data.view(-1)[i], 1e-6
            x = float(number)
            low = x if x < h else x - h  # zeros of a table or a weight have one side only
            high = x if x > 1 - h and "weight" in path else x + h
            sums = []
            for at in (low, high):
                tensor.data.view(-1)[i] = at
                sums.append(float((adjoint.sum(1) * probe.eval(d, wo, p)).sum()))
            tensor.data.view(-1)[i] = x
            expected = (sums[1] - sums[0]) / (high - low)
            rounding = 1e-15 * abs(sums[0]) * n / (high - low)
            onesided = 1e-5 if high - low < 1.5 * h else 1e-8
            found = float(gradients[path].view(-1)[i])
            assert found == pytest.approx(expected, rel=onesided, abs=onesided + rounding), f"{path}[{i}]"
            checked += 1
    assert checked > 0


@pytest.mark.parametrize("variant", ["rgb", "mono"])
@pytest.mark.parametrize("name", PHASES)
def test_values_and_gradients_are_those_of_the_oracle(name, variant):
    probe = probe_of(PHASES[name], variant=variant)
    n = 40
    d, wo, p = directions(n, 11), directions(n, 12), uniform(n, 3, seed=13) * 1.2 - 0.1
    adjoint = uniform(n, probe.scene.channels, seed=14) - 0.3
    wanted = {path: t.requires_grad_() for path, t in phase_parameters(probe.scene).items() if "to_world" not in path}
    value = phases.evaluate(World(probe.scene), probe.index, p, d, wo)
    torch.testing.assert_close(probe.eval(d, wo, p), value.detach(), rtol=1e-12, atol=0)
    if not wanted:
        return
    expected = torch.autograd.grad((adjoint.sum(1) * value).sum(), list(wanted.values()))
    found = probe.reverse(d, wo, adjoint, p)
    for path, gradient in zip(wanted, expected, strict=True):
        torch.testing.assert_close(
            found[path], gradient, rtol=1e-10, atol=1e-14, msg=lambda m, path=path: f"{path}: {m}"
        )


def test_the_derivative_of_hg_at_0():
    """d/dg at g = 0 is 3 cos / (4 pi), the first Legendre polynomial of the expansion in g."""
    wo = directions(30, 15)
    probe = probe_of({"type": "hg", "g": 0.0})
    (path,) = phase_parameters(probe.scene)
    adjoint = torch.tensor([[1.0, 0, 0]])
    found = probe.forward(AXIS, wo, adjoint, {path: torch.ones(())})
    torch.testing.assert_close(found[:, 0], 3 / (4 * math.pi) * (wo @ AXIS))
    assert not found[:, 1:].any()


@pytest.mark.parametrize("arithmetic", ARITHMETIC)
@pytest.mark.parametrize("name", WITH_PARAMETERS)
def test_forward_and_reverse_mode_agree(name, arithmetic):
    probe = probe_of(PHASES[name], arithmetic)
    n = 37
    d, wo, p = directions(n, 21), directions(n, 22), uniform(n, 3, seed=23)
    adjoint = uniform(n, 3, seed=24)
    tangents = {
        path: uniform(*t.shape, seed=25 + i) - 0.5
        for i, (path, t) in enumerate(phase_parameters(probe.scene).items())
        if not path.endswith("to_world")
    }
    gradients = probe.reverse(d, wo, adjoint, p)
    reverse = sum(float((gradients[path].double() * t).sum()) for path, t in tangents.items())
    forward = probe.forward(d, wo, adjoint, tangents, p).double().sum()
    assert float(forward) == pytest.approx(reverse, rel=1e-10 if arithmetic == "double" else 1e-4)


def test_a_gradient_of_a_table_has_no_part_along_the_table():
    """Scaling all numbers changes nothing (Euler's theorem)."""
    probe = probe_of(PHASES["table"])
    (path,) = phase_parameters(probe.scene)
    gradient = probe.reverse(directions(30, 31), directions(30, 32), uniform(30, 3), None)[path]
    along = float(gradient @ torch.tensor(TABLE, dtype=torch.float64))
    assert abs(along) < 1e-13 * float(gradient.norm()) * 10


def test_zeros_next_to_each_other_are_said():
    scene = scene_of(PHASES["table with zeros"])
    assert "without scattering into angles between two zeros" in str(scene)
    assert "between two zeros" not in str(scene_of(PHASES["table"]))


# ------------------------------------------------------------------------------------------------------------- refusals
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
    handle = backends.ready().Scene(color="rgb", dtype="float64")
    with pytest.raises(ValueError, match=r"field 'phase_1': expected a phase function that is no blend itself"):
        handle.build(objects, [tuple(slot.tensor().shape) for slot in layout.slots], [])


def test_the_probe_says_what_is_there():
    scene = scene_of(PHASES["blend"])
    with pytest.raises(ValueError, match=r"no phase function 'ball'; there are ball\.interior"):
        tr.testing.PhaseProbe(scene, "ball")
    with pytest.raises(ValueError, match=r"expected a scene in float32, got torch\.float64"):
        tr.testing.PhaseProbe(scene, name_of(scene), packets=True)
