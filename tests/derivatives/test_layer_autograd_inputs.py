"""What derivatives are asked of: tensors of every kind, edits in between, graphs behind objects, missing terms."""

from __future__ import annotations

import warnings

import pytest
import torch
from autograd_scene import make, picture, rand
from small_scene import COLOUR, TEXELS
from torch.autograd import forward_ad

import torchrender as tr
from torchrender.scene.declaration import models
from torchrender.scene.derivatives import COMPLETE

pytestmark = pytest.mark.once  # modes of autograd


@pytest.fixture(scope="module")
def scene():
    return make()


@pytest.fixture(scope="module")
def double():
    return make(dtype=torch.float64)


# ----------------------------------------------------------------------------------------------- edits in between
def test_edits_in_place_between_forward_and_backward():
    scene = make()
    (colour,) = scene.train_only(COLOUR)
    for edited in (colour, scene.sky.radiance.value, scene.ball.bsdf.reflectance.data):
        loss = picture(scene).sum()
        with torch.no_grad():
            edited.mul_(0.9)
        with pytest.raises(RuntimeError, match="modified by an inplace operation"):
            loss.backward()


def test_faces_edited_between_forward_and_backward():
    scene = make()
    scene["mesh"] = tr.Mesh([[-1, -1, 1], [1, -1, 1], [0, 1, 1]], [[0, 1, 2]], bsdf={"type": "ref", "id": "red"})
    scene.train_only(COLOUR)
    loss = picture(scene).sum()
    scene.mesh.faces[0] = torch.tensor([2, 1, 0])
    with pytest.raises(RuntimeError, match=r"faces .* modified by an inplace operation"):
        loss.backward()


def test_steps_between_forward_and_backward_of_another_parameter():
    """Edits that replace (structure, new tensors) leave the image's derivative what it was."""
    scene = make()
    (colour,) = scene.train_only(COLOUR)
    (expected,) = torch.autograd.grad(picture(scene).sum(), colour)
    loss = picture(scene).sum()
    scene.ball.bsdf.reflectance.data = rand(5, 5, 3)
    scene["more"] = tr.Disk()
    del scene["lamp"]
    picture(scene)
    assert torch.equal(torch.autograd.grad(loss, colour)[0], expected)


# ---------------------------------------------------------------------------------------------------------- params=
def test_every_kind_of_tensor_is_taken(scene):
    """Leaf, result of a computation, view, expanded, not contiguous: gradients arrive where they came from."""
    texels = rand(4, 4, 3)

    def run(leaf, image_of):
        leaf = leaf.clone().requires_grad_()
        image = image_of(leaf)
        image.sum().backward()
        return image.detach(), leaf.grad

    image, gradient = run(texels, lambda x: picture(scene, x, TEXELS))
    for leaf, view, back in [
        (texels.permute(2, 0, 1).contiguous(), lambda x: x.permute(1, 2, 0), lambda g: g.permute(1, 2, 0)),
        (texels.flatten(), lambda x: x.view(4, 4, 3), lambda g: g.view(4, 4, 3)),
        (texels.repeat(1, 2, 1), lambda x: x[:, :4], lambda g: g[:, :4]),
        (texels.repeat_interleave(2, dim=0), lambda x: x[::2], lambda g: g[::2]),
        (2 * texels, lambda x: x / 2, lambda g: 2 * g),
    ]:
        other, pulled = run(leaf, lambda x, view=view: picture(scene, view(x), TEXELS))
        assert torch.equal(other, image)
        assert torch.equal(back(pulled), gradient)
    _, grey = run(torch.tensor([0.3]), lambda x: picture(scene, x.expand(3)))
    _, colour = run(torch.full((3,), 0.3), lambda x: picture(scene, x))
    torch.testing.assert_close(grey, colour.sum()[None])


def test_one_tensor_for_two_parameters(scene):
    value = torch.tensor(0.5, requires_grad=True)
    image = picture(scene, None, params={COLOUR: value, "sky.radiance.value": value})
    image.sum().backward()
    parts = []
    for name, other in ((COLOUR, "sky.radiance.value"), ("sky.radiance.value", COLOUR)):
        leaf = torch.tensor(0.5, requires_grad=True)
        picture(scene, None, params={name: leaf, other: leaf.detach()}).sum().backward()
        parts.append(leaf.grad)
    torch.testing.assert_close(value.grad, parts[0] + parts[1])


