// What is known when the code is compiled. The CPU's is for all scenes. A kernel of a device is compiled for one
// (device/scene_facts.h): facts are constants there, and what the scene cannot have is left out.
#pragma once

#include "config.h"

#if defined(TR_ONE_SCENE)
// A member that has this value in all calls of the kernel; the host's keeps its place.
#define TR_FACT(type, name, value)      \
    static constexpr type name = value; \
    type name##_of_host
#else
#define TR_FACT(type, name, value) type name
#endif
// What paths keep. Kernels that do not know find out when they run, and are the same for all paths of a scene.
#if defined(TR_RECORDS)
#define TR_RECORDED(name) TR_FACT(bool, name, TR_RECORDS)
#else
#define TR_RECORDED(name) bool name
#endif
#if defined(TR_RECORDS) && !TR_RECORDS
#define TR_TAPE(type, name) TR_FACT(type, name, nullptr)
#else
#define TR_TAPE(type, name) type name
#endif
// Pointers in tables of functions that kernels of light paths, or of derivatives, alone call: others do not compile
// them.
#if defined(TR_ONE_SCENE) && !TR_LIGHT_PATHS
#define TR_OF_LIGHT_PATHS(p) nullptr
#else
#define TR_OF_LIGHT_PATHS(p) p
#endif
#if defined(TR_ONE_SCENE) && !TR_DERIVATIVES
#define TR_OF_DERIVATIVES(p) nullptr
#else
#define TR_OF_DERIVATIVES(p) p
#endif

#if defined(TR_MOTION) && !TR_MOTION
#define TR_MOVES(name) TR_FACT(bool, name, false)
#else
#define TR_MOVES(name) bool name
#endif

#if defined(TR_ONE_SCENE) && !TR_CHROMATIC
#define TR_CHROMATIC_MEDIA(name) TR_FACT(bool, name, false)
#else
#define TR_CHROMATIC_MEDIA(name) bool name
#endif

// The same of a BSDF's kind.
#if defined(TR_BSDF_KIND)
#define TR_MODEL_FACT(type, name, value) TR_FACT(type, name, value)
#else
#define TR_MODEL_FACT(type, name, value) type name
#endif

namespace tr::facts {

#if defined(TR_ONE_SCENE)
constexpr int32_t ShapeFlags = TR_SHAPE_FLAGS;  // of all shapes
constexpr uint32_t TextureKinds = TR_TEXTURE_KINDS, EmitterKinds = TR_EMITTER_KINDS, SensorKinds = TR_SENSOR_KINDS,
                   PhaseKinds = TR_PHASE_KINDS;
constexpr bool Pinhole = TR_PINHOLE, Lens = !TR_PINHOLE, Spectral = false, Bends = false;
#else
constexpr int32_t ShapeFlags = -1;
constexpr uint32_t TextureKinds = ~0u, EmitterKinds = ~0u, SensorKinds = ~0u, PhaseKinds = ~0u;
constexpr bool Pinhole = true, Lens = true, Spectral = true, Bends = true;  // each is possible
#endif

// Whether there can be a model of this kind.
constexpr bool has(uint32_t kinds, int kind) { return (kinds >> kind & 1u) != 0; }

}  // namespace tr::facts
