"""Scene files in XML: what they mean, and that mistakes are named with file, line and tag."""

import numpy as np
import pytest

from torchrender.loaders.xml import parse, parse_string
from torchrender.loaders.xml_upgrade import snake_case


def scene(body, version="3.0.0", **params):
    return parse_string(f'<scene version="{version}">\n{body}\n</scene>', **params)


def shape(body, **params):
    return scene(f'<shape type="sphere" id="s">{body}</shape>', **params)["s"]


def test_values():
    built = shape(
        """<integer name="i" value="-3"/><float name="f" value="1e-2"/><boolean name="b" value="True"/>
        <string name="t" value="hello"/><point name="p" x="1" y="2" z="3"/><vector name="v" value="4, 5 6"/>
        <rgb name="c" value="0.1 0.2,0.3"/><rgb name="grey" value="0.5"/><spectrum name="u" value="0.25"/>
        <spectrum name="w" value="400:0.1, 700:0.9"/>
        <spectrum name="d" type="d65"><float name="scale" value="2"/></spectrum>"""
    )
    assert built == {
        **{"type": "sphere", "i": -3, "f": 0.01, "b": True, "t": "hello", "p": [1, 2, 3], "v": [4, 5, 6]},
        "c": {"type": "rgb", "value": [0.1, 0.2, 0.3]},
        "grey": {"type": "rgb", "value": [0.5, 0.5, 0.5]},
        "u": {"type": "spectrum", "value": 0.25},
        "w": {"type": "spectrum", "value": [(400, 0.1), (700, 0.9)]},
        "d": {"type": "d65", "scale": 2},
    }


def matrix(steps):
    return shape(f'<transform name="to_world">{steps}</transform>')["to_world"]


