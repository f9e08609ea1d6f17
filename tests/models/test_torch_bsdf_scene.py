"""BSDFs written in PyTorch: their place in a scene, and what is said when they are wrong."""

from __future__ import annotations

import copy
import io
import math
import warnings

import pytest
import torch
from torch import nn
from torch_bsdfs import ALBEDO, COLOUR, NATIVE, Lambert, scene_with, wavefront

import torchrender as tr

pytestmark = pytest.mark.once  # BSDFs in PyTorch


# --------------------------------------------------------------------------------------------------- part of a scene
def test_parameters_are_the_scenes():
    bsdf = Lambert()
    scene = scene_with(bsdf, dtype=torch.float32)
    assert scene.get_parameter(ALBEDO) is bsdf.albedo
    assert bsdf.albedo.dtype == torch.float32 and bsdf.albedo.requires_grad
    assert ALBEDO in dict(scene.named_parameters()) and ALBEDO in scene.state_dict()
    assert "ball.bsdf.albedo" in repr(scene) and "by autograd, requires grad" in repr(scene)
    assert scene.train_only("red.*") and not bsdf.albedo.requires_grad
    assert scene.train_only("*.albedo") == [bsdf.albedo]
    scene.eval()
    assert not bsdf.training and bsdf.eval() is bsdf
    scene.double()
    assert bsdf.albedo.dtype == torch.float64


def test_copies_and_files():
    scene = scene_with(Lambert())
    with torch.no_grad():
        scene.get_parameter(ALBEDO).fill_(0.25)
    expected = tr.render(scene, integrator=wavefront(), seed=1)
    other = scene_with(Lambert())
    other.load_state_dict(scene.state_dict())
    for same in (copy.deepcopy(scene), other):
        assert torch.equal(tr.render(same, integrator=wavefront(), seed=1), expected)
    file = io.BytesIO()
    torch.save(scene.state_dict(), file)
    assert file.tell() > 0
    with pytest.raises(ValueError, match=r"save: ball.bsdf: a Lambert has no form in a scene file"):
        scene.save("never.xml")


def test_one_bsdf_of_several_shapes_and_replacements():
    bsdf = Lambert()
    shapes = {n: {"type": "sphere", "center": [x, 0, 0], "radius": 0.4} for n, x in (("ball", -0.5), ("second", 0.5))}
    for shape in shapes.values():
        shape["bsdf"] = {"type": "ref", "id": "paint"}
    scene = scene_with({}, paint=bsdf, **shapes)
    assert scene["ball"].bsdf is bsdf and scene["second"].bsdf is bsdf
    renderer = tr.Renderer(scene, integrator=wavefront(), spp=4)
    image = renderer(seed=1)
    image.sum().backward()
    assert bool(bsdf.albedo.grad.any())
    other = torch.tensor([0.1, 0.1, 0.9], dtype=torch.float64, requires_grad=True)
    by_name = [renderer(seed=1, params={name: other}) for name in ("paint.albedo", "second.bsdf.albedo")]
    called = torch.func.functional_call(renderer, {"scene.paint.albedo": other}, kwargs={"seed": 1})
    for found in (*by_name, called):
        assert torch.equal(found, by_name[0]) and not torch.equal(found, image)
    gradients = [torch.autograd.grad(i.sum(), other)[0] for i in (by_name[0], called)]
    torch.testing.assert_close(*gradients)
    assert torch.equal(renderer(seed=1), image)  # nothing of it has stayed
    scene["paint"] = {"type": "diffuse"}
    assert torch.isfinite(tr.render(scene, integrator=tr.PathTracer(3), seed=1)).all()


def test_a_bsdf_is_found_by_an_optimiser():
    """Through a parametrization, in single precision: what modules do."""
    target = tr.render(scene_with(NATIVE, dtype=torch.float32), integrator=tr.PathTracer(3), seed=99, spp=1024)
    bsdf = Lambert((0.5, 0.5, 0.5))
    scene = scene_with(bsdf, dtype=torch.float32)
    with torch.no_grad():
        bsdf.albedo.fill_(0.0)
    nn.utils.parametrize.register_parametrization(bsdf, "albedo", nn.Sigmoid(), unsafe=True)
    optimiser = torch.optim.Adam([p for p in scene.parameters() if p.requires_grad], lr=0.3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, 25)
    for seed in range(25):
        optimiser.zero_grad()
        (tr.render(scene, integrator=wavefront(chunk=4000), seed=seed, spp=64) - target).square().mean().backward()
        optimiser.step()
        schedule.step()
    torch.testing.assert_close(bsdf.albedo.detach(), torch.tensor(COLOUR), atol=0.04, rtol=0)


# ------------------------------------------------------------------------------------------------------------ errors
@pytest.mark.parametrize(
    "integrator",
    [None, tr.PathTracer(3), tr.DirectIllumination(), tr.VolumetricPathTracer(3), tr.ParticleTracer(3), "path"],
)
def test_native_integrators_refuse_it(integrator):
    called = []

    class Watched(Lambert):
        def eval(self, si, wi, wo):
            called.append(wi)
            return super().eval(si, wi, wo)

    name = {None: "PathTracer", "path": "PathTracer"}.get(integrator, type(integrator).__name__)
    message = (
        rf"integrator: ball.bsdf \(Watched\) is a BSDF written in PyTorch, which {name} does not evaluate; "
        r"WavefrontPathTracer\(...\) does"
    )
    scene = scene_with(Watched())
    with pytest.raises(ValueError, match=message):
        tr.render(scene, integrator=integrator)
    with pytest.raises(ValueError, match=r"outputs: ball.bsdf \(Watched\) .* has no 'albedo'"):
        tr.render(scene, integrator=wavefront(), outputs=("rgb", "albedo"))
    with pytest.raises(ValueError, match=r"BsdfProbe: name: ball.bsdf is a BSDF written in PyTorch"):
        tr.testing.BsdfProbe(scene, "ball.bsdf")
    assert not called
    assert torch.isfinite(tr.render(scene, outputs=("shading_normal",)).shading_normal).all()  # which needs none


