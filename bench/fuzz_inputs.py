"""What `bench.fuzz` feeds to the loaders: small good files of every kind, and damaged ones that are made of them.

A damaged file is a function of its kind and number: bits are turned over, numbers overwritten by extreme ones, pieces
left out, repeated, exchanged between files of the same kind, and words of text files replaced by others.
"""

from __future__ import annotations

import copy
import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchrender as tr
from torchrender.io import read_channels, read_image, read_parts, read_volume, write_image, write_parts, write_volume
from torchrender.loaders.geometry import load_mesh, load_scene
from torchrender.loaders.ply import write_ply
from torchrender.loaders.xml import parse

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
MTL = "newmtl red\nKd 0.5 0.1 0.1\nKe 0 0 0\nd 1\nmap_Kd -s 1 1 1 -o 0 0 a.png\nnewmtl blue\nKd 0.1\nNs 10\nillum 2\n"
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
PLY += "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n"
COLMAP = {
    "cameras.txt": "# cameras\n1 PINHOLE 30 40 50 45 14 18\n2 OPENCV 30 40 50 45 14 18 0.1 0.01 0 0\n",
    "images.txt": "1 1 0 0 0 0.1 -0.2 3 1 a.jpg\n1.5 2.5 7\n2 1 0 0 0 0.1 -0.2 3 2 b.jpg\n\n",
}
DICT: dict[str, Any] = {
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 4},
    "camera": {
        "type": "perspective",
        "fov": 40.0,
        "to_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]],
        "film": {"type": "hdrfilm", "width": 16, "height": 8, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": 4},
    },
    "red": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.1, 0.1]}},
    "ball": {"type": "sphere", "center": [0, 0, 0], "radius": 1.0, "bsdf": {"type": "ref", "id": "red"}},
    "floor": {
        "type": "rectangle",
        "bsdf": {"type": "roughconductor", "alpha": 0.1, "material": "Au", "distribution": "ggx"},
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1, 2, 3]}},
    },
    "fog": {
        "type": "cube",
        "bsdf": {"type": "null"},
        "interior": {"type": "homogeneous", "sigma_t": 1.0, "albedo": 0.5},
    },
    "sky": {"type": "envmap", "bitmap": torch.ones(4, 8, 3)},
}


def picture(height: int = 9, width: int = 13, channels: int = 3) -> torch.Tensor:
    """A picture of noise."""
    return torch.rand(height, width, channels, generator=torch.Generator().manual_seed(channels))


def serialized_stream() -> bytes:
    return struct.pack("<IBQQ", 0x1000, 0, 4, 2) + POINTS.tobytes() + FACES.tobytes()


def packed_stream(stream: bytes) -> bytes:
    """A serialized file of one mesh."""
    return struct.pack("<HH", 0x041C, 4) + zlib.compress(stream) + struct.pack("<QI", 0, 1)


def png_rows() -> bytes:
    """What is compressed in the 16-bit PNG picture that `packed_rows` makes, 5 x 4 pixels."""
    return b"".join(bytes([kind]) + bytes(range(5 * 2 * 3)) for kind in (0, 1, 2, 4))


def packed_rows(rows: bytes) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 5, 4, 16, 2, 0, 0, 0)
    chunks = [chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(rows)), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def ragged(path: Path) -> None:
    """A PLY file with faces of different lengths."""
    head = "ply\nformat binary_big_endian 1.0\nelement face 2\nproperty list uchar uint vertex_index\n"
    head += "element vertex 4\nproperty float x\nproperty float y\nproperty double z\nend_header\n"
    rows = b"".join(struct.pack(">ffd", *row) for row in POINTS.tolist())
    path.write_bytes(head.encode() + struct.pack(">B3IB4I", 3, 0, 1, 2, 4, 0, 1, 2, 3) + rows)


def boxed(path: Path) -> None:
    """A box with a material, in the format of the name's ending."""
    import trimesh

    box = trimesh.creation.box()
    if path.suffix != ".stl":
        material = trimesh.visual.material.PBRMaterial()
        box.visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2], material=material)
    if path.suffix == ".gltf":
        embedded(path, box)
    else:
        box.export(path)


