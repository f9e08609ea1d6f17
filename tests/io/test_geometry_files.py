"""Geometry from PLY, OBJ, glTF and STL files, and trimesh objects."""

import struct

import numpy as np
import pytest
import torch
import trimesh

from torchrender.loaders.geometry import from_trimesh, load_mesh, load_scene
from torchrender.scene import registry

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)


def ply_text(vertex=(), face=(), faces=("3 0 1 2", "3 0 2 3"), rows="", face_rows=""):
    """An ascii file with the unit square; `vertex` and `face` are further properties, rows their values."""
    lines = ["ply", "format ascii 1.0", "comment made for a test", "element vertex 4"]
    lines += [f"property float {c}" for c in "xyz"] + [f"property {p}" for p in vertex]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", *[f"property {p}" for p in face]]
    lines += ["end_header", *[f"{x:g} {y:g} {z:g} {rows}" for x, y, z in SQUARE], *[f"{f} {face_rows}" for f in faces]]
    return "\n".join(lines) + "\n"


def ply_binary(endian, face_data, count=2):
    """A binary file with normals and texture coordinates."""
    order = {"<": "binary_little_endian", ">": "binary_big_endian"}[endian]
    names = ["x", "y", "z", "nx", "ny", "nz", "u", "v"]
    header = ["ply", f"format {order} 1.0", "element vertex 4", *[f"property float {n}" for n in names]]
    header += [f"element face {count}", "property list uchar uint vertex_index", "end_header", ""]
    rows = b"".join(struct.pack(endian + "8f", *p, 0, 0, 2, p[0], p[1] / 4) for p in SQUARE.tolist())
    return "\n".join(header).encode() + rows + face_data


@pytest.mark.parametrize("endian", ["<", ">"])
def test_binary_ply(tmp_path, endian):
    faces = struct.pack(endian + "B3IB3I", 3, 0, 1, 2, 3, 0, 2, 3)
    (tmp_path / "a.ply").write_bytes(ply_binary(endian, faces))
    mesh = load_mesh(tmp_path / "a.ply")
    assert torch.equal(mesh["vertices"], torch.from_numpy(SQUARE)) and mesh["vertices"].dtype == torch.float32
    assert mesh["faces"].tolist() == [[0, 1, 2], [0, 2, 3]] and mesh["faces"].dtype == torch.int32
    assert mesh["vertex_normals"].tolist() == [[0, 0, 1]] * 4
    assert mesh["vertex_texcoords"].tolist() == [[0, 0], [1, 0], [1, 0.25], [0, 0.25]]
    flipped = load_mesh(tmp_path / "a.ply", flip_tex_coords=True, face_normals=True)
    assert flipped["vertex_texcoords"].tolist() == [[0, 1], [1, 1], [1, 0.75], [0, 0.75]]
    assert flipped["vertex_normals"] is None


@pytest.mark.parametrize("endian", ["<", ">"])
def test_binary_ply_with_mixed_polygons(tmp_path, endian):
    faces = struct.pack(endian + "B3IB4I", 3, 0, 1, 2, 4, 0, 1, 2, 3)
    (tmp_path / "a.ply").write_bytes(ply_binary(endian, faces))
    assert load_mesh(tmp_path / "a.ply")["faces"].tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]


