"""Silhouettes and creases that the camera sees: closed forms, differences for every sensor, invariants, bad input.

Statistical tests are at 1 % for all of this file together, by Sidak's correction over its cases.
"""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import torch
import trimesh
from moving_differences import agrees, compare

import torchrender as tr

pytestmark = [pytest.mark.once, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]

DOUBLE = torch.float64
CASES = 60  # statistical tests in this file, at most
SEEDS = 6
AT = tr.Transform.look_at([0.1, 0.2, 4], [0, 0.05, 0], [0, 1, 0])
SENSORS = {
    "perspective": {"fov": 40, "principal_point_offset_x": 0.03},
    "distorted": {"type": "perspective", "fov": 40, "distortion": [-0.2, 0.05, 0.01, -0.01, 0.01]},
    "thinlens": {"fov": 40, "aperture_radius": 0.15, "focus_distance": 3.0},
    "orthographic": {"to_world": AT @ tr.Transform.scale([1.6, 1.6, 1])},
    "fisheye": {"fov": 60, "distortion": [0.05, -0.02, 0.0, 0.0]},
    "panorama": {},
}
FILTERS = ({"type": "box"}, {"type": "gaussian"}, {"type": "mitchell"})


def camera(kind: str = "perspective", size: int = 16, rfilter: dict = FILTERS[0], **more) -> dict:
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": rfilter}
    return {"type": kind, "to_world": AT, "film": film, **SENSORS.get(kind, {}), **more}


def glowing(radiance) -> dict:
    return {"type": "area", "radiance": {"type": "rgb", "value": radiance}}


def solid(vertices, faces, radiance, **more) -> tr.Mesh:
    return tr.Mesh(np.asarray(vertices, float), np.asarray(faces), emitter=glowing(radiance), **more)


LEAF = np.array([[-1, -0.6, 0.4], [0.3, -0.5, 0.6], [-0.2, 0.5, -0.2]])
BOX = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
BOX_FACES = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip
TURNED = tr.Transform.rotate([1, 2, 0.5], 40)


def box(*half: float) -> np.ndarray:
    """A turned box of these half sides around the origin."""
    return np.array(BOX) * np.array(half) @ TURNED.matrix[:3, :3].numpy().T


def emitters(kind: str = "perspective", rfilter: dict = FILTERS[0]) -> dict:
    """Everything emits, so that one bounce is the whole image: outlines before each other, a sky, and cut off."""
    tilted = tr.Transform.translate([0.4, -0.6, 0]) @ tr.Transform.rotate([1, 1, 0], 30) @ tr.Transform.scale(0.4)
    behind = tr.Transform.translate([0.3, 0.3, -1.5]) @ tr.Transform.scale(0.9)
    ends = {"p0": [-0.9, -0.9, -0.6], "p1": [0.9, -0.3, -0.9], "radius": 0.2}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 1},
        "camera": camera(kind, rfilter=rfilter),
        "box": solid(box(0.4, 0.3, 0.5) + np.array([0.5, 0.2, 0.3]), BOX_FACES, [3, 2, 1]),
        "leaf": solid(LEAF, [[0, 1, 2]], [0.2, 1.5, 2.5]),
        "ball": {"type": "sphere", "center": [-0.5, 0.3, -0.4], "radius": 0.5, "emitter": glowing([1, 0.3, 2])},
        "plate": {"type": "disk", "to_world": tilted, "emitter": glowing([2, 2, 0.1])},
        "pipe": {"type": "cylinder", **ends, "emitter": glowing([0.5, 2.5, 0.5])},
        "wall": {"type": "rectangle", "to_world": behind, "emitter": glowing([1, 1, 1])},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.3, 0.5, 0.8]}},
    }


SHAPES = ("box.vertex_positions", "leaf.vertex_positions", "ball.center", "ball.radius", "plate.to_world",
          "pipe.p0", "pipe.radius", "wall.to_world")  # fmt: skip


def check(scene: tr.Scene, parameter: str, rtol: float = 0.02, step: float = 5e-3, spp: int = 256) -> None:
    # (in single precision, whose packets take a fifth of the time)
    derivatives, differences = compare(scene.to(torch.float32), parameter, SEEDS, spp, step)
    passed, text = agrees(derivatives, differences, rtol, CASES)
    assert passed, f"{parameter}: {text}"
    assert float(differences.abs().mean()) > 1e-4


