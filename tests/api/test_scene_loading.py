"""What `load_dict` makes of the values that people write."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import torchrender as tr
from torchrender.scene.indices import REFRACTIVE_INDICES

LUMINANCE = [0.2126, 0.7152, 0.0722]


def reflectance(value, **settings) -> torch.Tensor:
    scene = tr.load_dict(
        {"type": "scene", "a": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": value}}}, **settings
    )
    return scene.a.bsdf.reflectance.value


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.25, 0.25),
        (1, 1.0),
        (np.float32(0.25), 0.25),
        ([0.1, 0.2, 0.3], [0.1, 0.2, 0.3]),
        ((0.1, 0.2, 0.3), [0.1, 0.2, 0.3]),
        (np.array([0.1, 0.2, 0.3]), [0.1, 0.2, 0.3]),
        (torch.tensor([0.1, 0.2, 0.3]), [0.1, 0.2, 0.3]),
        ({"type": "rgb", "value": [0.1, 0.2, 0.3]}, [0.1, 0.2, 0.3]),
        ({"type": "rgb", "value": "0.1, 0.2 0.3"}, [0.1, 0.2, 0.3]),
        ({"type": "rgb", "value": 0.3}, [0.3, 0.3, 0.3]),
        ({"type": "srgb", "color": [0.1, 0.2, 0.3]}, [0.1, 0.2, 0.3]),
        ({"type": "spectrum", "value": 0.3}, 0.3),
        ({"type": "uniform", "value": 0.3}, 0.3),
    ],
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_colours(value, expected, dtype):
    found = reflectance(value, dtype=dtype)
    assert isinstance(found, torch.nn.Parameter) and not found.requires_grad
    assert found.dtype == dtype
    torch.testing.assert_close(found.detach(), torch.tensor(expected, dtype=dtype), rtol=1e-6, atol=0)


def test_mono_takes_luminance():
    found = reflectance({"type": "rgb", "value": [0.1, 0.2, 0.3]}, variant="mono", dtype=torch.float64)
    assert found.shape == (1,)
    assert float(found) == pytest.approx(np.dot([0.1, 0.2, 0.3], LUMINANCE), rel=1e-6)
    assert reflectance(0.3, variant="mono").shape == ()
    built = tr.load_dict({"type": "scene", "m": tr.Diffuse(reflectance=[0.1, 0.2, 0.3])}, variant="mono")
    assert built.m.reflectance.value.shape == (1,)


def test_mono_bitmaps_have_one_channel():
    texels = torch.rand(4, 5, 3, generator=torch.Generator().manual_seed(0))
    scene = tr.load_dict(
        {"type": "scene", "m": {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels, "raw": True}}},
        variant="mono",
    )
    expected = (texels * torch.tensor(LUMINANCE)).sum(-1, keepdim=True)
    torch.testing.assert_close(scene.m.reflectance.data.detach(), expected)


@pytest.mark.parametrize(("shape", "stored"), [((4, 5), (4, 5, 1)), ((4, 5, 1), (4, 5, 1)), ((4, 5, 4), (4, 5, 3))])
def test_bitmap_channels(shape, stored):
    bitmap = tr.Bitmap(data=torch.rand(shape), raw=True)
    assert bitmap.data.shape == stored


def test_an_array_in_place_of_a_texture_is_a_raw_bitmap():
    texels = torch.rand(2, 3, 3)
    diffuse = tr.Diffuse(reflectance=texels)
    assert diffuse.reflectance.type == "bitmap"
    assert torch.equal(diffuse.reflectance.data.detach(), texels)


def test_bytes_are_decoded_from_srgb_unless_raw():
    texels = np.array([[[0, 128, 255]]], dtype=np.uint8)
    linear = ((128 / 255 + 0.055) / 1.055) ** 2.4
    torch.testing.assert_close(
        tr.Bitmap(data=texels).data.detach(), torch.tensor([[[0.0, linear, 1.0]]]), rtol=1e-5, atol=1e-6
    )
    torch.testing.assert_close(tr.Bitmap(data=texels, raw=True).data.detach(), torch.tensor([[[0.0, 128 / 255, 1.0]]]))


def test_floating_point_texels_are_linear_already():
    texels = torch.full((2, 2, 3), 0.5)
    assert torch.equal(tr.Bitmap(data=texels, raw=False).data.detach(), texels)


def test_bitmap_from_file(tmp_path):
    texels = torch.rand(3, 4, 3, generator=torch.Generator().manual_seed(1))
    tr.io.write_image(tmp_path / "t.exr", texels)
    bitmap = tr.Bitmap(filename=str(tmp_path / "t.exr"), raw=True)
    torch.testing.assert_close(bitmap.data.detach(), texels, rtol=2e-3, atol=1e-4)


def test_tensors_are_copied():
    texels = torch.zeros(2, 2, 3)
    bitmap = tr.Bitmap(data=texels)
    texels.fill_(1)
    assert float(bitmap.data.detach().sum()) == 0


def test_parameters_given_stay_themselves():
    value = torch.nn.Parameter(torch.tensor([0.1, 0.2, 0.3]))
    scene = tr.load_dict({"type": "scene", "m": tr.Diffuse(reflectance=value)})
    assert scene.m.reflectance.value is value


def test_defaults():
    scene = tr.load_dict({"type": "scene", "sensor": {"type": "perspective"}, "a": {"type": "sphere"}})
    film = scene.sensors[0].film
    assert (film.width, film.height) == (768, 576)
    assert (film.filter.type, film.filter.stddev) == ("gaussian", 0.5)
    assert scene.sensors[0].sampler is None
    assert scene.integrator is None
    assert float(scene.a.bsdf.reflectance.value) == 0.5
    assert float(scene.a.radius) == 1
    assert float(tr.Checkerboard().color0.value) == pytest.approx(0.4)
    assert float(tr.Checkerboard().color1.value) == pytest.approx(0.2)
    assert float(tr.AreaLight().radiance.value) == 1
    assert float(tr.Conductor().eta.value) == 0 and float(tr.Conductor().k.value) == 1
    assert float(tr.load_dict({"type": "sphere"}).radius) == 1


def test_samplers_and_films():
    camera = tr.load_dict(
        {
            "type": "perspective",
            "sampler": {"type": "independent", "sample_count": 7},
            "film": {
                "type": "hdrfilm",
                "width": 40,
                "height": 30,
                "crop_offset_x": 3,
                "crop_offset_y": 4,
                "crop_width": 10,
                "crop_height": 20,
                "sample_border": True,
                "pixel_format": "rgba",
                "component_format": "float32",
                "rfilter": {"type": "tent", "radius": 2.0},
            },
        }
    )
    assert camera.sampler.sample_count == 7
    assert camera.film.window == (4, 3, 20, 10)
    assert camera.film.sample_border
    assert (camera.film.filter.type, camera.film.filter.radius) == ("tent", 2.0)
    plain = tr.load_dict({"type": "perspective", "sampler": {"type": "independent"}})
    assert plain.sampler == tr.Sampler(4, "independent")
    assert tr.load_dict({"type": "perspective", "any": {"type": "sobol", "sample_count": 3}}).sampler.type == "sobol"
    jittered = tr.load_dict({"type": "perspective", "sampler": {"type": "stratified", "jitter": True}})
    assert jittered.sampler == tr.Sampler(sample_count=4, type="stratified")
    assert "4 stratified samples a pixel" in repr(jittered)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        # Values that Mitsuba 3.9.1 reports as x_fov for a film of 768 x 576 pixels.
        ({}, 38.18484),
        ({"fov": 40}, 40.0),
        ({"fov": 40, "fov_axis": "x"}, 40.0),
        ({"fov": 40, "fov_axis": "y"}, 51.77401),
        ({"fov": 40, "fov_axis": "diagonal"}, 32.46861),
        ({"fov": 40, "fov_axis": "smaller"}, 51.77401),
        ({"fov": 40, "fov_axis": "larger"}, 40.0),
        ({"focal_length": "35mm"}, 52.62254),
    ],
)
def test_field_of_view(settings, expected):
    camera = tr.load_dict({"type": "perspective", **settings})
    assert float(camera.x_fov) == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize(("size", "expected"), [((48, 64), 38.18484), ((64, 48), 29.10546), ((64, 64), 34.02206)])
def test_default_field_of_view_follows_the_film(size, expected):
    camera = tr.load_dict({"type": "perspective", "film": {"type": "hdrfilm", "height": size[0], "width": size[1]}})
    assert float(camera.x_fov) == pytest.approx(expected, abs=2e-5)


def test_dielectric_takes_numbers_and_names():
    assert float(tr.Dielectric().eta) == pytest.approx(1.5046 / 1.000277, rel=1e-6)
    assert float(tr.Dielectric(int_ior="water", ext_ior=1.1).eta) == pytest.approx(1.333 / 1.1, rel=1e-6)
    assert float(tr.Dielectric(int_ior="vacuum", ext_ior="diamond").eta) == pytest.approx(1 / 2.419, rel=1e-6)
    assert float(tr.Dielectric(eta=1.3).eta) == pytest.approx(1.3)
    assert REFRACTIVE_INDICES["air"] == 1.000277


def test_conductors_by_name():
    gold = tr.Conductor(material="Au")
    torch.testing.assert_close(gold.eta.value.detach(), torch.tensor([0.143036, 0.375307, 1.44205]))
    assert float(tr.Conductor(material="none").k.value) == 1


def test_point_light_from_a_transform():
    light = tr.PointLight(to_world=tr.Transform.translate([1, 2, 3]))
    assert light.position.tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    "matrix",
    [
        tr.Transform.translate([1, 2, 3]),
        np.array(tr.Transform.translate([1, 2, 3])),
        tr.Transform.translate([1, 2, 3]).matrix,
        tr.Transform.translate([1, 2, 3]).matrix.tolist(),
        tr.Transform.translate([1, 2, 3]).matrix.flatten().tolist(),
    ],
)
def test_transforms_in_every_form(matrix):
    disk = tr.Disk(to_world=matrix)
    assert disk.to_world[:3, 3].tolist() == [1, 2, 3]


def test_texture_transform_from_four_by_four():
    matrix = tr.Transform.translate([0.1, 0.2, 9]) @ tr.Transform.scale([2, 3, 7])
    found = tr.Bitmap(data=torch.rand(2, 2, 3), to_uv=matrix).to_uv
    torch.testing.assert_close(found.detach(), torch.tensor([[2, 0, 0.1], [0, 3, 0.2], [0, 0, 1]]))


def test_transform_chains():
    chained = tr.Transform.translate([1, 0, 0]) @ tr.Transform.rotate([0, 0, 1], 90) @ tr.Transform.scale(2)
    torch.testing.assert_close(
        chained.transform_points([1.0, 0, 0]), torch.tensor([1.0, 2.0, 0.0], dtype=torch.float64)
    )
    assert torch.equal(tr.Transform.translate([1, 0, 0]).scale(2).matrix[0], torch.tensor([2.0, 0, 0, 1]).double())
    undone = (chained @ chained.inverse()).matrix
    torch.testing.assert_close(undone, torch.eye(4, dtype=torch.float64))


def test_look_at_points_the_camera():
    matrix = tr.Transform.look_at([1, 2, 3], [4, 5, 6], [0, 1, 0]).matrix
    torch.testing.assert_close(matrix[:3, 2], torch.full((3,), 1 / math.sqrt(3), dtype=torch.float64))
    torch.testing.assert_close(matrix[:3, :3].T @ matrix[:3, :3], torch.eye(3, dtype=torch.float64))
    assert float(torch.linalg.det(matrix)) == pytest.approx(1)
    assert float(matrix[1, 1]) > 0


def test_cube_normals_match_its_triangles():
    cube = tr.Cube(to_world=tr.Transform.scale([1, 2, 3]) @ tr.Transform.rotate([0, 1, 0], 30))
    corners = cube.vertex_positions[cube.faces.long()].detach()
    face = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face = torch.nn.functional.normalize(face, dim=1)
    torch.testing.assert_close(cube.vertex_normals[cube.faces[:, 0].long()].detach(), face, atol=1e-5, rtol=0)
    assert bool(((face * corners.mean(1)).sum(1) > 0).all())  # they point outside


def test_mesh_in_world_space():
    mesh = tr.Mesh(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32),
        np.array([[0, 1, 2]]),
        vertex_normals=torch.tensor([[0.0, 0, 1]] * 3),
        to_world=tr.Transform.translate([0, 0, 5]) @ tr.Transform.rotate([1, 0, 0], 90),
    )
    torch.testing.assert_close(mesh.vertex_positions[2].detach(), torch.tensor([0.0, 0.0, 6.0]))
    torch.testing.assert_close(mesh.vertex_normals[0].detach(), torch.tensor([0.0, -1.0, 0.0]), atol=1e-6, rtol=0)
    assert mesh.faces.dtype == torch.int32


def test_built_objects_may_hold_references():
    texels = torch.rand(2, 2, 3)
    scene = tr.load_dict(
        {
            "type": "scene",
            "m": tr.Mesh(
                [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
                [[0, 1, 2]],
                bsdf={"type": "twosided", "x": {"type": "diffuse", "reflectance": {"type": "ref", "id": "tex"}}},
            ),
            "n": tr.Rectangle(bsdf={"type": "ref", "id": "white"}),
            "white": {"type": "diffuse", "reflectance": 0.9},
            "tex": {"type": "bitmap", "data": texels, "raw": True},
        }
    )
    assert scene.m.bsdf.brdf_0.reflectance is scene.tex
    assert scene.n.bsdf is scene.white


def test_objects_take_the_scene_s_precision():
    mesh = tr.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    scene = tr.load_dict({"type": "scene", "m": mesh}, dtype=torch.float64)
    assert scene.m is mesh
    assert mesh.vertex_positions.dtype == torch.float64
    assert {p.dtype for p in scene.parameters()} == {torch.float64}


def test_normals_of_files_without_normals(tmp_path):
    # A tent of two triangles: the shared edge's normals lie between those of its faces.
    (tmp_path / "tent.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 1\n0 1 1\n-1 0 0\n1 0 0\n3 0 1 2\n3 1 0 3\n"
    )
    smooth = tr.load_dict({"type": "ply", "filename": str(tmp_path / "tent.ply")})
    flat = tr.load_dict({"type": "ply", "filename": str(tmp_path / "tent.ply"), "face_normals": True})
    torch.testing.assert_close(smooth.vertex_normals[0].detach(), torch.tensor([0.0, 0.0, 1.0]), atol=1e-6, rtol=0)
    assert flat.vertex_normals is None


def test_variants_are_those_of_the_build():
    assert {"mono", "rgb"} <= set(tr.variants())


def test_opencv_opengl_and_look_at_agree():
    origin, target, size, fov = [1.0, 2.0, 5.0], [0.2, 0.1, 0.0], (30, 40), 50.0
    ours = tr.PerspectiveCamera.look_at(origin, target, fov=fov, size=size)
    gl = ours.to_world.detach().double() @ torch.diag(torch.tensor([-1.0, 1, -1, 1]).double())
    from_gl = tr.PerspectiveCamera.from_opengl(gl[:3], fov, size)
    cv = torch.linalg.inv(ours.to_world.detach().double() @ torch.diag(torch.tensor([-1.0, -1, 1, 1]).double()))
    focal = size[1] / 2 / math.tan(math.radians(fov) / 2)
    K = torch.tensor([[focal, 0, size[1] / 2 + 3], [0, focal, size[0] / 2 - 2], [0, 0, 1]])
    from_cv = tr.PerspectiveCamera.from_opencv(K, cv[:3, :3], cv[:3, 3], size)
    for camera in (from_gl, from_cv):
        torch.testing.assert_close(camera.to_world.detach().float(), ours.to_world.detach(), atol=1e-5, rtol=0)
        assert float(camera.x_fov) == pytest.approx(fov, rel=1e-5)
        assert (camera.film.height, camera.film.width) == size
    assert float(from_cv.principal_point_offset_x) == pytest.approx(-3 / size[1], rel=1e-4)
    assert float(from_cv.principal_point_offset_y) == pytest.approx(2 / size[0], rel=1e-4)


def test_opencv_tensors_keep_their_gradient():
    t = torch.tensor([0.0, 0.0, 4.0], requires_grad=True)
    camera = tr.PerspectiveCamera.from_opencv([[50, 0, 16], [0, 50, 16], [0, 0, 1]], torch.eye(3), t, (32, 32))
    camera.to_world[:3, 3].sum().backward()
    assert t.grad.tolist() == [-1.0, -1.0, -1.0]  # the camera stands at -R^T t


def test_attributes_of_a_built_mesh_become_luminance_in_mono():
    colours = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    mesh = tr.Mesh(torch.eye(3), [[0, 1, 2]], attributes={"vertex_color": colours})
    scene = tr.load_dict({"type": "scene", "a": mesh}, variant="mono")
    torch.testing.assert_close(scene.a.vertex_color.detach(), torch.tensor(LUMINANCE)[:, None])
