"""Damaged files of every kind end in a ValueError or OSError that names the file, with bounded memory and time.

Each file is cut off, gets single bits turned over, and numbers overwritten by the largest, the smallest and zero. The
seeds are fixed. What is read nevertheless may be anything: single bits of pixels do not show.
"""

import resource
import struct
import time
import warnings
import zlib

import numpy as np
import pytest
import torch
import trimesh

import torchrender as tr
from torchrender.io import read_channels, read_image, read_parts, read_volume, write_image, write_parts, write_volume
from torchrender.loaders.geometry import load_mesh, load_scene
from torchrender.loaders.ply import write_ply
from torchrender.loaders.xml import parse

MEMORY = 1 << 31  # bytes of address space that reading a damaged file of a few KB may take
SECONDS = 10.0  # of processor time, for one file; each takes milliseconds
POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
XML = """<scene version="3.0.0"><default name="spp" value="4"/><integrator type="path"/>
<bsdf type="diffuse" id="red"><rgb name="reflectance" value="0.5, 0.1, 0.1"/></bsdf>
<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world"><translate z="4"/>
<lookat origin="0,0,4" target="0,0,0" up="0,1,0"/><rotate y="1" angle="20"/><matrix value="1 0 0 0 1 0 0 0 1"/>
</transform><film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="8"/></film>
<sampler type="independent"><integer name="sample_count" value="$spp"/></sampler></sensor>
<shape type="sphere"><ref id="red"/><boolean name="flip_normals" value="true"/></shape>
<emitter type="point"><spectrum name="intensity" value="400:1, 700:2"/></emitter></scene>"""
OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\nusemtl red\nf 1/1/1 2/2/1 3/1/1\nf -1 -2 -3\n"
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
PLY += "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n"


def picture(height=9, width=13, channels=3):
    return torch.rand(height, width, channels, generator=torch.Generator().manual_seed(channels))


def serialized(path):
    stream = struct.pack("<IBQQ", 0x1000, 0, 4, 2) + POINTS.tobytes() + FACES.tobytes()
    path.write_bytes(struct.pack("<HH", 0x041C, 4) + zlib.compress(stream) + struct.pack("<QI", 0, 1))


def ragged(path):
    head = (
        "ply\nformat binary_big_endian 1.0\nelement face 2\nproperty list uchar uint vertex_index\nelement vertex 4\n"
    )
    head += "property float x\nproperty float y\nproperty double z\nend_header\n"
    rows = b"".join(struct.pack(">ffd", *row) for row in POINTS.tolist())
    path.write_bytes(head.encode() + struct.pack(">B3IB4I", 3, 0, 1, 2, 4, 0, 1, 2, 3) + rows)


def gltf(path):
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2], material=trimesh.visual.material.PBRMaterial())
    box.export(path)


def colmap(path):
    """Both files of a reconstruction, of which one is to be damaged."""
    cameras = struct.pack("<QIiQQ4d", 1, 1, 1, 30, 40, 50, 45, 14, 18)
    image = struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0.1, -0.2, 3, 1) + b"a.jpg\0" + struct.pack("<QddQ", 1, 1.5, 2.5, 7)
    (path.parent / "cameras.bin").write_bytes(cameras)
    (path.parent / "images.bin").write_bytes(image)


def load_folder(path):
    return tr.load_colmap(path.parent)


# kind -> (name of the file, function that writes it, function that reads it)
KINDS = {
    "exr": ("a.exr", lambda p: write_image(p, picture()), read_image),
    "exr channels": ("a.exr", lambda p: write_image(p, {"": picture(), "z": picture(channels=1)}), read_channels),
    "exr parts": ("a.exr", lambda p: write_parts(p, {"a": picture(), "b": picture(5, 4, 1)}), read_parts),
    "hdr": ("a.hdr", lambda p: write_image(p, picture()), read_image),
    "pfm": ("a.pfm", lambda p: write_image(p, picture()), read_image),
    "png": ("a.png", lambda p: write_image(p, picture(channels=4)), read_image),
    "png 16": ("a.png", lambda p: write_image(p, picture(), bits=16), read_image),
    "jpeg": ("a.jpg", lambda p: write_image(p, picture()), read_image),
    "vol": ("a.vol", lambda p: write_volume(p, torch.rand(2, 3, 4, 1)), read_volume),
    "npy": ("a.npy", lambda p: write_volume(p, torch.rand(2, 3, 4, 1)), read_volume),
    "ply": ("a.ply", lambda p: write_ply(p, POINTS, FACES, normals=POINTS + 1, texcoords=POINTS[:, :2],
                                         attributes={"face_color": np.ones((2, 3), np.float32)}), load_mesh),
    "ply text": ("a.ply", lambda p: p.write_text(PLY), load_mesh),
    "ply ragged": ("a.ply", ragged, load_mesh),
    "obj": ("a.obj", lambda p: p.write_text(OBJ), load_mesh),
    "serialized": ("a.serialized", serialized, load_mesh),
    "xml": ("a.xml", lambda p: p.write_text(XML), tr.load_file),
    "xml tree": ("a.xml", lambda p: p.write_text(XML), parse),
    "spectrum": ("a.spd", lambda p: p.write_text("400 0.1\n500 0.2\n700 0.9\n"),
                 lambda p: tr.load_dict({"type": "diffuse", "reflectance": {"type": "spectrum", "filename": str(p)}})),
    "obj scene": ("a.obj", lambda p: p.write_text(OBJ), load_scene),
    "glb": ("a.glb", gltf, load_scene),
    "colmap cameras": ("cameras.bin", colmap, load_folder),
    "colmap images": ("images.bin", colmap, load_folder),
    "stl": ("a.stl", lambda p: trimesh.creation.box().export(p), load_scene),
}  # fmt: skip


def damaged(content, rng):
    """Variants of a file."""
    places = {0, 1, 2, 3, 4, 7, 8, 12, len(content) - 1, *rng.integers(0, len(content), 20).tolist()}
    for place in sorted(p for p in places if 0 <= p < len(content)):
        yield content[:place]
    for _ in range(60):
        changed = bytearray(content)
        for place in rng.integers(0, len(content), rng.integers(1, 4)):
            changed[place] ^= 1 << int(rng.integers(8))
        yield bytes(changed)
    for number in (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0", b"\0\0\0\x80", b"99999999", b"-1", b"1e999"):
        for place in rng.integers(0, min(len(content), 600), 12).tolist():
            yield content[:place] + number + content[place + len(number) :]
    for _ in range(10):  # a piece twice, or left out
        low, high = sorted(rng.integers(0, len(content), 2).tolist())
        yield content[:high] + content[low:]
        yield content[:low] + content[high:]


@pytest.fixture
def bounded_memory():
    """Allocations beyond the limit fail."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files(tmp_path, kind, bounded_memory):
    name, write, read = KINDS[kind]
    write(tmp_path / name)
    content = (tmp_path / name).read_bytes()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read(tmp_path / name)  # whole, it is accepted
        refused = 0
        for variant in damaged(content, np.random.default_rng(sorted(KINDS).index(kind))):
            (tmp_path / name).write_bytes(variant)
            start = time.process_time()
            try:
                read(tmp_path / name)
            except (ValueError, OSError) as error:
                assert name in str(error)
                refused += 1
            assert time.process_time() - start < SECONDS
    assert refused > 20
