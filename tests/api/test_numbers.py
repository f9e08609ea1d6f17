"""Numbers of Python, NumPy and torch, wherever numbers are taken."""

import warnings

import numpy as np
import pytest
import torch
from first_scene import make

import torchrender as tr

X, Y, Z = 0.25, -1.5, 2.0  # which single precision has
VECTORS = {
    "python": [X, Y, Z],
    "tuple": (X, Y, Z),
    "NumPy's numbers": [np.float64(X), np.float32(Y), np.int64(Z)],
    "mixed": [X, np.float64(Y), 2],
    "0-d arrays": [np.array(X), np.array(Y), np.array(Z)],
    "0-d tensors": [torch.tensor(X), torch.tensor(Y, dtype=torch.float64), torch.tensor(2)],
    "tensors and NumPy": [torch.tensor(X), np.float32(Y), 2],
    "array": np.array([X, Y, Z]),
    "array of objects": np.array([X, Y, Z], dtype=object),
    "read-only array": np.broadcast_to(np.array([X, Y, Z], np.float32), (3,)),
    "tensor": torch.tensor([X, Y, Z]),
}


@pytest.mark.parametrize("value", VECTORS.values(), ids=VECTORS)
def test_numbers_of_all_kinds(value):
    expected = torch.tensor([X, Y, Z], dtype=torch.float64)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        matrix = tr.Transform.translate(value).matrix
        assert torch.equal(matrix[:3, 3], expected)
        assert torch.equal(tr.Transform(matrix).transform_points([value])[0], 2 * expected)
        assert torch.equal(tr.Sphere(center=value).center.double(), expected)
        camera = tr.PerspectiveCamera.look_at(value, [0, 0, 0])
        assert torch.equal(camera.to_world[:3, 3].double(), expected)
        colour = {"type": "rgb", "value": [abs(v) for v in value] if isinstance(value, (list, tuple)) else abs(value)}
        light = make(lamp={"type": "point", "position": value, "intensity": colour})
        assert torch.equal(light.lamp.position.double(), expected)
        assert torch.equal(light.lamp.intensity.value.double(), expected.abs())
        nested = tr.Mesh(vertices=[value, [0, 0, 0], (1, 0, 0)], faces=[[np.int64(0), 1, np.int32(2)]])
        assert torch.equal(nested.vertex_positions[0].double(), expected)


def test_turntable():
    for a in np.linspace(0, 2 * np.pi, 3):
        camera = tr.PerspectiveCamera.look_at([4 * np.sin(a), 1, 4 * np.cos(a)], [0, 0, 0], fov=np.float32(35))
        assert float(camera.to_world[1, 3]) == 1 and float(camera.x_fov) == 35
    turned = tr.Transform.rotate([0, np.float64(1), 0], np.float64(90)).matrix
    assert torch.allclose(turned @ torch.tensor([1.0, 0, 0, 1]).double(), torch.tensor([0.0, 0, -1, 1]).double())
    moved = tr.Transform.translate(list(np.linspace(0, 1, 3))).matrix
    assert moved[:3, 3].tolist() == [0, 0.5, 1]


@pytest.mark.parametrize("count", [np.int64(3), np.array(3), torch.tensor(3), np.float32(3), np.float64(3)])
def test_integers_of_all_kinds(count):
    assert tr.Sampler(sample_count=count).sample_count == 3
    assert tr.PathTracer(max_depth=count, rr_depth=count).config()["max_depth"] == 3
    assert tr.Film(width=count, height=count).width == 3


@pytest.mark.parametrize("count", [2.5, np.float64(2.5), torch.tensor(2.5), True, np.bool_(True), "3", [3]])
def test_what_is_no_integer(count):
    with pytest.raises(ValueError, match="expected an integer, got"):
        tr.Sampler(sample_count=count)
    with pytest.raises(TypeError, match="max_depth: expected an integer, got"):
        tr.PathTracer(max_depth=count)


@pytest.mark.parametrize("flag", [True, np.bool_(True), np.array(True), torch.tensor(True)])
def test_booleans_of_all_kinds(flag):
    assert tr.Rectangle(flip_normals=flag).flip_normals is True
    assert tr.PathTracer(hide_emitters=flag).config()["hide_emitters"] is True


@pytest.mark.parametrize("flag", [1, 0.0, "true", np.int64(1), torch.tensor(1)])
def test_what_is_no_boolean(flag):
    with pytest.raises(ValueError, match="expected True or False, got"):
        tr.Rectangle(flip_normals=flag)
