"""Many rays, which `trace` takes a block at a time: what comes out is that of all at once, derivatives too."""

from __future__ import annotations

import warnings

import pytest
import torch
from bent_scenes import BOX, DOUBLE, beam, direction_like, glass, number_of, random_index

import torchrender as tr
from torchrender.gradientindex import blocks

NAMES = (
    "interior.index",
    "interior.index_base",
    "interior.index_scale",
    "interior.ext_ior",
    "interior.to_world",
    "interior.sigma_t.data",
    "interior.emission.value.value",
    "center",
)


def foggy(dtype: torch.dtype = DOUBLE, **medium: object) -> tr.Scene:
    """A sphere of a medium that absorbs, more or less, and emits."""
    grid = 0.3 + 0.2 * torch.rand(3, 4, 5, 1, generator=torch.Generator().manual_seed(4), dtype=DOUBLE)
    fog = {"type": "gridvolume", "grid": grid, "to_world": BOX}
    ball = {"type": "sphere", "center": [0.05, -0.02, 0.04], "radius": 0.9}
    index = random_index(8) - 1.5
    return glass(
        index, "dielectric", dtype, shape=ball, index_base=1.5, sigma_t=fog, emission=0.4, ext_ior=1.1, **medium
    )


def rays_and_parameters(scene: tr.Scene) -> dict[str, torch.Tensor]:
    """Those of a wide beam, in which some rays miss the sphere, and behind it 20 that all do."""
    o, d = beam(90, width=2.4)
    given = {"origins": torch.cat([o, o[:20] + 9.0]), "directions": torch.cat([d, d[:20]])}
    given = {name: rays.to(scene.dtype) for name, rays in given.items()}
    return given | {f"lens.{name}": scene.get_parameter(f"lens.{name}").detach() for name in NAMES}


def trace(scene: tr.Scene, given: dict[str, torch.Tensor]) -> tr.gradientindex.BentRays:
    params = {name: value for name, value in given.items() if "." in name}
    return tr.gradientindex.trace(scene, "lens", given["origins"], given["directions"], params=params)


def gradients(scene: tr.Scene, given: dict[str, torch.Tensor], wanted=None) -> list[torch.Tensor]:
    leaves = {name: value.clone().requires_grad_(wanted is None or name in wanted) for name, value in given.items()}
    asked = [leaf for leaf in leaves.values() if leaf.requires_grad]
    return list(torch.autograd.grad(number_of(trace(scene, leaves)), asked))


@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
def test_the_same_as_all_at_once(interpolation, monkeypatch):
    """Rays bit for bit; sums over rays to rounding, also of single parameters, and of blocks that all miss."""
    scene = foggy(interpolation=interpolation)
    given = rays_and_parameters(scene)
    whole, expected = trace(scene, given), gradients(scene, given)
    assert 40 < int(whole.valid.sum()) < 85 and not bool(whole.valid[90:].any())
    monkeypatch.setattr(blocks, "BLOCK", 16)
    assert all(torch.equal(a, b) for a, b in zip(trace(scene, given), whole))
    for name, found, wanted in zip(given, gradients(scene, given), expected):
        scale = float(wanted.abs().max())
        assert scale > 1e-3, name
        assert torch.allclose(found, wanted, rtol=1e-11, atol=1e-13 * scale), name
        (alone,) = gradients(scene, given, [name])
        assert torch.allclose(alone, found, rtol=1e-11, atol=1e-13 * scale), name


def test_forward_mode_and_transforms(monkeypatch):
    """These take all rays at once: a gradient by `torch.func`, and tangents."""
    scene = foggy()
    given = rays_and_parameters(scene)
    along = {name: direction_like(value, seed=k) for k, (name, value) in enumerate(given.items())}
    along["lens.interior.to_world"] = torch.zeros(4, 4, dtype=DOUBLE)  # the length of steps counts as constant
    monkeypatch.setattr(blocks, "BLOCK", 16)
    reverse = gradients(scene, given)
    _, forward = torch.func.jvp(lambda x: number_of(trace(scene, x)), (given,), (along,))
    by_functions = torch.func.grad(lambda x: number_of(trace(scene, x)))(given)
    total = sum(float((g * along[name]).sum()) for name, g in zip(given, reverse))
    assert float(forward) == pytest.approx(total, rel=1e-10)
    for (name, wanted), found in zip(by_functions.items(), reverse):
        assert torch.allclose(found, wanted, rtol=1e-10, atol=1e-12 * float(wanted.abs().max())), name


def test_again_and_on_other_threads(monkeypatch):
    """A graph that is kept gives its gradient twice, each time from nothing, by however many threads there are then."""
    scene = foggy(dtype=torch.float32)
    given = rays_and_parameters(scene)
    monkeypatch.setattr(blocks, "BLOCK", 16)
    leaf = given["lens.interior.index"].clone().requires_grad_()
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        number = number_of(trace(scene, {**given, "lens.interior.index": leaf}))
        found = []
        for threads in (1, 4, 1):
            torch.set_num_threads(threads)
            found += torch.autograd.grad(number, leaf, retain_graph=True)
    finally:
        torch.set_num_threads(before)
    assert torch.equal(found[0], found[2])
    assert torch.allclose(found[0], found[1], rtol=1e-4, atol=1e-5 * float(found[0].abs().max()))


def test_a_gradient_is_not_differentiated_again(monkeypatch):
    monkeypatch.setattr(blocks, "BLOCK", 16)
    scene = foggy()
    given = rays_and_parameters(scene)
    leaf = given["lens.interior.index"].clone().requires_grad_()
    number = number_of(trace(scene, {**given, "lens.interior.index": leaf}))
    (gradient,) = torch.autograd.grad(number, leaf, create_graph=True)
    with pytest.raises(tr.NotDifferentiableError, match="first derivatives only"):
        gradient.square().sum().backward()


def test_warnings_are_of_all_blocks(monkeypatch):
    """One for all, and none when derivatives are asked for."""
    monkeypatch.setattr(blocks, "BLOCK", 16)
    index = torch.full((16, 16, 16), 1.5)
    with pytest.warns(tr.RangeWarning, match="40 of 40 rays took more than max_steps steps") as caught:
        tr.gradientindex.trace(glass(index, max_steps=15), "lens", *beam(40))
    assert len(caught) == 1
    rough = random_index(8, 0.3).clamp(min=1).requires_grad_()
    with pytest.warns(tr.RangeWarning, match=r"\|p\| / n.*is off by") as caught:
        found = tr.gradientindex.trace(glass(1.5, "null"), "lens", *beam(50), params={"lens.interior.index": rough})
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        number_of(found).backward()
    assert rough.grad is not None and bool(rough.grad.any())
