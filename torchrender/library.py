"""A compiled core: a shared library with a C interface, called by ctypes, so that one serves every version of Python.

Arguments and results are bytes in the format of `marshal`, which both sides read and write in a few microseconds; what
they may hold is in ``csrc/bindings/value.h``. Arrays are passed as addresses.
"""

from __future__ import annotations

import ctypes
import functools
import marshal
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, NoReturn

_FORMAT = 2  # of marshal: the last one in which no value refers to an earlier one
_Progress = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double)
_RETURNED, _INTERRUPTED = 0, 1
_NO_PROGRESS = _Progress()
_ERRORS = (TypeError, ValueError, IndexError, MemoryError, RuntimeError)  # those that follow, see module.cpp


class Library:
    """The functions of a core. Those with a capital letter make objects, whose methods are functions, too."""

    def __init__(self, path: Path, isa: str) -> None:
        self.path, self.isa = path, isa
        library = ctypes.CDLL(str(path))
        pointer = ctypes.POINTER
        self._call = library.tr_call
        self._call.argtypes = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_size_t, _Progress]
        self._call.argtypes += [pointer(ctypes.c_void_p), pointer(ctypes.c_void_p), pointer(ctypes.c_size_t)]
        self._free, self.release = library.tr_free, library.tr_release
        self._free.argtypes = self.release.argtypes = [ctypes.c_void_p]
        self._free.restype = self.release.restype = None

    def __repr__(self) -> str:
        return f"Library({str(self.path)!r})"

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name.startswith("_"):
            raise AttributeError(name)
        made = functools.partial(self._make, name) if name[0].isupper() else functools.partial(self.call, name)
        setattr(self, name, made)
        return made

    def call(self, name: str, *arguments: Any, watch: Watch | None = None) -> Any:
        """What the function returns, or the error that it raises."""
        given = marshal.dumps(arguments, _FORMAT)
        reply, result, size = ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_size_t()
        callback = _NO_PROGRESS if watch is None else watch.callback
        how = self._call(name.encode(), given, len(given), callback, reply, result, size)
        try:
            value = marshal.loads(ctypes.string_at(result.value or 0, size.value))
        finally:
            self._free(reply)
        if how == _RETURNED:
            return value
        if how == _INTERRUPTED and watch is not None:
            watch.fail()
        raise _ERRORS[how - _INTERRUPTED - 1](value)

    def _make(self, kind: str, *arguments: Any) -> LibraryObject:
        address, attributes = self.call(kind, *arguments)
        made = LibraryObject(address)
        made.library, made.kind = self, kind
        vars(made).update(attributes)
        return made


class LibraryObject(ctypes.Structure):
    """An object of a core, which passes it as the bytes of its address."""

    _fields_ = (("address", ctypes.c_void_p),)
    library: Library
    kind: str

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name.startswith("_") or name in ("library", "kind"):
            raise AttributeError(name)
        return functools.partial(self.library.call, f"{self.kind}.{name}", self)

    def __del__(self) -> None:
        address: int | None = self.address
        if address:
            self.address = None
            self.library.release(address)


class Watch:
    """Lets Ctrl-C, and errors of a function that is told the share that is done, end a call of the core.

    A signal's handler runs as soon as Python code does. A function would be left by its error before a ``try`` in it is
    reached, so the core calls ``send`` of a generator that waits inside of one.
    """

    def __init__(self, progress: Callable[[float], Any] | None = None) -> None:
        self._errors: list[BaseException] = []
        waiting = _waiting(progress, self._errors)
        next(waiting)
        self.callback = _Progress(waiting.send)

    def fail(self) -> NoReturn:
        """Raise what has ended the call."""
        raise self._errors.pop()


def _waiting(progress: Callable[[float], Any] | None, errors: list[BaseException]) -> Generator[int, float, None]:
    """Takes shares, and says 1 when there is an error. Knows nothing of the `Watch`, which would be a cycle."""
    while True:
        try:
            done = yield len(errors)
            if progress is not None:
                progress(done)
        except GeneratorExit:
            return
        except BaseException as error:
            errors.append(error)
