"""Polarised light against closed forms: Fresnel's, Malus', wave plates; functions of Stokes vectors; refusals."""

from __future__ import annotations

import cmath
import math

import pytest
import torch
from optical_bench import under_sky

import torchrender as tr
from torchrender import polarization as pol

pytestmark = pytest.mark.core
T = tr.Transform


def stokes(scene: tr.Scene, **settings) -> torch.Tensor:
    return tr.render(scene, spp=4, seed=0, outputs=("stokes",), **settings).stokes[0, 0, 0]


def amplitudes(angle: float, index: complex) -> tuple[complex, complex]:
    c, s2 = math.cos(math.radians(angle)), math.sin(math.radians(angle)) ** 2
    q = cmath.sqrt(index * index - s2)
    return (c - q) / (c + q), (index**2 * c - q) / (index**2 * c + q)


@pytest.mark.parametrize("angle", [20, 50, 75])
def test_a_metal_reflects_as_fresnel_says(angle):
    found = stokes(under_sky(angle, {"type": "conductor", "eta": 0.183, "k": 3.43}))
    r_s, r_p = amplitudes(angle, 0.183 - 3.43j)
    mean, half = (abs(r_s) ** 2 + abs(r_p) ** 2) / 2, (abs(r_s) ** 2 - abs(r_p) ** 2) / 2
    assert torch.allclose(found, torch.tensor([mean, half, 0, 0], dtype=torch.float64), atol=1e-6)


def test_brewster():
    """At arctan(1.5) glass reflects 0.1479289 of s alone; what passes is 1 / 1.5^2 of the rest."""
    angle = math.degrees(math.atan(1.5))
    scene = under_sky(angle, {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0})
    found = tr.render(scene, spp=40000, seed=1, outputs=("stokes",)).stokes[0, 0, 0]
    reflected, passed = 0.1479289 / 2, (1 - 0.1479289 / 2) / 1.5**2
    # Q of what is reflected or passes, by chance: standard deviation below 0.3 / sqrt(40000); five of them
    expected = torch.tensor([reflected + passed, reflected * (1 - 1 / 1.5**2), 0, 0], dtype=torch.float64)
    assert torch.allclose(found, expected, atol=5 * 0.3 / 200)
    # a black sky below, by a mirror that absorbs: what is reflected is polarised wholly
    scene["floor"] = {
        "type": "rectangle",
        "to_world": T.translate([0, 0, -1]) @ T.scale(1000),
        "bsdf": {"type": "diffuse", "reflectance": 0.0},
    }
    found = tr.render(scene, spp=400, seed=1, outputs=("stokes", "dolp", "aolp"))
    assert float(found.dolp[0, 0, 0]) > 1 - 1e-5 and abs(math.sin(float(found.aolp[0, 0, 0]))) < 1e-4


def plates(*bsdfs: dict) -> tr.Scene:
    """Plates one behind the other before a mirror that is seen at 60 degrees, as if straight on."""
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    squares = {
        f"p{i}": {"type": "rectangle", "to_world": T.translate([0, 0, 3 - i]) @ T.scale(9), "bsdf": b}
        for i, b in enumerate(bsdfs)
    }
    camera = {"type": "perspective", "fov": 1e-3, "to_world": T.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]), "film": film}
    return tr.load_dict(
        {"type": "scene", "sensor": camera, "sky": {"type": "constant"}, **squares}, dtype=torch.float64
    )


@pytest.mark.parametrize("angle", [0, 15, 30, 45, 60, 75, 90])
def test_malus(angle):
    scene = plates({"type": "polarizer", "theta": float(angle)}, {"type": "polarizer"})
    assert abs(float(stokes(scene)[0]) - 0.5 * math.cos(math.radians(angle)) ** 2) < 1e-6
    theta = torch.tensor(float(angle), dtype=torch.float64, requires_grad=True)
    stokes(scene, params={"p0.bsdf.theta.value": theta})[0].backward()
    expected = -0.5 * math.sin(math.radians(2 * angle)) * math.pi / 180
    assert abs(float(theta.grad) - expected) < 1e-8


def test_a_third_polariser_lets_an_eighth_pass():
    scene = plates(*({"type": "polarizer", "theta": float(t)} for t in (90, 45, 0)))
    assert abs(float(stokes(scene)[0]) - 0.125) < 1e-6
    crossed = plates({"type": "polarizer", "theta": 90.0}, {"type": "polarizer"})
    assert float(stokes(crossed).abs().max()) < 1e-12


def test_wave_plates():
    """Of light at 45 degrees to its axis a quarter-wave plate makes circular light, a half-wave plate crosses it."""
    source = {"type": "polarizer", "theta": 45.0}
    quarter, half = ({"type": "retarder", "delta": d} for d in (90.0, 180.0))
    before, circular, twice = (stokes(plates(*p, source)) for p in ((), (quarter,), (quarter, quarter)))
    assert abs(abs(float(circular[3])) - 0.5) < 1e-6 and float(circular[1:3].abs().max()) < 1e-6
    assert torch.allclose(twice, stokes(plates(half, source)), atol=1e-9)
    assert torch.allclose(twice[2], -before[2], atol=1e-6)
    # what a circular polariser of that hand passes, the other one stops
    passed = [float(stokes(plates({"type": "circular", "left_handed": h}, quarter, source))[0]) for h in (False, True)]
    assert sorted(passed) == pytest.approx([0.0, 0.5], abs=1e-6)


