"""The second moment of samples: as an output, and as channels of the integrator `moment`."""

from __future__ import annotations

import copy

import pytest
import torch
from output_scenes import square

import torchrender as tr


def panel(power: int, rfilter: str) -> tr.Scene:
    """A chequered light that is seen directly, of radiances to a power: samples are those radiances themselves."""
    colors = [[0.5, 2.0, 1.0], [3.0, 0.1, 1.5]]
    board = {
        "type": "checkerboard",
        "color0": {"type": "rgb", "value": [c**power for c in colors[0]]},
        "color1": {"type": "rgb", "value": [c**power for c in colors[1]]},
        "to_uv": torch.diag(torch.tensor([3.0, 3.0, 1.0])),
    }
    light = {"type": "rectangle", "emitter": {"type": "area", "radiance": board}}
    return square(size=12, rfilter=rfilter, integrator={"type": "path", "max_depth": 1}, plate=light)


@pytest.mark.parametrize("rfilter", ["box", "tent", "gaussian"])
def test_second_moment_is_the_image_of_squares(rfilter):
    result = tr.render(panel(1, rfilter), spp=16, seed=1, outputs=("rgb", "second_moment"))
    squares = tr.render(panel(2, rfilter), spp=16, seed=1)
    assert float((squares - result.rgb**2).abs().max()) > 0.1
    torch.testing.assert_close(result.second_moment, squares, rtol=1e-5, atol=1e-5)


def test_second_moment_agrees_with_variance_and_passes():
    scene = square(size=12, sky={"type": "constant"}, integrator={"type": "path", "max_depth": 3})
    result = tr.render(scene, spp=8, seed=1, outputs=("rgb", "variance", "second_moment", "alpha"))
    torch.testing.assert_close(result.second_moment, result.rgb**2 + 7 * result.variance, rtol=1e-5, atol=1e-6)
    one = tr.render(scene, spp=1, seed=1, outputs=("rgb", "second_moment"))
    torch.testing.assert_close(one.second_moment, one.rgb**2)
    passes = tr.render(scene, spp=1, seed=1, passes=3, outputs=("second_moment",)).second_moment
    singles = [tr.render(scene, spp=1, seed=s) ** 2 for s in (1, tr.seeds.mix(1, 1), tr.seeds.mix(1, 2))]
    torch.testing.assert_close(passes, torch.stack(singles).mean(0))


@pytest.mark.parametrize("color", ["rgb", "mono"])
def test_integrator_stacks_image_and_second_moment(color):
    description = {"type": "moment", "img": {"type": "direct", "emitter_samples": 2, "bsdf_samples": 0}}
    scene = square(size=12, sky={"type": "constant"}, integrator=description, variant=color)
    n = 3 if color == "rgb" else 1
    stacked = tr.render(scene, spp=4, seed=1)
    nested = scene.integrator.integrator
    apart = tr.render(scene, spp=4, seed=1, integrator=nested, outputs=("rgb", "second_moment"))
    assert stacked.shape == (12, 12, 2 * n) and len(scene.integrator.channel_names(n)) == 2 * n
    assert torch.equal(stacked, torch.cat(tuple(apart), -1))
    by_hand = tr.render(scene, spp=4, seed=1, integrator=tr.Moment(nested))
    assert torch.equal(by_hand, stacked) and repr(scene.integrator).startswith("Moment(DirectIllumination(")
    assert torch.equal(tr.render(copy.deepcopy(scene), spp=4, seed=1), stacked)


def test_only_the_image_has_a_derivative():
    scene = square(size=12, sky={"type": "constant"}, integrator={"type": "moment"})
    (reflectance,) = scene.train_only("plate.bsdf.reflectance.value")
    stacked = tr.render(scene, spp=4, seed=1)
    (gradient,) = torch.autograd.grad(stacked.sum(), reflectance)
    (expected,) = torch.autograd.grad(tr.render(scene, spp=4, seed=1, integrator=tr.PathTracer()).sum(), reflectance)
    assert torch.equal(gradient, expected) and float(gradient.sum()) > 0


def test_errors():
    with pytest.raises(TypeError, match="Moment: integrator: expected one such as PathTracer"):
        tr.Moment(tr.ParticleTracer())
    with pytest.raises(ValueError, match="expected an integrator"):
        square(integrator={"type": "moment", "i": {"type": "aov", "aovs": "d:depth"}})
    with pytest.raises(ValueError, match="moment has no parameter 'aovs'"):
        square(integrator={"type": "moment", "aovs": "d:depth"})
    scene = square(sky={"type": "constant"})
    for integrator in (tr.ParticleTracer(), tr.WavefrontPathTracer()):
        with pytest.raises(ValueError, match="has no 'second_moment'"):
            tr.render(scene, integrator=integrator, outputs=("second_moment",))
