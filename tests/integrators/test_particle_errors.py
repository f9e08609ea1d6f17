"""What light tracing refuses, and how meters of irradiance stand in scenes."""

from __future__ import annotations

import copy
import pickle
import warnings

import light_scenes as ls
import media_objects
import pytest
import torch

import torchrender as tr

pytestmark = pytest.mark.once  # what is asked for and refused

LIGHT = tr.ParticleTracer(max_depth=3)
METER = {"type": "irradiancemeter", "film": {"type": "hdrfilm", "width": 4, "height": 3}}


def image(scene: tr.Scene, **settings) -> torch.Tensor:
    return tr.render(scene, **{"integrator": LIGHT, "spp": 4, "seed": 1, **settings})


@pytest.fixture(scope="module")
def metered() -> tr.Scene:
    return tr.load_dict(ls.metered(light=ls.beam()))


@pytest.fixture(scope="module")
def seen() -> tr.Scene:
    return tr.load_dict(ls.room(light=ls.area()))


# -------------------------------------------------------------------------------------------------------------- refused
def test_media_are_refused():
    scene = tr.load_dict(ls.room(light=ls.area(), fog=media_objects.ball({"sigma_t": 1.0})))
    with pytest.raises(ValueError, match=r"integrator: ParticleTracer does not trace through media.*volpath"):
        image(scene)


@pytest.mark.parametrize("name", ["alpha", "variance"])
def test_outputs_that_light_paths_do_not_have(seen, name):
    with pytest.raises(ValueError, match=f"outputs: ParticleTracer has no '{name}'"):
        image(seen, outputs=("rgb", name))


def test_other_outputs_are_those_of_any_integrator(seen):
    found = image(seen, outputs=("rgb", "depth"))
    assert torch.equal(found.rgb, image(seen))
    assert bool(torch.isfinite(found.depth).any())


def test_adaptive_gradients_are_refused(seen):
    with pytest.raises(ValueError, match=r"adaptive_grad: light paths belong to no pixel"):
        image(seen, adaptive_grad=True)


@pytest.mark.parametrize("name", ["floor.to_world", "light.to_world", "camera.to_world", "camera.x_fov"])
def test_a_box_filter_has_no_derivative_of_what_moves(name):
    scene = tr.load_dict(ls.room(ls.camera(rfilter="box"), light=ls.area()))
    scene.train_only(name)
    with pytest.raises(tr.NotDifferentiableError, match=rf"{name}.*box filter.*'gaussian' or 'tent'"):
        image(scene)
    with torch.no_grad():
        assert float(image(scene).mean()) > 0


def test_a_box_filter_has_the_derivatives_of_what_stands_still():
    scene = tr.load_dict(ls.room(ls.camera(rfilter="box"), light=ls.area()), dtype=torch.float64)
    albedo, radiance = scene.train_only("floor.bsdf.reflectance.data", "light.emitter.radiance.data")
    pictured = image(scene, spp=64, seed=2, correlated=True)
    by_albedo, by_radiance = torch.autograd.grad(pictured.sum(), [albedo, radiance])
    assert float(by_albedo.min()) >= 0
    assert float(by_albedo.max()) > 0
    # the image is linear in radiance
    torch.testing.assert_close((by_radiance * radiance).sum(), pictured.sum(), rtol=1e-9, atol=0)


