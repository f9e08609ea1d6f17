"""Several adjoints of one rendering: gradients as by a backward pass for each, by paths that are traced once."""

from __future__ import annotations

import gradientindex_scenes
import media_scenes
import pytest
import reference_scenes
import torch
from bent_scenes import random_index
from emulated import check_close, differentiable
from small_scene import COLOUR, TEXELS, ball_and_wall

import torchrender as tr
from torchrender import backends
from torchrender.autograd import backward_and_grads

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")


def adjoints_of(image: torch.Tensor, count: int = 3) -> list[torch.Tensor]:
    """Random ones, each zero in rows of its own, and all of them in the last one."""
    found = []
    for k in range(count):
        adjoint = torch.randn(image.shape, generator=torch.Generator().manual_seed(k)).to(image)
        adjoint[k], adjoint[-1] = 0, 0
        found.append(adjoint)
    return found


def picture(scene: tr.Scene, settings: dict) -> torch.Tensor:
    found = tr.render(scene, **settings)
    return found if isinstance(found, torch.Tensor) else found[0]


def check(scene: tr.Scene, traced_once: bool = True, **settings) -> None:
    """Gradients of all that can be differentiated are the same; `traced_once`: rays are those of one pass."""
    leaves = differentiable(scene)
    some = dict(list(leaves.items())[::2])  # what the other adjoints are pulled back to
    settings = {"spp": 4, "seed": 3, "visibility": False, **settings}
    expected: dict[str, torch.Tensor] = {}
    image = picture(scene, settings)
    first, *others = adjoints_of(image)
    torch.autograd.backward(image, first, retain_graph=True)
    for name, leaf in leaves.items():
        assert leaf.grad is not None
        expected[name], leaf.grad = leaf.grad, None
    rays = scene.statistics["vjp"]["closest_rays"]
    for k, other in enumerate(others):
        one = torch.autograd.grad(image, list(some.values()), other, retain_graph=True)
        expected |= {f"{name} {k}": g for name, g in zip(some, one, strict=True)}
    image = picture(scene, settings)
    found: dict[str, torch.Tensor] = {}
    for k, one in enumerate(backward_and_grads(image, first, [(list(some.values()), other) for other in others])):
        assert all(g is not None for g in one)
        found |= {f"{name} {k}": g for name, g in zip(some, one, strict=True) if g is not None}
    found |= {name: leaf.grad for name, leaf in leaves.items() if leaf.grad is not None}
    check_close(found, expected)
    traced = scene.statistics["vjp"]["closest_rays"]
    # Paths are traced for pixels of which any adjoint is not zero.
    assert rays <= traced <= (1.7 if traced_once else 3.5) * rays
    assert traced_once or traced > 2 * rays


@pytest.mark.parametrize("name", sorted(reference_scenes.SCENES))
def test_scenes(name):
    check(tr.load_dict(reference_scenes.in_few_pixels(name, 12)))


