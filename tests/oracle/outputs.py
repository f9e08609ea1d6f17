"""Outputs of the first hit: depth, normals, coordinates and albedo, averaged over the samples that hit something."""

from __future__ import annotations

from collections.abc import Mapping

import torch

import torchrender as tr
from torchrender.surface import dot, normalize
from torchrender.wavefront.layers import share
from torchrender.wavefront.world import At, Record

from .film import camera_samples, splat
from .world import World

# The textures that are the output `albedo` of BSDFs; of others it is white.
ALBEDO = {
    "diffuse": "reflectance",
    **dict.fromkeys(("conductor", "roughconductor", "anisotropicconductor"), "specular_reflectance"),
    **dict.fromkeys(("dielectric", "dispersivedielectric", "thindielectric"), "specular_transmittance"),
    **dict.fromkeys(("roughdielectric", "anisotropicdielectric"), "specular_transmittance"),
    **dict.fromkeys(("principled", "principledthin"), "base_color"),
    **dict.fromkeys(("plastic", "roughplastic", "pplastic", "redner"), "diffuse_reflectance"),
}


def albedo(world: World, hits: tr.queries.Hits, d: torch.Tensor) -> torch.Tensor:
    """Albedo (N, C) of the BSDFs at hits."""
    at = At(hits.shape_id.long(), hits.prim_id.long(), hits.barycentric, hits.uv)
    bsdf, behind = world.shape_field("bsdf")[at.shape], dot(hits.shading_normal, d).detach() > 0
    result = torch.ones(len(at), world.channels, dtype=torch.float64)
    for number in bsdf.unique().tolist():
        for back in (False, True):
            rows = ((bsdf == number) & (behind == back)).nonzero()[:, 0]
            result = result.index_put((rows,), albedo_of(world, number, at[rows], back))
    return result


class Unclipped:
    """A world whose cameras see from where they are, not from their near plane on."""

    def __init__(self, world: World) -> None:
        self.world, self.scene, self.records, self.dtype = world, world.scene, world.records, world.dtype

    def tensor(self, category: str, record: Record, name: str) -> torch.Tensor:
        found = self.world.tensor(category, record, name)
        return torch.zeros_like(found) if name == "near_clip" else found


def albedo_of(world: World, number: int, at: At, back: bool) -> torch.Tensor:
    """Of one BSDF, seen from one side (N, C): of mixtures the mixture, white in holes."""
    record = world.records["bsdf"][number]

    def inside(name: str) -> torch.Tensor:
        return albedo_of(world, record.field[name], at, back)

    white = torch.ones(len(at), world.channels, dtype=torch.float64)
    if record.type == "twosided":
        return inside("brdf_1" if back and record.field["brdf_1"] >= 0 else "brdf_0")
    if record.type in ("normalmap", "bumpmap"):
        return inside("nested_bsdf")
    if record.type in ("blendbsdf", "mask"):
        w = share(world, record, at)[:, None]
        first, second = ("bsdf_0", "bsdf_1") if record.type == "blendbsdf" else (None, "nested_bsdf")
        return (1 - w) * (inside(first) if first else white) + w * inside(second)
    return world.color("bsdf", record, ALBEDO[record.type], at) if record.type in ALBEDO else white


def first_hits(
    scene: tr.Scene,
    *,
    seed: int,
    spp: int,
    integrator: tr.integrators.Integrator | None = None,
    sensor: int = 0,
    params: Mapping[str, torch.Tensor] | None = None,
) -> dict[str, torch.Tensor]:
    """Outputs by name, (H, W) or (H, W, K); infinite depth, distance and position where nothing is hit, else zero.

    Not those that only repeat what others are made of.
    """
    world = World(scene, params)
    positions, rays, _, _ = camera_samples(world, seed, spp, sensor)
    config = (integrator or scene.integrator or tr.PathTracer()).config()
    hits = world.first_hits(rays, config["hide_emitters"])
    to_world = world.tensor("sensor", world.records["sensor"][sensor], "to_world")
    axes = normalize(to_world[:3, :3].T)
    rows = hits.valid.nonzero()[:, 0]
    hits, d = tr.queries.Hits(*(x[rows] for x in hits)), rays.directions[rows]
    away = hits.position - to_world[:3, 3]
    apart = hits.position - camera_samples(Unclipped(world), seed, spp, sensor)[1].origins[rows]
    found = {
        "depth": dot(away, axes[2])[:, None],
        "distance": torch.sqrt(dot(apart, apart))[:, None],
        "position": hits.position,
        "normal": hits.normal,
        "shading_normal": hits.shading_normal,
        "normal_camera": hits.normal @ axes.T,
        "shading_normal_camera": hits.shading_normal @ axes.T,
        "uv": hits.uv,
        "barycentric": hits.barycentric,
        "albedo": albedo(world, hits, d),
    }
    images = {}
    for name, value in found.items():
        x, y = positions[rows].unbind(1)
        sums, share = splat(scene.sensors[sensor].film, x, y, value, magnitude=True)
        nothing = float("inf") if name in ("depth", "distance", "position") else 0.0
        image = torch.where(share > 0, sums / torch.where(share > 0, share, 1.0), nothing)
        images[name] = image[..., 0] if name in ("depth", "distance") else image
    return images
