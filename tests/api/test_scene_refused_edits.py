"""Edits of a scene: what is refused leaves it as it was, what is taken stays a parameter."""

from __future__ import annotations

import copy

import pytest
import torch
from small_scene import COLOUR, ball_and_wall
from torch import nn

import torchrender as tr

TENT = ([[0.0, 0, 1], [0, 1, 1], [-1, 0, 0], [1, 0, 0]], [[0, 1, 2], [1, 0, 3]])


def make(**objects) -> tr.Scene:
    return tr.load_dict(ball_and_wall(**objects))


def tent(**settings) -> tr.Mesh:
    mesh = tr.Mesh(*TENT, **settings)
    mesh.compute_normals()
    return mesh


def picture(scene: tr.Scene, **settings) -> torch.Tensor:
    return tr.render(scene, seed=1, **settings).detach()


# --------------------------------------------------------------------------------------------------- computed normals
@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("through_data", [False, True])
def test_an_edit_of_computed_normals_is_overwritten(moving, through_data):
    scene = make(tent=tent())
    scene.tent.vertex_positions.requires_grad_(moving)
    before, normals = picture(scene), scene.tent.vertex_normals.detach().clone()
    with torch.no_grad():
        (scene.tent.vertex_normals.data if through_data else scene.tent.vertex_normals).neg_()
    assert torch.equal(picture(scene), before)
    assert torch.equal(scene.tent.vertex_normals, normals)
    # Normals of its own do stay.
    scene.tent.vertex_normals = -normals
    assert not torch.equal(picture(scene), before)
    assert torch.equal(scene.tent.vertex_normals, -normals)


def test_computed_normals_follow_faces():
    scene, other = make(tent=tent()), make()
    picture(scene)
    scene.tent.faces = [[0, 2, 1]]
    mesh = tr.Mesh(TENT[0], [[0, 2, 1]])
    mesh.compute_normals()
    other["tent"] = mesh
    picture(scene)
    torch.testing.assert_close(scene.tent.vertex_normals, other.tent.vertex_normals, atol=1e-6, rtol=0)


def test_substituted_normals_are_not_written_to():
    scene = make(tent=tent())
    given = -scene.tent.vertex_normals.detach()
    kept = given.clone()
    image = torch.func.functional_call(scene, {"tent.vertex_normals": given}, kwargs={"seed": 1})
    assert torch.equal(given, kept)
    assert torch.equal(image, picture(scene, params={"tent.vertex_normals": given}))
    assert not torch.equal(image, picture(scene))


def test_computed_normals_are_chosen_by_name_only():
    scene = make(tent=tent(), own=tr.Mesh(*TENT, vertex_normals=TENT[0]))
    for pattern in ("tent.*", "tent.vertex_*"):
        assert [p is scene.tent.vertex_positions for p in scene.train_only(pattern) if p.shape == (4, 3)] == [True]
        assert not scene.tent.vertex_normals.requires_grad
    (normals,) = scene.train_only("tent.vertex_normals")
    assert normals is scene.tent.vertex_normals
    assert any(p is scene.own.vertex_normals for p in scene.train_only("own.vertex_*"))


def test_a_refused_assignment_leaves_normals_computed():
    scene = make(tent=tent())
    for wrong in (torch.zeros(3, 3), torch.full((4, 3), float("nan")), "up"):
        with pytest.raises(ValueError, match="vertex_normals"):
            scene.tent.vertex_normals = wrong
        assert scene.tent.computed_normals
    scene.tent.vertex_normals = TENT[0]
    assert not scene.tent.computed_normals


def test_loaded_state_leaves_normals_computed():
    scene, other = make(tent=tent()), make(tent=tent())
    other.load_state_dict(scene.state_dict(), assign=True)
    assert other.tent.computed_normals
    with torch.no_grad():
        scene.tent.vertex_positions[0, 2] = 2
        other.tent.vertex_positions[0, 2] = 2
    assert torch.equal(picture(other), picture(scene))


# -------------------------------------------------------------------------------------------------- number of vertices
def test_another_number_of_vertices():
    scene = make(tent=tent())
    picture(scene)
    more = torch.rand(6, 3, generator=torch.Generator().manual_seed(0))
    normals = scene.tent.vertex_normals
    scene.tent.vertex_positions = more
    assert scene.tent.vertex_normals is normals and normals.shape == (6, 3)
    scene.tent.faces = [[0, 1, 2], [3, 4, 5]]
    fresh = tr.Mesh(more, [[0, 1, 2], [3, 4, 5]])
    fresh.compute_normals()
    image = picture(scene)
    torch.testing.assert_close(image, picture(make(tent=fresh)))
    assert torch.equal(picture(copy.deepcopy(scene)), image)


