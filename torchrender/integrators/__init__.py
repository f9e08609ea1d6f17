"""How light is transported (`transport`), what else an image may show (`stacks`), and both from dicts (`reading`)."""

from .reading import DOCUMENTED as DOCUMENTED
from .reading import TYPES as TYPES
from .reading import from_dict as from_dict
from .reading import ignored_names as ignored_names
from .stacks import AOV as AOV
from .stacks import Depth as Depth
from .stacks import Moment as Moment
from .stacks import Stack as Stack
from .stacks import Stokes as Stokes
from .transport import DirectIllumination as DirectIllumination
from .transport import GradientIndexTracer as GradientIndexTracer
from .transport import Integrator as Integrator
from .transport import ParticleTracer as ParticleTracer
from .transport import PathTracer as PathTracer
from .transport import VolumetricPathTracer as VolumetricPathTracer
from .transport import WavefrontPathTracer as WavefrontPathTracer
