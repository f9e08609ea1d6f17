"""Scenes and tensors that lie elsewhere than on the CPU: numbers are those of the same scene there, bit for bit.

On a device of PyTorch's that behaves as a card's tensors do (helpers/card.py).
"""

from __future__ import annotations

import copy
import io
import pickle

import card
import pytest
import small_scene
import torch
from bent_scenes import DOUBLE, glass, random_index
from small_scene import COLOUR, TEXELS
from torch import nn
from torch_bsdfs import ALBEDO, Lambert, scene_with, wavefront

import torchrender as tr
from torchrender.cuda.check import Check

pytestmark = [
    pytest.mark.skipif(not card.available(), reason="this PyTorch has no devices that Python is the backend of"),
    pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning"),
]
SETTINGS = {"spp": 4, "seed": 3}
CORNERS = [[-0.8, -0.6, 0.4], [0.9, -0.5, 0.3], [0.1, 0.8, 0.5]]


def described() -> dict:
    mesh = {"type": "mesh", "vertex_positions": CORNERS, "faces": [[0, 1, 2]], "bsdf": {"type": "ref", "id": "red"}}
    return small_scene.ball_and_wall(triangle=mesh)


@pytest.fixture
def scenes() -> tuple[tr.Scene, tr.Scene]:
    """The same scene on the CPU and on the card."""
    return tr.load_dict(described()), tr.load_dict(described(), device=card.NAME)


def on_host(tensor: torch.Tensor) -> torch.Tensor:
    assert tensor.device == torch.device(card.NAME, 0)
    return tensor.detach().to("cpu")


def gradients(image: torch.Tensor, parameters) -> list[torch.Tensor]:
    weights = torch.linspace(0.5, 1.5, image.numel()).reshape(image.shape).to(image.device)
    return list(torch.autograd.grad((image * weights).sum(), parameters))


def check_images(here: tr.Scene, there: tr.Scene, **settings) -> None:
    image = tr.render(here, **SETTINGS, **settings)
    assert image.abs().sum() > 0
    assert torch.equal(on_host(tr.render(there, **SETTINGS, **settings)), image)


@pytest.mark.parametrize("backend", ["cpu", "emulated"])
def test_images_and_gradients(scenes, device, backend):
    device(backend)
    found = []
    for scene in scenes:
        image = tr.render(scene, **SETTINGS)
        names = [n for n, p in scene.named_parameters() if n in (COLOUR, TEXELS, "ball.radius", "sensor.to_world")]
        parameters = scene.train_only(*names)
        assert len(parameters) == 4
        again = scene(**SETTINGS)
        assert again.device == image.device == scene.device
        found.append([image, again, *gradients(again, parameters)])
    for here, there in zip(*found, strict=True):  # the order of derivatives, and of sums of texels, is autograd's
        torch.testing.assert_close(on_host(there), here, rtol=0, atol=2e-7 * float(here.abs().max()))
    assert torch.equal(on_host(found[1][0]), found[0][0])
    assert torch.equal(found[0][0], found[0][1])
    assert all(g.abs().sum() > 0 for g in found[0][2:])
    assert scenes[1].updates == scenes[0].updates


def test_what_has_changed_is_seen(scenes):
    here, there = scenes
    check_images(here, there)
    for scene in scenes:
        with torch.no_grad():
            scene.get_parameter(COLOUR).mul_(0.5)
            scene.triangle.vertex_positions.add_(0.1)
    check_images(here, there)
    assert there.updates == here.updates
    assert there.updates["scenes"] == 1
    for scene in scenes:  # objects, settings, and an assigned parameter of another shape
        scene["lamp"] = {"type": "point", "position": [0.0, 1.0, 3.0], "intensity": 2.0}
        scene.ball.bsdf = {"type": "conductor", "material": "Au"}
        scene.sensor.film.width = 5
    check_images(here, there)
    for scene in scenes:
        del scene["triangle"]
        scene["red"].reflectance = {"type": "bitmap", "data": torch.full((3, 2, 3), 0.25)}
    check_images(here, there)
    assert there["red"].reflectance.data.device == there.device


class Dimmed(Lambert):
    """With settings that are no parameters, and a buffer."""

    def __init__(self) -> None:
        super().__init__()
        self.strength = 1.0
        self.register_buffer("share", torch.tensor([0.5, 1.0, 1.0], dtype=torch.float64))

    def eval(self, si, wi, wo):
        return super().eval(si, wi, wo) * self.strength * self.share * (0.5 if self.training else 1.0)


