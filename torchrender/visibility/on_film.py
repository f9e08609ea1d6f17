"""What the motion of outlines changes on the film: radiance with alpha, or outputs besides them.

Both are sums over the film of what samples of outlines bring, with a derivative of their own.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ..first_hit_call import FirstHitCall
from ..render_call import RenderCall
from .film_sums import FilmPlaces


class Radiance:
    """The image and, where it is wanted, alpha: averages over the filter."""

    def __init__(self, call: RenderCall) -> None:
        self.call, self.film = call, FilmPlaces(call)

    @staticmethod
    def zeros(call: RenderCall) -> tuple[torch.Tensor, ...]:
        image = torch.zeros(call.shape(), dtype=call.native.dtype)
        return (image, torch.zeros(call.size, dtype=call.native.dtype)) if call.alpha else (image,)

    def adjoint(self, adjoints: Sequence[torch.Tensor | None]) -> torch.Tensor:
        """Of the film's sums, for those of the image and of alpha."""
        image, alpha = (*adjoints, None)[:2]
        film = self.film.empty()
        if image is not None:
            self.film.add(film, image.detach().reshape(-1, self.call.numbers), slice(None, -1))
        if alpha is not None:
            self.film.add(film, alpha.detach().reshape(-1, 1), slice(-1, None))
        return film / self.film.normal

    def tangents(self, total: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Those of the image and of alpha, for those of the film's sums."""
        values = self.film.results(total / self.film.normal)
        zeros = self.zeros(self.call)
        parts = (values[:, :-1], values[:, -1])[: len(zeros)]
        return tuple(part.reshape(zero.shape).to(zero.dtype) for part, zero in zip(parts, zeros, strict=True))


class Averages:
    """Outputs of the first hit, in the core's order: csrc/cpu/boundary_outputs.h.

    They are averages O = N / D over the samples that hit something, so that their derivative is (dN - O dD) / D: of
    sums of values, and of what is covered. O and D are those of the derivative's samples.
    """

    def __init__(self, first: FirstHitCall, params: Sequence[torch.Tensor], threads: int) -> None:
        call = first.render
        real = self.zeros(first)
        covered = torch.empty(call.size, dtype=call.native.dtype)
        names = first.core_names().values()
        addresses = {**first.addresses(dict(zip(names, real, strict=True))), "covered": covered.data_ptr()}
        call.native.call("render_aov", list(params), {**first.config(True), "threads": threads}, addresses)
        real, covered = call.share.seen_by_outlines(first, params, real, covered)
        pixels = covered.numel()
        self.like = real
        self.sizes = [t.numel() // pixels if pixels else 1 for t in real]
        self.film = FilmPlaces(call, sum(self.sizes) + 1, not first.zero_at_misses)
        self.covered = covered.reshape(-1, 1).double()
        flat = torch.cat([t.reshape(pixels, size) for t, size in zip(real, self.sizes, strict=True)], 1)
        self.value = torch.where(self.covered > 0, flat.double(), 0.0)
        if first.zero_at_misses:  # all samples count, wherever things are
            self.covered, self.value = torch.ones_like(self.covered), torch.zeros_like(self.value)

    @staticmethod
    def zeros(first: FirstHitCall) -> tuple[torch.Tensor, ...]:
        return tuple(torch.zeros_like(first.empty(name)) for name in first.core_names().values())

    def adjoint(self, adjoints: Sequence[torch.Tensor | None]) -> torch.Tensor:
        """Of the film's sums, for those of the outputs."""
        rows = len(self.value)
        wanted = torch.cat(
            [
                self.value.new_zeros(rows, size) if a is None else a.detach().double().reshape(rows, size)
                for a, size in zip(adjoints, self.sizes, strict=True)
            ],
            1,
        )
        of_cover = -(wanted * self.value).sum(1, keepdim=True)
        columns = torch.where(self.covered > 0, torch.cat([wanted, of_cover], 1) / self.covered, 0.0)
        film = self.film.empty()
        self.film.add(film, columns, slice(None))
        return film / self.film.normal

    def tangents(self, total: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Those of the outputs, for those of the film's sums."""
        found = self.film.results(total / self.film.normal)
        change = found[:, :-1] - self.value * found[:, -1:]
        parts = torch.where(self.covered > 0, change / self.covered, 0.0).split(self.sizes, 1)
        return tuple(part.reshape(like.shape).to(like.dtype) for part, like in zip(parts, self.like, strict=True))
