"""A lens of glass whose index varies, by a few coefficients: sharper than one of plain glass.

    python tutorials/grin_lens.py

A singlet has two spherical surfaces and a rim. Plain glass leaves it spherical aberration, coma and a curved image;
an index n(r, z) that falls from the axis outwards can undo much of that. We look for five coefficients of

    n = 1.6 + a r^2 + b r^4 + c r^6 + z (d + e r^2)

and both curvatures, so that parallel light of three field angles comes to three points of a plane: the loss is the
mean square of the spots' radii. That is least squares with seven unknowns, and L-BFGS needs some dozen steps. Plain
glass gets the same start and as many steps for its two curvatures.

How much there is to gain depends on the field. Spots of up to 2 degrees, as here, become 11 times sharper than those of
the best plain glass, since it is spherical aberration and coma that blur them; of up to 4 degrees 3 times, of up to 6
degrees 1.6 times, as the curved image of a single lens remains.

Coefficients become a grid, and curvatures a closed mesh with normals, by operations of PyTorch, and both reach
`tr.gradientindex.trace` by `params=`; autograd does the rest. Refraction is by the normals of the vertices, those of
the true spheres, so that facets matter little.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import torch
from bent_rays import coordinates, cube, disk
from command_line import at_least_one, given, reported
from pictures import save_curves

import torchrender as tr

AXIS_INDEX = 1.6
APERTURE, STOP = 1.0, 0.85  # radii of the glass, of the beams
THICKNESS = 0.6  # on the axis
PLANE = 4.0  # where the picture is, from the middle of the lens
ANGLES = (0.0, 1.0, 2.0)  # degrees off the axis
NAMES = ("r²", "r⁴", "r⁶", "z", "z r²", "curvature 1", "curvature 2")
START = (0.0, 0.0, 0.0, 0.0, 0.0, 0.22, -0.22)
# What real glass allows, and two faces that do not cross within the aperture.
LIMITS = torch.tensor([0.15] * 5 + [0.45] * 2, dtype=torch.float64)
INDEX = "lens.interior_medium.index"


class Mesh:
    """The surface of a lens: rings around the axis on both faces, the last ones joined by the rim."""

    def __init__(self, rings: int, sectors: int) -> None:
        # A ring is also there twice at the edge, once with the normals of a face, once with those of the rim.
        self.radius = (torch.arange(rings, dtype=torch.float64) + 1) / rings * APERTURE
        angle = torch.arange(sectors, dtype=torch.float64) * (2 * math.pi / sectors)
        self.turn = torch.stack([torch.cos(angle), torch.sin(angle)], 1)
        ring = torch.arange(sectors)
        following = (ring + 1) % sectors

        def band(a: int, b: int) -> torch.Tensor:
            """Triangles between the rings that begin at a and b, facing +z if b is outside."""
            one = torch.stack([a + ring, b + ring, b + following], 1)
            return torch.cat([one, torch.stack([a + ring, b + following, a + following], 1)])

        centre = torch.stack([torch.zeros_like(ring), 1 + ring, 1 + following], 1)
        face = torch.cat([centre, *(band(1 + k * sectors, 1 + (k + 1) * sectors) for k in range(rings - 1))])
        count = 1 + rings * sectors
        rim = band(2 * count, 2 * count + sectors)
        self.faces = torch.cat([face.flip(1), face + count, rim.flip(1)])  # light comes from -z

    def __call__(self, first: torch.Tensor, second: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Vertices and normals (V, 3) of two faces of these curvatures."""
        parts, normals, rims = [], [], []
        for curvature, side in ((first, -1.0), (second, 1.0)):
            r = torch.cat([self.radius.new_zeros(1), self.radius])
            cosine = torch.sqrt(1 - (curvature * r) ** 2)
            z = side * THICKNESS / 2 + curvature * r * r / (1 + cosine)
            slope = curvature * r / cosine
            up = side * torch.stack([-slope, torch.ones_like(r)], 1) * cosine[:, None]
            for values, into in ((torch.stack([r, z], 1), parts), (up, normals)):
                ring = torch.cat(
                    [values[1:, None, :1] * self.turn, values[1:, None, 1:].expand(-1, len(self.turn), 1)], 2
                )
                into += [torch.stack([0 * values[0, 0], 0 * values[0, 0], values[0, 1]])[None], ring.reshape(-1, 3)]
            rims.append(parts[-1][-len(self.turn) :])
        outward = torch.nn.functional.pad(self.turn, (0, 1))
        vertices = torch.cat([*parts, *rims])
        return vertices.float(), torch.cat([*normals, outward, outward]).float()


