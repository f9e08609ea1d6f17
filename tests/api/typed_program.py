"""What a type checker has to make of the public interface; `make lint` checks it, and no test runs it."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import trimesh
from torch import nn
from typing_extensions import assert_type

import torchrender as tr
from torchrender.render_types import Outputs, RenderSettings
from torchrender.typing import SceneDict


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
    assert_type(layer.forward(seed=1, params={}), torch.Tensor)
    several = tr.Renderer(scene, outputs=("rgb", "alpha"))
    assert_type(several.forward(spp=4), Outputs)
    assert_type(several(outputs=None), torch.Tensor)
    assert_type(layer.scene, tr.Scene)
    assert_type(scene.forward(outputs=["depth"]), Outputs)
    settings: RenderSettings = {"spp": 4, "layout": "bchw", "on_interrupt": "return"}
    assert_type(tr.render(scene, **settings), torch.Tensor)
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
    assert_type(made, tr.Scene)
    description: SceneDict = {"type": "scene", "integrator": {"type": "path"}, "sky": {"type": "constant"}}
    assert_type(tr.load_dict(description, variant="mono", dtype=torch.float64), tr.Scene)
    read: dict[str, Any] = {}
    tr.load_dict(read).train_only("*")
    assert_type(tr.load_dict({"type": "sphere"}), tr.Scene | Any)
    assert_type(tr.from_trimesh(trimesh.Trimesh()), tr.Scene)
    images(made, tr.PerspectiveCamera.look_at([0, 0, 4], [0, 0, 0]))
    hits = tr.ray_intersect(scene, [[0.0, 0.0, 4.0]], [[0.0, 0.0, -1.0]])
    assert_type(hits.t, torch.Tensor)
    assert_type(tr.ray_occluded(scene, [[0.0, 0.0, 4.0]], [[0.0, 0.0, -1.0]]), torch.Tensor)


def objects() -> None:
    """Whatever numbers are taken from."""
    tr.Sphere(center=[0, np.float32(1), torch.tensor(2)], radius=np.float64(2), to_world=np.eye(4))
    tr.Sphere(center=np.zeros(3), to_world=tr.Transform(), bsdf={"type": "ref", "id": "red"})
    tr.Diffuse(reflectance=torch.zeros(4, 4, 3))
    tr.Diffuse(reflectance=np.zeros((4, 4, 3)))
    tr.Diffuse(reflectance=[0.1, 0.2, 0.3])
    tr.Diffuse(reflectance={"type": "rgb", "value": 0.5})
    tr.Rectangle(to_world=[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], emitter=tr.AreaLight(radiance=2))


def mistakes(scene: tr.Scene) -> None:
    tr.render(scene, samples=4)  # pyright: ignore[reportCallIssue]
    tr.render(scene, layout="whc")  # pyright: ignore[reportArgumentType]
    tr.Renderer(scene, spp="many")  # pyright: ignore[reportArgumentType]
    tr.load_file("scene.xml", unsupported="ignore")  # pyright: ignore[reportArgumentType]
    tr.load_file("scene.xml", variant="spektral")  # pyright: ignore[reportArgumentType]
    tr.load_dict({"type": "scene"}, variant="polarized")  # pyright: ignore[reportCallIssue, reportArgumentType]
    tr.render(scene, on_interrupt="keep")  # pyright: ignore[reportArgumentType]
    tr.Renderer(scene, params={})  # pyright: ignore[reportCallIssue]
    layer = tr.Renderer(scene)
    layer(sensr=0)  # pyright: ignore[reportCallIssue]
    layer.forward(spp="many")  # pyright: ignore[reportArgumentType]
    tr.HenyeyGreenstein(g="forward")  # pyright: ignore[reportArgumentType]
    tr.Diffuse(reflectance="red")  # pyright: ignore[reportArgumentType]
