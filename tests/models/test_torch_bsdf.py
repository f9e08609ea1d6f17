"""BSDFs written in PyTorch: their images and derivatives."""

from __future__ import annotations

import math

import pytest
import torch
from small_scene import ball_and_wall
from torch_bsdfs import ALBEDO, LIGHTS, NATIVE, TEXELS, Lambert, Phong, Uniform, scene_with, wavefront

import torchrender as tr

pytestmark = pytest.mark.once  # BSDFs in PyTorch


# ------------------------------------------------------------------------------------------------------------ images
@pytest.mark.parametrize(("light", "depth"), [*((name, 3) for name in LIGHTS), ("constant", 1), ("sphere", 5)])
def test_diffuse_is_the_native_one(light, depth):
    """Image and derivatives to rounding: defaults sample what the native model samples."""
    ours, theirs = scene_with(Lambert(), light), scene_with(NATIVE, light)
    theirs.train_only("ball.bsdf.*")
    found = tr.render(ours, integrator=wavefront(depth), seed=2)
    expected = tr.render(theirs, integrator=tr.PathTracer(depth), seed=2)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-12)
    assert float(found.detach().max()) > 0.05
    gradients = [
        torch.autograd.grad(image.square().sum(), scene.get_parameter(name))[0]
        for image, scene, name in ((found, ours, ALBEDO), (expected, theirs, "ball.bsdf.reflectance.value"))
    ]
    torch.testing.assert_close(*gradients, rtol=1e-9, atol=1e-12)
    assert bool(gradients[0].any()) == (depth > 1)


def around(bsdf) -> dict[str, dict]:
    """A BSDF inside of others."""
    normals = {"type": "bitmap", "data": 0.3 + 0.7 * TEXELS["data"], "raw": True}
    paint = {"type": "roughconductor", "alpha": 0.4, "distribution": "ggx", "eta": 0.2, "k": 3.0}
    return {
        "twosided": {"type": "twosided", "a": paint, "b": bsdf},
        "blendbsdf": {"type": "blendbsdf", "weight": TEXELS, "a": bsdf, "b": paint},
        "mask": {"type": "mask", "opacity": 0.6, "bsdf": {"type": "twosided", "bsdf": bsdf}},
        "normalmap": {"type": "normalmap", "normalmap": normals, "bsdf": bsdf},
        "bumpmap": {"type": "bumpmap", "heights": normals, "scale": 0.1, "bsdf": bsdf},
    }


@pytest.mark.parametrize("layer", around(None))
@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
def test_inside_of_other_bsdfs(layer):
    """Image and derivatives in what it is inside of and in itself are those of the native model there."""
    gradients, images = [], []
    for bsdf, integrator in ((Lambert(), wavefront(4)), (NATIVE, tr.PathTracer(4))):
        back = layer in ("twosided", "mask")
        ball = {"type": "sphere", "radius": 0.7, "flip_normals": back, "bsdf": around(bsdf)[layer]}
        scene = scene_with({}, ball=ball)
        values = {n: p.requires_grad_() for n, p in scene.named_parameters() if n.startswith("ball.bsdf")}
        images.append(tr.render(scene, integrator=integrator, seed=2, spp=8))
        found = torch.autograd.grad(images[-1].square().sum(), list(values.values()))
        gradients.append({n.replace("reflectance.value", "albedo"): g for n, g in zip(values, found, strict=True)})
    torch.testing.assert_close(*images, rtol=1e-9, atol=1e-12)
    ours, theirs = gradients
    for name in theirs:
        torch.testing.assert_close(ours[name], theirs[name], rtol=1e-9, atol=1e-12, msg=name)
        assert bool(ours[name].any()) or "brdf_0" in name  # the side that is not seen


@pytest.mark.parametrize("light", LIGHTS)
def test_samples_of_its_own_give_the_same_image(light):
    """z-tests of images of independent seeds; significance 0.01 for all lights together."""
    ours, theirs = scene_with(Uniform(), light), scene_with(NATIVE, light)
    images = []
    for scene, integrator, seeds in ((ours, wavefront(chunk=4000), (0, 12)), (theirs, tr.PathTracer(3), (100, 150))):
        with torch.no_grad():
            images.append(
                tr.testing.mean_and_variance(
                    lambda seed, s=scene, i=integrator: tr.render(s, integrator=i, seed=seed, spp=32), range(*seeds)
                )
            )
    (a, va), (b, vb) = images
    result = tr.testing.z_test(a, b, variance=va, reference_variance=vb, block=2, tests=len(LIGHTS))
    assert result, result.message


