"""The shapes of a scene as tensors, and where rays meet them, in plain PyTorch.

The native core says which triangle or curved shape a ray hits. From there position, normals and coordinates are
computed here once more, by operations that autograd differentiates as often and in whichever mode it is asked to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from . import heightfield, sdfgrid
from .curves import Segments
from .scene.packing import Layout, records
from .scene.scene import Scene

OFFSET = 8.9406967e-5  # how far off a surface rays start, in parts of coordinates
MESH, SPHERE, DISK, HEIGHT_FIELD, CYLINDER, CURVE, SDF_GRID = 0, 1, 2, 3, 4, 5, 6
CURVED = {"sphere": SPHERE, "disk": DISK, "heightfield": HEIGHT_FIELD, "cylinder": CYLINDER, "sdfgrid": SDF_GRID}
CURVES = {"bsplinecurve": CURVE, "linearcurve": CURVE}
CORNERS = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))  # of the rectangle, counter-clockwise seen from +z
RECTANGLE_FACES = ((0, 1, 2), (0, 2, 3))


@dataclass
class SurfacePoints:
    """Points on surfaces: `t` (N,), `position`, `normal`, `shading_normal` (N, 3), `uv`, `barycentric` (N, 2).

    On curves `barycentric` is the azimuth in turns and the place along the segment, on a grid of distances the place in
    a cell; on other curved shapes it repeats the texture coordinates.
    """

    t: torch.Tensor
    position: torch.Tensor
    normal: torch.Tensor
    shading_normal: torch.Tensor
    uv: torch.Tensor
    barycentric: torch.Tensor


@dataclass
class Surfaces:
    """All shapes of a scene, vertices and faces of meshes one after the other. S shapes, V vertices, F faces.

    Attributes:
        kind: (S,) int64, mesh (a rectangle is one), sphere, disk, cylinder, height field, curve or grid of distances.
        flip: (S,) bool, normals are turned round.
        smooth, textured: (S,) bool, there are vertex normals, texture coordinates.
        first_face, first_vertex: (S,) int64, where a shape's faces and vertices begin.
        faces: (F, 3) int64, indices into all vertices.
        positions, normals: (V, 3), world space. texcoords: (V, 2).
        to_world: (S, 4, 4), from the unit sphere, disk or cylinder, the square of a height field or the cube of a grid
            to the world; the identity for meshes.
        heights: of a height field, by its position among the shapes: heights (H, W) and interpolation.
        curves: of a curve, likewise: control points (N, 3), radii (N,), first control points (S,), and whether its
            segments are straight.
        grids: of a grid of distances likewise: the grid (D, H, W, 1) and its kind of normals.
    """

    kind: torch.Tensor
    flip: torch.Tensor
    smooth: torch.Tensor
    textured: torch.Tensor
    first_face: torch.Tensor
    first_vertex: torch.Tensor
    faces: torch.Tensor
    positions: torch.Tensor
    normals: torch.Tensor
    texcoords: torch.Tensor
    to_world: torch.Tensor
    heights: dict[int, tuple[torch.Tensor, str]]
    curves: dict[int, tuple[torch.Tensor, torch.Tensor, torch.Tensor, bool]]
    grids: dict[int, tuple[torch.Tensor, str]]

    @classmethod
    def of(cls, scene: Scene, layout: Layout, tensors: Sequence[torch.Tensor]) -> Surfaces:
        """The shapes with these `tensors` in the layout's slots, attached to them."""
        real = {"dtype": scene.dtype, "device": "cpu"}
        whole, truth = {**real, "dtype": torch.int64}, {**real, "dtype": torch.bool}
        identity = torch.eye(4, **real)
        kinds, flips, smooth, textured, first_face, first_vertex, matrices = [], [], [], [], [], [], []
        faces, positions, normals, texcoords, heights, curves, grids = [], [], [], [], {}, {}, {}
        n_vertices = n_faces = 0
        for record in records(layout, "shape"):
            kind, value = record.type, record.field
            flip, matrix = bool(value.get("flip_normals")), identity
            first_face.append(n_faces)
            first_vertex.append(n_vertices)
            has_normals = has_texcoords = False
            corners = indices = None
            if kind == "mesh":
                corners = tensors[value["vertices"]]
                indices = layout.indices(value["faces"]).long()
                has_normals, has_texcoords = value["normals"] >= 0, value["texcoords"] >= 0
                normals.append(tensors[value["normals"]] if has_normals else corners.new_zeros(corners.shape))
                texcoords.append(tensors[value["texcoords"]] if has_texcoords else corners.new_zeros(len(corners), 2))
            elif kind in CURVES:
                points, radii = tensors[value["control_points"]], tensors[value["radii"]]
                segments = layout.indices(value["segments"]).long()
                curves[len(kinds)] = (points, radii, segments, kind == "linearcurve")
            else:
                matrix = tensors[value["to_world"]]
                if kind == "sphere":
                    matrix = _placed(matrix, tensors[value["center"]], tensors[value["radius"]])
                if kind == "cylinder":
                    matrix = _along(matrix, tensors[value["p0"]], tensors[value["p1"]], tensors[value["radius"]])
            if kind == "rectangle":
                square = torch.tensor(CORNERS, **real)
                corners = transform_point(matrix, torch.nn.functional.pad(square, (0, 1)))
                indices = torch.tensor(RECTANGLE_FACES, **whole)
                has_texcoords = True
                normals.append(torch.zeros(4, 3, **real))
                texcoords.append((square + 1) / 2)
            if kind in ("sphere", "rectangle"):
                # mirroring turns a sphere inside out, and the faces of a rectangle, but not its normal
                flip ^= bool(torch.linalg.det(matrix.detach()[:3, :3]) < 0)
            if corners is not None and indices is not None:
                faces.append(indices + n_vertices)
                positions.append(corners)
                n_vertices, n_faces = n_vertices + len(corners), n_faces + len(indices)
            if kind == "heightfield":
                interpolation = heightfield.INTERPOLATIONS[value["interpolation"]]
                heights[len(kinds)] = (tensors[value["heights"]], interpolation)
            if kind == "sdfgrid":
                grids[len(kinds)] = (tensors[value["grid"]], sdfgrid.NORMALS[value["normals"]])
            kinds.append({**CURVED, **CURVES}.get(kind, MESH))
            flips.append(flip)
            smooth.append(has_normals)
            textured.append(has_texcoords)
            matrices.append(matrix if kind in CURVED else identity)
        nothing = torch.zeros(0, 3, **real)
        return cls(
            kind=torch.tensor(kinds, **whole),
            flip=torch.tensor(flips, **truth),
            smooth=torch.tensor(smooth, **truth),
            textured=torch.tensor(textured, **truth),
            first_face=torch.tensor(first_face, **whole),
            first_vertex=torch.tensor(first_vertex, **whole),
            faces=torch.cat(faces) if faces else torch.zeros(0, 3, **whole),
            positions=torch.cat(positions) if positions else nothing,
            normals=torch.cat(normals) if normals else nothing,
            texcoords=torch.cat(texcoords) if texcoords else nothing[:, :2],
            to_world=torch.stack(matrices) if matrices else identity.expand(0, 4, 4),
            heights=heights,
            curves=curves,
            grids=grids,
        )

    def meet(
        self,
        shape: torch.Tensor,
        primitive: torch.Tensor,
        origins: torch.Tensor,
        directions: torch.Tensor,
        t: torch.Tensor,
        coordinates: bool = True,
    ) -> SurfacePoints:
        """Where rays meet the surfaces that they are known to hit.

        Args:
            shape, primitive: (N,) integers, what is hit: triangles as infinite planes, disks alike.
            origins, directions: (N, 3).
            t: (N,) roughly the distance, which tells several intersections with a curved shape apart.
            coordinates: whether texture coordinates are wanted; without, those of meshes are barycentric.
        """
        shape, primitive = shape.long(), primitive.long()
        kind = self.kind[shape]
        rows, pieces = [], []
        on_mesh = (kind == MESH).nonzero()[:, 0]
        if len(on_mesh) or not len(shape):
            rows.append(on_mesh)
            s, p, o, d = shape, primitive, origins, directions
            if len(on_mesh) < len(shape):
                s, p, o, d = s[on_mesh], p[on_mesh], o[on_mesh], d[on_mesh]
            pieces.append(self._on_triangles(s, p, o, d, coordinates))
        quadric = ((kind == SPHERE) | (kind == DISK) | (kind == CYLINDER)).nonzero()[:, 0]
        if len(quadric):
            rows.append(quadric)
            pieces.append(self._on_quadrics(shape[quadric], origins[quadric], directions[quadric], t[quadric]))
        for indices, on_shape in (
            (self.heights, self._on_height_field),
            (self.curves, self._on_curve),
            (self.grids, self._on_sdf_grid),
        ):
            for index in indices:
                here = (shape == index).nonzero()[:, 0]
                if len(here):
                    rows.append(here)
                    pieces.append(on_shape(index, primitive[here], origins[here], directions[here], t[here]))
        if len(pieces) == 1:
            return pieces[0]
        back = torch.argsort(torch.cat(rows))
        names = SurfacePoints.__dataclass_fields__
        return SurfacePoints(*(torch.cat([getattr(piece, n) for piece in pieces])[back] for n in names))

    def _on_triangles(
        self, shape: torch.Tensor, primitive: torch.Tensor, o: torch.Tensor, d: torch.Tensor, coordinates: bool
    ) -> SurfacePoints:
        corner = self.faces[self.first_face[shape] + primitive]  # (N, 3)
        p0, p1, p2 = self.positions[corner].unbind(1)
        e1, e2 = p1 - p0, p2 - p0
        # Moeller and Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997, without the tests
        q, s = torch.linalg.cross(d, e2), o - p0
        r = torch.linalg.cross(s, e1)
        determinant = dot(e1, q)
        degenerate = determinant == 0
        inverse = torch.where(degenerate, 0.0, 1 / torch.where(degenerate, 1.0, determinant))
        b1, b2, t = dot(s, q) * inverse, dot(d, r) * inverse, dot(e2, r) * inverse
        weight = torch.stack([1 - b1 - b2, b1, b2], 1)[..., None]  # (N, 3, 1)
        normal = normalize(torch.linalg.cross(e1, e2))
        smooth = self.smooth[shape][:, None]
        shading = torch.where(smooth, normalize((self.normals[corner] * weight).sum(1), normal), normal)
        uv = barycentric = torch.stack([b1, b2], 1)
        if coordinates:
            uv = torch.where(self.textured[shape][:, None], (self.texcoords[corner] * weight).sum(1), barycentric)
        sign = 1 - 2 * self.flip[shape][:, None].to(o.dtype)
        return SurfacePoints(
            t, p0 + e1 * b1[:, None] + e2 * b2[:, None], normal * sign, shading * sign, uv, barycentric
        )

    def _on_quadrics(self, shape: torch.Tensor, o: torch.Tensor, d: torch.Tensor, near: torch.Tensor) -> SurfacePoints:
        matrix = self.to_world[shape]
        inverse = inverse_linear(matrix)
        sphere, cylinder = self.kind[shape] == SPHERE, self.kind[shape] == CYLINDER
        lo, ld = transform_vector(inverse, o - matrix[:, :3, 3]), transform_vector(inverse, d)
        # a cylinder is a sphere in two dimensions
        across = torch.stack([torch.ones_like(cylinder), torch.ones_like(cylinder), ~cylinder], 1).to(o.dtype)
        ao, ad = lo * across, ld * across
        a = dot(ad, ad)
        parallel = a == 0
        a = torch.where(parallel, 1.0, a)
        middle = -dot(ao, ad) / a
        left = 1 - dot(ao + ad * middle[:, None], ao + ad * middle[:, None])
        grazing = left <= 0
        half = torch.where(grazing, 0.0, torch.sqrt(torch.where(grazing, 1.0, left) / a))
        parallel = ld[:, 2] == 0
        plane = -lo[:, 2] / torch.where(parallel, 1.0, ld[:, 2])
        t = torch.where(sphere | cylinder, torch.where(near < middle, middle - half, middle + half), plane)
        local = lo + ld * t[:, None]
        height = torch.where(sphere | cylinder, local[:, 2], 0.0)
        local = torch.stack([local[:, 0], local[:, 1], height], 1)
        axis = local.new_tensor([0.0, 0.0, 1.0]).expand_as(local)
        up = torch.where((sphere | cylinder)[:, None], local * across, axis)
        normal = normalize(transform_normal(inverse, up))
        normal = normal * (1 - 2 * self.flip[shape][:, None].to(o.dtype))
        uv = curved_coordinates(local, sphere, cylinder)
        return SurfacePoints(t, transform_point(matrix, local), normal, normal, uv, uv)

    def _on_height_field(
        self, index: int, _primitive: torch.Tensor, o: torch.Tensor, d: torch.Tensor, near: torch.Tensor
    ) -> SurfacePoints:
        matrix, (heights, interpolation) = self.to_world[index], self.heights[index]
        inverse = inverse_linear(matrix)
        lo, ld = transform_vector(inverse, o - matrix[:3, 3]), transform_vector(inverse, d)

        def surface(t: torch.Tensor) -> tuple[torch.Tensor, ...]:
            local = lo + ld * t[:, None]
            uv = (local[:, :2] + 1) / 2
            return local, uv, *heightfield.evaluate(heights, uv, interpolation)

        # Newton's iteration from where it has converged: the first step makes first derivatives right, the second those
        # up to the third, the third those up to the seventh
        t = near.detach()
        for _ in range(3):
            local, _uv, z, z_u, z_v = surface(t)
            slope = ld[:, 2] - (z_u * ld[:, 0] + z_v * ld[:, 1]) / 2
            grazing = slope == 0
            t = t - torch.where(grazing, 0.0, (local[:, 2] - z) / torch.where(grazing, 1.0, slope))
        local, uv, z, z_u, z_v = surface(t)
        position = transform_point(matrix, torch.cat([local[:, :2], z[:, None]], 1))
        up = torch.stack([-z_u / 2, -z_v / 2, torch.ones_like(z)], 1)
        normal = normalize(transform_normal(inverse, up)) * (1 - 2 * self.flip[index].to(o.dtype))
        return SurfacePoints(t, position, normal, normal, uv, uv)

    def segments(self, index: int, primitive: torch.Tensor) -> Segments:
        """Of a curve the segments of these numbers."""
        points, radii, first, straight = self.curves[index]
        rows = first[primitive][:, None] + torch.tensor([0, 1, 1, 1] if straight else [0, 1, 2, 3], device=first.device)
        return Segments(points[rows], radii[rows], straight)

    def along_curve(self, index: int, primitive: torch.Tensor, b2: torch.Tensor) -> torch.Tensor:
        """The second texture coordinate (N,), which goes over all segments."""
        return (primitive + b2.clamp(0, 1)) / len(self.curves[index][2])

    def _on_curve(
        self, index: int, primitive: torch.Tensor, o: torch.Tensor, d: torch.Tensor, near: torch.Tensor
    ) -> SurfacePoints:
        segments = self.segments(index, primitive)
        t, b1, b2 = segments.meet(o, d, near)
        position, along, around = segments.evaluate(b1, b2)
        normal = normalize(torch.linalg.cross(around, along))
        uv = torch.stack([b1, self.along_curve(index, primitive, b2)], 1)
        return SurfacePoints(t, position, normal, normal, uv, torch.stack([b1, b2], 1))

    def _on_sdf_grid(
        self, index: int, primitive: torch.Tensor, o: torch.Tensor, d: torch.Tensor, near: torch.Tensor
    ) -> SurfacePoints:
        matrix, (grid, normals) = self.to_world[index], self.grids[index]
        inverse = inverse_linear(matrix)
        lo, ld = transform_vector(inverse, o - matrix[:3, 3]), transform_vector(inverse, d)
        cell, axis = sdfgrid.decode(grid, primitive)
        corner, n = sdfgrid.corners(grid, cell), sdfgrid.cell_counts(grid)
        t = near.detach()
        for _ in range(3):  # as on height fields
            value, slope = sdfgrid.interpolate(corner, (lo + ld * t[:, None]) * n - cell)
            change = dot(slope * n, ld)
            grazing = change == 0
            t = t - torch.where(grazing, 0.0, value / torch.where(grazing, 1.0, change))
        local = lo + ld * t[:, None]
        at = local * n - cell
        slope = sdfgrid.interpolate(corner, at)[1]
        sign = 1 - 2 * self.flip[index].to(o.dtype)
        normal = normalize(transform_normal(inverse, slope * n)) * sign
        shading = normal
        if normals == "smooth":
            shading = normalize(transform_normal(inverse, sdfgrid.smooth_gradient(grid, cell, at))) * sign
        others = (axis[:, None] + torch.tensor([1, 2], device=axis.device)) % 3
        place = at.gather(1, others)
        return SurfacePoints(t, transform_point(matrix, local), normal, shading, torch.zeros_like(place), place)


