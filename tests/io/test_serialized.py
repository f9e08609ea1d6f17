"""Mitsuba's serialized meshes, written here as the manual of 0.6 describes them."""

import struct
import zlib

import numpy as np
import pytest
import torch

import torchrender as tr
from torchrender.loaders.geometry import load_mesh

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
FACES = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
FLAGS = {"normals": 0x1, "texcoords": 0x2, "colours": 0x8}


def mesh(version=4, double=False, flat=False, points=POINTS, counts=None, **arrays):
    """One mesh: header and compressed stream."""
    flags = (0x2000 if double else 0x1000) | (0x10 if flat else 0) | sum(FLAGS[name] for name in arrays)
    real = "<f8" if double else "<f4"
    stream = struct.pack("<I", flags) + ("né".encode() + b"\0" if version == 4 else b"")
    stream += struct.pack("<QQ", *(counts or (len(points), len(FACES)))) + points.astype(real).tobytes()
    stream += b"".join(arrays[name].astype(real).tobytes() for name in FLAGS if name in arrays)
    return struct.pack("<HH", 0x041C, version) + zlib.compress(stream + FACES.astype("<u4").tobytes())


def write(path, *meshes, version=4):
    offsets = np.cumsum([0, *map(len, meshes)])[:-1]
    table = b"".join(struct.pack("<Q" if version == 4 else "<I", offset) for offset in offsets)
    path.write_bytes(b"".join(meshes) + table + struct.pack("<I", len(meshes)))
    return path


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("double", [False, True])
def test_every_array(tmp_path, version, double):
    arrays = {"normals": np.tile([0.0, 0, 2], (4, 1)), "texcoords": POINTS[:, :2] / 4, "colours": POINTS / 8}
    first = mesh(version, double, points=POINTS + 5)
    path = write(tmp_path / "a.serialized", first, mesh(version, double, **arrays), version=version)
    read = load_mesh(path, shape_index=1)
    assert read["vertices"].dtype == (torch.float64 if double else torch.float32)
    assert read["vertices"].tolist() == POINTS.tolist() and read["faces"].tolist() == FACES.tolist()
    assert read["vertex_normals"].tolist() == [[0, 0, 1]] * 4
    assert read["vertex_texcoords"].tolist() == (POINTS[:, :2] / 4).tolist()
    assert read["attributes"]["vertex_color"].tolist() == (POINTS / 8).tolist()
    other = load_mesh(path)
    assert other["vertices"].tolist() == (POINTS + 5).tolist() and other["vertex_normals"] is None


def test_shape(tmp_path):
    flat = mesh(flat=True, normals=np.tile([0.0, 0, 1], (4, 1)))
    write(tmp_path / "a.serialized", mesh(), flat)
    (tmp_path / "a.xml").write_text(
        '<scene version="3.0.0"><shape type="serialized" id="smooth"><string name="filename" value="a.serialized"/>'
        '<transform name="to_world"><scale value="2"/></transform></shape>'
        '<shape type="serialized" id="flat"><string name="filename" value="a.serialized"/>'
        '<integer name="shape_index" value="1"/><boolean name="flip_normals" value="true"/></shape></scene>'
    )
    scene = tr.load_file(tmp_path / "a.xml")
    assert scene.smooth.computed_normals and scene.smooth.vertex_positions.amax() == 2
    assert scene.flat.vertex_normals is None and scene.flat.flip_normals and scene.flat.faces.shape == (2, 3)
    with pytest.raises(ValueError, match=r"m: serialized has no parameter 'shape_indx'; did you mean 'shape_index'"):
        tr.load_dict({"type": "scene", "m": {"type": "serialized", "filename": "a", "shape_indx": 1}})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x1c\x04\x04", "truncated"),
        (b"PK\3\4" + bytes(20), "expected a serialized mesh of version 3 or 4"),
        (struct.pack("<HH", 0x041C, 5) + bytes(20), "version 3 or 4"),
        (mesh() + struct.pack("<QI", 0, 7), "claims to hold 7 meshes|lies at bytes"),
        (mesh() + struct.pack("<QI", 0, 0), "claims to hold 0 meshes"),
        (mesh() + struct.pack("<QI", 1 << 40, 1), "lies at bytes"),
        (mesh()[:-9] + struct.pack("<QI", 0, 1), "truncated"),
        (mesh()[:6] + b"\xff" * 60 + struct.pack("<QI", 0, 1), "decompress"),
        (mesh(counts=(1 << 31, 2)) + struct.pack("<QI", 0, 1), "cannot be in it"),
        (mesh(counts=(1 << 60, 2)) + struct.pack("<QI", 0, 1), "claims to have"),
        (mesh(counts=(4, 3)) + struct.pack("<QI", 0, 1), "truncated"),
        (mesh(counts=(3, 2)) + struct.pack("<QI", 0, 1), "vertex|truncated|not finite"),
        (mesh(points=POINTS * np.nan) + struct.pack("<QI", 0, 1), "not finite"),
    ],
)
def test_bad_files(tmp_path, content, message):
    (tmp_path / "a.serialized").write_bytes(content)
    with pytest.raises(ValueError, match=rf"a\.serialized.*({message})"):
        load_mesh(tmp_path / "a.serialized")


def test_index_out_of_range(tmp_path):
    path = write(tmp_path / "a.serialized", mesh(), mesh())
    with pytest.raises(ValueError, match="shape_index: the file has 2 meshes"):
        load_mesh(path, shape_index=2)