def test_vertices_that_do_not_fit_are_refused():
    more = torch.rand(6, 3, generator=torch.Generator().manual_seed(0))
    for what, named in (
        ({"vertex_normals": TENT[0]}, r"6 vertices, but vertex_normals has 4 rows: assign vertex_normals = None first"),
        ({"vertex_texcoords": torch.zeros(4, 2)}, r"vertex_texcoords has 4 rows: assign vertex_texcoords = None first"),
        ({"attributes": {"vertex_color": torch.ones(4, 3)}}, r"vertex_color has 4 rows: .*scene\[NAME\] = Mesh"),
    ):
        scene = make(mesh=tr.Mesh(*TENT, **what))
        before, names = picture(scene), [n for n, _ in scene.named_parameters()]
        with pytest.raises(ValueError, match=r"Mesh\.vertex_positions: .*" + named):
            scene.mesh.vertex_positions = more
        assert torch.equal(picture(scene), before) and [n for n, _ in scene.named_parameters()] == names
    mesh = tr.Mesh(*TENT, vertex_normals=TENT[0], attributes={"face_color": torch.ones(2, 3)})
    with pytest.raises(ValueError, match=r"3 vertices, but faces has the index 3: assign faces"):
        mesh.vertex_positions = more[:3]
    with pytest.raises(ValueError, match="faces has the index"):
        mesh.vertex_positions = torch.zeros(0, 3)
    mesh.vertex_normals = None
    mesh.vertex_positions = more
    assert mesh.vertex_positions.shape == (6, 3)


# ---------------------------------------------------------------------------------------------- references and objects
def test_a_refused_edit_keeps_the_order():
    scene = make(zebra={"type": "disk"})
    names, before = list(scene), tr.render(scene, outputs=("shape_id",), seed=1).shape_id
    parameters = [n for n, _ in scene.named_parameters()]
    with pytest.raises(ValueError, match="no object with the id 'rde'"):
        scene["wall"] = {"type": "rectangle", "bsdf": {"type": "ref", "id": "rde"}}
    with pytest.raises(ValueError, match="reflectance"):
        scene.red.reflectance = 1.5
    with pytest.raises(ValueError, match="radius"):
        scene.ball.radius = float("nan")
    assert list(scene) == names and [n for n, _ in scene.named_parameters()] == parameters
    assert torch.equal(tr.render(scene, outputs=("shape_id",), seed=1).shape_id, before)


def test_references_survive_a_refused_scene():
    ball = tr.Sphere(bsdf={"type": "ref", "id": "late"})
    wall = tr.Rectangle(bsdf={"type": "ref", "id": "red"})
    with pytest.raises(ValueError, match="no object with the id 'late'"):
        make(ball=ball, wall=wall)
    scene = make(late={"type": "diffuse", "reflectance": 0.1}, ball=ball, wall=wall)
    assert scene.ball.bsdf is scene.late and scene.wall.bsdf is scene.red  # and not the refused scene's
    two = tr.TwoSided(front={"type": "ref", "id": "later"})
    with pytest.raises(ValueError, match="no object with the id 'later'"):
        scene["two"] = two
    scene["later"] = tr.Diffuse()
    scene["two"] = two
    assert scene.two.brdf_0 is scene.later


def test_references_are_not_assigned_to_attributes():
    scene = make(black={"type": "diffuse", "reflectance": 0.0})
    before = picture(scene)
    reference = {"type": "ref", "id": "black"}
    for value in (reference, {"type": "twosided", "inside": reference}, tr.TwoSided(inside=reference)):
        with pytest.raises(ValueError, match=r"Sphere\.bsdf: .* assign the object itself: scene\['black'\]"):
            scene.ball.bsdf = value
    assert torch.equal(picture(scene), before)
    scene.ball.bsdf = scene["black"]
    assert not torch.equal(picture(scene), before)
    # What is assigned later counts, not a reference from before that waits for its scene.
    ball = tr.Sphere(bsdf=reference)
    ball.bsdf = tr.Diffuse(reflectance=0.9)
    scene["ball"] = ball
    assert scene.ball.bsdf is not scene.black


# ------------------------------------------------------------------------------------------------------------- leaves
@pytest.mark.parametrize("what", ["leaf", "parameter", "parameter of another precision"])
def test_an_assigned_leaf_becomes_a_parameter(what):
    scene = make()
    names = [n for n, _ in scene.named_parameters()]
    value = torch.tensor([0.1, 0.2, 0.3], requires_grad=True)
    if what != "leaf":
        value = nn.Parameter(value.detach().to(torch.float32 if what == "parameter" else torch.float64))
    scene.red.reflectance.value = value
    assert [n for n, _ in scene.named_parameters()] == names and COLOUR in scene.state_dict()
    own = scene.get_parameter(COLOUR)
    assert own.requires_grad and own.dtype == torch.float32 and (own is value) == (what == "parameter")
    torch.testing.assert_close(own.detach(), value.detach().float())
    tr.render(scene, seed=1).sum().backward()
    assert bool((scene.red.reflectance.value.grad != 0).any())
    copy.deepcopy(scene)


def test_a_leaf_in_the_place_of_a_texture_becomes_a_parameter():
    scene = make()
    scene.red.reflectance = torch.tensor([0.1, 0.2, 0.3], requires_grad=True)
    scene.ball.bsdf.reflectance = torch.full((2, 2, 3), 0.5, requires_grad=True)
    assert scene.get_parameter(COLOUR).requires_grad
    assert scene.get_parameter("ball.bsdf.reflectance.data").requires_grad
    with pytest.raises(ValueError, match="result of a computation"):
        scene.red.reflectance.value = torch.rand(3, requires_grad=True) * 0.5
