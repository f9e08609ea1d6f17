"""Which outlines a camera may see: pieces of edges, contours and rims, and points on them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from ..surface import CYLINDER, DISK, MESH, SPHERE, Surfaces, inverse_linear, transform_point, transform_vector
from ..wavefront.geometry import Rows
from .edges import Edges, EdgeTable, edge_table
from .tree import ALWAYS, CREASE, EDGE, ELEMENT, ROUND, elements

PIXELS = 16.0  # length of a piece on the film
MOST = 256  # pieces of an edge or contour
HOLLOW = 0.1  # weight of edges that can be seen from behind only
CONTOUR, RIM, LOWER_RIM, UPPER_RIM, LEFT_LINE, RIGHT_LINE = range(6)
CURVES_OF = {SPHERE: (CONTOUR,), DISK: (RIM,), CYLINDER: (LOWER_RIM, UPPER_RIM, LEFT_LINE, RIGHT_LINE)}


@dataclass
class Viewpoint:
    """Where rays of a camera come from: a `point` (3,) with a lens of a `radius` around it, or a `direction` (3,)."""

    point: torch.Tensor | None
    direction: torch.Tensor
    radius: float = 0.0

    def towards(self, points: torch.Tensor) -> torch.Tensor:
        """Vectors from the camera to points (N, 3)."""
        return self.direction.expand_as(points) if self.point is None else points - self.point


@dataclass
class Pieces(Rows):
    """Parts of outlines: what they are part of, their interval of its parameter, and their weights when one is chosen.

    `edge` is a row of the edges, or -1; of a quadric then `shape` and `curve` (CONTOUR ...) say which outline it is.
    """

    edge: torch.Tensor
    shape: torch.Tensor
    curve: torch.Tensor
    begin: torch.Tensor
    end: torch.Tensor
    weight: torch.Tensor


@dataclass
class OutlinePoints(Rows):
    """Points on outlines: `position` (N, 3), which may be attached; its derivative by the parameter, `along` (N, 3).

    `valid`: there is one, and an outline or a crease it is. `front` (N,): 1 where what hides something is on the side
    of (direction of the ray) x `along`, -1 where on the other, 0 of creases, which hide nothing. `room` (N,): how far
    across the ray the faces beside an edge reach; `rim` (N,): how far across it, in front, interpolated normals look
    away.
    """

    position: torch.Tensor
    along: torch.Tensor
    valid: torch.Tensor
    front: torch.Tensor
    room: torch.Tensor
    rim: torch.Tensor


class Outlines:
    """The outlines of a scene's surfaces.

    Args:
        surfaces: the scene's, attached to parameters.
        table: the edges as they were found before, if they still hold.
        moves: (S,) bool, which shapes' outlines are wanted.
    """

    def __init__(self, surfaces: Surfaces, table: EdgeTable | None, moves: torch.Tensor) -> None:
        self.surfaces = surfaces
        self.positions = surfaces.positions.detach()
        if table is None or not table.holds(self.positions):
            table = edge_table(surfaces.faces, self.positions)
        self.table = table
        self.edges = _joined(table.plain, table.fans) if len(table.fans) else table.plain
        self.curves = [(i, c) for i, kind in enumerate(surfaces.kind.tolist()) for c in CURVES_OF.get(kind, ())]
        self.moves = moves
        meshes = (surfaces.kind == MESH).nonzero()[:, 0]
        begins = surfaces.first_face[meshes].contiguous()
        faces = torch.arange(len(surfaces.faces))
        self.shape_of_face = meshes[torch.searchsorted(begins, faces, right=True) - 1] if len(meshes) else faces
        corner = self.positions[surfaces.faces]
        normal = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        self.face_normals = torch.nn.functional.normalize(normal, dim=1)

    def candidates(self, view: Viewpoint) -> tuple[Edges, torch.Tensor]:
        """Edges of meshes that can be outlines or creases from there, and a weight for each.

        Creases, of which both faces are seen, are those where normals, materials or texture coordinates jump.
        """
        edges = self.edges.rows(self.moves[self.shape_of_face[self.edges.face]].any(1))
        n0, n1 = self.face_normals[edges.face[:, 0]], self.face_normals[edges.face[:, 1]]
        towards = view.towards(self.positions[edges.v0[:, 0]])
        s0, s1 = (n0 * towards).sum(1), (n1 * towards).sum(1)
        margin = view.radius + 1e-6 * torch.linalg.vector_norm(towards, dim=1)
        same = ((s0 > margin) & (s1 > margin)) | ((s0 < -margin) & (s1 < -margin))
        split, flat = self._jumps(edges)
        bend = 1 - (n0 * n1).sum(1)
        flat = flat & (bend > 1e-6)
        crease = torch.where(split | flat, bend.clamp(0.05, 1.0), torch.zeros_like(bend))
        weight = torch.where((edges.count != 2) | ~same, torch.ones_like(bend), crease)
        kept = weight > 0
        return edges.rows(kept), weight[kept]

    def _jumps(self, edges: Edges) -> tuple[torch.Tensor, torch.Tensor]:
        """Whether faces have vertices or shapes of their own at an edge, and whether they are shaded flat."""
        shape = self.shape_of_face[edges.face]
        split = (edges.v0 != edges.v0[:, :1]).any(1) | (edges.v1 != edges.v1[:, :1]).any(1)
        return split | (shape != shape[:, :1]).any(1), ~self.surfaces.smooth[shape[:, 0]]

    def all(self) -> tuple[Edges, torch.Tensor]:
        """Edges that can be outlines or creases from somewhere, and elements (E, 17) of a tree of them, see tree.py."""
        edges = self.edges
        n0, n1 = self.face_normals[edges.face[:, 0]], self.face_normals[edges.face[:, 1]]
        bend = (1 - (n0 * n1).sum(1)).clamp(min=0.0)
        split, flat = self._jumps(edges)
        kept = ((bend > 1e-7) | split | (edges.count != 2)).nonzero()[:, 0]
        edges, n0, n1, bend, split, flat = edges.rows(kept), n0[kept], n1[kept], bend[kept], split[kept], flat[kept]
        a, b = self.positions[edges.v0[:, 0]], self.positions[edges.v1[:, 0]]
        hollow = (n0 * (self.positions[edges.third[:, 1]] - a)).sum(1) > 0
        weight = torch.where(hollow & (edges.count == 2), HOLLOW, 1.0)
        kind = torch.where(edges.count == 2, torch.where(split | flat, CREASE, EDGE), ALWAYS)
        bend = torch.where(split, bend.clamp(min=0.05), bend)
        return edges, elements(a, b, n0, n1, weight, bend, kind, torch.full_like(kind, -2))

    def quadrics(self) -> torch.Tensor:
        """The elements of all contours, rims and lines of quadrics, in the order of `curves`, (shape, curve) each."""
        if not self.curves:
            return torch.zeros(0, ELEMENT)
        shape, curve = torch.tensor(self.curves).T
        matrix = self.surfaces.to_world[shape].detach()
        x, y, z, place = matrix[:, :3].unbind(2)
        upper = (curve == UPPER_RIM)[:, None]
        radius = torch.linalg.matrix_norm(matrix[:, :3, :3], 2)
        across = torch.maximum(torch.linalg.vector_norm(x, dim=1), torch.linalg.vector_norm(y, dim=1))
        radius = torch.where(curve == CONTOUR, radius, across)
        line = curve >= LEFT_LINE  # somewhere on the cylinder: around its axis
        size = torch.where(line, radius + 0.5 * torch.linalg.vector_norm(z, dim=1), radius)
        centre = torch.where(line[:, None], place + 0.5 * z, torch.where(upper, place + z, place))
        zero = torch.zeros_like(place)
        end = torch.cat([size[:, None], zero[:, :2]], 1)
        ones = torch.ones_like(size)
        weight = torch.where(line, 0.3, 1.0).to(size)
        return elements(centre, end, zero, zero, weight, ones, torch.full_like(shape, ROUND), shape)

    def whole(self, view: Viewpoint) -> tuple[Edges, Pieces]:
        """All outlines uncut: candidate edges, and contours and rims of quadrics that move."""
        edges, weight = self.candidates(view)
        n = len(edges)
        quadrics = [(shape, curve) for shape, curve in self.curves if bool(self.moves[shape])]
        zero, none = torch.zeros(n + len(quadrics), dtype=weight.dtype), torch.full((n + len(quadrics),), -1)
        edge, shape, curve = none.clone(), none.clone(), none.clone()
        edge[:n] = torch.arange(n)
        if quadrics:
            shape[n:], curve[n:] = torch.tensor(quadrics).T
        ones = torch.ones(len(quadrics), dtype=weight.dtype)
        return edges, Pieces(edge, shape, curve, zero, zero + 1, torch.cat([weight, ones]))

    def points(
        self, edges: Edges, pieces: Pieces, s: torch.Tensor, origin: torch.Tensor, parallel: bool, exact: bool = True
    ) -> OutlinePoints:
        """Points at parameters s (N,) of the outlines that pieces belong to.

        Args:
            origin: (N, 3) where rays come from, or, `parallel`, their directions.
            exact: whether what is no outline from there, nor a crease, is told apart.
        """
        on_edge, rest = (pieces.edge >= 0).nonzero()[:, 0], (pieces.edge < 0).nonzero()[:, 0]
        rows, found = [on_edge, rest], []
        found.append(self._on_edges(edges.rows(pieces.edge[on_edge]), s[on_edge], origin[on_edge], parallel, exact))
        found.append(
            self._on_quadrics(pieces.shape[rest], pieces.curve[rest], s[rest], origin[rest].detach(), parallel)
        )
        back = torch.argsort(torch.cat(rows))
        return OutlinePoints.cat(found)[back]

    def _on_edges(
        self, edges: Edges, s: torch.Tensor, origin: torch.Tensor, parallel: bool, exact: bool
    ) -> OutlinePoints:
        there = (torch.arange(edges.v0.shape[1]) < edges.count[:, None]).to(s.dtype)[..., None]
        share = there / edges.count[:, None, None]  # copies of a vertex share its motion
        a, b = ((self.surfaces.positions[v] * share).sum(1) for v in (edges.v0, edges.v1))
        position, along = a + (b - a) * s[:, None], (b - a).detach()
        valid, front, room = torch.ones_like(s, dtype=torch.bool), torch.zeros_like(s), torch.full_like(s, math.inf)
        rim = torch.zeros_like(s)
        if exact:  # all faces on one side of the plane through ray and edge; or a crease, whatever its sides
            towards = origin if parallel else position.detach() - origin
            across = torch.linalg.cross(towards, along)
            third = self.positions[edges.third] - a.detach()[:, None]
            side = (third * across[:, None]).sum(2)
            right, left = (side > 0).any(1), (side < 0).any(1)
            split, flat = self._jumps(edges)
            valid = ~(right & left) | split | flat
            front = torch.where(right & left, 0.0, right.to(s) - left.to(s))
            reach = side.abs() / torch.linalg.vector_norm(across, dim=1).clamp(min=1e-30)[:, None]
            room = reach.amin(1)
            if bool(self.surfaces.smooth.any()):
                rim = torch.where(front != 0, self._rim(edges, s, towards, reach), 0.0)
        return OutlinePoints(position, along, valid, front, room, rim)

    def _rim(self, edges: Edges, s: torch.Tensor, towards: torch.Tensor, reach: torch.Tensor) -> torch.Tensor:
        """How far across rays, on faces that are seen, interpolated normals look away from where these come from.

        There a surface is black although it is seen. That ends at a line on the face, which moves about like the edge,
        and what is beyond is what the edge's motion uncovers.
        """
        normals = self.surfaces.normals.detach()
        seen = (self.face_normals[edges.face] * towards[:, None]).sum(2) < 0
        first = seen.to(s).argmax(1)
        row = torch.arange(len(s))
        v0, v1, third = (x[row, first] for x in (edges.v0, edges.v1, edges.third))
        at_edge = ((normals[v0] * (1 - s[:, None]) + normals[v1] * s[:, None]) * towards).sum(1)
        inside = (normals[third] * towards).sum(1)
        share = torch.where(at_edge > 0, at_edge / (at_edge - inside.clamp(max=0.0)).clamp(min=1e-30), 0.0)
        smooth = self.surfaces.smooth[self.shape_of_face[edges.face[row, first]]] & seen.any(1)
        return torch.where(smooth, share.clamp(max=1.0) * reach[row, first], 0.0)

    def _on_quadrics(
        self, shape: torch.Tensor, curve: torch.Tensor, s: torch.Tensor, origin: torch.Tensor, parallel: bool
    ) -> OutlinePoints:
        matrix = self.surfaces.to_world[shape]
        plain = matrix.detach()
        inverse = inverse_linear(plain)
        o = transform_vector(inverse, origin if parallel else origin - plain[:, :3, 3])
        round_, line = curve == CONTOUR, curve >= LEFT_LINE
        flat = torch.where(round_[:, None], o, o * o.new_tensor([1.0, 1.0, 0.0]))  # of a cylinder across its axis
        square = (flat * flat).sum(1)
        valid = square > 0 if parallel else (square > 1) | ~(round_ | line)
        length = torch.where(valid, square, torch.ones_like(square)).sqrt()[:, None]
        axis = flat / length
        # the circle (pair of points) of tangency: its centre and radius
        near = (
            torch.zeros_like(length) if parallel else torch.where(valid[:, None], 1 / length, torch.zeros_like(length))
        )
        radius = (1 - near * near).clamp(min=0.0).sqrt()
        sign = torch.where(axis[:, 2:] < 0, -1.0, 1.0).to(axis.dtype)  # Duff et al. 2017
        a = -1 / (sign + axis[:, 2:])
        b = axis[:, :1] * axis[:, 1:2] * a
        u = torch.cat([1 + sign * axis[:, :1] ** 2 * a, sign * b, -sign * axis[:, :1]], 1)
        v = torch.cat([b, sign + axis[:, 1:2] ** 2 * a, -axis[:, 1:2]], 1)
        phi = 2 * math.pi * s[:, None]
        zero, one = torch.zeros_like(phi), torch.ones_like(phi)
        contour = axis * near + (u * phi.cos() + v * phi.sin()) * radius
        around = (v * phi.cos() - u * phi.sin()) * radius * (2 * math.pi)
        height = (curve == UPPER_RIM).to(s.dtype)[:, None]
        rim = torch.cat([phi.cos(), phi.sin(), height], 1)
        along_rim = torch.cat([-phi.sin(), phi.cos(), zero], 1) * (2 * math.pi)
        across = torch.cat([-axis[:, 1:2], axis[:, :1], zero], 1) * torch.where(curve == LEFT_LINE, 1.0, -1.0)[
            :, None
        ].to(s)
        side = axis * near + across * radius + torch.cat([zero, zero, s[:, None]], 1)
        local = torch.where(round_[:, None], contour, torch.where(line[:, None], side, rim))
        along = torch.where(
            round_[:, None], around, torch.where(line[:, None], torch.cat([zero, zero, one], 1), along_rim)
        )
        position, tangent = transform_point(matrix, local), transform_vector(plain, along)
        with torch.no_grad():
            inwards = transform_vector(plain, local * local.new_tensor([-1.0, -1.0, 0.0]))
            middle = torch.where(round_[:, None], transform_vector(plain, -local), inwards)
            towards = origin if parallel else position - origin
            front = torch.sign((torch.linalg.cross(towards, tangent) * middle).sum(1))
        return OutlinePoints(position, tangent, valid, front, torch.full_like(s, math.inf), torch.zeros_like(s))


def _joined(a: Edges, b: Edges) -> Edges:
    """Both, as wide as the wider."""
    width = max(a.v0.shape[1], b.v0.shape[1])

    def padded(x: torch.Tensor) -> torch.Tensor:
        return torch.cat([x, x[:, :1].expand(-1, width - x.shape[1])], 1)

    def both(name: str) -> torch.Tensor:
        return torch.cat([padded(getattr(a, name)), padded(getattr(b, name))])

    return Edges(both("v0"), both("v1"), both("third"), both("face"), torch.cat([a.count, b.count]))
