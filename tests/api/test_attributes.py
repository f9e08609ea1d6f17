"""Attributes of objects: misspelt ones are refused, words of scene dicts honoured."""

import pytest
import torch
from first_scene import make

import torchrender as tr

MISSPELT = {
    "camera.fvo": "PerspectiveCamera has no parameter 'fvo'; did you mean 'fov'",
    "camera.width": "PerspectiveCamera has no parameter 'width'; it is one of its film: film.width",
    "camera.film.widht": "Film has no 'widht'; did you mean 'width'",
    "camera.film.filter.sttdev": "ReconstructionFilter has no 'sttdev'; did you mean 'stddev'",
    "sky.radience": "ConstantLight has no parameter 'radience'; did you mean 'radiance'",
    "ball.bsdf.reflectence": "Diffuse has no parameter 'reflectence'; did you mean 'reflectance'",
    "ball.centre": "Sphere has no parameter 'centre'; did you mean 'center'",
    "integrator.max_depht": "PathTracer has no setting 'max_depht'; did you mean 'max_depth'",
    "integrater": "the scene has no object 'integrater', .*; did you mean 'integrator'",
}


@pytest.mark.parametrize("path", MISSPELT)
def test_misspelt_attributes_are_refused(path):
    scene = make(integrator={"type": "path"})
    *owners, name = path.split(".")
    owner = scene
    for part in owners:
        owner = getattr(owner, part)
    with pytest.raises(AttributeError, match=MISSPELT[path]):
        setattr(owner, name, 5.0)
    assert not hasattr(owner, name)


def test_words_of_scene_dicts_are_honoured(tmp_path):
    scene = make(mesh=tr.Mesh(vertices=[[0, 0, 0], [1, 0, 0], [0, 1, 0]], faces=[[0, 1, 2]]))
    camera = scene.camera
    camera.fov = 20.0
    assert float(camera.x_fov) == 20 and float(camera.fov) == 20
    camera.focal_length = "35mm"
    same = tr.PerspectiveCamera(focal_length="35mm", film=tr.Film(12, 8))
    torch.testing.assert_close(camera.x_fov, same.x_fov)
    torch.testing.assert_close(camera.focal_length, torch.tensor(35.0))
    camera.film = {"type": "hdrfilm", "width": 5, "height": 7}
    assert tr.render(scene, spp=1).shape == (7, 5, 3)
    moved = torch.tensor([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]])
    scene.mesh.vertices = moved
    assert torch.equal(scene.mesh.vertex_positions, moved) and torch.equal(scene.mesh.vertices, moved)
    scene.ball.bsdf = {"type": "conductor"}
    scene.ball.bsdf.material = "Au"
    expected = tr.Conductor(material="Au")
    torch.testing.assert_close(scene.ball.bsdf.k.value, expected.k.value)
    tr.io.write_image(tmp_path / "a.exr", torch.full((2, 4, 3), 0.25))
    scene.ball.bsdf = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": torch.ones(3, 3, 3), "raw": True}}
    scene.ball.bsdf.reflectance.filename = str(tmp_path / "a.exr")
    assert scene.ball.bsdf.reflectance.data.shape == (2, 4, 3)


@pytest.mark.parametrize("axis", ["x", "y", "diagonal", "smaller", "larger"])
@pytest.mark.parametrize(
    ("kind", "more"),
    [(tr.PerspectiveCamera, {}), (tr.ThinLensCamera, {"aperture_radius": 0.1}), (tr.FisheyeCamera, {})],
)
def test_fields_of_view_along_any_axis(kind, more, axis):
    for size in ((8, 12), (12, 8)):
        camera = kind(fov=50.0, fov_axis=axis, film=tr.Film(*size), **more)
        torch.testing.assert_close(camera.fov, torch.tensor(50.0))
        other = kind(fov=31.0, fov_axis=axis, film=tr.Film(*size), **more)
        camera.fov = 31.0
        torch.testing.assert_close(camera.x_fov, other.x_fov)
        assert camera.fov_axis == axis
    with pytest.raises(ValueError, match=r"fov: expected an angle between 0 and \d+ degrees, got -3"):
        camera.fov = -3
    with pytest.raises(ValueError, match="fov_axis: unknown word 'z'"):
        camera.fov_axis = "z"


def test_fields_of_view_keep_their_gradient():
    camera = tr.PerspectiveCamera(fov=50.0, fov_axis="y", film=tr.Film(12, 8))
    camera.x_fov.requires_grad_()
    (slope,) = torch.autograd.grad(camera.fov, camera.x_fov)
    step = 1e-2
    ends = [camera.scale(camera.x_fov.detach() + s, 8 / 12) for s in (-step, step)]
    assert float(slope) == pytest.approx(float(ends[1] - ends[0]) / (2 * step), rel=1e-3)


def test_what_is_read_when_an_object_is_made():
    with pytest.raises(ValueError, match=r"Dielectric\.int_ior: 'int_ior' is read when the object is made; assign eta"):
        tr.Dielectric().int_ior = 1.3


def test_a_dict_as_an_attribute_is_an_object():
    scene = make()
    scene.ball2 = {"type": "sphere", "radius": 0.5, "center": [0.9, 0, 0]}
    assert isinstance(scene.ball2, tr.Sphere) and "ball2" in scene
    expected = make(ball2={"type": "sphere", "radius": 0.5, "center": [0.9, 0, 0]})
    assert torch.equal(tr.render(scene, spp=1, seed=0), tr.render(expected, spp=1, seed=0))


def test_modules_of_torch_may_be_attached():
    from torch.nn.utils import parametrize

    scene = make()
    parametrize.register_parametrization(scene.ball.bsdf.reflectance, "value", tr.constraints.UnitInterval())
    scene._mine = 3
    tr.render(scene, spp=1)


def test_trimesh_is_told_what_becomes_of_it():
    trimesh = pytest.importorskip("trimesh")
    with pytest.raises(ValueError, match=r"x: .* becomes a shape by tr.Mesh\(vertices=mesh.vertices"):
        make()["x"] = trimesh.creation.box()
