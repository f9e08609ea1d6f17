"""Rectangles that show an image are sampled by it: probabilities, unbiased images and derivatives, less noise.

What the cells are left out of is the same rectangle as a mesh of four triangles, whose points are chosen by area.
Statistical statements are tests of means over independent seeds, at a level of 1e-3 each.
"""

from __future__ import annotations

import functools
from typing import Any

import pytest
import torch

import torchrender as tr

T = tr.Transform
TEXELS = "lamp.emitter.radiance.data"
PLACE = T.translate([0, 0, 1.5]).rotate([1, 0.2, 0], 160).scale([0.9, 0.6, 1])
RUNS = 40


def picture(channels: int = 3) -> torch.Tensor:
    """Three bright texels, in different colours, on black."""
    texels = torch.zeros(6, 9, 3)
    texels[1, 2] = torch.tensor([30.0, 10.0, 0.0])
    texels[4, 6] = torch.tensor([0.0, 15.0, 30.0])
    texels[2, 7] = 8.0
    return texels[..., :channels] if channels == 3 else texels.mean(-1, keepdim=True)


def lamp(cells: bool, emitter: dict[str, Any], place: Any = PLACE) -> Any:
    if cells:
        return {"type": "rectangle", "to_world": place, "emitter": emitter}
    corners = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 0]])
    matrix = torch.as_tensor(place.matrix, dtype=torch.float32)
    vertices = corners @ matrix[:3, :3].T + matrix[:3, 3]
    faces = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    return tr.Mesh(vertices, faces, vertex_texcoords=(corners[:, :2] + 1) / 2, emitter=emitter)


def room(cells: bool, image: dict[str, Any], kind: str = "area", size: int = 6, place: Any = PLACE, **objects) -> dict:
    """A lamp above a floor, and a ball that shadows and reflects it."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    view = T.look_at([0, -4, 2.5], [0, 0, 0.2], [0, 0, 1])
    metal = {"type": "roughconductor", "material": "none", "alpha": 0.2}
    return {
        "type": "scene",
        "camera": {"type": "perspective", "fov": 40, "to_world": view, "film": film},
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.7}},
        "ball": {"type": "sphere", "radius": 0.3, "center": [0.3, 0, 0.3], "bsdf": metal},
        "lamp": lamp(cells, {"type": kind, "radiance": {"type": "bitmap", "raw": True, **image}}, place),
        **objects,
    }


NEAREST = {"data": picture(), "filter_type": "nearest"}
IMAGES: dict[str, dict[str, Any]] = {
    "nearest": NEAREST,
    "bilinear": {"data": picture(), "wrap_mode": "mirror"},
    "turned": {"data": picture(), "to_uv": T.translate([0.2, 0.1, 0]).rotate([0, 0, 1], 35).scale([1.5, 1.5, 1])},
    "more texels than cells": {"data": picture().repeat_interleave(60, 0).repeat_interleave(50, 1)},
    "one channel": {"data": picture(1)},
}
PATH = tr.PathTracer(max_depth=3, rr_depth=99)
LIGHT = tr.ParticleTracer(max_depth=3, rr_depth=99)
FOG = {
    "fog": {
        "type": "cube",
        "to_world": T.translate([0, 0, 1]).scale(3),
        "bsdf": {"type": "null"},
        "interior": {"type": "homogeneous", "sigma_t": 0.3, "albedo": 0.8},
    }
}


def same_means(first: tuple[torch.Tensor, torch.Tensor], second: tuple[torch.Tensor, torch.Tensor]) -> None:
    """Two-sample tests of entries, Šidák-corrected, with the tails of Student's distribution."""
    (a, variance_a), (b, variance_b) = first, second
    spread = (variance_a + variance_b).sqrt()
    z = torch.where(spread > 0, (a - b).abs() / spread.clamp(min=1e-30), 0.0).flatten()
    smallest = float(tr.testing.student_p_value(z, RUNS - 1).min())
    assert smallest > tr.testing.sidak(1e-3, len(z)), float(z.max())
    assert float(a.sum()) > 0


