"""Participating media: what has to look the same, settings of the integrator, and what must not change a result.

Means of renderings are compared by Student's test, which a right renderer fails with probability
`media_truth.SIGNIFICANCE` each; seeds are fixed.
"""

from __future__ import annotations

import itertools

import media_scenes as ms
import media_truth as truth
import numpy as np
import pytest
import torch
from instruction_sets import assert_equal_means
from media_objects import DOUBLE, cloud, colour, lamp, random_grid, sky
from media_truth import assert_mean, difference_of_means, lines, pencil, scene, seen
from oracle.film import camera_samples
from oracle.media import MEDIA, NOTHING, Tracer
from oracle.phases import PHASES
from oracle.world import World

import torchrender as tr
from torchrender.wavefront.volumes import VOLUMES


# ---------------------------------------------------------------------------------------- equal media, equal renderings
def test_homogeneous_and_equal_grid():
    plain = cloud()
    for kind, medium in {
        "homogeneous": {"type": "homogeneous"},
        "grid": {
            "sigma_t": ms.grid(np.full((3, 2, 4, 1), 2.0, np.float32), ms.scale(3) @ ms.translate(-0.5, -0.5, -0.5))
        },
        "albedo": {"albedo": ms.grid(np.tile(np.float32([0.9, 0.8, 0.5]), (2, 3, 2, 1)), np.eye(4))},
        "scale": {"sigma_t": 0.5, "scale": 4.0},
    }.items():
        objects = cloud(**medium)
        objects["ball"]["interior"].update(medium)
        difference_of_means(seen(scene(plain), seed=1), seen(scene(objects), seed=2), kind)


def test_coloured_extinction_and_three_grey_ones():
    values = [0.4, 1.5, 5.0]
    for data in (None, random_grid(18, (3, 3, 3, 3), high=6.0)):
        coloured = seen(scene(cloud(sigma_t=colour(values) if data is None else data)), seed=1)
        for c in range(3):
            grey = values[c] if data is None else {**data, "data": data["data"][..., c : c + 1]}
            difference_of_means(coloured[..., c], seen(scene(cloud(sigma_t=grey)), seed=5 + c)[..., c], f"channel {c}")


def test_mono_and_grey_rgb():
    objects = cloud(albedo=0.8)
    objects["sky"] = sky(0.5)
    difference_of_means(
        seen(scene(objects), seed=1)[..., :1], seen(scene(objects, variant="mono"), seed=2), "mono and rgb"
    )


# ------------------------------------------------------------------------------------------------------------- settings
def test_max_depth():
    """Depth 1 is what comes straight, depth 2 single scattering, and more is added until nothing is."""
    objects = cloud()
    origins, targets = lines(3, 17)
    exact = scene(objects, dtype=DOUBLE)
    straight = truth.transmittance(exact, origins, targets) * torch.tensor([0.3, 0.5, 0.7])
    assert float(tr.render(scene(objects, 0), spp=4, seed=1).abs().max()) == 0.0
    assert_mean(seen(scene(objects, 1)), straight)
    means = [seen(scene(objects, depth, 1000), spp=64).mean(0) for depth in (1, 2, 3, 6, 40, -1)]
    for less, more in itertools.pairwise(means[:-1]):
        assert bool((more > less).all())
    torch.testing.assert_close(means[-1], means[-2], rtol=0.02, atol=0)
    # the series of orders is that of the plain simulation
    world = World(exact)
    _, rays, _, _ = camera_samples(world, 3, 8, 0)
    plain = Tracer(world, 3, 4).trace(*rays[:2], NOTHING)
    difference_of_means(seen(scene(objects, 3), spp=16)[:, 0], plain, "depth 3")


def test_hide_emitters():
    """Emitters are hidden behind media and null boundaries as well; what media scatter remains."""
    objects = cloud()
    objects["lamp"] = lamp((0.0, 0.0, -3.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0), 2.0)
    objects["camera3"] = pencil([0.0, 0.0, 4.0], [0.0, 0.0, 0.0], 24)
    origins, targets = lines(3, 17)
    origins, targets = np.append(origins, [[0, 0, 4.0]], 0), np.append(targets, [[0, 0, 0.0]], 0)
    assert float(seen(scene(objects, 1, hide_emitters=True)).abs().max()) == 0.0
    exact = scene(objects, dtype=DOUBLE)
    light = torch.tensor([[0.3, 0.5, 0.7]] * 3 + [[2.0, 2.0, 2.0]], dtype=DOUBLE)
    through = truth.transmittance(scene(cloud(), dtype=DOUBLE), origins, targets)
    visible, hidden = seen(exact, seed=1), seen(scene(objects, hide_emitters=True), seed=2)
    difference_of_means(visible, hidden + through * light, "hidden")


