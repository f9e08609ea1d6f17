"""Scenes for the derivatives of what moves: geometry, cameras, coordinates, indices of refraction.

None has silhouettes, shadows or jumps of normals or textures in view or in its light, so that the derivative of the
image is the term inside surfaces: everything moves, but continuously.
"""

from __future__ import annotations

import math

import torch
from layer_scenes import blend, bump_map, mask, normal_map

from torchrender import Mesh, Transform


def smooth_texture(height: int, width: int) -> torch.Tensor:
    """Texels (H, W, 3) in [0.2, 0.8], smooth, periodic in u, and without u at the poles of a sphere."""
    v = (torch.arange(height, dtype=torch.float64) + 0.5) / height
    u = (torch.arange(width, dtype=torch.float64) + 0.5) / width
    v, u = torch.meshgrid(v, u, indexing="ij")
    waves = [torch.sin(2 * math.pi * k * u + i) for i, k in enumerate((1, 2, 1))]
    return 0.5 + 0.3 * torch.sin(math.pi * v).square()[..., None] * torch.stack(waves, dim=-1)


def bitmap(height: int = 16, width: int = 16, factor: float = 1.0, **settings) -> dict:
    return {"type": "bitmap", "data": smooth_texture(height, width) * factor, "raw": True, **settings}


def camera(origin, target, fov: float) -> dict:
    film = {"type": "hdrfilm", "width": 6, "height": 6, "rfilter": {"type": "box"}}
    return {"type": "perspective", "fov": fov, "to_world": Transform.look_at(origin, target), "film": film}


PIXEL = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}


def scene(depth: int, camera: dict, **objects) -> dict:
    integrator = {"type": "path", "max_depth": depth, "rr_depth": 99}
    camera = {name: value for name, value in camera.items() if value is not None}
    return {"type": "scene", "integrator": integrator, "camera": camera, **objects}


def floor(bsdf: dict | None = None) -> dict:
    """A rectangle that fills the view of `above`."""
    to_world = Transform.rotate([1, 0, 0], -70) @ Transform.scale(4.0)
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf or {"type": "diffuse", "reflectance": bitmap()}}


def above() -> dict:
    return camera([0.3, 1, 4], [0, 0, 0], 20)


def black_room(radius: float = 5.0) -> dict:
    """A sphere around everything that emits and does not reflect."""
    light = {"type": "area", "radiance": bitmap(32, 64, 2.0)}
    black = {"type": "diffuse", "reflectance": 0.0}
    return {"type": "sphere", "radius": radius, "flip_normals": True, "bsdf": black, "emitter": light}


def ball(bsdf: dict) -> dict:
    return {"type": "sphere", "center": [0.05, 0, -0.1], "radius": 0.9, "bsdf": bsdf}


def at_ball() -> dict:
    return camera([0, 0.3, 4], [0, 0, 0], 10)


def mesh_ball(bsdf: dict, attributes: dict | None = None, smooth: bool = True) -> Mesh:
    """A ball of triangles, shaded smooth, with texture coordinates that have no seam."""
    import trimesh

    shape = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    vertices = torch.tensor(shape.vertices, dtype=torch.float64)
    texcoords = vertices[:, :2] * 0.4 + 0.5
    normals = vertices if smooth else None
    return Mesh(vertices, shape.faces, normals, texcoords, bsdf=bsdf, attributes=attributes)


def attribute_plane() -> dict:
    """Two triangles seen frontally, coloured by their vertices."""
    corners = torch.tensor([[-3, -3, 0], [3, -3, 0.2], [3, 3, 0], [-3, 3, -0.2]], dtype=torch.float64)
    colours = torch.tensor([[0.2, 0.5, 0.8], [0.7, 0.3, 0.2], [0.4, 0.9, 0.1], [0.6, 0.6, 0.6]], dtype=torch.float64)
    attribute = {"type": "mesh_attribute", "name": "vertex_color", "scale": 0.9}
    # smooth normals: the crease between the triangles is no edge of the image
    up = torch.tensor([[0.0, 0, 1]]).expand(4, 3)
    mesh = Mesh(
        corners,
        [[0, 1, 2], [0, 2, 3]],
        vertex_normals=up,
        bsdf={"type": "diffuse", "reflectance": attribute},
        attributes={"vertex_color": colours},
    )
    return scene(
        3,
        camera([0.2, 0.1, 4], [0, 0, 0], 20),
        plane=mesh,
        lamp={"type": "point", "position": [0.5, 1, 2], "intensity": {"type": "rgb", "value": [9, 8, 7]}},
    )


