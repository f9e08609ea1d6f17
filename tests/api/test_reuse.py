"""Pictures and gradients that are made of what earlier calls have found: `Renderer(reuse=)`."""

from __future__ import annotations

import copy
import io
import pickle
import warnings

import pytest
import torch
from small_scene import COLOUR, TEXELS, ball_and_wall
from torch.nn.utils import parametrize

import torchrender as tr
from torchrender import recursion
from torchrender.recursion import Recursion
from torchrender.testing import z_test

CAMERA = {
    "type": "perspective",
    "to_world": tr.Transform.look_at([1, 0, 4], [0, 0, 0]),
    "film": {"type": "hdrfilm", "width": 8, "height": 6, "rfilter": {"type": "box"}},
}


def make(**settings) -> tr.Scene:
    scene = tr.load_dict(ball_and_wall(other=CAMERA), **settings)
    scene.train_only(COLOUR, TEXELS)
    return scene


def change(scene: tr.Scene, step: int) -> None:
    """Parameters of a step, whatever was found before."""
    with torch.no_grad():
        scene.get_parameter(COLOUR).copy_(torch.tensor([0.6, 0.1, 0.1]) * (1 + 0.05 * step))
        scene.get_parameter(TEXELS).fill_(0.5 - 0.03 * step)


def gradients(scene: tr.Scene, picture: torch.Tensor, target: float = 0.3) -> list[torch.Tensor]:
    loss = (picture - target).square().mean()
    return list(torch.autograd.grad(loss, [scene.get_parameter(name) for name in (COLOUR, TEXELS)]))


def after(steps: int, count: int, growth: float = 1.01, same: bool = False) -> tuple[torch.Tensor, Recursion]:
    """`count` estimates, after so many steps, of a number that grows: of skewed numbers, divided by what is right.

    F differs from H by `growth` and by noise of its own. `same`: both chains have the same numbers.
    """
    generator = torch.Generator().manual_seed(5)

    def numbers() -> tuple[torch.Tensor, torch.Tensor]:
        u, v = torch.rand(2, count, generator=generator, dtype=torch.float64)
        h = u.log().square() / 2  # its mean is 1, its variance 5
        return growth * h * (1 + 0.4 * (v - 0.5)), h

    found, state = torch.empty(0), Recursion()
    for step in range(steps):
        first = numbers()
        fresh, old = zip(first, first if same else numbers(), strict=True)
        scaled = [[growth ** (step - 1) * value for value in values] for values in (fresh, old)]
        found, state = state.step(scaled[0], scaled[1] if step else None)
    return found / growth ** (steps - 1), state


def test_the_expectation_stays_after_many_steps(monkeypatch):
    """Each number has a weight of its own, which is where weights hang most on samples. 5 standard errors: 6e-7.

    Where both chains have the same numbers, weights do depend on the noise: a bias that this test sees.
    """
    monkeypatch.setattr(recursion, "BLOCK", 1)
    found, _ = after(10, 30_000)
    assert abs(float(found.mean()) - 1) < 5 * float(found.std()) / 30_000**0.5
    biased, _ = after(10, 30_000, same=True)
    assert abs(float(biased.mean()) - 1) > 10 * float(biased.std()) / 30_000**0.5


def test_variance_falls_where_little_changes():
    """To that of a mean over all steps if nothing does; 25 % are 5 standard errors of the first variance."""
    found, state = after(1, 20_000, 1.0)
    plain = float(found.var())
    generator = torch.Generator().manual_seed(6)
    for _ in range(9):
        fresh = [torch.rand(20_000, generator=generator, dtype=torch.float64).log().square() / 2 for _ in range(2)]
        found, state = state.step(fresh, fresh)
    assert float(found.var()) == pytest.approx(plain / 10, rel=0.25)
    changing, state = after(30, 20_000)
    assert float(changing.var()) < 0.4 * plain
    # what chains believe of themselves: each has twice the variance of their mean, and changes count as noise
    believed = torch.stack([chain.variance.mean() for chain in state.chains]).mean() / 1.01 ** (2 * 29)
    assert 0.8 * float(changing.var()) < float(believed) / 2 < 1.6 * float(changing.var())


@pytest.mark.parametrize("count", [1, 5, 768, 1000, 1536])
def test_blocks_of_any_number(count):
    values = torch.arange(count, dtype=torch.float64)
    means = recursion.block_means(values)
    expected = [part.mean() for part in values.split(recursion.BLOCK)]
    assert torch.allclose(means, torch.stack(expected))
    blocks = [mean.expand(len(part)) for mean, part in zip(means, values.split(recursion.BLOCK), strict=True)]
    assert torch.equal(recursion.spread_blocks(means, count), torch.cat(blocks))


