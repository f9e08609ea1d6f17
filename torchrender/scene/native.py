"""A native scene: the compiled core's copy of a packed scene, and what it was last given."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from itertools import repeat
from operator import and_
from typing import Any

import torch

from .. import backends
from ..devices import (
    FUNCTIONS,
    IMAGES,
    address,
    device,
    holds,
    raise_error_of_memory,
    require_cpu,
    share_memory,
    use_compiler,
)
from ..library import Watch
from .host_memory import numbers_on_host
from .packing import Layout
from .residence import staying

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
        self._seen: list[tuple[torch.Tensor, int, int] | None] = [None] * len(shapes)
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

    def holds(self, place: torch.device) -> bool:
        """Whether the memory of what computes has what lies there."""
        return holds(self.device(), place)

    def reached(self, tensor: torch.Tensor) -> torch.Tensor:
        """`tensor` where the core can read and write it, a copy on the CPU if need be."""
        return tensor if tensor.is_cpu or self.holds(tensor.device) else tensor.to("cpu")

    def call(self, function: str, params: list[torch.Tensor], *args: Any) -> Any:
        """``handle.function(cfg, params, dirty, ...)``: the first of `args` goes in front of the parameters.

        Those of `params` that do not lie on the CPU are read there, by what renders in that memory, or copied. Then
        their gradients and tangents are there, too, and with ``on_device`` in the settings the image or its adjoint.
        ValueError names a parameter that is not finite; RuntimeError says that the device does not have this.
        """
        if function not in FUNCTIONS:
            require_cpu(function, self.device())
        with self.lock:
            computing = self.device() if function in IMAGES else "cpu"
            there, alone = self._there(computing, params)
            if there:
                params = [t if t.is_cpu or a else numbers_on_host(t) for t, a in zip(params, alone, strict=True)]
            addresses = [address(t) for t in params] if there else [t.data_ptr() for t in params]
            dirty = self._dirty(params, addresses)
            try:
                self._check_finite(params, map(and_, alone, dirty))  # the core looks at the others
                if self.device().startswith(("cuda", "sm_", "compute_")):
                    use_compiler(self.handle.library)
                    if self.home is not None and self.home.type == "cuda":
                        share_memory(self.handle.library)
                if function in _WITH_CONFIG:
                    settings, *rest = args
                    watch = Watch(settings.get("progress") if isinstance(settings, dict) else None)
                    if isinstance(settings, dict):
                        settings = {name: value for name, value in settings.items() if name != "progress"}
                    if isinstance(settings, dict) and computing != "cpu":
                        settings |= {"device": computing, **self._placed(there, alone, settings)}
                    elif computing != "cpu":  # of several calls
                        configs, *others = settings
                        placed = self._placed(there, alone, {})
                        settings = [{**config, "device": computing, **placed} for config in configs], *others
                    found = getattr(self.handle, function)(settings, addresses, dirty, *rest, watch=watch)
                else:
                    found = getattr(self.handle, function)(*args, addresses, dirty)
                raise_error_of_memory()
                return found
            except BaseException as error:
                # How far the core came is unknown: everything counts as changed next time.
                self._seen = [None] * len(self._seen)
                raise_error_of_memory()
                if isinstance(error, ValueError):  # perhaps of numbers that are not finite, without a name
                    self._check_finite(params, repeat(True))
                raise

    def _there(self, computing: str, params: list[torch.Tensor]) -> tuple[list[bool], list[bool]]:
        """Which of `params` lie in the memory of what renders, and which of them are read there alone; else nothing."""
        if self.home is None or self.home.type == "cpu":
            return [], []
        there = [not t.is_cpu and holds(computing, t.device) for t in params]
        return there, [t and staying(self.layout).get(i, False) for i, t in enumerate(there)]

    def _placed(self, there: list[bool], alone: list[bool], settings: dict[str, Any]) -> dict[str, Any]:
        """What a device has to know of the memory that it shares with PyTorch, and in whose order it works there."""
        image = bool(settings.get("on_device"))
        found: dict[str, Any] = {"on_device": (there, alone, image)} if image or any(there) else {}
        if self.home is not None and self.home.type == "cuda" and self.holds(self.home):
            found["stream"] = torch.cuda.current_stream(self.home).cuda_stream
        return found

    def _dirty(self, params: list[torch.Tensor], addresses: list[int]) -> list[bool]:
        dirty = [False] * len(params)
        for i, (tensor, place, seen) in enumerate(zip(params, addresses, self._seen, strict=True)):
            version = -1 if tensor.is_inference() else tensor._version
            # The alias that is kept holds the storage, so that an equal address means the same memory.
            if seen is None or version < 0 or seen[1] != version or seen[2] != place:
                self._seen[i] = (tensor.detach(), version, place)
                dirty[i] = True
        return dirty

    def _check_finite(self, params: list[torch.Tensor], which: Iterable[bool]) -> None:
        """ValueError with the name of one of them that is not finite."""
        for name, tensor, looked_at in zip(self.names, params, which):
            if looked_at and not bool(torch.isfinite(tensor.detach()).all()):
                raise ValueError(f"{name}: has values that are not finite") from None