@pytest.mark.parametrize("bsdf", [Lambert(two_sided=True), {"type": "twosided", "inner": Lambert()}])
def test_seen_from_behind(bsdf):
    """The camera is inside of the ball; once the option mirrors directions, once `twosided` around it."""
    inside = {"type": "sphere", "radius": 5.0, "bsdf": bsdf}
    lamp = {"type": "sphere", "center": [0, 2, 1], "radius": 0.3, "emitter": {"type": "area", "radiance": 9.0}}
    found = tr.render(scene_with({}, ball=inside, lamp=lamp), integrator=wavefront(), seed=2)
    inside = {**inside, "bsdf": {"type": "twosided", "inner": NATIVE}}
    expected = tr.render(scene_with({}, ball=inside, lamp=lamp), integrator=tr.PathTracer(3), seed=2)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-12)
    assert float(found.detach()[-1, 0].min()) > 0  # where there is nothing but the ball
    one_sided = tr.render(scene_with({}, ball={**inside, "bsdf": Lambert()}, lamp=lamp), integrator=wavefront(), seed=2)
    assert float(one_sided.detach()[-1, 0].max()) == 0


class Sheet(tr.TorchBSDF):
    """Light goes through and comes out on the other side, diffuse; whether from in front or from behind."""

    def eval(self, si, wi, wo):
        return torch.where(wi[:, 2:] * wo[:, 2:] < 0, 0.8 / math.pi * wo[:, 2:].abs(), 0.0).expand(-1, 3)

    def pdf(self, si, wi, wo):
        return torch.where(wi[:, 2] * wo[:, 2] < 0, wo[:, 2].abs() / math.pi, 0.0)

    def sample(self, si, wi, u):
        wo, _ = super().sample(si, wi, u)
        wo = wo * torch.where(wi[:, 2:] > 0, wi.new_tensor([1.0, 1.0, -1.0]), 1.0)
        return wo, wo[:, 2].abs() / math.pi


def test_light_through_a_sheet():
    """Below a sky of radiance 1 that covers everything, what a sheet lets through is its transmittance."""
    scene = tr.load_dict(
        {
            "type": "scene",
            "camera": ball_and_wall()["sensor"],
            "sheet": {"type": "rectangle", "to_world": tr.Transform.scale(9.0), "bsdf": Sheet()},
            "sky": {"type": "constant", "radiance": 1.0, "sampling_weight": 0.0},  # found by the BSDF's samples alone
            "dark": {"type": "point", "intensity": 0.0},
        },
        dtype=torch.float64,
    )
    image = tr.render(scene, integrator=wavefront(), seed=1, spp=4)
    torch.testing.assert_close(image, torch.full_like(image, 0.8), rtol=1e-9, atol=0)


def test_what_a_bsdf_sees_of_the_surface():
    """uv, position and ids are those of `ray_intersect`: a checkerboard over uv is the native one."""
    seen = []

    class Checkered(tr.TorchBSDF):
        def eval(self, si, wi, wo):
            seen.append(si)
            odd = (si.uv % 1 > 0.5).sum(1, keepdim=True) % 2
            return torch.where(odd == 1, wo[:, 2:], 2 * wo[:, 2:]).expand(-1, 3) * (0.2 / math.pi)

    found = tr.render(scene_with(Checkered()), integrator=wavefront(2), seed=4)
    native = scene_with({"type": "diffuse", "reflectance": {"type": "checkerboard"}})
    torch.testing.assert_close(found, tr.render(native, integrator=tr.PathTracer(2), seed=4), rtol=1e-9, atol=1e-12)
    si = seen[0]
    names = [path for _, _, path in native.layout().objects["shape"]]
    assert set(si.shape_id.tolist()) == {names.index("ball")}
    torch.testing.assert_close(si.position.norm(dim=1), torch.full((len(si.uv),), 0.5, dtype=torch.float64))
    torch.testing.assert_close(si.shading_normal * 0.5, si.position)


