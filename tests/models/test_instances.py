"""Groups of shapes and their instances: where the copies are, what they share, what is refused."""

from __future__ import annotations

import re

import numpy as np
import pytest
import torch

import torchrender as tr
from torchrender.loaders import instances

pytestmark = pytest.mark.once  # what scenes are made of

TURN = tr.Transform.translate([1, 2, 3]) @ tr.Transform.rotate([0, 1, 0], 40)
MIRROR = tr.Transform.scale([-1, 1, 1])


def scene_of(**objects) -> dict:
    film = {"type": "hdrfilm", "width": 8, "height": 8}
    camera = {"type": "perspective", "to_world": tr.Transform.look_at([0, 1, 6], [0, 0, 0]), "film": film}
    return {"type": "scene", "camera": camera, "sky": {"type": "constant"}, **objects}


def group(**shapes) -> dict:
    return {"type": "shapegroup", **shapes}


def instance(to_world=None, name: str = "group") -> dict:
    placed = {} if to_world is None else {"to_world": to_world}
    return {"type": "instance", "shapegroup": {"type": "ref", "id": name}, **placed}


def test_copies_are_where_the_instances_say():
    """A mesh, and every analytic shape, under the instance's matrix times its own."""
    own = tr.Transform.translate([0.2, 0.1, 0]) @ tr.Transform.rotate([1, 0, 0], 10)
    shapes = {
        "cube": {"type": "cube", "to_world": own},
        "ball": {"type": "sphere", "to_world": own, "center": [0.1, 0, 0], "radius": 0.5},
        "plate": {"type": "disk", "to_world": own},
        "pipe": {"type": "cylinder", "to_world": own, "p1": [0, 1, 0]},
        "wall": {"type": "rectangle", "to_world": own},
        "hills": {"type": "heightfield", "to_world": own, "heights": torch.rand(3, 4)},
    }
    scene = tr.load_dict(scene_of(group=group(**shapes), thing=instance(TURN)), dtype=torch.float64)
    plain = {name: {**shape, "to_world": TURN @ own} for name, shape in shapes.items()}
    expected = tr.load_dict(scene_of(**plain), dtype=torch.float64)
    assert "group" not in scene and "thing" not in scene
    for name in shapes:
        torch.testing.assert_close(scene[f"thing_{name}"].bounds(), expected[name].bounds())
    image, other = (tr.render(s, spp=4, seed=1) for s in (scene, expected))
    assert float((image - image.mean()).abs().max()) > 0
    torch.testing.assert_close(image.mean(), other.mean(), rtol=0.05, atol=0)
    names = [f"thing_{name}" for name in shapes]
    o = torch.tensor([[1.0, 2.0, 8.0]]).double().expand(200, 3)
    spread = torch.randn(200, 3, generator=torch.Generator().manual_seed(0)).double() * 0.15
    d = torch.tensor([[0.0, 0.0, -1.0]]).double() + spread
    ours, theirs = (tr.ray_intersect(s, o, d) for s in (scene, expected))
    assert int(ours.valid.sum()) > 100 and len(names) == 6
    torch.testing.assert_close(ours.position, theirs.position)
    torch.testing.assert_close(ours.normal, theirs.normal)
    torch.testing.assert_close(ours.uv, theirs.uv)


@pytest.mark.parametrize("shape", ["cube", "sphere", "cylinder", "rectangle", "disk"])
def test_a_mirrored_copy_faces_the_same_way(shape):
    """Normals go with the shape: what is outside of it stays outside in a mirror."""
    group_of = group(only={"type": shape, "to_world": tr.Transform.rotate([0.3, 1, 0.2], 25)})
    plain, mirrored = (
        tr.load_dict(scene_of(group=group_of, thing=instance(m)), dtype=torch.float64)
        for m in (tr.Transform.scale([1, 1, 1]), MIRROR)
    )
    o = torch.tensor([[0.1, 0.2, 5.0]]).double().expand(64, 3)
    d = torch.randn(64, 3, generator=torch.Generator().manual_seed(1)).double() * 0.1 + torch.tensor([0, 0, -1.0])
    flip = torch.tensor([-1.0, 1, 1]).double()
    a, b = tr.ray_intersect(plain, o, d), tr.ray_intersect(mirrored, o * flip, d * flip)
    hit = a.valid
    assert int(hit.sum()) > 10 and torch.equal(hit, b.valid)
    torch.testing.assert_close((a.position * flip)[hit], b.position[hit])
    torch.testing.assert_close((a.normal * flip)[hit], b.normal[hit])
    torch.testing.assert_close((a.shading_normal * flip)[hit], b.shading_normal[hit])


def test_copies_share_their_material():
    paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.2, 0.1]}}
    ball = {"type": "sphere", "radius": 0.4, "bsdf": paint}
    scene = tr.load_dict(
        scene_of(
            group=group(ball=ball),
            left=instance(tr.Transform.translate([-1, 0, 0])),
            right=instance(tr.Transform.translate([1, 0, 0])),
        )
    )
    assert scene.left.bsdf is scene.right.bsdf
    assert scene.left.radius is not scene.right.radius
    scene.left.radius.requires_grad_()
    reflectance = scene.get_parameter("left.bsdf.reflectance.value").requires_grad_()
    image = tr.render(scene, spp=16, seed=0)
    image.sum().backward()
    assert float(reflectance.grad.min()) > 0
    halves = image.detach()[:, :4].mean(), image.detach()[:, 4:].mean()
    torch.testing.assert_close(*halves, rtol=0.1, atol=0)


