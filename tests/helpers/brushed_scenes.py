"""A scene with surfaces that are rougher along one direction, for references; numbers and arrays alone, no torch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import reference_scenes as rs

SHEET = rs.DATA / "sheet.ply"


def roughness(seed: int, low: float, high: float) -> dict:
    """A texture of roughness, four texels wide."""
    return {"type": "bitmap", "data": rs._noise(seed, 4, 4, low, high, 1), "raw": True}


def metal(alpha_u, alpha_v, **more) -> dict:
    return {"type": "roughconductor", "material": "Cu", "alpha_u": alpha_u, "alpha_v": alpha_v, **more}


def write_sheet(path: Path, n: int = 7) -> None:
    """Write a bent sheet with normals, and texture coordinates that are turned and bent against its edges, as PLY."""
    y, x = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    z = 0.3 * np.sin(1.5 * x + 0.3) * np.cos(y)
    normals = np.stack([-0.45 * np.cos(1.5 * x + 0.3) * np.cos(y), 0.3 * np.sin(1.5 * x + 0.3) * np.sin(y), 1 + 0 * x])
    normals /= np.linalg.norm(normals, axis=0)
    u, v = 0.5 + 0.3 * x - 0.2 * y + 0.1 * x * y, 0.5 + 0.15 * x + 0.3 * y + 0.05 * x * x
    rows = np.stack([x, y, z, *normals, u, v], axis=-1).reshape(-1, 8).astype("<f4")
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    below, above = [corner, corner + 1, corner + n + 1], [corner, corner + n + 1, corner + n]
    corners = np.empty(2 * len(corner), dtype=[("n", "u1"), ("i", "<i4", 3)])
    corners["n"], corners["i"] = 3, np.concatenate([np.stack(below, 1), np.stack(above, 1)])
    names = ["x", "y", "z", "nx", "ny", "nz", "u", "v"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(corners)}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(header).encode() + rows.tobytes() + corners.tobytes())


def _brushed() -> rs.ReferenceScene:
    """Copper: a turned ball and disk, a mesh with normals and coordinates of its own, a floor; and a frosted pane."""
    glass = {
        "type": "roughdielectric",
        "distribution": "ggx",
        "alpha_u": 0.4,
        "alpha_v": 0.1,
        "int_ior": 1.5,
        "ext_ior": 1.0,
    }
    floor = metal(roughness(4, 0.1, 0.4), 0.5, distribution="ggx", specular_reflectance=0.7)
    return rs.ReferenceScene(
        rs._scene(
            {"type": "path", "max_depth": 5, "rr_depth": 99},
            rs._camera(),
            ball={
                "type": "sphere",
                "to_world": rs.translate(-1.2, -0.2, 0.2) @ rs.rotate("x", 25) @ rs.scale(0.8),
                "bsdf": metal(0.15, 0.5, distribution="ggx"),
            },
            plate={
                "type": "disk",
                "to_world": rs.translate(0.2, 0.7, -1.0) @ rs.rotate("x", -30) @ rs.scale(0.9, 0.6, 1.0),
                "bsdf": {"type": "twosided", "bsdf": metal(0.5, 0.2)},
            },
            mesh={
                "type": "ply",
                "filename": str(SHEET),
                "to_world": rs.translate(1.1, -0.3, 0.0) @ rs.rotate("y", -35) @ rs.scale(0.7),
                "bsdf": {"type": "twosided", "bsdf": metal(0.2, roughness(5, 0.3, 0.7), distribution="ggx")},
            },
            pane={
                "type": "rectangle",
                "to_world": rs.translate(0.5, 0.0, 1.5) @ rs.rotate("z", 30) @ rs.scale(0.35),
                "bsdf": glass,
            },
            floor={"type": "rectangle", "to_world": rs.FLOOR, "bsdf": {"type": "twosided", "bsdf": floor}},
            lamp=rs._lamp(rs._rgb(8.0, 7.0, 5.0)),
            sky={"type": "constant", "radiance": rs._rgb(0.3, 0.4, 0.5)},
        ),
        (
            "ball.bsdf.alpha_u.value",
            "ball.bsdf.alpha_v.value",
            "plate.bsdf.brdf_0.alpha_u.value",
            "floor.bsdf.brdf_0.alpha_u.data",
            "mesh.bsdf.brdf_0.alpha_v.data",
            "pane.bsdf.alpha_u.value",
        ),
    )


SCENES = {"brushed": _brushed}
