"""Volumes and media in scenes: what a dict and an XML file may say, the names and shapes that come of it, edits."""

from __future__ import annotations

import copy
import io
import pickle

import numpy as np
import pytest
import torch
from torch.nn.utils import parametrize

import torchrender as tr
from torchrender.loaders.xml import parse_string

pytestmark = pytest.mark.once  # what scenes are made of

VOXELS = torch.rand(2, 3, 4, 1, generator=torch.Generator().manual_seed(0))
FILM = {"type": "hdrfilm", "width": 4, "height": 3, "rfilter": {"type": "box"}}


def load(medium, variant="rgb", dtype=torch.float32, **objects) -> tr.Scene:
    """A ball of `medium` in constant light."""
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volpath", "max_depth": 4},
            "ball": {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium},
            "camera": {"type": "perspective", "to_world": tr.Transform.translate([0, 0, -3]), "film": FILM},
            "sky": {"type": "constant"},
            **objects,
        },
        variant=variant,
        dtype=dtype,
    )


def medium_names(scene: tr.Scene) -> set[str]:
    names = {name for name, _ in scene.named_parameters() if "interior_medium" in name}
    return {name.removeprefix("ball.interior_medium.") for name in names}


def grid(**more) -> dict:
    return {"type": "gridvolume", "data": VOXELS, **more}


# ---------------------------------------------------------------------------------------------------- names and values
@pytest.mark.parametrize(
    ("medium", "expected"),
    [
        ({"type": "homogeneous"}, {"scale", "sigma_t.value.value", "albedo.value.value"}),
        (
            {"type": "homogeneous", "sigma_t": {"type": "rgb", "value": [1, 2, 3]}, "phase": {"type": "hg", "g": 0.3}},
            {"scale", "sigma_t.value.value", "albedo.value.value", "phase_function.g"},
        ),
        (
            {"type": "heterogeneous", "sigma_t": grid(), "albedo": 0.5, "emission": [1.0, 0.5, 0.2]},
            {
                *("scale", "sigma_t.data", "sigma_t.to_world", "albedo.value.value"),
                "emission.value.value",  # an addition of this package
            },
        ),
    ],
)
def test_parameters_go_by_the_names_of_mitsuba(medium, expected):
    assert medium_names(load(medium)) == expected


def test_defaults_are_parameters_that_one_can_see():
    scene = load({"type": "homogeneous"})
    medium = scene.ball.interior
    found = [float(medium.sigma_t.value.value), float(medium.albedo.value.value), float(medium.scale)]
    assert found == [1.0, 0.75, 1.0]
    assert medium.phase.type == "isotropic" and medium.emission is None
    medium.albedo = None  # the default again
    assert float(medium.albedo.value.value) == 0.75
    assert all(f"ball.interior_medium.{n}" in repr(scene) for n in medium_names(scene))


@pytest.mark.parametrize("value", [2.0, [1.0, 2.0, 3.0], torch.tensor([1.0, 2.0, 3.0]), np.float32(2.0)])
def test_numbers_and_colours_are_constant_volumes(value):
    scene = load({"type": "heterogeneous", "sigma_t": value, "albedo": {"type": "constvolume", "value": 0.5}})
    assert scene.ball.interior.sigma_t.type == "constvolume"
    torch.testing.assert_close(scene.ball.interior.sigma_t.value.value.detach(), torch.as_tensor(value).float())


@pytest.mark.parametrize("value", [VOXELS, VOXELS[..., 0], VOXELS.numpy(), VOXELS[..., 0].tolist()])
def test_arrays_of_voxels_are_grids(value):
    for sigma_t in (value, {"type": "gridvolume", "data": value}):
        scene = load({"type": "heterogeneous", "sigma_t": sigma_t})
        assert torch.equal(scene.ball.interior.sigma_t.data, VOXELS)


