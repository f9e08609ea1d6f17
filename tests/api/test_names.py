"""Parameter names are those that people know from Mitsuba's `traverse`."""

from __future__ import annotations

import pytest
import torch

import torchrender as tr

RGB = {"type": "rgb", "value": [0.5, 0.25, 0.125]}
TEXELS = torch.linspace(0, 1, 4 * 8 * 3).reshape(4, 8, 3)
BITMAP = {"type": "bitmap", "data": TEXELS, "raw": True}
RATES = [f"{part}_sampling_rate" for part in ("diffuse_reflectance", "main_specular", "clearcoat")]
THIN_RATES = [f"{a}_{b}_sampling_rate" for a in ("specular", "diffuse") for b in ("reflectance", "transmittance")]
SPHERE = ["center", "radius", "to_world"]  # center and radius keep the dict's names: they have none there


def names(**objects) -> set[str]:
    scene = tr.load_dict({"type": "scene", **objects})
    return {name for name, _ in scene.named_parameters()}


def ball(bsdf) -> set[str]:
    found = names(ball={"type": "sphere", "bsdf": bsdf})
    return {n.removeprefix("ball.bsdf.") for n in found} - {f"ball.{n}" for n in SPHERE}


@pytest.mark.parametrize(
    ("bsdf", "expected"),
    [
        ({"type": "diffuse", "reflectance": RGB}, {"reflectance.value"}),
        ({"type": "diffuse", "reflectance": 0.3}, {"reflectance.value"}),
        ({"type": "diffuse"}, {"reflectance.value"}),
        ({"type": "diffuse", "reflectance": BITMAP}, {"reflectance.data", "reflectance.to_uv"}),
        ({"type": "diffuse", "id": "own", "reflectance": RGB}, {"reflectance.value"}),
        ({"type": "twosided", "any": {"type": "diffuse"}}, {"brdf_0.reflectance.value"}),
        (
            {"type": "twosided", "a": {"type": "diffuse"}, "b": {"type": "diffuse"}},
            {"brdf_0.reflectance.value", "brdf_1.reflectance.value"},
        ),
        (
            {"type": "diffuse", "reflectance": {"type": "checkerboard", "color0": RGB}},
            {"reflectance.to_uv", "reflectance.color0.value", "reflectance.color1.value"},
        ),
        ({"type": "dielectric"}, {"eta"}),
        ({"type": "dielectric", "specular_reflectance": 0.5}, {"eta", "specular_reflectance.value"}),
        ({"type": "roughdielectric", "distribution": "ggx"}, {"eta", "alpha.value"}),
        ({"type": "conductor"}, {"eta.value", "k.value", "specular_reflectance.value"}),
        ({"type": "conductor", "eta": RGB, "k": 3.0}, {"eta.value", "k.value", "specular_reflectance.value"}),
        ({"type": "roughconductor", "material": "Au"}, {"alpha.value", "eta.value", "k.value"}),
        ({"type": "roughconductor", "alpha": BITMAP}, {"alpha.data", "alpha.to_uv", "eta.value", "k.value"}),
        ({"type": "thindielectric"}, {"eta"}),
        ({"type": "plastic"}, {"eta", "diffuse_reflectance.value"}),
        ({"type": "roughplastic"}, {"eta", "alpha", "diffuse_reflectance.value"}),
        ({"type": "principled"}, {"base_color.value", "roughness.value", "specular", *RATES}),
        (
            {"type": "principled", "eta": 1.5, "spec_trans": 0.5, "metallic": BITMAP, "clearcoat": 0.1},
            {"base_color.value", "roughness.value", "eta", "spec_trans.value", "metallic.data", "metallic.to_uv"}
            | {"clearcoat.value", *RATES},
        ),
        ({"type": "principledthin"}, {"base_color.value", "roughness.value", "eta.value", *THIN_RATES}),
        ({"type": "redner"}, {"diffuse_reflectance.value", "specular_reflectance.value", "roughness.value"}),
        ({"type": "null"}, set()),
        ({"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}, {"reflectance.scale"}),
    ],
)
def test_bsdfs(bsdf, expected):
    assert ball(bsdf) == expected


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        ({"type": "point", "intensity": RGB}, {"sampling_weight", "position", "intensity.value"}),
        ({"type": "constant", "radiance": RGB}, {"sampling_weight", "radiance.value"}),
        ({"type": "directional", "irradiance": RGB}, {"sampling_weight", "irradiance.value", "to_world"}),
        (
            {"type": "spot", "intensity": RGB, "texture": 0.5},
            {"sampling_weight", "intensity.value", "texture.value", "cutoff_angle", "beam_width", "to_world"},
        ),
        (  # Mitsuba has no x_fov
            {"type": "projector", "irradiance": BITMAP},
            {"sampling_weight", "scale", "irradiance.data", "irradiance.to_uv", "to_world", "x_fov"},
        ),
        ({"type": "envmap", "data": TEXELS}, {"sampling_weight", "scale", "data", "to_world"}),
    ],
)
def test_emitters(light, expected):
    assert names(light=light) == {f"light.{n}" for n in expected}