def shaded_plane(bsdf: dict) -> Mesh:
    """Two triangles of one plane, with normals that change over it and turned texture coordinates.

    Tangents are the same on both, so that nothing jumps at the edge between them.
    """
    corners = torch.tensor([[-4, -4, 0], [4, -4, 0], [4, 4, 0], [-4, 4, 0]], dtype=torch.float64)
    up = torch.tensor([[-0.2, 0.1, 1], [0.3, 0.1, 1], [0.2, -0.2, 1], [-0.1, -0.3, 1]], dtype=torch.float64)
    texcoords = corners[:, :2] @ torch.tensor([[0.2, 0.1], [-0.05, 0.15]], dtype=torch.float64)
    return Mesh(corners, [[0, 1, 2], [0, 2, 3]], up, texcoords, bsdf=bsdf)


def lamp(kind: str) -> dict:
    """An area light over the floor, facing it."""
    light = {"type": "area", "radiance": bitmap(16, 16, 5.0)}
    if kind == "sphere":
        return {"type": "sphere", "center": [0.5, 3, 1], "radius": 0.4, "emitter": light}
    if kind == "cylinder":  # turned inside out and seen from within: no part of it hides another
        ends = {"p0": [0.5, 2.8, -2.5], "p1": [0.9, 3.0, 3.5]}
        return {"type": "cylinder", **ends, "radius": 6.0, "flip_normals": True, "emitter": light}
    to_world = Transform.look_at([0.5, 3, 1], [0, 0, 0], [0, 0, 1]) @ Transform.scale(0.5)
    return {"type": kind, "to_world": to_world, "emitter": light}


def hills(bsdf: dict, to_world: Transform, amplitude: float) -> dict:
    """A smooth height field."""
    v, u = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (5, 6)), indexing="ij")
    heights = amplitude * torch.sin(0.8 * u + 0.5) * torch.cos(0.9 * v)
    return {"type": "heightfield", "heights": heights, "to_world": to_world, "bsdf": bsdf}


def distances(bsdf: dict, size: float = 2.25, center: float = 0.0, flip: bool = False, **more) -> dict:
    """A dented ball of radius 0.4 `size` as a coarse grid of signed distances; nothing turns where cells meet."""
    z, y, x = torch.meshgrid(*(torch.linspace(0, 1, n, dtype=torch.float64) - 0.5 for n in (8, 9, 10)), indexing="ij")
    grid = torch.sqrt(x * x + 1.1 * y * y + z * z) - 0.4 + 0.01 * torch.sin(9 * x + 7 * y - 5 * z)
    to_world = Transform.translate([center, 0.1, 0]) @ Transform.rotate([1, 2, 1], 25) @ Transform.scale(size)
    to_world = to_world @ Transform.translate([-0.5, -0.5, -0.5])
    return {"type": "sdfgrid", "grid": grid, "to_world": to_world, "flip_normals": flip, "bsdf": bsdf, **more}


def saddle(bsdf: dict) -> dict:
    """A surface in a single cell, whose own normals therefore go on everywhere; it fills the view of `above`."""
    grid = torch.tensor([[[-0.5, -0.3], [-0.45, -0.6]], [[0.5, 0.55], [0.4, 0.6]]], dtype=torch.float64)
    to_world = Transform.rotate([1, 0, 0], -70) @ Transform.scale([8, 8, 4]) @ Transform.translate([-0.5, -0.5, -0.5])
    return {"type": "sdfgrid", "grid": grid, "normals": "analytic", "to_world": to_world, "bsdf": bsdf}


def pipe(bsdf: dict) -> dict:
    """A tube across the view of `at_ball`, wider than it and open beyond it, whose azimuth begins behind."""
    turned = Transform.rotate([1, 0, 0], -90)
    return {
        "type": "cylinder",
        "p0": [0.2, 0.1, -3.0],
        "p1": [-0.1, 0.3, 3.2],
        "radius": 0.9,
        "to_world": turned @ Transform.rotate([0, 0, 1], 40),
        "bsdf": bsdf,
    }


