"""Outputs that describe the surface: derivatives of the position by its coordinates, materials, colours of meshes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import torchrender as tr


def scene_of(dtype: torch.dtype = torch.float64, size: int = 9, **objects) -> tr.Scene:
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    to_world = tr.Transform.look_at([0.3, 0.2, 4], [0, 0, 0], [0, 1, 0])
    camera = {"type": "perspective", "fov": 30, "to_world": to_world, "film": film}
    return tr.load_dict({"type": "scene", "camera": camera, **objects}, dtype=dtype)


def sheet(texcoords: bool = True, **more) -> tr.Mesh:
    """Two triangles that fill the view, with skewed texture coordinates."""
    corners = torch.tensor([[-3.0, -3, 0], [3, -3, 0.3], [3, 3, 0], [-3, 3, -0.3]])
    uv = torch.tensor([[0.1, 0.2], [0.9, 0.1], [1.1, 0.8], [0.0, 0.7]]) if texcoords else None
    return tr.Mesh(corners, [[0, 1, 2], [0, 2, 3]], vertex_texcoords=uv, **more)


CURVED = {
    "sphere": {"type": "sphere", "center": [0.1, 0, 0], "radius": 0.8},
    "cylinder": {"type": "cylinder", "p0": [-0.9, 0.1, 0], "p1": [0.8, -0.2, 0.4], "radius": 0.5},
    "disk": {"type": "disk", "to_world": tr.Transform.rotate([1, 1, 0], 30)},
    "hills": {"type": "heightfield", "heights": torch.sin(torch.arange(20.0)).reshape(4, 5) * 0.2},
}


@pytest.mark.parametrize("kind", list(CURVED))
def test_partials_are_derivatives_of_the_position(kind):
    """Along a pixel's ray p moves within the surface: its shift is dp_du du + dp_dv dv, to first order."""
    scene = scene_of(shape=CURVED[kind])
    pixels = torch.tensor([[4, 4], [3, 5], [5, 3]])
    outputs = tr.render(scene, outputs=("position", "uv", "dp_du", "dp_dv", "normal"), spp=1, seed=1, pixels=pixels)
    o = scene.camera.to_world.detach()[:3, 3].expand(3, 3)
    d = torch.nn.functional.normalize(outputs.position - o, dim=1)
    for step in (torch.tensor([1e-5, 0, 0]).double(), torch.tensor([0, 1e-5, 0]).double()):
        hits = [tr.ray_intersect(scene, o, d + sign * step) for sign in (1, -1)]
        moved, (du, dv) = hits[0].position - hits[1].position, (hits[0].uv - hits[1].uv).unbind(1)
        expected = outputs.dp_du * du[:, None] + outputs.dp_dv * dv[:, None]
        torch.testing.assert_close(moved, expected, rtol=1e-5, atol=1e-9)
    for partial in (outputs.dp_du, outputs.dp_dv):
        assert float((partial * outputs.normal).sum(1).abs().max()) < 1e-9


def test_partials_of_a_mesh_in_closed_form():
    """A triangle's edges are its texture coordinates' differences times the two vectors; without any, the edges."""
    names = ("dp_du", "dp_dv", "prim_id", "barycentric", "uv")
    scene = scene_of(wall=sheet())
    found = tr.render(scene, outputs=names, spp=1, seed=0)
    corners = scene.wall.vertex_positions.detach()[scene.wall.faces.long()]
    uv = scene.wall.vertex_texcoords.detach()[scene.wall.faces.long()]
    of = corners[found.prim_id.long()], uv[found.prim_id.long()]
    # along the diagonal a pixel's centre may be in another triangle than its sample
    row, column = torch.meshgrid(torch.arange(9), torch.arange(9), indexing="ij")
    clear = ((row - column).abs() > 2) & ((row + column - 8).abs() > 2)
    for k in (1, 2):
        du, dv = (of[1][..., k, :] - of[1][..., 0, :]).unbind(-1)
        edge = found.dp_du * du[..., None] + found.dp_dv * dv[..., None]
        torch.testing.assert_close(edge[clear], (of[0][..., k, :] - of[0][..., 0, :])[clear])
    bare = tr.render(scene_of(wall=sheet(texcoords=False)), outputs=names, spp=1, seed=0)
    torch.testing.assert_close(bare.uv, bare.barycentric)
    upper = bare.prim_id == 1
    torch.testing.assert_close(bare.dp_du[upper][0], corners[1, 1] - corners[1, 0])


def test_materials():
    roughness = {"type": "bitmap", "data": torch.full((1, 1, 1), 0.3), "raw": True}
    pink = {"type": "rgb", "value": [0.9, 0.5, 0.4]}
    bsdfs = {
        "conductor": (
            {"type": "roughconductor", "alpha": roughness, "specular_reflectance": pink},
            0.3,
            [0.9, 0.5, 0.4],
        ),
        "plastic": ({"type": "roughplastic", "alpha": 0.25}, 0.25, [1.0, 1.0, 1.0]),
        "smooth": ({"type": "dielectric", "specular_reflectance": 0.7}, 0.0, [0.7, 0.7, 0.7]),
        "diffuse": ({"type": "twosided", "bsdf": {"type": "diffuse"}}, 1.0, [0.0, 0.0, 0.0]),
        "principled": ({"type": "principled", "roughness": 0.6}, 0.6, [0.0, 0.0, 0.0]),
    }
    for name, (bsdf, rough, specular) in bsdfs.items():
        found = tr.render(scene_of(wall=sheet(bsdf=bsdf)), outputs=("roughness", "specular_reflectance"), spp=2, seed=0)
        torch.testing.assert_close(found.roughness, torch.full((9, 9), rough).double(), msg=name, rtol=0, atol=1e-7)
        expected = torch.tensor(specular).double().expand(9, 9, 3)
        torch.testing.assert_close(found.specular_reflectance, expected, msg=name, rtol=0, atol=1e-7)


