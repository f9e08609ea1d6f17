"""Derivatives of the outputs of the first hit with respect to surfaces, textures and the camera.

The views are filled by one surface, so that nothing appears or disappears: with the same samples a finite difference
has no noise, only the error of its step. (Creases move there; see test_outputs_outlines.)
"""

from __future__ import annotations

import warnings

import pytest
import torch
from output_scenes import ALL, REAL

import torchrender as tr

COLOURS = "vertex_color"
STEP = 1e-5  # relative error of a central difference of smooth functions in double precision: below 1e-6


def texture(seed: int = 0, channels: int = 3) -> dict:
    data = torch.rand(5, 6, channels, generator=torch.Generator().manual_seed(seed))
    return {"type": "bitmap", "data": data, "raw": True, "wrap_mode": "clamp"}


def wavy_mesh(flat: bool) -> tr.Mesh:
    """A sheet of 18 triangles, seen from +z; normals of its own that are no unit vectors, or those of the faces."""
    n = 4
    steps = torch.linspace(-4, 4, n)
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    vertices = torch.stack([x, y, 0.3 * torch.sin(1.1 * x + y)], -1).reshape(-1, 3)
    corners = [(j * n + i, j * n + i + 1, j * n + i + n, j * n + i + n + 1) for j in range(n - 1) for i in range(n - 1)]
    faces = torch.tensor([f for a, b, c, d in corners for f in ((a, b, c), (b, d, c))])
    normals = torch.stack([-0.3 * torch.cos(x + y), 0.1 * x, 1 + 0.1 * y], -1).reshape(-1, 3)
    colours = torch.rand(n * n, 3, generator=torch.Generator().manual_seed(8))
    paint = {
        "type": "redner",
        "diffuse_reflectance": texture(),
        "specular_reflectance": texture(1),
        "roughness": texture(2, channels=1),
    }
    return tr.Mesh(
        vertices,
        faces,
        vertex_normals=None if flat else normals,
        vertex_texcoords=torch.stack([x, y], -1).reshape(-1, 2) / 8 + 0.5,
        face_normals=flat,
        bsdf={"type": "twosided", "bsdf": paint},
        attributes={COLOURS: colours, "face_color": torch.rand(len(faces), 3)},
    )


def plate(kind: str, **more) -> dict:
    turned = tr.Transform.rotate([0.6, 0.8, 0], 20)
    place = {
        "rectangle": turned @ tr.Transform.scale([5, 4, 1]),
        "heightfield": turned @ tr.Transform.scale([5, 4, 1]),
        "disk": tr.Transform.translate([-1.9, 1.2, 0]) @ turned @ tr.Transform.scale([5, 6, 1]),
    }[kind]
    return {"type": kind, "to_world": place, "bsdf": {"type": "diffuse", "reflectance": texture()}, **more}


SURFACES = {
    "smooth mesh": lambda: wavy_mesh(flat=False),
    "flat mesh": lambda: wavy_mesh(flat=True),
    "rectangle": lambda: plate("rectangle"),
    "flipped rectangle": lambda: plate("rectangle", flip_normals=True),
    "disk": lambda: plate("disk"),
    "height field": lambda: plate("heightfield", heights=torch.sin(torch.arange(20.0)).reshape(4, 5) * 0.2),
    "distances": lambda: {
        "type": "sdfgrid",
        "grid": torch.linspace(-0.5, 0.6, 4)[:, None, None] + 0.02 * torch.sin(torch.arange(80.0)).reshape(4, 5, 4),
        "to_world": tr.Transform.rotate([0.6, 0.8, 0], 20)
        @ tr.Transform.scale([10, 8, 2]).translate([-0.5, -0.5, -0.5]),
        "bsdf": {"type": "diffuse", "reflectance": texture()},
    },
    "cylinder": lambda: {
        "type": "cylinder",
        "p0": [-7.0, 1.0, -4.0],
        "p1": [8.0, -0.5, -3.0],
        "radius": 3.9,
        "bsdf": {"type": "roughplastic", "diffuse_reflectance": texture(), "alpha": 0.2},
    },
    "carved sphere": lambda: {
        "type": "sphere",
        "center": [0.3, 0.2, -3.0],
        "radius": 3.9,
        "bsdf": {
            "type": "roughconductor",
            "alpha": {"type": "volume", "volume": {"type": "gridvolume", "data": texture(3, 4)["data"][..., None]}},
            "specular_reflectance": {
                "type": "volume",
                "volume": {
                    "type": "gridvolume",
                    "data": torch.rand(4, 5, 6, 3, generator=torch.Generator().manual_seed(4)),
                    "to_world": tr.Transform.translate([-2, -2, 0.2]) @ tr.Transform.scale([4, 4, 0.9]),
                },
            },
        },
    },
    "sphere": lambda: {
        "type": "sphere",
        "center": [0.3, 0.2, -3.0],
        "radius": 3.9,
        "bsdf": {"type": "diffuse", "reflectance": texture()},
    },
}


