"""`merge`, `batch` and `resources`: entries of a scene's dict that stand for other objects."""

import warnings

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


def test_merge():
    ball = {"type": "sphere", "radius": 0.5, "center": [-1, 0, 0]}
    red = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.1, 0.1]}}
    box = {"type": "cube", "to_world": T.translate([1, 0, 0]) @ T.scale(0.4), "bsdf": {"type": "ref", "id": "red"}}
    rest = {"cam": CAMERA, "sky": {"type": "constant"}, "red": red}
    scene, said = load(**rest, all={"type": "merge", "a": ball, "b": {"type": "merge", "c": {**box, "id": "crate"}}})
    assert said == [] and {"all_a", "crate"} <= set(scene) and "all" not in scene
    assert scene.crate.bsdf is scene.red
    assert torch.equal(image(scene), image(load(**rest, all_a=ball, crate=box)[0]))
    alone, _ = load(all={"type": "merge", "a": ball})
    assert alone.all.type == "sphere"
    group, _ = load(
        group={"type": "shapegroup", "m": {"type": "merge", "a": ball, "b": {"type": "cube"}}},
        one={"type": "instance", "g": {"type": "ref", "id": "group"}},
    )
    assert set(group) == {"one_m_a", "one_m_b"}


@pytest.mark.parametrize(
    ("merge", "message"),
    [
        ({}, "m: the merge is empty"),
        ({"a": {"type": "diffuse"}}, "m.a: a merge holds shapes, got"),
        ({"a": 3}, "m.a: a merge holds shapes, got 3"),
        ({"a": {"type": "ref", "id": "b"}}, "m.a: .* no reference"),
        ({"a": {"type": "sphere", "id": "s"}, "b": {"type": "sphere", "id": "s"}}, "m.b: two objects have the id 's'"),
        ({"a": {"type": "sphere", "id": "ball"}}, "m: two objects have the id 'ball'"),
    ],
)
def test_what_a_merge_cannot_hold(merge, message):
    with pytest.raises(ValueError, match=message):
        load(ball={"type": "sphere"}, m={"type": "merge", **merge})
    with pytest.raises(ValueError, match="a merge stands at the top of the dict"):
        tr.load_dict({"type": "merge", "a": {"type": "sphere"}})


def test_batch():
    views = {
        "a": {"type": "perspective", "to_world": T.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])},
        "b": {"type": "perspective", "to_world": T.look_at([5, 0, 0], [0, 0, 0], [0, 1, 0])},
    }
    film = {"type": "hdrfilm", "width": 16, "height": 6, "rf": {"type": "box"}}
    sampler = {"type": "independent", "sample_count": 3}
    scene, said = load(cam={"type": "batch", **views, "film": film, "s": sampler}, sky={"type": "constant"})
    assert len(said) == 1 and said[0].startswith("cam: 'batch' becomes the cameras 'cam_a', 'cam_b' of the scene")
    assert [(c.film.height, c.film.width, c.film.filter.type) for c in scene.sensors] == [(6, 8, "box")] * 2
    assert [c.sampler.sample_count for c in scene.sensors] == [3, 3]
    assert image(scene, sensor=range(2)).shape == (2, 6, 8, 3)
    objects = {"film": tr.Film(16, 6), "s": tr.Sampler(3), "shutter_close": 1.0}
    assert [c.film for c in load(cam={"type": "batch", **views, **objects})[0].sensors] == [tr.Film(8, 6)] * 2
    spectral = {"type": "batch", **views, "film": {**film, "type": "specfilm"}}
    scene, said = load("substitute", cam=spectral)
    assert [c.film.width for c in scene.sensors] == [8, 8] and "cam_a.film: 'specfilm'" in said[1]
    for wrong, message in (
        ({"film": film}, "cam: the batch holds no camera"),
        ({**views, "film": {**film, "width": 15}}, r"cam\.film: a batch has columns for all 2 cameras"),
        ({**views, "x": {"type": "sphere"}}, "cam.x: a batch holds cameras as dicts, a film and a sampler"),
    ):
        with pytest.raises(ValueError, match=message):
            load(cam={"type": "batch", **wrong})


def test_resources(tmp_path):
    for name, value in (("one", 0.25), ("two", 0.75)):
        (tmp_path / name).mkdir()
        tr.io.write_image(tmp_path / name / "t.exr", torch.full((2, 2, 3), value))
    bsdf = {"type": "diffuse", "reflectance": {"type": "bitmap", "filename": "t.exr"}}
    folders = {n: {"type": "resources", "path": str(tmp_path / n)} for n in ("one", "two")}
    scene, said = load(**folders, ball={"type": "sphere", "bsdf": bsdf})
    assert said == [] and set(scene) == {"ball"}
    assert float(scene.ball.bsdf.reflectance.data[0, 0, 0]) == 0.75  # the one that was added last
    with pytest.raises(ValueError, match=r"r\.path: no such folder"):
        load(r={"type": "resources", "path": str(tmp_path / "three")})
    with pytest.raises(ValueError, match="r: resources has no parameter 'folder'"):
        load(r={"type": "resources", "folder": "."})


def test_resources_of_a_file_lead_nowhere_else(tmp_path):
    (tmp_path / "scene").mkdir()
    tr.io.write_image(tmp_path / "t.exr", torch.ones(2, 2, 3))
    (tmp_path / "scene" / "a.xml").write_text(
        '<scene version="3.0.0"><texture type="resources"><string name="path" value=".."/></texture>'
        '<texture type="bitmap"><string name="filename" value="t.exr"/></texture></scene>'
    )
    with pytest.raises(FileNotFoundError, match=r"no such file: 't\.exr'"):
        tr.load_file(tmp_path / "scene" / "a.xml")
