"""A rendering among torch's derivatives: every mode that autograd has, and what raises a clear error."""

from __future__ import annotations

import pytest
import torch
from autograd_scene import make, picture, rand
from small_scene import COLOUR, TEXELS
from torch.autograd import forward_ad

import torchrender as tr

pytestmark = pytest.mark.once  # modes of autograd


@pytest.fixture(scope="module")
def scene():
    return make()


@pytest.fixture(scope="module")
def double():
    return make(dtype=torch.float64)


# ------------------------------------------------------------------------------------------------------------ modes
@pytest.mark.parametrize(("name", "shape", "fast"), [(COLOUR, (3,), False), (TEXELS, (4, 4, 3), True)])
def test_gradcheck(double, name, shape, fast):
    """Deterministic: both derivatives are of the same samples, with correlated=True."""
    value = rand(*shape, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda x: picture(double, x, name, correlated=True),
        (value,),
        check_forward_ad=True,
        check_undefined_grad=True,
        fast_mode=fast,
    )


def test_function_transforms_are_the_eager_derivatives(scene):
    value, tangent = rand(3), rand(3, seed=1)
    leaf = value.clone().requires_grad_()
    image = picture(scene, leaf)
    (expected,) = torch.autograd.grad(image.square().sum(), leaf)

    assert torch.equal(torch.func.grad(lambda x: picture(scene, x).square().sum())(value), expected)
    same, pull = torch.func.vjp(lambda x: picture(scene, x), value)
    assert torch.equal(same, image)
    assert torch.equal(pull(2 * image.detach())[0], expected)

    primal, derivative = torch.func.jvp(lambda x: picture(scene, x), (value,), (tangent,))
    assert torch.equal(primal, image)
    with forward_ad.dual_level():
        dual = picture(scene, forward_ad.make_dual(value, tangent))
        assert torch.equal(forward_ad.unpack_dual(dual).tangent, derivative)
    # Forward and reverse mode differentiate the same samples.
    torch.testing.assert_close((derivative * 2 * image.detach()).sum(), (expected * tangent).sum(), rtol=1e-4, atol=0)


def test_jacobians_row_by_row(scene):
    def mean(x):
        return picture(scene, x).mean((0, 1))

    value = rand(3)
    jacobian = torch.autograd.functional.jacobian(mean, value)
    assert torch.equal(torch.func.jacrev(mean, chunk_size=1)(value), jacobian)
    # Red light depends on the red albedo only.
    assert float(jacobian.diagonal().min()) > 0
    assert float((jacobian - jacobian.diagonal().diag()).abs().max()) == 0


@pytest.mark.parametrize(
    "batched",
    [
        lambda f, x: torch.func.vmap(f)(torch.stack([x, x])),
        lambda f, x: torch.func.jacrev(f)(x),
        lambda f, x: torch.func.jacfwd(f)(x),
        lambda f, x: torch.autograd.functional.jacobian(f, x, vectorize=True),
        lambda f, x: torch.autograd.grad(f(x.requires_grad_()), x, torch.ones(2, 6, 8, 3), is_grads_batched=True),
    ],
    ids=["vmap", "jacrev", "jacfwd", "vectorize", "is_grads_batched"],
)
def test_batches_of_torch_are_refused_in_words(scene, batched):
    with pytest.raises(
        tr.NotDifferentiableError, match=r"vmap does not reach.*loop over the inputs.*sensor=\[\.\.\.\]"
    ):
        batched(lambda x: picture(scene, x), rand(3))


@pytest.mark.parametrize("how", ["create_graph", "hessian", "grad of grad", "forward over reverse"])
def test_second_derivatives_are_refused_in_words(scene, how):
    def f(x):
        return picture(scene, x).square().sum()

    value = rand(3).requires_grad_()
    with pytest.raises(tr.NotDifferentiableError, match="first derivatives only"):
        if how == "create_graph":
            (gradient,) = torch.autograd.grad(f(value), value, create_graph=True)
            gradient.sum().backward()
        elif how == "hessian":
            torch.autograd.functional.hessian(f, value)
        elif how == "grad of grad":
            torch.func.grad(lambda x: torch.func.grad(f)(x).sum())(value.detach())
        else:
            torch.func.jvp(torch.func.grad(f), (value.detach(),), (torch.ones(3),))


# ------------------------------------------------------------------------------------------------------------ modes
def test_pixels_do_not_depend_on_the_mode(scene):
    plain = picture(scene)
    assert not plain.requires_grad
    scene.train_only("*.reflectance.*")
    try:
        recorded = picture(scene)
        with torch.no_grad():
            silent = picture(scene)
        with torch.inference_mode():
            inference = picture(scene)
        with torch.set_grad_enabled(False), torch.enable_grad():
            again = picture(scene)
    finally:
        scene.train_only()
    assert recorded.requires_grad and again.requires_grad and not silent.requires_grad
    assert inference.is_inference()
    for image in (recorded, silent, inference, again):
        assert torch.equal(image.detach(), plain)


def test_scene_made_in_inference_mode():
    with torch.inference_mode():
        scene = make()
        image = picture(scene)
        scene.lamp.intensity.value.mul_(2)
        brighter = picture(scene)
    assert torch.equal(picture(make()), image)
    assert not torch.equal(brighter, image)


