"""OBJ files with materials as people write them, and files that they name."""

import json
import warnings

import numpy as np
import pytest
import torch
from PIL import Image

import torchrender as tr
from torchrender.image import srgb_to_linear
from torchrender.loaders.geometry import load_scene

pytestmark = pytest.mark.core

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACE = "usemtl m\nf 1/1 2/2 3/3 4/4\n"
RED = [200, 50, 50]


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "model" / "tex"
    made.mkdir(parents=True)
    Image.fromarray(np.full((4, 4, 3), RED, np.uint8)).save(made / "red wall.png")
    Image.fromarray(np.full((4, 4), 30000, np.uint16)).save(made / "grey16.png")
    (tmp_path / "model" / "bad.png").write_bytes(b"nothing")
    Image.fromarray(np.full((4, 4, 3), RED, np.uint8)).save(tmp_path / "outside.png")
    return tmp_path / "model"


def load(folder, materials, text="mtllib a.mtl\n" + SQUARE + FACE, **more):
    """The BSDF of the only mesh, and the texts of the warnings."""
    if materials is not None:
        (folder / "a.mtl").write_text(materials)
    (folder / "a.obj").write_text(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", tr.SubstitutionWarning)
        scene = load_scene(folder / "a.obj", **more)
    assert len(tr.load_dict(scene).sensors) == 1
    meshes = [v for v in scene.values() if isinstance(v, dict) and v["type"] == "mesh"]
    assert len(meshes) == 1
    bsdf = meshes[0]["bsdf"]
    said = [str(w.message).partition("a.obj: ")[2] for w in caught if w.category is tr.SubstitutionWarning]
    return (scene[bsdf["id"]] if bsdf["type"] == "ref" else bsdf), said


def colour(bsdf):
    reflectance = bsdf["bsdf"]["reflectance"]
    return reflectance["value"] if reflectance["type"] == "rgb" else reflectance["data"][0, 0].tolist()


@pytest.mark.parametrize(
    ("statement", "warning"),
    [
        ("map_Kd tex/red wall.png", None),
        ("\tmap_Kd\ttex\\red wall.png", None),
        ("map_Kd C:\\somewhere\\tex\\red wall.png", None),  # a file beside the model
        ("map_Kd -s 2 2 1 -o 0.5 -clamp on tex/red wall.png", "not used of its materials: m: map_Kd -s, m: map_Kd -o"),
        ("Kd 0.1 0.1 0.1\nmap_Kd tex/red wall.png\nmap_Bump -bm 0.5 tex/red wall.png", "m: map_bump"),
    ],
)
def test_textures(folder, statement, warning):
    (folder / "red wall.png").write_bytes((folder / "tex" / "red wall.png").read_bytes())
    bsdf, said = load(folder, f"newmtl m\n{statement}\n")
    expected = srgb_to_linear(torch.tensor(RED) / 255)
    assert colour(bsdf) == pytest.approx(expected.tolist(), abs=1e-6)
    assert said == [] if warning is None else (len(said) == 1 and warning in said[0])


def test_sixteen_bits(folder):
    bsdf, said = load(folder, "newmtl m\nmap_Kd tex/grey16.png\n")
    assert not said and colour(bsdf) == pytest.approx([float(srgb_to_linear(torch.tensor(30000 / 65535)))] * 3)


@pytest.mark.parametrize("name", ["nowhere.png", "bad.png", "../outside.png"])
def test_textures_that_cannot_be_read_are_named(folder, name):
    bsdf, said = load(folder, f"newmtl m\nKd 0.1 0.2 0.3\nmap_Kd {name}\n")
    assert colour(bsdf) == pytest.approx([0.1, 0.2, 0.3])
    assert said == [f"not used of its materials: m: map_Kd {name} (it cannot be read)"]


def test_trusted_files_may_name_files_elsewhere(folder):
    bsdf, said = load(folder, "newmtl m\nmap_Kd ../outside.png\n", trusted=True)
    assert not said and bsdf["bsdf"]["reflectance"]["type"] == "bitmap"


@pytest.mark.parametrize(
    ("statements", "expected"),
    [
        ("Kd 0.25", [0.25] * 3),
        ("Kd 0.1 0.2 0.3 # red", [0.1, 0.2, 0.3]),
        ("KD 0.1 0.2 0.3\nNs 100\nillum 2\nd 1.0", [0.1, 0.2, 0.3]),
    ],
)
def test_colours(folder, statements, expected):
    bsdf, said = load(folder, f"# by hand\n\n\tnewmtl m\n{statements}\n")
    assert not said and bsdf["type"] == "twosided" and colour(bsdf) == pytest.approx(expected)


@pytest.mark.parametrize(("statement", "opacity"), [("d 0.25", 0.25), ("Tr 0.25", 0.75), ("d 0.5\nTr 1", 0.5)])
def test_opacity(folder, statement, opacity):
    bsdf, said = load(folder, f"newmtl m\nKd 0.1 0.2 0.3\n{statement}\n")
    assert not said and bsdf["type"] == "mask" and bsdf["opacity"] == opacity
    assert colour(bsdf["bsdf"]) == pytest.approx([0.1, 0.2, 0.3])


def test_more_than_one_library_and_none(folder):
    (folder / "b c.mtl").write_text("newmtl m\nKd 0 1 0\n")
    (folder / "d.mtl").write_text("newmtl m\nKd 0 0 1\n")
    text = SQUARE + FACE
    assert colour(load(folder, "newmtl o\n", "mtllib a.mtl\nmtllib b c.mtl\n" + text)[0]) == [0, 1, 0]
    assert colour(load(folder, "newmtl o\n", "mtllib a.mtl d.mtl\n" + text)[0]) == [0, 0, 1]
    bsdf, said = load(folder, None, "mtllib nowhere.mtl\n" + text)
    assert colour(bsdf) == [0.5] * 3
    assert said == ["the materials 'nowhere.mtl' cannot be read", "no material is called 'm': grey"]


def test_tabs_comments_and_lines_that_go_on(folder):
    text = "mtllib a.mtl\n" + (SQUARE + FACE).replace(" ", "\t") + "usemtl m # the same\nf 1 2 \\\n3 # here\n"
    (folder / "a.obj").write_text(text.replace("f\t1/1", "f\t1/1\\\n").replace("v\t1\t0\t0", "v\t1\t0\t0 # corner"))
    (folder / "a.mtl").write_text("newmtl m\nKd 0 1 0\n")
    scene = load_scene(folder / "a.obj")
    meshes = [v for v in scene.values() if isinstance(v, dict) and v["type"] == "mesh"]
    assert sum(len(mesh["faces"]) for mesh in meshes) == 3
    assert {mesh["bsdf"]["id"] for mesh in meshes} == {"m"} and colour(scene["m"]) == [0, 1, 0]


def test_gltf_names_are_percent_encoded(tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    (tmp_path / "my data.bin").write_bytes(points)
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"uri": "my%20data.bin", "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    }
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    assert len(tr.load_file(tmp_path / "a.gltf").sensors) == 1
    (tmp_path / "in").mkdir()
    document["buffers"][0]["uri"] = "../my%20data.bin"
    (tmp_path / "in" / "a.gltf").write_text(json.dumps(document))
    with pytest.raises(ValueError, match=r"outside of the folder of .*a\.gltf"):
        tr.load_file(tmp_path / "in" / "a.gltf")
    assert len(tr.load_file(tmp_path / "in" / "a.gltf", trusted=True).sensors) == 1