@pytest.mark.parametrize("parameter", SHAPES)
def test_shapes(parameter):
    check(tr.load_dict(emitters(), dtype=DOUBLE), parameter)


@pytest.mark.parametrize("kind", SENSORS)
def test_sensors(kind):
    scene = emitters()
    scene["camera"] = camera(SENSORS[kind].get("type", kind), **SENSORS[kind])
    loaded = tr.load_dict(scene, dtype=DOUBLE)
    check(loaded, "camera.to_world", step=2e-3)
    check(loaded, "box.vertex_positions")


@pytest.mark.parametrize(
    ("kind", "parameter", "step"),
    [("perspective", "x_fov", 0.2), ("perspective", "principal_point_offset_x", 2e-3),
     ("distorted", "distortion", 5e-3),
     ("thinlens", "aperture_radius", 1e-2), ("thinlens", "focus_distance", 3e-2), ("fisheye", "x_fov", 0.2)],
)  # fmt: skip
def test_lenses(kind, parameter, step):
    scene = emitters()
    scene["camera"] = camera(SENSORS[kind].get("type", kind), **SENSORS[kind])
    check(tr.load_dict(scene, dtype=DOUBLE), f"camera.{parameter}", step=step, spp=600)


@pytest.mark.parametrize("rfilter", FILTERS[1:], ids=lambda f: f["type"])
@pytest.mark.parametrize("parameter", ["ball.center", "camera.to_world"])
def test_filters(rfilter, parameter):
    check(tr.load_dict(emitters(rfilter=rfilter), dtype=DOUBLE), parameter)


def measured(sensor: dict) -> tr.Scene:
    """A ball and a box above a floor under a lamp and a sky; two far balls keep the size of the scene as it is."""
    corners = [-2.2, -2.2, -0.5], [2.2, 2.2, 3.5]
    far = {f"far{i}": {"type": "sphere", "center": c, "radius": 0.1} for i, c in enumerate(corners)}
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    lamp = tr.Transform.translate([1, 0.5, 3]) @ tr.Transform.scale([0.4, 0.4, -0.4])
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "camera": {**sensor, "film": film},
            "ball": {"type": "sphere", "center": [0.3, 0.1, 0.6], "radius": 0.4},
            "box": tr.Mesh(box(0.3, 0.2, 0.4) + np.array([-0.6, 0.1, 0.5]), BOX_FACES),
            "floor": {"type": "rectangle", "to_world": tr.Transform.scale(2)},
            "lamp": {"type": "rectangle", "to_world": lamp, "emitter": glowing([400, 400, 400])},
            "sky": {"type": "constant", "radiance": 30.0},
            **far,
        },
        dtype=DOUBLE,
    )


@pytest.mark.parametrize("parameter", ["ball.center", "box.vertex_positions", "lamp.to_world"])
@pytest.mark.parametrize(
    "sensor",
    [
        {"type": "distant", "direction": [0.3, 0.2, -1]},
        {"type": "distant", "direction": [0.3, 0.2, -1], "target": [-0.25, -0.15, 0]},
        {"type": "radiancemeter", "origin": [0.5, -3, 2], "direction": [-0.75, 2.85, -2]},
    ],
    ids=["distant", "distant, one point", "radiancemeter"],
)
def test_sensors_of_one_pixel(sensor, parameter):
    """What moves on the way to a single point is a jump of its derivative, but light there comes from a whole sky."""
    check(measured(sensor), parameter, spp=20000)


@pytest.mark.parametrize("depth", [2, 3])
def test_the_direction_of_distant(depth):
    scene = measured({"type": "distant", "direction": [0.3, 0.2, -1]})
    scene.integrator.max_depth = depth
    check(scene, "camera.to_world", spp=20000, step=4e-3)


def shaded(bsdf: dict, kind: str) -> tr.Scene:
    """A convex body, which casts no shadow on itself, under a sky of many colours."""
    sky = np.random.default_rng(3).uniform(0.2, 2, (8, 16, 3))
    body = {
        "cube": tr.Mesh(box(0.6, 0.6, 0.6), BOX_FACES),
        "sphere": {"type": "sphere", "radius": 0.8},
        "seams": {"type": "cube", "to_world": TURNED @ tr.Transform.scale(0.6)},
    }[kind]
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "camera": camera(),
        "body": body,
        "sky": {"type": "envmap", "data": sky},
    }
    loaded = tr.load_dict(scene, dtype=DOUBLE)
    loaded["body"].bsdf = bsdf
    return loaded


