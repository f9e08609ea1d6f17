"""Wrong arguments of `render` and of the queries: refused before any work, naming the argument."""

from __future__ import annotations

import pytest
import torch

import torchrender as tr


@pytest.fixture(scope="module")
def scene():
    return tr.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 6}},
            "wide": {"type": "perspective", "film": {"type": "hdrfilm", "width": 9, "height": 6}},
            "red": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.1, 0.1]}},
            "wall": {
                "type": "rectangle",
                "to_world": tr.Transform.translate([0, 0, 4]),
                "bsdf": {"type": "ref", "id": "red"},
            },
            "tex": {"type": "bitmap", "data": torch.full((4, 4, 3), 0.5)},
            "squares": {"type": "checkerboard"},
            "sky": {"type": "constant"},
        }
    )


CASES = [
    ({"spp": 0}, ValueError, "spp: expected a number from 1"),
    ({"spp": 2.5}, TypeError, "spp: expected an integer"),
    ({"spp": True}, TypeError, "spp: expected an integer"),
    ({"spp_grad": 0}, ValueError, "spp_grad"),
    ({"passes": 0}, ValueError, "passes"),
    ({"seed": -1}, ValueError, "seed: expected a number from 0"),
    ({"seed": "x"}, TypeError, "seed: expected an integer, a torch.Generator or None"),
    ({"seed": 1.5}, TypeError, "seed: expected an integer"),
    ({"seed": 5, "seed_grad": 5}, ValueError, "seed_grad: equal to seed.*biased.*correlated=True"),
    ({"seed": 5, "seed_grad": 6, "correlated": True}, ValueError, "correlated=True uses the samples of `seed`"),
    ({"correlated": 1}, TypeError, "correlated: expected True or False"),
    ({"layout": "cwh"}, ValueError, "layout: expected one of hwc"),
    ({"nan": "ignore"}, ValueError, "nan: expected 'drop' or 'raise'"),
    ({"sampler": "sobel"}, ValueError, "render: sampler: unknown sampler 'sobel'.*; did you mean 'sobol'"),
    ({"sampler": "multijitter"}, ValueError, "sampler: .*not supported.*the nearest to it is 'stratified'; supported"),
    ({"sampler": 2}, TypeError, "sampler: expected one of independent, stratified, sobol, got 2"),
    ({"sensor": 2}, ValueError, "sensor: index 2, but the scene has 2 cameras"),
    ({"sensor": "sensr"}, ValueError, "sensor: the scene has no camera 'sensr'; did you mean 'sensor'?"),
    ({"sensor": 0.5}, TypeError, "sensor: expected an index, a name or a camera"),
    ({"range": "clamp"}, ValueError, "range: expected one of warn, raise, ignore, got 'clamp'"),
    ({"sensor": torch.tensor([0, 2])}, ValueError, "sensor: index 2, but the scene has 2 cameras"),
    ({"sensor": torch.zeros(2)}, TypeError, "sensor: expected an index, a name or a camera, got 0.0"),
    ({"sensor": []}, ValueError, "sensor: an empty list"),
    ({"sensor": torch.zeros(2, 2, dtype=torch.int64)}, TypeError, r"sensor: expected .* of shape \(2, 2\)"),
    ({"sensor": [0, 1]}, ValueError, "films of one size"),
    ({"integrator": 3}, TypeError, "integrator: expected an integrator"),
    ({"integrator": "pth"}, ValueError, "integrator: unknown type 'pth'; did you mean 'path'"),
    ({"integrator": "bdpt"}, ValueError, "'bdpt' is not supported"),
    ({"outputs": "rgb"}, TypeError, "outputs: expected a sequence"),
    ({"outputs": ("rgb", "dept")}, ValueError, "unknown name 'dept'; did you mean 'depth'"),
    ({"outputs": ("alpa",)}, ValueError, "unknown name 'alpa'; did you mean 'alpha'"),
    ({"outputs": ["rgb", ["depth"]]}, TypeError, r"outputs: expected names, got \['depth'\] \(list\)"),
    ({"outputs": ("rgb", "rgb")}, ValueError, "twice"),
    ({"pixels": torch.zeros(1, 2)}, TypeError, "pixels: expected integers"),
    ({"pixels": torch.zeros(2, dtype=torch.int64)}, ValueError, r"pixels: expected shape \(N, 2\)"),
    ({"pixels": torch.tensor([[0, 0], [6, 1]])}, ValueError, r"pixels: \(6, 1\) is not inside an image of 6 rows"),
    ({"pixels": torch.tensor([[0, -1]])}, ValueError, r"pixels: \(0, -1\) is not inside"),
    ({"pixels": torch.tensor([[0, 0]]), "crop": (0, 0, 2, 2)}, ValueError, "pixels and crop are both given"),
    ({"pixels": "all"}, TypeError, "pixels: expected an integer tensor"),
    ({"crop": (0, 0, 7, 8)}, ValueError, "crop: .* is not inside a film of 6 rows and 8 columns"),
    ({"crop": (0, 0, 0, 8)}, ValueError, "is not inside"),
    ({"crop": (0, 0)}, ValueError, r"crop: expected \(y0, x0, height, width\)"),
    ({"crop": 3}, ValueError, r"crop: expected \(y0, x0, height, width\)"),
    ({"params": {"red.reflectance.valu": torch.zeros(3)}}, ValueError, "no parameter 'red.reflectance.valu'; .*value"),
    ({"params": {"red.reflectance.value": [0, 0, 0]}}, TypeError, "red.reflectance.value: expected a tensor"),
    ({"params": {"red.reflectance.value": torch.zeros(3, dtype=torch.int64)}}, TypeError, "floating-point"),
    ({"params": {"red.reflectance.value": torch.zeros(4)}}, ValueError, r"expected shape \(\) or \(3,\), got \(4,\)"),
    ({"params": {"tex.data": torch.zeros(4, 4)}}, ValueError, r"expected shape \(H, W, C\)"),
    ({"params": {"wall.to_world": torch.eye(3)}}, ValueError, r"expected shape \(4, 4\), got \(3, 3\)"),
    (
        {"params": {"red.reflectance.value": torch.full((3,), float("nan"))}},
        ValueError,
        "red.reflectance.value: .*finite",
    ),
    ({"params": [torch.zeros(3)]}, TypeError, "params: expected a mapping"),
    ({"params": {3: torch.zeros(3)}}, TypeError, r"params: expected names of parameters, got 3 \(int\)"),
]