@pytest.mark.parametrize(
    "settings",
    [
        {"passes": 3},
        {"correlated": True, "spp": 8},
        {"pixels": torch.tensor([[1, 2], [5, 7], [3, 3], [5, 7]]), "spp": 300},
        {"outputs": ["rgb", "alpha"]},
        {"integrator": tr.PathTracer(max_depth=-1, rr_depth=2)},
        {"integrator": tr.PathTracer(max_depth=2), "sampler": "sobol"},
    ],
    ids=lambda settings: ", ".join(settings),
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_settings(settings, dtype):
    check(tr.load_dict(ball_and_wall(), dtype=dtype), **settings)


@pytest.mark.parametrize("name", sorted(media_scenes.SCENES))
def test_media(name):
    check(tr.load_dict(media_scenes.SCENES[name]().scene), spp=8)


def test_long_paths_through_media():
    # of several blocks of levels: the sweep traces the ones before the last again, once for all adjoints
    milk = {"type": "homogeneous", "sigma_t": 40.0, "albedo": 0.99}
    ball = {"type": "sphere", "radius": 0.5, "bsdf": {"type": "null"}, "interior": milk}
    check(tr.load_dict(ball_and_wall(ball=ball)), integrator=tr.VolumetricPathTracer(max_depth=400, rr_depth=400))


@pytest.mark.parametrize("bsdf", ["null", "dielectric"])
def test_light_that_bends(bsdf):
    check(gradientindex_scenes.seen(random_index(6), bsdf=bsdf))


def test_adaptive_samples_have_a_pass_for_each():
    check(tr.load_dict(ball_and_wall()), traced_once=False, adaptive_grad=True)


def test_light_paths_have_a_pass_for_each():
    description = ball_and_wall(integrator={"type": "ptracer", "max_depth": 3})
    description["sensor"]["film"]["rfilter"] = {"type": "gaussian"}
    check(tr.load_dict(description), traced_once=False)


def test_spectra():
    # the film's channels are sums over wavelengths, which adjoints are pulled through
    check(tr.load_dict(ball_and_wall(), variant="spectral"))


def test_pictures_that_are_no_renderings():
    scene = tr.load_dict(ball_and_wall())
    scene.train_only("red.*")
    red = scene.get_parameter("red.reflectance.value")
    for change in (torch.exp, lambda image: torch.stack([image, image]), lambda image: image.retain_grad() or image):
        image = change(tr.render(scene, spp=4, seed=3))
        adjoint, other = adjoints_of(image, 2)
        (expected,) = torch.autograd.grad(image, red, adjoint, retain_graph=True)
        (expected_other,) = torch.autograd.grad(image, red, other)
        red.grad = None
        image = change(tr.render(scene, spp=4, seed=3))
        ((found,),) = backward_and_grads(image, adjoint, [([red], other)])
        torch.testing.assert_close([red.grad, found], [expected, expected_other])


def test_parameters_that_follow_from_others():
    scene = tr.load_dict(ball_and_wall())
    texels = torch.rand(2, 2, 3, generator=torch.Generator().manual_seed(5)).requires_grad_()
    unused = torch.zeros(3, requires_grad=True)

    def rendered() -> torch.Tensor:
        finer = texels.repeat_interleave(2, 0).repeat_interleave(2, 1)
        return tr.render(scene, params={TEXELS: finer, COLOUR: finer[0, 0]}, spp=4, seed=3)

    image = rendered()
    adjoint, other = adjoints_of(image, 2)
    (expected,) = torch.autograd.grad(image, texels, adjoint, retain_graph=True)
    (expected_other,) = torch.autograd.grad(image, texels, other)
    ((found, nothing),) = backward_and_grads(rendered(), adjoint, [([texels, unused], other)])
    assert nothing is None and unused.grad is None
    check_close({"first": texels.grad, "other": found}, {"first": expected, "other": expected_other})
    assert backward_and_grads(rendered(), adjoint, []) == []
    check_close({"both": texels.grad}, {"both": 2 * expected})


def of_red(scene: tr.Scene, **settings) -> tuple[torch.Tensor, torch.Tensor]:
    scene.train_only("red.*")
    return scene.get_parameter("red.reflectance.value"), tr.render(scene, spp=4, seed=3, **settings)


def test_hooks_are_called():
    scene = tr.load_dict(ball_and_wall())
    red, image = of_red(scene)
    adjoint, other = adjoints_of(image, 2)
    (expected,) = torch.autograd.grad(image, red, adjoint, retain_graph=True)
    (expected_other,) = torch.autograd.grad(image, red, other)
    for hook in (lambda grad: 2 * grad, lambda grad: grad.mul_(2)):
        red, image = of_red(scene)
        red.grad, called = None, []
        image.register_hook(hook)
        image.grad_fn.register_hook(lambda *grads, called=called: called.append(grads) and None)
        ((found,),) = backward_and_grads(image, adjoint.clone(), [([red], other.clone())])
        torch.testing.assert_close([red.grad, found], [2 * expected, 2 * expected_other])
        assert len(called) == 2


def test_hooks_that_return_another_view_of_the_same_memory():
    scene = tr.load_dict(ball_and_wall(height=6, width=6))
    adjoint, other = adjoints_of(of_red(scene)[1], 2)
    for hook in (lambda grad: grad.transpose(0, 1), lambda grad: grad[..., :1].expand_as(grad)):
        red, image = of_red(scene)
        image.register_hook(hook)
        (expected,) = torch.autograd.grad(image, red, adjoint, retain_graph=True)
        (expected_other,) = torch.autograd.grad(image, red, other)
        red, image = of_red(scene)
        red.grad = None
        image.register_hook(hook)
        ((found,),) = backward_and_grads(image, adjoint, [([red], other)])
        torch.testing.assert_close([red.grad, found], [expected, expected_other])


def test_tensors_that_are_saved_elsewhere():
    scene = tr.load_dict(ball_and_wall())
    with torch.autograd.graph.saved_tensors_hooks(lambda t: t.clone(), lambda t: t):
        red, image = of_red(scene)
    adjoint, other = adjoints_of(image, 2)
    (expected_other,) = torch.autograd.grad(image, red, other, retain_graph=True)
    ((found,),) = backward_and_grads(image, adjoint, [([red], other)])
    torch.testing.assert_close(found, expected_other)
    assert red.grad is not None


def test_the_graph_is_freed_and_kept_hits_with_it():
    scene = tr.load_dict(ball_and_wall())
    red, image = of_red(scene, correlated=True)
    assert backends.core().hit_bytes_in_use() > 0
    adjoint, other = adjoints_of(image, 2)
    backward_and_grads(image, adjoint, [([red], other)])
    assert backends.core().hit_bytes_in_use() == 0
    with pytest.raises(RuntimeError, match="second time"):
        backward_and_grads(image, adjoint, [([red], other)])


def test_adjoints_that_are_one_tensor_or_do_not_fit():
    scene = tr.load_dict(ball_and_wall())
    red, image = of_red(scene)
    texels = scene.get_parameter(TEXELS).requires_grad_()
    image = tr.render(scene, spp=4, seed=3)
    adjoint = adjoints_of(image, 1)[0]
    expected = torch.autograd.grad(image, [red, texels], adjoint, retain_graph=True)
    (one,), (other,) = backward_and_grads(image, adjoint, [([red], adjoint), ([texels], adjoint)])
    torch.testing.assert_close((one, other), expected)
    torch.testing.assert_close((red.grad, texels.grad), expected)
    image = tr.render(scene, spp=4, seed=3)
    with pytest.raises(RuntimeError, match="ismatch in shape"):
        backward_and_grads(image, adjoint, [([red], adjoint[:2])])


def test_parameters_that_are_frozen_after_the_rendering():
    scene = tr.load_dict(ball_and_wall())
    red, image = of_red(scene)
    red.requires_grad_(False)
    assert backward_and_grads(image, torch.ones_like(image), []) == []
    assert red.grad is None


def test_edits_after_the_rendering_are_noticed():
    scene = tr.load_dict(ball_and_wall())
    scene.train_only("red.*")
    red = scene.get_parameter("red.reflectance.value")
    image = tr.render(scene, spp=1)
    with torch.no_grad():
        red += 0.1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        backward_and_grads(image, torch.ones_like(image), [([red], torch.ones_like(image))])
