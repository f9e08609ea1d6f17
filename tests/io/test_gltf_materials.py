"""glTF: extensions of materials, how textures are looked up, colours of vertices, and files that would be misread."""

import base64
import io
import json
import math
import struct
import warnings

import numpy as np
import pytest
import torch
from PIL import Image

import torchrender as tr
from torchrender.loaders.geometry import load_scene
from torchrender.loaders.gltf_materials import Entry

pytestmark = pytest.mark.core

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], "<f4")  # the picture upright: v runs downwards
COLOURS = np.array([[0, 0, 65535], [65535, 0, 0], [0, 32768, 0], [65535] * 3], "<u2")
# Two by two pixels of different colours.
PIXELS = np.array([[[255, 0, 0, 255], [0, 255, 0, 128]], [[0, 0, 255, 0], [255, 255, 255, 255]]], np.uint8)


def uri(data: bytes, kind: str = "application/octet-stream") -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def square(materials, colours=False, **more):
    """A document of one square for each material."""
    parts = [POINTS.tobytes(), UV.tobytes(), np.array([0, 1, 2, 0, 2, 3], "<u4").tobytes(), COLOURS.tobytes()]
    kinds = [(5126, 4, "VEC3"), (5126, 4, "VEC2"), (5125, 6, "SCALAR"), (5123, 4, "VEC3")]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    png = io.BytesIO()
    Image.fromarray(PIXELS).save(png, "PNG")
    attributes = {"POSITION": 0, "TEXCOORD_0": 1, **({"COLOR_0": 3} if colours else {})}
    return {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": list(range(len(materials)))}],
        "nodes": [{"mesh": i, "name": f"m{i}"} for i in range(len(materials))],
        "meshes": [
            {"primitives": [{"attributes": attributes, "indices": 2, "material": i}]} for i in range(len(materials))
        ],
        "materials": materials,
        "textures": [{"source": 0, "sampler": 0}, {"source": 0}],
        "samplers": [{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}],
        "images": [{"uri": uri(png.getvalue(), "image/png")}],
        "buffers": [{"uri": uri(b"".join(parts)), "byteLength": starts[-1]}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(part)}
            for start, part in zip(starts, parts, strict=False)
        ],
        "accessors": [
            {"bufferView": i, "componentType": kind, "count": count, "type": shape, "normalized": i == 3}
            for i, (kind, count, shape) in enumerate(kinds)
        ],
        **more,
    }  # fmt: skip


def load(path, *materials, binary=False, **more):
    """The scene's dict and the texts of its warnings."""
    content = json.dumps(square(list(materials), **more)).encode()
    path = path / ("a.glb" if binary else "a.gltf")
    if binary:
        content += b" " * (-len(content) % 4)
        content = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(content), len(content), b"JSON") + content
    path.write_bytes(content)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", tr.SubstitutionWarning)
        scene = load_scene(path)
    tr.load_dict(scene)  # it can be built
    return scene, [str(w.message) for w in caught if issubclass(w.category, tr.SubstitutionWarning)]


def material(pbr=None, **extensions):
    named = {f"KHR_materials_{name}": value for name, value in extensions.items()}
    return {"name": "thing", "pbrMetallicRoughness": pbr or {"metallicFactor": 0.0}, "extensions": named}


def bsdf_of(scene, index=0):
    return scene[scene[f"m{index}"]["bsdf"]["id"]]


@pytest.mark.parametrize("binary", [False, True])
def test_each_mesh_has_its_own_material(tmp_path, binary):
    """Materials of one name, of none, and their exact colours, which trimesh rounds to bytes."""
    colours = [[0.123456, 0.5, 0.25, 1.0], [0.7, 0.6, 0.5, 1.0], [0.2, 0.3, 0.4, 1.0]]
    materials = [{"name": "same", "pbrMetallicRoughness": {"baseColorFactor": c}} for c in colours]
    del materials[2]["name"]
    scene, said = load(tmp_path, *materials, binary=binary)
    assert not said and {"same", "same_1", "material"} <= set(scene)
    for i, colour in enumerate(colours):
        assert bsdf_of(scene, i)["bsdf"]["base_color"]["value"] == pytest.approx(colour[:3], abs=1e-12)