def test_a_parameter_under_two_names_is_given_once(scene):
    both = {COLOUR: rand(3), "wall.bsdf.reflectance.value": rand(3)}
    with pytest.raises(ValueError, match=r"wall\.bsdf\.reflectance\.value: the parameter 'red\.reflectance\.value'"):
        picture(scene, None, params=both)


def test_devices_are_named(scene):
    with pytest.raises(ValueError, match=r"red\.reflectance\.value: lies on meta, but the scene on cpu"):
        picture(scene, torch.zeros(3, device="meta"))
    other = make()
    other.sky.to("meta")
    with pytest.raises(ValueError, match=r"sky\.radiance\.value: lies on meta, but the scene on cpu"):
        picture(other)
    with pytest.raises(ValueError, match="lies on meta"):
        picture(make().to("meta"))


# --------------------------------------------------------------------------------------- what has no derivative
def with_derivative(kind: str) -> list[str]:
    return [f"{t}.{f.name}" for (_, t), m in models().items() for f in m.fields if f.derivative.startswith(kind)]


def test_missing_terms_are_warned_about_once():
    def make_with_pane():
        scene = make()
        scene["pane"] = tr.Rectangle(bsdf=tr.ThinDielectric())
        return scene

    scene = make_with_pane()
    (position,) = scene.train_only("lamp.position")
    with pytest.warns(tr.MissingTermWarning) as caught:
        image = tr.render(scene, seed=1)
    assert len(caught) == 1 and caught[0].filename == __file__
    text = str(caught[0].message)
    assert "lamp.position" in text and "seen in or through pane.bsdf" in text and " where " in text
    image.sum().backward()
    assert bool((position.grad != 0).any())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        picture(scene)  # once for a parameter of a scene
        with torch.no_grad():
            picture(make())
        picture(make().requires_grad_(False))  # where nothing is missing nothing is said
        complete = make()
        complete.train_only("lamp.position")
        picture(complete)
        other = make_with_pane()
        other.train_only(COLOUR)
        picture(other)
    with pytest.warns(tr.MissingTermWarning), forward_ad.dual_level():
        picture(make_with_pane(), forward_ad.make_dual(torch.zeros(3), torch.ones(3)), "lamp.position")


def test_parameters_that_reach_no_image_are_warned_about():
    scene = make()
    scene["spare"] = {"type": "diffuse", "reflectance": 0.5}
    (spare,) = scene.train_only("spare.*")
    with pytest.warns(UserWarning, match=r"spare\.reflectance\.value: nothing in the scene uses this"):
        picture(scene).sum().backward()
    assert spare.grad.item() == 0
    scene.wall.bsdf = scene.spare
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        picture(scene).sum().backward()
    assert spare.grad.item() > 0


def test_words_of_the_declaration():
    lacking = COMPLETE.also("interior, without moving edges: 0 for flat things")
    assert (lacking.refusal, lacking.caveat) == ("", "moving edges: 0 for flat things")
    assert COMPLETE.also("interior, without moving edges").caveat.startswith("moving edges: zero where")
    assert COMPLETE.also("interior, without moving edges; zero for flat things").caveat.endswith(
        ": zero for flat things"
    )
    assert COMPLETE.also("interior") == COMPLETE
    assert lacking.also("none: it is a name").refusal == "it is a name"
    assert COMPLETE.also("none").refusal
    # Every continuous field says in one of these ways what it has.
    said = {f.derivative.split(",")[0].split(":")[0] for m in models().values() for f in m.fields}
    assert said <= {"interior", "none"}
    assert with_derivative("interior, without") and with_derivative("none")


def graph(value):
    """A tensor like `value` that is part of a graph, and its leaf."""
    leaf = torch.as_tensor(value, dtype=torch.float32).clone().requires_grad_()
    return leaf * 1, leaf


