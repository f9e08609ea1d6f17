"""Geometry at the edge of what makes sense, its size, and numbers that are none: images and gradients stay finite."""

from __future__ import annotations

import pytest
import torch
from degenerate_scenes import BSDFS, DEGENERATE, FLOOR, LAMP, SKY, camera, check, load, variants

import torchrender as tr


@variants
@pytest.mark.parametrize("emits", [False, True])
@pytest.mark.parametrize("case", DEGENERATE)
def test_triangles_without_area(case, emits, variant, dtype):
    vertices, faces = DEGENERATE[case]
    emitter = {"type": "area", "radiance": 2.0} if emits else None
    mesh = tr.Mesh(vertices, faces, emitter=emitter, vertex_texcoords=[[0.5, 0.5]] * len(vertices))
    image = check(load({"sky": SKY, "floor": {**FLOOR}, "m": mesh}, variant, dtype))
    assert image.mean() > 0.1


@variants
def test_smooth_normals_of_triangles_without_area(variant, dtype, tmp_path):
    vertices, faces = DEGENERATE["an index twice"]
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in vertices) + "".join(
        f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces
    )
    (tmp_path / "m.obj").write_text(text)
    scene = load({"sky": SKY, "m": {"type": "obj", "filename": str(tmp_path / "m.obj")}}, variant, dtype)
    check(scene)
    with torch.no_grad():
        scene.get_parameter("m.vertex_positions")[2] = scene.get_parameter("m.vertex_positions")[0]
    check(scene)


@variants
def test_normals_that_are_zero_or_against_the_face(variant, dtype):
    vertices = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    for normal in ([0, 0, 0], [0, 0, -1], [1, 0, 0], [1e-30, 0, 0]):
        mesh = tr.Mesh(vertices, [[0, 1, 2], [0, 2, 3]], vertex_normals=[[0, 0, 1], normal, [0, 0, 1], normal])
        check(load({"sky": SKY, "lamp": LAMP, "m": mesh}, variant, dtype))
        opposite = tr.Mesh(vertices, [[0, 1, 2], [0, 2, 3]], vertex_normals=[[0, 0, 1], [0, 0, -1]] * 2)
        check(load({"sky": SKY, "lamp": LAMP, "m": opposite}, variant, dtype))


@variants
@pytest.mark.parametrize("bsdf", [*BSDFS, "null"])
def test_coincident_surfaces(bsdf, variant, dtype):
    # Of surfaces in one place either may be hit; energy is neither made nor lost without end.
    objects = {"sky": SKY, "lamp": LAMP}
    for i in range(3):
        objects[f"floor{i}"] = {**FLOOR, "bsdf": {"type": bsdf}}
        objects[f"ball{i}"] = {"type": "sphere", "radius": 0.5, "bsdf": {"type": bsdf}}
    image = check(load(objects, variant, dtype), integrator=tr.PathTracer(max_depth=8))
    assert image.max() < 20


@variants
def test_a_light_that_coincides_with_a_surface(variant, dtype):
    check(load({"a": {**FLOOR, "emitter": {"type": "area", "radiance": 1.0}}, "b": FLOOR, "c": FLOOR}, variant, dtype))


@variants
@pytest.mark.parametrize("height", [0.0, 1e-7, 1e-3])
def test_grazing_angles(height, variant, dtype):
    # The camera looks along the floor, from inside its plane or just above; the light lies in the plane as well.
    glossy = {**FLOOR, "bsdf": {"type": "dielectric"}}
    side = {"type": "disk", "to_world": tr.Transform.translate([0, 1.4, height]).rotate([1, 0, 0], 90).scale(0.3)}
    view = camera(origin=(0, -4, height), target=(0, 0, height), up=(0, 0, 1))
    rough = {**FLOOR, "bsdf": {"type": "roughdielectric", "alpha": 1e-3}}
    metal = {**FLOOR, "bsdf": {"type": "roughconductor", "alpha": 0.0, "material": "Au"}}
    coated = {
        **FLOOR,
        "bsdf": {"type": "principled", "roughness": 0.0, "clearcoat": 1.0, "sheen": 1.0, "spec_trans": 0.5},
    }
    for floor in (FLOOR, glossy, rough, metal, coated):
        objects = {"camera": view, "floor": floor, "side": {**side, "emitter": {"type": "area", "radiance": 1.0}}}
        check(tr.load_dict({"type": "scene", **objects}, variant=variant, dtype=dtype))


