"""Scenes saved as XML: what is loaded again renders the same bits."""

import xml.etree.ElementTree as ElementTree

import light_scenes
import media_scenes
import numpy as np
import pytest
import reference_scenes
import torch
from oracle.scenes import SCENES as ORACLE_SCENES

import torchrender as tr

CASES = {
    **{f"reference-{name}": lambda make=make: make().scene for name, make in reference_scenes.SCENES.items()},
    **{f"media-{name}": lambda make=make: make().scene for name, make in media_scenes.SCENES.items()},
    **{f"oracle-{name}": make for name, make in ORACLE_SCENES.items()},
}


def image_of(scene, sensor=0, **settings):
    with torch.no_grad():
        return tr.render(scene, sensor=sensor, spp=1, seed=3, **settings)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", CASES)
def test_images_are_the_same_bits(tmp_path, name):
    scene = tr.load_dict(CASES[name]())
    scene.save(tmp_path / "folder" / "scene.xml")
    again = tr.load_file(tmp_path / "folder" / "scene.xml")
    assert list(again) == list(scene)
    for i in range(len(scene.sensors)):
        assert torch.equal(image_of(again, i), image_of(scene, i))
    ours, theirs = dict(scene.named_parameters()), dict(again.named_parameters())
    flat = {n for n in set(ours) - set(theirs) if n.endswith(".vertex_normals")}  # of meshes that are shaded flat
    assert set(ours) - flat == set(theirs)
    for key, value in theirs.items():
        assert torch.equal(value, ours[key]), key


def test_edited_and_shared_objects(tmp_path):
    """Values that are no short decimals, objects held twice, names that need care, settings off their defaults."""
    shared = tr.Diffuse(reflectance=torch.rand(3, generator=torch.Generator().manual_seed(1)))
    scene = tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct", "emitter_samples": 2, "bsdf_samples": 1, "hide_emitters": True},
            "cam <1>": {
                **{"type": "perspective", "fov": 33.3, "principal_point_offset_x": 0.1},
                "film": tr.Film(12, 10, crop=(1, 2, 7, 8), filter=tr.ReconstructionFilter("tent", radius=1.5)),
                "sampler": {"type": "stratified", "sample_count": 9},
                "to_world": tr.Transform.look_at([0, 1, 5], [0, 0, 0], [0, 1, 0]),
            },
            "train": {"type": "sphere", "bsdf": {"type": "twosided", "x": shared}, "radius": 1 / 3},
            "b": {"type": "rectangle", "bsdf": shared, "flip_normals": True},
            "light": {"type": "point", "position": [0.1, 2.7, 3.3], "intensity": 7.0, "sampling_weight": 0.3},
        }
    )
    mesh = tr.Mesh(
        vertices=torch.rand(5, 3, generator=torch.Generator().manual_seed(2)) - 0.5,
        faces=[[0, 1, 2], [2, 3, 4], [0, 2, 4]],
        vertex_texcoords=torch.rand(5, 2),
        attributes={
            **{"vertex_color": torch.rand(5, 3), "face_heat_x": torch.rand(3, 1), "vertex_my_color": torch.rand(5, 1)},
            "vertex_flow": torch.rand(5, 3),
        },
        bsdf=tr.Diffuse(reflectance={"type": "mesh_attribute", "name": "vertex_color", "scale": 0.7}),
    )
    mesh.compute_normals()
    scene["a mesh/<x>"] = mesh
    with torch.no_grad():
        for parameter in (scene["train"].radius, scene.b.to_world, mesh.vertex_positions):
            parameter.mul_(1.1).add_(torch.rand(parameter.shape) * 1e-3)
        scene.b.to_world[3] = torch.tensor([0.0, 0, 0, 1])
    image = image_of(scene)
    scene.save(tmp_path / "two.xml")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["meshes", "two.xml"]
    again = tr.load_file(tmp_path / "two.xml")
    assert torch.equal(image_of(again), image) and image.shape == (7, 8, 3) and float(image.std()) > 0
    assert again["train"].bsdf.brdf_0 is again.b.bsdf and again.sensors[0].sampler == tr.Sampler(9, "stratified")
    loaded = again["a mesh/<x>"]
    assert loaded.computed_normals and set(loaded.attribute_names) == set(mesh.attribute_names)
    for name in mesh.attribute_names:
        assert torch.equal(getattr(loaded, name), getattr(mesh, name))
    assert "train_" in {e.get("id") for e in ElementTree.parse(tmp_path / "two.xml").getroot()}


def beams(**objects):
    """Light tracing onto a floor that measures it."""
    beam = {"type": "directionalarea", "radiance": {"type": "rgb", "value": [1.0, 2.0, 3.0]}}
    down = tr.Transform.translate([0, 2, 0]).rotate([1, 0, 0], 90)
    return light_scenes.metered(
        lamp={"type": "rectangle", "to_world": down, "emitter": beam},
        lens={"type": "heightfield", "heights": np.random.default_rng(1).uniform(0, 0.1, (5, 4))},
        integrator={"type": "ptracer", "max_depth": 4},
        **objects,
    )


@pytest.mark.parametrize("camera", [False, True])
def test_light_tracing(tmp_path, camera):
    scene = tr.load_dict(beams(**({"camera": light_scenes.camera()} if camera else {})))
    scene.save(tmp_path / "scene.xml")
    again = tr.load_file(tmp_path / "scene.xml")
    assert list(again) == list(scene) and again.integrator.kind == "ptracer"
    # Without a camera the meter is where Mitsuba wants it, inside of its shape.
    assert ('<sensor type="irradiancemeter" name=' in (tmp_path / "scene.xml").read_text()) is not camera
    for i in range(len(scene.sensors)):
        image = image_of(scene, i)
        assert torch.equal(image_of(again, i), image) and float(image.std()) > 0


@pytest.mark.parametrize("settings", [{"dtype": torch.float64}, {"variant": "mono"}])
def test_other_variants(tmp_path, settings):
    scene = tr.load_dict(reference_scenes.SCENES["mesh"]().scene, **settings)
    scene.save(tmp_path / "scene.xml")
    again = tr.load_file(tmp_path / "scene.xml", **settings)
    assert torch.equal(image_of(again), image_of(scene))
    for (name, ours), (_, theirs) in zip(scene.named_parameters(), again.named_parameters(), strict=True):
        assert torch.equal(ours.reshape(theirs.shape), theirs), name


def test_a_failure_leaves_the_old_file(tmp_path, monkeypatch):
    scene = tr.load_dict({"type": "scene", "a": {"type": "sphere", "bsdf": {"type": "diffuse"}}})
    scene.save(tmp_path / "a.xml")
    before = (tmp_path / "a.xml").read_text()
    scene["b"] = tr.Rectangle(emitter={"type": "area", "radiance": np.ones((2, 2, 3))})

    def fail(*_, **__):
        raise OSError("the disk is full")

    monkeypatch.setattr("torchrender.io.write_image", fail)
    with pytest.raises(OSError, match="disk is full"):
        scene.save(tmp_path / "a.xml")
    assert (tmp_path / "a.xml").read_text() == before
    with pytest.raises(ValueError, match=r"ends in \.xml"):
        scene.save(tmp_path / "a.obj")