def test_backward_twice_and_retain_graph(scene):
    value = rand(3).requires_grad_()
    loss = picture(scene, value).square().sum()
    (first,) = torch.autograd.grad(loss, value, retain_graph=True)
    (second,) = torch.autograd.grad(loss, value)
    assert torch.equal(first, second)
    with pytest.raises(RuntimeError, match="second time"):
        loss.backward()


def test_gradients_add_up_over_calls(scene):
    (colour,) = scene.train_only(COLOUR)
    try:
        singles = []
        for seed in (1, 2):
            singles.append(torch.autograd.grad(picture(scene, seed=seed).sum(), colour)[0])
        colour.grad = None
        for seed in (1, 2):
            picture(scene, seed=seed).sum().backward()
        assert torch.equal(colour.grad, singles[0] + singles[1])
    finally:
        colour.grad = None
        scene.train_only()


def test_hooks_and_retained_gradients(scene):
    value = rand(3).requires_grad_()
    image = picture(scene, value)
    image.retain_grad()
    image.register_hook(lambda g: 2 * g)
    image.sum().backward()
    assert torch.equal(image.grad, torch.full_like(image, 2.0))
    (expected,) = torch.autograd.grad(picture(scene, leaf := value.detach().requires_grad_()).sum(), leaf)
    torch.testing.assert_close(value.grad, 2 * expected)


def test_anomaly_detection(scene):
    value = rand(3).requires_grad_()
    with torch.autograd.detect_anomaly(check_nan=True):
        picture(scene, value).sum().backward()
    assert bool((value.grad > 0).all())


# ----------------------------------------------------------------------------------------------- autocast, dtypes
def test_autocast_changes_nothing(scene):
    (colour,) = scene.train_only(COLOUR)
    try:
        image = picture(scene)
        (gradient,) = torch.autograd.grad(image.sum(), colour)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            inside = picture(scene)
            (gradient_inside,) = torch.autograd.grad(inside.sum(), colour)
    finally:
        scene.train_only()
    assert inside.dtype == torch.float32
    assert torch.equal(inside, image) and torch.equal(gradient_inside, gradient)


def test_a_network_under_autocast(scene):
    torch.manual_seed(0)
    network = torch.nn.Linear(2, 3)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        colour = torch.sigmoid(network(torch.ones(2)))
        assert colour.dtype == torch.bfloat16
        image = picture(scene, colour)
    image.sum().backward()
    assert image.dtype == torch.float32
    assert network.weight.grad.dtype == torch.float32 and bool((network.weight.grad != 0).all())


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_gradients_have_the_dtype_of_what_was_given(scene, double, dtype):
    for renderer, expected in ((scene, torch.float32), (double, torch.float64)):
        value = torch.tensor([0.5, 0.25, 0.125], dtype=dtype, requires_grad=True)  # exact in all of them
        image = picture(renderer, value)
        image.sum().backward()
        assert image.dtype == expected and value.grad.dtype == dtype
        assert torch.equal(image.detach(), picture(renderer, value.detach().double()))


# --------------------------------------------------------------------------------------------------- torch.compile
@pytest.mark.parametrize("backend", ["eager", "aot_eager"])
def test_compiled_is_eager(backend):
    scene = make()
    renderer = tr.Renderer(scene, spp=2)
    network = torch.nn.Linear(2, 3)

    def step(inputs, seed):
        colour = torch.sigmoid(network(inputs))
        image = renderer(seed=seed, params={COLOUR: colour}) * 2
        return image.mean((0, 1))

    torch._dynamo.reset()
    compiled = torch.compile(step, backend=backend)
    for seed in (1, 2):
        results = []
        for function in (step, compiled):
            loss = function(torch.ones(2), seed)
            results.append((loss.detach(), *torch.autograd.grad(loss.sum(), list(network.parameters()))))
        assert all(torch.equal(a, b) for a, b in zip(*results))
    assert torch.equal(torch.compile(renderer, backend=backend)(seed=3), renderer(seed=3))


def test_compilation_breaks_the_graph_once():
    torch._dynamo.reset()
    scene = make()
    explained = torch._dynamo.explain(lambda x: picture(scene, torch.sigmoid(x)).square().mean())(rand(3))
    assert explained.graph_break_count == 1 and explained.graph_count == 2


def test_recorded_cuda_graphs_are_refused(scene, monkeypatch):
    """Where a card's stream records, which here is only said."""
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: True)
    rays = torch.zeros(1, 3), torch.ones(1, 3)
    for name, call in (
        ("render", lambda: tr.render(scene)),
        ("render", lambda: tr.Renderer(scene)()),
        ("ray_intersect", lambda: tr.ray_intersect(scene, *rays)),
        ("ray_occluded", lambda: tr.ray_occluded(scene, *rays)),
    ):
        with pytest.raises(RuntimeError, match=rf"^{name}: a CUDA graph is being recorded.* before torch\.cuda\.graph"):
            call()
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: False)
    assert tr.render(scene, spp=1).shape[2] == 3


def test_checkpointing(scene):
    """torch's checkpoints render again in backward(), with the random state of the first time."""
    from torch.utils.checkpoint import checkpoint

    def f(x):
        return picture(scene, x.sigmoid(), seed=None).square()

    results = []
    for call in (f, lambda x: checkpoint(f, x, use_reentrant=False)):
        torch.manual_seed(5)
        value = rand(3).requires_grad_()
        image = call(value)
        results.append((image.detach(), torch.autograd.grad(image.sum(), value)[0]))
    assert torch.equal(results[0][0], results[1][0]) and torch.equal(results[0][1], results[1][1])