def test_alpha():
    """Coverage of a medium is what it takes from light behind, that of a surface in it 1."""
    objects = cloud()
    objects["stone"] = {"type": "sphere", "radius": 0.3, "center": [0, 3.0, 0]}
    objects["camera3"] = pencil([0.0, 3.0, 4.0], [0.0, 3.0, 0.0], 24)
    objects["camera4"] = pencil([0.0, 6.0, 4.0], [0.0, 6.0, 0.0], 24)
    origins, targets = lines(3, 17)
    view = scene(objects)
    settings = {"sampler": "independent", "outputs": ("rgb", "alpha")}
    alpha = tr.render(view, spp=32, seed=1, sensor=[0, 1, 2, 3, 4], **settings).alpha.double()
    through = truth.transmittance(scene(objects, dtype=DOUBLE), origins, targets)[:, :1]
    expected = torch.cat([1 - through, torch.tensor([[1.0], [0.0]])])
    assert_mean(alpha.flatten(1).T[..., None], expected)


# ---------------------------------------------------------------------------------------- what must not change a result
def image_and_gradient(name: str, **settings) -> tuple[torch.Tensor, torch.Tensor]:
    view = tr.load_dict(ms.SCENES[name]().scene, **settings)
    words = ("medium.sigma_t", "medium.albedo", "phase_function.g", "reflectance", "radiance", "sky.data")
    names = [n for n, _ in view.named_parameters() if any(w in n for w in words) and not n.endswith("to_world")]
    parameters = view.train_only(*names)
    image = tr.render(view, spp=4, seed=3)
    gradients = torch.autograd.grad(image.square().mean(), parameters)
    return image.detach().double(), torch.cat([g.double().flatten() for g in gradients])


def most_agree(a: torch.Tensor, b: torch.Tensor, share: float, rtol: float = 1e-3) -> bool:
    """Paths are the same up to rounding; a few decide otherwise."""
    scale = b.abs().mean()
    return bool(((a - b).abs() <= rtol * (b.abs() + scale)).double().mean() >= share)


@pytest.mark.parametrize("name", list(ms.SCENES))
def test_precision_packets_and_threads(name, monkeypatch):
    single = image_and_gradient(name)
    double = image_and_gradient(name, dtype=DOUBLE)
    assert most_agree(single[0], double[0], 0.95)
    torch.testing.assert_close(single[1].sum(), double[1].sum(), rtol=0.05, atol=1e-6)
    kept = torch.get_num_threads()
    results = []
    try:
        for threads in (1, 2, 2, 5):
            torch.set_num_threads(threads)
            results.append(image_and_gradient(name))
    finally:
        torch.set_num_threads(kept)
    for image, _ in results:
        assert torch.equal(image, results[0][0])
    assert torch.equal(results[1][1], results[2][1])
    torch.testing.assert_close(results[0][1], results[1][1], rtol=1e-3, atol=1e-3 * float(results[0][1].abs().max()))
    monkeypatch.setattr(tr.backends, "PACKETS", False)
    numbers = image_and_gradient(name)
    assert most_agree(single[0], numbers[0], 0.95)
    torch.testing.assert_close(single[1].sum(), numbers[1].sum(), rtol=0.05, atol=1e-6)


def test_instruction_sets():
    """Each compiled instruction set gives the same images up to rounding, which turns few paths to others."""
    assert_equal_means("media_scenes", spp=8, rtol=5e-3)


def test_scenes_contain_every_model():
    """What has an entry in the oracle is in a picture: those of surfaces are tested in test_oracle.py."""
    used = set()
    for make in ms.SCENES.values():
        objects = tr.load_dict(make().scene).layout().objects
        used |= {(category, row[0]) for category in ("volume", "phase", "medium") for row in objects[category]}
    entries = {"volume": VOLUMES, "phase": PHASES, "medium": MEDIA}
    assert used == {(category, kind) for category, kinds in entries.items() for kind in kinds}