def test_ior_specular_coat_and_sheen(tmp_path):
    scene, said = load(
        tmp_path,
        material(ior={"ior": 1.8}),
        material(ior={"ior": 1.8}, specular={"specularFactor": 0.25}),
        material(specular={"specularFactor": 0.0}),
        material(clearcoat={"clearcoatFactor": 0.7, "clearcoatRoughnessFactor": 0.2}),
        material(sheen={"sheenColorFactor": [0.4, 0.4, 0.4]}),
    )
    assert not said
    inner = [bsdf_of(scene, i)["bsdf"] for i in range(5)]
    assert {b["type"] for b in inner} == {"principled"}
    assert inner[0]["eta"] == pytest.approx(1.8)
    f0 = ((inner[1]["eta"] - 1) / (inner[1]["eta"] + 1)) ** 2
    assert f0 == pytest.approx(0.25 * (0.8 / 2.8) ** 2) and inner[2]["eta"] == 1
    # alpha of the coat is 0.1 + gloss (0.001 - 0.1), here 0.2 squared
    assert inner[3]["clearcoat"] == 0.7 and 0.1 - 0.099 * inner[3]["clearcoat_gloss"] == pytest.approx(0.04)
    assert inner[4]["sheen"] == pytest.approx(0.4)


def test_anisotropy(tmp_path):
    """The two alphas of the extension: that across u is the square of the roughness."""
    scene, said = load(
        tmp_path,
        material({"roughnessFactor": 0.6, "metallicFactor": 0}, anisotropy={"anisotropyStrength": 0.5}),
        material(
            {"roughnessFactor": 0.6, "metallicFactor": 0},
            anisotropy={"anisotropyStrength": 0.5},
            transmission={"transmissionFactor": 1},
        ),
        material({"metallicRoughnessTexture": {"index": 1}}, anisotropy={"anisotropyStrength": 0.5}),
    )
    inner = [bsdf_of(scene, 0)["bsdf"], bsdf_of(scene, 1)]
    for bsdf in inner:
        aspect = math.sqrt(1 - 0.9 * bsdf["anisotropic"])
        assert bsdf["roughness"] ** 2 * aspect == pytest.approx(0.36)
        assert bsdf["roughness"] ** 2 / aspect == pytest.approx(0.36 + 0.64 * 0.25)
    assert "anisotropic" not in bsdf_of(scene, 2)["bsdf"]
    assert len(said) == 1 and said[0].endswith("not used: anisotropy beside a texture of roughness")


def test_transmission(tmp_path):
    """Through a sheet, or through a body if the material has a thickness."""
    clear = {"transmissionFactor": 0.9}
    scene, said = load(
        tmp_path,
        material(transmission=clear, ior={"ior": 1.45}),
        material(transmission=clear, volume={"thicknessFactor": 1.0, "attenuationColor": [1, 0, 0]}),
        material({"metallicFactor": 0.5}, transmission=clear),
        material(transmission={}),
    )
    sheet, body, metal, none = (bsdf_of(scene, i) for i in range(4))
    assert sheet["type"] == "principledthin" and sheet["spec_trans"] == 0.9 and sheet["eta"] == pytest.approx(1.45)
    assert body["type"] == "principled" and body["spec_trans"] == 0.9
    assert metal["type"] == "principledthin" and none["type"] == "twosided"
    assert sorted(text.partition("becomes ")[2] for text in said) == [
        "principled; not used: volume.attenuationColor",
        "principledthin; not used: metallic beside transmission",
    ]


def test_emission_and_unlit(tmp_path):
    lamp = {**material(emissive_strength={"emissiveStrength": 8.0}), "emissiveFactor": [1.0, 0.5, 0.0]}
    flat = material({"baseColorFactor": [0.2, 0.4, 0.6, 1]}, unlit={})
    scene, said = load(tmp_path, lamp, flat)
    assert not said and "light" not in scene
    assert scene["m0"]["emitter"]["radiance"]["value"] == [8.0, 4.0, 0.0]
    assert scene["m1"]["emitter"]["radiance"]["value"] == pytest.approx([0.2, 0.4, 0.6])
    built = tr.load_dict(scene)
    camera = tr.PerspectiveCamera.look_at([0.5, 0.5, 3], [0.5, 0.5, 0], fov=10, size=(2, 2))
    del built["m0"]
    assert torch.allclose(tr.render(built, sensor=camera, spp=4, seed=0), torch.tensor([0.2, 0.4, 0.6]), rtol=1e-4)


