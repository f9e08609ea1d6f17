# The classes of all models; those that no file defines are generated from the native declaration. Made by:
#     python -c "from torchrender.scene import stubs; stubs.main()"

from typing import Any

import torch

from .scene.camera import PerspectiveCamera as PerspectiveCamera
from .scene.cameras import FisheyeCamera as FisheyeCamera
from .scene.cameras import OrthographicCamera as OrthographicCamera
from .scene.cameras import PanoramaCamera as PanoramaCamera
from .scene.cameras import ThinLensCamera as ThinLensCamera
from .scene.curves import BSplineCurve as BSplineCurve
from .scene.curves import LinearCurve as LinearCurve
from .scene.emitters import DirectionalLight as DirectionalLight
from .scene.emitters import EnvironmentMap as EnvironmentMap
from .scene.emitters import PointLight as PointLight
from .scene.emitters import Projector as Projector
from .scene.emitters import SpotLight as SpotLight
from .scene.gradientindex import GradientIndexMedium as GradientIndexMedium
from .scene.heightfield import HeightField as HeightField
from .scene.layers import BlendBSDF as BlendBSDF
from .scene.layers import BumpMap as BumpMap
from .scene.layers import Mask as Mask
from .scene.layers import NormalMap as NormalMap
from .scene.layers import TwoSided as TwoSided
from .scene.materials import AnisotropicConductor as AnisotropicConductor
from .scene.materials import AnisotropicDielectric as AnisotropicDielectric
from .scene.materials import Conductor as Conductor
from .scene.materials import Dielectric as Dielectric
from .scene.materials import DispersiveDielectric as DispersiveDielectric
from .scene.materials import Hair as Hair
from .scene.materials import PPlastic as PPlastic
from .scene.materials import Plastic as Plastic
from .scene.materials import Principled as Principled
from .scene.materials import PrincipledThin as PrincipledThin
from .scene.materials import RednerMaterial as RednerMaterial
from .scene.materials import RoughConductor as RoughConductor
from .scene.materials import RoughDielectric as RoughDielectric
from .scene.materials import RoughPlastic as RoughPlastic
from .scene.materials import ThinDielectric as ThinDielectric
from .scene.media import HeterogeneousMedium as HeterogeneousMedium
from .scene.media import HomogeneousMedium as HomogeneousMedium
from .scene.mesh import Mesh as Mesh
from .scene.phases import BlendPhase as BlendPhase
from .scene.phases import TabulatedPhase as TabulatedPhase
from .scene.plugin import Plugin
from .scene.point_sensors import DistantSensor as DistantSensor
from .scene.point_sensors import RadianceMeter as RadianceMeter
from .scene.sdfgrid import SdfGrid as SdfGrid
from .scene.sensor import IrradianceMeter as IrradianceMeter
from .scene.shapes import Cylinder as Cylinder
from .scene.shapes import Disk as Disk
from .scene.shapes import Rectangle as Rectangle
from .scene.shapes import Sphere as Sphere
from .scene.textures import Bitmap as Bitmap
from .scene.textures import Checkerboard as Checkerboard
from .scene.textures import MeshAttribute as MeshAttribute
from .scene.textures import VolumeTexture as VolumeTexture
from .scene.volumes import ConstantVolume as ConstantVolume
from .scene.volumes import GridVolume as GridVolume
from .typing import Color, Number, TextureLike, Vector

class AreaLight(Plugin):
    """An emitting shape."""

    def __init__(
        self,
        *,
        radiance: TextureLike = 1.0,
        sampling_weight: Number = 1.0,
        stokes: Vector | None = None,
        **properties: Any,
    ) -> None: ...
    radiance: Any
    sampling_weight: torch.Tensor
    stokes: torch.Tensor

class CircularPolarizer(Plugin):
    """Circular polariser."""

    def __init__(
        self,
        *,
        transmittance: TextureLike = 1.0,
        left_handed: bool = False,
        **properties: Any,
    ) -> None: ...
    transmittance: Any
    left_handed: Any

class ConstantLight(Plugin):
    """A constant environment."""

    def __init__(
        self,
        *,
        radiance: Color = 1.0,
        sampling_weight: Number = 1.0,
        **properties: Any,
    ) -> None: ...
    radiance: Any
    sampling_weight: torch.Tensor

class ConstantTexture(Plugin):
    """A colour that is the same everywhere."""

    def __init__(
        self,
        *,
        value: Color | None = None,
        **properties: Any,
    ) -> None: ...
    value: Any

class Diffuse(Plugin):
    """Ideal diffuse (Lambertian) reflection, one-sided."""

    def __init__(
        self,
        *,
        reflectance: TextureLike = 0.5,
        **properties: Any,
    ) -> None: ...
    reflectance: Any

class DirectionalAreaLight(Plugin):
    """A shape that emits along its normal."""

    def __init__(
        self,
        *,
        radiance: TextureLike = 1.0,
        sampling_weight: Number = 1.0,
        stokes: Vector | None = None,
        **properties: Any,
    ) -> None: ...
    radiance: Any
    sampling_weight: torch.Tensor
    stokes: torch.Tensor

class HenyeyGreenstein(Plugin):
    """Henyey and Greenstein's phase function."""

    def __init__(
        self,
        *,
        g: Number = 0.8,
        **properties: Any,
    ) -> None: ...
    g: torch.Tensor

class Isotropic(Plugin):
    """Scatters alike in all directions."""

    def __init__(
        self,
        **properties: Any,
    ) -> None: ...

class Null(Plugin):
    """Rays pass through unchanged."""

    def __init__(
        self,
        **properties: Any,
    ) -> None: ...

class Polarizer(Plugin):
    """Linear polariser."""

    def __init__(
        self,
        *,
        theta: TextureLike = 0.0,
        transmittance: TextureLike = 1.0,
        **properties: Any,
    ) -> None: ...
    theta: Any
    transmittance: Any

class Rayleigh(Plugin):
    """Rayleigh's phase function, of particles like molecules."""

    def __init__(
        self,
        **properties: Any,
    ) -> None: ...

class Retarder(Plugin):
    """Linear retarder."""

    def __init__(
        self,
        *,
        theta: TextureLike = 0.0,
        delta: TextureLike = 90.0,
        transmittance: TextureLike = 1.0,
        **properties: Any,
    ) -> None: ...
    theta: Any
    delta: Any
    transmittance: Any