def embedded(path: Path, box: Any) -> None:
    """A glTF file of JSON, its buffer in it."""
    import base64
    import json

    files = box.export(file_type="gltf") if hasattr(box, "geometry") else box.scene().export(file_type="gltf")
    header = json.loads(files["model.gltf"])
    for buffer in header["buffers"]:
        content = base64.b64encode(files[buffer["uri"]]).decode()
        buffer["uri"] = "data:application/octet-stream;base64," + content
    path.write_text(json.dumps(header))


def colmap(path: Path) -> None:
    """Both files of a reconstruction, of which one is to be damaged."""
    if path.suffix == ".txt":
        for name, text in COLMAP.items():
            (path.parent / name).write_text(text)
        return
    cameras = struct.pack("<QIiQQ4d", 1, 1, 1, 30, 40, 50, 45, 14, 18)
    image = struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0.1, -0.2, 3, 1) + b"a.jpg\0" + struct.pack("<QddQ", 1, 1.5, 2.5, 7)
    (path.parent / "cameras.bin").write_bytes(cameras)
    (path.parent / "images.bin").write_bytes(image)


def with_materials(path: Path) -> None:
    """A library of materials, and the OBJ file beside it that names it."""
    (path.parent / "a.obj").write_text(OBJ)
    write_image(path.parent / "a.png", picture(2, 2))
    path.write_text(MTL)


