"""Media that bend light in scenes: files, saved and loaded again, edited, trained, shared."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
import torch
from bent_scenes import BOX, DOUBLE, beam, glass, number_of, random_index

import torchrender as tr

RAYS = tuple(r.float() for r in beam(20))
SETTINGS = {
    **{"interpolation": "quadratic", "sigma_t": [0.1, 0.2, 0.3], "ext_ior": 1.25, "step": 0.5, "max_steps": 77},
    **{"index_base": 0.1, "index_scale": 0.9},
}


def trace(scene: tr.Scene, **named) -> tr.gradientindex.BentRays:
    return tr.gradientindex.trace(scene, "lens", *RAYS, **named)


def same(a: tr.Scene, b: tr.Scene) -> bool:
    return all(torch.equal(x, y) for x, y in zip(trace(a), trace(b)))


@pytest.mark.parametrize("settings", [{}, SETTINGS], ids=["defaults", "all"])
@pytest.mark.parametrize("index", [1.5, random_index(5).float()], ids=["number", "grid"])
@pytest.mark.parametrize("shape", ["cube", "sphere"])
def test_saved_and_loaded(tmp_path, settings, index, shape):
    for bsdf in ("null", "dielectric"):
        scene = glass(index, bsdf, torch.float32, shape=shape, **settings)
        scene.save(tmp_path / f"{bsdf}.xml")
        again = tr.load_file(tmp_path / f"{bsdf}.xml")
        assert same(again, scene)
        ours, theirs = (s["lens"].interior.state_dict() for s in (scene, again))
        assert set(ours) == set(theirs) and all(torch.equal(ours[k], theirs[k]) for k in ours)
        for name in ("interpolation", "max_steps"):
            assert getattr(scene["lens"].interior, name) == getattr(again["lens"].interior, name)


def test_xml_says_what_a_dict_says(tmp_path):
    index = random_index(5).float()
    tr.io.write_volume(tmp_path / "index.vol", index)
    text = """<scene version="3.0.0"><shape type="cube" id="lens"><bsdf type="null"/>
        <medium type="gradientindex" name="interior">
            <string name="filename" value="index.vol"/>
            <string name="interpolation" value="quadratic"/>
            <float name="step" value="0.5"/>
            <transform name="to_world"><scale value="2"/><translate x="-1" y="-1" z="-1"/></transform>
        </medium></shape></scene>"""
    (tmp_path / "scene.xml").write_text(text)
    loaded = tr.load_file(tmp_path / "scene.xml")
    assert same(loaded, glass(index, "null", torch.float32, interpolation="quadratic", step=0.5))


def test_files_of_indices(tmp_path):
    index = random_index(4).float()
    tr.io.write_volume(tmp_path / "a.vol", index[..., None])
    np.save(tmp_path / "a.npy", index.numpy())
    for name in ("a.vol", "a.npy"):
        scene = glass(None, dtype=torch.float32, filename=str(tmp_path / name))
        assert torch.equal(scene["lens"].interior.index, index)
    with pytest.raises(FileNotFoundError, match=r"interior_medium\.filename: no such file"):
        glass(None, filename=str(tmp_path / "none.vol"))
    tr.io.write_volume(tmp_path / "rgb.vol", 1 + torch.rand(2, 3, 4, 3))
    with pytest.raises(ValueError, match=r"filename: expected control values of shape \(Z, Y, X\).*split light"):
        glass(None, filename=str(tmp_path / "rgb.vol"))
    with pytest.raises(ValueError, match="give one of index and filename; got none"):
        glass(None)


def test_the_class():
    medium = tr.GradientIndexMedium(index=1.5, to_world=BOX, interpolation="quadratic")
    assert medium.index.shape == (1, 1, 1) and "1 x 1 x 1 voxels" in repr(medium)
    assert (medium.interpolation, medium.max_steps) == ("quadratic", 0)
    assert {n for n, _ in medium.named_parameters()} >= {"index", "index_base", "index_scale", "to_world", "ext_ior"}
    column = tr.GradientIndexMedium(index=torch.full((2, 3, 4, 1), 1.5))
    assert column.index.shape == (2, 3, 4)
    with pytest.raises(ValueError, match="max_steps: expected an integer between 0 and"):
        medium.max_steps = -1
    with pytest.raises(ValueError, match="'trilinear' has no continuous gradient"):
        medium.interpolation = "trilinear"
    assert (medium.interpolation, medium.max_steps) == ("quadratic", 0)


def test_states_and_copies():
    scene = glass(random_index(5), "null", torch.float32)
    other = glass(random_index(5, seed=9), "null", torch.float32, sigma_t=0.2)
    assert not same(scene, other)
    other.load_state_dict(scene.state_dict())
    assert same(scene, other)
    for copied in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        assert same(scene, copied)
        with torch.no_grad():
            copied["lens"].interior.index.mul_(1.01)
        assert not same(scene, copied)


def test_edits_are_seen():
    """In place, by another tensor of another size, and of settings."""
    scene = glass(random_index(5), "null", torch.float32)
    first = trace(scene)
    with torch.no_grad():
        scene["lens"].interior.index.add_(0.1)
    assert float((trace(scene).optical_path - first.optical_path).min()) > 0.1
    scene["lens"].interior.index = torch.full((9, 8, 7), 1.2)
    assert torch.allclose(trace(scene).optical_path, 1.2 * trace(scene).length, rtol=1e-5)
    steps = int(trace(scene).steps.max())
    scene["lens"].interior.step = 0.25
    assert int(trace(scene).steps.max()) > 3 * steps
    scene["lens"].interior.interpolation = "quadratic"
    assert torch.allclose(trace(scene).optical_path, 1.2 * trace(scene).length, rtol=1e-5)
    scene["lens"].bsdf = tr.load_dict({"type": "diffuse"})
    with pytest.raises(ValueError, match="got diffuse"):
        trace(scene)


def test_one_medium_of_two_shapes():
    """Names of parameters are shared, gradients summed up."""
    medium = tr.load_dict({"type": "gradientindex", "index": random_index(6), "to_world": BOX}, dtype=DOUBLE)
    lenses = {
        "a": {"type": "cube", "interior": medium, "bsdf": {"type": "null"}},
        "b": {"type": "sphere", "center": [0, 2.2, 0], "interior": medium, "bsdf": {"type": "null"}},
    }
    scene = tr.load_dict({"type": "scene", **lenses}, dtype=DOUBLE)
    medium.index.requires_grad_()
    o, d = beam(10)
    number_of(tr.gradientindex.trace(scene, "a", o, d)).backward()
    first = medium.index.grad.clone()
    number_of(tr.gradientindex.trace(scene, "b", o + o.new_tensor([0, 2.2, 0]), d)).backward()
    assert bool(first.any()) and not torch.equal(first, medium.index.grad)


def test_a_lens_is_trained():
    """Rays of a plane wave are to meet in a point behind the cube: a few steps of an optimiser bring them closer."""
    scene = glass(torch.full((6, 6, 6), 1.5, dtype=DOUBLE), "null")
    (index,) = scene.train_only("lens.interior.index")
    line = torch.linspace(-0.5, 0.5, 7, dtype=DOUBLE)
    y, x = torch.meshgrid(line, line, indexing="ij")
    o = torch.stack([x.flatten(), y.flatten(), torch.full((49,), -2.0, dtype=DOUBLE)], 1)
    d = torch.tensor([[0.0, 0.0, 1.0]], dtype=DOUBLE).expand_as(o)
    optimizer, spots = torch.optim.Adam([index], 0.03), []
    for _ in range(30):
        optimizer.zero_grad()
        rays = tr.gradientindex.trace(scene, "lens", o, d)
        far = rays.position + rays.direction * ((4 - rays.position[:, 2]) / rays.direction[:, 2])[:, None]
        loss = far[:, :2].square().sum(1).mean()
        loss.backward()
        optimizer.step()
        spots.append(float(loss.detach().sqrt()))
    assert spots[0] == pytest.approx(float(o[:, :2].square().sum(1).mean().sqrt()), rel=1e-6)
    assert spots[-1] < 0.2 * spots[0]