def test_ply_attributes(tmp_path):
    properties = [
        "uchar red",
        "uchar green",
        "uchar blue",
        "float heat",
        "float flow_x",
        "float flow_y",
        "float flow_z",
    ]
    text = ply_text(
        [*properties, "float s", "float t"], ["float r", "float g", "float b"], rows="255 51 0 7 1 2 3 .25 .75",
        faces=("4 0 1 2 3", "3 0 2 3"), face_rows=".1 .2 .3",
    )  # fmt: skip
    (tmp_path / "a.ply").write_text(text)
    mesh = load_mesh(tmp_path / "a.ply")
    assert mesh["vertex_texcoords"].tolist() == [[0.25, 0.75]] * 4 and mesh["vertex_normals"] is None
    attributes = mesh["attributes"]
    assert set(attributes) == {"vertex_color", "vertex_heat", "vertex_flow", "face_color"}
    assert torch.allclose(attributes["vertex_color"].float(), torch.tensor([1.0, 0.2, 0.0]).expand(4, 3))
    assert attributes["vertex_heat"].tolist() == [[7]] * 4 and attributes["vertex_flow"].tolist() == [[1, 2, 3]] * 4
    # The quad became two triangles, which keep its colour.
    assert torch.allclose(attributes["face_color"], torch.tensor([0.1, 0.2, 0.3]).expand(3, 3))
    (tmp_path / "b.ply").write_text(ply_text(["float a_0", "float a_1"], rows="1 2"))
    with pytest.warns(UserWarning, match="vertex_a has 2 components"):
        assert load_mesh(tmp_path / "b.ply")["attributes"] == {}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"hello", "not a PLY file"),
        (b"ply\nformat ascii 1.0\nelement vert", "truncated"),
        (ply_text().replace("float y", "quad y").encode(), "means nothing: 'property quad y'"),
        (ply_text().replace("float y", "float x").encode(), "twice"),
        (ply_text()[:-12].encode(), "truncated"),
        (ply_text().replace("1 1 0", "1 one 0").encode(), "no number"),
        (ply_text(faces=("3 0 1 7",)).encode(), "vertex 7, but there are 4"),
        (ply_text(faces=("3 0 1 -1",)).encode(), "vertex -1"),
        (ply_text(faces=("2 0 1",)).encode(), "face 0 has 2 corners"),
        (ply_text(faces=()).encode(), "4 vertices, 0 faces"),
        (ply_text().replace("1 1 0", "1 nan 0").encode(), "not finite"),
        (ply_binary("<", struct.pack("<B3IB2I", 3, 0, 1, 2, 3, 0, 2)), "truncated"),
        (ply_binary("<", struct.pack("<B3IB2I", 255, 0, 1, 2, 3, 0, 2)), "truncated|claims"),
        (ply_binary("<", b"")[:-40], "truncated"),
    ],
)
def test_bad_ply(tmp_path, content, message):
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        load_mesh(tmp_path / "a.ply")
    assert "a.ply" in str(caught.value)


OBJ = """# corners that differ in texture coordinates are different vertices
mtllib a.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0.25
vn 0 0 2
usemtl red
f 1/1/1 2/2/1 3/2/1 4/1/1
g other
f -4/1/1 -2/2/1 \\
  -1/2/1
"""


def test_obj(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ)
    mesh = load_mesh(tmp_path / "a.obj")
    assert mesh["vertices"].tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 0]]
    assert mesh["faces"].tolist() == [[0, 1, 2], [0, 2, 3], [0, 2, 4]]
    assert mesh["vertex_texcoords"].tolist() == [[0, 1], [1, 0.75], [1, 0.75], [0, 1], [1, 0.75]]
    assert mesh["vertex_normals"].tolist() == [[0, 0, 1]] * 5
    kept = load_mesh(tmp_path / "a.obj", flip_tex_coords=False)
    assert kept["vertex_texcoords"].tolist() == [[0, 0], [1, 0.25], [1, 0.25], [0, 0], [1, 0.25]]
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n")
    plain = load_mesh(tmp_path / "b.obj")
    assert plain["vertex_normals"] is None and plain["vertex_texcoords"] is None and plain["attributes"] == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\n", "no faces"),
        ("v 0 0 0\nf 1 2 3\n", r"line 2: index 2 is out of the 1 entries"),
        ("v 0 0 0\nf 0 1 1\n", r"line 2: index 0"),
        ("v 0 zero 0\n", r"line 1: .*zero"),
        ("v 0 0\n", r"line 1: expected 3 numbers"),
        ("v 0 0 0\nf 1 1\n", r"line 2: a face needs three corners"),
        ("v 0 0 0\nf 1/1/1/1 1 1\n", r"line 2: a corner is"),
        ("v 0 0 0\n\0\0", "binary"),
    ],
)
def test_bad_obj(tmp_path, text, message):
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(ValueError, match=message):
        load_mesh(tmp_path / "a.obj")


