"""Light tracing against the same in plain PyTorch (tests/oracle/light.py), with the same random numbers: images, and
gradients by autograd, are equal to rounding."""

from __future__ import annotations

import layer_scenes
import light_scenes as ls
import pytest
import torch
from light_changes import direction, triangle, weight
from oracle import light
from oracle.scene_parts import bumps

import torchrender as tr

pytestmark = [
    pytest.mark.once,  # in double precision, which does not depend on it
    pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning"),
]
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
MIRROR = {"type": "conductor", "eta": 0.2, "k": 3.9}
BEAM = ("light.to_world", "light.emitter.radiance.data")
CAMERA = tuple(
    f"camera.{n}" for n in ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y", "pixel_aspect")
)
SHEET = ("sheet.vertex_positions", "sheet.vertex_normals", "sheet.bsdf.eta")
FLOOR = ("floor.to_world", "floor.bsdf.reflectance.value")
PLACE = FLOOR[0]
PAINT = {"type": "diffuse", "reflectance": ls.RGB}
METAL = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.5, "eta": 0.2, "k": 3.9}
ALONG = {"type": "roughconductor", "distribution": "ggx", "alpha_u": 0.3, "alpha_v": 0.7, "eta": 0.2, "k": 3.9}
BRUSHED = ("bsdf.alpha_u.value", "bsdf.alpha_v.value")


def mirrored() -> dict:
    place = ls.T.look_at([-1, 0.2, 0.1], [0.4, 1, 0], [0, 0, 1]) @ ls.T.scale(0.6)
    mirror = ls.T.look_at([0.4, 1, 0], [-0.66, -0.48, 0.06], [0, 0, 1]) @ ls.T.scale(9)
    return ls.floor_view(
        light={**ls.beam(), "to_world": place}, mirror={"type": "rectangle", "to_world": mirror, "bsdf": MIRROR}
    )


def lens() -> dict:
    ball = {"type": "sphere", "center": [0.1, 0.5, 0.1], "radius": 0.6, "bsdf": GLASS}
    place = ls.facing_down(0.1, 1.2, 0.1) @ ls.T.rotate([1, 0, 0], 3) @ ls.T.scale(0.25)
    return ls.floor_view(light={**ls.beam(), "to_world": place}, lens=ball)


def turned(bsdf: dict, texture: dict | None = None) -> dict:
    """Of a smooth map, unless told."""
    texture = {"type": "bitmap", "data": layer_scenes.normals(5, 6, 1.5), "raw": True} if texture is None else texture
    return {"type": "normalmap", "normalmap": texture, "bsdf": bsdf}


# normals that hide from the light or from the camera, many on the large triangle
BUMPS = bumps(141, 0.3, to_uv=ls.T.scale([20.0, 20.0, 1.0]))


def from_behind(bsdf: dict) -> dict:
    """A floor that faces down."""
    return {
        **ls.floor(),
        "to_world": ls.T.translate([0, -1, 0]) @ ls.T.rotate([1, 0, 0], 90) @ ls.T.scale(3),
        "bsdf": bsdf,
    }


def veil() -> dict:
    """A sheet with holes in front of glass that is also a mirror and nothing at all."""
    return triangle(
        layer_scenes.mask(layer_scenes.blend(GLASS, layer_scenes.blend(MIRROR, {"type": "null"}, 0.7), 0.4), 0.8)
    )


VEIL = tuple(
    f"sheet.{n}"
    for n in (
        "vertex_positions",
        "bsdf.opacity.value",
        "bsdf.nested_bsdf.weight.value",
        "bsdf.nested_bsdf.bsdf_0.eta",
        "bsdf.nested_bsdf.bsdf_1.weight.value",
    )
)
BLEND = tuple(f"floor.bsdf.{n}" for n in ("weight.data", "bsdf_0.reflectance.value", "bsdf_1.alpha.value"))