@pytest.fixture(scope="module")
def runs() -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
    """Last pictures and gradients (runs, numbers) of runs of five steps, by kind of reuse."""
    scene, found = make(), {}
    for kind in (None, "image", "both"):
        pictures, grads = [], []
        for run in range(60):
            renderer = tr.Renderer(scene, spp=2, reuse=kind)
            for step in range(0 if kind else 4, 5):
                change(scene, step)
                picture = renderer(seed=1000 * run + step)
                gradient = gradients(scene, picture)
            pictures.append(picture.detach().flatten())
            grads.append(torch.cat([g.flatten() for g in gradient]))
        found[kind or "plain"] = torch.stack(pictures).double(), torch.stack(grads).double()
    return found


@pytest.mark.parametrize("kind", ["image", "both"])
def test_pictures_and_gradients_keep_their_expectation(runs, kind):
    """After five steps, against the same parameters and many samples; significance 0.001 for all numbers of each."""
    scene = make()
    change(scene, 4)
    pictures = [tr.render(scene, spp=64, seed=seed) for seed in range(30)]
    true = [torch.stack([picture.detach().flatten() for picture in pictures]).double()]
    true.append(torch.stack([torch.cat([g.flatten() for g in gradients(scene, p)]) for p in pictures]).double())
    for found, many in zip(runs[kind], true, strict=True):
        result = z_test(
            found.mean(0),
            many.mean(0),
            variance=found.var(0) / len(found),
            reference_variance=many.var(0) / len(many),
            significance=0.001,
            atol=1e-6,
        )
        assert result, result.message


def test_pictures_and_gradients_have_less_variance(runs):
    """Means over all numbers: their ratios are known to a few percent."""
    picture, gradient = ({kind: float(r[i].var(0).mean()) for kind, r in runs.items()} for i in range(2))
    assert picture["image"] < 0.35 * picture["plain"]
    assert picture["both"] < 0.35 * picture["plain"]
    assert gradient["image"] < 0.9 * gradient["plain"]
    assert gradient["both"] < 0.5 * gradient["plain"]


def steps(renderer: tr.Renderer, numbers: range, **settings) -> list[torch.Tensor]:
    """The last picture and its gradients."""
    for step in numbers:
        change(renderer.scene, step)
        picture = renderer(seed=step, **settings)
        found = gradients(renderer.scene, picture)
    return [picture.detach(), *found]


def same(found: list[torch.Tensor], expected: list[torch.Tensor]) -> bool:
    return all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("kind", ["image", "both"])
def test_a_run_that_goes_on_finds_the_same_bits(kind):
    whole = tr.Renderer(make(), spp=2, reuse=kind)
    steps(whole, range(3), sensor=1, view="evening")
    file = io.BytesIO()
    torch.save(whole.state_dict(), file)
    copies = [copy.deepcopy(whole), pickle.loads(pickle.dumps(whole))]
    expected = steps(whole, range(3, 5), sensor=1, view="evening")
    file.seek(0)
    other = tr.Renderer(make(), spp=2, reuse=kind)
    other.load_state_dict(torch.load(file, weights_only=True))
    for renderer in (other, *copies):
        assert same(steps(renderer, range(3, 5), sensor=1, view="evening"), expected)
    anew = tr.Renderer(make(), spp=2, reuse=kind)
    assert not same(steps(anew, range(3, 5), sensor=1, view="evening"), expected)
    with pytest.raises(ValueError, match=r"reuse is '\w+', but the state that is loaded has"):
        tr.Renderer(make(), reuse="image" if kind == "both" else "both").load_state_dict(whole.state_dict())


def test_a_renderer_without_reuse_has_no_state():
    renderer = tr.Renderer(make())
    assert renderer.memory is None
    assert not [name for name in renderer.state_dict() if "memory" in name]
    renderer.reset()
    assert torch.equal(renderer(seed=1, view=3), renderer(seed=1))