def test_missing_and_unknown_files(tmp_path):
    for load in (load_mesh, load_scene):
        with pytest.raises(FileNotFoundError, match=r"nothing\.ply"):
            load(tmp_path / "nothing.ply")
    (tmp_path / "a.xyzw").write_text("hello")
    with pytest.raises(ValueError, match=r"a\.xyzw"):
        load_scene(tmp_path / "a.xyzw")
    with pytest.raises(ValueError, match=r"\.ply, \.obj or \.serialized"):
        load_mesh(tmp_path / "a.xyzw")
    (tmp_path / "empty.obj").write_text("# nothing")
    with pytest.raises(ValueError, match="no triangles"):
        load_scene(tmp_path / "empty.obj")
    trimesh.creation.box().export(tmp_path / "a.glb")
    content = (tmp_path / "a.glb").read_bytes()
    (tmp_path / "a.glb").write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match=r"a\.glb"):
        load_scene(tmp_path / "a.glb")
    with pytest.raises(TypeError, match="int"):
        from_trimesh(3)


def sees_everything(scene, points):
    """Whether all points are in the view of the scene's camera, with x and y at most 1 after projection."""
    sensor = scene["sensor"]
    local = np.linalg.inv(sensor["to_world"]) @ np.concatenate([points, np.ones((len(points), 1))], axis=1).T
    tangent = np.abs(local[:2] / local[2]).max() / np.tan(np.radians(sensor["fov"] / 2))
    depth = (local[2].min() > sensor["near_clip"]) and (local[2].max() < sensor["far_clip"])
    return depth and 0.4 < tangent < 1


def test_gltf_scene(tmp_path, monkeypatch):
    from PIL import Image

    known = registry.scene_types()  # as where there is no better material than a diffuse one
    monkeypatch.setattr(registry, "scene_types", lambda: {k: c for k, c in known.items() if k != "principled"})

    picture = Image.fromarray(np.full((2, 2, 3), 188, np.uint8))
    material = trimesh.visual.material.PBRMaterial(
        name="Mat.001", baseColorFactor=[0.2, 0.4, 0.6, 1.0], baseColorTexture=picture, emissiveFactor=[1, 0.5, 0]
    )
    uv = np.linspace(0, 1, 16).reshape(8, 2)
    boxes = [trimesh.creation.box() for _ in range(2)]
    for box in boxes:
        box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    source = trimesh.Scene()
    source.add_geometry(boxes[0], node_name="Box.001", transform=trimesh.transformations.translation_matrix([9, 2, 3]))
    source.add_geometry(boxes[1], node_name="Box.002")
    source.add_geometry(trimesh.creation.icosphere(subdivisions=1), node_name="ball")
    source.export(tmp_path / "a.glb")
    scene = load_scene(tmp_path / "a.glb")
    shapes = {key: value for key, value in scene.items() if isinstance(value, dict) and value["type"] == "mesh"}
    assert set(shapes) == {"Box_001", "Box_002", "ball"}
    box = shapes["Box_001"]
    assert box["vertices"].shape == (8, 3) and box["faces"].shape == (12, 3)
    assert np.allclose(box["to_world"][:3, 3], [9, 2, 3])
    assert np.allclose(box["vertex_texcoords"], uv * [1, -1] + [0, 1], atol=1e-6)
    assert box["emitter"]["radiance"]["value"] == [1, 0.5, 0] and "light" not in scene
    assert box["bsdf"]["type"] == "ref"
    texture = scene[box["bsdf"]["id"]]["bsdf"]["reflectance"]
    # 188 / 255 decodes to 0.50289, times the factor
    assert torch.allclose(texture["data"], torch.tensor([0.2, 0.4, 0.6]).mul(0.50289).expand(2, 2, 3), atol=1e-4)
    assert shapes["ball"]["bsdf"]["bsdf"]["reflectance"]["value"] == [0.5, 0.5, 0.5]
    points = np.concatenate([np.add(boxes[0].vertices, [9, 2, 3]), boxes[1].vertices])
    assert sees_everything(scene, points)