def _placed(matrix: torch.Tensor, center: torch.Tensor, radius: torch.Tensor) -> torch.Tensor:
    """`matrix` after moving and scaling the unit sphere."""
    # sums of products instead of matrix products, here and below: autocast leaves those their precision
    offset = (matrix[:, :3] * center).sum(1) + matrix[:, 3]
    return torch.cat([matrix[:, :3] * radius, offset[:, None]], 1)


def _along(matrix: torch.Tensor, p0: torch.Tensor, p1: torch.Tensor, radius: torch.Tensor) -> torch.Tensor:
    """`matrix` after moving the cylinder around the z axis from 0 to 1 to the segment from `p0` to `p1`."""
    axis = p1 - p0
    n = axis / torch.linalg.vector_norm(axis)
    # Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017
    sign = torch.where(n[2] < 0, -1.0, 1.0).to(n.dtype)
    a = -1 / (sign + n[2])
    b = n[0] * n[1] * a
    s = torch.stack([1 + sign * n[0] ** 2 * a, sign * b, -sign * n[0]])
    t = torch.stack([b, sign + n[1] ** 2 * a, -n[1]])
    local = torch.stack([s * radius, t * radius, axis, p0], 1)  # (3, 4)
    linear = (matrix[:3, :3, None] * local[None]).sum(1)
    top = torch.cat([linear[:, :3], (linear[:, 3] + matrix[:3, 3])[:, None]], 1)
    return torch.cat([top, matrix[3:]])