TUBE = [[-3.0, 0.1, -0.2], [-1.0, -0.1, 0.1], [0.2, 0.1, -0.1], [1.2, 0.0, 0.1], [3.0, -0.2, 0.0]]


def tube(bsdf: dict, kind: str = "bsplinecurve") -> dict:
    """A curve across the view of `at_ball`, wider than it and open beyond it, whose azimuth begins above."""
    points = torch.tensor(TUBE, dtype=torch.float64)
    radii = torch.tensor([0.8, 0.95, 0.85, 0.95, 0.9], dtype=torch.float64)
    if kind == "linearcurve":  # one cone: joints of several have edges
        points, radii = points[[0, -1]], radii[[0, 1]]
    return {"type": kind, "control_points": points, "radii": radii, "bsdf": bsdf}


def rod(bsdf: dict) -> dict:
    """The sphere at the end of a curve, which goes away from the camera of `at_ball`."""
    points = [[0.05, 0.1, -0.1], [0.1, -0.2, -5.0]]
    return {"type": "linearcurve", "control_points": points, "radii": [0.9, 0.5], "bsdf": bsdf}


def grid() -> dict:
    """A smooth volume of colours, seen from within between its voxels."""
    z, y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (24, 24, 24)), indexing="ij")
    waves = [torch.sin(0.3 * x + 0.2 * y + i) * torch.cos(0.25 * z - 0.1 * i) for i in range(3)]
    to_world = Transform.rotate([0, 1, 0], 15) @ Transform.translate([-6, -6, -6]) @ Transform.scale(12)
    return {"type": "gridvolume", "data": 0.5 + 0.3 * torch.stack(waves, -1), "to_world": to_world}


CARVED = {"type": "diffuse", "reflectance": {"type": "volume", "volume": grid()}}
METAL = {
    "type": "conductor",
    "eta": {"type": "rgb", "value": [0.2, 0.9, 1.1]},
    "k": {"type": "rgb", "value": [3.9, 2.4, 2.2]},
}
GLASS = {"type": "dielectric", "int_ior": 1.3, "ext_ior": 1.0}
PLAIN = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.5, 0.4]}}
PAINT = {"type": "diffuse", "reflectance": bitmap()}
FROSTED = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.4, "int_ior": 1.3, "ext_ior": 1.0}


BRUSHED = {**METAL, "type": "roughconductor", "alpha": {"type": "bitmap", "data": smooth_texture(16, 16)[..., :1]}}
ALONG = {**BRUSHED, "alpha_u": BRUSHED["alpha"], "alpha_v": 0.5, "distribution": "ggx"}
del ALONG["alpha"]
FROSTED_ALONG = {**FROSTED, "alpha_u": 0.3, "alpha_v": 0.5}
del FROSTED_ALONG["alpha"]
TOY = {"type": "plastic", "diffuse_reflectance": bitmap(), "int_ior": 1.5}
MUG = {**TOY, "type": "roughplastic", "distribution": "ggx", "alpha": 0.4}
CUP = {**MUG, "type": "pplastic"}
FIBRE = {"type": "hair", "sigma_a": bitmap(), "longitudinal_roughness": 0.5, "azimuthal_roughness": 0.6}
PANE = {"type": "thindielectric", "int_ior": 1.5}
LACQUER = {
    "type": "principled",
    "base_color": bitmap(),
    "roughness": 0.5,
    "metallic": 0.3,
    "sheen": 0.5,
    "spec_tint": 0.4,
    "clearcoat": 0.5,
}
LACQUER_ALONG = {**LACQUER, "base_color": 0.6, "metallic": 0.7, "roughness": 0.7, "anisotropic": bitmap(4, 4, 0.6)}
HAZE = {"type": "principled", "base_color": 0.8, "roughness": 0.6, "spec_trans": 0.8, "eta": 1.3}