def grid_of(values: torch.Tensor, size: int) -> torch.Tensor:
    """Samples (size, size, size) of the index in a cube of side 2.2."""
    x, y, z = (c.double() for c in coordinates(size, 1.1))
    square = (x * x + y * y).clamp(max=1.2)  # beyond the glass it does not matter
    a, b, c, d, e = values[:5]
    return (AXIS_INDEX + square * (a + square * (b + square * c)) + z * (d + e * square)).float()


def beams(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Origins and directions (angles, count, 3) of parallel light through the stop, at the middle of the lens."""
    angle = torch.deg2rad(torch.tensor(ANGLES))
    directions = torch.stack([torch.zeros_like(angle), torch.sin(angle), torch.cos(angle)], 1)
    points = torch.nn.functional.pad(STOP * disk(count), (0, 1))
    directions = directions[:, None].expand(-1, count, 3)
    return points - 2 * directions / directions[..., 2:], directions


class Lens:
    """The scene, and where light meets the plane for given coefficients and curvatures."""

    def __init__(self, voxels: int, rings: int, sectors: int, rays: int, step: float) -> None:
        self.voxels, self.mesh, self.rays = voxels, Mesh(rings, sectors), beams(rays)
        vertices, normals = self.mesh(torch.tensor(START[5]), torch.tensor(START[6]))
        # Light comes from vacuum; the index inside is the grid's.
        medium = {"type": "gradientindex", "index": AXIS_INDEX, "to_world": cube(1.1), "ext_ior": 1.0, "step": step}
        lens = tr.Mesh(vertices, self.mesh.faces, vertex_normals=normals, bsdf={"type": "dielectric"}, interior=medium)
        self.scene = tr.load_dict({"type": "scene", "lens": lens})

    def params(self, values: torch.Tensor) -> dict[str, torch.Tensor]:
        """What the scene is to have for these coefficients and curvatures."""
        vertices, normals = self.mesh(values[5], values[6])
        index = tr.gradientindex.fit(grid_of(values, self.voxels))
        return {"lens.vertex_positions": vertices, "lens.vertex_normals": normals, INDEX: index}

    def spots(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(angles, rays, 2): where rays meet the plane, from the middle of their spot; (angles, rays, 1): whether."""
        origins, directions = (x.reshape(-1, 3) for x in self.rays)
        found = tr.gradientindex.trace(self.scene, "lens", origins, directions, params=self.params(values))
        along = torch.where(found.valid, found.direction[:, 2], 1.0)
        t = (PLANE - found.position[:, 2]) / along
        at = found.position[:, :2] + t[:, None] * found.direction[:, :2]
        at, valid = at.reshape(len(ANGLES), -1, 2), found.valid.reshape(len(ANGLES), -1, 1)
        middle = (at * valid).sum(1, True) / valid.sum(1, True)
        return (at - middle) * valid, valid

    def squares(self, values: torch.Tensor) -> torch.Tensor:
        """(angles,): the mean squared distance of rays from the middle of their spot."""
        at, valid = self.spots(values)
        return at.square().sum(2).sum(1) / valid.sum(1)[:, 0]


def optimise(lens: Lens, values: torch.Tensor, free: list[int], iterations: int) -> tuple[torch.Tensor, list[float]]:
    """L-BFGS over some of the values; the best ones, and the loss after every step."""
    limits = LIMITS[free]
    moved = torch.atanh(values[free] / limits).requires_grad_()  # no bounds for the optimiser
    optimiser = torch.optim.LBFGS([moved], max_iter=10, history_size=20, line_search_fn="strong_wolfe")
    curve: list[float] = []

    def whole() -> torch.Tensor:
        return values.index_put((torch.tensor(free),), limits * torch.tanh(moved))

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        loss = torch.log(lens.squares(whole()).mean())
        loss.backward()
        return loss

    for _ in tr.progress(range(iterations), desc="lens"):
        curve.append(math.sqrt(math.exp(optimiser.step(closure).item())))
    return whole().detach(), curve


def save_spots(spots: dict[str, torch.Tensor], path: Path) -> None:
    """Draw spot diagrams, a row for each lens, with its own scale."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(len(spots), len(ANGLES), figsize=(9, 3 * len(spots)), layout="constrained")
    for row, (name, at) in zip(axes, spots.items(), strict=True):
        reach = 1.1 * float(at.abs().max())
        for axis, angle, points in zip(row, ANGLES, at, strict=True):
            rms = points.square().sum(1).mean().sqrt()
            axis.scatter(points[:, 0], points[:, 1], s=2)
            axis.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
            axis.set_title(f"{name}, {angle:g}°: rms {rms:.2g}", fontsize=9)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def save_lens(lens: Lens, values: torch.Tensor, path: Path) -> None:
    """Draw the index within the lens and a few rays, whose ways inside are drawn straight.

    The rays are a little off the plane x = 0, where edges of triangles lie.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    first, second = values[5], values[6]
    y, z = torch.meshgrid(torch.linspace(-1, 1, 201).double(), torch.linspace(-1, 1, 201).double(), indexing="ij")
    faces = [
        side * THICKNESS / 2 + c * y * y / (1 + torch.sqrt(1 - (c * y) ** 2)) for c, side in ((first, -1), (second, 1))
    ]
    points = (torch.stack([0 * y, y, z], -1).float() / 1.1 + 1) / 2
    n, _ = tr.gradientindex.evaluate(tr.gradientindex.fit(grid_of(values, lens.voxels)), points)
    n = torch.where((z > faces[0]) & (z < faces[1]), n, torch.nan)
    figure, axis = pyplot.subplots(figsize=(9, 4), layout="constrained")
    image = axis.imshow(n, origin="lower", extent=(-1, 1, -1, 1))
    heights = torch.linspace(-STOP, STOP, 9)
    for angle, colour in zip(ANGLES, ("tab:blue", "tab:orange", "tab:green"), strict=False):
        slope = math.tan(math.radians(angle))
        origins = torch.stack([torch.full((9,), 1e-3), heights - slope, torch.full((9,), -1.0)], 1)
        directions = torch.tensor([0.0, slope, 1.0]).expand(9, 3)
        params = lens.params(values)
        found = tr.gradientindex.trace(lens.scene, "lens", origins, directions, params=params)
        params.pop(INDEX)
        entry = tr.ray_intersect(lens.scene, origins, directions, params=params).position
        plane = found.position + (PLANE - found.position[:, 2:]) / found.direction[:, 2:] * found.direction
        ways = torch.stack([origins, entry, found.position, plane], 1)
        for way in ways:
            axis.plot(way[:, 2], way[:, 1], color=colour, linewidth=0.7)
    axis.axvline(PLANE, color="black", linewidth=0.7)
    axis.set(xlim=(-1, PLANE + 0.1), ylim=(-1.1, 1.1), aspect="equal")
    figure.colorbar(image, ax=axis, shrink=0.8, label="index")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def run(
    folder: Path,
    *,
    voxels: int = 33,
    rings: int = 64,
    sectors: int = 192,
    rays: int = 500,
    step: float = 1.0,
    iterations: int = 12,
) -> dict[str, float]:
    """The whole program; returns root mean squares of the spots: at the start, of plain glass and of a varying index.

    Args:
        folder: where pictures and the index go.
        voxels: of the grid along a side.
        rings, sectors: triangles of either face from the axis outwards and around it.
        rays: of each field angle.
        step: the longest step of a ray in voxels.
        iterations: times ten steps of L-BFGS.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lens = Lens(voxels, rings, sectors, rays, step)
    start = torch.tensor(START, dtype=torch.float64)
    plain, first = optimise(lens, start, [5, 6], iterations)
    graded, second = optimise(lens, start, list(range(7)), iterations)
    lenses = {"start": start, "plain glass": plain, "varying index": graded}
    with torch.no_grad():
        result = {name: lens.squares(values).mean().sqrt().item() for name, values in lenses.items()}
        save_spots({name: lens.spots(values)[0] for name, values in lenses.items()}, folder / "spots.png")
        index = tr.gradientindex.fit(grid_of(graded, voxels))
    save_curves({"plain glass": first, "varying index": second}, folder / "loss.png", "Radius of the spots (rms)")
    tr.io.write_volume(folder / "index.vol", index[..., None])
    with torch.no_grad():
        save_lens(lens, graded, folder / "lens.png")
    for name, value in result.items():
        print(f"{name}: spots of {value:.2e} (rms), {result['plain glass'] / value:.1f} times sharper than plain glass")
    print(", ".join(f"{name}: {value:.4f}" for name, value in zip(NAMES, graded.tolist(), strict=True)))
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--iterations", type=at_least_one, help="times ten steps of L-BFGS (default 12)")
    parser.add_argument("--output", type=Path, default=Path("output/grin_lens"), help="folder for the results")
    options = parser.parse_args(argv)
    with reported(parser, "results", options.output):
        run(options.output, **given(options, "iterations"))


if __name__ == "__main__":
    main()
