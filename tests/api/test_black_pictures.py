"""Pictures without light say why."""

import pytest
from first_scene import make, objects, said

import torchrender as tr

BACK = {"type": "rectangle", "to_world": tr.Transform.rotate([0, 1, 0], 180)}
POINT = {"type": "point", "position": [0, 0, 3.0]}
BLACK = {
    "no light": ({"sky": None}, "the scene has no light"),
    "a light of no shape": ({"sky": None, "lamp": {"type": "area"}}, "lamp: this area light lights nothing"),
    "inside of a shape": ({"ball": {"type": "sphere", "center": [0, 0, 4.0]}}, "the camera is inside of 'ball'"),
    "inside of a mesh": (
        {"ball": {"type": "cube", "to_world": tr.Transform.translate([0, 0, 4.0])}},
        "the camera is inside of 'ball'",
    ),
    "backs": ({"ball": BACK, "sky": POINT}, r"surfaces that the camera sees \(ball\) turn their backs"),
    "nothing": ({"ball": {"type": "sphere", "center": [0, 0, 9.0]}, "sky": POINT}, "no ray of the camera meets"),
}


@pytest.mark.parametrize("name", BLACK)
def test_black_pictures_are_explained(name):
    more, text = BLACK[name]
    scene = tr.load_dict({k: v for k, v in objects(**more).items() if v is not None})
    with pytest.warns(UserWarning, match=text):
        image = tr.render(scene, spp=1, seed=0)
    assert not bool(image.any())
    assert said(scene) == []  # once


def test_pictures_of_one_pixel_that_sees_all():
    """Through its lens, somewhere in which it meets something, or nowhere."""
    camera = {"type": "distant", "direction": [0, 0, -1], "film": {"type": "hdrfilm", "width": 1, "height": 1}}
    for ball, text in ((BACK, r"surfaces that the camera sees \(ball\) turn their backs"), (None, "no ray")):
        given = objects(ball=ball, sky=POINT, camera=camera)
        scene = tr.load_dict({k: v for k, v in given.items() if v is not None})
        with pytest.warns(UserWarning, match=text):
            assert not bool(tr.render(scene, spp=1, seed=0).any())


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"ball": {**BACK, "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}}}},
        {"ball": {"type": "sphere", "radius": 9.0, "emitter": {"type": "area"}, "flip_normals": True}},
        {"sky": {"type": "constant", "radiance": 0.0}},  # black by wish
    ],
)
def test_other_pictures_are_not(more):
    assert said(make(**more)) == []


def test_outputs_need_no_light():
    scene = tr.load_dict({k: v for k, v in objects().items() if k != "sky"})
    assert said(scene, outputs=("depth", "normal")) == []