@pytest.mark.parametrize(
    ("kind", "parameter"),
    [("cube", "body.vertex_positions"), ("seams", "camera.to_world"), ("sphere", "body.center"),
     ("cube", "camera.to_world")],
)  # fmt: skip
def test_shaded_bodies(kind, parameter):
    """Silhouettes, and creases between faces of other brightness."""
    check(shaded({"type": "diffuse", "reflectance": 0.8}, kind), parameter, spp=600)


# ----------------------------------------------------------------------------------------------------- closed forms
FOCAL = 8 / math.tan(math.radians(20))  # pixels, of 16


def frontal(**objects) -> tr.Scene:
    to_world = tr.Transform.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 1},
            "camera": camera(to_world=to_world, principal_point_offset_x=0.0),
            **objects,
        },
        dtype=DOUBLE,
    )


def gradient(scene: tr.Scene, name: str, columns: slice = slice(None), output: str | None = None) -> torch.Tensor:
    (leaf,) = scene.train_only(name)
    total = torch.zeros_like(leaf)
    for seed in range(4):
        image = tr.render(scene, spp=64, seed=seed, outputs=None if output is None else (output,))
        image = image[..., 0] if output is None else image[0]
        total += torch.autograd.grad(image[:, columns].sum(), leaf)[0] / 4
    return total


def test_a_frontal_disk():
    """Flux (difference of radiance) pi (f R / D)^2 by radius, distance, field of view; and sideways on half a film."""
    radius, contrast = 0.6, 1.5
    disk = {"type": "disk", "to_world": tr.Transform.scale(radius), "emitter": glowing([2, 2, 2])}
    scene = frontal(disk=disk, sky={"type": "constant", "radiance": 0.5})
    flux = contrast * math.pi * (FOCAL * radius / 4) ** 2
    matrix = gradient(scene, "disk.to_world")
    assert float(matrix[0, 0] + matrix[1, 1]) == pytest.approx(2 * flux / radius, rel=5e-3)
    assert float(matrix[2, 3]) == pytest.approx(2 * flux / 4, rel=5e-3)
    sideways = float(gradient(scene, "disk.to_world", slice(8, None))[0, 3])  # +x is to the right
    assert sideways == pytest.approx(2 * contrast * FOCAL**2 * radius / 16, rel=1e-2)
    by_fov = -8 / math.sin(math.radians(20)) ** 2 * math.pi / 360 * 2 * flux / FOCAL
    assert float(gradient(scene, "camera.x_fov")) == pytest.approx(by_fov, rel=5e-3)
    alone = frontal(disk=disk)
    matrix = gradient(alone, "disk.to_world", output="alpha")
    assert float(matrix[0, 0] + matrix[1, 1]) == pytest.approx(2 * flux / contrast / radius, rel=5e-3)


@pytest.mark.parametrize("subdivisions", [None, 4, 6])  # of the last one there are so many edges that they are rounded
def test_a_sphere_on_the_axis(subdivisions):
    """Its picture is a disk of radius f R / sqrt(D^2 - R^2)."""
    radius, mesh = 0.7, subdivisions is not None
    ball: object = {"type": "sphere", "radius": radius}
    if mesh:
        shape = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
        ball = tr.Mesh(shape.vertices, shape.faces, vertex_normals=shape.vertices)
    scene = frontal(ball=ball, sky={"type": "constant", "radiance": 1.0})
    by_radius = -2 * math.pi * FOCAL**2 * radius * 16 / (16 - radius**2) ** 2
    by_distance = -2 * math.pi * FOCAL**2 * radius**2 * 4 / (16 - radius**2) ** 2
    if mesh:
        g = gradient(scene, "ball.vertex_positions")
        positions = scene.ball.vertex_positions.detach()
        found = float((g * positions).sum() / radius), float(g[:, 2].sum())
    else:
        found = float(gradient(scene, "ball.radius")), float(gradient(scene, "ball.center")[2])
    assert found[0] == pytest.approx(by_radius, rel=1e-2)
    assert found[1] == pytest.approx(by_distance, rel=1e-2)