def test_what_is_not_used_is_said(tmp_path):
    _, said = load(
        tmp_path,
        material(
            iridescence={"iridescenceFactor": 0.5},
            anisotropy={"anisotropyStrength": 0.5, "anisotropyRotation": 0.3, "anisotropyTexture": {"index": 0}},
            clearcoat={"clearcoatFactor": 1, "clearcoatTexture": {"index": 0}, "clearcoatNormalTexture": {"index": 0}},
            sheen={"sheenColorFactor": [1, 0, 0], "sheenRoughnessFactor": 0.3},
            specular={"specularColorFactor": [1, 0, 0]},
        ),
    )
    assert len(said) == 1 and said[0].endswith(
        "a.gltf: 'thing' becomes twosided; not used: specular.specularColor, clearcoat.clearcoatTexture, "
        "clearcoat.clearcoatNormalTexture, sheen.sheenColorFactor (hue), sheen.sheenRoughnessFactor, "
        "anisotropy.anisotropyRotation, anisotropy.anisotropyTexture, KHR_materials_iridescence"
    )


def test_textures_are_looked_up_as_the_sampler_says(tmp_path):
    pbr = {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}, "metallicFactor": 0.5}
    scene, said = load(tmp_path, {**material(pbr), "alphaMode": "BLEND", "normalTexture": {"index": 0, "scale": 2.0}})
    mask = bsdf_of(scene)
    normals = mask["bsdf"]["bsdf"]["normalmap"]
    base = mask["bsdf"]["bsdf"]["bsdf"]["base_color"]
    for bitmap in (mask["opacity"], normals, base):
        assert bitmap["wrap_mode"] == "clamp" and bitmap["filter_type"] == "nearest"
    assert "wrap_mode" not in mask["bsdf"]["bsdf"]["bsdf"]["roughness"]
    assert "baseColorTexture.wrapT" in said[0] and "normalTexture.wrapT" in said[0]
    # twice as steep: red is (1, -1, -1) of the stored normal, scaled by (1, 1, 1/2)
    assert torch.allclose(normals["data"][0, 0], torch.tensor([1.0, 0.0, 0.25]))


def image_of(tmp_path, transform):
    """What a camera sees of the middles of the picture's four pixels, through unlit material."""
    texture = {"index": 1, "extensions": {"KHR_texture_transform": transform}}
    scene, said = load(tmp_path, material({"baseColorTexture": texture}, unlit={}))
    assert not said
    emission = scene["m0"]["emitter"]["radiance"] = {**scene["m0"]["emitter"]["radiance"], "filter_type": "nearest"}
    assert emission["data"].shape == (2, 2, 3)
    fov = 2 * math.degrees(math.atan(0.05))
    camera = tr.PerspectiveCamera.look_at([0.5, 0.5, 10], [0.5, 0.5, 0], fov=fov, size=(2, 2), filter="box")
    return tr.render(tr.load_dict(scene), sensor=camera, spp=4, seed=0)


@pytest.mark.parametrize(
    ("transform", "expected"),
    [
        ({}, "rgbw"),
        ({"offset": [0.5, 0]}, "grwb"),
        ({"offset": [0, 0.5]}, "bwrg"),
        ({"scale": [0.5, 0.5]}, "rrrr"),
        ({"scale": [0.5, 0.5], "offset": [0.5, 0.0]}, "gggg"),
        # the extension's example: "only the lower left quadrant of the source image, rotated clockwise 90 degrees"
        ({"offset": [0, 1], "rotation": math.pi / 2, "scale": [0.5, 0.5]}, "bbbb"),
        # and the whole picture, turned the same way
        ({"offset": [0, 1], "rotation": math.pi / 2}, "brwg"),
        ({"offset": [0, 1], "scale": [1, -1]}, "bwrg"),
    ],
)
def test_texture_transform(tmp_path, transform, expected):
    colours = {"r": [1.0, 0, 0], "g": [0, 1.0, 0], "b": [0, 0, 1.0], "w": [1.0, 1, 1]}
    seen = image_of(tmp_path, transform)
    assert torch.allclose(seen.reshape(4, 3), torch.tensor([colours[c] for c in expected]), atol=1e-4)


def test_colours_of_vertices_are_factors_of_the_base_colour(tmp_path):
    half = {"baseColorFactor": [0.5, 1.0, 1.0, 1.0]}
    textured = {"baseColorTexture": {"index": 1}}
    scene, said = load(tmp_path, material(half), material(textured), colours=True)
    assert bsdf_of(scene)["bsdf"]["base_color"] == {"type": "mesh_attribute", "name": "vertex_color"}
    expected = torch.from_numpy(COLOURS.astype(np.float64) / 65535) * torch.tensor([0.5, 1, 1])
    torch.testing.assert_close(scene["m0"]["attributes"]["vertex_color"], expected)
    assert bsdf_of(scene, 1)["bsdf"]["base_color"]["type"] == "bitmap" and "attributes" not in scene["m1"]
    assert len(said) == 1 and "not used: COLOR_0" in said[0]


