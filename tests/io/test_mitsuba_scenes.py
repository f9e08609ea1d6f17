"""What Mitsuba's own scenes have and this version does otherwise: it loads, and what differs is said."""

import warnings

import numpy as np
import pytest
import torch

import torchrender as tr

T = tr.Transform
CAMERA = {
    "type": "perspective",
    "fov": 40,
    "to_world": T.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
    "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
    "sampler": {"type": "independent", "sample_count": 16},
}


def load(unsupported="error", **objects):
    """The scene, and the texts of the warnings about what takes the place of something."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = tr.load_dict({"type": "scene", **objects}, unsupported=unsupported)
    return scene, [str(w.message) for w in caught if issubclass(w.category, tr.SubstitutionWarning)]


def image(scene, **settings):
    with torch.no_grad():
        return tr.render(scene, seed=0, **settings)


# ------------------------------------------------------------------------------------- parameters without an effect
@pytest.mark.parametrize("kind", ["roughconductor", "roughdielectric", "roughplastic", "pplastic"])
def test_visible_normals_are_sampled_anyhow(kind):
    objects = {"cam": CAMERA, "light": {"type": "constant"}}
    scene, said = load(**objects, ball={"type": "sphere", "bsdf": {"type": kind, "sample_visible": False}})
    assert len(said) == 1 and said[0].startswith("ball.bsdf: sample_visible=False is not there")
    plain, said = load(**objects, ball={"type": "sphere", "bsdf": {"type": kind, "sample_visible": True}})
    assert not said and torch.equal(image(scene), image(plain))


def test_parameters_of_sampling_are_left_out():
    sky = {"type": "envmap", "data": np.ones((2, 4, 3)), "mis_compensation": True}
    stratified = {"type": "stratified", "sample_count": 4, "jitter": False, "seed": 3}
    scene, said = load(cam={**CAMERA, "sampler": stratified, "shutter_open": 0.0, "shutter_close": 1.0}, sky=sky)
    assert scene.sensors[0].sampler == tr.Sampler(4, "stratified")
    assert [text.partition(" is ")[0] for text in said] == [
        "cam.sampler: jitter=False",
        "cam.sampler: seed=3",
        "sky: mis_compensation=True",
    ]
    medium = {"type": "homogeneous", "has_spectral_extinction": False, "sample_emitters": False}
    texture = {"type": "bitmap", "data": np.ones((2, 2, 3)), "format": "fp16"}
    ball = {"type": "sphere", "bsdf": {"type": "mask", "x": {"type": "diffuse", "reflectance": texture}}}
    assert load(ball={**ball, "interior": medium})[1] == []


def test_parameters_of_how_work_is_divided():
    kinds = {
        "path": {"samples_per_pass": 4, "block_size": 32, "timeout": -1.0},
        "volpathmis": {"use_spectral_mis": True},
    }
    for kind, given in kinds.items():
        scene, said = load(integrator={"type": kind, "max_depth": 3, **given})
        assert scene.integrator.max_depth == 3 and said == []
    said = load(integrator={"type": "path", "timeout": 10.0})[1]
    assert said == ["integrator: timeout: without a counterpart in path, and left out"]
    scene, said = load(integrator={"type": "prb_projective", "sppc": 4, "sppi": 0, "guiding": "none"})
    counts = "sppc=4, sppi=0: left out; to render they are spp_grad=sppc and spp_visibility=(sppp, sppi)"
    assert said == [f"integrator: {counts}; guiding: left out; there is nothing to guide"]
    with pytest.raises(ValueError, match="integrator: path has no parameter 'sppc'"):
        load(integrator={"type": "path", "sppc": 4})


@pytest.mark.parametrize("kind", ["spot", "projector"])
def test_lights_have_no_size(kind):
    turned = T.translate([1, 2, 3]) @ T.rotate([1, 2, 0], 40)
    light, said = load(light={"type": kind, "fov": 30} if kind == "projector" else {"type": kind})
    light, said = load(light={"type": kind, "to_world": turned @ T.scale(3)})
    assert len(said) == 1 and "light.to_world: the scale 3 is left out" in said[0]
    torch.testing.assert_close(light.light.to_world, torch.as_tensor(turned.matrix).float(), atol=1e-6, rtol=0)
    assert load(light={"type": kind, "to_world": turned})[1] == []


def test_skies_without_albedo():
    place = {"type": "sunsky", "height": 8, "sun_direction": [0.0, 0.3, 1.0]}
    scene, said = load(sky={**place, "albedo": {"type": "rgb", "value": [0.3, 0.2, 0.1]}, "complex_sun": True})
    assert [text.partition(" is left out")[0] for text in said] == ["sky: albedo", "sky: complex_sun"]
    assert torch.equal(scene.sky.data, load(sky={**place, "complex_sun": False})[0].sky.data)


# ------------------------------------------------------------------------------------------------- spectra as values
def test_spectra_in_spectra(tmp_path):
    colour = {"type": "rgb", "value": [0.2, 0.7, 0.3]}
    for given in ({"type": "srgb", "color": colour}, {"type": "d65", "color": colour}):
        bsdf = tr.load_dict({"type": "diffuse", "reflectance": given})
        assert bsdf.reflectance.value.tolist() == pytest.approx([0.2, 0.7, 0.3])
    uniform = {"type": "uniform", "value": 0.4, "wavelength_min": 400.0, "wavelength_max": 700.0}
    assert float(tr.load_dict({"type": "diffuse", "reflectance": uniform}).reflectance.value) == pytest.approx(0.4)
    path = tmp_path / "a.xml"
    path.write_text(
        '<scene version="3.0.0"><bsdf type="diffuse" id="a"><spectrum type="srgb" name="reflectance">'
        '<rgb name="color" value="0.2, 0.7, 0.3"/></spectrum></bsdf></scene>'
    )
    assert tr.load_file(path).a.reflectance.value.tolist() == pytest.approx([0.2, 0.7, 0.3])


def test_daylight_times_a_texture():
    texels = np.linspace(0.1, 0.9, 12).reshape(2, 2, 3)
    light = {"type": "d65", "scale": 3.0, "any": {"type": "bitmap", "data": texels, "raw": True}}
    made = tr.load_dict({"type": "area", "radiance": light}, dtype=torch.float64)
    np.testing.assert_allclose(made.radiance.data.numpy(), 3 * texels)
    board = {"type": "d65", "scale": 2.0, "any": {"type": "checkerboard", "color0": 0.5, "color1": 0.25}}
    made = tr.load_dict({"type": "area", "radiance": board})
    assert float(made.radiance.color0.value) == 1.0 and float(made.radiance.color1.value) == 0.5
    attribute = {"type": "d65", "scale": 2.0, "any": {"type": "mesh_attribute", "name": "vertex_color", "scale": 1.5}}
    assert float(tr.load_dict({"type": "area", "radiance": attribute}).radiance.scale) == 3.0
    scene, _ = load(
        image={"type": "bitmap", "data": texels},
        light={
            "type": "sphere",
            "emitter": {"type": "area", "radiance": {"type": "d65", "x": {"type": "ref", "id": "image"}}},
        },
    )
    assert scene.light.emitter.radiance is scene.image
    for wrong, message in (
        ({"scale": 2.0, "x": {"type": "ref", "id": "image"}}, "radiance.scale: expected 1 with a texture that is not"),
        ({"color": 1.0, "x": {"type": "checkerboard"}}, "d65: expected a colour or one texture, got color, x"),
        ({"scal": 2.0}, "d65 has no parameter 'scal'; did you mean 'scale'"),
    ):
        with pytest.raises(ValueError, match=message):
            tr.load_dict({"type": "area", "radiance": {"type": "d65", **wrong}})


# ------------------------------------------------------------------------------------------------------- integrators
def test_depth():
    scene, _ = load(integrator={"type": "depth"}, cam=CAMERA, wall={"type": "rectangle", "to_world": T.scale(100)})
    found = image(scene, spp=64)
    assert found.shape == (8, 8, 1)
    near = float(scene.sensors[0].near_clip)
    rays = scene.sensors[0].rays()
    along = -rays.directions[:, 2].reshape(8, 8)
    torch.testing.assert_close(found[..., 0] + near / along, 5 / along, rtol=5e-3, atol=0)
    assert float(image(load(integrator={"type": "depth"}, cam=CAMERA)[0]).abs().max()) == 0
    assert tr.Depth().channel_names() == ["depth.T"] and repr(tr.Depth()) == "Depth()"
    with pytest.raises(ValueError, match="integrator: depth has no parameter 'path'"):
        load(integrator={"type": "depth", "path": {"type": "path"}})


def test_meters_without_light_tracing():
    plate = {"type": "rectangle", "to_world": T.scale(2), "bsdf": {"type": "diffuse", "reflectance": 0.0}}
    meter = {
        "type": "irradiancemeter",
        "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}},
    }
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 2.0, 3.0]}}
    scene, _ = load(plate={**plate, "meter": meter}, sky=sky, integrator={"type": "path", "max_depth": 2})
    with pytest.warns(tr.SubstitutionWarning, match="ParticleTracer takes the place of PathTracer"):
        found = image(scene, spp=1 << 16)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # said once
        assert torch.equal(image(scene, spp=1 << 16), found)
    expected = torch.pi * torch.tensor([1.0, 2.0, 3.0])
    # a path meets the plate with probability 1/4 or more of those sent to the scene's ball: 0.7 % standard deviation
    torch.testing.assert_close(found[0, 0], expected, rtol=0.035, atol=0)


# -------------------------------------------------------------------------------------------- names and forms of values
def test_references_by_key_and_by_id():
    red = {"type": "diffuse", "id": "red", "reflectance": {"type": "rgb", "value": [0.8, 0.1, 0.1]}}
    balls = {n: {"type": "sphere", "bsdf": {"type": "ref", "id": n}} for n in ("red", "key")}
    scene, _ = load(key=red, a=balls["red"], b=balls["key"])
    assert scene.a.bsdf is scene.b.bsdf is scene.red
    with pytest.raises(ValueError, match="there is no object with the id 'kay'"):
        load(key=red, a={"type": "sphere", "bsdf": {"type": "ref", "id": "kay"}})
    other, _ = load(key=red, red_={"type": "diffuse", "id": "other"}, a=balls["key"])
    assert other.a.bsdf is other.red


def test_spectra_at_the_top(tmp_path):
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "ref", "id": "grey"}}}
    scene, _ = load(grey={"type": "uniform", "value": 0.25}, ball=ball)
    assert scene.ball.bsdf.reflectance is scene.grey and float(scene.grey.value) == 0.25
    path = tmp_path / "a.xml"
    path.write_text(
        '<scene version="3.0.0"><spectrum type="srgb" id="c"><rgb name="color" value="0.3, 0.6, 0.2"/></spectrum>'
        '<bsdf type="diffuse" id="b"><ref name="reflectance" id="c"/></bsdf></scene>'
    )
    assert tr.load_file(path).b.reflectance.value.tolist() == pytest.approx([0.3, 0.6, 0.2])


def test_points_of_one_number(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text(
        '<scene version="3.0.0"><shape type="sphere" id="a"><point name="center" value="0.25"/></shape></scene>'
    )
    assert tr.load_file(path).a.center.tolist() == [0.25] * 3
    path.write_text(path.read_text().replace("0.25", "1, 2"))
    with pytest.raises(ValueError, match="value: expected 1 or 3 numbers, got '1, 2'"):
        tr.load_file(path)


# ------------------------------------------------------------------------------------------------ what there is not
@pytest.mark.parametrize(
    ("entry", "advice"),
    [
        ({"type": "measured", "filename": "a.bsdf"}, "'measured' is not supported .*roughconductor or principled"),
        ({"type": "ellipsoids"}, "'ellipsoids' is not supported .*: a mesh for each"),
        ({"type": "timed_sunsky"}, "'timed_sunsky' is not supported .*: .*sunsky is the light of one time"),
        (
            {**CAMERA, "film": {"type": "specfilm"}},
            "specfilm: bands need wavelengths: a scene of the variant 'spectral'",
        ),
    ],
    ids=lambda v: v["type"] if isinstance(v, dict) else "",
)
def test_refusals_say_what_to_do(entry, advice):
    with pytest.raises(ValueError, match=advice):
        load(x=entry)


def test_tags_of_later_versions(tmp_path):
    path = tmp_path / "a.xml"
    moving = '<animation name="to_world"><transform time="0"/></animation>'
    for text, message in ((moving, "transforms that move"), ('<import filename="x.py"/>', "cannot bring Python code")):
        shape = f'<shape type="sphere">{text}</shape>'
        path.write_text(f'<scene version="3.0.0">{shape if "anim" in text else text}</scene>')
        with pytest.raises(ValueError, match=message):
            tr.load_file(path)


@pytest.mark.parametrize(
    ("plate", "passed"),
    [
        ({"type": "polarizer", "theta": 30.0}, 0.5),
        ({"type": "circular", "transmittance": 0.6}, 0.3),
        ({"type": "polarizer", "transmittance": {"type": "rgb", "value": [0.4, 0.4, 0.4]}}, 0.2),
        ({"type": "retarder", "delta": 90.0}, 1.0),
    ],
)
def test_plates_pass_their_part_of_unpolarised_light(plate, passed):
    sky = {"type": "constant", "radiance": 1.0}
    scene, said = load(cam=CAMERA, sky=sky, plate={"type": "rectangle", "to_world": T.scale(100), "b": plate})
    assert not said
    assert abs(float(image(scene, spp=4).mean()) - passed) <= 1e-6
