"""Whether tutorials have written the pictures that they announce."""

from __future__ import annotations

from pathlib import Path


def drawn(folder: Path, *names: str) -> bool:
    """Diagrams, of which the smallest is larger than a picture without any."""
    return all((folder / f"{name}.png").stat().st_size > 2000 for name in names)


def check_pictures(folder: Path, names: list[str]) -> None:
    """Renderings in both formats, and the curves of losses."""
    for name in names:
        for suffix in ("png", "exr"):
            file = folder / f"{name}.{suffix}"
            assert file.stat().st_size > 100, file
    assert (folder / "loss.png").stat().st_size > 1000