def test_a_matrix_with_a_graph_gets_gradients_through_the_copies():
    """d mean(x) / d translation = 1: vertices are matrix times those of the group, for autograd, too."""
    matrix = torch.eye(4, dtype=torch.float64, requires_grad=True)
    scene = tr.load_dict(scene_of(group=group(cube={"type": "cube"}), box=instance(matrix)), dtype=torch.float64)
    (gradient,) = torch.autograd.grad(scene.box.vertex_positions[:, 0].mean(), matrix)
    expected = torch.zeros(4, 4).double()
    expected[0, 3] = 1.0
    torch.testing.assert_close(gradient, expected)


def test_files_of_groups_and_computed_normals(tmp_path):
    """A file without normals is read once, and its copies are shaded smooth with normals of their own."""
    (tmp_path / "tetra.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    (tmp_path / "scene.xml").write_text(
        """<scene version="3.0.0">
        <shape type="shapegroup" id="leaves">
            <shape type="obj"><string name="filename" value="tetra.obj"/><ref id="green"/></shape>
        </shape>
        <bsdf type="diffuse" id="green"><rgb name="reflectance" value="0.1 0.6 0.2"/></bsdf>
        <shape type="instance" id="a"><ref id="leaves"/></shape>
        <shape type="instance" id="b">
            <ref id="leaves"/><transform name="to_world"><scale x="-2" y="2" z="2"/></transform>
        </shape>
        </scene>"""
    )
    scene = tr.load_file(tmp_path / "scene.xml")
    assert scene.a.bsdf is scene.b.bsdf is scene.green
    assert scene.a.computed_normals and scene.b.computed_normals
    flip = torch.tensor([-1.0, 1, 1])
    torch.testing.assert_close(scene.b.vertex_positions, scene.a.vertex_positions * flip * 2)
    torch.testing.assert_close(scene.b.vertex_normals, scene.a.vertex_normals * flip)
    scene.save(tmp_path / "out" / "scene.xml")
    again = tr.load_file(tmp_path / "out" / "scene.xml")
    assert torch.equal(again.b.vertex_positions, scene.b.vertex_positions)


def test_lights_are_copied():
    lamp = {"type": "rectangle", "emitter": {"type": "area", "radiance": 2.0}}
    objects = scene_of(group=group(lamp=lamp), a=instance(TURN), b=instance(MIRROR))
    scene = tr.load_dict(objects)
    assert [scene[name].emitter.type for name in "ab"] == ["area", "area"]
    image = tr.render(scene, spp=4, seed=0)
    assert bool(torch.isfinite(image).all())


def test_built_objects_in_groups():
    mesh = tr.Mesh(torch.rand(3, 3), [[0, 1, 2]], attributes={"vertex_color": torch.rand(3, 3)})
    scene = tr.load_dict(scene_of(group=group(part=mesh), a=instance(TURN), b=instance(MIRROR)))
    assert torch.equal(scene.a.vertex_color, mesh.vertex_color)
    matrix = torch.as_tensor(np.asarray(TURN.matrix)).float()
    torch.testing.assert_close(scene.a.vertex_positions, mesh.vertex_positions @ matrix[:3, :3].T + matrix[:3, 3])


BALL = {"type": "sphere"}
ERRORS = [
    ({"a": {"type": "instance"}}, "a: an instance needs a shapegroup"),
    ({"a": instance(name="grup"), "group": group(b=BALL)}, "there is no shapegroup with the id 'grup'"),
    ({"group": group()}, "group: the shapegroup is empty"),
    ({"group": group(b=BALL, c=instance())}, "group.c: a shapegroup holds shapes, and no instance in turn"),
    ({"group": group(b={"type": "diffuse"})}, "group.b: expected a shape, got 'diffuse', which is a bsdf"),
    ({"group": group(b=3.0)}, "group.b: expected a shape"),
    ({"group": group(b=BALL), "a": {**instance(), "radius": 2.0}}, "a.radius: an instance has a shapegroup and"),
    ({"group": group(b=BALL), "a": instance(np.zeros((4, 4)))}, "singular"),
    ({"group": group(b={"type": "sphere", "radius": -1.0})}, "group.b.radius: expected a positive number"),
    ({"group": group(b=BALL), "a": instance(), "other": {**instance(), "id": "a"}}, "two objects have the id 'a'"),
]


@pytest.mark.parametrize(("objects", "message"), ERRORS, ids=range(len(ERRORS)))
def test_errors_name_the_place(objects, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        tr.load_dict(scene_of(**objects))


def test_instances_are_limited(monkeypatch):
    monkeypatch.setattr(instances, "MAX_COPIES", 5)
    many = {f"i{k}": instance() for k in range(3)}
    with pytest.raises(ValueError, match="i2: too many instances: a scene has at most 5 copies of shapes"):
        tr.load_dict(scene_of(group=group(a=BALL, b=BALL), **many))
    monkeypatch.setattr(instances, "MAX_NUMBERS", 100)
    with pytest.raises(ValueError, match="of 100 vertices and faces together"):
        tr.load_dict(scene_of(group=group(a={"type": "cube"}), **many))


def test_an_instance_by_itself_is_refused():
    scene = tr.load_dict(scene_of(ball=BALL))
    with pytest.raises(ValueError, match="an instance stands at the top of the dict or file"):
        scene["more"] = instance()
