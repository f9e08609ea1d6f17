"""What stands in for unsupported parts of a scene, and that it is said."""

import warnings

import numpy as np
import pytest
import torch

import torchrender as tr
from torchrender.scene import registry

SPHERE = {"type": "sphere"}


def load(**objects):
    """The scene, and the texts of the warnings about stand-ins."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = tr.load_dict({"type": "scene", **objects}, unsupported="substitute")
    return scene, [str(w.message) for w in caught if issubclass(w.category, tr.SubstitutionWarning)]


def without(monkeypatch, *kinds):
    """Make these types unknown, as in a version that does not have them."""
    known = registry.scene_types()
    monkeypatch.setattr(registry, "scene_types", lambda: {k: c for k, c in known.items() if k not in kinds})


def test_supported_scenes_are_left_alone():
    scene, said = load(
        a={**SPHERE, "any": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}}},
        b={"type": "perspective", "film": {"type": "hdrfilm", "any": {"type": "box"}}, "s": {"type": "independent"}},
        c={"type": "path", "max_depth": 3},
    )
    assert said == [] and scene.a.bsdf.reflectance.value.tolist() == pytest.approx([0.1, 0.2, 0.3])
    assert scene.sensors[0].film.filter.type == "box" and scene.integrator.max_depth == 3


def test_materials(monkeypatch):
    names = "plastic roughplastic pplastic principled principledthin roughconductor mask bumpmap blendbsdf normalmap"
    without(monkeypatch, *names.split(), "thindielectric")
    green = {"type": "rgb", "value": [0.1, 0.6, 0.1]}
    scene, said = load(
        a={**SPHERE, "bsdf": {"type": "pplastic", "diffuse_reflectance": green, "alpha": 0.2}},
        b={**SPHERE, "bsdf": {"type": "mask", "opacity": 0.5, "inner": {"type": "ref", "id": "shared"}}},
        c={**SPHERE, "bsdf": {"type": "roughconductor", "material": "Au", "alpha": 0.3}},
        d={**SPHERE, "bsdf": {"type": "measured", "filename": "nowhere.bsdf"}},
        shared={"type": "principled", "base_color": green, "metallic": 0.5},
        e={**SPHERE, "bsdf": {"type": "twosided", "x": {"type": "bumpmap", "bsdf": {"type": "diffuse"}}}},
        f={**SPHERE, "bsdf": {"type": "thindielectric"}},
    )
    for bsdf in (scene.a.bsdf, scene.b.bsdf, scene.shared):
        assert bsdf.type == "diffuse" and bsdf.reflectance.value.tolist() == pytest.approx([0.1, 0.6, 0.1])
    assert [scene[n].bsdf.type for n in "cdef"] == ["conductor", "diffuse", "twosided", "null"]
    assert torch.allclose(scene.c.bsdf.eta.value, tr.Conductor(material="Au").eta.value)
    assert "scene" not in said[0] and said[0].startswith("a.bsdf: 'pplastic' is not supported")
    assert any("b.bsdf" in s and "'mask'" in s and "'principled'" in s for s in said)
    assert any("c.bsdf" in s and "'conductor' without alpha" in s for s in said)
    assert any("e.bsdf.x" in s and "'bumpmap'" in s for s in said)


def test_lights_shapes_and_what_refers_to_them(monkeypatch):
    without(monkeypatch, "sunsky")
    scene, said = load(
        sun={"type": "sunsky", "turbidity": 4},
        fur={"type": "ellipsoids", "filename": "nowhere.ply"},
        group={"type": "ellipsoids", "filename": "nowhere.ply"},
        light={"type": "volumelight"},
        ball={**SPHERE, "bsdf": {"type": "ref", "id": "fur"}},
    )
    assert set(scene) == {"sun", "ball"} and scene.sun.type == "constant"
    assert any("fur: 'ellipsoids' is not supported and was left out" in s for s in said)
    assert any("ball.bsdf: refers to 'fur', which was left out" in s for s in said)
    assert np.isfinite(tr.render(scene, sensor=tr.PerspectiveCamera(), spp=1, crop=(0, 0, 2, 2)).numpy()).all()


def test_parameters_cameras_and_integrators(monkeypatch):
    without(monkeypatch, "thinlens")
    scene, said = load(
        cam={
            **{"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3.0, "fov": 30.0, "srf": 1.0},
            "film": {"type": "specfilm", "width": 8, "height": 4, "any": {"type": "lanczos", "lobes": 2}, "tone": 1},
            "any": {"type": "multijitter", "sample_count": 9, "seed": 0, "jitter": True},
        },
        integrator={"type": "emission", "inner": {"type": "direct", "shading_samples": 2}},
        env={"type": "envmap", "data": np.ones((2, 4, 3)), "mis_compensation": True},
        box={"type": "cube", "max_smooth_angle": 30.0},
        metal={"type": "conductor", "material": "Unobtainium"},
        rough={"type": "roughdielectric", "alpha": {"type": "bitmap", "data": np.ones((2, 2, 1))}, "alphaa": 1.0},
    )
    camera = scene.sensors[0]
    assert camera.film.width == 8 and camera.sampler.sample_count == 9
    assert scene.integrator.kind == "direct" and scene.integrator.emitter_samples == 2
    text = "\n".join(said)
    parts = ["cam: 'thinlens'", "cam.film: 'specfilm'", "cam: the parameter srf", "the parameter tone=1", "'emission'"]
    parts += ["metal: the parameter material='Unobtainium' is not known", "mis_compensation=True"]
    parts += ["box: the parameter max_smooth_angle=30.0", "rough: the parameter alphaa=1.0"]
    assert all(part in text for part in parts), text


def test_errors_stay_errors():
    with pytest.raises(ValueError, match=r"a\.radius: expected a positive number"):
        tr.load_dict({"type": "scene", "a": {"type": "sphere", "radius": -1}}, unsupported="substitute")
    with pytest.raises(ValueError, match=r"unknown .*'sfere'"):
        tr.load_dict({"type": "scene", "a": {"type": "sfere"}}, unsupported="substitute")
    with pytest.raises(ValueError, match="unsupported: expected 'error' or 'substitute', got 'ignore'"):
        tr.load_dict({"type": "scene"}, unsupported="ignore")
    circle = {"type": "coating", "x": {"type": "ref", "id": "b"}}, {"type": "coating", "x": {"type": "ref", "id": "a"}}
    with pytest.raises(ValueError, match="in a circle"):
        tr.load_dict({"type": "scene", "a": circle[0], "b": circle[1]}, unsupported="substitute")


def test_files(tmp_path):
    (tmp_path / "a.xml").write_text(
        '<scene version="0.5.0"><integrator type="bdpt"/><bsdf type="phong" id="p">'
        '<spectrum name="diffuseReflectance" value="0.25"/></bsdf><shape type="sphere"><ref id="p"/></shape></scene>'
    )
    with pytest.raises(ValueError, match="bdpt"):
        tr.load_file(tmp_path / "a.xml")
    with pytest.warns(tr.SubstitutionWarning) as caught:
        scene = tr.load_file(tmp_path / "a.xml", unsupported="substitute")
    assert len(caught) == 2 and scene.p.reflectance.value.item() == 0.25