GIVEN = {
    "fov": (lambda x: tr.PerspectiveCamera(fov=x), 40.0, "x_fov"),
    "fov of y": (lambda x: tr.PerspectiveCamera(fov=x, fov_axis="y"), 40.0, "x_fov"),
    "focal length": (lambda x: tr.PerspectiveCamera(focal_length=x), 35.0, "x_fov"),
    "look_at fov": (lambda x: tr.PerspectiveCamera.look_at([0, 0, 4], [0, 0, 0], fov=x), 40.0, "x_fov"),
    "look_at origin": (lambda x: tr.PerspectiveCamera.look_at(x, [0, 0, 0]), [0.0, 1.0, 4.0], "to_world"),
    "look_at target": (lambda x: tr.PerspectiveCamera.look_at([0, 0, 4], x), [0.0, 1.0, 0.0], "to_world"),
    "opengl matrix": (lambda x: tr.PerspectiveCamera.from_opengl(x, 40, (4, 4)), torch.eye(4), "to_world"),
    "opengl fov": (lambda x: tr.PerspectiveCamera.from_opengl(torch.eye(4), x, (4, 4)), 40.0, "x_fov"),
    "transform": (lambda x: tr.Rectangle(to_world=tr.Transform.translate(x)), [0.0, 1.0, 0.0], "to_world"),
    "rotation angle": (lambda x: tr.Disk(to_world=tr.Transform.rotate([0, 0, 1], x)), 40.0, "to_world"),
    "list of numbers": (lambda x: tr.Sphere(center=[x, 0.0, x]), 0.5, "center"),
    "radius": (lambda x: tr.Sphere(radius=x), 0.5, "radius"),
    "index of refraction": (lambda x: tr.Dielectric(int_ior=x), 1.5, "eta"),
    "index outside": (lambda x: tr.Dielectric(ext_ior=x), 1.1, "eta"),
    "point light's matrix": (lambda x: tr.PointLight(to_world=x), torch.eye(4), "position"),
    "direction of light": (lambda x: tr.DirectionalLight(direction=x), [0.2, -1.0, 0.3], "to_world"),
    "fov of a projector": (lambda x: tr.Projector(fov=x), 40.0, "x_fov"),
    "vertices": (lambda x: tr.Mesh(x, [[0, 1, 2]]), torch.eye(3), "vertex_positions"),
    "mesh's matrix": (lambda x: tr.Mesh(torch.eye(3), [[0, 1, 2]], to_world=x), torch.eye(4), "vertex_positions"),
    "cube's matrix": (lambda x: tr.Cube(to_world=x), torch.eye(4), "vertex_positions"),
    "bitmap": (lambda x: tr.Bitmap(data=x), torch.ones(2, 2, 3), "data"),
    "to_uv": (lambda x: tr.Bitmap(data=torch.ones(2, 2, 3), to_uv=x), torch.eye(3), "to_uv"),
}


@pytest.mark.parametrize("name", GIVEN)
def test_objects_keep_the_graph_of_what_they_are_made_from(name):
    build, value, field = GIVEN[name]
    given, leaf = graph(value)
    made = getattr(build(given), field)
    weight = torch.arange(1.0, made.numel() + 1).reshape(made.shape)
    (gradient,) = torch.autograd.grad((made * weight).sum(), leaf)
    assert bool((gradient != 0).any())


@pytest.mark.parametrize("name", GIVEN)
def test_objects_keep_the_tangent_of_what_they_are_made_from(name):
    build, value, field = GIVEN[name]
    value = torch.as_tensor(value, dtype=torch.float32)
    leaf = value.clone().requires_grad_()
    with forward_ad.dual_level():
        made = getattr(build(forward_ad.make_dual(value, torch.arange(1.0, value.numel() + 1).view_as(value))), field)
        tangent = forward_ad.unpack_dual(made).tangent
    assert tangent is not None
    made = getattr(build(leaf * 1), field)
    weight = torch.arange(1.0, made.numel() + 1).view_as(made)
    (gradient,) = torch.autograd.grad((made * weight).sum(), leaf)
    pulled = (gradient * torch.arange(1.0, value.numel() + 1).view_as(value)).sum()
    torch.testing.assert_close((tangent * weight).sum().to(pulled), pulled, rtol=1e-4, atol=1e-4)


def test_colours_keep_their_graph_through_every_form():
    for form in (
        lambda x: tr.Diffuse(reflectance=x),
        lambda x: {"type": "diffuse", "reflectance": x},
        lambda x: {"type": "diffuse", "reflectance": {"type": "rgb", "value": x}},
        lambda x: {"type": "diffuse", "reflectance": {"type": "rgb", "value": [x[0], x[1], 0.5]}},
        lambda x: {"type": "diffuse", "reflectance": {"type": "bitmap", "data": x.expand(2, 2, 3), "raw": True}},
    ):
        for settings in ({}, {"dtype": torch.float64}, {"variant": "mono"}):
            given, leaf = graph([0.6, 0.3, 0.2])
            scene = tr.load_dict(
                {
                    "type": "scene",
                    "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 2, "height": 2}},
                    "wall": {"type": "rectangle", "to_world": tr.Transform.look_at([0, 0, 3], [0, 0, 0])}
                    | {"bsdf": form(given)},
                    "sky": {"type": "constant"},
                },
                **settings,
            )
            picture(scene).sum().backward()
            assert bool((leaf.grad[:2] != 0).all())