# -------------------------------------------------------------------------------------------------------------- meters
def test_meters_need_the_particle_tracer(metered):
    for integrator in (tr.PathTracer(), tr.DirectIllumination(), "volpath"):
        with (
            pytest.raises(ValueError, match=r"sensor: an irradiancemeter is measured by ParticleTracer"),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore")  # of the beam that is not found
            image(metered, integrator=integrator)


@pytest.mark.parametrize("name", ["depth", "uv", "shape_id"])
def test_meters_have_no_outputs_but_radiance(metered, name):
    with pytest.raises(ValueError, match=f"an irradiancemeter has no '{name}'"):
        image(metered, outputs=("rgb", name))
    with pytest.raises(ValueError, match="an irradiancemeter has no 'aovs'"):
        image(metered, integrator=tr.AOV("dd:depth", LIGHT))
    assert torch.equal(image(metered, outputs=("rgb",)).rgb, image(metered))


def test_meters_lie_on_surfaces_with_coordinates():
    bare = tr.Mesh([[0, 0, 0], [1, 0, 0], [0, 0, -1]], [[0, 1, 2]])
    for shape in ({"type": "sphere"}, {"type": "disk"}, bare):
        meter = {**METER, "shape": {"type": "ref", "id": "thing"}}
        scene = {"type": "scene", "thing": shape, "light": ls.beam(), "meter": meter}
        with pytest.raises(ValueError, match=r"'shape': expected a rectangle, or a mesh with texture coordinates"):
            image(tr.load_dict(scene))


def test_meters_need_a_shape():
    with pytest.raises(ValueError, match=r"irradiancemeter: 'shape' is missing"):
        tr.load_dict({"type": "scene", "meter": METER})
    with pytest.raises(ValueError, match=r"meter.*(nowhere|unknown)"):
        tr.load_dict({"type": "scene", "meter": {**METER, "shape": {"type": "ref", "id": "nowhere"}}})


def test_meters_belong_to_the_scene(metered):
    stray = copy.deepcopy(metered.sensors[0])
    with pytest.raises(ValueError, match=r"has to be one of the scene's"):
        image(metered, sensor=stray)
    assert torch.equal(image(metered, sensor=metered.sensors[0]), image(metered))


def test_coordinates_of_a_meter_have_no_derivative():
    corners = [[-3.0, -1, 3], [3, -1, 3], [3, -1, -3], [-3, -1, -3]]
    sheet = tr.Mesh(corners, [[0, 1, 2], [0, 2, 3]], vertex_texcoords=[[0, 0], [1, 0], [1, 1], [0, 1]])
    meter = {**METER, "shape": {"type": "ref", "id": "sheet"}}
    scene = tr.load_dict({"type": "scene", "sheet": sheet, "light": ls.beam(), "meter": meter})
    scene.train_only("sheet.vertex_texcoords")
    with pytest.raises(
        tr.NotDifferentiableError, match=r"sheet\.vertex_texcoords: an irradiancemeter has no derivative"
    ):
        image(scene)
    scene.train_only("sheet.vertex_positions")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tr.MissingTermWarning)
        image(scene).sum().backward()
    assert float(scene.sheet.vertex_positions.grad.abs().max()) > 0


def test_meters_stand_inside_of_their_shape_or_beside_it():
    inside = tr.load_dict(
        {"type": "scene", "light": ls.beam(), "floor": ls.floor(any=METER)},
    )
    beside = tr.load_dict(
        {
            "type": "scene",
            "light": ls.beam(),
            "floor": ls.floor(),
            "meter": {**METER, "shape": {"type": "ref", "id": "floor"}},
        }
    )
    given = tr.load_dict({"type": "scene", "light": ls.beam(), "floor": ls.floor()})
    given["meter"] = tr.IrradianceMeter(shape=given.floor, film=METER["film"])
    expected = image(inside)
    assert expected.shape == (3, 4, 3)
    assert float(expected.std()) > 0
    for scene in (beside, given):
        assert len(scene.sensors) == 1
        assert scene.sensors[0].shape is scene.floor
        assert torch.equal(image(scene), expected)
    assert "3 x 4 pixels" in repr(inside.sensors[0])


