"""What of `render` other devices than the CPU do not have yet: an error by name, before any work is done."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from .devices import device, everything_on_the_cpu, named
from .first_hit_call import PATH_OUTPUTS, STOKES_OUTPUTS
from .scene.packing import Layout
from .scene.scene import Scene


def check_device(scene: Scene, packed: Layout, names: Sequence[str]) -> None:
    """RuntimeError unless the chosen device renders these outputs of a scene."""
    computing = device(scene.device)
    if computing != "cpu":
        for what in _missing(scene, packed, names):
            raise RuntimeError(f"render: {named(computing)} does not have {what}; {everything_on_the_cpu()}")


def _missing(scene: Scene, packed: Layout, names: Sequence[str]) -> Iterator[str]:
    """What is not there, with what is."""
    for name in names:
        if name in STOKES_OUTPUTS:
            yield f"the output {name!r} yet, but {', '.join(PATH_OUTPUTS)}, features and those of first hits"
    if packed.spectral:
        yield "spectral scenes yet, but those in rgb and mono"
    if scene.polarized:
        yield "polarised light yet, but variants without it (rgb, mono)"
    if packed.bending:
        yield f"media that light bends in yet, such as {packed.objects['medium'][packed.bending[0]][2]}"
