"""A rendering by the path tracer in PyTorch in place of the native one, and how the two are compared."""

from __future__ import annotations

import warnings

import torch

import torchrender as tr

SPP = 4
RTOL = 1e-9  # of the largest number of an image or gradient,
ATOL = 1e-15  # since derivatives may cancel to zero


class InTorch(tr.WavefrontPathTracer):
    """A native integrator in PyTorch; chunks divide pixels."""

    def __init__(self, own: tr.integrators.Integrator) -> None:
        super().__init__(chunk=1000)
        self.own = own

    def config(self) -> dict:
        settings, own = super().config(), getattr(self, "own", None)
        return settings if own is None else {**settings, **own.config(), "integrator": settings["integrator"]}


def assert_equal(found: torch.Tensor, expected: torch.Tensor, what: str) -> None:
    scale = float(expected.detach().abs().max())
    difference = float((found - expected).detach().abs().max())
    assert difference <= RTOL * scale + ATOL, f"{what}: {difference:.3g} of {scale:.3g}"


def differentiable(scene: tr.Scene) -> dict[str, torch.Tensor]:
    """Values of the parameters that have a derivative, by one of their names."""
    layout = scene.layout()
    first = {i: n for n, i in reversed(layout.by_name.items())}
    names = [n for i, n in first.items() if not layout.slots[i].refusal]
    return {n: scene.get_parameter(n).detach().clone() for n in names}


def render(scene: tr.Scene, values: dict[str, torch.Tensor], **more) -> torch.Tensor:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about moving edges, which are no part of either
        # Derivatives have samples of their own; images are compared in test_image.
        return tr.render(scene, spp=1, spp_grad=SPP, seed=5, params=values, **more)
