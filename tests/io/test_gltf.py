"""glTF: materials as principled BSDFs, cameras, and the lights of KHR_lights_punctual."""

import base64
import json
import math

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial

import torchrender as tr
from torchrender.loaders.geometry import load_scene
from torchrender.loaders.materials import metallic_roughness
from torchrender.scene import registry

EVERYTHING = dict.fromkeys(("principled", "normalmap", "mask", "diffuse", "twosided"), "bsdf")


def picture(*pixel):
    """Two by two pixels of one colour."""
    return Image.fromarray(np.tile(np.array(pixel, np.uint8), (2, 2, 1)))


def triangle(**more):
    """A glTF document of one triangle, with further members."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes() + np.array([0, 1, 2], "<u4").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(points).decode()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "leaf"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"uri": uri, "byteLength": len(points)}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
    }
    return {**document, **more}


def test_materials_become_principled():
    material = PBRMaterial(
        **{"baseColorFactor": [0.5, 1.0, 1.0, 1.0], "metallicFactor": 0.5, "roughnessFactor": 0.8},
        baseColorTexture=picture(188, 188, 0),
        metallicRoughnessTexture=picture(0, 51, 255),
        normalTexture=picture(128, 51, 255),
        occlusionTexture=picture(1, 1, 1),
    )
    bsdf, lost = metallic_roughness(material, EVERYTHING)
    assert lost == ["occlusionTexture"] and bsdf["type"] == "twosided" and bsdf["bsdf"]["type"] == "normalmap"
    # glTF's second axis points up the picture, as the cross product of normal and first axis does.
    assert torch.allclose(bsdf["bsdf"]["normalmap"]["data"][0, 0], torch.tensor([128 / 255, 0.2, 1.0]))
    inner = bsdf["bsdf"]["bsdf"]
    assert inner["type"] == "principled"
    assert torch.allclose(inner["base_color"]["data"][0, 0], torch.tensor([0.5, 1, 0]) * 0.50289, atol=2e-3)
    assert inner["roughness"]["data"].shape == (2, 2, 1)
    assert torch.allclose(inner["roughness"]["data"], torch.tensor(0.16))  # green: 0.2 * 0.8
    assert torch.allclose(inner["metallic"]["data"], torch.tensor(0.5))  # blue: 1 * 0.5
    plain, lost = metallic_roughness(PBRMaterial(), EVERYTHING)
    assert not lost and plain["bsdf"]["roughness"] == plain["bsdf"]["metallic"] == 1.0  # glTF's defaults


@pytest.mark.parametrize(("mode", "expected"), [("MASK", [0.0, 1.0]), ("BLEND", [51 / 255 * 0.5, 0.5])])
def test_opacity(mode, expected):
    texels = np.array([[[9, 9, 9, 51], [9, 9, 9, 255]]], np.uint8)
    material = PBRMaterial(
        baseColorFactor=[1.0, 1, 1, 0.5], baseColorTexture=Image.fromarray(texels), alphaMode=mode, alphaCutoff=0.3
    )
    bsdf, lost = metallic_roughness(material, EVERYTHING)
    assert not lost and bsdf["type"] == "mask" and bsdf["bsdf"]["type"] == "twosided"
    assert bsdf["opacity"]["data"].flatten().tolist() == pytest.approx(expected, abs=3e-3)
    uniform = metallic_roughness(PBRMaterial(baseColorFactor=[1.0, 1, 1, 0.25], alphaMode="BLEND"), EVERYTHING)[0]
    assert uniform["opacity"] == pytest.approx(0.25, abs=2e-3)


def test_without_principled_it_is_said(monkeypatch):
    monkeypatch.setattr(registry, "scene_types", lambda: {"diffuse": "bsdf", "twosided": "bsdf"})
    box = trimesh.creation.box()
    material = PBRMaterial(name="steel", metallicFactor=1.0, normalTexture=picture(1, 2, 3), alphaMode="BLEND")
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    from torchrender.loaders.geometry import from_trimesh

    with pytest.warns(tr.SubstitutionWarning, match="'steel'.*not used: metallicFactor, normalTexture, alphaMode"):
        scene = from_trimesh(box)
    assert scene["steel"]["bsdf"] == {"type": "diffuse", "reflectance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}


def test_emission_with_a_texture():
    box = trimesh.creation.box()
    material = PBRMaterial(name="lamp", emissiveFactor=[1.0, 0.5, 0.0], emissiveTexture=picture(255, 255, 188))
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    scene = tr.from_trimesh(box)
    shape = next(m for m in scene.children() if getattr(m, "type", "") == "mesh")
    assert torch.allclose(shape.emitter.radiance.data[0, 0], torch.tensor([1.0, 0.5, 0.0]))
    assert "light" not in scene
    material.emissiveTexture = picture(0, 0, 0)
    assert "light" in tr.from_trimesh(box)


def test_cameras_and_lights(tmp_path):
    half = math.sqrt(0.5)
    lights = [
        {"type": "point", "color": [1, 0.5, 0], "intensity": 8},
        {"type": "directional", "name": "sun", "intensity": 3},
        {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.2}},
        {"type": "area", "name": "panel"},
    ]
    extension = "KHR_lights_punctual"
    nodes = [
        {"mesh": 0, "name": "leaf", "children": [1, 2]},
        {"camera": 0, "translation": [0, 0, 5], "scale": [2, 2, 2]},
        {"translation": [1, 2, 3], "rotation": [0, half, 0, half], "children": [3, 4, 5, 7]},  # -z turns to -x
        {"extensions": {extension: {"light": 0}}, "translation": [0, 0, -1]},
        {"extensions": {extension: {"light": 1}}},
        {"extensions": {extension: {"light": 2}}},
        {"camera": 1, "matrix": np.eye(4).flatten().tolist()},
        {"extensions": {extension: {"light": 3}}},
    ]
    lens = {"yfov": 0.5, "aspectRatio": 2.0, "znear": 0.25, "zfar": 50.0}
    document = triangle(
        nodes=nodes,
        scenes=[{"nodes": [0, 6]}],
        cameras=[{"type": "perspective", "perspective": p} for p in (lens, {"yfov": 1.0, "znear": 1})],
        extensions={extension: {"lights": lights}},
        extensionsUsed=[extension],
    )
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    with pytest.warns(tr.SubstitutionWarning, match="'panel': 'area' is not supported and was left out"):
        scene = load_scene(tmp_path / "a.gltf")
    camera = scene["sensor"]
    assert camera["fov"] == pytest.approx(math.degrees(0.5)) and camera["fov_axis"] == "y"
    assert (camera["film"]["width"], camera["film"]["height"]) == (1024, 512) and camera["near_clip"] == 0.25
    # It stands at z = 5 and looks along -z, x to the right: our z axis is the view, our x axis its left.
    assert np.allclose(camera["to_world"], [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 5], [0, 0, 0, 1]])
    assert scene["sensor_1"]["film"]["width"] == 512
    assert np.allclose(scene["light"]["position"], [0, 2, 3]) and scene["light"]["intensity"]["value"] == [8, 4, 0]
    assert np.allclose(scene["light_1"]["direction"], [-1, 0, 0])
    assert scene["light_1"]["irradiance"]["value"] == [3, 3, 3]
    spot = scene["light_2"]
    assert np.allclose(spot["to_world"][:3, 2], [-1, 0, 0]) and np.allclose(spot["to_world"][:3, 3], [1, 2, 3])
    assert (spot["cutoff_angle"], spot["beam_width"]) == pytest.approx((math.degrees(0.2), math.degrees(0.1)))
    built = tr.load_dict(scene)
    assert torch.allclose(built["light_1"].direction, torch.tensor([-1.0, 0.0, 0.0]), atol=1e-6)
    assert float(built["light_2"].beam_width) == pytest.approx(math.degrees(0.1))


def test_orthographic_camera(tmp_path):
    """It sees xmag to either side and ymag up and down, twice as wide as high here."""
    document = triangle(
        nodes=[{"mesh": 0}, {"camera": 0, "translation": [5, 6, 7], "scale": [3, 3, 3]}],
        scenes=[{"nodes": [0, 1]}],
        cameras=[{"type": "orthographic", "orthographic": {"xmag": 4.0, "ymag": 2.0, "znear": 0.5, "zfar": 9.0}}],
    )
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    camera = tr.load_file(tmp_path / "a.gltf").sensors[0]
    assert isinstance(camera, tr.OrthographicCamera) and (camera.film.width, camera.film.height) == (1024, 512)
    assert (float(camera.near_clip), float(camera.far_clip)) == (0.5, 9.0)
    rays = camera.rays(torch.tensor([[0.0, 0.0], [1024.0, 512.0]]))  # the upper left corner, and the other one
    torch.testing.assert_close(rays.origins[:, :2], torch.tensor([[1.0, 8.0], [9.0, 4.0]]))
    torch.testing.assert_close(rays.directions, torch.tensor([[0.0, 0.0, -1.0]] * 2))


@pytest.mark.parametrize("kind", ["point", "spot", "directional"])
def test_loads_and_renders(tmp_path, kind):
    extension = "KHR_lights_punctual"
    nodes = [{"mesh": 0}, {"extensions": {extension: {"light": 0}}, "translation": [0.3, 0.3, 1]}]
    nodes.append({"camera": 0, "translation": [0.3, 0.3, 4]})
    document = triangle(
        nodes=nodes,
        scenes=[{"nodes": [0, 1, 2]}],
        cameras=[{"type": "perspective", "perspective": {"yfov": 0.3, "znear": 0.1}}],
        extensions={extension: {"lights": [{"type": kind, "intensity": 2, "spot": {"innerConeAngle": 0.5}}]}},
    )
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    scene = tr.load_file(tmp_path / "a.gltf")
    image = tr.render(scene, spp=4, seed=0, crop=(240, 240, 32, 32))
    # Grey 0.5 under a light of 2 W/sr one unit above, or 2 W/m^2, seen near the foot: 0.5 / pi * 2, at most 3 % less
    # aside.
    assert torch.allclose(image, torch.tensor(1 / math.pi), rtol=0.03)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"nodes": [{"children": [0], "mesh": 0}]}, "no tree|damaged"),
        ({"nodes": [{"mesh": 0, "children": [1]}, {"camera": 7}]}, "damaged"),
        ({"accessors": [{"componentType": 5126, "count": 10**12, "type": "VEC3"}]}, "cannot hold"),
        ({"scenes": [{"nodes": ["a"]}]}, "damaged"),
        ({"scenes": 5}, "damaged"),
    ],
)
def test_documents_that_are_refused(tmp_path, change, message):
    (tmp_path / "a.gltf").write_text(json.dumps(triangle(**change)))
    with pytest.raises(ValueError, match=rf"a\.gltf.*({message})"):
        load_scene(tmp_path / "a.gltf")


def test_files_elsewhere_are_not_read(tmp_path):
    """Buffers and pictures come from the folder of the file and below."""
    (tmp_path / "secret.bin").write_bytes(bytes(48))
    (tmp_path / "scene").mkdir()
    document = triangle()
    document["buffers"] = [{"uri": "../secret.bin", "byteLength": 48}]
    (tmp_path / "scene" / "a.gltf").write_text(json.dumps(document))
    with pytest.raises((ValueError, OSError), match=r"a\.gltf"):
        load_scene(tmp_path / "scene" / "a.gltf")