def test_plain_pictures_where_nothing_is_learned():
    """Without derivatives, in evaluation, and in forward mode; what is known stays."""
    scene = make()
    renderer, untouched = (tr.Renderer(scene, spp=2, reuse="image") for _ in range(2))
    for layer in (renderer, untouched):
        steps(layer, range(2))
    plain = tr.render(scene, spp=2, seed=9)
    with torch.no_grad():
        assert torch.equal(renderer(seed=9), plain)
    renderer.eval()
    assert torch.equal(renderer(seed=9), plain)
    renderer.train()
    value = scene.get_parameter(COLOUR).detach().clone()
    out, _ = torch.func.jvp(lambda x: renderer(seed=9, params={COLOUR: x}), (value,), (torch.ones(3),))
    assert torch.equal(out, plain)
    assert torch.equal(torch.func.vjp(lambda x: renderer(seed=9, params={COLOUR: x}), value)[0], plain)
    assert same(steps(renderer, range(2, 3)), steps(untouched, range(2, 3)))


def test_views_are_kept_apart():
    """Of cameras, alone or in a list, and of names."""
    scene = make()
    renderer, alone = (tr.Renderer(scene, spp=2, reuse="both") for _ in range(2))
    for step in range(3):
        change(scene, step)
        batch = renderer(sensor=[0, 1], seed=step, layout="bchw")
        single = [alone(sensor=i, seed=step) for i in range(2)]
        assert batch.shape == (2, 3, 6, 8)
        for view, picture in zip(batch, single, strict=True):
            assert torch.equal(view, picture.permute(2, 0, 1))
        found = gradients(scene, batch)
        expected = [gradients(scene, picture) for picture in single]
        for a, b in zip(found, (sum(pair) / 2 for pair in zip(*expected, strict=True)), strict=True):
            assert torch.allclose(a, b, atol=1e-7)
    assert torch.equal(renderer(seed=7, view="new"), tr.Renderer(scene, spp=2, reuse="both")(seed=7))
    assert not torch.equal(renderer(seed=7), tr.Renderer(scene, spp=2, reuse="both")(seed=7))


def test_parameters_that_are_given_are_kept():
    """A lamp at other places, and outputs of a network."""
    scene = make()
    renderer = tr.Renderer(scene, spp=2, reuse="both")
    colour = torch.tensor([0.5, 0.2, 0.2], requires_grad=True)
    for step in range(3):
        params = {COLOUR: colour * (1 + 0.1 * step), "sky.radiance.value": torch.ones(3)}
        renderer(seed=step, params=params).mean().backward()
    assert colour.grad is not None and float(colour.grad.abs().sum()) > 0
    (view,) = renderer.memory.views.values()
    assert torch.equal(view.params[COLOUR], colour.detach() * 1.2)
    assert "sky.radiance.value" in view.params


def test_parameters_that_follow_from_others():
    """What is kept is what was rendered; gradients reach what it follows from."""
    scene = make()
    parametrize.register_parametrization(scene.red.reflectance, "value", tr.constraints.UnitInterval())
    renderer = tr.Renderer(scene, spp=2, reuse="both")
    for step in range(2):
        renderer(seed=step).mean().backward()
    (view,) = renderer.memory.views.values()
    assert torch.equal(view.params[COLOUR], scene.red.reflectance.value)
    (learned,) = scene.red.reflectance.parametrizations["value"].parameters()
    assert float(learned.grad.abs().sum()) > 0


@pytest.mark.parametrize("settings", [{"pixels": torch.tensor([[0, 1], [5, 7]])}, {"integrator": "ptracer"}])
def test_parts_of_films_and_light_paths(settings):
    lamp = {"type": "point", "position": [0, 1, 3], "intensity": 3.0}
    scene = tr.load_dict(ball_and_wall(lamp=lamp))
    scene.train_only(COLOUR)
    renderer = tr.Renderer(scene, spp=2, reuse="both", **settings)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for step in range(3):
            picture = renderer(seed=step)
            picture.mean().backward()
    assert picture.shape == tr.render(scene, spp=2, **settings).shape


def test_gradients_of_several_backward_passes():
    """One of a picture goes on; the next ones are those of its samples. Pictures without one begin anew."""
    scene = make()
    renderer, other = (tr.Renderer(scene, spp=2, reuse="both") for _ in range(2))
    for layer in (renderer, other):
        steps(layer, range(2))
    change(scene, 2)
    wanted = [scene.get_parameter(TEXELS)]
    loss = renderer(seed=2).square().mean()
    first, second = (torch.autograd.grad(loss, wanted, retain_graph=True)[0] for _ in range(2))
    assert not torch.equal(first, second)
    assert torch.equal(first, torch.autograd.grad(other(seed=2).square().mean(), wanted)[0])
    renderer(seed=3)  # and no backward()
    found = torch.autograd.grad(renderer(seed=4).square().mean(), wanted)[0]
    assert torch.isfinite(found).all()


