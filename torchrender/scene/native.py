"""A native scene: the compiled core's copy of a packed scene, and what it was last given."""

from __future__ import annotations

import threading
from typing import Any

import torch

from .. import backends
from ..devices import FUNCTIONS, RENDERS, device, require_cpu, use_compiler
from ..library import Watch
from .packing import Layout

_WITH_CONFIG = (
    *("render", "render_vjp", "render_jvp", "response_vjp", "pixel_weights"),
    *("render_aov", "aov_vjp", "aov_jvp", "find_outlines", "boundary"),
)


class NativeScene:
    """One built scene of the core. Immutable in structure: another structure gets another object.

    The core reads parameters where they lie; this class tells it which ones changed since the last call.

    `previous` is the native scene that this one replaces: what did not change, of the acceleration structure, the
    tables of lights and the knowledge of what changed, is taken from it. It stays usable, for derivatives of images
    that it rendered; it makes its own again then. `home` is where the scene lies.
    """

    def __init__(
        self,
        layout: Layout,
        color: str,
        dtype: torch.dtype,
        shapes: list[tuple[int, ...]],
        previous: NativeScene | None = None,
        home: torch.device | None = None,
    ) -> None:
        self.home = home
        self.layout = layout
        self.index_key = layout.index_key()
        self.dtype = dtype
        self.shapes = shapes
        self.channels = 1 if color == "mono" else 3
        self.lock = threading.Lock()
        self.core = backends.ready(dtype, home)
        self.handle = self.core.Scene(color, str(dtype).removeprefix("torch."))
        self.names = [slot.name for slot in layout.slots]
        self._seen: list[tuple[torch.Tensor, int] | None] = [None] * len(shapes)
        indices = [(t.data_ptr(), int(t.shape[0])) for t in layout.index_tensors]
        if previous is None or previous.core is not self.core or previous.channels != self.channels:
            self.builds = 1
            self.handle.build(layout.objects, shapes, indices)
            return
        self.builds = previous.builds + 1
        if previous.layout.objects != layout.objects:  # slots mean something else now
            self.handle.build(layout.objects, shapes, indices)
            return
        with previous.lock:
            self.handle.build(layout.objects, shapes, indices, previous.handle)
            for i, shape in enumerate(shapes):
                if previous.shapes[i] == shape:
                    self._seen[i] = previous._seen[i]

    def counters(self) -> dict[str, int]:
        """How often parts of the core's copy of the scene were made, see `Scene.updates`."""
        return {"scenes": self.builds, **self.handle.counters()}

    def device(self) -> str:
        """What computes, see `torchrender.devices.device`."""
        return device(self.home)

    def call(self, function: str, params: list[torch.Tensor], *args: Any) -> Any:
        """``handle.function(cfg, params, dirty, ...)``: the first of `args` goes in front of the parameters.

        ValueError names a parameter that is not finite; RuntimeError says that the device does not have this.
        """
        if function not in FUNCTIONS:
            require_cpu(function, self.device())
        with self.lock:
            dirty = self._dirty(params)
            addresses = [t.data_ptr() for t in params]
            try:
                if self.device().startswith(("cuda", "sm_", "compute_")):
                    use_compiler(self.handle.library)
                if function in _WITH_CONFIG:
                    settings, *rest = args
                    watch = Watch(settings.get("progress") if isinstance(settings, dict) else None)
                    if isinstance(settings, dict):
                        settings = {name: value for name, value in settings.items() if name != "progress"}
                    if function in RENDERS:
                        settings |= {"device": self.device()}
                    return getattr(self.handle, function)(settings, addresses, dirty, *rest, watch=watch)
                return getattr(self.handle, function)(*args, addresses, dirty)
            except BaseException as error:
                # How far the core came is unknown: everything counts as changed next time.
                self._seen = [None] * len(self._seen)
                if isinstance(error, ValueError):
                    self._name_nonfinite(params)
                raise

    def _dirty(self, params: list[torch.Tensor]) -> list[bool]:
        dirty = []
        for i, tensor in enumerate(params):
            version = -1 if tensor.is_inference() else tensor._version
            seen = self._seen[i]
            # The alias that is kept holds the storage, so that an equal address means the same memory.
            same = seen is not None and version >= 0 and seen[1] == version and seen[0].data_ptr() == tensor.data_ptr()
            if not same:
                self._seen[i] = (tensor.detach(), version)
            dirty.append(not same)
        return dirty

    def _name_nonfinite(self, params: list[torch.Tensor]) -> None:
        """ValueError if one of `params` is what the core has refused; the core itself looks at what changed only."""
        for name, tensor in zip(self.names, params, strict=True):
            if not bool(torch.isfinite(tensor.detach()).all()):
                raise ValueError(f"{name}: has values that are not finite") from None