# -------------------------------------------------------------------------------------------------------- invariants
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_forward_mode_is_reverse_mode(dtype):
    scene = tr.load_dict(emitters("thinlens", FILTERS[1]), dtype=dtype)
    names = [*SHAPES, "camera.to_world", "camera.aperture_radius"]
    values = [scene.get_parameter(n).detach() for n in names]

    def f(*tensors):
        return tr.render(scene, spp=4, seed=5, params=dict(zip(names, tensors)))

    result = tr.testing.dot_product_test(f, values, rtol=1e-10 if dtype == DOUBLE else 2e-4)
    assert result, result.message


def test_everything_moved_together_changes_nothing():
    """The sky is constant: a rigid motion of shapes and camera leaves the image, pixel by pixel, as it is."""
    scene = tr.load_dict(emitters(), dtype=DOUBLE)
    names = ("box.vertex_positions", "leaf.vertex_positions", "ball.to_world", "plate.to_world", "pipe.to_world",
             "wall.to_world", "camera.to_world")  # fmt: skip
    values = {n: scene.get_parameter(n).detach() for n in names}
    spin = torch.zeros(4, 4, dtype=DOUBLE)
    spin[:3, :3] = torch.tensor([[0, -0.3, 0.5], [0.3, 0, -0.2], [-0.5, 0.2, 0]], dtype=DOUBLE)
    spin[:3, 3] = torch.tensor([0.4, -0.2, 0.7], dtype=DOUBLE)
    changes = {n: v @ spin[:3, :3].T + spin[:3, 3] if v.shape[1] == 3 else spin @ v for n, v in values.items()}

    def f(*tensors):
        return tr.render(scene, spp=16, seed=2, params=dict(zip(names, tensors)))

    _, change = torch.func.jvp(f, tuple(values.values()), tuple(changes.values()))
    _, parts = torch.func.jvp(
        lambda c: tr.render(scene, spp=16, seed=2, params={"camera.to_world": c}),
        (values["camera.to_world"],),
        (changes["camera.to_world"],),
    )
    assert float(change.abs().max()) < 1e-9 * float(parts.abs().max())


def test_what_glows_like_the_sky_is_not_seen_to_move():
    scene = emitters()
    for name in ("box", "leaf", "ball", "plate", "pipe", "wall"):
        if isinstance(scene[name], dict):
            scene[name]["emitter"] = glowing([0.3, 0.5, 0.8])
        else:
            scene[name].emitter = glowing([0.3, 0.5, 0.8])
    loaded = tr.load_dict(scene, dtype=DOUBLE)
    leaves = loaded.train_only(*SHAPES, "camera.to_world")
    tr.render(loaded, spp=16, seed=1).square().sum().backward()
    assert all(float(leaf.grad.abs().max()) < 1e-12 for leaf in leaves)


def test_coplanar_faces_and_split_vertices_change_nothing():
    """More faces in the same plane, and vertices of its own for every face, which are welded: the same total."""
    once = solid([[-0.6, -0.5, 0], [0.7, -0.4, 0.2], [0.1, 0.6, 0.1]], [[0, 1, 2]], [2, 1, 1])
    corners = once.vertex_positions.detach().numpy()
    middle = corners.mean(0, keepdims=True)
    fan = np.concatenate([corners, middle])
    faces = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])
    split = fan[faces.flatten()]
    found = []
    for vertices, indices in ((corners, [[0, 1, 2]]), (fan, faces), (split, np.arange(9).reshape(3, 3))):
        scene = tr.load_dict({**emitters(), "leaf": solid(vertices, indices, [2, 1, 1])}, dtype=DOUBLE)
        (leaf,) = scene.train_only("leaf.vertex_positions")
        tr.render(scene, spp=1, seed=1, spp_visibility=256)[:, :8].sum().backward()
        found.append(leaf.grad.sum(0))
    for other in found[1:]:
        torch.testing.assert_close(other, found[0], rtol=2e-2, atol=0.05)


