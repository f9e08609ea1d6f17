"""Derivatives with respect to everything that moves: against finite differences, and forward against reverse mode.

Three classes. Smooth: what only looks up values, in test_parameters_derivatives.py. Moving but continuous: scenes
without edges in view or in their light (motion_scenes.py), where the term inside surfaces is the whole derivative.
Discontinuous: silhouettes and shadows move; more of that in test_visibility.py and test_shadows.py.

Derivative and differences use the same samples, so that most of the noise of a seed cancels in their difference. What
is tested is the mean of that difference over the seeds (Student).
"""

from __future__ import annotations

import functools
import warnings

import motion_scenes
import pytest
import reference_scenes
import torch
from moving_differences import agrees, compare

import torchrender as tr
from torchrender.scene.declaration import models

pytestmark = pytest.mark.once  # takes long; other derivatives are tested at every instruction set

SEEDS = 8
LENS = {"to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y", "pixel_aspect"}


# fields that say where something is, not how it looks
MOVING = {
    ("shape", "mesh"): {"vertex_positions", "vertex_normals", "vertex_texcoords"},
    ("shape", "sphere"): {"to_world", "center", "radius"},
    ("shape", "disk"): {"to_world"},
    ("shape", "cylinder"): {"to_world", "p0", "p1", "radius"},
    ("volume", "gridvolume"): {"to_world"},
    ("shape", "heightfield"): {"to_world", "heights"},
    ("shape", "sdfgrid"): {"to_world", "grid"},
    ("shape", "rectangle"): {"to_world"},
    ("shape", "bsplinecurve"): {"control_points", "radii"},
    ("shape", "linearcurve"): {"control_points", "radii"},
    ("texture", "bitmap"): {"to_uv"},
    ("texture", "mesh_attribute"): {"scale"},
    ("emitter", "envmap"): {"to_world"},
    ("emitter", "point"): {"position"},
    ("emitter", "directional"): {"to_world"},
    ("emitter", "spot"): {"to_world", "cutoff_angle", "beam_width"},
    ("emitter", "projector"): {"to_world", "x_fov"},
    ("bsdf", "dielectric"): {"eta"},
    ("bsdf", "roughdielectric"): {"eta"},
    ("bsdf", "anisotropicdielectric"): {"eta"},
    ("bsdf", "thindielectric"): {"eta"},
    ("bsdf", "plastic"): {"eta"},
    ("bsdf", "roughplastic"): {"eta", "alpha"},
    ("bsdf", "pplastic"): {"eta"},
    ("bsdf", "principled"): {"eta", "specular"},
    ("bsdf", "hair"): {"longitudinal_roughness", "azimuthal_roughness", "scale_tilt", "eta", "scale"},
    ("bsdf", "bumpmap"): {"scale"},
    ("sensor", "perspective"): LENS | {"distortion"},
    ("sensor", "thinlens"): LENS | {"aperture_radius", "focus_distance"},
    ("sensor", "orthographic"): {"to_world"},
    ("sensor", "fisheye"): LENS | {"distortion"},
    ("sensor", "panorama"): {"to_world"},
    ("sensor", "radiancemeter"): {"to_world"},
    ("sensor", "distant"): {"to_world", "target"},
}


@functools.cache
def load(name: str) -> tr.Scene:
    return tr.load_dict(motion_scenes.SCENES[name](), dtype=torch.float64)


def moving_parameters(scene: tr.Scene) -> dict[str, tuple[str, str, str]]:
    """Name of each parameter that moves something, and its model and field."""
    found = {}
    layout = scene.layout()
    for name, index in layout.by_name.items():
        slot = layout.slots[index]
        key = (slot.module.category, slot.module.model().type)
        if slot.attribute in MOVING.get(key, ()) and not slot.refusal:
            found.setdefault(name, (*key, slot.attribute))
    return found