def spectrum(path: Path) -> Any:
    return tr.load_dict({"type": "diffuse", "reflectance": {"type": "spectrum", "filename": str(path)}})


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Attributes:
        name: of the file.
        write: makes a good one at a path, and what it needs beside it.
        read: reads it.
        text: its words are replaced, too.
        packed: makes a file of what is damaged, where that is not the file itself but what is compressed in it.
    """

    name: str
    write: Callable[[Path], object]
    read: Callable[[Path], object]
    text: bool = False
    packed: Callable[[bytes], bytes] | None = None


KINDS = {
    "exr": Kind("a.exr", lambda p: write_image(p, picture()), read_image),
    "exr channels": Kind("a.exr", lambda p: write_image(p, {"": picture(), "z": picture(channels=1)}), read_channels),
    "exr parts": Kind("a.exr", lambda p: write_parts(p, {"a": picture(), "b": picture(5, 4, 1)}), read_parts),
    "hdr": Kind("a.hdr", lambda p: write_image(p, picture()), read_image),
    "pfm": Kind("a.pfm", lambda p: write_image(p, picture()), read_image),
    "png": Kind("a.png", lambda p: write_image(p, picture(channels=4)), read_image),
    "png 16": Kind("a.png", lambda p: write_image(p, picture(), bits=16), read_image),
    "png 16 inside": Kind("a.png", lambda p: p.write_bytes(png_rows()), read_image, packed=packed_rows),
    "jpeg": Kind("a.jpg", lambda p: write_image(p, picture()), read_image),
    "vol": Kind("a.vol", lambda p: write_volume(p, torch.rand(2, 3, 4, 1)), read_volume),
    "npy": Kind("a.npy", lambda p: write_volume(p, torch.rand(2, 3, 4, 1)), read_volume),
    "ply": Kind("a.ply", lambda p: write_ply(p, POINTS, FACES, normals=POINTS + 1, texcoords=POINTS[:, :2],
                                             attributes={"face_color": np.ones((2, 3), np.float32)}), load_mesh),
    "ply text": Kind("a.ply", lambda p: p.write_text(PLY), load_mesh, text=True),
    "ply ragged": Kind("a.ply", ragged, load_mesh),
    "obj": Kind("a.obj", lambda p: p.write_text(OBJ), load_mesh, text=True),
    "obj scene": Kind("a.obj", lambda p: p.write_text(OBJ), load_scene, text=True),
    "mtl": Kind("a.mtl", with_materials, lambda p: load_scene(p.with_suffix(".obj")), text=True),
    "serialized": Kind("a.serialized", lambda p: p.write_bytes(packed_stream(serialized_stream())), load_mesh),
    "serialized inside": Kind("a.serialized", lambda p: p.write_bytes(serialized_stream()), load_mesh,
                              packed=packed_stream),
    "gltf": Kind("a.gltf", boxed, load_scene, text=True),
    "glb": Kind("a.glb", boxed, load_scene),
    "stl": Kind("a.stl", boxed, load_scene),
    "xml": Kind("a.xml", lambda p: p.write_text(XML), tr.load_file, text=True),
    "xml tree": Kind("a.xml", lambda p: p.write_text(XML), parse, text=True),
    "spectrum": Kind("a.spd", lambda p: p.write_text("400 0.1\n500 0.2\n700 0.9\n"), spectrum, text=True),
    "colmap cameras": Kind("cameras.bin", colmap, lambda p: tr.load_colmap(p.parent)),
    "colmap images": Kind("images.bin", colmap, lambda p: tr.load_colmap(p.parent)),
    "colmap cameras text": Kind("cameras.txt", colmap, lambda p: tr.load_colmap(p.parent), text=True),
    "colmap images text": Kind("images.txt", colmap, lambda p: tr.load_colmap(p.parent), text=True),
}  # fmt: skip
NUMBERS = (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0", b"\0\0\0\x80", b"\xff\xff", b"\xff", b"\0")
WORDS = (b"-1", b"0", b"1e999", b"nan", b"99999999999", b"1.5", b"", b"-", b"\xff", b"$spp", b"999999", b"4294967296")
SPLIT = re.compile(rb"[A-Za-z_]+|[-+.0-9eE]+|[^A-Za-z_0-9]")


def damaged(content: bytes, rng: np.random.Generator, text: bool) -> bytes:
    """One damaged variant of a file."""
    changed = content
    for _ in range(int(rng.integers(1, 4))):
        how = int(rng.integers(9 if text else 6))
        if not changed:
            return changed
        low, high = sorted(rng.integers(0, len(changed), 2).tolist())
        if how == 0:
            changed = changed[:high]
        elif how == 1:
            some = bytearray(changed)
            some[low] ^= 1 << int(rng.integers(8))
            changed = bytes(some)
        elif how == 2:
            number = NUMBERS[int(rng.integers(len(NUMBERS)))]
            changed = changed[:low] + number + changed[low + len(number) :]
        elif how == 3:
            changed = changed[:high] + changed[low:]
        elif how == 4:
            changed = changed[:low] + changed[min(high, low + 16) :]
        elif how == 5:  # a piece from elsewhere
            start = int(rng.integers(len(content)))
            piece = content[start : start + int(rng.integers(1, 17))]
            changed = changed[:low] + piece + changed[low + len(piece) :]
        else:
            words = SPLIT.findall(changed)
            if not words:
                continue
            place = int(rng.integers(len(words)))
            if how == 6:
                words[place] = WORDS[int(rng.integers(len(WORDS)))]
            elif how == 7:
                words[place] = words[int(rng.integers(len(words)))]
            else:
                del words[place]
            changed = b"".join(words)
    return changed


VALUES: tuple[Any, ...] = (
    *(None, -1, 0, 1e999, float("nan"), 1 << 70, "", "path", [], [1, 2], {}, {"type": "ref", "id": "ball"}, True),
    *(
        torch.zeros(0),
        torch.zeros(2, 2),
        torch.tensor(1),
        np.zeros((3, 3)),
        object(),
        {"type": "rgb", "value": 2},
        b"x",
    ),
    *({"type": 3}, {"type": "sphere"}, {"type": "rgb"}, lambda: 0, [[1]], {"a": 1}, "0.5, 0.5, 0.5", -0.5),
)


def damaged_dict(rng: np.random.Generator) -> dict[Any, Any]:
    """The scene of `DICT` with some entries replaced, left out, renamed or put elsewhere."""
    made = copy.deepcopy(DICT)
    for _ in range(int(rng.integers(1, 4))):
        places = list(_places(made))
        owner, key = places[int(rng.integers(len(places)))]
        how = int(rng.integers(5))
        if how < 2:
            owner[key] = copy.deepcopy(VALUES[int(rng.integers(len(VALUES)))])  # later changes may go into it
        elif how == 2:
            del owner[key]
        elif how == 3:
            owner[("name", "value", "Type", "bsdf", "a.b", 3)[int(rng.integers(6))]] = owner.pop(key)
        else:
            other, name = places[int(rng.integers(len(places)))]
            owner[key] = copy.deepcopy(other.get(name))
    return made


def _places(owner: dict[Any, Any]) -> Any:
    """Dicts and their keys, at any depth."""
    for key, value in list(owner.items()):
        yield owner, key
        if isinstance(value, dict):
            yield from _places(value)
