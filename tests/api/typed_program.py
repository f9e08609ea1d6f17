"""What a type checker has to make of the public interface; `make lint` checks it, and no test runs it."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn
from typing_extensions import assert_type

import torchrender as tr
from torchrender.render_types import Outputs


def images(scene: tr.Scene, camera: tr.PerspectiveCamera) -> None:
    assert_type(tr.render(scene), torch.Tensor)
    assert_type(tr.render(scene, sensor=[0, camera], integrator="path", spp=16, seed=0, layout="bchw"), torch.Tensor)
    assert_type(scene(spp=4), torch.Tensor)
    found = tr.render(scene, outputs=("rgb", "depth", "vertex_color"))
    assert_type(found, Outputs)
    assert_type(found.depth, torch.Tensor)
    assert_type(found.vertex_color, torch.Tensor)
    image, _depth, _colours = scene(outputs=("rgb", "depth", "vertex_color"), pixels=[[0, 0]])
    assert_type(image, torch.Tensor)


def layers(scene: tr.Scene) -> None:
    layer = tr.Renderer(scene, spp=16)
    assert_type(layer(seed=1), torch.Tensor)
    assert_type(layer(outputs=("alpha",)), Outputs)
    assert_type(tr.Renderer(scene, outputs=("rgb", "alpha"))().alpha, torch.Tensor)
    module: nn.Module = layer
    del module


def scenes() -> None:
    scene = tr.load_file("scene.xml", resolution=64, unsupported="substitute")
    assert_type(scene, tr.Scene)
    assert_type(scene.train_only("*.reflectance.*"), list[nn.Parameter])
    assert_type(scene.get_parameter("red.reflectance.value"), nn.Parameter)
    assert_type(scene.bounding_box(), torch.Tensor)
    assert_type(list(scene), list[str])
    assert_type(scene.ball.bsdf, Any)
    scene["ball"] = {"type": "sphere"}
    made = tr.load_dict({"type": "scene", "ball": tr.Sphere(radius=2.0, bsdf=tr.Diffuse(reflectance=0.5))})
    images(made, tr.PerspectiveCamera.look_at([0, 0, 4], [0, 0, 0]))
    hits = tr.ray_intersect(scene, [[0.0, 0.0, 4.0]], [[0.0, 0.0, -1.0]])
    assert_type(hits.t, torch.Tensor)
    assert_type(tr.ray_occluded(scene, [[0.0, 0.0, 4.0]], [[0.0, 0.0, -1.0]]), torch.Tensor)


def mistakes(scene: tr.Scene) -> None:
    tr.render(scene, samples=4)  # pyright: ignore[reportCallIssue]
    tr.render(scene, layout="whc")  # pyright: ignore[reportArgumentType]
    tr.Renderer(scene, spp="many")  # pyright: ignore[reportArgumentType]
    tr.load_file("scene.xml", unsupported="ignore")  # pyright: ignore[reportArgumentType]