def test_beams_and_meters_belong_to_their_shape():
    beam = {"type": "directionalarea", "radiance": RGB}
    found = names(
        q={"type": "rectangle", "any": beam}, floor={"type": "rectangle", "meter": {"type": "irradiancemeter"}}
    )
    assert found == {
        "q.bsdf.reflectance.value",
        "q.emitter.sampling_weight",
        "q.emitter.radiance.value",
        "q.to_world",
        "floor.bsdf.reflectance.value",
        "floor.to_world",
    }


def test_area_lights_belong_to_their_shape():
    found = names(q={"type": "rectangle", "any": {"type": "area", "radiance": BITMAP}})
    assert found == {
        "q.bsdf.reflectance.value",
        "q.emitter.sampling_weight",
        "q.emitter.radiance.data",
        "q.emitter.radiance.to_uv",
        "q.to_world",
    }


@pytest.mark.parametrize("kind", ["rectangle", "disk"])
def test_flat_shapes(kind):
    assert names(thing={"type": kind}) == {"thing.to_world", "thing.bsdf.reflectance.value"}


def test_cube_is_a_mesh():
    scene = tr.load_dict({"type": "scene", "thing": {"type": "cube"}})
    assert {n for n, _ in scene.named_parameters()} == {
        "thing.bsdf.reflectance.value",
        "thing.vertex_positions",
        "thing.vertex_normals",
        "thing.vertex_texcoords",
    }
    assert scene.thing.faces.shape == (12, 3)
    assert not scene.thing.faces.is_floating_point()


def test_camera():
    assert names(sensor={"type": "perspective"}) == {
        f"sensor.{n}"
        for n in (
            "near_clip",
            "far_clip",
            "x_fov",
            "principal_point_offset_x",
            "principal_point_offset_y",
            "pixel_aspect",  # an addition of this package: fx / fy
            "to_world",
        )
    }


@pytest.mark.parametrize("first", ["red", "a"])
def test_shared_objects_go_by_their_own_id(first):
    objects = {
        "red": {"type": "diffuse", "reflectance": RGB},
        "a": {"type": "rectangle", "bsdf": {"type": "ref", "id": "red"}},
        "b": {"type": "disk", "any": {"type": "twosided", "x": {"type": "ref", "id": "red"}}},
    }
    ordered = {first: objects.pop(first), **objects}
    scene = tr.load_dict({"type": "scene", **ordered})
    assert {n for n, _ in scene.named_parameters()} == {"red.reflectance.value", "a.to_world", "b.to_world"}
    # Other ways to the same object work too.
    assert scene.get_parameter("a.bsdf.reflectance.value") is scene.red.reflectance.value
    assert scene.b.bsdf.brdf_0 is scene.red


def test_shared_textures_go_by_their_own_id():
    found = names(
        tex={"type": "checkerboard"},
        m={"type": "diffuse", "reflectance": {"type": "ref", "id": "tex"}},
        a={"type": "rectangle", "bsdf": {"type": "ref", "id": "m"}},
    )
    assert found == {"tex.to_uv", "tex.color0.value", "tex.color1.value", "a.to_world"}


def test_an_id_inside_names_the_object():
    found = names(a={"type": "rectangle", "id": "other"})
    assert found == {"other.to_world", "other.bsdf.reflectance.value"}


@pytest.mark.parametrize("name", ["cpu", "type_of", "train", "forward", "sensors", "dtype", "state_dict", "training"])
def test_names_that_modules_refuse_get_an_underscore(name):
    scene = tr.load_dict(
        {
            "type": "scene",
            name: {"type": "diffuse", "reflectance": RGB},
            "a": {"type": "rectangle", "bsdf": {"type": "ref", "id": name}},
        }
    )
    taken = name != "type_of"
    expected = name + "_" * taken
    assert f"{expected}.reflectance.value" in dict(scene.named_parameters())
    assert scene[name] is getattr(scene, expected)
    assert scene.a.bsdf is scene[name]
    assert name in scene


def test_public_classes_carry_field_names():
    assert issubclass(tr.Diffuse, torch.nn.Module)
    built = [tr.Diffuse(), tr.TwoSided(brdf_0=tr.Diffuse()), tr.Null()]
    built += [
        tr.RoughConductor(),
        tr.RoughDielectric(),
        tr.RoughPlastic(),
        tr.Plastic(),
        tr.ThinDielectric(),
        tr.Principled(),
        tr.PrincipledThin(),
        tr.RednerMaterial(),
    ]
    built += [tr.Dielectric(), tr.Conductor(), tr.Bitmap(data=TEXELS), tr.Checkerboard(), tr.AreaLight()]
    built += [tr.ConstantLight(), tr.EnvironmentMap(data=TEXELS), tr.PointLight(), tr.Rectangle(), tr.Disk()]
    built += [tr.Sphere(), tr.Cube(), tr.PerspectiveCamera(), tr.DirectionalAreaLight()]
    built += [tr.IrradianceMeter(shape=tr.Rectangle()), tr.DirectionalLight(), tr.SpotLight(), tr.Projector()]
    assert len({type(b) for b in built}) == len(built)
    assert "Diffuse" in dir(tr)
    with pytest.raises(AttributeError, match="Difuse"):
        _ = tr.Difuse