def test_computed_normals_follow_positions_that_have_derivatives(tmp_path):
    """A file without normals is shaded with normals that follow its positions: they belong to the derivative."""
    (tmp_path / "tent.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 1\n0 1 1\n-1 0 0\n1 0 0\n3 0 1 2\n3 1 0 3\n"
    )
    scene = make(dtype=torch.float64)
    scene["tent"] = {"type": "ply", "filename": str(tmp_path / "tent.ply")}
    layout = scene.layout()
    slot = layout.slot_of[id(scene.tent), "vertex_normals"]
    plain = tr.scene.gather.gather(scene, layout, None)[slot]
    positions = scene.tent.vertex_positions.requires_grad_()
    attached = tr.scene.gather.gather(scene, layout, None)[slot]
    torch.testing.assert_close(attached, plain, rtol=0, atol=1e-15)
    assert not plain.requires_grad
    weight = rand(4, 3, dtype=torch.float64)
    (gradient,) = torch.autograd.grad((attached * weight).sum(), positions)
    direction = rand(4, 3, dtype=torch.float64, seed=1)
    with torch.no_grad():
        step = 1e-6 * direction
        high = (scene.tent.normals_from_positions(positions + step) * weight).sum()
        low = (scene.tent.normals_from_positions(positions - step) * weight).sum()
    assert float((gradient * direction).sum()) == pytest.approx(float(high - low) / 2e-6, rel=1e-6)
    # Asked for by themselves too, they get what is theirs.
    normals = scene.tent.vertex_normals.requires_grad_()
    both = tr.scene.gather.gather(scene, layout, None)[slot]
    first, second = torch.autograd.grad((both * weight).sum(), [positions, normals])
    assert torch.equal(first, gradient) and torch.equal(second, weight)


def test_every_required_leaf_gets_a_gradient(scene):
    """What DistributedDataParallel waits for: no leaf that requires a gradient stays without one."""
    leaves = scene.train_only("*.reflectance.*", "*.radiance.*", "*.intensity.*")
    try:
        picture(scene, crop=(0, 0, 1, 1)).sum().backward()  # a corner that hardly anything reaches
        assert len(leaves) == 4 and all(leaf.grad is not None for leaf in leaves)
    finally:
        scene.zero_grad(set_to_none=True)
        scene.train_only()


def test_default_devices_and_dtypes_change_nothing(scene):
    """Programs that compute on a GPU set torch's default device; what is made here lies where the scene lies."""
    expected = picture(scene)
    torch.set_default_device("meta")
    try:
        made = make()
        image = picture(made)
        made["more"] = tr.Cube(to_world=tr.Transform.scale(0.1))
        made.red.reflectance = [0.2, 0.3, 0.4]
        camera = tr.PerspectiveCamera.look_at([0, 0, 4], [0, 0, 0], size=(4, 4))
        matrix = [[40, 0, 2], [0, 40, 2], [0, 0, 1]], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [0, 0, 4]
        other = tr.PerspectiveCamera.from_opencv(*matrix, (4, 4))
        images = tr.render(made, sensor=[camera, other], spp=1, seed=None)
        assert "red" in repr(made) and made.bounding_box().device.type == "cpu"
        rays = made.sensors[0].rays()
        found = tr.ray_intersect(made, *rays, params={"ball.radius": torch.ones((), device="cpu", requires_grad=True)})
        shadowed = tr.ray_occluded(made, [[0.0, 0, 4]], [[0.0, 0, -1]], 9.0)
        found.position[found.valid].sum().backward()
        some = tr.render(made, spp=1, pixels=[[0, 0]])
    finally:
        torch.set_default_device(None)
    assert torch.equal(image, expected) and images.device.type == "cpu"
    assert {t.device.type for t in (*rays, *found, shadowed, some)} == {"cpu"} and bool(shadowed.all())
    with pytest.raises(ValueError, match=r"red\.reflectance: .*meta device"):
        tr.load_dict({"type": "scene", "red": {"type": "diffuse", "reflectance": torch.zeros(3, device="meta")}})
    torch.set_default_dtype(torch.float64)
    try:
        assert torch.equal(picture(make()), expected)
    finally:
        torch.set_default_dtype(torch.float32)


def test_sparse_tensors_are_refused(scene):
    with pytest.raises(TypeError, match=r"red\.reflectance\.value: expected a dense tensor, got layout"):
        picture(scene, torch.ones(3).to_sparse())
