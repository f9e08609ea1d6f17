"""What of a tree of BSDFs a hit is scattered by: csrc/core/integrator/layers.h, bsdf/{normalmap,bumpmap}.h and
shape/partials.h.

What is attached. The weights of the branches that were taken; the chances of taking them are not. A turned normal is an
attached function of the map, of where that is looked up, of the shading normal and of dp/du; so is what the shadowing
function leaves of light, and one of the direction of light besides.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..surface import dot, normalize
from .bsdf import luminance
from .bsdfs import BSDFS
from .geometry import Frame, Rows
from .partials import partials
from .textures import slopes
from .world import At, Record, World

LAYERS = ("twosided", "blendbsdf", "mask", "normalmap", "bumpmap")
CHOICES = ("blendbsdf", "mask")  # of which a random number takes a branch
LEAST_SQUARED_COSINE = 1e-6


@dataclass
class Layers(Rows):
    """The layers that N hits were found below.

    `leaf` (N,) is the number of the BSDF that scatters, that of the mask in its holes; `mirrored` (N,) whether it sees
    directions mirrored; `weight` (N,) the product of the weights of the branches, `inverse` (N,) that of 1 / chance;
    `turned` (N,) the number of a normal map, -1 where there is none, and `shadowed` (N,) whether it dims light; `base`
    and `normal` (N, 3) what it turned and what became of it, on the side that is shaded; `wanted` (N,) whether a
    branch was chosen that a derivative is wanted of.
    """

    leaf: torch.Tensor
    mirrored: torch.Tensor
    weight: torch.Tensor
    inverse: torch.Tensor
    turned: torch.Tensor
    shadowed: torch.Tensor
    base: torch.Tensor
    normal: torch.Tensor
    wanted: torch.Tensor

    def hides(self, w: torch.Tensor) -> torch.Tensor:
        """Where one of the two normals sees `w` (N, 3) from the other side."""
        if not bool((self.turned >= 0).any()):
            return torch.zeros_like(self.shadowed)
        return (self.turned >= 0) & (dot(self.base, w) * dot(self.normal, w) <= 0).detach()

    def dimmed(self, light: torch.Tensor) -> torch.Tensor:
        """What is left of light from `light` (N, 3): Estevez, Lecocq and Stein 2019, chapter 12."""
        if not bool(self.shadowed.any()):
            return torch.ones_like(self.weight)

        def tangent2(cosine: torch.Tensor) -> torch.Tensor:
            squared = (cosine * cosine).clamp(min=LEAST_SQUARED_COSINE)
            return (1 - squared).clamp(min=0.0) / squared

        alpha2 = (tangent2(dot(self.base, self.normal)) / 8).clamp(max=1.0)
        left = 2 / (1 + torch.sqrt(1 + alpha2 * tangent2(dot(self.base, light))))
        return torch.where(self.shadowed, left, 1.0)


def share(world: World, record: Record, at: At) -> torch.Tensor:
    """The weight (N,) of the second branch of a blend, or of what is there of a mask."""
    name = "weight" if record.type == "blendbsdf" else "opacity"
    return luminance(world.color("bsdf", record, name, at)).clamp(0.0, 1.0)


def find(
    world: World,
    bsdf: torch.Tensor,
    at: At,
    position: torch.Tensor,
    normal: torch.Tensor,
    d: torch.Tensor,
    u: torch.Tensor,
    *,
    viewed: bool,
    wanted: torch.Tensor,
) -> Layers:
    """The layers of hits with these BSDFs (N,) and normals (N, 3), found along d (N, 3) with the numbers u (N,).

    `viewed`: paths come from the camera. `wanted`, by BSDF: either branch has a chance, whatever its weight is.
    """
    behind = (dot(normal, d) > 0).detach()
    leaf, turned = bsdf.clone(), torch.full_like(bsdf, -1)
    mirrored, hole, chosen = (torch.zeros_like(behind) for _ in range(3))
    weight = inverse = torch.ones_like(d[:, 0]).detach()
    is_layer = torch.tensor([r.type in LAYERS for r in world.records["bsdf"]], dtype=torch.bool)
    while bool((waiting := is_layer[leaf] & ~hole).any()):
        number = int(leaf[waiting][0])
        record = world.records["bsdf"][number]
        rows = (waiting & (leaf == number)).nonzero()[:, 0]
        if record.type == "twosided":
            front, back = record.field["brdf_0"], record.field["brdf_1"]
            mirrored[rows] = behind[rows]
            leaf[rows] = torch.where(behind[rows], front if back < 0 else back, front)
        elif record.type in ("normalmap", "bumpmap"):
            turned[rows], leaf[rows] = number, record.field["nested_bsdf"]
        else:
            w = share(world, record, at[rows])
            q = 0.1 + 0.8 * w.detach() if bool(wanted[number]) else w.detach()
            chosen[rows] |= wanted[number]
            second = u[rows] < q
            chance = torch.where(second, q, 1 - q).clamp(min=1e-12)
            u = u.index_put((rows,), (torch.where(second, u[rows], u[rows] - q) / chance).clamp(max=1 - 1e-7))
            weight = weight.index_put((rows,), weight[rows] * torch.where(second, w, 1 - w))
            inverse = inverse.index_put((rows,), inverse[rows] / chance)
            if record.type == "blendbsdf":
                leaf[rows] = torch.where(second, record.field["bsdf_1"], record.field["bsdf_0"])
            else:
                leaf[rows] = torch.where(second, record.field["nested_bsdf"], number)
                hole[rows] = ~second
    for row, written in world.torch_bsdfs.items():
        if written.two_sided:
            mirrored |= (leaf == row) & behind
    side = torch.where(mirrored & (turned >= 0), -1.0, 1.0).to(normal)
    base = normal * side[:, None]
    normal, shadowed = base, torch.zeros_like(behind)
    for number in turned[turned >= 0].unique().tolist():
        record = world.records["bsdf"][number]
        rows = (turned == number).nonzero()[:, 0]
        along = partials(world, at[rows], position[rows])
        n = turn(world, record, at[rows], base[rows], side[rows], *along, -d[rows], viewed)
        normal = normal.index_put((rows,), n)
        shadowed[rows] = record.field["use_shadowing_function"] == 1
    return Layers(leaf, mirrored & (turned < 0), weight, inverse, turned, shadowed, base, normal, chosen)


def frames(world: World, found: Layers, at: At, position: torch.Tensor) -> Frame:
    """The frames of the BSDFs that were found, which those follow that are oriented by texture coordinates."""
    frame = Frame.about(found.normal)
    oriented = torch.tensor([BSDFS[r.type].oriented(r) for r in world.records["bsdf"]], dtype=torch.bool)
    rows = oriented[found.leaf].nonzero()[:, 0]
    if not len(rows):
        return frame
    along = frame[rows].along(partials(world, at[rows], position[rows])[0])
    return Frame(*(getattr(frame, axis).index_put((rows,), getattr(along, axis)) for axis in "stn"))


def turn(
    world: World,
    record: Record,
    at: At,
    z: torch.Tensor,
    side: torch.Tensor,
    du: torch.Tensor,
    dv: torch.Tensor,
    wi: torch.Tensor,
    viewed: bool,
) -> torch.Tensor:
    """The normals z (N, 3), those of the back where `side` (N,) is -1, as the map turns them."""
    if record.type == "normalmap":
        s = normalize(du - z * dot(z, du)[:, None])
        t = torch.linalg.cross(z, s) * side[:, None]
        x, y, up = (2 * world.color("bsdf", record, "normalmap", at, 3) - 1)[..., None].unbind(1)
        leaning, upwards = s * x + t * y, z * up
    else:
        n, scale = z * side[:, None], world.tensor("bsdf", record, "scale")
        hu, hv = slopes(world, world.records["texture"][record.field["nested_texture"]], at).unbind(1)
        a = du + n * (hu * scale - dot(n, du))[:, None]
        b = dv + n * (hv * scale - dot(n, dv))[:, None]
        m = normalize(torch.linalg.cross(a, b))
        up = dot(m, n)[:, None]
        leaning, upwards = (m - n * up) * torch.where(up.detach() < 0, -1.0, 1.0).to(up), z * up.abs()
    n = normalize(leaning + upwards)
    if not viewed or record.field["flip_invalid_normals"] == 0:
        return n
    hides = (dot(n, wi) * dot(z, wi) < 0).detach()
    return torch.where(hides[:, None], normalize(upwards - leaning), n)