def test_mono_has_the_luminance_of_coloured_grids():
    colours = torch.rand(2, 2, 2, 3)
    expected = (colours * torch.tensor([0.2126, 0.7152, 0.0722])).sum(-1, keepdim=True)
    for volume in ({"type": "gridvolume", "data": colours}, tr.GridVolume(data=colours)):
        scene = load({"type": "heterogeneous", "albedo": volume}, variant="mono")
        torch.testing.assert_close(scene.ball.interior.albedo.data.detach(), expected)
        tr.render(scene, spp=1)


def test_grids_of_files_and_their_bounding_boxes(tmp_path):
    vol, npy = tmp_path / "fog.vol", tmp_path / "fog.npy"
    tr.io.write_volume(vol, VOXELS, bounding_box=((-1, 0, 2), (1, 3, 6)))
    tr.io.write_volume(npy, VOXELS)
    assert tr.io.read_volume_bounds(vol).tolist() == [[-1, 0, 2], [1, 3, 6]]
    for path in (vol, npy):
        volume = tr.GridVolume(filename=path, accel=False, raw=True)
        assert torch.equal(volume.data, VOXELS) and torch.equal(volume.to_world, torch.eye(4))
    assert torch.equal(tr.GridVolume(grid=VOXELS.numpy()).data, VOXELS)
    moved = tr.Transform.translate([5, 0, 0])
    placed = tr.GridVolume(filename=vol, use_grid_bbox=True, to_world=moved).to_world.detach()
    corners = torch.tensor([[0.0, 0, 0, 1], [1, 1, 1, 1]]) @ placed.T
    assert corners[:, :3].tolist() == [[4, 0, 2], [6, 3, 6]]
    # Mitsuba 3.9.1 gives this box for such a file and transform.
    transform = tr.Transform.translate([5, 1, -2]).rotate([0, 0, 1], 90).scale([2, 1, 3])
    volume = tr.GridVolume(filename=vol, use_grid_bbox=True, to_world=transform)
    corners = torch.cartesian_prod(*[torch.tensor([0.0, 1.0])] * 3) @ volume.to_world[:3, :3].T + volume.to_world[:3, 3]
    torch.testing.assert_close(corners.amin(0).detach(), torch.tensor([2.0, -1, 4]), rtol=0, atol=1e-6)
    torch.testing.assert_close(corners.amax(0).detach(), torch.tensor([5.0, 3, 16]), rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match=r"fog\.npy: expected a \.vol file"):
        tr.GridVolume(filename=npy, use_grid_bbox=True)
    with pytest.raises(ValueError, match=r"use_grid_bbox: only \.vol files have a bounding box, but data is given"):
        tr.GridVolume(data=VOXELS, use_grid_bbox=True)
    tr.io.write_volume(vol, VOXELS, bounding_box=((0, 0, 0), (1, 0, 1)))
    with pytest.raises(ValueError, match=r"filename.*its bounding box is empty"):
        tr.GridVolume(filename=vol, use_grid_bbox=True)


def test_words_of_grids():
    volume = tr.GridVolume(data=VOXELS)
    assert (volume.filter_type, volume.wrap_mode) == ("trilinear", "clamp")
    volume.filter_type, volume.wrap_mode = "nearest", "mirror"
    assert [volume.encode(n) for n in ("filter_type", "wrap_mode")] == [1, 1]
    with pytest.raises(ValueError, match=r"filter_type: unknown word 'bilinear'.*'trilinear'"):
        volume.filter_type = "bilinear"
    assert tr.Bitmap(data=VOXELS[0]).filter_type == "bilinear"


