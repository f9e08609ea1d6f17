// What kernels take of a card, as NVRTC 12.2 compiles them for sm_90: a tenth more than kernel_resources.txt has is an
// error.
#pragma once

#include <array>
#include <cstdio>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include "device/compiler.h"
#include "device/scene_facts.h"
#include "find_nvrtc.h"

namespace tr::testing {

struct KernelCase {
    const Kernel &kernel;
    const SceneFacts &facts;
    int bsdf;
    const char *suffix;
};

inline void check_resources(const std::vector<KernelCase> &cases) {
    const std::unique_ptr<cuda::Nvrtc> nvrtc = find_nvrtc();
    if (!nvrtc) return;
    if (nvrtc->version() != "12.2") {
        std::printf("  left out: it is NVRTC %s, but what kernels take is known by 12.2\n", nvrtc->version().c_str());
        return;
    }
    std::map<std::string, std::array<size_t, 4>> known;
    std::ifstream file(sources() + "/tests/kernel_resources.txt");
    for (std::string name, line; std::getline(file, line);) {
        std::istringstream words(line);
        std::array<size_t, 4> row{};
        if (words >> name >> row[0] >> row[1] >> row[2] >> row[3]) known[name] = row;
    }
    const cuda::KernelCompiler compiler(nvrtc.get(), sources(), KernelCache("/proc/torchrender_none"));
    for (const KernelCase &each : cases) {
        const std::string name = each.kernel.name + std::string(each.suffix);
        const auto [registers, stack, spilled, code] =
            compiler.resources(each.kernel, 90, each.facts.options(each.kernel.knows, each.bsdf));
        const std::array<size_t, 4> found{registers, stack, spilled, code};
        bool within = known.count(name) != 0;
        for (size_t k = 0; within && k < 4; ++k) within = 10 * found[k] <= 11 * known[name][k];
        if (!within)
            report(__FILE__, __LINE__,
                   "more than kernel_resources.txt has, or nothing there: " + name + " " + std::to_string(registers) +
                       " " + std::to_string(stack) + " " + std::to_string(spilled) + " " + std::to_string(code));
    }
}

// Of a room of meshes in which everything is diffuse, of one colour.
inline SceneFacts facts_of_room() {
    SceneFacts room;
    room.shape_flags = HasNormals | HasTexcoords, room.textures = 1, room.emitters = 1, room.sensors = 1;
    room.pinhole = true, room.sampler = int32_t(SamplerKind::Sobol);
    return room;
}

}  // namespace tr::testing
