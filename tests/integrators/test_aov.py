"""Outputs as further channels of an image, by the integrator `aov` of scene files."""

from __future__ import annotations

import copy
import pickle

import pytest
import torch
from output_scenes import REAL, square

import torchrender as tr
from torchrender.first_hit_call import IDENTIFIERS

AOVS = "dd.y:depth, nn:sh_normal,gn:geo_normal,uv:uv,pos:position,al:albedo,pi:prim_index,si:shape_index"


def aov_scene(nested: bool = True, pixel_format: str = "rgb") -> tr.Scene:
    integrator = {"type": "aov", "aovs": AOVS}
    if nested:
        integrator["img"] = {"type": "path", "max_depth": 3}
    scene = square(size=12, sky={"type": "constant"}, integrator=integrator)
    scene.sensors[0].film.formats["pixel_format"] = pixel_format
    return scene


def test_aov_integrator_stacks_channels():
    scene = aov_scene()
    image = tr.render(scene, spp=8, seed=1)
    names = scene.integrator.channel_names()
    assert image.shape == (12, 12, len(names)) == (12, 12, 3 + 17)
    assert names[:5] == ["R", "G", "B", "dd.y.T", "nn.X"] and names[-2:] == ["pi.I", "si.I"]
    integrator = tr.PathTracer(max_depth=3)
    found = tr.render(scene, integrator=integrator, spp=8, seed=1, outputs=("rgb", "alpha", *REAL, *IDENTIFIERS))
    assert torch.equal(image[..., :3], found.rgb)
    # averages over all samples, zero where nothing is hit: those over hits times coverage
    alpha = found.alpha.unsqueeze(-1)
    expected = [torch.where(alpha > 0, v * alpha, 0) for v in (found.shading_normal, found.normal, found.uv)]
    torch.testing.assert_close(image[..., 4:12], torch.cat(expected, -1), rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(
        image[..., 12:15], torch.where(alpha > 0, found.position * alpha, 0), rtol=1e-5, atol=1e-6
    )
    hit = found.alpha == 1
    # from the near plane, at 0.01 along the axis
    along = found.distance * (1 - 0.01 / 5)
    torch.testing.assert_close(image[..., 3][hit], along[hit], rtol=1e-5, atol=0)
    assert torch.equal(image[..., -1], found.shape_id.float()) and torch.equal(image[..., -2], found.prim_id.float())
    # asked for outputs, it renders as its nested integrator does
    assert torch.equal(tr.render(scene, spp=8, seed=1, outputs=("rgb",)).rgb, found.rgb)


def test_aov_integrator_without_radiance_and_with_alpha():
    alone = tr.render(aov_scene(nested=False), spp=8, seed=1)
    stacked = tr.render(aov_scene(), spp=8, seed=1)
    assert alone.shape[2] == 17 and torch.equal(alone, stacked[..., 3:])
    scene = aov_scene(pixel_format="rgba")
    covered = tr.render(scene, spp=8, seed=1)
    assert covered.shape[2] == 21 and scene.integrator.channel_names(alpha=True)[3] == "A"
    assert torch.equal(covered[..., 3], tr.render(scene, spp=8, seed=1, outputs=("alpha",)).alpha)
    assert tr.render(scene, spp=1, seed=1, layout="chw").shape == (21, 12, 12)
    assert tr.render(scene, spp=1, seed=1, pixels=torch.tensor([[0, 1]])).shape == (1, 21)


def test_aov_integrator_has_derivatives_and_is_a_module():
    scene = aov_scene()
    (reflectance,) = scene.train_only("plate.bsdf.reflectance.value")
    image = tr.render(scene, spp=8, seed=1)
    albedo = image[..., scene.integrator.channel_names().index("al.R")]
    (gradient,) = torch.autograd.grad(albedo.sum(), reflectance)
    covered = tr.render(scene, spp=8, seed=tr.seeds.mix(1, 0x67726164), outputs=("alpha",)).alpha
    torch.testing.assert_close(float(gradient), float(covered.sum()), rtol=1e-5, atol=0)
    for other in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene)):
        assert torch.equal(tr.render(other, spp=8, seed=1), image.detach())
    assert repr(scene.integrator).startswith("AOV(aovs='dd.y:depth") and "PathTracer(max_depth=3" in str(scene)
    by_hand = tr.render(scene, spp=8, seed=1, integrator=tr.AOV(AOVS, tr.PathTracer(max_depth=3)))
    assert torch.equal(by_hand, image)


def test_aov_integrator_from_xml(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text("""<scene version="3.0.0">
      <integrator type="aov"><string name="aovs" value="d:depth"/><integrator type="direct" name="img"/></integrator>
      <sensor type="perspective"><film type="hdrfilm"><integer name="width" value="4"/>
        <integer name="height" value="4"/></film></sensor>
      <shape type="sphere"><point name="center" value="0 0 5"/></shape><emitter type="constant"/></scene>""")
    scene = tr.load_file(path)
    assert isinstance(scene.integrator, tr.AOV) and isinstance(scene.integrator.integrator, tr.DirectIllumination)
    assert tr.render(scene, spp=1).shape == (4, 4, 4)


@pytest.mark.parametrize(
    ("integrator", "words"),
    [
        ({"aovs": "depth"}, "expected pairs 'name:type', got 'depth'"),
        ({"aovs": "a:depth,,b:uv"}, "expected pairs 'name:type', got ''"),
        ({"aovs": "a:boundary_test"}, "'boundary_test' is not supported by this version"),
        ({"aovs": "a:dept"}, "unknown type 'dept'; did you mean 'depth'"),
        ({"aovs": 3}, "expected a string"),
        ({}, "needs the parameter 'aovs'"),
        ({"aovs": "a:uv", "i": {"type": "bdpt"}}, "expected an integrator"),
        ({"aovs": "a:uv", "i": {"type": "aov", "aovs": "b:uv"}}, "expected an integrator"),
        ({"aovs": "a:uv", "i": {"type": "path"}, "j": {"type": "direct"}}, "one nested integrator"),
        ({"aovs": "a:uv", "depth": 3}, "no parameter 'depth'"),
    ],
)
def test_aov_errors(integrator, words):
    with pytest.raises((TypeError, ValueError), match=words):
        square(integrator={"type": "aov", **integrator})