def test_files_that_would_be_misread_are_refused(tmp_path):
    def refused(message, change):
        document = square([material()])
        change(document)
        (tmp_path / "a.gltf").write_text(json.dumps(document))
        with pytest.raises(ValueError, match=message):
            load_scene(tmp_path / "a.gltf")

    draco = {"extensionsRequired": ["KHR_draco_mesh_compression", "KHR_materials_ior"]}
    refused(r"needs the extensions KHR_draco_mesh_compression, which are not", lambda d: d.update(draco))
    refused("damaged", lambda d: d["accessors"][0].update(sparse={"count": 10**12}))
    refused("damaged", lambda d: d["accessors"][1].update(componentType=5122, count=10**6))
    refused("damaged", lambda d: d["materials"][0]["pbrMetallicRoughness"].update(baseColorTexture={"index": 7}))


def test_images_that_cannot_be_read(tmp_path):
    images = {"images": [{"uri": "nowhere.png"}]}
    _, said = load(tmp_path, {**material({"baseColorTexture": {"index": 1}}), "normalTexture": {"index": 1}}, **images)
    assert len(said) == 1 and "normalTexture (it cannot be read), baseColorTexture (it cannot be read)" in said[0]


@pytest.mark.parametrize("binary", [False, True])
def test_arrays_of_integers_and_sparse_arrays(tmp_path, binary):
    """Positions as bytes that stand for themselves, coordinates and normals as fractions, one corner moved."""
    parts = {
        "POSITION": (np.pad(POINTS * 10, ((0, 0), (0, 1))).astype("<i1"), 5120, "VEC3", False),  # rows of four bytes
        "TEXCOORD_0": ((UV * 65535).astype("<u2"), 5123, "VEC2", True),
        "NORMAL": (np.array([[0, 0, 127, 0]] * 4, "<i1"), 5120, "VEC3", True),
        "indices": (np.array([0, 1, 2, 0, 2, 3], "<u2"), 5123, "SCALAR", False),
        "where": (np.array([2], "<u2"), 5123, "SCALAR", False),
        "what": (np.array([[20, 30, -5]], "<i1"), 5120, "VEC3", False),
    }
    content, views, accessors = b"", [], []
    for data, kind, shape, normalized in parts.values():
        views.append({"buffer": 0, "byteOffset": len(content), "byteLength": data.nbytes})
        if data.itemsize == 1 and len(data) > 1:
            views[-1]["byteStride"] = 4
        accessors.append({"bufferView": len(accessors), "componentType": kind, "count": data.size if shape == "SCALAR"
                          else len(data), "type": shape, "normalized": normalized})  # fmt: skip
        content += data.tobytes() + b"\0" * (-data.nbytes % 4)
    accessors[0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": 4, "componentType": 5123},
        "values": {"bufferView": 5},
    }
    document = square([material()], bufferViews=views, accessors=accessors)
    document["extensionsRequired"] = ["KHR_mesh_quantization"]
    document["meshes"][0]["primitives"][0] = {
        "attributes": {"POSITION": 0, "TEXCOORD_0": 1, "NORMAL": 2}, "indices": 3, "material": 0
    }  # fmt: skip
    path = tmp_path / ("a.glb" if binary else "a.gltf")
    document["buffers"] = [{"byteLength": len(content)} if binary else {"uri": "a.bin", "byteLength": len(content)}]
    (tmp_path / "a.bin").write_bytes(content)
    text = json.dumps(document).encode()
    if binary:
        text += b" " * (-len(text) % 4)
        rest = struct.pack("<I4s", len(content), b"BIN\0") + content
        text = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest
    path.write_bytes(text)
    shape = load_scene(path)["m0"]
    expected = torch.from_numpy(POINTS).double() * 10
    expected[2] = torch.tensor([20.0, 30.0, -5.0])
    torch.testing.assert_close(shape["vertices"].double(), expected)
    torch.testing.assert_close(shape["vertex_texcoords"].double(), torch.from_numpy(UV).double())
    torch.testing.assert_close(shape["vertex_normals"], torch.tensor([[0.0, 0, 1]] * 4).double())


def test_index_of_zero_stands_for_infinity():
    entry = Entry(material=material(ior={"ior": 0.0}))
    assert entry.layers({"type": "principled"}, {})["eta"] == pytest.approx(1.5) and entry.lost == ["ior"]
