"""Which derivatives a parameter has, read from the native declaration; for all models that is docs/derivatives.md.

The declaration says for each field ``"interior"`` (complete), ``"interior, without X; zero where Y"`` (the term X is
missing; the words after the semicolon say when it is zero) or ``"none: reason"``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .declaration import TENSOR_KINDS, models
from .registry import plugin_class

if TYPE_CHECKING:
    from .packing import Slot

WITHOUT = "interior, without "
# When a missing term vanishes, where the declaration does not say it more precisely.
ZERO = "zero where no such edge is in view"

# In the declarations of what turns rays, or normals (also in csrc/host/gradient_requirements.cpp).
TURNING = ("edges seen through", "a normal begins to hide")


@dataclass(frozen=True)
class Limits:
    """What limits the derivative of a parameter: why there is none, or which term it lacks; both empty if complete."""

    refusal: str = ""
    caveat: str = ""  # the missing term, and after a colon when it is zero

    def also(self, derivative: str) -> Limits:
        """These limits, and those of a field with this declaration: a texture has those of the field it sits in."""
        refusal = caveat = ""
        if derivative.startswith("none"):
            refusal = derivative.partition(":")[2].strip() or "its derivative is not implemented"
        elif derivative.startswith(WITHOUT):
            missing, *zero = re.split("[:;]", derivative.removeprefix(WITHOUT), maxsplit=1)
            caveat = f"{missing.strip()}: {zero[0].strip() if zero else ZERO}"
        return Limits(self.refusal or refusal, self.caveat or caveat)


COMPLETE = Limits()


def describe_derivative(refusal: str, caveat: str) -> tuple[str, str]:
    """For a table: whether there is a derivative, in reverse and forward mode alike, and what is to be said of it."""
    if refusal:
        return "none", refusal
    return "yes", f"without {caveat.partition(':')[0]}" if caveat else ""


def moves_rays(slot: Slot) -> bool:
    """Whether rays, their hits, or where on a surface or map something is looked up depend on a parameter."""
    category = slot.module.category
    if category == "shape":
        return slot.attribute in slot.module.fields()  # other tensors of a mesh are colours
    if category == "sensor" or slot.kind == "transform2":
        return True
    if category in ("emitter", "volume"):
        return slot.kind in ("transform", "point")
    # of BSDFs and their textures what is reflected and refracted
    return any(words in slot.caveat for words in TURNING) or slot.module.type == "mesh_attribute"


def moves_outlines(slot: Slot) -> bool:
    """Whether silhouettes, shadows or rims of interpolated normals depend on a parameter."""
    if slot.module.category == "emitter":
        return slot.attribute in ("position", "to_world")
    own = slot.module.category == "sensor" or slot.attribute in slot.module.fields()
    return slot.module.category in ("shape", "sensor") and own and slot.attribute != "vertex_texcoords"


PAGE = """# Which derivatives there are

Made from the native declaration of the models, by
`python -c "from torchrender.scene import derivatives; derivatives.write_page()"`.

*Complete* derivatives are the derivatives of the expected image, in forward and reverse mode. Where a term is missing,
the rest of the derivative is there, and asking for it gives one `tr.MissingTermWarning`. Where there is none, asking
for it raises `tr.NotDifferentiableError`. The parameters of a texture or volume have what the parameter has that it
stands for. `print(scene)` says the same for the parameters of one scene.

How things move: what a ray of the camera, or one that was reflected or refracted, has hit slides over the surface;
points on what emits are glued to it, and integrated over area (the material form of Zhang, Miller, Yan, Gkioulekas and
Zhao, "Path-Space Differentiable Rendering", SIGGRAPH 2020). Silhouettes, creases and shadows of meshes, spheres, disks
and cylinders move with them, in radiance, and what the camera sees in alpha and in the outputs of the first hit.
`features`, `duv_dx`, `duv_dy`, an `irradiancemeter` and radiance with a `tr.TorchBSDF` lack that, and so does
`visibility=False`; jumps of `uv` along a line of a round shape do not move either, nor the lines where mapped normals
begin to look away from the viewer, and where faces do from light that their interpolated normals still see. What
depends on the object: `to_uv` of a bitmap with nearest texels has no derivative; that of `vertex_normals` is complete
on diffuse surfaces.

`tr.VolumetricPathTracer` has the same derivatives, of media, too, and of what moves media: their boundaries, the places
of grids, with the border beyond which a grid is empty, lights and cameras in and around them. Of moving edges it has
those that the camera sees, through media, too. It lacks the edges of shadows and those that reflected and scattered
light meets, whose rays would have to be followed through media both ways; jumps of grids with nearest voxels; and the
light that a boundary with the BSDF `null` emits itself.

`tr.WavefrontPathTracer` has the derivatives of the path tracer, and by autograd those of everything that a
`tr.TorchBSDF` computes with.

`tr.ParticleTracer` has the same derivatives as the path tracers, with the motion of light over the film. That needs a
filter with a slope: with the box filter, asking for the derivative of something that moves raises
`tr.NotDifferentiableError`, and so does, with an `irradiancemeter`, the one with respect to the texture coordinates of
its surface, and every derivative of something that moves where there is an `sdfgrid`. A beam (`directionalarea`) moves
and turns with its surface. Points that light meets are glued to surfaces unless the light came from a mirror, through
smooth glass or in a beam; what is missing of edges is those in such light, and jumps of textures in it."""


def page() -> str:
    """The page docs/derivatives.md: a table of all continuous parameters of all models."""
    parts = [PAGE]
    category = ""
    for (group, kind), model in models().items():
        names = {f.name: f.name for f in model.fields}
        if (group, kind) != ("attribute", "attribute"):
            names.update({f.name: name for name, f in plugin_class(group, kind).fields().items()})
        fields = [f for f in model.fields if f.kind in (*TENSOR_KINDS, "texture", "volume")]
        if not fields:
            continue
        if group != category:
            category = group
            parts.append(f"\n## {'mesh attribute' if group == 'attribute' else group}\n")
            parts.append("| model | parameter | derivative | |\n|---|---|---|---|")
        for field in fields:
            limits = COMPLETE.also(field.derivative)
            if limits.refusal:
                cells = "no derivative", limits.refusal
            elif limits.caveat:
                missing, _, zero = limits.caveat.partition(": ")
                cells = f"without {missing}", zero
            else:
                cells = "complete", ""
            parts.append(f"| `{kind}` | `{names[field.name]}` | {cells[0]} | {cells[1]} |")
    return "\n".join(parts) + "\n"


def write_page() -> None:
    """Write docs/derivatives.md of a checkout."""
    path = Path(__file__).resolve().parents[2] / "docs" / "derivatives.md"
    path.write_text(page())