def curved_coordinates(local: torch.Tensor, sphere: torch.Tensor, cylinder: torch.Tensor | None = None) -> torch.Tensor:
    """Texture coordinates (N, 2) of points (N, 3) of the unit sphere, cylinder or disk.

    Those are azimuth and polar angle, azimuth and height, radius and azimuth. At the poles and the centre, where
    azimuths jump, derivatives are zero.
    """
    x, y, z = local.unbind(-1)
    square = x * x + y * y
    pole = square == 0
    radius = torch.where(pole, 0.0, torch.sqrt(torch.where(pole, 1.0, square)))
    phi = torch.where(pole, 0.0, torch.atan2(torch.where(pole, 0.0, y), torch.where(pole, 1.0, x))) / (2 * math.pi)
    phi = torch.where(phi < 0, phi + 1, phi)
    polar = torch.where(pole, torch.where(z < 0, math.pi, 0.0).to(z.dtype), torch.atan2(radius, z)) / math.pi
    if cylinder is None:
        cylinder = torch.zeros_like(sphere)
    second = torch.where(sphere, polar, torch.where(cylinder, z, phi))
    return torch.stack([torch.where(sphere | cylinder, phi, radius), second], -1)


def dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """(..., 3), (..., 3) -> (...)."""
    return (a * b).sum(-1)


