"""Media whose index of refraction varies, so that light in them bends: rays through them, and their fields.

`trace` follows rays through the medium of a shape (`tr.GradientIndexMedium`), with derivatives of exactly what it
computes. `evaluate` is the field in plain PyTorch, `fit` finds control values from samples of an index, `refine` a grid
that is twice as fine.
"""

from .field import evaluate as evaluate
from .field import fit as fit
from .field import refine as refine
from .trace import BentRays as BentRays
from .trace import trace as trace
