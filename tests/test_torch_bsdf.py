"""BSDFs written in PyTorch: their images, derivatives, place in a scene, and what is said when they are wrong."""

from __future__ import annotations

import copy
import io
import math
import warnings

import pytest
import torch
from small_scene import ball_and_wall
from torch import nn

import torchrender as tr

ALBEDO = "ball.bsdf.albedo"
COLOUR = (0.6, 0.3, 0.1)


class Lambert(tr.TorchBSDF):
    """Diffuse, by what every subclass has by default."""

    def __init__(self, albedo=COLOUR, **more) -> None:
        super().__init__(**more)
        self.albedo = nn.Parameter(torch.tensor(albedo, dtype=torch.float64))

    def eval(self, si, wi, wo):
        return self.albedo * (wo[:, 2:] / math.pi)


class Uniform(Lambert):
    """The same with samples of its own: uniform on the hemisphere."""

    def pdf(self, si, wi, wo):
        return torch.where((wi[:, 2] > 0) & (wo[:, 2] > 0), 0.5 / math.pi, 0.0)

    def sample(self, si, wi, u):
        z, phi = u[:, 0], 2 * math.pi * u[:, 1]
        r = torch.sqrt(1 - z * z)
        wo = torch.stack([r * torch.cos(phi), r * torch.sin(phi), z], 1)
        return wo, torch.where(wi[:, 2] > 0, 0.5 / math.pi, 0.0)


class Phong(tr.TorchBSDF):
    """A lobe about the mirrored direction, nonlinear in its exponent."""

    def __init__(self) -> None:
        super().__init__(two_sided=True)
        self.exponent = nn.Parameter(torch.tensor(3.0))
        self.colour = nn.Parameter(torch.tensor([0.5, 0.4, 0.3]))

    def eval(self, si, wi, wo):
        cosine = (wi * wo * wi.new_tensor([-1.0, -1.0, 1.0])).sum(1, keepdim=True).clamp(min=1e-6)
        lobe = cosine**self.exponent * (self.exponent + 2) / (2 * math.pi)
        return torch.where((wi[:, 2:] > 0) & (wo[:, 2:] > 0), self.colour * lobe * wo[:, 2:], 0.0)


NATIVE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(COLOUR)}}
TEXELS = {"type": "bitmap", "data": torch.rand(4, 5, 3, generator=torch.Generator().manual_seed(4)), "raw": True}
FACING = tr.Transform.look_at([0, 2, 1.5], [0, 0, 0])
LIGHTS = {
    "constant": {"type": "constant", "radiance": 0.7},
    "point": {"type": "point", "position": [1.0, 1.5, 2.0], "intensity": 5.0},
    "envmap": {"type": "envmap", "data": TEXELS["data"]},
    "sphere": {"type": "sphere", "center": [0, 2, 1], "radius": 0.3, "emitter": {"type": "area", "radiance": 9.0}},
    "textured": {"type": "rectangle", "to_world": FACING, "emitter": {"type": "area", "radiance": TEXELS}},
}


def scene_with(bsdf, light: str = "constant", dtype: torch.dtype = torch.float64, **more) -> tr.Scene:
    ball = {"type": "sphere", "radius": 0.5, "bsdf": bsdf}
    return tr.load_dict(ball_and_wall(spp=4, **{"ball": ball, "sky": LIGHTS[light], **more}), dtype=dtype)


def wavefront(max_depth: int = 3, **more) -> tr.WavefrontPathTracer:
    return tr.WavefrontPathTracer(max_depth, **{"chunk": 100, **more})


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
    paint = {"type": "roughconductor", "alpha": 0.4, "distribution": "ggx"}
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
            image = tr.render(scene, integrator=integrator, seed=6, params=values)
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
