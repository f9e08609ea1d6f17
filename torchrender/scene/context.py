"""What a scene object is built with: colour mode, precision, device, and the place in the scene for messages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

import torch

# Rec. 709 luminance, with the digits of csrc/core/color/spectrum.h: what makes one channel out of red, green and blue.
LUMINANCE = (0.2126, 0.7152, 0.0722)
SAMPLES = 471  # numbers of a spectrum that is a table: one a nanometre, from 360 to 830 nm
SHORTEST, LONGEST = 360.0, 830.0  # nm
SODIUM = 589.3  # nm, where the usual tables have indices of refraction


@dataclass(frozen=True)
class Context:
    """Settings for building scene objects.

    Attributes:
        color: ``"rgb"``, ``"mono"``, ``"spectral"``; None for an object built by itself, which takes what it is given.
        dtype: of every parameter; None keeps the dtype of tensors and arrays, else torch's default dtype.
        path: where in the scene, outermost first.
        folder: relative file names start here.
        emission: a spectrum here is light, else a factor such as a reflectance.
        bounded: the channels of a colour here are at most 1.
        wavelength: in nm, at which a mono scene has its spectra; None is for their luminance.
        index: a spectrum here is an index of refraction, outside spectral scenes the one number at `SODIUM`.
    """

    color: str | None = None
    dtype: torch.dtype | None = None
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    path: tuple[str, ...] = ()
    folder: Path | None = None
    emission: bool = False
    bounded: bool = False
    index: bool = False
    wavelength: float | None = None

    @property
    def channels(self) -> int:
        return 1 if self.color == "mono" else 3

    @property
    def where(self) -> str:
        return ".".join(self.path)

    def at(self, name: str) -> Context:
        return replace(self, path=(*self.path, name))

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{self.where}: {message}" if self.path else message)

    @contextmanager
    def located(self) -> Iterator[None]:
        """Errors of other modules inside get this place prepended."""
        try:
            yield
        except (ValueError, TypeError, OSError) as error:
            if self.path and not str(error).startswith(self.where):
                kind = type(error) if type(error) in (ValueError, TypeError) else None
                if isinstance(error, FileNotFoundError):
                    kind = FileNotFoundError
                raise (kind or ValueError)(f"{self.where}: {error}") from error
            raise

    def file(self, name: Any) -> Path:
        """`name` as an absolute path of an existing file."""
        with self.located():
            path = Path(name)
            if not path.is_absolute() and self.folder is not None:
                path = self.folder / path
            if not path.exists():
                raise FileNotFoundError(f"no such file: {path}")
        return path


@dataclass(frozen=True)
class Reference:
    """The id of another object of the scene, resolved when the scene is loaded."""

    id: str