@pytest.mark.parametrize(("arguments", "error", "message"), CASES)
def test_arguments(scene, arguments, error, message):
    with pytest.raises(error, match=message):
        tr.render(scene, **arguments)


def test_indices_of_cameras_as_a_tensor_or_array(scene):
    expected = tr.render(scene, sensor=[0, 0], spp=1, seed=0)
    for indices in (torch.tensor([0, 0]), torch.tensor([0, 0]).numpy()):
        assert torch.equal(tr.render(scene, sensor=indices, spp=1, seed=0), expected)
    assert tr.render(scene, sensor=torch.tensor(1), spp=1).shape == (6, 9, 3)


def test_what_is_no_scene(scene):
    with pytest.raises(TypeError, match="scene: expected a Scene"):
        tr.render({"type": "scene"})
    with pytest.raises(TypeError, match="scene: expected a Scene"):
        tr.Renderer(None)
    with pytest.raises(TypeError, match=r"unknown argument 'sp'; .*'spp'"):
        tr.Renderer(scene, sp=3)


@pytest.mark.parametrize("name", ["spp", "passes", "layout", "nan", "outputs"])
def test_settings_of_a_layer_are_checked_when_it_is_made(scene, name):
    cases = [(a[name], error, message) for a, error, message in CASES if list(a) == [name]]
    assert cases
    for value, error, message in cases:
        with pytest.raises(error, match=message):
            tr.Renderer(scene, **{name: value})


def test_a_scene_without_cameras():
    with pytest.raises(ValueError, match="the scene has no camera"):
        tr.render(tr.load_dict({"type": "scene", "sky": {"type": "constant"}}))


def test_parameters_that_became_non_finite(scene):
    value = scene.red.reflectance.value
    kept = value.detach().clone()
    with torch.no_grad():
        value[1] = float("inf")
    with pytest.raises(ValueError, match=r"red\.reflectance\.value: has values that are not finite"):
        tr.render(scene, spp=1)
    with torch.no_grad():
        value.copy_(kept)
    assert bool(torch.isfinite(tr.render(scene, spp=1)).all())