def test_meters_in_scene_files(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(
        """<scene version="3.0.0">
        <integrator type="ptracer"><integer name="max_depth" value="3"/></integrator>
        <shape type="rectangle" id="floor">
            <transform name="to_world">
                <scale x="3" y="3" z="1"/><rotate x="1" angle="-90"/><translate y="-1"/>
            </transform>
            <sensor type="irradiancemeter">
                <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="3"/></film>
                <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
            </sensor>
        </shape>
        <shape type="rectangle">
            <transform name="to_world"><rotate x="1" angle="90"/><translate y="1"/></transform>
            <emitter type="directionalarea"><rgb name="radiance" value="1, 2, 3"/></emitter>
        </shape>
        </scene>"""
    )
    scene = tr.load_file(path)
    found = tr.render(scene, seed=1)
    assert found.shape == (3, 4, 3)
    total = found.double().mean((0, 1)) * 36
    torch.testing.assert_close(total, 4 * torch.tensor([1.0, 2.0, 3.0]).double(), rtol=0.3, atol=0)


def test_a_scene_with_a_meter_is_a_module_like_others(metered):
    expected = image(metered)
    assert torch.equal(image(copy.deepcopy(metered)), expected)
    assert torch.equal(image(pickle.loads(pickle.dumps(metered))), expected)
    other = tr.load_dict(ls.metered(light=ls.beam(radiance={"type": "rgb", "value": [9.0, 9.0, 9.0]})))
    same = tr.load_dict(ls.metered(light=ls.beam()))
    with torch.no_grad():
        for parameter in same.parameters():
            parameter.mul_(0.5)
    assert not torch.equal(image(other), expected)
    same.load_state_dict(metered.state_dict())
    assert torch.equal(image(same), expected)
    light = tr.Renderer(metered, integrator=LIGHT, spp=4, seed=1)
    assert torch.equal(light(), expected)


# --------------------------------------------------------------------------------------------------------------- beams
def test_path_tracers_say_once_that_they_find_no_beams():
    scene = tr.load_dict(ls.floor_view(light=ls.beam()))
    with pytest.warns(UserWarning, match=r"directionalarea light, whose beams only ParticleTracer"):
        found = image(scene, integrator=tr.PathTracer(max_depth=3))
    assert float(found.abs().max()) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        image(scene, integrator=tr.PathTracer(max_depth=3))
        assert float(image(scene).max()) > 0


def test_beams_need_a_flat_shape():
    curved = ls.wavy_sheet(n=4)
    curved = tr.Mesh(
        curved.vertex_positions.detach(),
        curved.faces,
        vertex_normals=curved.vertex_normals.detach(),
        emitter={"type": "directionalarea"},
    )
    with pytest.raises(ValueError, match=r"'emitter': expected a flat shape, or a mesh without vertex normals"):
        image(tr.load_dict(ls.room(light=curved)))


# ----------------------------------------------------------------------------------------------------------- bad values
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("name", ["light.emitter.radiance.data", "light.to_world", "floor.to_world"])
def test_numbers_that_are_not_finite_are_named(name, value):
    scene = tr.load_dict(ls.metered(light=ls.beam()))
    with torch.no_grad():
        scene.get_parameter(name).view(-1)[1] = value
    with pytest.raises(ValueError, match=rf"{name}.*not finite"):
        image(scene)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("light.emitter.radiance.data", 1e30),
        ("light.emitter.radiance.data", -1.0),
        ("light.emitter.radiance.data", 0.0),
        ("light.to_world", 0.0),
        ("floor.to_world", 0.0),
        ("floor.to_world", 1e30),
        ("sheet.vertex_positions", 0.0),
        ("sheet.vertex_positions", 1e30),
        ("sheet.bsdf.eta", 1e30),
        ("sheet.bsdf.eta", 1e-30),
    ],
)
@pytest.mark.parametrize("measured", [True, False])
def test_extreme_numbers_never_crash(name, value, measured):
    """An image and gradients of finite numbers, or an error that says what is wrong."""
    make = ls.metered if measured else ls.floor_view
    scene = tr.load_dict(make(light=ls.beam(), sheet=ls.wavy_sheet(n=6)))
    (parameter,) = scene.train_only(name)
    with torch.no_grad():
        parameter.fill_(value)
        if name.endswith("to_world"):
            parameter[3] = torch.tensor([0.0, 0, 0, 1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = image(scene, spp=2)
            found.sum().backward()
        except (ValueError, tr.RenderError) as error:
            assert name.split(".")[0] in str(error) or "finite" in str(error)
            return
    assert bool(torch.isfinite(found).all())


@pytest.mark.parametrize("scene", [ls.room(), ls.metered()])
def test_without_a_lamp_it_is_dark(scene):
    found = image(tr.load_dict(scene))
    assert float(found.abs().max()) == 0