# Where a parameter changes the chance of a coat or of a reflection, differences with common random numbers lack the
# few paths that go another way. Near the horizon of interpolated normals the faces of a coarse mesh hide what a turned
# normal still sees: a moving shadow edge, which halves with every second subdivision.
JUMPS = {
    ("dented_mesh", "room.radius"),
    ("mug_in_room", "ball.bsdf.diffuse_reflectance.to_uv"),
    ("pane_in_room", "room.radius"),
}
CASES = [
    (name, parameter)
    for name in motion_scenes.SCENES
    for parameter in moving_parameters(load(name))
    if (name, parameter) not in JUMPS
]


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize(("name", "parameter"), CASES)
def test_moving_but_continuous(name, parameter):
    scene = load(name)
    # A ray that is refracted in one image and reflected in the other, or meets a light in one of them only, is rare and
    # weighs much: steps long enough that every seed has some of these.
    # The table of a rough coat is smooth over percents of its index.
    glass = name.startswith(("glass", "frosted")) or (name, parameter) == ("mug_in_room", "ball.bsdf.eta")
    # Numbers of a grid turn its normals by many times as much.
    if name == "glass_distances" and parameter.endswith("grid"):
        step = 5e-4
    else:
        step = 0.2 if parameter.endswith("fov") else 0.02 if glass and not parameter.endswith("to_uv") else 2e-3
    spp = 200 if name.startswith("glass") else 50 if glass else 32
    together = tuple(moving_parameters(scene))
    derivatives, differences = compare(scene, parameter, SEEDS, spp, step, together=together, visibility=False)
    passed, text = agrees(derivatives, differences, 0.02 if glass else 5e-3, len(CASES))
    assert passed, f"{name} {parameter}: {text}"


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize("name", list(motion_scenes.SCENES))
def test_forward_and_reverse_mode_agree(name):
    scene = load(name)
    names = list(moving_parameters(scene))
    values = [scene.get_parameter(n).detach() for n in names]

    def f(*tensors):
        return tr.render(scene, spp=2, seed=5, params=dict(zip(names, tensors)))

    result = tr.testing.dot_product_test(f, values, rtol=1e-10)
    assert result, result.message
    assert result.forward != 0


def test_every_declared_parameter_that_moves_something_is_tested():
    """A new model with such a field needs a line in MOVING and a scene; the others are in the reference scenes."""
    tested = {moving_parameters(load(name))[parameter] for name, parameter in CASES}
    for (category, kind), fields in MOVING.items():
        for field in fields:
            assert (category, kind, field) in tested, f"{category} {kind}: {field} is in no scene"
    appearance = {"spectrum", "texture", "vector"}
    for (category, kind), model in models().items():
        if category in ("volume", "phase", "medium"):  # see test_media_motion.py
            continue
        for field in model.fields:
            if not field.differentiable or field.derivative.startswith("none") or field.kind in appearance:
                continue
            names = {field.name, f"vertex_{field.name}", f"vertex_{field.name}".replace("vertices", "positions")}
            looks = (category, kind, field.name) in {
                ("texture", "bitmap", "data"),
                ("texture", "volume", "volume"),
                ("emitter", "envmap", "data"),
                ("emitter", "envmap", "scale"),
                ("emitter", "projector", "scale"),
                ("attribute", "attribute", "data"),
            }
            assert looks or names & MOVING.get((category, kind), set()), f"{category} {kind}: {field.name}"


@pytest.mark.core
@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize("name", [n for n in motion_scenes.SCENES if n != "hole"])
def test_packets_of_single_precision_give_the_gradients_of_double(name):
    gradients = []
    for dtype in (torch.float32, torch.float64):
        scene = tr.load_dict(motion_scenes.SCENES[name](), dtype=dtype)
        parameters = [scene.get_parameter(n).requires_grad_() for n in moving_parameters(scene)]
        # (which outline is looked at depends on the last digits)
        image = tr.render(scene, spp=16, seed=1, visibility=False)
        weight = torch.from_numpy(reference_scenes.weight(*image.shape[:2])).to(dtype)
        gradients.append(torch.autograd.grad((image * weight).mean(), parameters))
    for single, double in zip(*gradients):
        assert float((single.double() - double).norm()) <= 5e-3 * float(double.norm()) + 1e-9


