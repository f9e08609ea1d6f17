"""How samples of outlines are shared out among silhouettes, shadows and reflections where nobody says how many.

The statistical test is at 0.1 %.
"""

from __future__ import annotations

import math

import pytest
import torch

import torchrender as tr
from torchrender.visibility.allotment import COSTS, factors

pytestmark = [pytest.mark.once, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]

USUAL = {"silhouettes": 4000.0, "shadows": 2000.0, "reflections": 2000.0}
SHALLOW = 3.0


def takes(numbers: dict[str, float]) -> float:
    return sum(COSTS[part] * n for part, n in numbers.items())


# ------------------------------------------------------------------------------------------------------------ numbers
def test_what_all_bring_leaves_the_usual_numbers():
    found = factors(USUAL, {"silhouettes": 0.05, "shadows": 1.0, "reflections": 0.5}, SHALLOW)
    assert found == dict.fromkeys(USUAL, 1.0)


def test_what_brings_nothing_leaves_its_samples_to_the_others():
    found = factors(USUAL, {"silhouettes": 1.0, "shadows": 0.0, "reflections": 3e-4}, SHALLOW)
    assert found["shadows"] == pytest.approx(found["silhouettes"] / 8)
    assert found["reflections"] == found["shadows"]  # 0.03 % is hardly anything
    assert 1 < found["silhouettes"] <= 2
    numbers = {part: n * found[part] for part, n in USUAL.items()}
    assert takes(numbers) <= takes(USUAL) * (1 + 1e-9)
    # one per cent is between nothing and enough
    some = factors(USUAL, {"silhouettes": 1.0, "shadows": 1.0, "reflections": 0.02}, SHALLOW)
    assert found["reflections"] / found["silhouettes"] < some["reflections"] / some["silhouettes"] < 1


@pytest.mark.parametrize(("rays", "more"), [(5.25, 2.25), (100.0, 4.0)])
def test_deep_paths_have_up_to_four_times_as_many(rays, more):
    found = factors(USUAL, dict.fromkeys(USUAL, 1.0), rays)
    assert found == {"silhouettes": 1.0, "shadows": more, "reflections": more}


@pytest.mark.parametrize("brought", [0.0, math.nan])
def test_nothing_at_all_leaves_the_usual_numbers(brought):
    assert factors(USUAL, dict.fromkeys(USUAL, brought), SHALLOW) == dict.fromkeys(USUAL, 1.0)


# ----------------------------------------------------------------------------------------------------------- in scenes
def ball_in_the_sky(reflectance: float, floor: bool) -> tr.Scene:
    """A ball, black or not, above a floor or not."""
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
    below = tr.Transform.translate([0, 0, -1.4]) @ tr.Transform.scale(4)
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "camera": {
                "type": "perspective",
                "fov": 45,
                "to_world": tr.Transform.look_at([4, 0, 2], [0, 0, -0.5], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}},
            },
            "ball": ball,
            **({"floor": {"type": "rectangle", "to_world": below}} if floor else {}),
            "sky": {"type": "constant"},
        }
    )


def derivative(scene: tr.Scene, seed: int = 0, spp_grad: int = 16, **settings) -> torch.Tensor:
    moved = scene.get_parameter("ball.to_world").detach().clone().requires_grad_()
    image = tr.render(scene, spp=1, spp_grad=spp_grad, seed=seed, params={"ball.to_world": moved}, **settings)
    return torch.autograd.grad((image * torch.linspace(0, 1, 64)[:, None, None]).mean(), moved)[0]


def samples(scene: tr.Scene) -> dict[str, float]:
    return {part: found["samples"] for part, found in scene.statistics["visibility"].items() if part != "pilot"}


def test_a_black_ball_has_its_silhouette_sampled():
    black, white = ball_in_the_sky(0.0, floor=False), ball_in_the_sky(0.8, floor=True)
    derivative(black, spp_grad=32), derivative(white, spp_grad=32)
    of_black, of_white = samples(black), samples(white)
    assert of_black["silhouettes"] == pytest.approx(2 * of_white["silhouettes"], abs=1)
    assert of_black["shadows"] < 0.6 * of_white["shadows"]
    assert of_black["reflections"] < 0.6 * of_white["reflections"]


def test_numbers_that_are_given_are_taken():
    scene = ball_in_the_sky(0.0, floor=False)
    derivative(scene, spp_visibility=(2, 1))
    assert samples(scene) == {"silhouettes": 2 * 64**2, "shadows": 64**2, "reflections": 64**2}


def test_few_samples_are_not_looked_at_before():
    scene = ball_in_the_sky(0.0, floor=False)
    derivative(scene, spp_grad=4)
    assert scene.statistics["visibility"]["pilot"]["samples"] == 256  # of what the camera sees of shadows
    found = samples(scene)
    assert found["reflections"] == found["shadows"] == 1024  # in place of 64^2 * 4 / 64 and / 32


def test_seeds_repeat_for_any_number_of_threads():
    scene = ball_in_the_sky(0.8, floor=True)
    first, threads = derivative(scene, seed=3), torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        assert torch.equal(first, derivative(scene, seed=3))
    finally:
        torch.set_num_threads(threads)


def test_forward_mode_takes_the_same_samples():
    scene = ball_in_the_sky(0.8, floor=True)
    start = scene.get_parameter("ball.to_world").detach().clone()
    tangent = torch.zeros(4, 4)
    tangent[:3, 3] = torch.tensor([0.3, -0.5, 0.8])
    gradient = derivative(scene, seed=5)
    reverse = samples(scene)

    def image(moved: torch.Tensor) -> torch.Tensor:
        return tr.render(scene, spp=1, spp_grad=16, seed=5, params={"ball.to_world": moved})

    _, change = torch.func.jvp(image, (start,), (tangent,))
    assert samples(scene) == reverse
    forward = (change * torch.linspace(0, 1, 64)[:, None, None]).mean()
    assert float(forward) == pytest.approx(float((gradient * tangent).sum()), rel=2e-4)


def test_expectations_are_those_of_fixed_numbers():
    scene = ball_in_the_sky(0.8, floor=True)

    def mean_and_variance(**settings) -> tuple[torch.Tensor, torch.Tensor]:
        found = torch.stack([derivative(scene, seed=s, **settings)[:3, 3].double() for s in range(24)])
        return found.mean(0), found.var(0) / len(found)

    (a, va), (b, vb) = mean_and_variance(), mean_and_variance(spp_visibility=(4, 2))
    z = (a - b) / (va + vb).sqrt()
    assert float(z.abs().max()) < 3.9, z  # 0.1 % for three numbers, of Student's t with 40 degrees of freedom