def test_transform_steps_multiply_from_the_left():
    # Scaled by (2, 1, 1), moved by (1, 2, 3), turned by 90 degrees about z.
    result = matrix('<scale x="2"/><translate value="1 2 3"/><rotate value="0,0,1" angle="90"/>')
    assert result.dtype == np.float64
    assert np.allclose(result, [[0, -1, 0, -2], [2, 0, 0, 1], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-15)
    assert np.allclose(matrix('<rotate y="2" angle="90"/>') @ [1, 0, 0, 1], [0, 0, -1, 1])
    assert np.allclose(matrix('<scale value="3"/>'), np.diag([3, 3, 3, 1]))
    assert np.array_equal(matrix(""), np.eye(4))


def test_transform_matrices():
    assert np.array_equal(matrix('<matrix value="1 2 3 4 5 6 7 8 9 10 11 12 0 0 0 1"/>')[1], [5, 6, 7, 8])
    nine = matrix('<matrix value="1 2 3 4 5 6 7 8 10"/>')
    assert np.array_equal(nine, [[1, 2, 3, 0], [4, 5, 6, 0], [7, 8, 10, 0], [0, 0, 0, 1]])
    view = matrix('<lookat origin="1,2,3" target="0,0 1" up="0 1 0"/>')
    expected = [[-0.894427, -0.298142, -1 / 3, 1], [0, 0.745356, -2 / 3, 2], [0.447214, -0.596285, -2 / 3, 3]]
    assert np.allclose(view[:3], expected, atol=1e-6)
    without_up = matrix('<lookat origin="0,5,0" target="0,0,0"/>')
    assert np.allclose(without_up[:3, :3] @ without_up[:3, :3].T, np.eye(3))
    assert np.allclose(without_up[:3, 2], [0, -1, 0])


def test_names_ids_and_references():
    built = scene(
        """<bsdf type="diffuse" id="red"/><alias id="red" as="rouge"/>
        <bsdf type="diffuse" id="shape_1"/>
        <shape type="sphere"><ref id="rouge"/><emitter type="area"/></shape>
        <shape type="sphere"><ref name="mine" id="late"/></shape>
        <shape type="cube" name="box"><bsdf type="twosided">
        <bsdf type="diffuse"/><bsdf type="diffuse" id="inner"/></bsdf></shape>
        <bsdf type="diffuse" id="late"/>"""
    )
    assert list(built) == ["type", "red", "shape_1", "shape", "shape_2", "box", "late"]
    assert built["shape"] == {"type": "sphere", "bsdf": {"type": "ref", "id": "red"}, "emitter": {"type": "area"}}
    assert built["shape_2"]["mine"] == {"type": "ref", "id": "late"}
    assert built["box"]["bsdf"] == {
        **{"type": "twosided", "bsdf": {"type": "diffuse"}, "bsdf_1": {"type": "diffuse", "id": "inner"}}
    }


def test_parameters():
    body = """<default name="a" value="1"/><default name="ab" value="2"/>
    <shape type="sphere" id="s"><point name="center" value="$a,$ab,$abc"/><string name="t" value="x$a.y"/></shape>"""
    built = scene(body.replace("$abc", "3"))
    assert built["s"]["center"] == [1, 2, 3] and built["s"]["t"] == "x1.y"
    assert scene(body.replace("$abc", "3"), a=5)["s"]["center"] == [5, 2, 3]
    assert shape('<boolean name="b" value="$flag"/>', flag=True)["b"] is True
    with pytest.raises(ValueError, match=r"line 3.*undefined parameter \$spq.*'spp'"):
        scene('<default name="spp" value="1"/>\n<shape type="sphere"><integer name="i" value="$spq"/></shape>')
    with pytest.raises(ValueError, match=r"no parameter \$spq.*'spp'"):
        scene('<default name="spp" value="1"/>', spq=3)


def test_files_includes_and_search_paths(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "more").mkdir()
    for name in ("parts/mesh.ply", "more/wood.png"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "parts" / "red.xml").write_text('<bsdf version="3.0.0" type="diffuse" id="red"/>')
    (tmp_path / "parts" / "all.xml").write_text(
        '<scene version="3.0.0"><include filename="red.xml"/>'
        '<shape type="ply" id="m"><string name="filename" value="$name"/></shape></scene>'
    )
    main = tmp_path / "main.xml"
    main.write_text(
        '<scene version="3.0.0"><default name="name" value="parts/mesh.ply"/><path value="more"/>'
        '<include filename="parts/all.xml"/>'
        '<texture type="bitmap" id="t"><string name="filename" value="wood.png"/></texture></scene>'
    )
    built = parse(main)
    assert built["red"] == {"type": "diffuse"}
    assert built["m"]["filename"] == str(tmp_path.resolve() / "parts" / "mesh.ply")
    assert built["t"]["filename"] == str(tmp_path.resolve() / "more" / "wood.png")
    with pytest.raises(FileNotFoundError, match=r"all\.xml, line 1, <string>: no such file: 'gone\.ply'"):
        parse(main, name="gone.ply")
    (tmp_path / "loop.xml").write_text('<scene version="3.0.0"><include filename="loop.xml"/></scene>')
    with pytest.raises(ValueError, match="includes itself"):
        parse(tmp_path / "loop.xml")
    with pytest.raises(FileNotFoundError, match="no such scene file"):
        parse(tmp_path / "nothing.xml")


def test_included_files_name_what_lies_beside_them_or_beside_the_scene(tmp_path):
    for folder in ("parts", "meshes", "parts/own"):
        (tmp_path / folder).mkdir()
    for name in ("blue.xml", "parts/green.xml", "both.xml", "parts/both.xml"):
        kind = "plastic" if "/" in name else "diffuse"
        (tmp_path / name).write_text(f'<bsdf version="3.0.0" type="{kind}" id="{name.split("/")[-1][:-4]}"/>')
    files = ("a.ply", "parts/b.ply", "meshes/c.ply", "parts/own/d.ply", "parts/e.ply", "e.ply")
    for name in files:
        (tmp_path / name).write_bytes(b"x")
    shapes = [f'<shape type="ply" id="{n}"><string name="filename" value="{n}.ply"/></shape>' for n in "abcde"]
    (tmp_path / "parts" / "all.xml").write_text(
        '<scene version="3.0.0"><path value="meshes"/><path value="own"/>'
        '<include filename="blue.xml"/><include filename="green.xml"/><include filename="both.xml"/>'
        f'{"".join(shapes)}<bsdf type="diffuse" id="s"><spectrum name="reflectance" filename="b.ply"/></bsdf></scene>'
    )
    main = tmp_path / "main.xml"
    main.write_text('<scene version="3.0.0"><include filename="parts/all.xml"/></scene>')
    built = parse(main)
    # <path> and <include> prefer what lies beside the file they stand in, objects what lies beside the scene's file
    assert [built[name]["type"] for name in ("blue", "green", "both")] == ["diffuse", "plastic", "plastic"]
    found = ["a.ply", "parts/b.ply", "meshes/c.ply", "parts/own/d.ply", "e.ply"]
    found = [str(tmp_path.resolve() / name) for name in found]
    assert [built[name]["filename"] for name in "abcde"] == found
    assert built["s"]["reflectance"]["filename"] == found[1]
    (tmp_path / "parts" / "all.xml").write_text('<scene version="3.0.0"><path value="nowhere"/></scene>')
    with pytest.raises(FileNotFoundError, match=r"all\.xml, .*<path>: no such folder: 'nowhere'; searched in .*parts"):
        parse(main)


def test_old_files_are_upgraded():
    built = scene(
        """<sensor type="perspective" id="cam"><string name="fovAxis" value="x"/><transform name="toWorld">
        <lookAt origin="0,0,1" target="0,0,0" up="0,1,0"/></transform></sensor>
        <bsdf type="roughplastic" id="p"><spectrum name="diffuseReflectance" value="0.1,0.2,0.3"/>
        <float name="intIOR" value="1.4"/><srgb name="specularReflectance" value="#ff8000"/></bsdf>
        <texture type="checkerboard" id="c">
        <float name="uscale" value="2"/><float name="voffset" value="3"/></texture>""",
        version="0.5.0",
    )
    assert built["cam"]["fov_axis"] == "x" and np.allclose(built["cam"]["to_world"][:3, 3], [0, 0, 1])
    assert built["p"]["diffuse_reflectance"] == {"type": "rgb", "value": [0.1, 0.2, 0.3]}
    assert built["p"]["int_ior"] == 1.4
    assert np.allclose(built["p"]["specular_reflectance"]["value"], [1, 0.2158605, 0])
    assert np.array_equal(built["c"]["to_uv"], [[2, 0, 0, 0], [0, 1, 0, 3], [0, 0, 1, 0], [0, 0, 0, 1]])
    assert set(built["c"]) == {"type", "to_uv"}
    names = {"toWorld": "to_world", "intIOR": "int_ior", "rrDepth": "rr_depth", "alpha": "alpha"}
    assert {name: snake_case(name) for name in names} == names


def test_tags_and_words_of_the_oldest_files():
    built = scene(
        """<camera type="perspective" id="c"><film type="ldrfilm"/></camera>
        <luminaire type="point" id="l"><blackbody name="intensity" temperature="5000K"/></luminaire>
        <texture type="bitmap" id="t"><string name="filterType" value="ewa"/></texture>""",
        version="0.3.0",
    )
    assert built["c"]["film"] == {"type": "hdrfilm"} and built["t"]["filter_type"] == "bilinear"
    assert built["l"]["intensity"] == {"type": "blackbody", "temperature": 5000}
    with pytest.raises(ValueError, match="<blackbody>: scale"):
        scene('<emitter type="point"><blackbody name="a" temperature="5" scale="2"/></emitter>', version="0.6.0")


def test_files_elsewhere_are_refused(tmp_path):
    inside, outside = tmp_path / "scene", tmp_path / "other"
    inside.mkdir(), outside.mkdir()
    for name in ("mesh.ply", "red.xml"):
        (outside / name).write_text('<bsdf version="3.0.0" type="diffuse" id="red"/>')
    (inside / "link.ply").symlink_to(outside / "mesh.ply")
    bodies = {
        '<shape type="ply" id="m"><string name="filename" value="../other/mesh.ply"/></shape>': "<string>",
        f'<shape type="ply" id="m"><string name="filename" value="{outside}/mesh.ply"/></shape>': "<string>",
        '<shape type="ply" id="m"><string name="filename" value="link.ply"/></shape>': "<string>",
        '<include filename="../other/red.xml"/>': "<include>",
        '<path value="../other"/><shape type="ply" id="m"><string name="filename" value="mesh.ply"/></shape>': "<path>",
        '<bsdf type="diffuse"><spectrum name="reflectance" filename="../other/mesh.ply"/></bsdf>': "<spectrum>",
    }
    for body, tag in bodies.items():
        (inside / "a.xml").write_text(f'<scene version="3.0.0">{body}</scene>')
        with pytest.raises(ValueError, match=rf"a\.xml, line 1, {tag}: .*outside of the scene's folder.*trusted=True"):
            parse(inside / "a.xml")
        assert parse(inside / "a.xml", trusted=True)["type"] == "scene"
    # What the caller says himself is his choice.
    (inside / "b.xml").write_text(
        '<scene version="3.0.0"><shape type="ply" id="m"><string name="filename" value="$mesh"/></shape></scene>'
    )
    assert parse(inside / "b.xml", mesh=outside / "mesh.ply")["m"]["filename"] == str(outside.resolve() / "mesh.ply")
    with pytest.raises(ValueError, match="outside of the scene's folder"):
        parse(inside / "b.xml", mesh="../other/mesh.ply")


def test_sizes_are_limited(tmp_path, monkeypatch):
    """Files and parameters that grow exponentially end early, with little memory."""
    growing = "".join(f'<default name="a{i + 1}" value="{f"$a{i}" * 8}"/>' for i in range(20))
    with pytest.raises(ValueError, match=r"<default>: .*longer than 1048576 characters"):
        scene('<default name="a0" value="laughing"/>' + growing)
    for level in range(12):
        (tmp_path / f"{level}.xml").write_text(
            '<scene version="3.0.0">' + f'<include filename="{level + 1}.xml"/>' * 40 + "</scene>"
        )
    (tmp_path / "12.xml").write_text('<scene version="3.0.0">' + '<bsdf type="diffuse"/>' * 500 + "</scene>")
    monkeypatch.setattr("torchrender.loaders.xml._MAX_ELEMENTS", 20_000)
    with pytest.raises(ValueError, match="too many elements"):
        parse(tmp_path / "0.xml")
    deep = '<shape type="a">' * 200 + "</shape>" * 200
    with pytest.raises(ValueError, match="nested more than 100 deep"):
        scene(deep)
    for name in ("\0.ply".replace("\0", "&#0;"), "a" * 5000, "a" * 300):
        with pytest.raises((ValueError, FileNotFoundError)):
            scene(f'<shape type="ply"><string name="filename" value="{name}"/></shape>')


S = '<shape type="sphere">'


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('<shap type="sphere"/>', r"line 2, <shap>: unknown tag.*'shape'"),
        ('<shape tipe="sphere"/>', r"<shape>: unexpected attribute 'tipe'.*'type'"),
        ("<shape/>", r"<shape>: the attribute 'type' is missing"),
        (S + '<float name="r" value="x"/></shape>', r"<float>: value: expected a number, got 'x'"),
        (S + '<float value="1"/></shape>', r"<float>: the attribute 'name' is missing"),
        (S + '<integer name="r" value="1.5"/></shape>', r"<integer>: .*expected an integer, got '1.5'"),
        (S + '<boolean name="r" value="yes"/></shape>', r"<boolean>: .*'true' or 'false', got 'yes'"),
        (S + '<rgb name="r" value="1,2"/></shape>', r"<rgb>: value: expected 1 or 3 numbers, got '1,2'"),
        (S + '<spectrum name="r" value="1:x"/></shape>', r"<spectrum>: .*expected pairs"),
        (S + '<point name="r" x="1" z="2"/></shape>', r"<point>: the attribute 'y' is missing"),
        (S + '<transform name="t"><skale value="1"/></transform></shape>', r"<skale>: .*'scale'"),
        (S + '<transform name="t"><rotate x="1"/></transform></shape>', r"<rotate>: .*'angle' is missing"),
        (S + '<transform name="t"><rotate angle="1"/></transform></shape>', r"<rotate>: .*'x' is missing"),
        (
            S + '<transform name="t"><lookat origin="0 0 0" target="0 0 0"/></transform></shape>',
            r"<lookat>: .*same point",
        ),
        (S + '<ref id="gren"/></shape><bsdf type="diffuse" id="green"/>', r"<ref>: nothing.*'green'"),
        ('<bsdf type="diffuse" id="a"/>\n<bsdf type="diffuse" id="a"/>', r"line 3, <bsdf>: the id 'a'.*line 2"),
        (S + '<float name="a" value="1"/><float name="a" value="1"/></shape>', r"<float>: the name 'a'"),
        ('<float name="a" value="1"/>', r"<float>: unexpected directly inside <scene>"),
        ("hello", r"<scene>: unexpected text 'hello'"),
        (S, r"line \d+.*not well-formed"),
    ],
)
def test_mistakes_are_named(body, message):
    with pytest.raises(ValueError, match=message):
        scene(body)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<scene><shape type="sphere"/></scene>', "'version' is missing"),
        ('<scene version="9"/>', "expected a version"),
        ("", "not well-formed"),
        ('<?xml version="1.0" encoding="utf-H"?><scene version="3.0.0"/>', "unknown encoding: utf-H"),
        ('<html version="1"/>', "expected a scene"),
        ('<!DOCTYPE s [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><scene version="3.0.0">&b;</scene>', "DOCTYPE s"),
        ('<!DOCTYPE s SYSTEM "file:///etc/hosts"><scene version="3.0.0"/>', "DOCTYPE s"),
    ],
)
def test_documents_that_are_refused(text, message):
    with pytest.raises(ValueError, match=message):
        parse_string(text)