def test_material_ids_are_those_of_bsdf_objects():
    """Two balls share a material, a third has its own, the rest of the view has none."""
    shared = {"type": "ref", "id": "paint"}
    scene = scene_of(
        size=24,
        paint={"type": "diffuse"},
        left={"type": "sphere", "center": [-0.6, 0, 0], "radius": 0.3, "bsdf": shared},
        right={"type": "sphere", "center": [0.6, 0, 0], "radius": 0.3, "bsdf": shared},
        other={"type": "sphere", "center": [0, 0.6, 0], "radius": 0.3},
    )
    found = tr.render(scene, outputs=("material_id", "shape_id"), spp=1, seed=0)
    numbers = {int(s): set(found.material_id[found.shape_id == s].tolist()) for s in found.shape_id.unique()}
    assert numbers[-1] == {-1}
    left, right, other = (numbers[i] for i in (0, 1, 2))
    assert left == right != other and len(left) == len(other) == 1


def test_colours_of_meshes():
    """Interpolated between vertices, constant on faces, zero on shapes that have none of that name."""
    generator = torch.Generator().manual_seed(1)
    vertex, face = torch.rand(4, 3, generator=generator), torch.rand(2, 1, generator=generator)
    scene = scene_of(
        wall=sheet(attributes={"vertex_color": vertex, "face_mark": face}),
        ball={"type": "sphere", "radius": 0.5},
    )
    names = ("vertex_color", "face_mark", "barycentric", "prim_id", "shape_id")
    found = tr.render(scene, outputs=names, spp=1, seed=0)
    assert found.vertex_color.shape == found.face_mark.shape == (9, 9, 3)
    corner = vertex.double()[scene.wall.faces.long()][found.prim_id.long()]
    b1, b2 = found.barycentric[..., :1], found.barycentric[..., 1:]
    expected = corner[..., 0, :] * (1 - b1 - b2) + corner[..., 1, :] * b1 + corner[..., 2, :] * b2
    names = list(scene.layout().objects["shape"])
    wall = next(i for i, row in enumerate(names) if row[2] == "wall")
    clear = torch.zeros(9, 9, dtype=torch.bool)
    clear[0], clear[-1] = True, True  # no outline and no diagonal
    clear[0, :2] = clear[0, -2:] = clear[-1, :2] = clear[-1, -2:] = False
    assert bool((found.shape_id[clear] == wall).all())
    torch.testing.assert_close(found.vertex_color[clear], expected[clear])
    torch.testing.assert_close(found.face_mark[clear], face.double()[found.prim_id[clear].long()].expand(-1, 3))
    assert float(found.vertex_color[4, 4].abs().max()) == 0  # the ball


def test_unknown_colours_are_named():
    with pytest.raises(ValueError, match="no mesh has colours 'vertex_colour'; did you mean 'vertex_color'"):
        tr.render(scene_of(wall=sheet(attributes={"vertex_color": torch.rand(4, 3)})), outputs=("vertex_colour",))
    with pytest.raises(ValueError, match="no mesh has colours 'face_x'"):
        tr.render(scene_of(wall=sheet()), outputs=("face_x",))
    with pytest.raises(ValueError, match="at most 4 colours of meshes"):
        tr.render(scene_of(wall=sheet()), outputs=tuple(f"face_{i}" for i in range(5)))


def test_a_colour_is_recovered_from_its_image():
    """A least-squares fit of vertex colours through the output, with torch's own optimiser."""
    target = torch.tensor([[0.2, 0.5, 0.8], [0.7, 0.3, 0.2], [0.4, 0.9, 0.1], [0.6, 0.6, 0.6]])
    wide = tr.Transform.scale(0.3)
    scene = scene_of(torch.float32, wall=sheet(attributes={"vertex_color": target}, to_world=wide))
    with torch.no_grad():
        image = tr.render(scene, outputs=("vertex_color",), spp=4, seed=0).vertex_color
    colours = scene.wall.vertex_color
    with torch.no_grad():
        colours.fill_(0.5)
    colours.requires_grad_()
    optimiser = torch.optim.Adam([colours], lr=0.05)
    for _ in range(150):
        optimiser.zero_grad()
        found = tr.render(scene, outputs=("vertex_color",), spp=4, seed=0, correlated=True, seed_grad=0).vertex_color
        (found - image).square().sum().backward()
        optimiser.step()
    torch.testing.assert_close(colours.detach(), target, rtol=0, atol=5e-3)


def test_aov_integrator_has_partials():
    """Averages over all samples, zero beside the ball, as in Mitsuba: 2 pi (-y, x, 0), and pi times a meridian."""
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    to_world = tr.Transform.look_at([0.3, 0.2, 4], [0, 0, 0], [0, 1, 0])
    scene = tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "aov", "aovs": "a:dp_du,b:dp_dv,p:position"},
            "camera": {"type": "perspective", "fov": 40, "to_world": to_world, "film": film},
            "ball": {"type": "sphere"},
        },
        dtype=torch.float64,
    )
    image = tr.render(scene, spp=1, seed=0).numpy()
    u, v, p = image[..., :3], image[..., 3:6], image[..., 6:]
    hit = np.abs(p).max(-1) > 0
    x, y, z = p[hit].T
    np.testing.assert_allclose(u[hit], 2 * math.pi * np.stack([-y, x, 0 * x], 1), atol=1e-9)
    around = np.sqrt(x * x + y * y)
    np.testing.assert_allclose(v[hit], math.pi * np.stack([x * z / around, y * z / around, -around], 1), atol=1e-9)
    assert not u[~hit].any() and not v[~hit].any()