def scene_with(surface, integrator: dict | None = None, rfilter: str = "gaussian", **settings) -> tr.Scene:
    film = {"type": "hdrfilm", "width": 4, "height": 3, "rfilter": {"type": rfilter}}
    camera = {
        "type": "perspective",
        "fov": 35,
        "principal_point_offset_x": 0.02,
        "near_clip": 0.5,
        "to_world": tr.Transform.look_at([0.5, 0.3, 4], [0.1, 0, 0]),
        "film": film,
    }
    more = {} if integrator is None else {"integrator": integrator}
    return tr.load_dict({"type": "scene", "camera": camera, "wall": surface, **more}, dtype=torch.float64, **settings)


def differentiable(scene: tr.Scene) -> list[str]:
    names = []
    for name, _ in scene.named_parameters():
        try:
            scene.train_only(name)
        except tr.NotDifferentiableError:
            continue
        names.append(name)
    scene.train_only()
    return names


def direction(name: str, shape: torch.Size, seed: int = 3) -> torch.Tensor:
    random = torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    if name.endswith("to_world"):
        random[3] = 0
    return random


def check(scene: tr.Scene, name: str, outputs) -> None:
    """`outputs(value)`, a tuple of tensors: forward mode against finite differences, reverse against forward mode."""
    value = scene.get_parameter(name).detach().clone()
    tangent = direction(name, value.shape)
    base, derivative = torch.func.jvp(outputs, (value,), (tangent,))
    up, down = outputs(value + STEP * tangent), outputs(value - STEP * tangent)
    for i, found in enumerate(derivative):
        expected = (up[i] - down[i]) / (2 * STEP)
        scale = float(expected.abs().mean())
        torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-3 * scale + 1e-6, msg=lambda m, i=i: f"{i}: {m}")
    generator = torch.Generator().manual_seed(5)
    weights = [torch.rand(b.shape, generator=generator, dtype=torch.float64) for b in base]
    leaf = value.requires_grad_()
    loss = sum((o * w).sum() for o, w in zip(outputs(leaf), weights, strict=True))
    (gradient,) = torch.autograd.grad(loss, leaf)
    forward = sum(float((d * w).sum()) for d, w in zip(derivative, weights, strict=True))
    size = sum(float((d * w).abs().sum()) for d, w in zip(derivative, weights, strict=True))
    assert abs(float((gradient * tangent).sum()) - forward) <= 1e-10 * size


CASES = [(surface, name) for surface in SURFACES for name in differentiable(scene_with(SURFACES[surface]()))]


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize(("surface", "name"), CASES)
def test_every_output_by_every_parameter(surface, name):
    scene = scene_with(SURFACES[surface]())
    colours = (COLOURS, "face_color") if "mesh" in surface else ()

    def outputs(value: torch.Tensor) -> tuple[torch.Tensor, ...]:
        names = (*REAL, *colours)
        return tuple(
            tr.render(scene, spp=3, seed=1, correlated=True, visibility=False, outputs=names, params={name: value})
        )

    assert bool(torch.isfinite(outputs(scene.get_parameter(name).detach())[0]).all())  # the view is filled
    check(scene, name, outputs)