def normalize(v: torch.Tensor, fallback: torch.Tensor | None = None) -> torch.Tensor:
    """Unit vectors (..., 3); `fallback`, else zero, with zero derivatives where the length is zero."""
    square = dot(v, v)[..., None]
    usable = square > 0
    unit = v / torch.sqrt(torch.where(usable, square, 1.0))
    return torch.where(usable, unit, torch.zeros_like(v) if fallback is None else fallback)


def transform_point(matrix: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
    """(N, 4, 4) or (4, 4) and (N, 3) -> (N, 3)."""
    return transform_vector(matrix, p) + matrix[..., :3, 3]


def transform_vector(matrix: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Vectors (..., 3) under the linear part of affine matrices (..., 4, 4)."""
    if matrix.ndim == 2:  # of all of them: column by column
        x, y, z = matrix[:3, :3].unbind(1)
        return v[..., :1] * x + v[..., 1:2] * y + v[..., 2:3] * z
    return (matrix[..., :3, :3] * v[..., None, :]).sum(-1)


def inverse_linear(matrix: torch.Tensor) -> torch.Tensor:
    """The inverse (..., 3, 3) of the linear part of affine matrices (..., 4, 4)."""
    a, b, c = matrix[..., :3, :3].unbind(-1)
    bc = torch.linalg.cross(b, c)
    rows = torch.stack([bc, torch.linalg.cross(c, a), torch.linalg.cross(a, b)], -2)
    return rows / dot(a, bc)[..., None, None]


def transform_normal(inverse: torch.Tensor, n: torch.Tensor) -> torch.Tensor:
    """Normals under the map whose inverse is given; not normalised."""
    return (inverse[..., :3, :3].transpose(-1, -2) * n[..., None, :]).sum(-1)
