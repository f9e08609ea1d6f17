"""BSDFs written in PyTorch, and scenes with them."""

from __future__ import annotations

import math

import torch
from small_scene import ball_and_wall
from torch import nn

import torchrender as tr

ALBEDO = "ball.bsdf.albedo"
COLOUR = (0.6, 0.3, 0.1)


class Lambert(tr.TorchBSDF):
    """Diffuse, by what every subclass has by default."""

    def __init__(self, albedo=COLOUR, **more) -> None:
        super().__init__(**more)
        self.albedo = nn.Parameter(torch.tensor(albedo, dtype=torch.float64))

    def eval(self, si, wi, wo):
        return self.albedo * (wo[:, 2:] / math.pi)


class Uniform(Lambert):
    """The same with samples of its own: uniform on the hemisphere."""

    def pdf(self, si, wi, wo):
        return torch.where((wi[:, 2] > 0) & (wo[:, 2] > 0), 0.5 / math.pi, 0.0)

    def sample(self, si, wi, u):
        z, phi = u[:, 0], 2 * math.pi * u[:, 1]
        r = torch.sqrt(1 - z * z)
        wo = torch.stack([r * torch.cos(phi), r * torch.sin(phi), z], 1)
        return wo, torch.where(wi[:, 2] > 0, 0.5 / math.pi, 0.0)


class Phong(tr.TorchBSDF):
    """A lobe about the mirrored direction, nonlinear in its exponent."""

    def __init__(self) -> None:
        super().__init__(two_sided=True)
        self.exponent = nn.Parameter(torch.tensor(3.0))
        self.colour = nn.Parameter(torch.tensor([0.5, 0.4, 0.3]))

    def eval(self, si, wi, wo):
        cosine = (wi * wo * wi.new_tensor([-1.0, -1.0, 1.0])).sum(1, keepdim=True).clamp(min=1e-6)
        lobe = cosine**self.exponent * (self.exponent + 2) / (2 * math.pi)
        return torch.where((wi[:, 2:] > 0) & (wo[:, 2:] > 0), self.colour * lobe * wo[:, 2:], 0.0)


NATIVE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(COLOUR)}}
TEXELS = {"type": "bitmap", "data": torch.rand(4, 5, 3, generator=torch.Generator().manual_seed(4)), "raw": True}
FACING = tr.Transform.look_at([0, 2, 1.5], [0, 0, 0])
LIGHTS = {
    "constant": {"type": "constant", "radiance": 0.7},
    "point": {"type": "point", "position": [1.0, 1.5, 2.0], "intensity": 5.0},
    "envmap": {"type": "envmap", "data": TEXELS["data"]},
    "sphere": {"type": "sphere", "center": [0, 2, 1], "radius": 0.3, "emitter": {"type": "area", "radiance": 9.0}},
    "textured": {"type": "rectangle", "to_world": FACING, "emitter": {"type": "area", "radiance": TEXELS}},
}


def scene_with(bsdf, light: str = "constant", dtype: torch.dtype = torch.float64, **more) -> tr.Scene:
    ball = {"type": "sphere", "radius": 0.5, "bsdf": bsdf}
    return tr.load_dict(ball_and_wall(spp=4, **{"ball": ball, "sky": LIGHTS[light], **more}), dtype=dtype)


def wavefront(max_depth: int = 3, **more) -> tr.WavefrontPathTracer:
    return tr.WavefrontPathTracer(max_depth, **{"chunk": 100, **more})