def halve(tensor: torch.Tensor) -> None:
    with torch.no_grad():
        tensor.mul_(0.5)


EDITS = {
    "a film's size": lambda scene: setattr(scene.sensor.film, "width", 5),
    "a crop": lambda scene: setattr(scene.sensor.film, "crop", (1, 1, 3, 4)),
    "an integrator's depth": lambda scene: setattr(scene.integrator, "max_depth", 1),
    "samples": lambda scene: setattr(scene.sensor.sampler, "sample_count", 9),
    "a parameter in place": lambda scene: halve(scene.get_parameter(COLOUR)),
    "a parameter": lambda scene: setattr(scene["red"].reflectance, "value", [0.1, 0.5, 0.2]),
    "faces": lambda scene: setattr(scene.triangle, "faces", [[0, 2, 1]]),
    "vertices": lambda scene: setattr(scene.triangle, "vertex_positions", [[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]),
    "a material": lambda scene: setattr(scene.ball, "bsdf", {"type": "conductor", "material": "Au"}),
    "a shared material": lambda scene: scene.__setitem__("second", {"type": "disk", "bsdf": scene["red"]}),
    "a shape less": lambda scene: scene.__delitem__("triangle"),
    "smooth normals": lambda scene: scene.triangle.compute_normals(),
}


@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS)
def test_every_edit_alone(scenes, edit):
    def image(scene):
        return tr.render(scene, seed=3, integrator=scene.integrator)

    before = image(scenes[0])
    assert torch.equal(on_host(image(scenes[1])), before)
    for scene in scenes:
        edit(scene)
    assert torch.equal(on_host(image(scenes[1])), image(scenes[0]))


def test_assigned_parameters_ask_for_gradients(scenes):
    for scene in scenes:
        scene["red"].reflectance.value = torch.tensor([0.1, 0.5, 0.2], requires_grad=True)
        (gradient,) = gradients(tr.render(scene, **SETTINGS), [scene.get_parameter(COLOUR)])
        assert gradient.device == scene.device
        scene["red"].reflectance.value = [0.2, 0.5, 0.2]
        assert scene.get_parameter(COLOUR).requires_grad


def test_settings_of_bsdfs_in_pytorch():
    images = []
    for place in ("cpu", card.NAME):
        scene = scene_with(Dimmed(), dtype=torch.float32).to(place)
        images.append([tr.render(scene, integrator=wavefront(), **SETTINGS)])
        scene.ball.bsdf.strength = 0.7
        images[-1].append(tr.render(scene, integrator=wavefront(), **SETTINGS))
        scene.train(False)
        images[-1].append(tr.render(scene, integrator=wavefront(), **SETTINGS))
    assert all(torch.equal(on_host(there), here) for here, there in zip(*images, strict=True))
    assert not torch.equal(images[0][0], images[0][1])
    assert not torch.equal(images[0][1], images[0][2])


def test_gradients_of_what_a_scene_was_made_of():
    found = []
    for place in ("cpu", card.NAME):
        theta = torch.tensor([0.3, 0.4, 0.5], requires_grad=True)
        described = small_scene.ball_and_wall(red={"type": "diffuse", "reflectance": theta * 0.5})
        image = tr.render(tr.load_dict(described, device=place), **SETTINGS)
        image.sum().backward()
        found.append((image, theta.grad))
    assert torch.equal(on_host(found[1][0]), found[0][0])
    assert torch.equal(found[1][1], found[0][1])


def test_a_loss_over_several_renderings(scenes):
    """What is not trained may change between them: copies that an image needs for its derivative are not written to."""
    summed, images = torch.zeros(3), []
    colours = [scene.train_only(COLOUR)[0] for scene in scenes]
    for factor in (1.0, 0.5, 0.25):
        for scene in scenes:
            scene.sky.radiance = factor
        summed += torch.autograd.grad(tr.render(scenes[0], **SETTINGS).sum(), colours[0])[0]
        images.append(tr.render(scenes[1], **SETTINGS).sum())
    (found,) = torch.autograd.grad(torch.stack(images).sum(), colours[1])
    torch.testing.assert_close(on_host(found), summed)


def test_what_has_not_changed_is_not_made_again():
    sky = {"type": "envmap", "bitmap": torch.rand(4, 8, 3, generator=torch.Generator().manual_seed(1))}
    counted = []
    for place in ("cpu", card.NAME):
        scene = tr.load_dict(small_scene.ball_and_wall(sky=sky), device=place)
        scene.train_only("sky.*")
        for seed in range(3):
            tr.render(scene, spp=2, seed=seed).sum().backward()
        counted.append(scene.updates)
    assert counted[0] == counted[1]
    assert counted[1]["environments"] == 1


