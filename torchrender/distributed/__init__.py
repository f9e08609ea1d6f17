"""One image by several processes, which `torchrun` starts: shares of its samples, or tiles of it."""

from .render import SPLITS as SPLITS
from .render import render as render

__all__ = ["SPLITS", "render"]