def test_obj_scene_with_materials(tmp_path):
    from PIL import Image

    (tmp_path / "a.obj").write_text(OBJ.replace("g other", "usemtl tex"))
    (tmp_path / "a.mtl").write_text(
        "newmtl red\nKd 0.8 0.1 0.1\nKe 3 2 0\nnewmtl tex\nKd 0.8 0.8 0.8\nmap_Kd tex.png\n"
    )
    Image.fromarray(np.full((4, 4, 3), 255, np.uint8)).save(tmp_path / "tex.png")
    scene = load_scene(tmp_path / "a.obj")
    reflectances = [v["bsdf"]["reflectance"] for v in scene.values() if isinstance(v, dict) and v["type"] == "twosided"]
    values = [r["value"] for r in reflectances if r["type"] == "rgb"]
    assert np.allclose(values, [[0.8, 0.1, 0.1]])
    bitmaps = [r["data"] for r in reflectances if r["type"] == "bitmap"]
    assert len(bitmaps) == 1 and torch.equal(bitmaps[0], torch.ones(4, 4, 3))
    shapes = [v for v in scene.values() if isinstance(v, dict) and v["type"] == "mesh"]
    assert len(shapes) == 2 and all(np.allclose(s["vertex_normals"], [0, 0, 1]) for s in shapes)
    emitters = [s["emitter"]["radiance"]["value"] for s in shapes if "emitter" in s]
    assert emitters == [[3, 2, 0]] and "light" not in scene


def test_ply_and_stl_scenes_and_vertex_colours(tmp_path):
    (tmp_path / "a.ply").write_text(ply_text(["float r", "float g", "float b"], rows=".1 .2 .3"))
    scene = load_scene(tmp_path / "a.ply")
    assert scene["a"]["bsdf"]["bsdf"]["reflectance"] == {"type": "mesh_attribute", "name": "vertex_color"}
    assert scene["a"]["attributes"]["vertex_color"].shape == (4, 3) and sees_everything(scene, SQUARE)
    trimesh.creation.box().export(tmp_path / "b.stl")
    shape = next(v for v in load_scene(tmp_path / "b.stl").values() if isinstance(v, dict) and v["type"] == "mesh")
    assert shape["faces"].shape == (12, 3) and "vertex_normals" not in shape
    box = trimesh.creation.box()
    box.visual.face_colors = np.tile(np.array([[255, 51, 0, 255]], np.uint8), (12, 1))
    shape = next(v for v in from_trimesh(box).values() if isinstance(v, dict) and v["type"] == "mesh")
    assert torch.allclose(shape["attributes"]["face_color"], torch.tensor([1, 0.2, 0]).double().expand(12, 3))


def test_camera_of_a_trimesh_scene():
    source = trimesh.Scene(trimesh.creation.box())
    source.camera.resolution, source.camera.fov = (320, 200), (50, 40)
    source.set_camera(angles=(0, 0, 0), distance=5)
    sensor = from_trimesh(source)["sensor"]
    assert (sensor["film"]["width"], sensor["film"]["height"]) == (320, 200) and sensor["fov"] == source.camera.fov[0]
    # At distance 5 on the z axis, looking at the origin along -z, x to the right (so +x of the camera is -x).
    assert np.allclose(sensor["to_world"][:3, :3], np.diag([-1, 1, -1])) and sensor["to_world"][2, 3] > 4
