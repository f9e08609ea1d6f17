"""The volumetric path tracer as people ask for it, and what is refused before any work: values, places, derivatives."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch

import torchrender as tr

pytestmark = pytest.mark.once  # what is asked for and refused

VOXELS = torch.rand(2, 3, 4, generator=torch.Generator().manual_seed(0))
FILM = {"type": "hdrfilm", "width": 4, "height": 3, "rfilter": {"type": "box"}}
TETRAHEDRON = {
    "vertices": [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "faces": [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
}
SINGULAR = np.diag([1.0, 1.0, 0.0, 1.0])
VOLPATH = tr.VolumetricPathTracer(max_depth=3)


def scene(medium=None, **objects):
    ball = {"ball": {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium}} if medium is not None else {}
    camera = {"type": "perspective", "to_world": tr.Transform.translate([0, 0, -3]), "film": FILM}
    return {"type": "scene", **ball, "camera": camera, "sky": {"type": "constant"}, **objects}


def load(medium=None, **objects) -> tr.Scene:
    return tr.load_dict(scene(medium, **objects))


def fog(**more):
    return {"type": "heterogeneous", **more}


def grid(data=VOXELS, **more):
    return {"type": "gridvolume", "data": data, **more}


# ------------------------------------------------------------------------------------------------------------ settings
@pytest.mark.parametrize(("kind", "depth"), [("volpath", -1), ("volpathmis", -1), ("prbvolpath", 6)])
def test_types_of_scene_files(kind, depth):
    made = tr.load_dict({"type": kind})
    assert isinstance(made, tr.VolumetricPathTracer)
    assert (made.max_depth, made.rr_depth, made.hide_emitters) == (depth, 5, False)
    assert made.config() == {**tr.PathTracer(depth).config(), "volumetric": True}
    given = tr.load_dict({"type": kind, "max_depth": 9, "rr_depth": 7, "hide_emitters": True})
    assert repr(given) == "VolumetricPathTracer(max_depth=9, rr_depth=7, hide_emitters=True)"
    with pytest.raises(ValueError, match=f"{kind} has no parameter 'max_dept'; did you mean 'max_depth'"):
        tr.load_dict({"type": kind, "max_dept": 3})
    assert tr.render(load(fog()), integrator=kind, spp=1).shape == (3, 4, 3)


def test_settings_are_checked():
    with pytest.raises(ValueError, match="VolumetricPathTracer: max_depth: expected at least -1, got -2"):
        tr.VolumetricPathTracer(max_depth=-2)
    made = tr.VolumetricPathTracer()
    made.hide_emitters = 1
    with pytest.raises(TypeError, match="VolumetricPathTracer: hide_emitters: expected True or False"):
        tr.render(load(), integrator=made)


def test_other_outputs_beside_its_image():
    volumes = load(fog())
    stacked = tr.render(volumes, integrator=tr.AOV("dd:depth", VOLPATH), spp=2, seed=1)
    assert stacked.shape == (3, 4, 4)
    assert torch.equal(stacked[..., :3], tr.render(volumes, integrator=VOLPATH, spp=2, seed=1))
    nested = {"type": "aov", "aovs": "dd:depth", "any": {"type": "volpath", "max_depth": 3}}
    assert torch.equal(tr.render(volumes, integrator=nested, spp=2, seed=1), stacked)
    found = tr.render(volumes, integrator=VOLPATH, outputs=("rgb", "depth"), spp=2, seed=1)
    assert torch.equal(found.rgb, stacked[..., :3]) and found.depth.shape == (3, 4)


def test_integrators_that_leave_media_out_say_so_once():
    volumes = load(fog())
    with pytest.warns(
        UserWarning, match=r"media, which this integrator leaves out; VolumetricPathTracer \('volpath'\)"
    ):
        tr.render(volumes, spp=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tr.render(volumes, spp=1)
        other = load(fog())
        tr.render(other, spp=1, integrator=VOLPATH)
        tr.render(other, spp=1, outputs=("depth",))
        tr.render(load(spare=fog()), spp=1)  # nothing has this one


# ------------------------------------------------------------------------------------------------ values and structure
@pytest.mark.parametrize(
    ("description", "message"),
    [
        (scene(fog(sigma_t=-1.0)), r"ball\.interior_medium\.sigma_t\.value\.value: -1 is outside the range \[0, inf\]"),
        (scene(fog(sigma_t=VOXELS - 1)), r"interior_medium\.sigma_t\.data: -0\.\d+ is outside the range \[0, inf\]"),
        (scene(fog(sigma_t=float("nan"))), r"sigma_t\.value\.value: has values that are not finite"),
        (scene(fog(sigma_t=VOXELS * np.nan)), r"sigma_t\.data: has values that are not finite"),
        (scene(fog(albedo=1.001)), r"albedo\.value\.value: 1\.001 is outside the range \[0, 1\] of albedo"),
        (scene(fog(albedo=grid(VOXELS + 1))), r"albedo\.data: 1\.\d+ is outside the range \[0, 1\] of albedo"),
        (scene(fog(emission=[0.1, 0.2, -0.3])), r"emission\.value\.value: -0\.3 is outside the range \[0, inf\]"),
        (scene(fog(scale=-2)), r"ball\.interior_medium\.scale: -2 is outside the range"),
        (scene(fog(phase={"type": "hg", "g": 1})), r"phase_function\.g: 1 is outside the range \[-0\.9999, 0\.9999\]"),
        (scene(fog(phase={"type": "hg", "g": -1})), r"phase_function\.g: -1 is outside the range"),
        (scene(fog(sigma_t=grid(torch.zeros(2, 0, 3)))), r"sigma_t\.data: expected voxels .* Z, Y, X > 0, got"),
        (scene(fog(sigma_t=grid(torch.zeros(2, 2)))), r"sigma_t\.data: expected voxels of shape \(Z, Y, X, C\)"),
        (scene(fog(sigma_t=grid(torch.zeros(2, 2, 2, 2)))), r"sigma_t\.data: expected voxels .* C = 1 or 3"),
        (scene(fog(sigma_t=torch.zeros(2, 2))), r"sigma_t.*: expected a number, a colour of three numbers or voxels"),
        (scene(fog(sigma_t="dense")), r"sigma_t: expected a number, a colour, voxels or a volume, got 'dense'"),
        (scene(fog(sigma_t=grid(to_world=SINGULAR))), r"sigma_t\.to_world: the matrix is singular"),
        (scene(fog(sigma_t={"type": "gridvolume"})), r"sigma_t: give one of filename, grid and data; got none"),
        (scene(fog(sigma_t={"type": "gridvolume", "filename": "no.vol"})), r"sigma_t\.filename: no such file: no\.vol"),
        (scene(fog(sigma_t=grid(wrap_mode="clam"))), r"sigma_t\.wrap_mode: unknown word 'clam'; did you mean 'clamp'"),
        (scene(fog(sigma_t={"type": "gridvolum"})), r"sigma_t: unknown volume type 'gridvolum'.*'gridvolume'"),
        (scene(fog(sigma_t={"type": "bitmap"})), r"sigma_t: expected a volume, got 'bitmap', which is a texture"),
        (
            scene({"type": "homogeneous", "sigma_t": VOXELS}),
            r"ball\.interior_medium\.sigma_t: the extinction of a homogeneous medium is a number or a colour",
        ),
        (scene({"type": "homogeneus"}), r"ball\.interior_medium: unknown medium type 'homogeneus'.*'homogeneous'"),
        (scene(fog(sigmat=2)), r"heterogeneous has no parameter 'sigmat'; did you mean 'sigma_t'"),
        (scene(fog(sigmat=grid())), r"heterogeneous has no parameter 'sigmat'; did you mean 'sigma_t'"),
        (scene(fog(sample_emitters=3)), r"sample_emitters=3 is not supported"),
        (scene(fog(phase={"type": "sggx"})), r"phase_function: the phase 'sggx' is not supported"),
        (scene(fog(phase={"type": "hg"}, phase_function={"type": "hg"})), "the same parameter; give one of them"),
        (scene(ball={"type": "sphere", "fog": fog()}), r"ball\.fog: a medium of a shape goes by the name 'interior'"),
        (scene(ball={"type": "sphere", "interior": 3.0}), r"ball\.interior_medium: expected a medium"),
        (scene(ball={"type": "sphere", "interior": {"type": "hg"}}), r"expected a medium, got 'hg', which is a phase"),
        (scene({"type": "ref", "id": "fgo"}, fog=fog()), r"ball.*there is no object with the id 'fgo'.*'fog'"),
        (scene({"type": "ref", "id": "red"}, red={"type": "diffuse"}), r"expected a medium, but 'red' is a bsdf"),
        (scene(lamp={"type": "point", "medium": fog()}), r"lamp: point has no parameter 'medium'"),
        (scene(wall={"type": "diffuse", "interior": fog()}), r"wall: diffuse has no parameter 'interior'"),
    ],
)
def test_scenes_that_are_refused(description, message):
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        tr.load_dict(description)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("sigma_t.data", -VOXELS[..., None], "ball.*sigma_t.*not negative"),
        ("sigma_t.data", VOXELS[..., None] * np.inf, r"ball\.interior_medium\.sigma_t\.data: has values"),
        ("sigma_t.to_world", torch.zeros(4, 4), "ball.*sigma_t.*to_world"),
        ("albedo.value.value", torch.tensor(1.5), "ball.*albedo.*from 0 to 1"),
        ("scale", torch.tensor(-1.0), "ball.*scale.*not negative"),
        ("phase_function.g", torch.tensor(1.0), r"ball\.interior_medium\.phase_function\.g: 1 is outside the range"),
    ],
)
def test_edits_that_are_refused(name, value, message):
    """Substitutes, and edits in place, which nobody sees before the next rendering."""
    volumes = load(fog(sigma_t=VOXELS, phase={"type": "hg", "g": 0.3}))
    full = f"ball.interior_medium.{name}"
    with pytest.raises(ValueError, match=message):
        tr.render(volumes, spp=1, integrator=VOLPATH, params={full: value})
    volumes.get_parameter(full).data.copy_(value)
    with pytest.raises(ValueError, match=message):
        tr.render(volumes, spp=1, integrator=VOLPATH)


def test_refused_assignments_leave_the_medium_as_it_was():
    volumes = load({"type": "homogeneous", "phase": {"type": "hg", "g": 0.3}})
    medium = volumes.ball.interior
    before = volumes.layout().objects
    for name, value in (("sigma_t", -1.0), ("sigma_t", VOXELS), ("albedo", 2.0), ("phase", 0.3), ("scale", -1)):
        with pytest.raises(ValueError, match=name):
            setattr(medium, name, value)
    with pytest.raises(ValueError, match="outside the range"):
        medium.phase.g = 1.0
    assert volumes.layout().objects == before and float(medium.sigma_t.value.value) == 1
    medium.albedo, medium.phase = VOXELS, {"type": "isotropic"}
    assert medium.albedo.type == "gridvolume" and medium.phase_function.type == "isotropic"


def test_a_camera_outside_of_the_scene_has_no_medium_of_it():
    volumes = load(fog())
    camera = tr.PerspectiveCamera.look_at([0, 0, 0], [0, 0, 1], size=(3, 4), medium=volumes.ball.interior)
    with pytest.raises(ValueError, match="a camera with a medium has to be one of the scene's"):
        tr.render(volumes, sensor=camera, integrator=VOLPATH)
    volumes["inside"] = camera
    assert tr.render(volumes, sensor=1, integrator=VOLPATH, spp=1).shape == (3, 4, 3)


# ---------------------------------------------------------------------------------------------------------- boundaries
def boundary_warnings(**objects) -> list[str]:
    volumes = load(**objects)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(2):  # each is said once
            tr.render(volumes, spp=1, integrator=VOLPATH)
            volumes.camera.near_clip = 0.02
    return [str(w.message) for w in caught]


def test_closed_boundaries_are_fine():
    seam = {
        "vertices": [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -0.0, 0]],  # one corner twice, as at a seam
        "faces": [[0, 2, 1], [4, 1, 3], [4, 3, 2], [1, 2, 3]],
    }
    half = {"type": "mesh", "vertices": TETRAHEDRON["vertices"], "interior": fog()}
    shared = {**half, "interior": {"type": "ref", "id": "fog"}}
    faces = TETRAHEDRON["faces"]
    turned = [face[::-1] for face in faces[2:]]
    assert boundary_warnings(a={"type": "mesh", **TETRAHEDRON, "interior": fog()}) == []
    assert boundary_warnings(a={"type": "mesh", **seam, "interior": fog()}) == []
    assert boundary_warnings(a={"type": "cube", "exterior": fog()}, b={"type": "sphere", "interior": fog()}) == []
    assert boundary_warnings(a={"type": "rectangle", "interior": fog()}) == []  # what it bounds is not for us to say
    # two meshes that close the boundary together, one of them the other way round
    assert boundary_warnings(fog=fog(), a={**shared, "faces": faces[:2]}, b={**shared, "faces": faces[2:]}) == []
    other = {**shared, "faces": turned, "flip_normals": True}
    assert boundary_warnings(fog=fog(), a={**shared, "faces": faces[:2]}, b=other) == []
    assert boundary_warnings(a={**half, "faces": faces[:3], "interior": None}) == []  # no medium


@pytest.mark.parametrize("faces", [TETRAHEDRON["faces"][:3], [*TETRAHEDRON["faces"][:3], [3, 2, 1]]])
def test_open_boundaries_are_warned_about_once(faces):
    mesh = {"type": "mesh", "vertices": TETRAHEDRON["vertices"], "faces": faces}
    found = boundary_warnings(shell={**mesh, "interior": fog()}, good={"type": "cube", "interior": fog()})
    assert len(found) == 1 and found[0].startswith("shell: the boundary of a medium, but not closed")


# --------------------------------------------------------------------------------------------------------- derivatives
def moving_scene(medium: dict | None) -> tr.Scene:
    texture = {"type": "bitmap", "data": torch.full((2, 2, 3), 0.5), "raw": True}
    coloured = {"type": "mesh_attribute", "name": "vertex_color"}
    return load(
        medium,
        mesh={
            **{"type": "mesh", **TETRAHEDRON, "bsdf": {"type": "diffuse", "reflectance": coloured}},
            **{"vertex_normals": torch.ones(4, 3), "attributes": {"vertex_color": torch.full((4, 3), 0.5)}},
        },
        wall={"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": texture}},
        glass={"type": "disk", "bsdf": {"type": "dielectric", "specular_reflectance": 0.9}},
        sky={"type": "envmap", "data": torch.ones(2, 4, 3)},
        lamp={"type": "point", "position": [0, 3, 0]},
    )


def no_derivative(volumes: tr.Scene, name: str) -> bool:
    if name.endswith(("_weight", "_clip", "_width", "_height")):
        return False
    try:
        volumes.train_only(name)
    except tr.NotDifferentiableError:
        return True
    return False


def test_what_moves_lacks_outlines_and_nothing_else():
    """Every parameter has a derivative; depth, which is no image of this integrator, has its outlines."""
    volumes = moving_scene(fog(sigma_t=VOXELS, albedo=grid(), emission=0.1, phase={"type": "hg", "g": 0.3}))
    volumes["integrator"] = VOLPATH
    names = [name for name, _ in volumes.named_parameters()]
    assert {"ball.radius", "lamp.position", "ball.interior_medium.sigma_t.to_world"} <= set(names)
    assert not [n for n in names if n.startswith(("ball", "lamp", "mesh", "camera")) and no_derivative(volumes, n)]
    leaves = volumes.train_only("ball.radius")
    with pytest.warns(tr.MissingTermWarning, match=r"ball\.radius is without the motion of edges of shadows, of"):
        image = tr.render(volumes, spp=1)
    assert torch.isfinite(torch.autograd.grad(image.sum(), leaves)[0])
    (line,) = [row for row in repr(volumes).splitlines() if row.strip().startswith("lamp.position")]
    assert "none" not in line


def test_jumps_of_grids_are_named():
    volumes = load(fog(sigma_t=grid(filter_type="nearest")))
    volumes.train_only("ball.radius")
    with pytest.warns(
        tr.MissingTermWarning, match="light meets, of jumps of ball.interior_medium.sigma_t, which is zero"
    ):
        tr.render(volumes, spp=1, integrator=VOLPATH)


def test_without_media_derivatives_are_those_of_the_path_tracer():
    volumes = moving_scene(None)
    names = ["wall.to_world", "lamp.position", "mesh.vertex_positions", "sky.to_world", "camera.to_world"]

    def gradients(integrator):
        leaves = volumes.train_only(*names)
        image = tr.render(volumes, spp=8, seed=2, integrator=integrator, visibility=False)
        return torch.autograd.grad(image.square().sum(), leaves)

    paths = gradients(tr.PathTracer(max_depth=4))
    ours = gradients(tr.VolumetricPathTracer(max_depth=4))
    for name, a, b in zip(names, ours, paths, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-4 * float(b.abs().max()), msg=name)
