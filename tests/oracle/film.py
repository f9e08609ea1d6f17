"""The samples of an image, and their weighted mean in pixels: csrc/cpu/film.h."""

from __future__ import annotations

import torch

import torchrender as tr
from torchrender.render_arguments import film_config
from torchrender.scene.camera import Rays
from torchrender.scene.film import Film
from torchrender.scene.sensor import default_sampler
from torchrender.wavefront.film import Splats, filter_weight
from torchrender.wavefront.numbers import CAMERA_BLOCK, Numbers, pixel_key
from torchrender.wavefront.sensors import SENSORS

from .world import World


def numbers_of(scene: tr.Scene, spp: int, seed: int, sensor: int) -> Numbers:
    """Those of the sampler that a rendering takes when nothing is said, in double precision."""
    return Numbers(default_sampler(scene.sensors[sensor]).type, spp, seed, sensor, torch.float64)


def camera_samples(
    world: World, seed: int, spp: int, sensor: int
) -> tuple[torch.Tensor, Rays, torch.Tensor, torch.Tensor]:
    """Film positions (N, 2), their rays, and numbers of pixel and sample (N,)."""
    record, film = world.records["sensor"][sensor], world.scene.sensors[sensor].film
    row, column = Splats(film, film.window, film_config(film, None)[2]["window"]).sources.unbind(1)
    sample = torch.arange(spp).repeat(len(row))
    row, column = row.repeat_interleave(spp), column.repeat_interleave(spp)
    pixel = pixel_key(row, column)
    u = numbers_of(world.scene, spp, seed, sensor).block(pixel, sample, CAMERA_BLOCK)
    positions = torch.stack([column + u[:, 0], row + u[:, 1]], 1)
    rays = SENSORS[record.type](world, record, (film.height, film.width), positions, u[:, 2:])
    return positions, rays, pixel, sample


def splat(
    film: Film, x: torch.Tensor, y: torch.Tensor, values: torch.Tensor, magnitude: bool = False
) -> tuple[torch.Tensor, torch.Tensor]:
    """Sums of samples (N, K) at these places, in pixels, times filter weights, (h, w, K) of the film's window; and of
    the weights, (h, w, 1). `magnitude`: weights count without their sign."""
    y0, x0, height, width = film.window
    column, row = torch.floor(x.detach()), torch.floor(y.detach())
    columns = torch.cat([values, values.new_ones(len(values), 1)], 1)
    total = columns.new_zeros(height * width, columns.shape[1])
    k = Splats(film, film.window, film.window).reach
    for i in range(-k, k + 1):
        for j in range(-k, k + 1):
            weight = filter_weight(film.filter, row + i + 0.5 - y) * filter_weight(film.filter, column + j + 0.5 - x)
            weight = weight.abs() if magnitude else weight
            r, c = (row + i - y0).long(), (column + j - x0).long()
            inside = (r >= 0) & (r < height) & (c >= 0) & (c < width)
            total = total.index_add(0, (r * width + c)[inside], (columns * weight[:, None])[inside])
    total = total.reshape(height, width, -1)
    return total[..., :-1], total[..., -1:]