# without its sharp terms near the terminator, where the few paths that weigh much come and go
DULL = {**BRUSHED, "alpha": 0.6}
SIDES = {"type": "twosided", "bsdf": normal_map(PAINT)}
BUMPS = {"type": "twosided", "bsdf": bump_map(PAINT, 0.2)}
BOTH_SIDES = {"type": "twosided", "bsdf": PAINT}


def environment() -> dict:
    return {"type": "envmap", "data": smooth_texture(16, 32), "to_world": Transform.rotate([0, 1, 0], 30)}


SCENES = {
    "point_light": lambda: scene(
        3,
        above(),
        floor=floor(),
        lamp={"type": "point", "position": [0.5, 2, 1], "intensity": {"type": "rgb", "value": [9, 8, 7]}},
    ),
    "sun": lambda: scene(
        2, above(), floor=floor(), sun={"type": "directional", "direction": [0.5, -2, -1], "irradiance": [3, 2, 1]}
    ),
    "spot_light": lambda: scene(
        2,
        above(),
        floor=floor(),
        lamp={
            "type": "spot",
            "intensity": {"type": "rgb", "value": [9, 8, 7]},
            "cutoff_angle": 40,
            "beam_width": 10,
            "texture": bitmap(wrap_mode="clamp"),
            "to_world": Transform.look_at([0.5, 2, 1], [0, 0, 0], [0, 0, 1]),
        },
    ),
    "projector": lambda: scene(
        2,
        above(),
        floor=floor(),
        beamer={
            "type": "projector",
            "irradiance": bitmap(12, 16, 5.0, wrap_mode="clamp"),
            "fov": 90,  # its border is out of view
            "to_world": Transform.look_at([0.5, 2, 1], [0, 0, 0], [0, 0, 1]),
        },
    ),
    "rectangle_light": lambda: scene(2, above(), floor=floor(), lamp=lamp("rectangle")),
    "disk_light": lambda: scene(2, above(), floor=floor(), lamp=lamp("disk")),
    "sphere_light": lambda: scene(2, above(), floor=floor(), lamp=lamp("sphere")),
    "cylinder_light": lambda: scene(2, above(), floor=floor(), lamp=lamp("cylinder")),
    "pipe": lambda: scene(2, at_ball(), pipe=pipe(PAINT), room=black_room()),
    "metal_pipe": lambda: scene(3, at_ball(), pipe=pipe(METAL), room=black_room()),
    "tube": lambda: scene(2, at_ball(), tube=tube(PAINT), room=black_room()),
    "metal_tube": lambda: scene(3, at_ball(), tube=tube(METAL), room=black_room()),
    "carved_tube": lambda: scene(2, at_ball(), tube=tube(CARVED), room=black_room()),
    "bumpy_tube": lambda: scene(2, at_ball(), tube=tube(BUMPS), room=black_room()),
    "wire": lambda: scene(2, at_ball(), wire=tube(PAINT, "linearcurve"), room=black_room()),
    "metal_wire": lambda: scene(3, at_ball(), wire=tube(METAL, "linearcurve"), room=black_room()),
    "brushed_wire": lambda: scene(3, at_ball(), wire=tube(ALONG, "linearcurve"), room=black_room()),
    "rod": lambda: scene(3, at_ball(), rod=rod(METAL), room=black_room()),
    "hairy_pipe": lambda: scene(2, at_ball(), pipe=pipe(FIBRE), room=black_room()),
    "hairy_tube": lambda: scene(2, at_ball(), tube=tube(FIBRE), room=black_room()),
    "carved_floor": lambda: scene(2, above(), floor=floor(CARVED), lamp=lamp("rectangle")),
    "carved_pipe": lambda: scene(2, at_ball(), pipe=pipe(CARVED), room=black_room()),
    "carved_hills": lambda: scene(2, above(), hills=hills(CARVED, floor()["to_world"], 0.04), lamp=lamp("disk")),
    "two_sided": lambda: scene(2, above(), floor=floor({"type": "twosided", "bsdf": PAINT}), lamp=lamp("rectangle")),
    "disk_floor": lambda: scene(
        2,
        above(),
        floor={**floor(), "type": "disk", "bsdf": {"type": "diffuse", "reflectance": 0.6}},
        lamp=lamp("disk"),
    ),
    "attribute": attribute_plane,
    "painted_ball": lambda: scene(2, at_ball(), ball=ball(PAINT), room=black_room()),
    "metal_ball": lambda: scene(3, at_ball(), ball=ball(METAL), room=black_room()),
    "metal_mesh": lambda: scene(3, at_ball(), ball=mesh_ball(METAL), room=black_room()),
    "painted_mesh": lambda: scene(2, at_ball(), ball=mesh_ball(PAINT), room=black_room()),
    "room": lambda: scene(
        3,
        camera([0.3, 0.1, 0.4], [2, 0.1, 0], 60),
        room={
            "type": "sphere",
            "center": [0.1, 0, 0],
            "radius": 2.0,
            "flip_normals": True,
            "to_world": Transform.rotate([0, 0, 1], 20),
            "bsdf": {"type": "diffuse", "reflectance": bitmap(32, 64)},
            "emitter": {"type": "area", "radiance": bitmap(32, 64, 2.0)},
        },
    ),
    "hole": lambda: scene(
        4,
        above(),
        hole={**floor({"type": "null"}), "to_world": Transform.translate([0, 0, 1])},
        floor=floor(),
        lamp={"type": "point", "position": [0.5, 1, 0.8], "intensity": 9.0},
    ),
    "glass_ball": lambda: scene(4, at_ball(), ball=ball(GLASS), sky=environment()),
    "glass_in_room": lambda: scene(4, at_ball(), ball=ball(GLASS), room=black_room()),
    "frosted_in_room": lambda: scene(4, at_ball(), ball=ball(FROSTED), room=black_room()),
    "hills": lambda: scene(2, above(), hills=hills(PAINT, floor()["to_world"], 0.04), lamp=lamp("rectangle")),
    "glass_hills": lambda: scene(4, at_ball(), lens=hills(GLASS, Transform.scale(0.6), 0.08), room=black_room()),
    "saddle": lambda: scene(2, above(), floor=saddle(PLAIN), lamp=lamp("rectangle")),
    "distances": lambda: scene(2, at_ball(), ball=distances(CARVED), room=black_room()),
    "metal_distances": lambda: scene(3, at_ball(), ball=distances(METAL), room=black_room()),
    # seen from a smooth vertex, and from one on a grid
    "hall_of_distances": lambda: scene(
        4,
        camera([0.3, 0.1, 0.4], [2, 0.1, 0], 60),
        hall=distances(PLAIN, 6.0, flip=True),
        bulb={"type": "point", "position": [-0.4, 0.3, 0.2], "intensity": {"type": "rgb", "value": [9, 8, 7]}},
    ),
    "glass_distances": lambda: scene(4, at_ball(), lens=distances(GLASS), room=black_room()),
    "brushed_in_room": lambda: scene(3, at_ball(), ball=ball(BRUSHED), room=black_room()),
    "toy_in_room": lambda: scene(3, at_ball(), ball=ball(TOY), room=black_room()),
    "toy_mesh": lambda: scene(3, at_ball(), ball=mesh_ball(TOY), room=black_room()),
    "mug_in_room": lambda: scene(3, at_ball(), ball=ball(MUG), room=black_room()),
    "cup_in_room": lambda: scene(3, at_ball(), ball=ball(CUP), room=black_room()),
    "pane_in_room": lambda: scene(
        3, above(), pane={**floor(PANE), "to_world": Transform.scale(4.0)}, floor=floor(), room=black_room(20.0)
    ),
    "lacquer_in_room": lambda: scene(3, at_ball(), ball=ball(LACQUER), room=black_room()),
    "frosted_haze_in_room": lambda: scene(4, at_ball(), ball=ball(HAZE), room=black_room()),
    "dented_in_room": lambda: scene(3, at_ball(), ball=ball(normal_map(DULL)), room=black_room()),
    "dented_mesh": lambda: scene(3, at_ball(), ball=mesh_ball(normal_map(DULL)), room=black_room()),
    "dented_floor": lambda: scene(2, above(), floor=floor(SIDES), lamp=lamp("rectangle")),
    "dented_disk": lambda: scene(2, above(), floor={**floor(SIDES), "type": "disk"}, lamp=lamp("rectangle")),
    "dented_hills": lambda: scene(2, above(), hills=hills(SIDES, floor()["to_world"], 0.04), lamp=lamp("rectangle")),
    "bumpy_hills": lambda: scene(2, above(), hills=hills(BUMPS, floor()["to_world"], 0.04), lamp=lamp("rectangle")),
    "bumpy_in_room": lambda: scene(3, at_ball(), ball=ball(bump_map(DULL)), room=black_room()),
    "bumpy_mesh": lambda: scene(3, at_ball(), ball=mesh_ball(bump_map(DULL)), room=black_room()),
    "bumpy_floor": lambda: scene(2, above(), floor=floor(BUMPS), lamp=lamp("rectangle")),
    "bumpy_disk": lambda: scene(2, above(), floor={**floor(BUMPS), "type": "disk"}, lamp=lamp("rectangle")),
    "mixed_in_room": lambda: scene(3, at_ball(), ball=ball(blend(PAINT, BRUSHED)), room=black_room()),
    "perforated_in_room": lambda: scene(4, at_ball(), ball=ball(mask(BOTH_SIDES)), room=black_room()),
    "distorted": lambda: scene(
        2,
        above() | {"fov": 30, "distortion": [-0.2, 0.08, 0.01, -0.02, 0.03, 0.02, -0.03, 0.01]},
        floor=floor(),
        lamp=lamp("rectangle"),
    ),
    "thinlens": lambda: scene(
        2,
        above() | {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3.0},
        floor=floor(),
        lamp=lamp("rectangle"),
    ),
    "orthographic": lambda: scene(
        2,
        above() | {"type": "orthographic", "fov": None, "to_world": above()["to_world"] @ Transform.scale([1, 1.2, 1])},
        floor=floor(),
        lamp=lamp("rectangle"),
    ),
    "fisheye": lambda: scene(
        1, above() | {"type": "fisheye", "fov": 90, "distortion": [0.05, -0.02, 0.01, -0.003]}, room=black_room()
    ),
    "panorama": lambda: scene(1, above() | {"type": "panorama", "fov": None}, room=black_room()),
    "radiancemeter": lambda: scene(
        2,
        above() | {"type": "radiancemeter", "fov": None, "film": PIXEL},
        floor=floor(),
        lamp=lamp("rectangle"),
    ),
    "distant": lambda: scene(
        2,
        above() | {"type": "distant", "fov": None, "film": PIXEL, "target": [0.2, 0.1, 0.1]},
        ball=ball(PAINT),
        sky=environment(),
    ),
    "along_hills": lambda: scene(
        2, above(), hills=hills({"type": "twosided", "bsdf": ALONG}, floor()["to_world"], 0.04), lamp=lamp("rectangle")
    ),
    "along_floor": lambda: scene(2, above(), floor=floor({"type": "twosided", "bsdf": ALONG}), lamp=lamp("rectangle")),
    "along_disk": lambda: scene(
        2,
        above(),
        floor={
            "type": "disk",  # whose centre, where the radius has no direction, is out of view
            "to_world": Transform.rotate([1, 0, 0], -70) @ Transform.translate([2, 0.5, 0]) @ Transform.scale(5.0),
            "bsdf": ALONG,
        },
        lamp=lamp("rectangle"),
    ),
    "along_mesh": lambda: scene(2, above(), plane=shaded_plane(ALONG), lamp=lamp("rectangle")),
    "along_ball": lambda: scene(
        3,
        at_ball(),
        ball={**ball(ALONG), "to_world": Transform.rotate([1, 0, 0], 90)},  # poles are out of view
        room=black_room(),
    ),
    "frosted_along": lambda: scene(3, above(), plane=shaded_plane(FROSTED_ALONG), room=black_room(20.0)),
    "lacquer_along": lambda: scene(2, above(), plane=shaded_plane(LACQUER_ALONG), lamp=lamp("rectangle")),
    "along_dents": lambda: scene(2, above(), floor=floor(normal_map(ALONG)), lamp=lamp("rectangle")),
    "sky": lambda: scene(2, camera([0.3, 0.5, 4], [0.1, 0.1, 0], 50), sky=environment()),
    "floor_under_sky": lambda: scene(2, above(), floor=floor(), sky=environment()),
}