def test_slightly_out_of_range_is_no_error_while_optimising(scene):
    image = tr.render(scene, spp=1, params={"red.reflectance.value": torch.tensor([1.01, -0.01, 0.5])})
    assert bool(torch.isfinite(image).all())


@pytest.mark.parametrize("name", ["sky.sampling_weight", "sensor.near_clip", "squares.to_uv"])
def test_missing_derivatives_are_refused(scene, name):
    parameter = scene.get_parameter(name)
    parameter.requires_grad_()
    try:
        with pytest.raises(tr.NotDifferentiableError, match=name):
            tr.render(scene, spp=1)
        with torch.no_grad():
            tr.render(scene, spp=1)
    finally:
        parameter.requires_grad_(False)
    tangent = torch.ones_like(parameter.detach())
    with torch.autograd.forward_ad.dual_level():
        dual = torch.autograd.forward_ad.make_dual(parameter.detach(), tangent)
        with pytest.raises(tr.NotDifferentiableError, match=name):
            tr.render(scene, spp=1, params={name: dual})


def test_cameras_that_require_gradients(scene):
    clip = torch.tensor(0.1, requires_grad=True)
    camera = tr.PerspectiveCamera(near_clip=clip, film=tr.Film(4, 4))
    with pytest.raises(tr.NotDifferentiableError, match=r"camera\.near_clip"):
        tr.render(scene, sensor=camera, spp=1)
    t = torch.tensor([0.0, 0.0, 4.0], requires_grad=True)
    camera = tr.PerspectiveCamera.from_opencv([[50, 0, 16], [0, 50, 16], [0, 0, 1]], torch.eye(3), t, (32, 32))
    with pytest.warns(tr.MissingTermWarning, match=r"camera\.to_world"):
        tr.render(scene, sensor=camera, spp=1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((torch.zeros(3), torch.zeros(3)), r"origins: expected shape \(N, 3\)"),
        ((torch.zeros(2, 3), torch.ones(3, 3)), "origins have shape"),
        ((torch.zeros(2, 3), torch.ones(2, 3), torch.ones(3)), "tmax: expected a number or shape"),
        ((torch.zeros(2, 3), torch.ones(2, 3), float("nan")), "tmax: has values that are not numbers"),
        ((torch.zeros(2, 3, device="meta"), torch.ones(2, 3)), "origins: lies on meta, but the scene on cpu: use .to"),
        ((torch.zeros(2, 3), torch.ones(2, 3, device="meta")), "directions: lies on meta"),
        ((torch.zeros(2, 3), torch.ones(2, 3), torch.ones(2, device="meta")), "tmax: lies on meta"),
    ],
)
def test_queries(scene, arguments, message):
    for function in (tr.ray_intersect, tr.ray_occluded):
        with pytest.raises(ValueError, match=message):
            function(scene, *arguments)


def test_queries_of_what_is_no_scene():
    with pytest.raises(TypeError, match="scene: expected a Scene"):
        tr.ray_intersect(None, torch.zeros(1, 3), torch.ones(1, 3))


def test_reattach():
    with pytest.raises(ValueError, match="value has shape"):
        tr.reattach(torch.zeros(2), torch.zeros(3))
    with pytest.raises(TypeError, match="expected a tensor"):
        tr.reattach(0.0, torch.zeros(3))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"integrator": "ptracer", "outputs": ["depth"]}, "outputs: an irradiancemeter has no 'depth', but 'rgb'"),
        ({"integrator": "ptracer", "outputs": ["rgb", "uv"]}, "outputs: an irradiancemeter has no 'uv', but 'rgb'"),
        ({"integrator": "path"}, "sensor: an irradiancemeter is measured by ParticleTracer"),
    ],
)
def test_what_a_meter_does_not_measure(arguments, message):
    meter = {"type": "irradiancemeter", "film": {"type": "hdrfilm", "width": 2, "height": 2}}
    scene = tr.load_dict({"type": "scene", "sky": {"type": "constant"}, "wall": {"type": "rectangle", "meter": meter}})
    with pytest.raises(ValueError, match=message):
        tr.render(scene, **arguments)
