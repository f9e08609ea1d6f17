"""Messages that name what was meant; cameras by name, sizes, files that are read and those that are not."""

import warnings

import numpy as np
import pytest
import torch
from first_scene import make

import torchrender as tr


def test_cameras_go_by_their_names():
    scene = make(second={"type": "perspective", "film": {"type": "hdrfilm", "width": 12, "height": 8}})
    scene.second.to_world = tr.Transform.look_at([3, 0, 0], [0, 0, 0])
    by_index = tr.render(scene, spp=1, seed=0, sensor=[1, 0])
    assert torch.equal(tr.render(scene, spp=1, seed=0, sensor=["second", "camera"]), by_index)
    assert torch.equal(tr.render(scene, spp=1, seed=0, sensor="second"), by_index[0])


@pytest.mark.parametrize("integrator", [None, "ptracer", tr.WavefrontPathTracer(), {"type": "aov", "aovs": "d:depth"}])
def test_size_of_a_rendering(integrator):
    scene, other = make(), make()
    other.camera.film = tr.Film(9, 5)
    outputs = ("rgb", "depth", "duv_dx") if integrator is None else None
    mine = tr.render(scene, spp=2, seed=0, size=(5, np.int64(9)), integrator=integrator, outputs=outputs)
    expected = tr.render(other, spp=2, seed=0, integrator=integrator, outputs=outputs)
    for a, b in zip(mine, expected, strict=True):
        assert torch.equal(a, b)
    assert scene.camera.film.width == 12


def test_size_makes_films_alike():
    scene = make(second={"type": "perspective", "film": {"type": "hdrfilm", "width": 5, "height": 5}})
    with pytest.raises(ValueError, match=r"films of one size are needed.*size=\(H, W\) gives them one"):
        tr.render(scene, spp=1, sensor=[0, 1])
    assert tr.render(scene, spp=1, sensor=[0, 1], size=(3, 4)).shape == (2, 3, 4, 3)
    for size, text in ((7, "expected \\(height, width\\)"), ((0, 3), "at least 1"), ((2.5, 3), "an integer")):
        with pytest.raises(ValueError, match=f"render: size: {text}|render: size: expected {text}"):
            tr.render(scene, spp=1, size=size)


def test_images_of_other_layouts_are_recognised(tmp_path):
    image = torch.rand(3, 8, 12)
    for ending in ("png", "exr", "hdr", "pfm"):
        with pytest.raises(ValueError, match=r"looks like \(C, H, W\): use image.movedim\(0, -1\)"):
            tr.io.write_image(tmp_path / f"a.{ending}", image)
        with pytest.raises(ValueError, match="which is a batch: write one image at a time"):
            tr.io.write_image(tmp_path / f"a.{ending}", image[None])


@pytest.mark.parametrize("ending", ["fbx", "usda", "blend"])
def test_files_that_nobody_reads(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    path.write_bytes(b"something")
    with pytest.raises(ValueError, match=rf"files that end in '.{ending}' are not supported; convert it to glTF"):
        tr.load_file(path)


def test_parameters_of_files_are_listed(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text(
        '<scene version="3.0.0"><default name="resolution" value="8"/><sensor type="perspective">'
        '<film type="hdrfilm"><integer name="width" value="$resolution"/></film></sensor></scene>'
    )
    with pytest.raises(ValueError, match=r"no parameter \$size; known here: resolution"):
        tr.load_file(path, size=64)


def test_gradients_that_do_not_exist_point_to_train_only():
    scene = make()
    scene.requires_grad_()
    with pytest.raises(tr.NotDifferentiableError, match=r"train_only\(PATTERN, ...\)"):
        tr.render(scene, spp=1)


@pytest.mark.parametrize("ending", ["bmp", "tga"])
def test_textures_of_old_formats(tmp_path, ending):
    image = pytest.importorskip("PIL.Image")
    values = (torch.rand(5, 4, 3, generator=torch.Generator().manual_seed(0)) * 255).to(torch.uint8)
    image.fromarray(values.numpy()).save(tmp_path / f"a.{ending}")
    assert torch.equal(tr.io.read_image(tmp_path / f"a.{ending}", raw=True), values / 255)
    texture = {"type": "bitmap", "filename": str(tmp_path / f"a.{ending}"), "raw": True}
    scene = make(ball={"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": texture}})
    assert torch.equal(scene.ball.bsdf.reflectance.data, values / 255)


def test_films_and_samplers_of_the_top_level(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text(
        """<scene version="3.0.0">
        <film type="hdrfilm" id="f"><integer name="width" value="7"/><integer name="height" value="5"/>
          <boolean name="banner" value="false"/></film>
        <sampler type="sobol" id="s"><integer name="sample_count" value="3"/></sampler>
        <sensor type="perspective" id="one"><ref id="f"/><ref id="s"/></sensor>
        <sensor type="perspective" id="two"><ref name="film" id="f"/></sensor>
        <emitter type="constant"/></scene>"""
    )
    scene = tr.load_file(path)
    assert [(s.film.width, s.film.height) for s in scene.sensors] == [(7, 5), (7, 5)]
    assert scene.one.sampler == tr.Sampler(3, "sobol") and scene.two.sampler is None
    with pytest.raises(ValueError, match=r"f: a film \(hdrfilm\) belongs into a sensor"):
        make(f={"type": "hdrfilm"})


def test_renderers_choose_what_is_trained():
    renderer = tr.Renderer(make(), train="*.reflectance.*", spp=1)
    assert [n for n, p in renderer.named_parameters() if p.requires_grad] == ["scene.ball.bsdf.reflectance.value"]
    renderer().sum().backward()
    tr.Renderer(renderer.scene, train=("sky.radiance.value",))
    assert [n for n, p in renderer.named_parameters() if p.requires_grad] == ["scene.sky.radiance.value"]
    with pytest.raises(ValueError, match="no parameter matches 'nothing'"):
        tr.Renderer(renderer.scene, train="nothing")


def test_materials_of_obj_files_are_not_lost_in_silence(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 1 0 0\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl red\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    shape = {"type": "obj", "filename": str(tmp_path / "a.obj")}
    with pytest.warns(UserWarning, match=r"mesh: a shape of type obj has no materials but .* a.obj are left out"):
        make(mesh=shape)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make(mesh={**shape, "bsdf": {"type": "diffuse"}})
        make(red={"type": "diffuse"}, mesh={**shape, "bsdf": {"type": "ref", "id": "red"}})
        (tmp_path / "a.mtl").unlink()
        make(mesh=shape)