@pytest.mark.parametrize("cosine", [0.9, 0.2])
def test_default_samples_follow_their_density(cosine):
    """Chi-square at significance 0.01 for both, and value over density is what a Lambertian surface has: its albedo."""
    bsdf = Lambert()
    wi = torch.tensor([[math.sqrt(1 - cosine**2), 0, cosine]], dtype=torch.float64)
    n = 20000
    u = torch.rand(n, 3, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
    wo, pdf = bsdf.sample(None, wi.expand(n, 3), u)
    result = tr.testing.chi2_test(wo, lambda d: bsdf.pdf(None, wi.expand(len(d), 3), d), tests=2)
    assert result, result.message
    torch.testing.assert_close(pdf, bsdf.pdf(None, wi.expand(n, 3), wo))
    weight = bsdf.eval(None, wi.expand(n, 3), wo) / pdf[:, None]
    torch.testing.assert_close(weight, bsdf.albedo.expand(n, 3))
    assert not bool(bsdf.sample(None, -wi.expand(n, 3), u)[1].any())


# ------------------------------------------------------------------------------------------------------- derivatives
def test_derivatives_are_those_of_the_image():
    """Central differences of images of the derivative's own samples, which do not depend on the parameters here."""
    scene = scene_with(Phong(), "sphere")
    integrator = wavefront(4, rr_depth=99)
    weight = torch.linspace(-1, 2, 6 * 8 * 3, dtype=torch.float64).reshape(6, 8, 3)

    def loss(seed: int = 5, **more) -> torch.Tensor:
        return (tr.render(scene, integrator=integrator, seed=seed, **more) * weight).sum()

    parameters = [scene.get_parameter(f"ball.bsdf.{n}") for n in ("exponent", "colour")]
    found = torch.autograd.grad(loss(seed=1, seed_grad=5), parameters)
    for parameter, gradient in zip(parameters, found, strict=True):
        for i in range(parameter.numel()):
            values = []
            for step in (1e-4, -1e-4):
                with torch.no_grad():
                    parameter.view(-1)[i] += step
                    values.append(float(loss()))
                    parameter.view(-1)[i] -= step
            assert gradient.view(-1)[i] == pytest.approx((values[0] - values[1]) / 2e-4, rel=1e-6)


def test_forward_mode_is_reverse_mode():
    scene = scene_with(Phong(), "sphere")
    names = ["ball.bsdf.exponent", "ball.bsdf.colour", "red.reflectance.value"]
    values = [scene.get_parameter(n).detach().clone() for n in names]
    generator = torch.Generator().manual_seed(1)
    tangents = [torch.randn(v.shape, generator=generator, dtype=v.dtype) for v in values]

    def image(*tensors: torch.Tensor) -> torch.Tensor:
        return tr.render(scene, integrator=wavefront(), seed=3, params=dict(zip(names, tensors, strict=True)))

    _, tangent = torch.func.jvp(image, tuple(values), tuple(tangents))
    weight = torch.randn(tangent.shape, generator=generator, dtype=tangent.dtype)
    leaves = [v.clone().requires_grad_() for v in values]
    gradients = torch.autograd.grad((image(*leaves) * weight).sum(), leaves)
    expected = sum(float((g * t).sum()) for g, t in zip(gradients, tangents, strict=True))
    assert float((tangent * weight).sum()) == pytest.approx(expected, rel=1e-9)
    assert abs(expected) > 1e-3


def test_what_moves_is_part_of_it():
    """Where the ball, the lamp and the camera are: as with the native material, to rounding."""
    ours, theirs = scene_with(Lambert(), "sphere"), scene_with(NATIVE, "sphere")
    names = ("ball.center", "ball.radius", "sky.center", "sky.radius", "sensor.to_world", "wall.to_world")
    gradients = []
    for scene, integrator in ((ours, wavefront()), (theirs, tr.PathTracer(3))):
        values = {n: scene.get_parameter(n).detach().clone().requires_grad_() for n in names}
        with pytest.warns(tr.MissingTermWarning, match="ball.center"):
            # of silhouettes that the camera sees scenes with a TorchBSDF have no derivative
            image = tr.render(scene, integrator=integrator, seed=6, params=values, spp_visibility=0)
        gradients.append(torch.autograd.grad(image.square().sum(), list(values.values())))
    for name, found, expected in zip(names, *gradients, strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-8, atol=1e-11, msg=name)
        assert bool(expected.any()), name


def test_memory_of_the_derivative_is_that_of_a_chunk():
    """What graphs keep alive does not grow with the number of samples, but with that of paths in a chunk."""

    class Kept:
        now = peak = 0

        def __init__(self, tensor: torch.Tensor) -> None:
            self.tensor, self.size = tensor, tensor.nbytes
            Kept.now += self.size
            Kept.peak = max(Kept.peak, Kept.now)

        def __del__(self) -> None:
            Kept.now -= self.size

    def peak(spp: int, chunk: int) -> int:
        wall = {"type": "rectangle", "to_world": tr.Transform.translate([0, 0, 1]) @ tr.Transform.scale(9.0)}
        scene = scene_with({}, ball={**wall, "bsdf": Lambert()})  # which is all that is in view
        image = tr.render(scene, integrator=wavefront(chunk=chunk), seed=0, spp=1, spp_grad=spp)
        assert image.grad_fn is not None
        Kept.now = Kept.peak = 0
        with torch.autograd.graph.saved_tensors_hooks(Kept, lambda kept: kept.tensor):
            image.sum().backward()
        assert bool(scene.get_parameter(ALBEDO).grad.any())
        return Kept.peak

    few = peak(8, 96)
    assert few > 1000
    assert peak(40, 96) < 1.1 * few
    assert peak(8, 384) > 2 * few
