"""Which BSDF of a tree of them scatters at a hit, and with which normal.

The native counterparts are csrc/core/integrator/bsdf_stack.h, bsdf/{normalmap,bumpmap}.h and shape/partials.h.

What is attached. The weights of the branches that were taken; the probabilities of taking them are not. A perturbed
normal is an attached function of the map, of where that is looked up, of the shading normal and of dp/du; so is what
the shadowing function leaves of light, and one of the direction of light besides.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..scene.packing import Record
from ..surface import dot, normalize
from .bsdfs import BSDFS
from .color import luminance
from .geometry import Frame, Rows
from .partials import partials
from .textures import slopes
from .world import At, World

LAYERS = ("twosided", "blendbsdf", "mask", "normalmap", "bumpmap")
CHOICES = ("blendbsdf", "mask")  # of which a random number takes a branch
LEAST_SQUARED_COSINE = 1e-6


@dataclass
class BsdfStack(Rows):
    """What the BSDF at each of N hits was resolved to, and the layers around it.

    `resolved` (N,) is the number of the BSDF that scatters, that of the mask in its holes; `mirrored` (N,) whether it
    sees directions mirrored; `weight` (N,) the product of the weights of the branches, `inverse` (N,) that of their
    inverse probabilities; `perturbed` (N,) the number of a normal map, -1 where there is none, and `shadowed` (N,)
    whether it dims light; `base` and `normal` (N, 3) the normal before and after, on the side that is shaded;
    `needs_grad` (N,) whether a branch was chosen whose weight needs a gradient.
    """

    resolved: torch.Tensor
    mirrored: torch.Tensor
    weight: torch.Tensor
    inverse: torch.Tensor
    perturbed: torch.Tensor
    shadowed: torch.Tensor
    base: torch.Tensor
    normal: torch.Tensor
    needs_grad: torch.Tensor

    def hides(self, w: torch.Tensor) -> torch.Tensor:
        """Where one of the two normals sees `w` (N, 3) from the other side."""
        if not bool((self.perturbed >= 0).any()):
            return torch.zeros_like(self.shadowed)
        return (self.perturbed >= 0) & (dot(self.base, w) * dot(self.normal, w) <= 0).detach()

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
    """The weight (N,) of the second branch of a blend, or the opacity of a mask."""
    name = "weight" if record.type == "blendbsdf" else "opacity"
    return luminance(world.color("bsdf", record, name, at)).clamp(0.0, 1.0)


def resolve(
    world: World,
    bsdf: torch.Tensor,
    at: At,
    position: torch.Tensor,
    normal: torch.Tensor,
    d: torch.Tensor,
    u: torch.Tensor,
    *,
    viewed: bool,
    needs_grad: torch.Tensor,
) -> BsdfStack:
    """The layers of hits with these BSDFs (N,) and normals (N, 3), found along d (N, 3) with the numbers u (N,).

    `viewed`: paths come from the camera. `needs_grad`, by BSDF: either branch is taken with a positive probability,
    whatever its weight is.
    """
    behind = (dot(normal, d) > 0).detach()
    resolved, perturbed = bsdf.clone(), torch.full_like(bsdf, -1)
    mirrored, hole, chosen = (torch.zeros_like(behind) for _ in range(3))
    weight = inverse = torch.ones_like(d[:, 0]).detach()
    is_layer = torch.tensor([r.type in LAYERS for r in world.records["bsdf"]], dtype=torch.bool)
    while bool((waiting := is_layer[resolved] & ~hole).any()):
        number = int(resolved[waiting][0])
        record = world.records["bsdf"][number]
        rows = (waiting & (resolved == number)).nonzero()[:, 0]
        if record.type == "twosided":
            front, back = record.field["brdf_0"], record.field["brdf_1"]
            mirrored[rows] = behind[rows]
            resolved[rows] = torch.where(behind[rows], front if back < 0 else back, front)
        elif record.type in ("normalmap", "bumpmap"):
            perturbed[rows], resolved[rows] = number, record.field["nested_bsdf"]
        else:
            w = share(world, record, at[rows])
            q = 0.1 + 0.8 * w.detach() if bool(needs_grad[number]) else w.detach()
            chosen[rows] |= needs_grad[number]
            second = u[rows] < q
            chance = torch.where(second, q, 1 - q).clamp(min=1e-12)
            u = u.index_put((rows,), (torch.where(second, u[rows], u[rows] - q) / chance).clamp(max=1 - 1e-7))
            weight = weight.index_put((rows,), weight[rows] * torch.where(second, w, 1 - w))
            inverse = inverse.index_put((rows,), inverse[rows] / chance)
            if record.type == "blendbsdf":
                resolved[rows] = torch.where(second, record.field["bsdf_1"], record.field["bsdf_0"])
            else:
                resolved[rows] = torch.where(second, record.field["nested_bsdf"], number)
                hole[rows] = ~second
    for row, written in world.torch_bsdfs.items():
        if written.two_sided:
            mirrored |= (resolved == row) & behind
    side = torch.where(mirrored & (perturbed >= 0), -1.0, 1.0).to(normal)
    base = normal * side[:, None]
    normal, shadowed = base, torch.zeros_like(behind)
    for number in perturbed[perturbed >= 0].unique().tolist():
        record = world.records["bsdf"][number]
        rows = (perturbed == number).nonzero()[:, 0]
        along = partials(world, at[rows], position[rows])
        n = perturb(world, record, at[rows], base[rows], side[rows], *along, -d[rows], viewed)
        normal = normal.index_put((rows,), n)
        shadowed[rows] = record.field["use_shadowing_function"] == 1
    return BsdfStack(resolved, mirrored & (perturbed < 0), weight, inverse, perturbed, shadowed, base, normal, chosen)


def frames(world: World, found: BsdfStack, at: At, position: torch.Tensor) -> Frame:
    """The frames of the BSDFs that were found, which those follow that are oriented by texture coordinates."""
    frame = Frame.about(found.normal)
    oriented = torch.tensor([BSDFS[r.type].oriented(r) for r in world.records["bsdf"]], dtype=torch.bool)
    rows = oriented[found.resolved].nonzero()[:, 0]
    if not len(rows):
        return frame
    along = frame[rows].along(partials(world, at[rows], position[rows])[0])
    return Frame(*(getattr(frame, axis).index_put((rows,), getattr(along, axis)) for axis in "stn"))


def perturb(
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