class Wrong(tr.TorchBSDF):
    """Does what the functions of these names do."""

    def __init__(self, **functions) -> None:
        super().__init__()
        self.__dict__["functions"] = functions

    def eval(self, si, wi, wo):
        return self.functions.get("eval", lambda wo: wo[:, 2:].expand(-1, 3) / math.pi)(wo)

    def pdf(self, si, wi, wo):
        return self.functions.get("pdf", lambda wo: wo[:, 2].clamp(min=0) / math.pi)(wo)

    def sample(self, si, wi, u):
        found = super().sample(si, wi, u)
        return self.functions.get("sample", lambda wo, pdf: (wo, pdf))(*found)


@pytest.mark.parametrize(
    ("functions", "error", "message"),
    [
        ({"eval": lambda wo: wo[:, 2]}, ValueError, r"ball.bsdf: eval: expected .* of shape \(\d+, 3\), got a Tensor"),
        ({"eval": lambda wo: wo.long()}, ValueError, "ball.bsdf: eval: expected floating-point numbers"),
        ({"eval": lambda wo: None}, TypeError, "ball.bsdf: eval: expected a tensor .*, got None"),
        ({"pdf": lambda wo: wo}, ValueError, r"ball.bsdf: pdf: expected .* of shape \(\d+,\)"),
        ({"pdf": lambda wo: -wo[:, 2].abs()}, ValueError, "ball.bsdf: pdf: expected densities that are not negative"),
        ({"sample": lambda wo, pdf: wo}, TypeError, r"ball.bsdf: sample: expected a pair \(wo, pdf\)"),
        ({"sample": lambda wo, pdf: (wo[:, :2], pdf)}, ValueError, "ball.bsdf: sample: wo: expected"),
        ({"sample": lambda wo, pdf: (2 * wo, pdf)}, ValueError, "expected unit vectors, got one of length 2"),
    ],
)
def test_what_it_returns_is_looked_at(functions, error, message):
    with pytest.raises(error, match=message):
        tr.render(scene_with(Wrong(**functions)), integrator=wavefront())


class NotANumber(Lambert):
    """Not a number for some directions, in a way that a graph spreads."""

    def eval(self, si, wi, wo):
        return self.albedo * torch.sqrt(wo[:, 2:] - 0.3) / math.pi


def test_numbers_that_are_not_finite_are_dropped_and_reported():
    scene = scene_with(NotANumber())
    integrator = wavefront()
    with pytest.warns(
        RuntimeWarning, match=r"\d+ samples were not finite, first at ball.bsdf: eval; they were dropped"
    ):
        image = tr.render(scene, integrator=integrator, seed=0)
    assert torch.isfinite(image).all()
    with pytest.warns(RuntimeWarning, match="not finite, first at ball.bsdf: eval"):
        image.sum().backward()
    gradient = scene.get_parameter(ALBEDO).grad
    assert torch.isfinite(gradient).all() and bool(gradient.any())
    with pytest.raises(tr.RenderError, match=r"samples were not finite, first at ball.bsdf: eval"):
        tr.render(scene, integrator=integrator, seed=0, nan="raise")
    bad_density = scene_with(Wrong(pdf=lambda wo: wo[:, 2] * math.nan))
    with pytest.raises(tr.RenderError, match=r"first at ball.bsdf: pdf"):
        tr.render(bad_density, integrator=integrator, seed=0, nan="raise")


def test_classes_that_cannot_work_are_refused():
    class Nothing(tr.TorchBSDF):
        pass

    class Half(Lambert):
        def pdf(self, si, wi, wo):
            return wo[:, 2]

    with pytest.raises(TypeError, match=r"Nothing: a BSDF written in PyTorch needs a method eval\(self, si, wi, wo\)"):
        Nothing()
    with pytest.raises(TypeError, match="Half: pdf and sample belong together: sample is missing"):
        Half()
    with pytest.raises(TypeError, match="Lambert: two_sided: expected True or False, got 1"):
        Lambert(two_sided=1)
    with pytest.raises(ValueError, match=r"ball.bsdf: .*torch.nn module has to be derived from tr.TorchBSDF"):
        scene_with(nn.Linear(3, 3))
    with pytest.raises(ValueError, match=r"wall.emitter: expected a emitter, got a bsdf"):
        scene_with({}, wall={"type": "rectangle", "emitter": Lambert()})


def test_parameters_by_name_are_checked():
    scene = scene_with(Lambert())
    for params, error, message in (
        (
            {"ball.bsdf.albdo": torch.ones(3)},
            ValueError,
            "no parameter 'ball.bsdf.albdo'; did you mean 'ball.bsdf.albedo'",
        ),
        ({ALBEDO: torch.ones(4)}, ValueError, rf"params: {ALBEDO}: expected shape \(3,\), got \(4,\)"),
        ({ALBEDO: 0.5}, TypeError, f"params: {ALBEDO}: expected a tensor, got 0.5"),
    ):
        with pytest.raises(error, match=message):
            tr.render(scene, integrator=wavefront(), params=params)


def test_a_scene_without_use_of_it_is_native():
    """One that no shape has stands in nobody's way."""
    scene = scene_with(NATIVE, spare=Lambert())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        image = tr.render(scene, integrator=tr.PathTracer(3), seed=0)
    assert torch.equal(image, tr.render(scene_with(NATIVE), integrator=tr.PathTracer(3), seed=0))