def test_the_cases_move_what_they_should():
    """No derivative is zero for want of an implementation: each surface moves its hits, normals and look-ups."""
    expected = {"wall.vertex_positions", "wall.vertex_normals", "wall.vertex_texcoords", "wall.to_world"}
    expected |= {"wall.center", "wall.radius", "camera.to_world", "camera.x_fov", "camera.principal_point_offset_x"}
    assert expected <= {name for _, name in CASES}
    scene = scene_with(SURFACES["smooth mesh"]())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tr.MissingTermWarning)
        scene.train_only("wall.vertex_positions", "camera.to_world")
        found = tr.render(scene, spp=3, seed=1, outputs=(*REAL, COLOURS))
        for name in (*REAL, COLOURS):
            scene.zero_grad()
            getattr(found, name).square().sum().backward(retain_graph=True)
            assert float(scene.get_parameter("wall.vertex_positions").grad.abs().max()) > 1e-6, name


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize("name", ["wall.vertex_positions", "camera.x_fov", "camera.to_world", "camera.pixel_aspect"])
def test_channels_of_the_aov_integrator(name):
    """The length of the ray from the near plane, which moves with the field of view."""
    scene = scene_with(SURFACES["smooth mesh"](), integrator={"type": "aov", "aovs": "d:depth,n:sh_normal,p:position"})

    def outputs(value: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return (tr.render(scene, spp=3, seed=1, correlated=True, params={name: value}),)

    check(scene, name, outputs)


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
def test_depth_of_a_plane_in_closed_form():
    """A camera that moves by dz towards a plane: depth falls by dz, distance by dz / cosine, normals stay."""
    scene = scene_with(plate("rectangle"))
    with torch.no_grad():
        scene.get_parameter("wall.to_world").copy_(torch.diag(torch.tensor([9.0, 9.0, 1.0, 1.0])))
        pose = torch.as_tensor(tr.Transform.look_at([0, 0, 4], [0, 0, 0]).matrix)
        scene.get_parameter("camera.to_world").copy_(pose)
    tangent = torch.zeros(4, 4, dtype=torch.float64)
    tangent[2, 3] = -1.0

    def outputs(value: torch.Tensor):
        names = ("depth", "distance", "normal", "uv", "position")
        found = tr.render(
            scene, spp=1, seed=1, correlated=True, visibility=False, outputs=names, params={"camera.to_world": value}
        )
        return tuple(found)

    pose = scene.get_parameter("camera.to_world").detach()
    base, derivative = torch.func.jvp(outputs, (pose,), (tangent,))
    depth, distance, normal, _, position = derivative
    scene_filter = torch.full_like(depth, -1.0)
    torch.testing.assert_close(depth, scene_filter, rtol=1e-9, atol=0)
    # with one sample a pixel and the Gaussian filter these are averages of 1 / cosine >= 1
    assert bool((distance <= -1 + 1e-12).all()) and bool((distance > -1.3).all())
    assert float(normal.abs().max()) < 1e-12
    torch.testing.assert_close(position[..., :2], -base[4][..., :2] / 4, rtol=1e-9, atol=1e-12)


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
def test_optimising_a_camera_by_depth_and_normals():
    """A pose recovered from outputs alone, which need one sample a pixel and no light."""
    scene = scene_with(SURFACES["smooth mesh"](), rfilter="box")
    camera = scene.get_parameter("camera.to_world")
    true = camera.detach().clone()
    settings = {"spp": 4, "seed": 1, "correlated": True, "outputs": ("depth", "shading_normal")}
    target = tr.render(scene, **settings)
    offset = torch.tensor([0.15, -0.1, 0.2], dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.LBFGS([offset], max_iter=25, line_search_fn="strong_wolfe")

    def moved() -> torch.Tensor:
        column = torch.cat([offset, torch.zeros(1, dtype=torch.float64)])
        return true + torch.nn.functional.pad(column[:, None], (3, 0))

    def loss() -> torch.Tensor:
        optimizer.zero_grad()
        found = tr.render(scene, params={"camera.to_world": moved()}, **settings)
        value = (found.depth - target.depth).square().mean()
        value = value + (found.shading_normal - target.shading_normal).square().mean()
        value.backward()
        return value

    optimizer.step(loss)
    assert float(offset.detach().abs().max()) < 1e-3


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
def test_gradients_where_nothing_is_hit_are_zero_and_finite():
    """Pixels whose depth is infinite give no gradient, whatever the loss does with their adjoints that are finite."""
    scene = scene_with({"type": "sphere", "radius": 0.2, "bsdf": {"type": "diffuse"}}, rfilter="box")
    scene.train_only("wall.center", "camera.to_world")
    found = tr.render(scene, spp=2, seed=1, outputs=ALL)
    assert bool((found.depth == float("inf")).any()) and bool((found.shape_id == -1).any())
    loss = torch.where(torch.isfinite(found.depth), found.depth, 0).sum() + found.normal.sum()
    loss.backward()
    for name in ("wall.center", "camera.to_world"):
        assert bool(torch.isfinite(scene.get_parameter(name).grad).all()), name
