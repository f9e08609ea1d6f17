// The functions of the core that a kernel of paths calls, compiled with it: of the models those that the scene has, of
// the BSDFs the one that is shaded.
#pragma once

#include "core/emitter/emitter.cpp"
#include "core/integrator/camera.cpp"
#include "core/integrator/classify.cpp"
#include "core/shape/surface.cpp"
#include "core/texture/texture.cpp"
#if TR_STACKS
#include "core/integrator/bsdf_stack.cpp"
#endif
#if TR_VOLUMETRIC
#include "core/integrator/medium.cpp"
#include "core/integrator/shadow_transmittance.cpp"
#if TR_PHASE_KINDS >> 0 & 1
#include "core/phase/isotropic.cpp"
#endif
#if TR_PHASE_KINDS >> 1 & 1
#include "core/phase/hg.cpp"
#endif
#if TR_PHASE_KINDS >> 2 & 1
#include "core/phase/rayleigh.cpp"
#endif
#if TR_PHASE_KINDS >> 3 & 1
#include "core/phase/tabulated.cpp"
#endif
#if TR_PHASE_KINDS >> 4 & 1
#include "core/phase/blend.cpp"
#endif
#endif
#if TR_EMITTER_KINDS >> 0 & 1
#include "core/emitter/area.cpp"
#endif
#if TR_EMITTER_KINDS >> 1 & 1
#include "core/emitter/constant.cpp"
#endif
#if TR_EMITTER_KINDS >> 2 & 1
#include "core/emitter/envmap.cpp"
#endif
#if TR_EMITTER_KINDS >> 3 & 1
#include "core/emitter/point.cpp"
#endif
#if TR_EMITTER_KINDS >> 4 & 1
#include "core/emitter/directionalarea.cpp"
#endif
#if TR_EMITTER_KINDS >> 5 & 1
#include "core/emitter/directional.cpp"
#endif
#if TR_EMITTER_KINDS >> 6 & 1
#include "core/emitter/spot.cpp"
#endif
#if TR_EMITTER_KINDS >> 7 & 1
#include "core/emitter/projector.cpp"
#endif
#if defined(TR_ONE_BSDF)
#include TR_BSDF_SOURCE
#include "core/bsdf/bsdf.cpp"
#include "core/bsdf/parameters.cpp"
#endif
#include "core/integrator/surface.cpp"
#if TR_LIGHT_PATHS
#include "core/integrator/light.cpp"
#endif
