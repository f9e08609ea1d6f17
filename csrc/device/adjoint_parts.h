// The functions of the core that a kernel of the sweep calls besides those in core_parts.h.
#pragma once

#include "core/adjoint/camera.cpp"
#include "core/adjoint/gradient_sink.cpp"
#include "core/adjoint/lookup.cpp"
#include "core/adjoint/scattering.cpp"
#include "core/adjoint/surface.cpp"
#include "core/adjoint/sweep.cpp"
#include "core_parts.h"
#if TR_VOLUMETRIC
#include "core/adjoint/medium.cpp"
#include "core/adjoint/medium_motion.cpp"
#endif
#if TR_LIGHT_PATHS
#include "core/adjoint/light.cpp"
#endif
#if TR_STACKS
#include "core/adjoint/stack.cpp"
#endif
