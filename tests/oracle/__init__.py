"""A slow, obvious path tracer in PyTorch: what the native renderer is compared with, image and gradients, to rounding.

It draws the same random numbers, samples in the same way and asks `tr.ray_intersect` for hits; everything else is plain
tensor operations in float64 that autograd differentiates. Sampling is detached: sampled numbers, densities, weights of
multiple importance sampling, Russian roulette and visibility are constants. Every sampled line is kept while surfaces
slide along it, see `path.py`.

Each native model has a class or function here, in the file of its category, registered under its type name.
"""

from __future__ import annotations

from .outputs import first_hits
from .path import render

__all__ = ["first_hits", "render"]
