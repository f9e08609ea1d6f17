"""What users of other differentiable renderers reported as bugs, as tests of this one."""

from __future__ import annotations

import math

import pytest
import torch

import torchrender as tr


def make(**objects) -> tr.Scene:
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "camera": {
                "type": "perspective",
                "fov": 40,
                "to_world": tr.Transform.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}},
            },
            "ball": {"type": "sphere", "bsdf": {"type": "diffuse"}},
            **objects,
        }
    )


def noise(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(0))


SKIES = {
    "envmap": {"type": "envmap", "data": noise(4, 8, 3)},
    "constant": {"type": "constant"},
    "point": {"type": "point", "position": [0, 0, 9]},
}


@pytest.mark.parametrize("sky", SKIES)
@pytest.mark.parametrize("hide", [False, True])
def test_alpha_is_zero_where_no_surface_is(sky, hide):
    scene = make(sky=SKIES[sky])
    out = tr.render(scene, integrator=tr.PathTracer(3, hide_emitters=hide), outputs=("rgb", "alpha"), spp=16, seed=0)
    assert out.alpha[0, 0] == 0 and out.alpha[5, 5] == 1
    background = out.rgb[0, 0].sum()
    assert (background == 0) == (hide or sky == "point")


def test_hidden_lights_have_no_alpha_but_shine():
    lamp = {
        "type": "rectangle",
        "to_world": tr.Transform.translate([1.2, 1.2, 1]).rotate([0, 1, 0], 180).scale(0.3),
        "emitter": {"type": "area", "radiance": 30.0},
    }
    scene = make(lamp={**lamp, "flip_normals": True})
    shown = tr.render(scene, outputs=("rgb", "alpha"), spp=64, seed=0)
    hidden = tr.render(scene, integrator=tr.PathTracer(3, hide_emitters=True), outputs=("rgb", "alpha"), spp=64, seed=0)
    lit = shown.rgb.sum(-1).argmax()
    assert shown.alpha.flatten()[lit] > 0.5 and hidden.alpha.flatten()[lit] == 0
    assert torch.equal(hidden.rgb[5, 5], shown.rgb[5, 5])


@pytest.mark.parametrize("name", ["sky.data", "ball.bsdf.reflectance.data", "ball.center"])
def test_setting_a_parameter_to_its_own_value_changes_nothing(name):
    scene = make(sky=SKIES["envmap"])
    scene.ball.bsdf.reflectance = noise(4, 4, 3)
    before = tr.render(scene, spp=4, seed=0)
    path, _, field = name.rpartition(".")
    owner = scene.get_submodule(path)
    setattr(owner, field, getattr(owner, field).detach().clone())
    assert torch.equal(tr.render(scene, spp=4, seed=0), before)
    with torch.no_grad():
        getattr(owner, field).copy_(getattr(owner, field).clone())
    assert torch.equal(tr.render(scene, spp=4, seed=0), before)


@pytest.mark.parametrize(("row", "column"), [(1, 3), (2, 0), (3, 5), (5, 11), (6, 8)])
def test_one_texel_of_an_environment_shines_from_its_direction(row, column):
    """Row 0 is the pole +y, the last row -y; columns go from -z towards +x, centred at half integers."""
    height, width = 8, 16
    data = torch.zeros(height, width, 3)
    data[row, column] = 1
    scene = tr.load_dict({"type": "scene", "sky": {"type": "envmap", "data": data}})
    theta, phi = math.pi * row / (height - 1), 2 * math.pi * (column + 0.5) / width
    towards = torch.tensor([math.sin(phi) * math.sin(theta), math.cos(theta), -math.cos(phi) * math.sin(theta)])
    for sign, bright in ((1, True), (-1, False)):
        up = [0, 0, 1] if abs(float(towards[1])) > 0.9 else [0, 1, 0]
        camera = tr.PerspectiveCamera.look_at([0, 0, 0], sign * towards, up, fov=1, size=(1, 1), filter="box")
        seen = tr.render(scene, sensor=camera, spp=4, seed=0)
        assert (float(seen.min()) > 0.9) if bright else (float(seen.max()) == 0)


def test_all_channels_of_a_texture_get_gradients():
    scene = make(sky=SKIES["constant"])
    scene.ball.bsdf.reflectance = noise(2, 2, 3)
    (texels,) = scene.train_only("ball.*.data")
    image = tr.render(scene, spp=16, seed=0)
    for channel in range(3):
        (gradient,) = torch.autograd.grad(image[..., channel].sum(), texels, retain_graph=True)
        others = [c for c in range(3) if c != channel]
        assert bool((gradient[..., channel] > 0).all()) and not gradient[..., others].any()


def test_moved_vertices_are_seen_at_once():
    scene = make(sky=SKIES["constant"])
    scene["patch"] = tr.Mesh([[-1, -1, 2], [1, -1, 2], [0, 1, 2]], [[0, 1, 2]])
    before, box = tr.render(scene, spp=4, seed=0), scene.bounding_box()
    hits = tr.ray_intersect(scene, torch.tensor([[0.0, 0, 5]]), torch.tensor([[0.0, 0, -1]]))
    with torch.no_grad():
        scene.patch.vertex_positions[:, 2] += 1
    assert not torch.equal(tr.render(scene, spp=4, seed=0), before)
    assert float(scene.bounding_box()[1, 2] - box[1, 2]) == pytest.approx(1)
    moved = tr.ray_intersect(scene, torch.tensor([[0.0, 0, 5]]), torch.tensor([[0.0, 0, -1]]))
    assert float(hits.t - moved.t) == pytest.approx(1)


def test_parameters_of_every_camera_can_be_reached_and_edited():
    scene = make(sky=SKIES["envmap"], second={"type": "perspective", "film": tr.Film(12, 12)})
    scene.second.to_world = tr.Transform.look_at([3, 0, 3], [0, 0, 0])
    before = tr.render(scene, sensor=[0, 1], spp=4, seed=0)
    with torch.no_grad():
        scene.second.x_fov.mul_(0.5)
    after = tr.render(scene, sensor=[0, 1], spp=4, seed=0)
    assert torch.equal(after[0], before[0]) and not torch.equal(after[1], before[1])


def test_a_method_of_a_module_can_render():
    class Model(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.scene = make(sky=SKIES["constant"])
            self.colours = torch.nn.ParameterDict({"ball": torch.full((3,), 0.5)})

        def look(self, names: list[str], options: dict) -> dict[str, torch.Tensor]:
            params = {f"{n}.bsdf.reflectance.value": torch.sigmoid(self.colours[n]) for n in names}
            return {"image": tr.render(self.scene, params=params, **options)}

    model = Model()
    model.look(["ball"], {"spp": 4, "seed": 0})["image"].sum().backward()
    assert bool((model.colours["ball"].grad > 0).all())
