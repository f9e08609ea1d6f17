"""Images on the emulated device: bit for bit those of the CPU where both walk one tree, late and in any order."""

from __future__ import annotations

import re
from pathlib import Path

import light_scenes
import pytest
import reference_scenes
import small_scene
import torch
from emulated import PATH, blobs, check_image, hills, materials, scene_of_materials

import torchrender as tr

ROOT = Path(__file__).resolve().parents[2]


REFERENCES = {**reference_scenes.SCENES, **reference_scenes.CAMERAS}


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_images_are_those_of_the_cpu(device, name):
    check_image(device, tr.load_dict(REFERENCES[name]().scene), spp=1)


def test_every_bsdf(device):
    check_image(device, scene_of_materials(materials(), 32), integrator=tr.PathTracer(max_depth=6, rr_depth=2), spp=2)


@pytest.mark.parametrize("interpolation", ["bspline", "bilinear"])
def test_height_fields(device, interpolation):
    check_image(device, hills(interpolation), ("rgb", "alpha", "depth", "shading_normal"))


@pytest.mark.parametrize("normals", ["analytic", "smooth"])
def test_grids_of_distances(device, normals):
    check_image(device, blobs(normals), ("rgb", "alpha", "depth", "normal", "shading_normal", "prim_id"))


PLACE = tr.Transform.look_at([0.3, -0.2, 4.2], [0, 0, 0], [0, 1, 0])
PIXEL = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
CAMERAS = {
    "perspective with distortion": {"type": "perspective", "fov": 40, "distortion": [-0.2, 0.05, 0.01, -0.01, 0.01]},
    "fisheye": {"type": "fisheye", "fov": 60, "distortion": [0.05, -0.02, 0.0, 0.0]},
    "panorama": {"type": "panorama"},
    "orthographic": {"type": "orthographic"},
    "thinlens": {"type": "thinlens", "fov": 40, "aperture_radius": 0.1, "focus_distance": 4.0},
    "radiancemeter": {"type": "radiancemeter", "film": PIXEL},
    "distant": {"type": "distant", "film": PIXEL, "target": [0.2, 0.1, -1.0]},
}


@pytest.mark.parametrize("name", CAMERAS)
def test_every_camera(device, name):
    camera = {"to_world": PLACE, "film": light_scenes.film(), **CAMERAS[name]}
    check_image(device, tr.load_dict(light_scenes.room(camera, lamp=light_scenes.area(), sky=light_scenes.envmap())))


@pytest.mark.filterwarnings("ignore:the scene has a directionalarea light")
def test_every_emitter(device):
    lights = {
        "area": light_scenes.area(),
        "beam": light_scenes.beam(),
        "ball": light_scenes.ball_light(),
        "mesh": light_scenes.mesh_light(),
        "point": light_scenes.point_light(),
        "spot": light_scenes.spot(),
        "projector": light_scenes.projector(),
        "sun": light_scenes.sun(),
        "sky": light_scenes.envmap(),
    }
    scene = tr.load_dict(light_scenes.room(**lights))
    for integrator in (PATH, tr.PathTracer(max_depth=3, emitter_sampling="power"), tr.PathTracer(max_depth=1)):
        check_image(device, scene, integrator=integrator)
    check_image(device, tr.load_dict(light_scenes.room(sky={"type": "constant"})), integrator=tr.PathTracer())


@pytest.mark.parametrize(
    "integrator",
    [
        tr.PathTracer(max_depth=-1, rr_depth=3),
        tr.PathTracer(max_depth=24, rr_depth=30),
        tr.PathTracer(max_depth=4, hide_emitters=True),
        tr.DirectIllumination(emitter_samples=3, bsdf_samples=2, hide_emitters=True),
        tr.DirectIllumination(emitter_samples=0, bsdf_samples=2),
    ],
)
def test_integrators(device, integrator):
    scene = tr.load_dict(light_scenes.room(lamp=light_scenes.area(), ball=light_scenes.ball_light()))
    check_image(device, scene, integrator=integrator)


