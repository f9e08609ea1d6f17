"""Media that bend light have to be apart: those that touch, overlap or are nested are refused by name."""

from __future__ import annotations

import warnings

import pytest
import torch
from bent_scenes import BOX, DOUBLE
from gradientindex_scenes import T, seen

import torchrender as tr
from torchrender.gradientindex import apart

SKY = {"sky": {"type": "constant", "radiance": 1.0}}
MEDIUM = {"type": "gradientindex", "index": 1.3, "to_world": BOX}
TETRAHEDRON = tr.Mesh(
    torch.tensor([[-1.0, -1, -1], [1, 1, -1], [1, -1, 1], [-1, 1, 1]]),
    torch.tensor([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]),
    face_normals=True,
)


def other(shape: str = "sphere", place: torch.Tensor | None = None, bsdf: str = "null", **fields: object) -> dict:
    to_world = {} if place is None else {"to_world": place}
    return {"type": shape, "bsdf": {"type": bsdf}, "interior": MEDIUM, **to_world, **fields}


def render(shape: str = "sphere", /, **shapes: object) -> torch.Tensor:
    """The unit sphere, or another shape, of glass, and others."""
    return tr.render(seen(1.5, shape=shape, back={**shapes, **SKY}, size=2), spp=1, seed=0)


def ball(radius: float, at: list[float], **fields: object) -> dict:
    return other(radius=radius, center=at, **fields)


REFUSED = {
    "nested": ("sphere", ball(0.3, [0.2, 0, 0.1])),
    "around": ("sphere", ball(3.0, [0.5, 0, 0])),
    "overlapping": ("sphere", ball(1.2, [1.2, 0, 0])),
    "a cube in a ball": ("sphere", other("cube", T.scale(0.4))),
    "crossed bars": ("cube", other("cube", T.rotate([0, 0, 1], 45) @ T.scale([3, 0.2, 0.2]))),
    "half of a face": ("cube", other("cube", T.translate([0.7, 0.4, 2]))),
    "a small thing on a face": ("cube", other("cube", T.translate([0.3, 0.2, 1.05]) @ T.scale(0.05))),
    "a ball on a face": ("cube", ball(0.5, [0.0, 0.0, 1.5])),
    "almost touching": ("cube", other("cube", T.translate([0, 0, 2.00005]))),
    "a cylinder": ("sphere", other("cylinder", T.scale(0.5))),
    "glass": ("sphere", ball(0.3, [0.2, 0, 0.1], bsdf="dielectric")),
}


@pytest.mark.parametrize("name", REFUSED)
def test_not_apart(name):
    shape, thing = REFUSED[name]
    with pytest.raises(ValueError, match=r"render: (lens: touches .* of thing|thing: touches .* of lens), or is in it"):
        render(shape, thing=thing)


APART = {
    "balls": ("sphere", {"thing": ball(0.7, [1.8, 0, 0])}),
    "balls with common boxes": ("sphere", {"thing": ball(0.7, [1.0, 1.0, 1.0])}),
    "cubes": ("cube", {"thing": other("cube", T.translate([0, 0, 2.001]))}),
    "in a corner of its box": ("sphere", {"thing": ball(0.2, [0.8, 0.8, 0.8])}),
    "a thing that light goes straight in": (
        "sphere",
        {"thing": {"type": "sphere", "radius": 0.5, "bsdf": {"type": "null"}}},
    ),
}


@pytest.mark.parametrize("name", APART)
def test_apart(name):
    shape, shapes = APART[name]
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert bool(render(shape, **shapes).any())


@pytest.mark.parametrize("radius", [1.1, 1.2])
def test_in_the_hollow_of_a_shell(radius):
    """The shell's outer and inner boundary have one medium; a ball within it is apart, or larger than the hollow."""
    shell = tr.load_dict(MEDIUM, dtype=DOUBLE)
    scene = seen(
        1.5, back={"thing": ball(2.0, [0, 0, 0]), "hollow": ball(1.15, [0, 0, 0], flip_normals=True), **SKY}, size=2
    )
    scene["thing"].interior = scene["hollow"].interior = shell
    scene["lens"].radius = torch.tensor(radius, dtype=DOUBLE)
    if radius < 1.15:
        tr.render(scene, spp=1, seed=0)
        return
    with pytest.raises(ValueError, match=r"render: (lens|hollow): touches .* of (thing|hollow|lens)"):
        tr.render(scene, spp=1, seed=0)


def test_meshes_of_many_shapes():
    """Two that are in a third one's box, but not in it; then one of them is moved in, and back, by parameters."""
    scene = seen(
        1.5, shape="sphere", back={"a": ball(0.2, [0.8, 0.8, 0.8]), "b": ball(0.2, [-0.8, 0.8, 0.8]), **SKY}, size=2
    )
    tr.render(scene, spp=1, seed=0)
    with torch.no_grad():
        scene["b"].center.copy_(torch.tensor([-0.3, 0.3, 0.3]))
    with pytest.raises(ValueError, match=r"render: (b: touches .* of lens|lens: touches .* of b)"):
        tr.render(scene, spp=1, seed=0)
    with torch.no_grad():
        scene["b"].center.copy_(torch.tensor([-0.8, 0.8, 0.8]))
    tr.render(scene, spp=1, seed=0)


def test_a_mesh_on_a_mesh():
    """Two tetrahedra that share a face, and with a gap between them."""
    mirrored = TETRAHEDRON.vertices.clone()
    normal = torch.tensor([1.0, 1, 1]) / 3**0.5  # of the face of vertices 1, 2 and 3
    distance = 2 * ((mirrored - mirrored[1]) @ normal)[:, None] * normal
    for gap in (0.0, 0.01):
        scene = seen(1.5, back={"thing": ball(0.1, [5.0, 0, 0]), **SKY}, size=2)
        for name, vertices, faces in (
            ("lens", TETRAHEDRON.vertices, TETRAHEDRON.faces),
            ("thing", mirrored - distance + gap * normal, TETRAHEDRON.faces.flip(1)),
        ):
            mesh = tr.Mesh(vertices, faces, face_normals=True).to(DOUBLE)
            mesh.interior, mesh.bsdf = scene[name].interior, scene[name].bsdf
            scene[name] = mesh
        if gap:
            tr.render(scene, spp=1, seed=0)
        else:
            with pytest.raises(ValueError, match=r"(lens: touches .* of thing|thing: touches .* of lens)"):
                tr.render(scene, spp=1, seed=0)


def test_what_is_not_found_is_told_of(monkeypatch):
    """By rays that meet the other medium, where those that look for it do not."""
    monkeypatch.setattr(apart, "RAYS", 0)
    with pytest.warns(RuntimeWarning, match=r"rays in gradientindex media met the boundary of another one"):
        tr.render(seen(1.5, back={"thing": ball(0.3, [0.2, 0, 0.1]), **SKY}, size=12), spp=4, seed=0)


def test_within_transforms():
    """The check has no derivative, and is in the way of none."""
    scene = seen(1.5, back={"thing": ball(0.7, [1.0, 1.0, 1.0]), **SKY}, size=2)
    center = scene["thing"].center.detach()
    gradient = torch.func.grad(lambda c: tr.render(scene, spp=1, seed=0, params={"thing.center": c}).sum())(center)
    assert gradient.shape == (3,)