def test_single_precision_is_double_precision():
    gradients = []
    for dtype in (torch.float32, DOUBLE):
        scene = tr.load_dict(emitters(), dtype=dtype)
        leaves = scene.train_only(*SHAPES, "camera.to_world")
        weight = torch.linspace(0.5, 1.5, 256).reshape(16, 16, 1).to(dtype)
        (tr.render(scene, spp=64, seed=1) * weight).sum().backward()
        gradients.append([leaf.grad.double() for leaf in leaves])
    for single, double in zip(*gradients):
        assert float((single - double).norm()) < 0.02 * float(double.norm())


def test_pixels_and_crops_have_their_part():
    scene = tr.load_dict(emitters(rfilter=FILTERS[1]), dtype=DOUBLE)
    (leaf,) = scene.train_only("ball.center")
    found = []
    rows, columns = torch.meshgrid(torch.arange(3, 9), torch.arange(4, 13), indexing="ij")
    pixels = torch.stack([rows.flatten(), columns.flatten()], 1)
    for settings in ({}, {"crop": (3, 4, 6, 9)}, {"pixels": pixels}):
        image = tr.render(scene, spp=256, seed=1, spp_visibility=512, **settings)
        part = image[3:9, 4:13] if not settings else image
        found.append(torch.autograd.grad(part.sum(), leaf)[0])
    for other in found[1:]:
        torch.testing.assert_close(other, found[0], rtol=0.02, atol=0.05)


def test_the_same_seed_gives_the_same_gradient():
    scene = tr.load_dict(emitters(), dtype=torch.float32)
    leaves = scene.train_only(*SHAPES)
    found = []
    for threads in (1, 2, 2):
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
        try:
            found.append(torch.autograd.grad(tr.render(scene, spp=8, seed=4).sum(), leaves))
        finally:
            torch.set_num_threads(before)
    for other in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], other))


def bumpy(subdivisions, amount):
    """A scene with a smooth ball of so many triangles, and its vertices with bumps."""
    ball = trimesh.creation.icosphere(subdivisions, radius=0.7)
    vertices = torch.from_numpy(ball.vertices.copy()).float()
    mesh = tr.Mesh(vertices, torch.from_numpy(ball.faces.copy()))
    mesh.compute_normals()
    path = {"type": "path", "max_depth": 2}
    scene = tr.load_dict({**emitters(), "integrator": path, "bumpy": mesh}, dtype=torch.float32)
    bumps = torch.randn(vertices.shape, generator=torch.Generator().manual_seed(3))
    return scene, (vertices + amount * bumps).requires_grad_()


def bumpy_gradient(scene, vertices, subdivisions=5):
    smoothing = tr.optim.MeshSmoothing(
        len(vertices), torch.from_numpy(trimesh.creation.icosphere(subdivisions).faces.copy()), 2.0
    )
    u = smoothing.to_differential(vertices.detach()).requires_grad_()
    image = tr.render(scene, spp=2, seed=4, params={"bumpy.vertex_positions": smoothing.from_differential(u)})
    return torch.autograd.grad(image.square().sum(), u)[0]


def test_large_meshes_with_normals_of_their_own_have_the_same_gradient():
    # Enough corners for PyTorch's threads: indexing would add them up in the order in which these come.
    scene, vertices = bumpy(5, 0.003)
    found = [bumpy_gradient(scene, vertices) for _ in range(4)]
    assert all(torch.equal(found[0], other) for other in found[1:])


def test_gradients_do_not_depend_on_earlier_ones():
    # What is known of outlines is kept from call to call.
    scene, vertices = bumpy(3, 0.05)
    flat = torch.cat([vertices[:, :2], torch.zeros(len(vertices), 1)], 1).detach().requires_grad_()
    fresh = bumpy_gradient(scene, vertices, 3)
    other, _ = bumpy(3, 0.0)
    for earlier in (torch.zeros_like(vertices).requires_grad_(), flat, flat * 1.5 + 0.2):  # no area; another order
        bumpy_gradient(other, earlier, 3)
    # Not to the last bit: rays that meet an edge may take the other triangle in a tree that has followed the mesh.
    torch.testing.assert_close(bumpy_gradient(other, vertices, 3), fresh, rtol=0, atol=1e-3 * float(fresh.abs().max()))


