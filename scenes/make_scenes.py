"""Write the meshes and textures that the scenes in this folder refer to.

    python scenes/make_scenes.py

The files are committed; run this only to change them. The Cornell box is the classic one of Cornell University's
Program of Computer Graphics, scaled to [-1, 1]^3; the sphere is a latitude-longitude mesh (32 segments, 16 rings).
`meshes/monkey.ply` (Blender's Suzanne, three levels of subdivision) is source data and is not written here.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent

# Quadrilaterals of the room; counter-clockwise seen from the side that reflects.
ROOM = {
    "light": [(-0.23, 0.99, -0.18), (0.23, 0.99, -0.18), (0.23, 0.99, 0.2), (-0.23, 0.99, 0.2)],
    "floor": [(-1, -1, 1), (1, -1, 1), (1, -1, -1), (-1, -1, -1)],
    "ceiling": [(-1, 1, -1), (1, 1, -1), (1, 1, 1), (-1, 1, 1)],
    "back": [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)],
    "green_wall": [(1, -1, -1), (1, -1, 1), (1, 1, 1), (1, 1, -1)],
    "red_wall": [(-1, -1, 1), (-1, -1, -1), (-1, 1, -1), (-1, 1, 1)],
}

# The two blocks: y range and the four corners (x, z) of the base, counter-clockwise seen from below.
BLOCKS = {
    "small_box": (-1.0, -0.4, [(0.13582, 0.005397), (0.70960295, 0.18082), (0.53418, 0.754603), (-0.039603, 0.57918)]),
    "large_box": (
        -1.01,
        0.21,
        [(-0.70885890, -0.47096), (-0.1390394, -0.6588589), (0.04885888, -0.0890394), (-0.5209606, 0.0988589)],
    ),
}


def write_ply(path: Path, vertices, faces, normals=None, texcoords=None) -> None:
    """Write a binary PLY file: vertices (V, 3), faces (F, 3), optional normals (V, 3) and texcoords (V, 2)."""
    columns, names = [np.asarray(vertices, "<f4")], ["x", "y", "z"]
    if normals is not None:
        columns.append(np.asarray(normals, "<f4"))
        names += ["nx", "ny", "nz"]
    if texcoords is not None:
        columns.append(np.asarray(texcoords, "<f4"))
        names += ["u", "v"]
    rows = np.concatenate(columns, axis=1)
    faces = np.asarray(faces)
    corners = np.empty(len(faces), dtype=[("n", "u1"), ("i", "<i4", 3)])
    corners["n"], corners["i"] = 3, faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(header).encode() + rows.tobytes() + corners.tobytes())


def quads(corners) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (4 n, 3) and faces (2 n, 3) of n separate quadrilaterals."""
    vertices = np.asarray(corners, float).reshape(-1, 3)
    first = np.arange(0, len(vertices), 4)[:, None]
    faces = (first[:, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return vertices, faces


def block(low: float, high: float, base) -> list:
    """The six outward-facing sides of an upright block."""
    bottom = [(x, low, z) for x, z in base]
    top = [(x, high, z) for x, z in base]
    sides = [[bottom[(i + 1) % 4], bottom[i], top[i], top[(i + 1) % 4]] for i in range(4)]
    return [bottom, top[::-1], *sides]


def sphere(segments: int = 32, rings: int = 16):
    """Unit sphere with its poles on the z axis: vertices (these are also its normals), texture coordinates, faces.

    u runs with the longitude from +x towards +y, v is 1 at +z. The vertices of the seam and of the poles are repeated,
    so that every corner has its own texture coordinates.
    """
    vertices, texcoords, faces = [], [], []
    for j in range(rings + 1):
        for i in range(segments + 1):
            theta, phi = np.pi * j / rings, 2 * np.pi * (i % segments) / segments
            radius = np.sin(theta) if 0 < j < rings else 0.0
            vertices.append((radius * np.cos(phi), radius * np.sin(phi), np.cos(theta)))
            texcoords.append((i / segments, 1 - j / rings))
    for j in range(rings):
        for i in range(segments):
            a, b = j * (segments + 1) + i, (j + 1) * (segments + 1) + i
            if j > 0:
                faces.append((a, b, a + 1))
            if j < rings - 1:
                faces.append((a + 1, b, b + 1))
    used, faces = np.unique(faces, return_inverse=True)
    return np.array(vertices)[used], np.array(texcoords)[used], faces.reshape(-1, 3)


def blocks_texture(resolution: int) -> np.ndarray:
    """16 x 16 random colours, each repeated to fill (resolution, resolution, 3) texels; linear values."""
    colours = np.random.default_rng(0).uniform(0.2, 0.8, (16, 16, 3)).astype(np.float32)
    return colours.repeat(resolution // 16, axis=0).repeat(resolution // 16, axis=1)


def write_exr(path: Path, image: np.ndarray) -> None:
    """Write (H, W, 3) float32 as an EXR file with channels R, G, B."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {name: np.ascontiguousarray(image[..., i]) for i, name in enumerate("RGB")}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def main() -> None:
    meshes, textures = HERE / "meshes", HERE / "textures"
    for folder in (meshes, textures):
        folder.mkdir(exist_ok=True)
    for name, corners in ROOM.items():
        write_ply(meshes / f"{name}.ply", *quads(corners))
    for name, (low, high, base) in BLOCKS.items():
        write_ply(meshes / f"{name}.ply", *quads(block(low, high, base)))
    vertices, texcoords, faces = sphere()
    write_ply(meshes / "sphere.ply", vertices, faces, normals=vertices, texcoords=texcoords)
    for resolution in (32, 512, 1024):
        write_exr(textures / f"blocks_{resolution}.exr", blocks_texture(resolution))


if __name__ == "__main__":
    main()