CHANGES = {
    "the scene": lambda scene: scene.__setitem__("more", {"type": "sphere", "center": [0, 1, 0], "radius": 0.1}),
    "another parameter": lambda scene: scene.get_parameter("sky.radiance.value").mul_(2),
    "what is learned or given": lambda scene: scene.train_only(COLOUR),
    "the film": lambda scene: setattr(scene.sensor.film, "width", 9),
    "the integrator": lambda scene: setattr(scene, "integrator", tr.PathTracer(max_depth=2)),
}


@pytest.mark.parametrize("what", CHANGES)
def test_what_changes_is_estimated_anew(what):
    """It is said once; and not at all after `reset`."""
    scene = make()
    renderer, told = (tr.Renderer(scene, spp=2, reuse="image") for _ in range(2))
    for layer in (renderer, told):
        layer(seed=0)
    with torch.no_grad():
        CHANGES[what](scene)
    with pytest.warns(
        UserWarning, match=rf"reuse: since the last picture of a view .*{what}.* changed; it is estimated anew"
    ):
        found = renderer(seed=1)
    assert torch.equal(found, tr.Renderer(scene, spp=2, reuse="image")(seed=1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        renderer(seed=2, crop=(0, 0, 2, 2))
        told.reset()
        assert torch.equal(told(seed=1), found)


def test_normals_that_follow_from_positions_are_no_change():
    mesh = tr.Mesh([[-1.0, -1, 0.1], [1, -1, 0.1], [0, 1, 0.2]], [[0, 1, 2]])
    scene = tr.load_dict(ball_and_wall(mesh=mesh))
    (positions,) = scene.train_only("mesh.vertex_positions")
    renderer = tr.Renderer(scene, spp=2, reuse="both", visibility=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for step in range(3):
            renderer(seed=step).mean().backward()
            with torch.no_grad():
                positions += 0.01
    assert positions.grad is not None


def test_double_precision():
    renderer = tr.Renderer(make(dtype=torch.float64), spp=2, reuse="both")
    picture, *found = steps(renderer, range(3))
    assert picture.dtype == found[0].dtype == torch.float64


BAD = [
    ({"reuse": "images"}, ValueError, "reuse: unknown kind 'images'; did you mean 'image'"),
    ({"reuse": True}, TypeError, "reuse: expected 'image' or 'both' or None, got True"),
    ({"spp": 3}, ValueError, "reuse: spp has to be even, for samples come in two halves; got 3"),
    ({"reuse": "both", "spp_grad": 1}, ValueError, "reuse: spp_grad has to be even"),
    ({"outputs": ("rgb", "depth")}, ValueError, "reuse: .* leave outputs out"),
    ({"integrator": {"type": "aov", "aovs": "dd:depth"}}, ValueError, "reuse: .* without further outputs"),
    ({"correlated": True}, ValueError, "reuse: correlated=True"),
    ({"on_interrupt": "return"}, ValueError, "reuse: .* leave on_interrupt out"),
    ({"reuse": "both", "adaptive_grad": True}, ValueError, "reuse='both' .* reuse='image' goes with it"),
]


@pytest.mark.parametrize(("settings", "error", "message"), BAD)
def test_what_is_not_reused_is_refused(settings, error, message):
    """When the layer is made, and when it is called."""
    scene = make()
    with pytest.raises(error, match=message):
        tr.Renderer(scene, **{"reuse": "image", **settings})
    kind = settings.pop("reuse", "image")
    if settings:
        with pytest.raises(error, match=message):
            tr.Renderer(scene, reuse=kind)(**settings)


def test_what_a_call_cannot_have_is_refused():
    scene = make()
    renderer = tr.Renderer(scene, spp=2, reuse="image")
    camera = tr.PerspectiveCamera.look_at([0, 0, 4], [0, 0, 0], size=(6, 8))
    with pytest.raises(ValueError, match="pictures of the scene's own cameras are reused"):
        renderer(sensor=camera)
    with pytest.raises(ValueError, match="params: a list has a mapping for each sensor"):
        renderer(sensor=[0, 1], params=[{}])
    for _ in range(2):  # with and without a past
        with pytest.raises(ValueError, match="the scene has no parameter 'rad'"):
            renderer(params={"rad": torch.ones(3)})
        renderer(seed=0)
    scene.sensor.sampler.sample_count = 5
    with pytest.raises(ValueError, match="spp has to be even"):
        tr.Renderer(scene, reuse="image")()