# ------------------------------------------------------------------------------------------------- probabilities
def shares(image: dict[str, Any], n: int = 40000) -> tuple[torch.Tensor, torch.Tensor]:
    """How often points are chosen on each of 6 x 9 parts of a light, and their density there, times the area."""
    objects = room(True, image, place=T())
    scene = tr.load_dict({name: objects[name] for name in ("type", "lamp")}, dtype=torch.float64)
    p = torch.tensor([0.3, -0.2, 40.0], dtype=torch.float64)  # from afar all of it is seen alike
    u = torch.rand(n, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = tr.testing.sample_emitters(scene, p, u)
    at = p + found.direction * found.distance[:, None]
    row, column = ((at[:, 1] + 1) * 3).long().clamp(0, 5), ((at[:, 0] + 1) * 4.5).long().clamp(0, 8)
    cosine = -found.direction[:, 2]
    by_area = found.pdf * cosine / found.distance**2 * 4
    other = tr.testing.emitter_density(scene, p, found.direction).pdf
    assert float((other / found.pdf - 1).abs().median()) < 1e-9
    assert float(((other / found.pdf - 1).abs() > 1e-6).double().mean()) < 1e-3  # at the edges of cells
    part = 9 * row + column
    counts = torch.bincount(part, minlength=54).double()
    return counts, torch.zeros(54, dtype=torch.float64).scatter_reduce(0, part, by_area, "mean", include_self=False)


def test_texels_are_chosen_by_their_largest_channel():
    """A quarter of the points is uniform; counts by a chi-square test."""
    counts, density = shares(NEAREST)
    brightness = picture().double().amax(-1).flatten()
    expected = 0.75 * brightness / brightness.sum() + 0.25 / 54
    torch.testing.assert_close(density, 54 * expected, rtol=1e-5, atol=1e-5)
    n = float(counts.sum())
    statistic = float(((counts - n * expected) ** 2 / (n * expected)).sum())
    assert statistic < 90.6  # of 53 degrees of freedom, exceeded with a probability of 1e-3


@pytest.mark.parametrize("name", ["black", "infinitely turned"])
def test_where_there_is_nothing_to_choose_by(name):
    """Black, or all of one texel: uniform."""
    image = {"data": torch.zeros(6, 9, 3)} if name == "black" else {**NEAREST, "to_uv": T.scale([0, 0, 1])}
    counts, density = shares(image)
    torch.testing.assert_close(density, torch.ones_like(density), rtol=1e-5, atol=1e-5)
    assert float(((counts - 40000 / 54) ** 2 / (40000 / 54)).sum()) < 90.6


# ----------------------------------------------------------------------------------------------------- unbiased
CASES: dict[str, tuple[str, str, Any, dict[str, Any]]] = {
    **{f"path, {name}": (name, "area", PATH, {}) for name in IMAGES},
    "light tracing": ("nearest", "area", LIGHT, {}),
    "beams": ("bilinear", "directionalarea", LIGHT, {}),
    "two lights": ("nearest", "area", PATH, {"sky": {"type": "constant", "radiance": 0.2}}),
    "fog": ("nearest", "area", tr.VolumetricPathTracer(max_depth=3, rr_depth=99), FOG),
}


@functools.cache
def found(case: str, cells: bool, variant: str = "rgb") -> tuple[tuple[torch.Tensor, torch.Tensor], ...]:
    """Mean and variance of the mean, of an image and of the texels' derivative of its weighted sum."""
    name, kind, integrator, objects = CASES[case]
    scene = tr.load_dict(room(cells, IMAGES[name], kind, **objects), variant=variant)
    texels = scene.get_parameter(TEXELS).requires_grad_()

    def run(seed: int) -> torch.Tensor:
        image = tr.render(scene, integrator=integrator, spp=64, spp_grad=32, seed=seed)
        weight = torch.linspace(1, 2, image.numel()).reshape(image.shape)
        (gradient,) = torch.autograd.grad((image * weight).sum(), texels)
        size = [6, gradient.shape[0] // 6, 9, gradient.shape[1] // 9, gradient.shape[2]]
        return torch.cat([image.detach().flatten(), gradient.reshape(size).sum((1, 3)).flatten()]).double()

    mean, variance = tr.testing.mean_and_variance(run, range(RUNS) if cells else range(1000, 1000 + RUNS))
    return (mean[:108], variance[:108]), (mean[108:], variance[108:])


@pytest.mark.parametrize("case", CASES)
def test_images_and_derivatives_are_those_of_points_by_area(case):
    """Black texels have derivatives as large as others: the image is linear in all of them."""
    for cells, area in zip(found(case, True), found(case, False), strict=True):
        same_means(cells, area)


def test_with_wavelengths():
    for cells, area in zip(
        found("path, nearest", True, "spectral"), found("path, nearest", False, "spectral"), strict=True
    ):
        same_means(cells, area)


@pytest.mark.parametrize("case", ["path, bilinear", "light tracing", "beams", "fog"])
def test_forward_and_reverse_mode_agree(case):
    name, kind, integrator, objects = CASES[case]
    scene = tr.load_dict(room(True, IMAGES[name], kind, **objects), dtype=torch.float64)

    def image(texels: torch.Tensor) -> torch.Tensor:
        return tr.render(scene, integrator=integrator, spp=2, seed=3, params={TEXELS: texels})

    result = tr.testing.dot_product_test(image, scene.get_parameter(TEXELS).detach(), rtol=1e-9)
    assert result, result.message


# --------------------------------------------------------------------------------------------------------- noise
@pytest.mark.parametrize(("case", "gain"), [("path, nearest", 5.0), ("light tracing", 3.0)])
def test_there_is_less_noise(case, gain):
    """Below the rows of the image in which the lamp itself is seen. By light tracing the derivative gains, too."""
    (_, image), (_, gradient) = found(case, True)
    (_, by_area), (_, gradient_by_area) = found(case, False)
    assert float(by_area[36:].sum() / image[36:].sum()) > gain
    bright = picture().flatten() > 0
    assert case != "light tracing" or float(gradient_by_area[bright].sum() / gradient[bright].sum()) > 1.5


# ------------------------------------------------------------------------------------------------------- changes
def test_cells_follow_the_picture():
    """However texels, coordinates, or the shape of a mesh of two triangles change."""
    quad = [[-0.9, -0.6, 1.5], [0.9, -0.6, 1.5], [0.9, 0.6, 1.5], [-0.9, 0.6, 1.5]]

    def scene_of(texels: torch.Tensor, turn: float = 0.0, corner: float = 0.6) -> tr.Scene:
        vertices = [*quad[:2], [0.9, corner, 1.5], quad[3]]
        image = {"type": "bitmap", "raw": True, "data": texels, "to_uv": T.rotate([0, 0, 1], turn)}
        mesh = tr.Mesh(
            vertices,
            [[0, 2, 1], [0, 3, 2]],
            vertex_texcoords=[[0, 0], [1, 0], [1, 1], [0, 1]],
            emitter={"type": "area", "radiance": image},
        )
        return tr.load_dict({**room(True, NEAREST), "lamp": mesh})

    def image(scene: tr.Scene) -> torch.Tensor:
        return tr.render(scene, spp=4, seed=1)

    scene, other = scene_of(picture()), picture().flip(0, 1)
    first = image(scene)
    assert torch.equal(first, image(scene_of(picture())))
    with torch.no_grad():
        scene.get_parameter(TEXELS).copy_(other)
    assert torch.equal(image(scene), image(scene_of(other))) and not torch.equal(image(scene), first)
    scene.get_parameter(TEXELS).data.copy_(picture())  # without a word
    assert torch.equal(image(scene), first)
    with torch.no_grad():
        scene.get_parameter("lamp.emitter.radiance.to_uv").copy_(
            scene_of(picture(), 90).get_parameter("lamp.emitter.radiance.to_uv")
        )
    assert torch.equal(image(scene), image(scene_of(picture(), 90)))
    with torch.no_grad():
        scene.get_parameter("lamp.vertex_positions")[2, 1] = 0.2  # triangles of two sizes have no cells
    assert torch.equal(image(scene), image(scene_of(picture(), 90, 0.2)))
