"""The five rows of the comparison table: which scene file, with which texture, differentiated in which parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

SCENES = Path(__file__).resolve().parent.parent / "scenes"


@dataclass(frozen=True)
class Row:
    """One row: a scene file, its `$parameters`, and the names of the differentiated parameters."""

    name: str
    file: str
    parameters: tuple[str, ...]
    arguments: dict[str, str] = field(default_factory=dict)

    @property
    def path(self) -> str:
        return str(SCENES / self.file)


def _textured(name: str, resolution: int) -> Row:
    return Row(
        f"{name}, texture {resolution}²",
        f"textured_{name}.xml",
        (f"{name}.bsdf.brdf_0.reflectance.data",),
        {"texture": f"textures/blocks_{resolution}.exr"},
    )


ROWS = (
    Row(
        "Cornell box, 5 x 3 albedos",
        "cornell_box.xml",
        tuple(f"{name}.reflectance.value" for name in ("floor", "ceil", "red", "green", "box")),
    ),
    _textured("sphere", 512),
    _textured("sphere", 1024),
    _textured("monkey", 512),
    _textured("monkey", 1024),
)

# ... and a scene in which surfaces polarise: in the others Stokes vectors are images.
ALL_ROWS = (*ROWS, Row("Gold over plastic", "polarising_sphere.xml", ("ground.bsdf.diffuse_reflectance.value",)))