def test_matrices_and_analysers():
    generator = torch.Generator().manual_seed(0)
    light = torch.rand(5, 4, generator=generator, dtype=torch.float64) - 0.5
    light[:, 0] = 2.0
    for angle in (0.3, 1.2):
        behind = (pol.linear_polariser(torch.tensor(angle, dtype=torch.float64)) @ light[..., None])[:, 0, 0]
        assert torch.allclose(behind, pol.analyser(light, angle))
        delayed = (pol.retarder(torch.tensor(0.7, dtype=torch.float64)) @ light[..., None])[..., 0]
        assert torch.allclose(pol.analyser(delayed, angle), pol.analyser(light, angle, 0.7))
    turned = (pol.rotation(torch.tensor(0.4, dtype=torch.float64)) @ light[..., None])[..., 0]
    assert torch.allclose(pol.dolp(turned), pol.dolp(light)) and torch.allclose(turned[:, 3], light[:, 3])
    assert torch.allclose((pol.aolp(light) - pol.aolp(turned)) % math.pi, torch.full((5,), 0.4, dtype=torch.float64))
    light.requires_grad_()
    assert torch.autograd.gradcheck(lambda s: (pol.dolp(s), pol.aolp(s), pol.docp(s)), (light,))
    dark = torch.zeros(4, dtype=torch.float64, requires_grad=True)
    (pol.dolp(dark) + pol.docp(dark) + pol.aolp(dark)).backward()
    assert torch.isfinite(dark.grad).all()
    assert pol.false_color(light.detach()).shape == (5, 3)
    with pytest.raises(ValueError, match=r"expected a tensor of floating-point numbers \(..., 4\)"):
        pol.dolp(torch.zeros(3))


def test_outputs_and_variants():
    gold = {"type": "conductor", "material": "Au"}
    scene = under_sky(60, gold)
    image = tr.render(scene, spp=4, seed=0)
    out = tr.render(scene, spp=4, seed=0, outputs=("rgb", "stokes", "dolp", "alpha", "depth"), layout="chw")
    assert out.stokes.shape == (4, 3, 1, 1) and out.dolp.shape == (3, 1, 1) and out.alpha.item() == 1
    assert torch.allclose(out.rgb, out.stokes[0]) and torch.allclose(out.rgb[:, 0, 0], image[0, 0])
    vectors = tr.render(scene, spp=4, seed=0, integrator={"type": "stokes", "nested": {"type": "direct"}})
    assert vectors.shape == (1, 1, 3, 4)
    many = tr.render(scene, spp=4, seed=0, sensor=[0, 0], outputs=("stokes",)).stokes
    assert many.shape == (2, 1, 1, 3, 4)
    for variant in tr.variants():
        if variant.endswith("_polarized"):
            crossed = tr.load_dict(
                {
                    "type": "scene",
                    "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 2, "height": 2}},
                    "sky": {"type": "constant"},
                    **{
                        f"p{i}": {
                            "type": "rectangle",
                            "to_world": T.translate([0, 0, 1 + i]) @ T.scale(99),
                            "bsdf": {"type": "polarizer", "theta": 90.0 * i},
                        }
                        for i in range(2)
                    },
                },
                variant=variant,
            )
            assert crossed.variant == variant and crossed.polarized
            # seen at up to 27 degrees, where the polarisers are not quite crossed
            assert float(tr.render(crossed, spp=4, seed=0).abs().max()) < 0.02


def test_glossy_surfaces_that_do_not_polarise_are_named():
    scene = under_sky(30, {"type": "principled"})
    with pytest.warns(UserWarning, match=r"plane.bsdf \(principled\): what this scatters is unpolarised"):
        assert float(stokes(scene)[1:].abs().max()) == 0


def test_where_nothing_polarises():
    """The image, and nothing else; to rounding what is traced as polarised light, of a lamp with a vector of zeros."""
    lamp = {"type": "sphere", "center": [2, -2, 6], "emitter": {"type": "area", "radiance": 3.0}}
    scenes = [under_sky(30, {"type": "diffuse"}, lamp=lamp)]
    lamp["emitter"] = {**lamp["emitter"], "stokes": [0, 0, 0]}
    scenes.append(under_sky(30, {"type": "diffuse"}, lamp=lamp))
    found = [tr.render(scene, spp=8, seed=2, outputs=("stokes",)).stokes for scene in scenes]
    assert torch.equal(found[0][..., 0], tr.render(scenes[0], spp=8, seed=2))
    torch.testing.assert_close(found[1], found[0], rtol=1e-12, atol=1e-14)
    assert float(found[0][..., 0].mean()) > 0.01 and not found[0][..., 1:].any()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"integrator": tr.WavefrontPathTracer()}, "WavefrontPathTracer has no polarised light"),
        ({"adaptive_grad": True}, "adaptive_grad: it is for radiance"),
        ({"outputs": ("stokes", "variance")}, "polarised light has no 'variance'"),
    ],
)
def test_what_there_is_not(settings, message):
    with pytest.raises(ValueError, match=message):
        tr.render(under_sky(30, {"type": "conductor"}), **{"outputs": ("stokes",), "spp": 1, **settings})
