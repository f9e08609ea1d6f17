"""torchrender: a differentiable path tracer as a PyTorch layer.

``scene = tr.load_dict({...})``, ``image = tr.render(scene, spp=64, seed=0)``; the image is a tensor with a gradient.
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import TYPE_CHECKING, Any

from . import backends as backends
from . import integrators as integrators
from ._version import __version__ as __version__
from .autograd import reattach as reattach
from .backends import show_config as show_config
from .errors import InterruptionWarning as InterruptionWarning
from .errors import MissingTermWarning as MissingTermWarning
from .errors import NotDifferentiableError as NotDifferentiableError
from .errors import RangeWarning as RangeWarning
from .errors import RenderError as RenderError
from .errors import SubstitutionWarning as SubstitutionWarning
from .integrators import AOV as AOV
from .integrators import Depth as Depth
from .integrators import DirectIllumination as DirectIllumination
from .integrators import GradientIndexTracer as GradientIndexTracer
from .integrators import Integrator as Integrator
from .integrators import Moment as Moment
from .integrators import ParticleTracer as ParticleTracer
from .integrators import PathTracer as PathTracer
from .integrators import Stokes as Stokes
from .integrators import VolumetricPathTracer as VolumetricPathTracer
from .integrators import WavefrontPathTracer as WavefrontPathTracer
from .loaders.dict import from_trimesh as from_trimesh
from .loaders.dict import load_dict as load_dict
from .loaders.dict import load_file as load_file
from .loaders.dict import variants as variants
from .progress import progress as progress
from .render import render as render
from .renderer import Renderer as Renderer
from .scene import Scene as Scene
from .scene import written as _written  # noqa: F401
from .scene.film import SAMPLERS as SAMPLERS
from .scene.film import Film as Film
from .scene.film import ReconstructionFilter as ReconstructionFilter
from .scene.film import Sampler as Sampler
from .scene.mesh import Cube as Cube
from .scene.torch_bsdf import TorchBSDF as TorchBSDF
from .transform import Transform as Transform
from .versions import count_fused_steps as _count_fused_steps

if TYPE_CHECKING:  # what __getattr__ below finds
    from . import constraints as constraints
    from . import daylight as daylight
    from . import distributed as distributed
    from . import gradientindex as gradientindex
    from . import heightfield as heightfield
    from . import io as io
    from . import optim as optim
    from . import rotation as rotation
    from . import sdfgrid as sdfgrid
    from . import spectrum as spectrum
    from . import testing as testing
    from . import typing as typing
    from ._plugins import *  # noqa: F403
    from .bsdfs import native_bsdf as native_bsdf
    from .daylight import sky as sky
    from .denoising import denoise as denoise
    from .image import log_images as log_images
    from .image import show as show
    from .image import tonemap as tonemap
    from .loaders.colmap import load_colmap as load_colmap
    from .queries import ray_intersect as ray_intersect
    from .queries import ray_occluded as ray_occluded

_count_fused_steps()

# Imported when first used, so that importing this package stays fast: module -> names that it gives.
_LAZY_MODULES = (
    "constraints",
    "daylight",
    "distributed",
    "gradientindex",
    "heightfield",
    "io",
    "optim",
    "rotation",
    "sdfgrid",
    "spectrum",
    "testing",
    "typing",
)
_MODULES = ("backends", "integrators")
_LAZY_NAMES = {
    "tonemap": "image",
    "show": "image",
    "log_images": "image",
    "ray_intersect": "queries",
    "ray_occluded": "queries",
    "sky": "daylight",
    "denoise": "denoising",
    "native_bsdf": "bsdfs",
    "load_colmap": "loaders.colmap",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY_MODULES:
        return importlib.import_module(f".{name}", __name__)
    if name in _LAZY_NAMES:
        value = getattr(importlib.import_module(f".{_LAZY_NAMES[name]}", __name__), name)
        globals()[name] = value
        return value
    if name == "__all__":  # with the classes of all models, which the native declaration names
        return [n for n in __dir__() if not n.startswith("_")]
    if name[:1].isupper():
        from .scene import registry

        known = registry.public_classes()
        if name in known:
            value = registry.plugin_class(*known[name])
            globals()[name] = value
            return value
    message = f"module 'torchrender' has no attribute {name!r}"
    if not name.startswith("_"):
        from .errors import close_to

        message += close_to(name, (n for n in __dir__() if not n.startswith("_")))
    raise AttributeError(message)


def __dir__() -> list[str]:
    from .scene import registry

    own = (name for name, value in globals().items() if not isinstance(value, ModuleType) or name in _MODULES)
    found = {*own, *_LAZY_MODULES, *_LAZY_NAMES, *registry.declared_classes()}
    return sorted(found - {"Any", "ModuleType", "TYPE_CHECKING", "annotations"})
