"""A scene is a module: objects come and go, copies and files keep it, parameters are chosen by pattern."""

from __future__ import annotations

import copy
import io
import pickle

import pytest
import torch
from small_scene import ball_and_wall

import torchrender as tr


def make(**settings) -> tr.Scene:
    return tr.load_dict(ball_and_wall(10, 12, 4), **settings)


def picture(scene, **settings) -> torch.Tensor:
    return tr.render(scene, seed=3, **settings).detach()


@pytest.mark.parametrize("how", ["deepcopy", "pickle", "torch.save"])
def test_copies_render_the_same(how):
    scene = make()
    before = picture(scene)
    if how == "deepcopy":
        other = copy.deepcopy(scene)
    elif how == "pickle":
        other = pickle.loads(pickle.dumps(scene))
    else:
        stream = io.BytesIO()
        torch.save(scene, stream)
        stream.seek(0)
        other = torch.load(stream, weights_only=False)
    assert torch.equal(picture(other), before)
    # They are independent of each other.
    with torch.no_grad():
        other.sky.radiance.value.mul_(2)
    assert torch.equal(picture(scene), before)
    torch.testing.assert_close(picture(other), 2 * before)
    assert other.wall.bsdf is other.red


def test_state_dict_carries_all_values():
    scene, other = make(), make()
    with torch.no_grad():
        for parameter in other.parameters():
            parameter.mul_(0.5)
    scene.sky.radiance.value.data.fill_(3)
    other.load_state_dict(scene.state_dict())
    assert torch.equal(picture(other), picture(scene))


def test_precision_can_be_changed():
    scene = make()
    image = picture(scene)
    scene.to(torch.float64)
    assert scene.dtype == torch.float64
    double = picture(scene)
    assert double.dtype == torch.float64
    torch.testing.assert_close(double.float(), image, atol=0.05, rtol=0.05)
    assert torch.equal(picture(scene.float()), image)


def test_objects_come_and_go():
    scene = make()
    empty = picture(scene)
    scene["lens"] = tr.Rectangle(to_world=tr.Transform.translate([0, 0, 2]), bsdf={"type": "ref", "id": "red"})
    assert scene.lens.bsdf is scene.red
    assert not torch.equal(picture(scene), empty)
    del scene["lens"]
    assert torch.equal(picture(scene), empty)
    assert "lens" not in scene
    with pytest.raises(KeyError, match="lens"):
        del scene["lens"]


def test_replacing_a_material_replaces_it_everywhere():
    scene = make()
    scene["red"] = {"type": "diffuse", "reflectance": 0.9}
    assert scene.wall.bsdf is scene.red
    assert scene.get_parameter("wall.bsdf.reflectance.value").shape == ()
    scene.red = tr.Diffuse(reflectance=0.2)
    assert float(scene.wall.bsdf.reflectance.value) == pytest.approx(0.2)


def test_new_values_of_another_shape():
    scene = make()
    scene.ball.bsdf.reflectance.data = torch.full((7, 9, 3), 0.5)
    torch.testing.assert_close(picture(scene), picture(make()))
    scene.red.reflectance = 0.6
    assert scene.get_parameter("red.reflectance.value").shape == ()
    scene.red.reflectance = {"type": "checkerboard", "color0": 0.1}
    assert "red.reflectance.color0.value" in dict(scene.named_parameters())
    picture(scene)


def test_assignment_keeps_the_wish_for_gradients():
    scene = make()
    scene.train_only("red.*")
    scene.red.reflectance.value = [0.1, 0.2, 0.3]
    assert scene.red.reflectance.value.requires_grad
    assert scene.red.reflectance.value.tolist() == pytest.approx([0.1, 0.2, 0.3])


def test_static_settings_are_seen():
    scene = make()
    assert scene.ball.bsdf.reflectance.filter_type == "bilinear"
    texels = torch.rand(4, 4, 3, generator=torch.Generator().manual_seed(0))
    scene.ball.bsdf.reflectance.data = texels
    smooth = picture(scene)
    scene.ball.bsdf.reflectance.filter_type = "nearest"
    assert not torch.equal(picture(scene), smooth)
    with pytest.raises(ValueError, match="nearest"):
        scene.ball.bsdf.reflectance.filter_type = "nearset"


