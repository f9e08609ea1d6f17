"""Bad scenes: an error that names the place, the word and the nearest known one; never a crash or a silent default."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import torchrender as tr

TRIANGLE = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]


def scene(**objects):
    return {"type": "scene", **objects}


def diffuse(value):
    return scene(a={"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": value}})


def mesh(vertices=TRIANGLE, faces=((0, 1, 2),), **more):
    return scene(m={"type": "mesh", "vertices": vertices, "faces": faces, **more})


def camera(**more):
    return scene(cam={"type": "perspective", **more})


def film(**more):
    return camera(film={"type": "hdrfilm", **more})


BITMAP = {"type": "bitmap", "raw": True}
SINGULAR = np.diag([1.0, 1.0, 0.0, 1.0])

CASES = [
    # words
    (scene(a={"type": "spher"}), "a: unknown object type 'spher'; did you mean 'sphere'"),
    (scene(a={"type": "sphere", "raduis": 2}), "a: sphere has no parameter 'raduis'; did you mean 'radius'"),
    (scene(a={"type": "sphere", "bsdf": {"type": "difuse"}}), "a.bsdf: unknown bsdf type 'difuse'.*'diffuse'"),
    (scene(a={"type": "sphere", "bsdf": {"type": "measured"}}), "a.bsdf: .*'measured' is not supported"),
    (scene(a={"type": "sphere", "bsdf": {"type": "point"}}), "a.bsdf: expected a bsdf, got 'point', which"),
    (scene(a={"type": "ellipsoids"}), "a: the shape 'ellipsoids' is not supported"),
    (scene(a={"type": "bdpt"}), "a: the integrator 'bdpt' is not supported"),
    (scene(a={"type": "path", "max_dept": 3}), "a: path has no parameter 'max_dept'; did you mean 'max_depth'"),
    (scene(a={"type": "path", "max_depth": -2}), "a: PathTracer: max_depth: expected at least -1, got -2"),
    (scene(a={"reflectance": 0.5}), "a: a dict that describes an object needs a 'type'"),
    (scene(a=3.0), "a: expected a nested object"),
    (scene(a={"type": "diffuse", "id": 3}), "a: id: expected a string"),
    ({"type": "scene", "a.b": {"type": "sphere"}}, "an id is a string without dots"),
    (scene(a={"type": "hdrfilm"}), r"a: a film \(hdrfilm\) belongs into a sensor"),
    (scene(a={"type": "sobol"}), r"a: a sampler \(sobol\) belongs into a sensor"),
    (scene(a={"type": "box"}), r"a: a filter \(box\) belongs into a film"),
    (scene(a={"type": "sphere", "bsdf": {"type": "hdrfilm"}}), r"a.bsdf: a film \(hdrfilm\) belongs into a sensor"),
    ({"type": "box"}, "load_dict: type: expected a scene or an object of one, got 'box', a filter of a film"),
    ({"type": "sobol"}, "load_dict: type: .* got 'sobol', a sampler of a sensor"),
    # references
    (scene(a={"type": "sphere", "bsdf": {"type": "ref", "id": "wite"}}, white={"type": "diffuse"}), "wite.*'white'"),
    (scene(a={"type": "sphere", "bsdf": {"type": "ref", "id": "b"}}, b={"type": "disk"}), "a.bsdf: expected a bsdf"),
    (scene(a={"type": "sphere", "bsdf": {"type": "ref"}}), "a.bsdf: a reference is"),
    (scene(a={"type": "sphere", "x": {"type": "ref", "id": "b"}}, b={"type": "bitmap", "data": np.zeros((1, 1, 3))}),
     "a sphere cannot contain a texture"),
    # structure
    (scene(a={"type": "sphere", "x": {"type": "diffuse"}, "y": {"type": "diffuse"}}), "a.y: sphere: more than 1"),
    (scene(a={"type": "sphere", "emitter": {"type": "constant"}}), "a.emitter: only area or directionalarea"),
    (scene(a={"type": "diffuse", "x": {"type": "diffuse"}}), "a: diffuse has no parameter 'x'"),
    (scene(a={"type": "twosided"}), "a: twosided: a nested BSDF is missing"),
    (scene(a={"type": "twosided", "x": {"type": "dielectric"}}), "a.brdf_0: a dielectric cannot be made two-sided"),
    (scene(l={"type": "constant", "radiance": BITMAP | {"data": np.zeros((1, 1, 3))}}), "cannot be a texture"),
    # values
    (diffuse(1.2), r"a.bsdf.reflectance.value: 1.2 is outside the range \[0, 1\]"),
    (diffuse([0.1, -0.5, 0.2]), "a.bsdf.reflectance.value: -0.5 is outside"),
    (diffuse(float("nan")), "a.bsdf.reflectance.value: has values that are not finite"),
    (diffuse([0.1, 0.2]), "a.bsdf.reflectance.* a colour of three numbers"),
    (diffuse("red"), "a.bsdf.reflectance: expected a number, a colour, .*got 'red'"),
    (diffuse(None), None),  # None is "not given"
    (diffuse(torch.tensor([1 + 2j])), "a.bsdf.reflectance: expected real numbers"),
    (diffuse({"type": "rgb", "value": [1, 2]}), "rgb: expected three numbers"),
    (diffuse({"type": "rgb"}), "rgb: 'value' is missing"),
    (diffuse({"type": "rgb", "value": [0.1, 0.2, 0.3], "scale": 2}), "rgb has no parameter 'scale'"),
    (diffuse({"type": "spectrum", "value": [[700, 0.1], [400, 0.2]]}), "reflectance.*must increase"),
    (diffuse({"type": "blackbody", "temperature": 0}), "reflectance.*positive temperature"),
    (diffuse(np.zeros((2, 2, 5))), "texels of shape"),
    (diffuse(BITMAP), "give one of filename, bitmap and data; got none"),
    (diffuse(BITMAP | {"data": np.zeros((0, 4, 3))}), "texels of shape"),
    (diffuse(BITMAP | {"data": np.full((2, 2, 3), np.inf)}), "data: has values that are not finite"),
    (diffuse(BITMAP | {"data": np.zeros((1, 1, 3)), "filter_type": "bilinea"}), "filter_type: .*'bilinear'"),
    (diffuse(BITMAP | {"data": np.zeros((1, 1, 3)), "filter_typ": "bilinear"}), "has no parameter 'filter_typ'"),
    (diffuse({"type": "bitmap", "data": np.zeros((1, 1, 3)), "raw": "yes"}), "raw: expected True or False, got 'yes'"),
    (diffuse({"type": "mesh_attribute"}), "'name' is missing"),
    (diffuse({"type": "mesh_attribute", "name": "color"}), "name: expected a name beginning with 'vertex_'"),
    (scene(a={"type": "sphere", "radius": 0}), "a.radius: expected a positive number"),
    (scene(a={"type": "sphere", "radius": [1, 2]}), "a.radius: expected a number, got"),
    (scene(a={"type": "sphere", "center": [1, 2]}), "a.center: expected three numbers"),
    (scene(a={"type": "sphere", "flip_normals": 1}), "a.flip_normals: expected True or False"),
    (scene(a={"type": "sphere", "to_world": np.eye(3)}), "a.to_world: .*expected a 4x4 matrix"),
    (scene(a={"type": "sphere", "to_world": np.full((4, 4), np.nan)}), "a.to_world: .*not finite"),
    (scene(b={"type": "diffuse", "reflectance": 0.1}, a={"type": "sphere", "bsdf": {"type": "ref", "id": "b", "x": 1}}),
     "a.bsdf: a reference is"),
    (scene(a={"type": "dielectric", "int_ior": "glas"}), "a.int_ior: unknown material 'glas'"),
    (scene(a={"type": "dielectric", "int_ior": -1.0}), "a.int_ior: an index of refraction is positive"),
    (scene(a={"type": "dielectric", "int_ior": 1.5, "eta": 1.5}), "give eta, or int_ior, but not both"),
    (scene(a={"type": "roughdielectric", "alpha": 20.0}), r"a.alpha.value: 20 is outside the range \[0, 10\]"),
    (scene(a={"type": "roughdielectric", "alpha_u": 0.1}), "a: .*alpha_u is given without alpha_v"),
    (scene(a={"type": "roughdielectric", "sample_visible": 0.5}), "a.sample_visible: expected True or False"),
    (scene(a={"type": "roughdielectric", "distribution": "phong"}), "a.distribution: .*beckmann, ggx"),
    (scene(a={"type": "roughdielectric", "eta": 1.5, "ext_ior": 1.0}), "give eta, or ext_ior, but not both"),
    (scene(a={"type": "roughconductor", "alpha_v": 0.1}), "a: .*alpha_v is given without alpha_u"),
    (scene(a={"type": "roughconductor", "alpha_v": 0.1, "alpha": 0.1}), "a: .*give alpha, or alpha_u and alpha_v"),
    (scene(a={"type": "roughplastic", "alpha_u": 0.1}), "a: .*'alpha_u' is not supported"),
    (scene(a={"type": "roughconductor", "alpha": -0.1}), r"a.alpha.value: -0.1 is outside the range \[0, 10\]"),
    (scene(a={"type": "roughconductor", "material": "Gold"}), "a.material: the conductor 'Gold' is not known"),
    (scene(a={"type": "roughconductor", "material": "Au", "k": 1.0}), "a: .*give material, or eta and k"),
    (scene(a={"type": "plastic", "nonlinear": 1}), "a.nonlinear: expected True or False"),
    (scene(a={"type": "plastic", "int_ior": "glas"}), "a.int_ior: unknown material 'glas'"),
    (scene(a={"type": "roughplastic", "alpha": {"type": "checkerboard"}}), "a.alpha: .*be a texture"),
    (scene(a={"type": "principled", "anisotropic": 1.5}), r"a.anisotropic.value: 1.5 is outside the range \[0, 1\]"),
    (scene(a={"type": "principled", "eta": 1.5, "specular": 0.5}), "a: .*give eta or specular"),
    (scene(a={"type": "principled", "metallic": 2.0}), r"a.metallic.value: 2 is outside the range \[0, 1\]"),
    (
        scene(a={"type": "twosided", "x": {"type": "principled", "spec_trans": 0.5}}),
        "a.brdf_0: a principled with spec_trans cannot be made two-sided",
    ),
    (scene(a={"type": "twosided", "x": {"type": "roughdielectric"}}), "a.brdf_0: a roughdielectric cannot be made two"),
    (scene(a={"type": "conductor", "material": "Unobtainium"}), "a.material: the conductor 'Unobtainium' is not known"),
    (scene(a={"type": "conductor", "material": "Au", "eta": 1.0}), "give material, or eta and k"),
    (scene(a={"type": "point", "position": [0, 0, 0], "to_world": np.eye(4)}), "give position or to_world"),
    (scene(a={"type": "point", "intensity": -1.0}), "a.intensity.value: -1 is outside"),
    (scene(a={"type": "envmap"}), "give one of filename, bitmap and data"),
    (scene(a={"type": "envmap", "data": np.zeros((1, 1, 3))}), "a.data: an environment map has at least 2x2"),
    (scene(a={"type": "envmap", "data": np.ones((2, 2, 3)), "mis_compensation": 1}), "mis_compensation: expected True"),
    # meshes
    (mesh(vertices=[]), "m.vertices: expected an array of shape"),
    (mesh(vertices=np.zeros((0, 3))), "m.vertices: the mesh is empty"),
    (mesh(faces=np.zeros((0, 3), dtype=int)), "m.faces: the mesh is empty"),
    (mesh(faces=[[0, 1, 3]]), "m.faces: face 0 has the index 3, but there are 3 vertices"),
    (mesh(faces=[[0, 1, 2], [0, -1, 2]]), "m.faces: face 1 has the index -1"),
    (mesh(faces=[[0.0, 1.0, 2.0]]), "m.faces: expected integer indices"),
    (mesh(faces=[[0, 1, 2, 2]]), r"m.faces: expected indices of shape \(F, 3\)"),
    (mesh(vertices=[[0, 0, np.nan]] * 3), "m.vertices: has values that are not finite"),
    (mesh(vertices=[[0, 0]] * 3), "m.vertices: expected an array of shape"),
    (mesh(vertex_normals=[[0, 0, 1]]), r"m.vertex_normals: expected an array of shape \(3, 3\)"),
    (mesh(vertex_texcoords=np.zeros((3, 3))), r"m.vertex_texcoords: expected an array of shape \(3, 2\)"),
    (mesh(attributes={"color": np.zeros((3, 3))}), "begins with 'vertex_' or 'face_'"),
    (mesh(attributes={"vertex_color": np.zeros((4, 3))}), r"vertex_color: expected an array of shape \(3, 1\) or"),
    (mesh(to_world=SINGULAR, vertex_normals=[[0, 0, 1]] * 3), "m.to_world: the matrix is singular"),
    (scene(m={"type": "mesh", "faces": [[0, 1, 2]]}), "m: a mesh needs vertices"),
    (scene(m={"type": "cube", "faces": [[0, 1, 2]]}), "m: cube has no parameter 'faces'"),
    (scene(m={"type": "ply"}), "m: ply: 'filename' is missing"),
    (scene(m={"type": "ply", "filename": "x.ply", "flip_uv": True}), "m: ply has no parameter 'flip_uv'"),
    # cameras and films
    (camera(fov=190), "cam.fov: expected an angle between 0 and 180 degrees, got 190"),
    (camera(fov=40, focal_length="50mm"), "give one of fov, focal_length and x_fov"),
    (camera(focal_length="50 furlongs"), "cam.focal_length: expected a length"),
    (camera(fov_axis="z"), "cam.fov_axis: unknown word 'z'"),
    (camera(near_clip=0.0), "expected 0 < near_clip < far_clip"),
    (camera(near_clip=10.0, far_clip=1.0), "expected 0 < near_clip < far_clip"),
    (camera(to_world=np.diag([2.0, 2, 2, 1])), "cam.to_world: a camera's matrix may turn and move, but not scale"),
    (camera(srf=1.0), "cam.srf: needs wavelengths: a scene of the variant 'spectral', not 'rgb'"),
    (camera(film={"type": "hdrfilm", "width": 0}), "cam.film.width: expected at least 1, got 0"),
    (film(width=2.5), "cam.film.width: expected an integer"),
    (film(hight=10), "cam.film: hdrfilm has no parameter 'hight'; did you mean 'height'"),
    (film(crop_width=800), "is not inside a film of 576 rows and 768 columns"),
    (film(rfilter={"type": "lanczos", "lobes": 0}), "lobes: expected at least 1"),
    (film(rfilter={"type": "gausian"}), "unknown rfilter type 'gausian'; did you mean 'gaussian'"),
    (film(rfilter={"type": "gaussian", "sigma": 1.0}), "gaussian has no parameter 'sigma'"),
    (film(rfilter={"type": "gaussian", "stddev": -1.0}), "stddev: expected a number of pixels"),
    (film(pixel_format="bgr"), "cam.film.pixel_format: unknown word 'bgr'"),
    (camera(film={"type": "specfilm"}), "specfilm: bands need wavelengths"),
    (camera(sampler={"type": "independent", "sample_count": 0}), "sample_count: expected at least 1"),
    (camera(sampler={"type": "independent", "samples": 4}), "independent has no parameter 'samples'"),
    (camera(sampler={"type": "sobol", "jitter": True}), "cam.sampler: sobol has no parameter 'jitter'"),
    (camera(sampler={"type": "stratified", "jitter": 1.0}), "cam.sampler.jitter: expected True or False"),
    (camera(sampler={"type": "sobel"}), "cam.sampler: unknown sampler 'sobel'.*; did you mean 'sobol'"),
    (camera(sampler={"type": ["sobol"]}), "cam.sampler.type: expected a word, got"),
    (camera(sampler={}), "cam.sampler: unknown sampler None"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("description", "message"), [c for c in CASES if c[1]], ids=lambda v: v if isinstance(v, str) else ""
)
def test_scenes(description, message):
    with pytest.raises((ValueError, TypeError), match=message):
        tr.load_dict(description)


def test_none_counts_as_not_given():
    assert float(tr.load_dict(diffuse(None)).a.bsdf.reflectance.value) == 0.5


def test_other_samplers_are_replaced_by_the_nearest():
    for kind, related in (("multijitter", "stratified"), ("orthogonal", "stratified"), ("ldsampler", "sobol")):
        more = {"orthogonal": {"strength": 2, "jitter": True}, "multijitter": {"jitter": False}}.get(kind, {})
        for name in ("sampler", "any"):
            text = rf"cam.{name}: the sampler {kind!r} is not there; {related!r}, the nearest to it"
            with pytest.warns(tr.SubstitutionWarning, match=text):
                scene = tr.load_dict(camera(**{name: {"type": kind, "sample_count": 7, **more}}))
            assert scene.cam.sampler == tr.Sampler(7, related)


def test_texels_out_of_range_are_warned_about():
    with pytest.warns(UserWarning, match=r"a.bsdf.reflectance.data: 1.5 is outside"):
        tr.load_dict(diffuse(BITMAP | {"data": np.full((2, 2, 3), 1.5)}))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"variant": "rgb_polarised"}, "unknown variant 'rgb_polarised'; did you mean 'rgb_polarized'"),
        ({"variant": "rbg"}, "unknown variant 'rbg'; did you mean 'rgb'"),
        ({"dtype": torch.float16}, "dtype: expected torch.float32 or torch.float64"),
        ({"device": "cuda:99"}, "device: PyTorch has no 'cuda:99' here"),
        ({"device": "abacus"}, "device: expected 'cpu' or another device, got 'abacus'"),
    ],
)
def test_settings(settings, message):
    with pytest.raises(ValueError, match=message):
        tr.load_dict({"type": "scene"}, **settings)


@pytest.mark.parametrize("description", [3, "scene", None, ["scene"]])
def test_what_is_no_dict(description):
    with pytest.raises(TypeError, match="expected a nested dict"):
        tr.load_dict(description)
    with pytest.raises(ValueError, match="no 'type'"):
        tr.load_dict({})


@pytest.mark.parametrize("name", ["missing.xml", "missing.ply", "missing.glb"])
def test_missing_files(tmp_path, name):
    with pytest.raises(FileNotFoundError, match=name):
        tr.load_file(tmp_path / name)


@pytest.mark.parametrize(
    "description",
    [
        scene(m={"type": "ply", "filename": "missing.ply"}),
        scene(m={"type": "obj", "filename": "missing.obj"}),
        diffuse({"type": "bitmap", "filename": "missing.png"}),
        scene(e={"type": "envmap", "filename": "missing.exr"}),
    ],
)
def test_missing_files_in_a_scene(description):
    with pytest.raises(FileNotFoundError, match=r"(m|a\.bsdf\.reflectance|e)\.filename: no such file: missing"):
        tr.load_dict(description)


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\nelement vertex 3\n", b"\x00\x01\x02" * 100])
@pytest.mark.parametrize("kind", ["ply", "obj"])
def test_damaged_meshes(tmp_path, content, kind):
    path = tmp_path / f"damaged.{kind}"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"m\.filename: .*damaged"):
        tr.load_dict(scene(m={"type": kind, "filename": str(path)}))


@pytest.mark.parametrize("name", ["t.png", "t.exr", "t.jpg", "t.hdr"])
def test_damaged_images(tmp_path, name):
    (tmp_path / name).write_bytes(b"not an image")
    with pytest.raises(ValueError, match=r"a\.bsdf\.reflectance\.filename: "):
        tr.load_dict(diffuse({"type": "bitmap", "filename": str(tmp_path / name)}))


def test_references_in_a_circle():
    with pytest.raises(ValueError, match="refers to itself"):
        tr.load_dict(
            scene(
                a={"type": "checkerboard", "color0": {"type": "ref", "id": "b"}},
                b={"type": "checkerboard", "color0": {"type": "ref", "id": "a"}},
            )
        )


def test_two_objects_with_one_id():
    with pytest.raises(ValueError, match="two objects have the id 'x'"):
        tr.load_dict(scene(a={"type": "sphere", "id": "x"}, b={"type": "sphere", "id": "x"}))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tr.Diffuse(reflectence=0.5), "Diffuse: diffuse has no parameter 'reflectence'; .*'reflectance'"),
        (lambda: tr.Diffuse(reflectance=1.5), "Diffuse.reflectance.value: 1.5 is outside"),
        (lambda: tr.Mesh(TRIANGLE, [[0, 1, 7]]), "Mesh.faces: face 0 has the index 7"),
        (lambda: tr.Mesh(TRIANGLE), "Mesh: a mesh needs vertices"),
        (lambda: tr.Transform([[1, 2], [3, 4]]), "expected a 4x4 matrix"),
        (lambda: tr.Transform.look_at([0, 0, 0], [0, 0, 0]), "the same point"),
        (lambda: tr.Transform.look_at([0, 0, 0], [0, 1, 0], [0, 1, 0]), "up is parallel"),
        (lambda: tr.Transform.rotate([0, 0, 0], 3), "the axis has no length"),
        (lambda: tr.Transform.scale([1, 2]), "expected three numbers"),
        (lambda: tr.Transform.scale(0).inverse(), "singular"),
        (lambda: tr.PerspectiveCamera.look_at([0, 0, 1], [0, 0, 0], size=(0, 4)), "size: expected at least 1"),
        (lambda: tr.PerspectiveCamera.look_at([0, 0, 1], [0, 0, 0], size=4), r"expected \(height, width\)"),
        (lambda: tr.PerspectiveCamera.from_opencv(torch.eye(3) * 0, torch.eye(3), [0, 0, 1], (4, 4)), "K: needs fx"),
        (lambda: tr.DirectIllumination(shading_samples=2, bsdf_samples=1), "but not both"),
        (lambda: tr.DirectIllumination(emitter_samples=0, bsdf_samples=0), "both 0"),
        (lambda: tr.PathTracer(rr_depth=0), "rr_depth: expected at least 1"),
    ],
)
def test_constructors(call, message):
    with pytest.raises((ValueError, TypeError), match=message):
        call()


def test_parameters_without_names_are_refused_in_words():
    for make, name in ((tr.Diffuse, "Diffuse"), (tr.Bitmap, "Bitmap"), (tr.NormalMap, "NormalMap")):
        with pytest.raises(TypeError, match=f"{name}: parameters are given by name, but 0.5"):
            make(0.5)
