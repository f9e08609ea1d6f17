// What kernels are told of a scene when they are compiled (core/math/facts.h): with it they are a tenth as large, and
// compiled in a second each.
#pragma once

#include <string>
#include <vector>

#include "core/integrator/config.h"
#include "core/scene.h"
#include "kernel.h"

namespace tr {

struct SceneFacts {
    int32_t shape_flags = 0;
    uint32_t textures = 0, emitters = 0, sensors = 0, phases = 0;  // kinds, a bit each
    bool textured = false, pinhole = false, stacks = false, tangents = false;
    bool records = false, forward = false, motion = false;  // paths are on a tape; in forward mode; something moves
    bool fixed_sums = false;
    bool volumetric = false, chromatic = false;  // paths through media, of coloured extinction
    bool light_paths = false;
    int32_t sampler = 0;

    SceneFacts() = default;
    template <class S>
    SceneFacts(const SceneView<S> &scene, const PathConfig &config);

    // Definitions for the compiler, of what such a kernel has to know. `bsdf`: the kind that it shades.
    std::vector<std::string> options(Knowledge knowledge, int bsdf) const;
};

}  // namespace tr