def test_indices_edited_in_place_are_seen():
    scene = make()
    scene["patch"] = tr.Mesh(
        [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
        [[0, 1, 2], [0, 2, 3]],
        bsdf=tr.Diffuse(reflectance=0.0),
    )
    before = picture(scene)
    scene.patch.faces[1] = scene.patch.faces[0]
    assert not torch.equal(picture(scene), before)


def test_normals_follow_positions(tmp_path):
    (tmp_path / "tent.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 1\n0 1 1\n-1 0 0\n1 0 0\n3 0 1 2\n3 1 0 3\n"
    )
    scene = make()
    scene["tent"] = {"type": "ply", "filename": str(tmp_path / "tent.ply")}
    picture(scene)
    turned = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    expected = scene.tent.vertex_normals.detach() @ turned.T
    with torch.no_grad():
        scene.tent.vertex_positions.copy_(scene.tent.vertex_positions @ turned.T)
    picture(scene)
    torch.testing.assert_close(scene.tent.vertex_normals.detach(), expected, atol=1e-6, rtol=0)


def test_train_only_chooses_by_pattern():
    scene = make()
    chosen = scene.train_only("*.reflectance.*")
    assert {n for n, p in scene.named_parameters() if p.requires_grad} == {
        "red.reflectance.value",
        "ball.bsdf.reflectance.data",
    }
    assert len(chosen) == 2
    assert scene.train_only("sky.radiance.value", "red.*")[0] is scene.sky.radiance.value
    assert not scene.ball.bsdf.reflectance.data.requires_grad
    assert scene.train_only() == []
    with pytest.raises(ValueError, match="reflectance"):
        scene.train_only("red.reflectanse.value")
    with pytest.raises(tr.NotDifferentiableError, match=r"sky\.sampling_weight"):
        scene.train_only("sky.sampling_weight")
    (to_uv,) = scene.train_only("*.to_uv")  # by name only: "*.reflectance.*" means colours
    assert to_uv is scene.ball.bsdf.reflectance.to_uv


def test_get_parameter_names_the_nearest():
    scene = make()
    assert scene.get_parameter("red.reflectance.value") is scene.red.reflectance.value
    with pytest.raises(AttributeError, match=r"red\.reflectance\.value"):
        scene.get_parameter("red.reflectanse.value")
    with pytest.raises(AttributeError, match="reflectance"):
        _ = scene.red.reflectanse


def test_summary_lists_parameters():
    text = repr(make())
    for part in ("variant rgb", "float32", "red.reflectance.value", "[0.1, 0.6]", "4x4x3", "10 x 12 pixels"):
        assert part in text
    line = next(row for row in text.splitlines() if "sensor.near_clip" in row)
    assert " none [" in line


def test_bounding_box():
    scene = tr.load_dict(
        {
            "type": "scene",
            "a": {"type": "sphere", "center": [1, 0, 0], "radius": 2},
            "b": {"type": "cube", "to_world": tr.Transform.translate([0, 5, 0])},
            "c": {"type": "disk", "to_world": tr.Transform.translate([0, 0, -7]) @ tr.Transform.rotate([1, 0, 0], 90)},
            "d": {"type": "rectangle", "to_world": tr.Transform.scale([4, 1, 1])},
        }
    )
    torch.testing.assert_close(scene.bounding_box(), torch.tensor([[-4.0, -2.0, -8.0], [4.0, 6.0, 2.0]]))
    with pytest.raises(ValueError, match="no shapes"):
        tr.load_dict({"type": "scene"}).bounding_box()


def test_sensors_and_integrator():
    scene = make()
    assert scene.sensors == [scene.sensor]
    assert isinstance(scene.integrator, tr.PathTracer) and scene.integrator.max_depth == 3
    scene.integrator = tr.DirectIllumination()
    assert isinstance(scene.integrator, tr.DirectIllumination)
    assert len([m for m in scene.modules() if isinstance(m, tr.Integrator)]) == 1
    scene["other"] = {"type": "perspective"}
    assert len(scene.sensors) == 2


def test_parametrisations_of_torch():
    from torch.nn.utils import parametrize

    scene = make()
    before = picture(scene)
    parametrize.register_parametrization(scene.red.reflectance, "value", tr.constraints.UnitInterval())
    torch.testing.assert_close(picture(scene), before, atol=1e-5, rtol=1e-5)
    original = scene.red.reflectance.parametrizations.value.original
    original.requires_grad_()
    tr.render(scene, seed=1).sum().backward()
    assert original.grad.shape == (3,) and bool((original.grad != 0).all())


def test_a_refused_edit_changes_nothing():
    scene = make()
    before = picture(scene)
    with pytest.raises(ValueError, match=r"ball\.bsdf: there is no object with the id 'rde'"):
        scene["ball"] = {"type": "sphere", "bsdf": {"type": "ref", "id": "rde"}}
    with pytest.raises(ValueError, match="raduis"):
        scene["ball"] = {"type": "sphere", "raduis": 1}
    with pytest.raises(ValueError, match="reflectance"):
        scene.red.reflectance = 1.5
    assert torch.equal(picture(scene), before)


@pytest.mark.parametrize("what", ["vertices", "smooth vertices", "texcoords", "environment", "texels", "colour"])
@pytest.mark.parametrize("way", ["data", "numpy"])
def test_edits_that_no_version_counter_shows_are_seen(what, way):
    """Writes through `.data` or an array that shares the memory: also to what other things are derived from."""

    def build(edited: bool) -> tr.Scene:
        side = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.3]])
        texels = torch.rand(4, 4, 3, generator=torch.Generator().manual_seed(1))
        sky = torch.rand(4, 8, 3, generator=torch.Generator().manual_seed(2))
        mesh = tr.Mesh(
            side,
            [[0, 1, 2], [0, 2, 3]],
            vertex_texcoords=side[:, :2] / 2 + 0.5,
            bsdf={"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels, "raw": True}},
        )
        if what == "smooth vertices":
            mesh.compute_normals()
        wall = {"type": "rectangle", "to_world": tr.Transform.translate([0, 0, -2]).scale(5), "bsdf": tr.Diffuse()}
        camera = {"type": "perspective", "to_world": tr.Transform.look_at([0, 0, 4], [0, 0, 0])}
        camera["film"] = {"type": "hdrfilm", "width": 8, "height": 8}
        scene = tr.load_dict(
            {"type": "scene", "c": camera, "mesh": mesh, "wall": wall, "sky": {"type": "envmap", "data": sky}}
        )
        if not edited:
            tr.render(scene, spp=4, seed=0)
        tensor = {
            "texcoords": scene.mesh.vertex_texcoords,
            "environment": scene.sky.data,
            "texels": scene.mesh.bsdf.reflectance.data,
            "colour": scene.wall.bsdf.reflectance.value,
        }.get(what, scene.mesh.vertex_positions)
        if edited:
            with torch.no_grad():
                tensor.mul_(0.5)
        elif way == "data":
            tensor.data.mul_(0.5)
        else:
            array = tensor.detach().numpy()
            array *= 0.5
        return scene

    assert torch.equal(tr.render(build(False), spp=4, seed=0), tr.render(build(True), spp=4, seed=0))
