"""torchrender: a differentiable path tracer as a PyTorch layer.

``scene = tr.load_dict({...})``, ``image = tr.render(scene, spp=64, seed=0)``; the image is a tensor with a gradient.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from . import backends, integrators
from ._version import __version__ as __version__
from .autograd import reattach
from .backends import show_config
from .errors import MissingTermWarning, NotDifferentiableError, RenderError, SubstitutionWarning
from .integrators import (
    AOV,
    DirectIllumination,
    Integrator,
    ParticleTracer,
    PathTracer,
    VolumetricPathTracer,
    WavefrontPathTracer,
)
from .loaders.colmap import load_colmap
from .loaders.dict import from_trimesh, load_dict, load_file, variants
from .progress import progress
from .render import Renderer, render
from .scene import Scene
from .scene.camera import PerspectiveCamera
from .scene.cameras import FisheyeCamera, OrthographicCamera, PanoramaCamera, ThinLensCamera
from .scene.emitters import DirectionalLight, EnvironmentMap, PointLight, Projector, SpotLight
from .scene.film import SAMPLERS, Film, ReconstructionFilter, Sampler
from .scene.heightfield import HeightField
from .scene.layers import BlendBSDF, BumpMap, Mask, NormalMap, TwoSided
from .scene.materials import (
    Conductor,
    Dielectric,
    Plastic,
    Principled,
    PrincipledThin,
    RednerMaterial,
    RoughConductor,
    RoughDielectric,
    RoughPlastic,
    ThinDielectric,
)
from .scene.media import HeterogeneousMedium, HomogeneousMedium
from .scene.mesh import Cube, Mesh
from .scene.phases import BlendPhase, TabulatedPhase
from .scene.point_sensors import DistantSensor, RadianceMeter
from .scene.sensor import IrradianceMeter
from .scene.shapes import Disk, Rectangle, Sphere
from .scene.textures import Bitmap, Checkerboard, MeshAttribute
from .scene.torch_bsdf import TorchBSDF
from .scene.volumes import ConstantVolume, GridVolume
from .transform import Transform
from .versions import count_fused_steps

if TYPE_CHECKING:  # what __getattr__ below finds
    from . import constraints as constraints
    from . import daylight as daylight
    from . import heightfield as heightfield
    from . import io as io
    from . import optim as optim
    from . import rotation as rotation
    from . import testing as testing
    from . import typing as typing
    from ._plugins import *  # noqa: F403
    from .daylight import sky as sky
    from .image import show as show
    from .image import tonemap as tonemap
    from .queries import ray_intersect as ray_intersect
    from .queries import ray_occluded as ray_occluded

count_fused_steps()

__all__ = [
    "AOV",
    "SAMPLERS",
    "Bitmap",
    "BlendBSDF",
    "BlendPhase",
    "BumpMap",
    "Checkerboard",
    "Conductor",
    "ConstantVolume",
    "Cube",
    "Dielectric",
    "DirectIllumination",
    "DirectionalLight",
    "Disk",
    "DistantSensor",
    "EnvironmentMap",
    "Film",
    "FisheyeCamera",
    "GridVolume",
    "HeightField",
    "HeterogeneousMedium",
    "HomogeneousMedium",
    "Integrator",
    "IrradianceMeter",
    "Mask",
    "Mesh",
    "MeshAttribute",
    "MissingTermWarning",
    "NormalMap",
    "NotDifferentiableError",
    "OrthographicCamera",
    "PanoramaCamera",
    "ParticleTracer",
    "PathTracer",
    "PerspectiveCamera",
    "Plastic",
    "PointLight",
    "Principled",
    "PrincipledThin",
    "Projector",
    "RadianceMeter",
    "ReconstructionFilter",
    "Rectangle",
    "RednerMaterial",
    "RenderError",
    "Renderer",
    "RoughConductor",
    "RoughDielectric",
    "RoughPlastic",
    "Sampler",
    "Scene",
    "Sphere",
    "SpotLight",
    "SubstitutionWarning",
    "TabulatedPhase",
    "ThinDielectric",
    "ThinLensCamera",
    "TorchBSDF",
    "Transform",
    "TwoSided",
    "VolumetricPathTracer",
    "WavefrontPathTracer",
    "backends",
    "from_trimesh",
    "integrators",
    "load_colmap",
    "load_dict",
    "load_file",
    "progress",
    "reattach",
    "render",
    "show_config",
    "variants",
]

# Imported when first used, so that importing this package stays fast: module -> names that it gives.
_LAZY_MODULES = ("constraints", "daylight", "heightfield", "io", "optim", "rotation", "testing", "typing")
_LAZY_NAMES = {
    "tonemap": "image",
    "show": "image",
    "ray_intersect": "queries",
    "ray_occluded": "queries",
    "sky": "daylight",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY_MODULES:
        return importlib.import_module(f".{name}", __name__)
    if name in _LAZY_NAMES:
        value = getattr(importlib.import_module(f".{_LAZY_NAMES[name]}", __name__), name)
        globals()[name] = value
        return value
    if name[:1].isupper() and not name.startswith("_"):
        # Classes generated from the native declaration: tr.Diffuse, tr.AreaLight, ...
        from .scene import registry

        known = registry.public_classes()
        if name in known:
            value = registry.plugin_class(*known[name])
            globals()[name] = value
            return value
    raise AttributeError(f"module 'torchrender' has no attribute {name!r}")


def __dir__() -> list[str]:
    from .scene import registry

    return sorted({*globals(), *_LAZY_MODULES, *_LAZY_NAMES, *registry.public_classes()})
