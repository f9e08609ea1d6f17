"""The BSDFs by their types."""

from __future__ import annotations

from ..scene.declaration import models
from .bsdf import Bsdf
from .native_bsdf import NativeBsdf
from .torch_adapter import TorchAdapter


class Layer(Bsdf):
    """Gives way to a BSDF that it holds; see layers.py."""


BSDFS: dict[str, type[Bsdf]] = {
    kind: Layer if "wraps_bsdfs" in model.flags else NativeBsdf.of(model)
    for (category, kind), model in models().items()
    if category == "bsdf"
}
BSDFS["mask"] = BSDFS["null"]  # what is met of a mask where it is not
BSDFS["torch"] = TorchAdapter