def test_normals_that_follow_positions(scenes):
    found = []
    for scene in scenes:
        scene.triangle.compute_normals()
        (positions,) = scene.train_only("triangle.vertex_positions")
        tr.render(scene, **SETTINGS).sum().backward()
        with torch.no_grad():
            positions += torch.linspace(0, 0.3, 9).reshape(3, 3).to(scene.device)
        found.append([tr.render(scene, **SETTINGS), positions.grad, *scene.state_dict().values()])
    assert all(torch.equal(on_host(there), here) for here, there in zip(*found, strict=True))


def test_inference(scenes):
    here, there = scenes
    with torch.inference_mode():
        image = tr.render(there, **SETTINGS)
    halve(there.get_parameter(TEXELS))
    halve(here.get_parameter(TEXELS))
    assert not torch.equal(image.to("cpu"), on_host(tr.render(there, **SETTINGS)))
    check_images(here, there)
    (colour,) = there.train_only(COLOUR)
    tr.render(there, **SETTINGS).sum().backward()
    assert colour.grad.device == there.device


def test_training(scenes):
    found = []
    for scene in scenes:
        parameters = scene.train_only(COLOUR, TEXELS)
        optimizer = torch.optim.Adam(parameters, lr=0.05)
        for seed in range(3):
            optimizer.zero_grad()
            tr.render(scene, spp=2, seed=seed).square().mean().backward()
            optimizer.step()
        found.append([p.detach() for p in parameters])
        assert scene.updates["scenes"] == 1
    for here, there in zip(*found, strict=True):
        assert torch.equal(on_host(there), here)


def test_forward_mode_and_functions(scenes):
    found = []
    for scene in scenes:
        colour = scene.get_parameter(COLOUR).detach()

        def image(value, scene=scene):
            return torch.func.functional_call(scene, {COLOUR: value}, (), SETTINGS)

        tangent = torch.tensor([0.1, 0.2, 0.3]).to(scene.device)
        value, along = torch.func.jvp(image, (colour,), (tangent,))
        pulled = torch.func.grad(lambda c, image=image: image(c).square().sum())(colour)
        replaced = tr.render(scene, params={COLOUR: colour * 0.5}, **SETTINGS)
        found.append([value, along, pulled, replaced, tr.render(scene, **SETTINGS)])
    assert all(torch.equal(on_host(there), here) for here, there in zip(*found, strict=True))
    assert torch.equal(found[0][0], found[0][4])
    assert found[0][1].abs().sum() > 0


def test_cameras_that_are_no_part_of_the_scene(scenes):
    found = []
    for scene in scenes:
        views = [tr.PerspectiveCamera.look_at([0.3 * i, 0, 4], [0, 0, 0], size=(6, 5)) for i in range(2)]
        for view in views:
            view.to(scene.device)
            view.to_world.requires_grad_(True)
        image = tr.render(scene, sensor=views, **SETTINGS)
        found.append([image, *gradients(image, [view.to_world for view in views])])
        assert torch.equal(tr.render(scene, sensor=scene.sensor, **SETTINGS), tr.render(scene, **SETTINGS))
        counted = scene.updates
        tr.render(scene, sensor=views, **SETTINGS)
        assert scene.updates == counted
    assert all(torch.equal(on_host(there), here) for here, there in zip(*found, strict=True))


def test_outputs_and_pixels(scenes):
    names = ("rgb", "depth", "normal", "shape_id", "features")
    found = []
    for scene in scenes:
        shown = torch.linspace(0, 1, 24).reshape(3, 4, 2).to(scene.device).requires_grad_(True)
        pixels = torch.tensor([[0, 1], [3, 4], [2, 6]]).to(scene.device)
        outputs = tr.render(scene, outputs=names, features={"wall": shown}, pixels=pixels, **SETTINGS)
        assert outputs._fields == names
        found.append([*outputs, *gradients(outputs.features, [shown])])
    assert all(torch.equal(on_host(there), here) for here, there in zip(*found, strict=True))


