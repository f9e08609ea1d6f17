"""What is rendered and differentiated of a scene for `python -m bench same`, by the public interface alone."""

from __future__ import annotations

import copy
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch.autograd import forward_ad

import torchrender as tr

# What says where something is, by the end of its name; all else says how it looks.
PLACES = ("to_world", "to_uv", "center", "radius", "p0", "p1", "position", "target", "heights", "x_fov", "distortion")
PLACES += ("vertex_positions", "vertex_normals", "vertex_texcoords", "pixel_aspect", "aperture_radius")
PLACES += ("focus_distance", "principal_point_offset_x", "principal_point_offset_y")
OUTPUTS = ("rgb", "alpha", "variance", "depth", "distance", "position", "normal", "shading_normal", "normal_camera")
OUTPUTS += ("shading_normal_camera", "uv", "barycentric", "dp_du", "dp_dv", "albedo", "specular_reflectance")
OUTPUTS += ("roughness", "shape_id", "prim_id", "material_id", "duv_dx", "duv_dy")
WITHOUT_DERIVATIVE = ("alpha", "variance", "shape_id", "prim_id", "material_id")


class Found:
    """What one scene gives: arrays, and what was refused, by name."""

    def __init__(self) -> None:
        self.arrays: dict[str, np.ndarray] = {}
        self.said: dict[str, str] = {}

    def attempt(self, name: str, make: Callable[[], Any]) -> Any:
        """The result of `make()`, or None, where what it says is kept."""
        try:
            return make()
        except Exception as error:  # whatever one state says, the other has to say, too
            self.said[name] = f"{type(error).__name__}: {error}"
            return None

    def add(self, name: str, tensors: dict[str, torch.Tensor]) -> None:
        self.arrays |= {f"{name}/{key}": value.detach().cpu().numpy() for key, value in tensors.items()}


def fixed(name: str, like: torch.Tensor) -> torch.Tensor:
    """Numbers in the shape of a tensor that depend on a name alone, in both programs."""
    random = np.random.default_rng(zlib.crc32(name.encode()))
    return torch.from_numpy(np.asarray(random.standard_normal(tuple(like.shape)))).to(like)


class Rendering:
    """One way to render a scene, and its derivatives."""

    def __init__(
        self, found: Found, name: str, scene: tr.Scene, refused: dict[str, str], settings: dict[str, Any]
    ) -> None:
        self.found, self.name, self.scene = found, name, scene
        self.settings = dict(settings)
        self.values = {n: p.detach().clone() for n, p in scene.named_parameters() if n not in refused}
        found.said |= {f"{name}/parameter/{n}": text for n, text in refused.items()}

    def like(self, name: str) -> Rendering:
        """The same under another name."""
        copied = copy.copy(self)
        copied.name = name
        return copied

    def render(self, **more: Any) -> dict[str, torch.Tensor]:
        """Tensors by the name of their output."""
        image = tr.render(self.scene, **{**self.settings, **more})
        return image._asdict() if hasattr(image, "_asdict") else {"rgb": image}

    def image(self) -> bool:
        """Whether there is one."""
        image = self.found.attempt(f"{self.name}/image", self.render)
        if image is not None:
            self.found.add(f"{self.name}/image", image)
        return image is not None

    def refuse(self) -> None:
        """Leave out what this way to render refuses, which its own integrator would not have."""

        def probe(names: list[str]) -> None:
            self.render(params={n: self.values[n].clone().requires_grad_() for n in names})

        try:
            probe(list(self.values))
            return
        except (tr.NotDifferentiableError, ValueError):
            pass
        for name in list(self.values):
            try:
                probe([name])
            except (tr.NotDifferentiableError, ValueError) as error:
                self.found.said[f"{self.name}/parameter/{name}"] = f"{type(error).__name__}: {error}"
                del self.values[name]

    def reverse(self, kind: str, names: list[str], **more: Any) -> None:
        """Gradients of a fixed weighted sum of all outputs that have any."""

        def gradients() -> dict[str, torch.Tensor]:
            leaves = {n: self.values[n].clone().requires_grad_() for n in names}
            images = self.render(params={**self.values, **leaves} if leaves else None, **more)
            loss = sum(
                (torch.where(torch.isfinite(image), image, 0) * fixed(output, image)).sum()
                for output, image in images.items()
                if output not in WITHOUT_DERIVATIVE
            )
            given = torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)
            return {n: torch.zeros_like(v) if g is None else g for (n, v), g in zip(leaves.items(), given, strict=True)}

        if names:
            name = f"{self.name}/reverse {kind}"
            self.found.add(name, self.found.attempt(name, gradients) or {})

    def forward(self, kind: str = "", **more: Any) -> None:
        """The derivative of the outputs along fixed random changes of all parameters."""

        def tangents() -> dict[str, torch.Tensor]:
            with forward_ad.dual_level():
                dual = {n: forward_ad.make_dual(v, fixed(n, v)) for n, v in self.values.items()}
                pairs = {n: forward_ad.unpack_dual(image) for n, image in self.render(params=dual, **more).items()}
                return {n: pair.tangent for n, pair in pairs.items() if pair.tangent is not None}

        if self.values:
            name = f"{self.name}/forward {kind}".strip()
            self.found.add(name, self.found.attempt(name, tangents) or {})

    @property
    def places(self) -> list[str]:
        return [n for n in self.values if n.rpartition(".")[2] in PLACES]

    def derivatives(self, parts: bool) -> None:
        self.refuse()
        names, places = list(self.values), self.places
        self.reverse("all", names)
        if parts and 0 < len(places) < len(names):
            self.reverse("values", [n for n in names if n not in places])
            self.reverse("geometry", places)
        self.forward()

    def first_hits(self) -> None:
        """All outputs besides radiance, and their derivatives."""
        ends = {n.rpartition(".")[2] for n in self.values}
        names = (*OUTPUTS, *sorted(n for n in ends if n.startswith(("vertex_color", "face_color"))))
        images = self.found.attempt(f"{self.name}/outputs", lambda: self.render(outputs=names))
        if images is not None:
            self.found.add(f"{self.name}/outputs", images)
        shown = {"outputs": tuple(n for n in names if n not in ("rgb", "duv_dx", "duv_dy")), "correlated": True}
        self.reverse("outputs", list(self.values), **shown)
        self.forward("outputs", **shown)

    def queries(self) -> None:
        """What rays from around hit, and its derivatives by them and by the geometry."""
        like = next(iter(self.scene.parameters())).new_zeros(40, 3)
        origins = 4 * torch.nn.functional.normalize(fixed("origins", like), dim=1)
        leaves = {"origins": origins.requires_grad_()}
        leaves["directions"] = (0.4 * fixed("directions", like) - origins.detach()).requires_grad_()
        values = {n: self.values[n].clone().requires_grad_() for n in self.places if not n.startswith("sensor")}

        def hits() -> dict[str, torch.Tensor]:
            return tr.ray_intersect(self.scene, *leaves.values(), params=values)._asdict()

        found = self.found.attempt(f"{self.name}/outputs", hits)
        if found is not None:
            self.found.add(f"{self.name}/outputs", found)
            moved = {n: x for n, x in found.items() if x.requires_grad}
            loss = sum((torch.where(torch.isfinite(x), x, 0) * fixed(n, x)).sum() for n, x in moved.items())
            leaves |= values
            given = torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)
            gradients = {n: g for n, g in zip(leaves, given, strict=True) if g is not None}
            self.found.add(f"{self.name}/reverse all", gradients)
