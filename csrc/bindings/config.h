// What a call of the renderer takes besides tensors.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "cpu/render.h"

namespace tr {

struct Config {
    PathConfig path;
    Filter filter;
    int height, width, threads;
    Rect crop, window;
    int64_t spp, sample_offset;
    bool light;          // paths begin at emitters
    std::string device;  // where radiance is rendered: cpu, emulated or tree
    OnDevice on_device;
    std::uintptr_t stream;  // of a card, see Launcher
    bool glued;             // of outlines: samples for such paths
    std::optional<std::vector<Pixel>> pixels;
    std::vector<int32_t> attributes;  // numbers of the names of meshes' colours that are put out
    std::vector<uint64_t> seeds;      // of the passes of other outputs than radiance
    bool zero_at_misses;
    bool adaptive;    // reverse mode of radiance
    bool fixed_sums;  // ... of devices, see DerivativeCall
    bool by_power;    // emitters are chosen by their power, too
    HitStore *hits;   // may be null
    std::size_t hits_pass;
    FilmSums *sums;                           // of earlier samples; may be null
    std::function<bool(double)> interrupted;  // of RenderCall
};

}  // namespace tr
