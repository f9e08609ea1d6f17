"""What people who have never seen this package write in their first hour: what helps them, and what they get."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from first_scene import make, said
from PIL import Image

import torchrender as tr
from torchrender.errors import describe

BYTES = np.full((4, 5, 3), 128, np.uint8)
LINEAR = ((128 / 255 + 0.055) / 1.055) ** 2.4


def scene(**objects):
    return tr.load_dict({"type": "scene", "camera": {"type": "perspective"}, **objects})


def ball(**properties):
    return scene(ball={"type": "sphere", **properties})


def diffuse(value):
    return ball(bsdf={"type": "diffuse", "reflectance": value})


def smoke(**properties):
    return scene(smoke={"type": "cube", "bsdf": {"type": "null"}, "interior": {"type": "heterogeneous", **properties}})


# ------------------------------------------------------------------------------------------------------------ errors
ADVICE = {
    "a reference to nothing": (
        lambda: ball(bsdf={"type": "ref", "id": "wood"}),
        r"ball.bsdf: there is no object with the id 'wood'; known here: ball, camera$",
    ),
    "the id of an object": (lambda: ball(bsdf="red"), r"ball.bsdf: .*'red' \(str\).*{'type': 'ref', 'id': 'red'}"),
    "the type of an object": (lambda: ball(bsdf="diffuse"), r"ball.bsdf: .* of this type is {'type': 'diffuse'}"),
    "a phase function": (lambda: smoke(phase="hg"), r"smoke.*phase_function: .* of this type is {'type': 'hg'}"),
    "a shape": (lambda: scene(ball="sphere"), r"ball: expected a nested object .* {'type': 'sphere'}"),
    "an image file": (lambda: diffuse("wood.png"), r"reflectance: .* {'type': 'bitmap', 'filename': 'wood.png'}"),
    "a file of voxels": (lambda: smoke(sigma_t="a.vol"), r"sigma_t: .* {'type': 'gridvolume', 'filename': 'a.vol'}"),
    "a class": (
        lambda: ball(bsdf=tr.Diffuse),
        r"ball.bsdf: .*; it is a class, of which Diffuse\(...\) makes an object",
    ),
    "texels without channels": (
        lambda: diffuse(np.ones((4, 5))),
        r"ball.bsdf.reflectance: .* are value\[\.\.\., None\]",
    ),
    "channels first": (lambda: diffuse(np.ones((3, 8, 8))), r"looks like \(C, H, W\): C comes last here"),
    "a batch of texels": (
        lambda: diffuse(np.ones((1, 8, 8, 3))),
        r"reflectance: expected .* or texels \(H, W, C\), got",
    ),
    "a slice of voxels": (lambda: smoke(sigma_t=np.ones((4, 4))), r"sigma_t: expected .* or voxels \(Z, Y, X\) or"),
    "a place": (
        lambda: ball(to_world=[0, 1, 0]),
        r"ball.to_world: .* a place is tr.Transform.translate\(\[x, y, z\]\)",
    ),
    "a scale in words": (lambda: tr.Transform.scale("2"), r"Transform.scale: expected three numbers, got '2'"),
    "a camera's size": (
        lambda: scene(c={"type": "thinlens", "width": 64}),
        r"c: thinlens has no parameter 'width'.*film",
    ),
    "a camera's samples": (lambda: scene(c={"type": "perspective", "spp": 64}), r"no parameter 'spp'; .*sampler"),
    "a camera's pose": (
        lambda: scene(c={"type": "perspective", "origin": [0, 0, 1]}),
        r"tr.Transform.look_at\(origin,",
    ),
    "an index of a camera": (lambda: tr.render(make(), sensor=3), r"index 3, but the scene has 1 camera$"),
    "a size": (lambda: tr.render(make(), size=64), r"^render: size: expected \(height, width\), got 64"),
    "a mesh of trimesh": (
        lambda: tr.Mesh(trimesh.creation.box()),
        r"Mesh.vertices: .*tr.Mesh\(mesh.vertices, mesh.faces\)",
    ),
    "a dict for a file": (lambda: tr.load_file({"type": "scene"}), r"load_file: path: .*; tr.load_dict takes dicts"),
    "nothing for a file": (lambda: tr.load_file(None), r"load_file: path: expected a file name, got None"),
    "a file for a dict": (
        lambda: tr.load_dict("a.xml"),
        r"load_dict: expected a nested dict, .*; tr.load_file reads files",
    ),
    "a file for trimesh": (
        lambda: tr.from_trimesh("a.glb"),
        r"^geometry: expected a trimesh.*; tr.load_file reads files",
    ),
    "outputs as a picture": (
        lambda: tr.io.write_image("a.png", tr.render(make(), spp=1, outputs=("depth", "rgb"))),
        r"only EXR files have named channels; write one output, such as found.depth",
    ),
    "nothing to show": (lambda: tr.show(None), r"image: expected an image .*, got NoneType"),
    "bytes to show": (
        lambda: tr.show(torch.zeros(4, 4, 3, dtype=torch.uint8)),
        r"image: expected linear radiance, got b",
    ),
    "a curve's other words": (
        lambda: tr.LinearCurve(points=np.zeros((5, 3)), radii=0.1),
        r"LinearCurve: linearcurve has no parameter 'points'; did you mean 'control_points'",
    ),
    "strands of two lengths": (
        lambda: tr.BSplineCurve(control_points=[np.zeros((5, 3)), np.zeros((6, 3))], radii=0.1),
        r"control_points: got strands of different lengths: .* segment_indices",
    ),
    "strands too short": (
        lambda: tr.BSplineCurve(control_points=np.zeros((5, 3, 3)), radii=0.1),
        r"control_points: a bsplinecurve has at least 4, got 3",
    ),
}


@pytest.mark.parametrize("name", ADVICE)
def test_errors_say_what_to_write(name):
    call, message = ADVICE[name]
    with pytest.raises((TypeError, ValueError), match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "meant"),
    [("Pathtracer", "PathTracer"), ("sphere", "Sphere"), ("BsplineCurve", "BSplineCurve"), ("load_dct", "load_dict")],
)
def test_names_of_the_package(name, meant):
    with pytest.raises(AttributeError, match=f"no attribute '{name}'; did you mean '{meant}'"):
        getattr(tr, name)
    assert not hasattr(tr, "__wrapped__") and not hasattr(tr, "qqqqqq")


def test_what_came_fits_on_a_line():
    assert describe([np.zeros((2, 2)), 1]) == "[array([[0., 0.], [0., 0.]]), 1] (list)"


# ------------------------------------------------------------------------------------------------- pictures as textures
@pytest.mark.parametrize(
    "value", [BYTES, torch.from_numpy(BYTES), Image.fromarray(BYTES)], ids=["NumPy", "torch", "PIL"]
)
def test_pictures_in_place_of_a_texture_are_decoded_as_files_are(tmp_path, value):
    Image.fromarray(BYTES).save(tmp_path / "a.png")
    found = tr.Diffuse(reflectance=value).reflectance.data
    assert torch.equal(found, tr.Bitmap(filename=str(tmp_path / "a.png")).data)
    torch.testing.assert_close(found, torch.full((4, 5, 3), LINEAR), rtol=1e-5, atol=0)


def test_pictures_of_normals_stay_as_they_are():
    nested = {"type": "diffuse"}
    expected = torch.full((4, 5, 3), 128 / 255)
    assert torch.equal(
        ball(bsdf={"type": "normalmap", "n": nested, "normalmap": BYTES}).ball.bsdf.normalmap.data, expected
    )


# -------------------------------------------------------------------------------------------------------------- curves
def test_strands_of_equal_length():
    points = torch.rand(3, 6, 3, generator=torch.Generator().manual_seed(0))
    radii = torch.rand(3, 6, generator=torch.Generator().manual_seed(1)) + 0.1
    curve = tr.BSplineCurve(control_points=points, radii=radii)
    assert torch.equal(curve.control_points, points.flatten(0, 1)) and torch.equal(curve.radii, radii.flatten())
    assert curve.segment_indices.tolist() == [0, 1, 2, 6, 7, 8, 12, 13, 14]  # none from one strand to the next
    together = tr.BSplineCurve(control_points=torch.cat([points, radii[..., None]], -1).tolist())
    assert torch.equal(together.control_points, curve.control_points) and torch.equal(together.radii, curve.radii)
    assert torch.equal(together.segment_indices, curve.segment_indices)
    assert tr.LinearCurve(control_points=points, radii=0.1).segment_indices.tolist() == [
        *range(5),
        *range(6, 11),
        *range(12, 17),
    ]


@pytest.mark.parametrize("bsdf", [{"type": "dielectric"}, {"type": "mask", "inner": {"type": "roughdielectric"}}])
def test_curves_of_glass_are_warned_about_once(bsdf):
    wire = {"type": "linearcurve", "control_points": [[-1.0, 0, 0], [1, 0, 0]], "radii": 0.1, "bsdf": bsdf}
    wires = scene(sky={"type": "constant"}, wire=wire)
    with pytest.warns(UserWarning, match="wire: light that refracts into a curve leaves it unbent"):
        tr.render(wires, spp=1, size=(2, 2))
    assert said(wires) == []
    wires["wire"] = {**wire, "bsdf": {"type": "hair"}}
    assert said(wires) == []


# ------------------------------------------------------------------------------------------------------------ pictures
def test_pictures_of_numpy_are_shown():
    image = torch.rand(4, 6, 3, generator=torch.Generator().manual_seed(0))
    expected = np.asarray(tr.show([image, image[..., 0]]))
    assert np.array_equal(np.asarray(tr.show([image.numpy(), image[..., 0]])), expected)
    assert np.array_equal(np.asarray(tr.show(x for x in (image, image[..., 0]))), expected)
    assert np.array_equal(np.asarray(tr.show(image.numpy())), expected[:, :6])


def test_numbers_of_numpy_for_films(tmp_path):
    frames = [torch.zeros(2, 2, 3), torch.ones(2, 2, 3)]
    tr.io.write_video(tmp_path / "a.gif", frames, fps=np.int64(10), quality=np.int32(50))
    tr.io.write_video(tmp_path / "b.gif", frames, fps=10)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()
    for fps in (np.float32(0), np.bool_(True), "10", torch.ones(2)):
        with pytest.raises(ValueError, match=r"fps: expected a number above 0, at most 50 for \.gif"):
            tr.io.write_video(tmp_path / "c.gif", frames, fps=fps)