@variants
@pytest.mark.parametrize("bsdf", BSDFS)
def test_a_camera_on_a_surface(bsdf, variant, dtype):
    material = {"type": bsdf}
    for origin, target in (
        ((0, 0, 0), (0, 0, -1)),
        ((0, 0, 0), (0, 0, 1)),
        ((0, 0, 0), (1, 0, 0)),
        ((0, 0, 1), (0, 0, 2)),
    ):
        up = (0, 1, 0)
        objects = {
            "camera": camera(origin=origin, target=target, up=up),
            "sky": SKY,
            "floor": {**FLOOR, "bsdf": material},
            "ball": {"type": "sphere", "bsdf": material},
        }
        check(tr.load_dict({"type": "scene", **objects}, variant=variant, dtype=dtype))


def aimed(points: torch.Tensor, origin: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    return origin.expand_as(points).contiguous(), points - origin


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_rays_through_edges_and_vertices(dtype):
    """Rays from inside a cube at its edges, diagonals and corners hit it or just miss, with finite answers."""
    scene = load({"c": {"type": "cube"}}, dtype=dtype)
    steps = torch.linspace(-1, 1, 21, dtype=dtype)
    one = torch.ones_like(steps)
    edges = [torch.stack([a * one, b * one, steps], 1) for a in (-1, 1) for b in (-1, 1)]
    edges += [torch.stack([steps, steps, one], 1), torch.stack([-one, steps, -steps], 1)]
    points = torch.cat(edges)
    for origin in ([0, 0, 0], [0.1, 0.2, -0.3]):
        o, d = aimed(points, torch.tensor(origin, dtype=dtype))
        hits = tr.ray_intersect(scene, o, d)
        assert hits.valid.float().mean() > 0.9
        assert not torch.isnan(hits.t).any()
        for name in ("position", "normal", "shading_normal", "uv"):
            assert torch.isfinite(getattr(hits, name)[hits.valid]).all(), name
        torch.testing.assert_close(hits.position[hits.valid], points[hits.valid], rtol=0, atol=1e-5)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_rays_within_the_plane_of_what_they_meet(dtype):
    scene = load(
        {"r": {"type": "rectangle"}, "d": {"type": "disk", "to_world": tr.Transform.translate([5, 0, 0])}}, dtype=dtype
    )
    o = torch.tensor([[-2, 0, 0], [-2, 1, 0], [2, 0, 0], [0, 0, 0], [0, 0, 1]], dtype=dtype)
    d = torch.tensor([[1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1]], dtype=dtype)
    hits = tr.ray_intersect(scene, o, d)
    assert not torch.isnan(hits.t).any()
    assert hits.valid[4]
    assert not torch.isnan(hits.position[hits.valid]).any()
    assert tr.ray_occluded(scene, o, d)[4]


@variants
def test_axis_parallel_rays_at_the_faces_of_boxes(variant, dtype):
    # A long lens: rays nearly parallel to the sides of the cube, in whose planes the pixels' edges lie.
    view = camera(origin=(0, 0, 1000), size=8)
    view["fov"] = 0.2
    view["to_world"] = tr.Transform.look_at([1, 1, 1000], [1, 1, 0], [0, 1, 0])
    check(
        tr.load_dict({"type": "scene", "camera": view, "sky": SKY, "c": {"type": "cube"}}, variant=variant, dtype=dtype)
    )


# ------------------------------------------------------------------------------------------------------------ sizes
def room(scale: float) -> dict:
    """The same scene in other units of length."""
    size = tr.Transform.scale(scale)
    return {
        "type": "scene",
        "camera": camera(origin=(0.5, 0.4, 4), scale=scale),
        "sky": {"type": "constant", "radiance": 0.3},
        "floor": {"type": "rectangle", "to_world": size.scale(1.5)},
        "cube": {"type": "cube", "to_world": size.translate([0.4, 0, 0.3]).rotate([0, 0, 1], 20).scale(0.3)},
        "ball": {
            "type": "sphere",
            "to_world": size,
            "center": [-0.5, 0, 0.4],
            "radius": 0.4,
            "bsdf": {"type": "dielectric"},
        },
        "lamp": {**LAMP, "to_world": size @ LAMP["to_world"]},
    }


@variants
@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3, 1e6])
def test_an_image_does_not_depend_on_the_unit_of_length(scale, variant, dtype):
    found = check(tr.load_dict(room(scale), variant=variant, dtype=dtype), spp=64)
    assert found.mean() > 0.1
    if scale < 1e-3:
        return  # smaller than the offset of rays from surfaces, which is 9e-5 near the origin: finite, but not right
    expected = check(tr.load_dict(room(1.0), variant=variant, dtype=dtype), spp=64)
    # The random numbers are the same; a few paths take another turn where rounding decides.
    assert ((found - expected).abs() > 1e-2).float().mean() < 0.05
    torch.testing.assert_close(found.mean(), expected.mean(), rtol=0.01, atol=0)


