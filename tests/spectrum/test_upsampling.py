"""Spectra of colours: round trips, corners of the gamut, derivatives."""

from __future__ import annotations

import functools
import itertools

import fresh_python
import pytest
import torch

import torchrender as tr

sp = tr.spectrum
DOUBLE = torch.float64
CORNERS = torch.tensor(list(itertools.product([0.0, 1.0], repeat=3)), dtype=DOUBLE)
IMAGES = functools.partial(sp.upsample, exact=False)


def random(n: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(n, 3, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE)


def spectrum_of(sigmoids: torch.Tensor) -> torch.Tensor:
    return sigmoids[..., 3:] * sp.sigmoid(sigmoids[..., :3])


def colour_of(sigmoids: torch.Tensor) -> torch.Tensor:
    return sp.to_rgb(spectrum_of(sigmoids), sp.d65(sigmoids))


def linear(encoded: torch.Tensor) -> torch.Tensor:
    """Of colours that are evenly spread for the eye, darker ones."""
    return torch.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def test_sigmoids():
    c = torch.tensor([[0.0, 0, 0], [3, -1, 0.5], [0, 0, 1e4]], dtype=DOUBLE)
    table = sp.sigmoid(c)
    assert table.shape == (3, 471) and bool((table[0] == 0.5).all()) and float(table[2].min()) > 1 - 1e-8
    q = 3 * 0.25 - 0.5 + 0.5  # in the middle, at 595 nm
    assert float(table[1, 235]) == pytest.approx(0.5 + q / (2 * (1 + q * q) ** 0.5), abs=1e-14)
    assert torch.autograd.gradcheck(sp.sigmoid, c.requires_grad_(), check_forward_ad=True)


def test_constants_come_back():
    for colours in (random(100), linear(random(100, 1))):
        found = sp.upsample(colours)
        assert float((colour_of(found) - colours).abs().max()) < 1e-6
        assert torch.equal(found[:, :3], sp.rgb_to_coefficients(colours)) and bool((found[:, 3] == 1).all())
        assert float((colour_of(sp.upsample(colours.float())) - colours).abs().max()) < 1e-5


def test_images_come_back():
    """20000 random colours: 2.5e-3 at most and 9e-4 in 99 of 100, as with the table that Jakob and Hanika made."""
    colours = torch.cat([random(10000), linear(random(10000, 1))])
    for light, part in ((False, colours), (True, colours[9000:11000])):
        error = (colour_of(IMAGES(part, light=light)) - part).abs().amax(-1)
        assert float(error.max()) < 2.5e-3 and float(error.quantile(0.99)) < 9e-4
    assert float((IMAGES(part.float()) - IMAGES(part)).abs().mean()) < 1e-3


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("light", [True, False])
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_corners(exact, light, dtype):
    extreme = torch.tensor([[0.0, 0, 1e-30], [1, 1, 0.9995], [1, 0.999, 1], [1e-5, 0, 0], [3, 0, 0]], dtype=DOUBLE)
    colours = torch.cat([CORNERS, CORNERS / 2, extreme]).to(dtype).requires_grad_()
    found = sp.upsample(colours, exact=exact, light=light)
    assert bool(found.isfinite().all())
    back = (colour_of(found) - colours).detach().abs().amax(-1)
    assert float(back[:-1].max()) < 1e-3 and float(back[-1]) < 3e-3
    (gradient,) = torch.autograd.grad(spectrum_of(found).sum(), colours)
    assert bool(gradient.isfinite().all())


def test_out_of_range():
    inside, outside = torch.tensor([0.2, 0.0, 0.7], dtype=DOUBLE), torch.tensor([0.2, -0.5, 0.7], dtype=DOUBLE)
    for exact in (True, False):
        colours = outside.clone().requires_grad_()
        found = sp.upsample(colours, exact=exact)
        assert torch.equal(found.detach(), sp.upsample(inside, exact=exact))
        found.sum().backward()
        assert float(colours.grad[1]) == 0 and bool(colours.grad.isfinite().all())
    # of factors above 1 the scale is the largest channel, of light twice that
    bright = torch.tensor([0.5, 4.0, 1.0], dtype=DOUBLE)
    assert float(sp.upsample(bright)[3]) == 4 and float(sp.upsample(bright, light=True)[3]) == 8
    assert torch.allclose(colour_of(sp.upsample(bright)), bright, atol=1e-5)
    # light has one shape at any brightness
    shapes = sp.upsample(torch.stack([bright, 1000 * bright]), light=True)
    assert torch.allclose(shapes[0, :3], shapes[1, :3], rtol=1e-6, atol=0)


def test_lamps_that_are_off_can_be_lit():
    for exact in (True, False):
        colour = torch.zeros(3, dtype=DOUBLE, requires_grad=True)
        table = spectrum_of(sp.upsample(colour, exact=exact, light=True))
        assert float(table.detach().abs().max()) == 0
        (gradient,) = torch.autograd.grad(table[200], colour)
        assert gradient.tolist() == pytest.approx([1 / 3] * 3, abs=1e-3)


@pytest.mark.parametrize("light", [False, True])
def test_derivatives_of_constants(light):
    colours = torch.tensor([[0.3, 0.5, 0.2], [0.02, 0.01, 0.9], [0.97, 0.95, 0.92]], dtype=DOUBLE).requires_grad_()
    check = functools.partial(torch.autograd.gradcheck, eps=1e-5, atol=1e-6, rtol=2e-6)
    assert check(lambda c: sp.upsample(c, light=light), colours, check_forward_ad=True, check_batched_grad=True)
    table = torch.autograd.functional.jacobian(lambda c: colour_of(sp.upsample(c, light=light)), colours[0].detach())
    assert torch.allclose(table, torch.eye(3, dtype=DOUBLE), atol=1e-6)  # there and back is the identity


def test_derivatives_of_images():
    colours = (0.05 + 0.9 * random(6, 4)).requires_grad_()  # of the interpolation, whose cells are wide at this scale
    for light in (False, True):
        check = functools.partial(torch.autograd.gradcheck, eps=1e-7, atol=1e-4, rtol=1e-4, check_forward_ad=True)
        assert check(lambda c, light=light: IMAGES(c, light=light), colours)
    with pytest.raises(tr.NotDifferentiableError, match=r"torch\.func\.vmap does"):
        torch.autograd.grad(IMAGES(colours), colours, torch.ones(2, 6, 4, dtype=DOUBLE), is_grads_batched=True)


@pytest.mark.parametrize("exact", [True, False])
def test_vmap_and_jacobians(exact):
    colours = random(8, 2)

    def coefficients(c):
        return sp.upsample(c, exact=exact)

    together = coefficients(colours)
    assert torch.allclose(torch.vmap(coefficients)(colours), together, rtol=1e-9, atol=1e-9)
    assert torch.allclose(torch.vmap(coefficients, in_dims=1)(colours.T), together, rtol=1e-9, atol=1e-9)
    backward = torch.vmap(torch.func.jacrev(coefficients))(colours)
    forward = torch.vmap(torch.func.jacfwd(coefficients))(colours)
    assert torch.allclose(backward, forward, rtol=1e-8, atol=1e-9)


def test_shapes():
    image = random(12).reshape(2, 3, 2, 3)
    for exact in (True, False):
        found = sp.upsample(image, exact=exact)
        assert found.shape == (2, 3, 2, 4)
        assert torch.allclose(found.reshape(-1, 4), sp.upsample(image.reshape(-1, 3), exact=exact), rtol=1e-9)
        assert sp.upsample(image[:0], exact=exact).shape == (0, 3, 2, 4)


def test_mistakes_are_named():
    for function in (sp.upsample, sp.rgb_to_coefficients):
        with pytest.raises(ValueError, match=r"rgb: expected shape \(\.\.\., 3\).*\(2,\)"):
            function(torch.ones(2))
        with pytest.raises(TypeError, match=r"rgb: expected a floating-point tensor.*list"):
            function([1.0, 0.5, 0.2])
    with pytest.raises(ValueError, match=r"coefficients: expected shape \(\.\.\., 3\)"):
        sp.sigmoid(torch.ones(4))


def test_the_table_may_be_made_inside_of_a_transform():
    """In a program of its own, where nothing is made yet."""
    program = (
        "import sys, torch, torchrender as tr\n"
        "assert 'torchrender.spectrum.upsampling' not in sys.modules and 'torchrender.io' not in sys.modules\n"
        "sp, x = tr.spectrum, torch.tensor([0.3, 0.5, 0.2], dtype=torch.float64)\n"
        "first = torch.func.jacrev(sp.upsample)(x)\n"
        "with torch.inference_mode():\n"
        "    sp.rgb_to_coefficients(x)\n"
        "again = torch.autograd.functional.jacobian(sp.upsample, x)\n"
        "assert torch.allclose(first, again, rtol=1e-10, atol=1e-10)\n"
    )
    done = fresh_python.run(program)
    assert done.returncode == 0, done.stderr