def test_ray_queries(scenes):
    found = []
    for scene in scenes:
        origins = torch.tensor([[0.0, 0.0, 3.0], [0.2, -0.1, 3.0], [9.0, 0.0, 3.0]]).to(scene.device)
        origins.requires_grad_(True)
        directions = torch.tensor([[0.0, 0.0, -1.0]]).expand(3, 3).to(scene.device)
        hits = tr.ray_intersect(scene, origins, directions)
        found.append([*hits, *gradients(hits.position[:2], [origins]), tr.ray_occluded(scene, origins, directions)])
    assert all(torch.equal(on_host(there), here) for here, there in zip(*found, strict=True))


def test_bent_rays():
    rays = torch.tensor([[0.1, 0.2, 3.0]], dtype=DOUBLE), torch.tensor([[0.0, 0.0, -1.0]], dtype=DOUBLE)
    found = []
    for place in ("cpu", card.NAME):
        scene = glass(random_index(6)).to(place)
        found.append(tr.gradientindex.trace(scene, "lens", *(ray.to(place) for ray in rays)))
        assert bool(found[-1].valid.all())
    assert all(torch.equal(on_host(there), here) for here, there in zip(*found, strict=True))


def test_bsdfs_in_pytorch():
    found = []
    for place in ("cpu", card.NAME):
        scene = scene_with(Lambert(), dtype=torch.float32).to(place)
        image = tr.render(scene, integrator=wavefront(), **SETTINGS)
        found.append([image, *gradients(image, [scene.get_parameter(ALBEDO)])])
    assert all(torch.equal(on_host(there), here) for here, there in zip(*found, strict=True))


def test_constrained_parameters(scenes):
    class Squashed(nn.Module):
        def forward(self, x):
            return torch.sigmoid(x)

    found = []
    for scene in scenes:
        texture = scene["red"].reflectance
        nn.utils.parametrize.register_parametrization(texture, "value", Squashed())
        texture.parametrizations.value.original.requires_grad_(True)
        image = tr.render(scene, **SETTINGS)
        found.append([image, *gradients(image, [texture.parametrizations.value.original])])
    assert all(torch.equal(on_host(there), here) for here, there in zip(*found, strict=True))


def test_moves_copies_and_files(scenes):
    here, there = scenes
    check_images(here, there)
    check_images(here, copy.deepcopy(there))
    there.to("cpu")
    assert torch.equal(tr.render(there, **SETTINGS), tr.render(here, **SETTINGS))
    there.to(card.NAME)
    check_images(here, there)
    there.rebuild()
    check_images(here, there)
    for a, b in zip(here.state_dict().values(), there.to("cpu").state_dict().values(), strict=True):
        assert torch.equal(a, b)
    assert torch.equal(tr.render(pickle.loads(pickle.dumps(there)), **SETTINGS), tr.render(here, **SETTINGS))
    assert here.device == there.device == torch.device("cpu")
    file = io.BytesIO()
    torch.save(here, file)
    file.seek(0)
    assert torch.load(file, map_location="meta", weights_only=False).device == torch.device("meta")


@pytest.mark.parametrize("backend", ["cpu", "emulated"])
def test_a_black_picture(device, backend):
    """Why it is, the host looks for, by rays."""
    device(backend)
    dark = {**described(), "sky": {"type": "point", "position": [0.0, 0.0, 3.0], "intensity": 1.0}}
    dark["sensor"]["to_world"] = tr.Transform.look_at([0, 0, 4], [0, 0, 9], [0, 1, 0])
    with pytest.warns(UserWarning, match="the picture is black"):
        tr.render(tr.load_dict(dark, device=card.NAME), **SETTINGS)


def test_what_is_refused(scenes):
    here, there = scenes
    value = here.get_parameter(COLOUR)
    with pytest.raises(ValueError, match=rf"^{COLOUR}: lies on {card.NAME}:0, but the scene on cpu: use .to\('cpu'\)"):
        tr.render(here, params={COLOUR: value.to(card.NAME)}, **SETTINGS)
    with pytest.raises(ValueError, match=rf"^{COLOUR}: lies on meta, but the scene on {card.NAME}:0"):
        tr.render(there, params={COLOUR: value.to("meta")}, **SETTINGS)
    with pytest.raises(ValueError, match=r"lies on meta: use \.to\('cpu'\)$"):
        tr.render(here.to("meta"), **SETTINGS)
    with pytest.raises(ValueError, match="spp: expected a number from 1"):
        tr.render(there, spp=0)
    check_images(tr.load_dict(described()), there)


def test_the_check_of_cards(tmp_path):
    found = Check("emulated", tmp_path / "report.json", "").moved(f"{card.NAME}:0", size=12)
    assert found["passed"]
    assert found["of"] > 5