def test_rounded_edges_do_not_depend_on_earlier_calls():
    """Those of scenes with more than 65536."""
    shape = trimesh.creation.icosphere(6, radius=0.7)
    ball = tr.Mesh(shape.vertices, shape.faces, vertex_normals=shape.vertices)
    path = {"type": "path", "max_depth": 2}

    def sums(scene, moved=0.0):
        x = scene.get_parameter("bumpy.vertex_positions").detach() + torch.tensor([moved, 0.0, 0.0])
        x.requires_grad_()
        image = tr.render(scene, spp=4, seed=4, params={"bumpy.vertex_positions": x})
        return torch.autograd.grad(image.square().sum(), x)[0].sum(0)

    scene, other = (tr.load_dict({**emitters(), "integrator": path, "bumpy": ball}) for _ in range(2))
    fresh = sums(scene)
    assert torch.equal(sums(scene), fresh)  # nothing has moved: what is known is used as it is
    moved = sums(other, 0.3)
    assert (moved - fresh).norm() > 0.05 * fresh.norm()
    torch.testing.assert_close(sums(other), fresh, rtol=0, atol=1e-3 * float(fresh.abs().max()))


# ---------------------------------------------------------------------------------------------------- switches, input
def test_switched_off():
    scene = tr.load_dict(emitters(), dtype=DOUBLE)
    (leaf,) = scene.train_only("ball.center")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for settings in ({"visibility": False}, {"visibility": False, "outputs": ("rgb", "alpha")}):
            image = tr.render(scene, spp=4, seed=1, **settings)
            image = image if isinstance(image, torch.Tensor) and not isinstance(image, tuple) else image.rgb
            assert float(torch.autograd.grad(image.sum(), leaf)[0].abs().max()) < 1e-12
    image = tr.render(scene, spp=4, seed=1, spp_visibility=0)
    assert float(torch.autograd.grad(image.sum(), leaf)[0].abs().max()) < 1e-12
    assert torch.equal(tr.render(scene, spp=4, seed=1), tr.render(scene, spp=4, seed=1, visibility=False))


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"visibility": 1}, TypeError, "visibility: expected True or False, got"),
        ({"spp_visibility": -1}, ValueError, "spp_visibility: expected a number from 0"),
        ({"spp_visibility": 1.5}, TypeError, "spp_visibility: expected an integer"),
    ],
)
def test_refused(settings, error, message):
    scene = tr.load_dict(emitters(), dtype=torch.float32)
    with pytest.raises(error, match=message):
        tr.render(scene, spp=1, **settings)


def test_degenerate_meshes():
    """Faces without area, doubled and non-manifold ones, points behind the camera: finite."""
    good = np.array([[-0.6, -0.5, 0], [0.7, -0.4, 0.2], [0.1, 0.6, 0.1], [0.1, 0.1, 8.0], [0.2, 0.7, -3.0]])
    faces = [[0, 1, 2], [0, 1, 2], [0, 0, 1], [0, 1, 4], [1, 0, 3], [2, 2, 2]]
    scene = tr.load_dict({**emitters(), "leaf": solid(good, faces, [2, 1, 1])}, dtype=DOUBLE)
    (leaf,) = scene.train_only("leaf.vertex_positions")
    tr.render(scene, spp=4, seed=1).sum().backward()
    assert bool(leaf.grad.isfinite().all()) and float(leaf.grad.abs().max()) > 0


def test_hidden_emitters_have_no_outlines():
    scene = emitters()
    scene["integrator"]["hide_emitters"] = True
    loaded = tr.load_dict(scene, dtype=DOUBLE)
    leaves = loaded.train_only(*SHAPES)
    image = tr.render(loaded, spp=4, seed=1)
    grads = torch.autograd.grad(image.sum(), leaves, allow_unused=True)
    assert all(g is None or float(g.abs().max()) < 1e-12 for g in grads)


def test_another_topology_has_other_edges():
    scene = tr.load_dict(emitters(), dtype=DOUBLE)
    peak = np.concatenate([LEAF, LEAF.mean(0, keepdims=True) + np.array([0, 0, 0.3])])
    for vertices, faces in ((LEAF, [[0, 1, 2]]), (peak, [[0, 1, 3], [1, 2, 3], [2, 0, 3]])):
        scene["leaf"] = solid(vertices, faces, [0.2, 1.5, 2.5])
        check(scene, "leaf.vertex_positions")