# ----------------------------------------------------------------------------------------------------- where media are
def test_all_shapes_and_cameras_take_media(tmp_path):
    triangle = {"vertices": [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    kinds = [{"type": k} for k in ("sphere", "cube", "rectangle", "disk")] + [{"type": "mesh", **triangle}]
    kinds += [{"type": k, "filename": str(tmp_path / f"a.{k}")} for k in ("obj", "ply")]
    both = {"interior": {"type": "ref", "id": "fog"}, "exterior": {"type": "homogeneous", "albedo": 0.1}}
    shapes = {f"s{i}": {**kind, **both} for i, kind in enumerate(kinds)}
    camera = {"type": "perspective", "film": FILM, "medium": {"type": "ref", "id": "fog"}}
    scene = load({"type": "ref", "id": "fog"}, fog={"type": "heterogeneous"}, **shapes, camera=camera)
    for name in (*shapes, "ball"):
        assert scene[name].interior is scene.fog and scene[name].interior_medium is scene.fog
    assert scene.camera.medium is scene.fog
    # Shared media are packed once, under their own id, whatever the order.
    objects = scene.layout().objects
    assert [row[2] for row in objects["medium"]] == ["fog"] + [f"{n}.exterior_medium" for n in shapes]
    assert scene.get_parameter("s1.interior.scale") is scene.fog.scale
    mesh = tr.Mesh(**triangle, interior={"type": "homogeneous"}, bsdf=tr.Null())
    assert mesh.interior.type == "homogeneous" and mesh.exterior is None


def test_objects_are_shared_by_reference():
    scene = load(
        {"type": "heterogeneous", "sigma_t": {"type": "ref", "id": "density"}, "phase": {"type": "ref", "id": "ahead"}},
        other={
            "type": "cube",
            "interior": {
                **{"type": "heterogeneous", "sigma_t": {"type": "ref", "id": "density"}},
                "any": {"type": "ref", "id": "ahead"},
            },
        },
        density=grid(),
        ahead={"type": "hg", "g": 0.5},
    )
    assert scene.ball.interior.sigma_t is scene.other.interior.sigma_t is scene.density
    assert scene.ball.interior.phase is scene.other.interior.phase is scene.ahead
    rows = scene.layout().objects
    assert [len(rows[c]) for c in ("volume", "phase", "medium")] == [3, 1, 2]  # one grid and two albedos
    assert [p.shape for p in scene.train_only("*.interior.sigma_t.data")] == [VOXELS.shape]
    scene["density"] = tr.GridVolume(data=torch.zeros(1, 1, 1))
    assert scene.ball.interior.sigma_t is scene.density


def test_xml(tmp_path):
    tr.io.write_volume(tmp_path / "smoke.vol", VOXELS, bounding_box=((0, 0, 0), (2, 2, 2)))
    built = parse_string(
        """<scene version="3.0.0">
        <integrator type="volpath"><integer name="max_depth" value="7"/></integrator>
        <medium type="homogeneous" id="fog"><rgb name="albedo" value=".9 .8 .7"/><phase type="hg"/></medium>
        <shape type="sphere" id="a">
            <bsdf type="null"/>
            <medium name="interior" type="heterogeneous">
                <volume name="sigma_t" type="gridvolume">
                    <string name="filename" value="smoke.vol"/><boolean name="use_grid_bbox" value="true"/>
                    <transform name="to_world"><translate x="1"/></transform>
                </volume>
                <volume name="albedo" type="constvolume"><rgb name="value" value="0.3 0.2 0.1"/></volume>
                <float name="scale" value="3"/>
                <phase type="hg"><float name="g" value="-0.2"/></phase>
            </medium>
            <ref name="exterior" id="fog"/>
        </shape>
        <sensor type="perspective"><ref id="fog"/></sensor>
        </scene>""",
        folder=tmp_path,
    )
    scene = tr.load_dict(built)
    assert isinstance(scene.integrator, tr.VolumetricPathTracer) and scene.integrator.max_depth == 7
    inside = scene.a.interior
    assert torch.equal(inside.sigma_t.data, VOXELS) and inside.sigma_t.to_world[0].tolist() == [2, 0, 0, 1]
    torch.testing.assert_close(inside.albedo.value.value.detach(), torch.tensor([0.3, 0.2, 0.1]))
    assert float(inside.scale) == 3 and float(inside.phase.g) == pytest.approx(-0.2)
    assert scene.a.exterior is scene.fog is scene.sensors[0].medium and float(scene.fog.phase.g) == pytest.approx(0.8)


def test_xml_of_old_files():
    built = parse_string(
        """<scene version="0.6.0"><shape type="sphere" id="a"><medium type="heterogeneous" name="interior">
        <volume name="sigmaT" type="constvolume"><float name="value" value="2"/></volume>
        </medium></shape></scene>"""
    )
    assert float(tr.load_dict(built).a.interior.sigma_t.value.value) == 2


# --------------------------------------------------------------------------------------------------------- as a module
def test_copies_files_and_precision():
    scene = load({"type": "heterogeneous", "sigma_t": grid(), "phase": {"type": "hg", "g": 0.3}})
    twin = load({"type": "heterogeneous", "sigma_t": grid(data=torch.ones(2, 3, 4)), "phase": {"type": "hg"}})
    twin.load_state_dict(scene.state_dict())
    file = io.BytesIO()
    torch.save(scene, file)
    file.seek(0)
    stored = torch.load(file, weights_only=False)
    for other in (twin, copy.deepcopy(scene), pickle.loads(pickle.dumps(scene)), stored):
        assert torch.equal(other.ball.interior.sigma_t.data, VOXELS)
        assert other.layout().objects == scene.layout().objects
        tr.render(other, spp=1)
    scene.double()
    assert scene.ball.interior.sigma_t.data.dtype == scene.ball.interior.phase.g.dtype == torch.float64
    assert tr.render(scene, spp=1).dtype == torch.float64
    assert scene.float().ball.interior.scale.dtype == torch.float32


def test_grids_of_any_size_take_the_place_of_one():
    scene = load({"type": "heterogeneous", "sigma_t": grid(), "albedo": 0.5})
    for shape in ((5, 1, 2, 1), (3, 3, 3, 3)):
        larger = torch.rand(shape, requires_grad=True)
        image = tr.render(scene, spp=1, params={"ball.interior_medium.sigma_t.data": larger})
        assert image.requires_grad
        tr.render(scene, spp=1, params={"ball.interior.sigma_t.data": larger})  # the words of the dict
    colour = torch.tensor([0.5, 0.6, 0.7])
    tr.render(scene, spp=1, params={"ball.interior.albedo.value.value": colour})
    for wrong in ((2, 3, 4), (2, 3, 4, 2), (2, 0, 4, 1)):
        with pytest.raises(ValueError, match=r"sigma_t\.data: expected shape \(Z, Y, X, C\) with C = 1 or 3, got"):
            tr.render(scene, spp=1, params={"ball.interior.sigma_t.data": torch.zeros(wrong)})
    scene.ball.interior.sigma_t.data = torch.rand(2, 2, 2)
    assert scene.ball.interior.sigma_t.data.shape == (2, 2, 2, 1)
    with pytest.raises(ValueError, match="given twice"):
        twice = dict.fromkeys(("ball.interior.scale", "ball.interior_medium.scale"), torch.tensor(1.0))
        tr.render(scene, spp=1, params=twice)


def test_upsampling_a_grid_with_its_optimiser():
    scene = load({"type": "heterogeneous", "sigma_t": grid(data=VOXELS + 1)})
    (density,) = scene.train_only("ball.interior.sigma_t.data")
    optimizer = torch.optim.Adam([density], lr=0.1)
    density.grad = torch.ones_like(density)
    optimizer.step()
    old = density.detach().clone()
    new = tr.optim.upsample(scene, "ball.interior.sigma_t.data", (4, 6, 8), optimizer)
    assert new is scene.ball.interior.sigma_t.data and new.requires_grad and new.shape == (4, 6, 8, 1)
    # cell-centred, clamped: the corner keeps its value, and so does the mean along each axis
    assert new[0, 0, 0] == old[0, 0, 0]
    torch.testing.assert_close(new.mean().detach(), old.mean(), rtol=1e-6, atol=0)
    assert optimizer.state[new]["exp_avg"].shape == new.shape
    tr.render(scene, spp=1)


def test_a_grid_may_be_parametrised():
    scene = load({"type": "heterogeneous", "sigma_t": grid()})
    parametrize.register_parametrization(scene.ball.interior.sigma_t, "data", tr.constraints.Positive())
    torch.testing.assert_close(scene.ball.interior.sigma_t.data, VOXELS)
    assert tr.render(scene, spp=1).shape == (3, 4, 3)
    tr.optim.upsample(scene, "ball.interior.sigma_t.data", (4, 6, 8))
    assert scene.ball.interior.sigma_t.data.shape == (4, 6, 8, 1) and tr.render(scene, spp=1).shape == (3, 4, 3)


def test_tensors_of_a_graph_stay_in_it():
    leaf = torch.rand(2, 2, 2, 1, requires_grad=True)
    scene = load({"type": "heterogeneous", "sigma_t": tr.GridVolume(data=leaf.exp())})
    assert tr.render(scene, spp=1).requires_grad
    scene.ball.interior.sigma_t = torch.rand(2, 2, 2, requires_grad=True)  # an assigned leaf gives numbers and its wish
    assert scene.ball.interior.sigma_t.data.requires_grad and isinstance(scene.ball.interior.sigma_t, tr.GridVolume)


# ---------------------------------------------------------------------------------------------------- down to the image
SMOKE = {
    **{"type": "heterogeneous", "albedo": grid(data=VOXELS / 2), "emission": 0.1, "scale": 2.0},
    "sigma_t": grid(to_world=tr.Transform.translate([-1, -1, -1]).scale(2)),
    "phase": {"type": "hg", "g": 0.3},
}
OTHERS = {
    "sigma_t": {"sigma_t": grid(data=VOXELS + 0.5, to_world=SMOKE["sigma_t"]["to_world"])},
    "filter_type": {"sigma_t": {**SMOKE["sigma_t"], "filter_type": "nearest"}},
    "to_world": {"sigma_t": grid(to_world=tr.Transform.translate([-1, -1, -1]).scale(1.5))},
    "albedo": {"albedo": grid(data=VOXELS)},
    "wrap_mode": {"albedo": grid(data=VOXELS / 2, wrap_mode="repeat")},
    "emission": {"emission": 0.2},
    "scale": {"scale": 2.5},
    "g": {"phase": {"type": "hg", "g": -0.3}},
    "phase": {"phase": {"type": "isotropic"}},
}


def picture(**changes) -> torch.Tensor:
    objects = {k: changes.pop(k) for k in ("ball", "camera", "sky", "lamp", "integrator") if k in changes}
    return tr.render(load({**SMOKE, **changes}, **objects), spp=16, seed=0)


@pytest.mark.core
@pytest.mark.parametrize("changed", OTHERS)
def test_every_setting_of_a_medium_reaches_the_image(changed):
    assert not torch.equal(picture(**OTHERS[changed]), picture())


@pytest.mark.core
def test_media_around_the_camera_and_outside_of_shapes_reach_the_image():
    plain = picture(scale=0.0, emission=None)
    torch.testing.assert_close(plain, torch.ones_like(plain))  # nothing but the sky
    fog = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.0}
    camera = {"type": "perspective", "to_world": tr.Transform.translate([0, 0, -3]), "film": FILM}
    # From within a fog that ends at the ball and begins again behind it, nothing of the sky is left.
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": {**fog, "sigma_t": 0.1}, "exterior": fog}
    inside = tr.render(load(None, ball=ball, camera={**camera, "medium": fog}), spp=4, seed=0)
    assert not bool(inside.any())
    # Without the camera's medium it begins behind the ball, which all rays in the middle of the film reach.
    assert bool((tr.render(load(None, ball=ball, camera=camera), spp=4, seed=0)[1, 1:3] == 0).all())