def test_parts_of_a_film_and_moments(device):
    names = ("rgb", "alpha", "variance", "second_moment")
    for rfilter in ("box", "gaussian"):
        film = {"type": "hdrfilm", "width": 20, "height": 15, "rfilter": {"type": rfilter}}  # two tiles
        objects = REFERENCES["shapes"]().scene
        scene = tr.load_dict({**objects, "sensor": {**objects["sensor"], "film": film}})
        whole = check_image(device, scene, names, spp=70)  # two chunks of samples
        assert torch.equal(tr.render(scene, integrator=PATH, spp=70, seed=3, crop=(3, 2, 9, 16)), whole[3:12, 2:18])
        pixels = torch.tensor([[14, 19], [0, 0], [7, 3], [7, 4], [0, 0], [7, 16]])
        listed = tr.render(scene, integrator=PATH, spp=70, seed=3, pixels=pixels)
        assert torch.equal(listed, whole[pixels[:, 0], pixels[:, 1]])
    check_image(device, scene, sampler="independent", passes=2)
    moments = tr.render(scene, integrator=tr.Moment(PATH), spp=70, seed=3)
    assert torch.equal(moments[..., :3], whole)
    check_image(device, scene, sampler="stratified", on_interrupt="return")


def test_images_are_those_of_embree(device):
    """Rays find the same but for rounding; a few paths then go another way."""
    scene = tr.load_file(ROOT / "scenes" / "cornell_box.xml")
    found = tr.render(scene, integrator=PATH, spp=4, seed=1, size=(40, 40))
    device("cpu")
    expected = tr.render(scene, integrator=PATH, spp=4, seed=1, size=(40, 40))
    far = (found - expected).abs() > 1e-3 * (expected.abs() + expected.mean())
    assert float(far.double().mean()) < 0.02
    torch.testing.assert_close(found.mean(), expected.mean(), rtol=2e-3, atol=0)


def ball(variant: str = "rgb", **objects) -> tr.Scene:
    return tr.load_dict(small_scene.ball_and_wall(**objects), variant=variant)


REFUSED = {
    "spectral scenes yet, but those in rgb and mono": {"variant": "spectral"},
    "polarised light yet": {"variant": "rgb_polarized"},
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_not_there_is_refused_by_name(device, words):
    settings = dict(REFUSED[words])
    scene = ball(settings.pop("variant"))
    expected = f"^render: TORCHRENDER_BACKEND=emulated does not have .*{re.escape(words)}.*; with TORCHRENDER_BACKEND="
    for call in (lambda: tr.render(scene, **settings), lambda: tr.Renderer(scene)(**settings)):
        with pytest.raises(RuntimeError, match=expected):
            call()
    assert not scene.statistics


def test_shapes_that_are_not_there_are_refused(device):
    curve = {"type": "bsplinecurve", "control_points": torch.arange(12.0).reshape(4, 3), "radii": 0.1}
    with pytest.raises(ValueError, match=r"odd: devices have everything but curves so far, got a bsplinecurve; with"):
        tr.render(ball(odd=curve), spp=1)


def test_what_changes_is_seen(device):
    scene = ball()
    first = tr.render(scene, spp=1, seed=1)
    for name in (n for n, _ in scene.named_parameters() if n.endswith(("reflectance", "reflectance.value", "center"))):
        moved = {name: scene.get_parameter(name).detach() * 0.9 + 0.01}
        again = tr.render(scene, spp=1, seed=1, params=moved)
        assert not torch.equal(again, first)
        device("tree")
        assert torch.equal(tr.render(scene, spp=1, seed=1, params=moved), again)
        device("emulated")
    assert torch.equal(tr.render(scene, spp=1, seed=1), first)


def test_mono_images(device):
    check_image(device, ball("mono"))


def test_values_that_are_not_finite_are_counted(device):
    scene = ball(lamp={"type": "point", "position": [0.7, 0, 0.05], "intensity": 3e38})
    counts = []
    for name in ("tree", "emulated"):
        device(name)
        with pytest.warns(RuntimeWarning, match="samples were not finite, first at bsdf"):
            tr.render(scene, spp=16, seed=1)
        counts.append(scene.statistics["render"]["nonfinite"])
    assert counts[0] == counts[1] > 2
