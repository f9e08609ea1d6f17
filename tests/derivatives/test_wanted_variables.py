"""A derivative by one parameter alone leaves out what BSDFs have for others: it is the one beside all others.

To rounding: what is differentiated decides which vertices stand beside each other in packets.
"""

from __future__ import annotations

import motion_scenes as ms
import pytest
import reference_scenes
import torch

import torchrender as tr

SIZE = 12
PRINCIPLED = {
    "type": "principled",
    "roughness": 0.4,
    "metallic": 0.3,
    "specular": 0.6,
    "spec_tint": 0.5,
    "sheen": 0.7,
    "sheen_tint": 0.6,
    "flatness": 0.3,
    "clearcoat": 0.5,
    "clearcoat_gloss": 0.6,
    "spec_trans": 0.2,
}
PATTERN = torch.rand(4, 4, 3, generator=torch.Generator().manual_seed(1)) * 0.6 + 0.2


def ball(color: object) -> dict:
    """A tinted ball of all that `principled` has, of this colour or texture, under a sky."""
    view = tr.Transform.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE}
    return {
        "type": "scene",
        "camera": {"type": "perspective", "fov": 40, "to_world": view, "film": film},
        "ball": {"type": "sphere", "bsdf": {**PRINCIPLED, "base_color": color}},
        "sky": {"type": "constant"},
    }


def scenes() -> dict[str, dict]:
    bitmap = {"type": "bitmap", "data": PATTERN, "raw": True}
    tinted = {"coloured": ball([0.6, 0.3, 0.2]), "textured": ball(bitmap)}
    tinted["nearest"] = ball({**bitmap, "filter_type": "nearest"})
    # shapes whose matrices are left out where nobody differentiates them
    brushed = {
        "type": "roughconductor",
        "alpha_u": 0.1,
        "alpha_v": 0.4,
        "eta": 0.2,
        "k": 3.9,
    }  # along a field's tangents
    hills = ms.hills(brushed, ms.floor()["to_world"], 0.04)
    tinted["hills"] = ms.scene(2, ms.above(), hills=hills, lamp=ms.lamp("rectangle"))
    tinted["distances"] = ms.scene(3, ms.at_ball(), ball=ms.distances(ms.PLAIN), room=ms.black_room())
    return {**{name: reference_scenes.in_few_pixels(name, SIZE) for name in reference_scenes.SCENES}, **tinted}


SCENES = scenes()


def gradients(scene: tr.Scene, names: list[str]) -> list[torch.Tensor]:
    scene.train_only(*names)
    image = tr.render(scene, spp=4, seed=3, visibility=False)
    adjoint = torch.randn(image.shape, generator=torch.Generator().manual_seed(2)).to(image.dtype)
    return torch.autograd.grad(image, [scene.get_parameter(name) for name in names], adjoint)


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize(("dtype", "error"), [(torch.float64, 1e-10), (torch.float32, 2e-4)], ids=["plain", "packets"])
@pytest.mark.parametrize("name", sorted(SCENES))
def test_each_parameter_alone_has_the_gradient_that_it_has_beside_all(name, dtype, error):
    scene = tr.load_dict(SCENES[name], dtype=dtype)
    scene.train_only("*")
    names = [n for n, p in scene.named_parameters() if p.requires_grad]
    assert len(names) > 5
    counted = 0
    for each, beside in zip(names, gradients(scene, names), strict=True):
        (alone,) = gradients(scene, [each])
        torch.testing.assert_close(alone, beside, rtol=error, atol=error * float(beside.abs().max()))
        counted += bool(beside.abs().max() > 0)
    assert counted


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
def test_each_tangent_alone_has_the_derivative_that_it_has_beside_all():
    """In forward mode: derivatives by all parameters are the sum of those by each."""
    scene = tr.load_dict(SCENES["textured"], dtype=torch.float64)
    scene.train_only("ball.bsdf.*", "ball.to_world")
    names = [n for n, p in scene.named_parameters() if p.requires_grad]
    generator = torch.Generator().manual_seed(4)
    values = {n: scene.get_parameter(n).detach() for n in names}
    tangents = {n: torch.randn(v.shape, generator=generator, dtype=v.dtype) for n, v in values.items()}

    def derivative(chosen: list[str]) -> torch.Tensor:
        def image(params: dict) -> torch.Tensor:
            return tr.render(scene, spp=4, seed=3, params=params, visibility=False)

        parts = ({n: which[n] for n in chosen} for which in (values, tangents))
        return torch.func.jvp(image, *((part,) for part in parts))[1].detach()

    together, alone = derivative(names), [derivative([name]) for name in names]
    assert all(float(each.abs().max()) > 0 for each in alone)
    torch.testing.assert_close(sum(alone), together, rtol=1e-9, atol=1e-9 * float(together.abs().max()))
