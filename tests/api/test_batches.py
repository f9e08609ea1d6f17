"""Several cameras, parameters and images at once."""

import numpy as np
import pytest
import torch
from first_scene import make

import torchrender as tr


def test_batches_of_cameras():
    a = np.linspace(0, 3, 4)
    origins = np.stack([4 * np.sin(a), 0 * a + 1, 4 * np.cos(a)], 1)
    cameras = tr.PerspectiveCamera.look_at(origins, [0, 0, 0], fov=35, size=(6, 7))
    alone = [tr.PerspectiveCamera.look_at(o, [0, 0, 0], fov=35, size=(6, 7)) for o in origins]
    assert [torch.equal(c.to_world, d.to_world) for c, d in zip(cameras, alone, strict=True)] == [True] * 4
    batch = tr.render(make(), sensor=cameras, spp=1, seed=0)
    assert batch.shape == (4, 6, 7, 3)
    by_fov = tr.PerspectiveCamera.look_at([0, 0, 4], [0, 0, 0], fov=torch.tensor([20.0, 30, 40]))
    assert [float(c.x_fov) for c in by_fov] == [20, 30, 40]
    poses = torch.stack([c.world_to_camera for c in alone]).double()
    opencv = tr.PerspectiveCamera.from_opencv(alone[0].K.double(), poses[:, :3, :3], poses[:, :3, 3], (6, 7))
    gl = torch.stack([c.to_world for c in alone]) @ torch.diag(torch.tensor([-1.0, 1, -1, 1]))
    opengl = tr.PerspectiveCamera.from_opengl(gl, 35, (6, 7))
    for one, two, three in zip(alone, opencv, opengl, strict=True):
        torch.testing.assert_close(two.to_world.float(), one.to_world, rtol=0, atol=1e-5)
        torch.testing.assert_close(three.to_world, one.to_world)
        torch.testing.assert_close(two.x_fov.float(), one.x_fov)
    with pytest.raises(ValueError, match="look_at: numbers of cameras that differ: origin 4, target 2"):
        tr.PerspectiveCamera.look_at(origins, origins[:2] * 0.1)
    with pytest.raises(ValueError, match="origin: expected three numbers"):
        tr.PerspectiveCamera.look_at([1.0, 2.0], [0, 0, 0])


def test_gradients_reach_batches_of_poses():
    origins = torch.tensor([[0.0, 0, 4], [3, 0, 3]], requires_grad=True)
    cameras = tr.PerspectiveCamera.look_at(origins, [0.0, 0, 0], size=(6, 7))
    weights = torch.tensor([[1.0], [2]])
    (torch.stack([c.to_world[:3, 3] for c in cameras]) * weights).sum().backward()
    assert torch.equal(origins.grad, weights.expand(2, 3))


class Views(torch.utils.data.Dataset):
    def __len__(self):
        return 3

    def __getitem__(self, i):
        return tr.PerspectiveCamera.look_at([i, 1, 4], [0, 0, 0], size=(4, 5)), torch.full((4, 5, 3), float(i))


def test_datasets_of_cameras():
    cameras, images = next(iter(torch.utils.data.DataLoader(Views(), batch_size=3)))
    assert isinstance(cameras, list) and images.shape == tr.render(make(), sensor=cameras, spp=1).shape


def test_parameters_by_view():
    scene, name = make(), "ball.bsdf.reflectance.value"
    cameras = tr.PerspectiveCamera.look_at([[0, 0, 4], [3, 0, 3]], [0, 0, 0], size=(6, 7))
    colours = torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9]], requires_grad=True)
    params = [{name: c} for c in colours]
    settings = {"spp": 2, "seed": 0}
    batch = tr.render(scene, sensor=cameras, params=params, **settings)
    for i in range(2):
        alone = tr.render(scene, sensor=cameras[i], params=params[i], **settings)
        assert torch.equal(batch[i], alone)
    batch.sum().backward()
    assert bool((colours.grad > 0).all())
    found = tr.render(scene, sensor=cameras, params=params, outputs=("rgb", "albedo"), layout="bchw", **settings)
    assert found.albedo.shape == (2, 3, 6, 7) and torch.equal(found.rgb.movedim(1, -1), batch)
    for sensor, text in ((cameras[:1], "got 2 and 1 sensors"), (0, "got 2 and one sensor")):
        with pytest.raises(ValueError, match=f"params: a list has a mapping for each sensor of a list; {text}"):
            tr.render(scene, sensor=sensor, params=params)


def test_outputs_are_written_with_their_names(tmp_path):
    found = tr.render(make(), spp=1, outputs=("rgb", "alpha", "depth", "shading_normal", "shape_id"))
    tr.io.write_image(tmp_path / "a.exr", found)
    channels = tr.io.read_channels(tmp_path / "a.exr")
    assert all(torch.equal(channels[c], found.rgb[..., i]) for i, c in enumerate("RGB"))
    assert torch.equal(channels["A"], found.alpha)
    assert torch.equal(channels["depth"], found.depth) and torch.equal(channels["shape_id"], found.shape_id.float())
    assert torch.equal(channels["shading_normal.B"], found.shading_normal[..., 2])
    with pytest.raises(ValueError, match="only EXR files have named channels"):
        tr.io.write_image(tmp_path / "a.png", found)


def test_show_takes_batches():
    images = torch.rand(2, 5, 7, 3)
    expected = list(tr.show(list(images)).getdata())
    for given in (images, images.movedim(-1, 1), [i.movedim(-1, 0) for i in images]):
        assert list(tr.show(given).getdata()) == expected