# name: (scene, parameters, depth)
SCENES = {
    "beam": (lambda: ls.floor_view(light=ls.beam()), (*BEAM, *FLOOR, *CAMERA), 2),
    "area": (lambda: ls.floor_view(light=ls.area()), (*BEAM, *FLOOR, *CAMERA), 2),
    "tent": (lambda: ls.floor_view(ls.close_camera(rfilter="tent"), light=ls.area()), (*BEAM, *FLOOR, *CAMERA), 2),
    "mitchell": (lambda: ls.floor_view(ls.close_camera(rfilter="mitchell"), light=ls.area()), (*BEAM, *CAMERA), 2),
    "sheet": (
        lambda: ls.floor_view(light=ls.beam(), sheet=triangle(GLASS)),
        (*SHEET, *BEAM, *FLOOR, *CAMERA),
        3,
    ),
    "area through a sheet": (
        lambda: ls.floor_view(light=ls.area(), sheet=triangle(GLASS)),
        (*SHEET, *BEAM, *FLOOR, *CAMERA),
        3,
    ),
    "mirror": (mirrored, ("mirror.to_world", "mirror.bsdf.eta.value", "mirror.bsdf.k.value", *BEAM, *FLOOR), 3),
    "lens": (lens, ("lens.center", "lens.radius", "lens.bsdf.eta", *BEAM, *FLOOR), 4),
    "blend": (
        lambda: ls.floor_view(light=ls.area(), floor=ls.floor(bsdf=layer_scenes.blend(PAINT, METAL))),
        (*BLEND, *BEAM, PLACE, *CAMERA),
        2,
    ),
    "brushed": (
        lambda: ls.floor_view(light=ls.area(), floor=ls.floor(bsdf=ALONG)),
        (*(f"floor.{n}" for n in BRUSHED), *BEAM, PLACE, *CAMERA),
        2,
    ),
    "brushed triangle": (
        lambda: ls.floor_view(light=ls.area(), floor=triangle(ALONG, low=True)),
        (*(f"floor.{n}" for n in BRUSHED), "floor.vertex_positions", "floor.vertex_normals", *BEAM, *CAMERA),
        2,
    ),
    "turned brushed": (
        lambda: ls.floor_view(light=ls.beam(), floor=from_behind({"type": "twosided", "bsdf": turned(ALONG)})),
        (*(f"floor.bsdf.brdf_0.{n}" for n in ("normalmap.data", "nested_bsdf.alpha_u.value")), *BEAM, PLACE, *CAMERA),
        2,
    ),
    "hair": (
        lambda: ls.floor_view(light=ls.area(), floor=ls.floor(bsdf={"type": "hair", "eumelanin": 0.3})),
        (*(f"floor.bsdf.{n}" for n in ("eumelanin.value", "longitudinal_roughness", "eta")), *BEAM, PLACE, *CAMERA),
        2,
    ),
    "through layers": (lambda: ls.floor_view(light=ls.area(), sheet=veil()), (*VEIL, *BEAM, *FLOOR), 3),
    "beam through layers": (lambda: ls.floor_view(light=ls.beam(), sheet=veil()), (*VEIL, *BEAM, *FLOOR), 3),
    "meter under layers": (lambda: ls.metered(light=ls.area(), sheet=veil()), (*VEIL, *BEAM, PLACE), 3),
    "turned normals": (
        lambda: ls.floor_view(light=ls.area(), floor=ls.floor(bsdf=turned(METAL))),
        ("floor.bsdf.normalmap.data", "floor.bsdf.nested_bsdf.alpha.value", *BEAM, PLACE, *CAMERA),
        2,
    ),
    "turned normals that hide": (
        lambda: ls.floor_view(light=ls.area(), floor=ls.floor(bsdf=turned(METAL, bumps(141)))),
        ("floor.bsdf.normalmap.data", *BEAM, PLACE),
        2,
    ),
    "turned normals behind": (
        lambda: ls.floor_view(
            light=ls.beam(),
            floor=from_behind({"type": "twosided", "bsdf": layer_scenes.blend(turned(PAINT, BUMPS), PAINT)}),
        ),
        (*(f"floor.bsdf.brdf_0.{n}" for n in ("weight.data", "bsdf_0.normalmap.data")), *BEAM, PLACE, *CAMERA),
        2,
    ),
    "turned glass": (
        lambda: ls.floor_view(light=ls.area(), sheet=triangle(turned(GLASS, BUMPS))),
        ("sheet.bsdf.normalmap.data", "sheet.bsdf.nested_bsdf.eta", *SHEET[:2], *BEAM, *FLOOR, *CAMERA),
        3,
    ),
    "meter": (lambda: ls.metered(light=ls.beam()), (*BEAM, "floor.to_world"), 2),
    "meter under a sheet": (
        lambda: ls.metered(light=ls.area(), sheet=triangle(GLASS)),
        (*SHEET, *BEAM, "floor.to_world"),
        3,
    ),
}


@pytest.mark.parametrize("name", list(SCENES))
def test_images_and_gradients_are_those_of_plain_torch(name):
    make, names, depth = SCENES[name]
    scene, tracer = tr.load_dict(make(), dtype=torch.float64), tr.ParticleTracer(max_depth=depth, rr_depth=99)
    scene.sensors[0].sampler = tr.Sampler(4, "independent")  # of these few paths none grazes a surface

    def leaves() -> dict[str, torch.Tensor]:
        return {n: scene.get_parameter(n).detach().clone().requires_grad_() for n in names}

    ours, theirs = leaves(), leaves()
    image = tr.render(scene, integrator=tracer, spp=4, seed=7, correlated=True, params=ours)
    expected = light.render(scene, spp=4, seed=7, max_depth=depth)
    assert float(image.detach().mean()) > 1e-4
    torch.testing.assert_close(image, expected, rtol=1e-6, atol=1e-8)
    expected = light.render(scene, spp=4, seed=7, max_depth=depth, params=theirs, derivative=True)
    found, wanted = (
        torch.autograd.grad((x * weight(x)).sum(), list(params.values()), allow_unused=True)
        for x, params in ((image, ours), (expected, theirs))
    )
    for parameter, a, b in zip(names, found, wanted, strict=True):
        b = torch.zeros_like(a) if b is None else b
        size = float(b.abs().max())
        assert size > 0, parameter
        # the derivative of how far rays start off a surface is left out natively: 1e-4 of the distances
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3 * size, msg=lambda m, p=parameter: f"{p}: {m}")
        assert float((direction(parameter, a) * a).sum().abs()) > 0, parameter
