"""Mueller matrices of surfaces on an optical bench, rendered, against closed forms: Fresnel's equations and devices."""

from __future__ import annotations

import cmath
import math

import pytest
import torch
from optical_bench import T, bench, mueller, stokes, surface

pytestmark = pytest.mark.core
BREWSTER = math.degrees(math.atan(1.5))
LIKE_GLASS = {"type": "conductor", "eta": 1.5, "k": 0.0}  # reflects as glass does, and lets nothing pass
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}


def inside(index: float) -> dict:
    """Glass seen from inside."""
    return {"type": "dielectric", "int_ior": 1.0, "ext_ior": index}


def assert_close(found: torch.Tensor, expected: list[list[float]] | torch.Tensor, tolerance: float = 1e-7) -> None:
    expected = torch.as_tensor(expected, dtype=torch.float64)
    assert (found - expected).abs().max() < tolerance, found


def block(a: float, b: float, x: float, y: float) -> list[list[float]]:
    return [[a, b, 0, 0], [b, a, 0, 0], [0, 0, x, -y], [0, 0, y, x]]


@pytest.mark.parametrize(
    ("index", "angle", "psi", "delta"),
    [
        (0.183 - 3.43j, 70, 43.650, 108.127),  # gold
        (0.183 - 3.43j, 75, None, 89.40),
        (1.37 - 7.62j, 70, 42.011, 143.774),  # aluminium
        (3.88 - 0.019j, 75, 1.200, 172.844),  # silicon
    ],
)
def test_ellipsometry(index, angle, psi, delta):
    """r_p / r_s = tan(psi) exp(i delta), from the entries that an ellipsometer measures."""
    m = mueller(angle, angle, surface=surface({"type": "conductor", "eta": index.real, "k": -index.imag}))
    found_psi = math.degrees(math.acos(float(m[0, 1] / m[0, 0]))) / 2
    found_delta = math.degrees(math.atan2(float(m[3, 2]), float(m[2, 2])))
    c, s2 = math.cos(math.radians(angle)), math.sin(math.radians(angle)) ** 2
    q = cmath.sqrt(index**2 - s2)
    ratio = (index**2 * c - q) / (index**2 * c + q) * (c + q) / (c - q)
    assert abs(found_psi - math.degrees(math.atan(abs(ratio)))) < 1e-5
    assert abs(found_delta - math.degrees(cmath.phase(ratio))) < 1e-5
    assert psi is None or abs(found_psi - psi) < 6e-4
    assert abs(found_delta - delta) < (6e-4 if psi is not None else 6e-3)


def test_normal_incidence():
    assert_close(mueller(0, 0, surface=surface(LIKE_GLASS)), block(0.04, 0, -0.04, 0))


def test_brewster():
    """R_s is (5/13)^2; of what passes r_p is 0, and t_s t_p is 12/13."""
    half = 25 / 338
    assert_close(mueller(BREWSTER, BREWSTER, surface=surface(LIKE_GLASS)), block(half, half, 0, 0))
    # of glass itself, some of whose samples are reflected, up to their number
    m = mueller(BREWSTER, BREWSTER, 64, surface=surface(GLASS))
    assert_close(m / m[0, 0], block(1, 1, 0, 0))
    passed = mueller(90 - BREWSTER, 180 - BREWSTER, 64, surface=surface(inside(1.5)))
    assert_close(passed / passed[0, 0], block(1, -25 / 313, 312 / 313, 0))


@pytest.mark.parametrize("bsdf", [LIKE_GLASS, {"type": "conductor", "eta": 0.183, "k": 3.43}, inside(1.5)])
def test_grazing_light_is_reflected_as_it_is(bsdf):
    """Up to the angle, 1.7e-6 times some index."""
    assert_close(mueller(89.9999, 89.9999, surface=surface(bsdf)), torch.eye(4), 2e-5)


def test_total_reflection():
    """At the angle whose phase is the largest: 2 arctan((1 - n^2) / (2 n))."""
    n = 1 / 1.5
    angle = math.degrees(math.acos(math.sqrt((1 - n * n) / (1 + n * n))))
    phase = 2 * math.atan((1 - n * n) / (2 * n))
    assert abs(phase - 0.7895822394) < 1e-10
    assert_close(mueller(angle, angle, surface=surface(inside(1.5))), block(1, 0, math.cos(phase), math.sin(phase)))


def test_a_film_of_air():
    """Between panes of glass, beyond the critical angle, it reflects as glass that ends does."""
    film, end = ({"type": kind, "int_ior": 1.0, "ext_ior": 1.5} for kind in ("thindielectric", "dielectric"))
    assert_close(mueller(60, 60, surface=surface(film)), mueller(60, 60, surface=surface(end)), 1e-10)


def test_fresnel_s_rhomb():
    """Two total reflections, each of an eighth of a wave, make circular light of diagonal light."""
    angle = 51.782
    top = [0, 2 * math.tan(math.radians(angle)), 2]
    faces = {
        "bottom": surface(inside(1.49661), to_world=T.scale(1)),
        "top": surface(inside(1.49661), to_world=T.translate(top) @ T.rotate([1, 0, 0], 180) @ T.scale(1)),
    }
    assert_close(mueller(angle, 180 - angle, center=top, **faces), block(1, 0, 0, 1), 2e-5)


@pytest.mark.parametrize("angle", [20, 45, 70])
def test_two_panes(angle):
    """What goes straight through both: of each s and p (1 - R) / (1 + R), and of U and V t / (1 - r^2)."""
    pane = {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}
    panes = {f"pane{i}": surface(pane, to_world=T.translate([0, 0, -0.5 * i]) @ T.scale(3)) for i in range(2)}
    m = mueller(angle, 180 - angle, 64, **panes)
    c = math.cos(math.radians(angle))
    q = math.sqrt(1.5**2 - 1 + c * c)
    r_s, r_p = (c - q) / (c + q), (1.5**2 * c - q) / (1.5**2 * c + q)
    s, p = (((1 - r * r) / (1 + r * r)) ** 2 for r in (r_s, r_p))
    x = ((1 - r_s**2) * (1 - r_p**2) / (1 - (r_s * r_p) ** 2)) ** 2
    assert_close(m / m[0, 0], block(1, (s - p) / (s + p), 2 * x / (s + p), 0))


def test_at_brewster_s_angle_the_index_does_not_matter_to_p():
    eta = torch.tensor(1.5, dtype=torch.float64, requires_grad=True)
    scene = bench("unpolarised", BREWSTER, BREWSTER, surface=surface(LIKE_GLASS))
    light = stokes(scene, params={"surface.bsdf.eta.value": eta.expand(3)})
    (by_s,) = torch.autograd.grad(light[0] + light[1], eta, retain_graph=True)
    (by_p,) = torch.autograd.grad(light[0] - light[1], eta)
    # R_s = ((1 - n^2) / (1 + n^2))^2 there; at this angle c = 1 / sqrt(1 + n^2), and q = n^2 c
    c = 1 / math.sqrt(1 + 1.5**2)
    q = 1.5**2 * c
    derivative = 2 * (c - q) / (c + q) * (-2 * c / (c + q) ** 2) * 1.5 / q
    assert abs(float(by_s) - derivative) < 1e-6 and abs(float(by_p)) < 1e-7