# ----------------------------------------------------------------------------------------------------- discontinuous
def silhouette() -> tr.Scene:
    """A ball and its shadow."""
    return tr.load_dict(
        motion_scenes.scene(
            2,
            motion_scenes.camera([0, 1, 4], [0, 0, 0], 40),
            floor=motion_scenes.floor(),
            ball={"type": "sphere", "radius": 0.5, "bsdf": {"type": "diffuse", "reflectance": 0.1}},
            lamp={"type": "point", "position": [0.5, 3, 1], "intensity": 9.0},
        ),
        dtype=torch.float64,
    )


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize("parameter", ["ball.radius", "ball.to_world", "camera.to_world"])
def test_discontinuous(parameter):
    derivatives, differences = compare(silhouette(), parameter, SEEDS, 256, 0.02)
    passed, text = agrees(derivatives, differences, 0.02, 4)
    assert passed, text


# ------------------------------------------------------------------------------------------------------ closed forms
def test_light_above_a_plane_in_closed_form():
    """A small square light straight above the point that is seen: L A / pi rho / h^2, so d log I / dh = -2 / h."""
    size, height = 0.01, 2.0
    scene = tr.load_dict(
        motion_scenes.scene(
            2,
            motion_scenes.camera([0, 0.5, 1], [0, 0, 0], 0.1),
            floor={
                "type": "rectangle",
                "to_world": tr.Transform.rotate([1, 0, 0], -90) @ tr.Transform.scale(3),
                "bsdf": {"type": "diffuse", "reflectance": 0.5},
            },
            lamp={
                "type": "rectangle",
                "to_world": tr.Transform.translate([0, height, 0])
                @ tr.Transform.rotate([1, 0, 0], 90)
                @ tr.Transform.scale(size),
                "emitter": {"type": "area", "radiance": 1e4},
            },
        ),
        dtype=torch.float64,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tr.MissingTermWarning)
        (matrix,) = scene.train_only("lamp.to_world")
        image = tr.render(scene, spp=64, seed=1)
        (gradient,) = torch.autograd.grad(image.mean(), matrix)
    value = float(image.detach().mean())
    assert value == pytest.approx(1e4 * (2 * size) ** 2 * 0.5 / torch.pi / height**2, rel=1e-3)
    assert float(gradient[1, 3]) == pytest.approx(-2 / height * value, rel=2e-3)
    # stretching the light along one of its axes makes its area, and so the image, grow alike
    assert float(gradient[0, 0]) * size == pytest.approx(value, rel=2e-3)


def test_one_clear_warning_names_the_missing_term():
    fresh = tr.load_dict(motion_scenes.SCENES["metal_mesh"](), dtype=torch.float64)
    fresh.train_only("ball.vertex_positions", "camera.to_world")
    with pytest.warns(tr.MissingTermWarning, match=r"ball\.vertex_positions.*through ball\.bsdf.*zero where") as caught:
        tr.render(fresh, spp=1, seed=0).sum().backward()
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tr.render(fresh, spp=1, seed=0).sum().backward()


def test_normals_of_a_mirror_lack_the_edges_that_are_seen_in_it():
    for name, lacking in (("metal_mesh", True), ("painted_mesh", False)):
        fresh = tr.load_dict(motion_scenes.SCENES[name](), dtype=torch.float64)
        fresh.train_only("ball.vertex_normals")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            tr.render(fresh, spp=1, seed=0).sum().backward()
        missing = [w for w in caught if issubclass(w.category, tr.MissingTermWarning)]
        assert len(missing) == int(lacking), name


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
def test_an_index_of_one_has_the_derivative_of_its_neighbours():
    """Where nothing is refracted yet: the natural start of a search for an index."""
    scene = load("glass_ball")
    found = []
    for eta in (1.0, 1.0 + 1e-4):
        x = torch.tensor(eta, dtype=torch.float64, requires_grad=True)
        image = tr.render(scene, spp=16, seed=1, params={"ball.bsdf.eta": x})
        weight = torch.from_numpy(reference_scenes.weight(*image.shape[:2]))
        found.append(float(torch.autograd.grad((image * weight).mean(), x)[0]))
    assert found[0] == pytest.approx(found[1], rel=0.02)