@variants
@pytest.mark.parametrize("offset", [1e3, 1e5])
def test_a_scene_far_from_the_origin(offset, variant, dtype):
    away = tr.Transform.translate([offset, -offset, offset])
    look = tr.Transform.look_at([offset, -offset, offset + 4], [offset, -offset, offset], [0, 1, 0])
    objects = {
        "camera": {**camera(), "to_world": look},
        "sky": SKY,
        "floor": {"type": "rectangle", "to_world": away.scale(1.5)},
        "ball": {"type": "sphere", "center": [offset, -offset, offset + 0.5], "radius": 0.4},
    }
    image = check(tr.load_dict({"type": "scene", **objects}, variant=variant, dtype=dtype))
    assert 0.1 < image.mean() < 1.001


# --------------------------------------------------------------------------------------------- what is not a number
def test_parameters_that_become_nonfinite_are_refused_by_name_and_the_scene_recovers():
    scene = load(
        {
            "sky": {"type": "envmap", "data": torch.ones(4, 8, 3)},
            "floor": FLOOR,
            "m": tr.Mesh(*DEGENERATE["unused vertices"]),
        }
    )
    expected = tr.render(scene, spp=1, seed=0)
    for name, parameter in scene.named_parameters():
        kept = parameter.detach().clone()
        for bad in (float("nan"), float("inf")):
            with torch.no_grad():
                parameter.reshape(-1)[-1] = bad
            with pytest.raises(ValueError, match=name.replace(".", r"\.")):
                tr.render(scene, spp=1, seed=0)
            with torch.no_grad():
                parameter.copy_(kept)
        assert torch.equal(tr.render(scene, spp=1, seed=0), expected), name


def test_steps_out_of_range_do_not_end_an_optimisation():
    scene = load({"lamp": LAMP, "floor": {**FLOOR, "bsdf": {"type": "diffuse", "reflectance": 0.5}}, "sky": SKY})
    for name in ("floor.bsdf.reflectance.value", "lamp.emitter.radiance.value", "sky.radiance.value"):
        for value in (-0.1, 1.2):
            with torch.no_grad():
                scene.get_parameter(name).fill_(value)
            check(scene)


def test_samples_that_overflow_are_dropped_counted_and_named_in_one_warning():
    bulb = {"type": "point", "position": [0, 0, 0.01], "intensity": 1e38}
    scene = load({"bulb": bulb, "floor": FLOOR})
    with pytest.warns(RuntimeWarning, match=r"samples were not finite, first at \S+.*dropped") as caught:
        image = tr.render(scene, spp=4, seed=0)
    assert len(caught) == 1 and caught[0].filename == __file__
    assert torch.isfinite(image).all()
    assert scene.statistics["render"]["nonfinite"] > 0
    with pytest.raises(tr.RenderError, match="samples were not finite"):
        tr.render(scene, spp=4, seed=0, nan="raise")
