// What a call of the renderer takes and returns besides tensors, from and to Python.
#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <string>

#include "config.h"
#include "functions.h"
#include "samplers.h"

namespace tr {

// Asks Python, a few times a second, whether to stop, and tells it the share that is done.
class Interruption {
public:
    explicit Interruption(Progress progress) : progress_(progress) {}
    bool operator()(double done) {
        auto now = std::chrono::steady_clock::now();
        if (!progress_ || now - last_ < std::chrono::milliseconds(50)) return false;
        last_ = now;
        return progress_(done) != 0;
    }

private:
    Progress progress_;
    std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

// Of this name; false if there is none.
inline bool filter_of(const std::string &name, FilterKind &kind) {
    constexpr const char *names[] = {"box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos"};
    for (int i = 0; i < 6; ++i)
        if (name == names[i]) return kind = FilterKind(i), true;
    return false;
}

inline Rect rect(const Value &value) {
    auto r = value.as<std::array<int, 4>>();
    return {r[0], r[1], r[0] + r[2], r[1] + r[3]};
}

// Whether there is such an entry that is True.
inline bool flag(const Value &d, const char *name) {
    const Value *found = d.find(name);
    return found && found->as<bool>();
}

inline Config read_config(const Value &d, Progress progress) {
    Config c{};
    c.path.max_depth = d["max_depth"].as<int>();
    c.path.rr_depth = d["rr_depth"].as<int>();
    c.path.hide_emitters = d["hide_emitters"].as<bool>();
    c.path.emitter_samples = d["emitter_samples"].as<int>();
    c.path.bsdf_samples = d["bsdf_samples"].as<int>();
    c.path.seed = d["seed"].as<uint64_t>();
    c.path.sensor = d["sensor"].as<uint32_t>();
    auto size = d["film_size"].as<std::array<int, 2>>();
    c.height = size[0], c.width = size[1];
    c.crop = rect(d["crop"]);
    c.window = d.find("window") ? rect(d["window"]) : c.crop;
    FilterKind filter = FilterKind::Box;
    if (!filter_of(d["filter"].as<std::string>(), filter))
        throw std::invalid_argument("filter: unknown type '" + d["filter"].as<std::string>() + "'");
    auto numbers = d["filter_param"].as<std::array<double, 2>>();
    c.filter = Filter(filter, numbers[0], numbers[1]);
    if (d.find("pixels")) {  // (n, 2) rows and columns of the crop, int64
        auto [address, n] = d["pixels"].as<std::pair<uintptr_t, size_t>>();
        const int64_t *p = reinterpret_cast<const int64_t *>(address);
        c.pixels.emplace(n);
        for (size_t i = 0; i < n; ++i)
            (*c.pixels)[i] = {c.crop.y0 + int32_t(p[2 * i]), c.crop.x0 + int32_t(p[2 * i + 1])};
    }
    c.threads = std::max(1, d["threads"].as<int>());
    c.spp = d["spp"].as<int64_t>();
    c.sample_offset = d["sample_offset"].as<int64_t>();
    // samples of a pixel that are spread together, of which these may be a part: the first and how many
    auto pattern =
        d.find("pattern") ? d["pattern"].as<std::pair<int64_t, int64_t>>() : std::pair(c.sample_offset, c.spp);
    c.path.sampler = make_sampler(sampler_kind(d["sampler"].as<std::string>()), pattern.first, pattern.second);
    c.path.volumetric = flag(d, "volumetric");
    if (d.find("spectral")) {  // addresses of numbers in the scene's precision, see SpectralConfig
        auto [positions, intervals, weights] = d["spectral"].as<std::tuple<uintptr_t, int32_t, uintptr_t>>();
        c.path.spectral = {reinterpret_cast<const void *>(positions), intervals,
                           reinterpret_cast<const void *>(weights)};
    }
    c.path.stokes = flag(d, "stokes");
    c.device = d.find("device") ? d["device"].as<std::string>() : "cpu";
    if (d.find("on_device")) {  // gradients and values by slot, and the image
        auto [slots, values, image] = d["on_device"].as<std::tuple<std::vector<bool>, std::vector<bool>, bool>>();
        c.on_device = {{slots.begin(), slots.end()}, {values.begin(), values.end()}, image};
    }
    c.stream = d.find("stream") ? d["stream"].as<uintptr_t>() : 0;
    c.light = d["integrator"].as<std::string>() == "ptracer";
    c.glued = flag(d, "glued");
    if (d.find("attributes")) c.attributes = d["attributes"].as<std::vector<int32_t>>();
    if (d.find("seeds")) c.seeds = d["seeds"].as<std::vector<uint64_t>>();
    c.zero_at_misses = flag(d, "zero_at_misses");
    if (const Value *hits = d.find("hits")) {  // radiance: the store, the number of the pass
        auto [store, pass] = hits->as<std::pair<Value, size_t>>();
        c.hits = object_of<HitStore>(store).get();
        c.hits_pass = pass;
    }
    if (const Value *sums = d.find("sums")) c.sums = object_of<FilmSums>(*sums).get();
    c.interrupted = Interruption(progress);
    c.adaptive = flag(d, "adaptive");
    c.fixed_sums = flag(d, "fixed_sums");
    c.by_power = d.find("emitter_sampling") && d["emitter_sampling"].as<std::string>() == "power";
    return c;
}

inline Value to_value(const RenderStats &s) {
    if (s.interrupted) throw Interrupted{};
    return Value::Dict{
        {"nonfinite", s.non_finite},        {"nonfinite_where", s.non_finite_where},
        {"closest_rays", s.closest_rays},   {"shadow_rays", s.shadow_rays},
        {"collisions", s.collisions},       {"majorants_exceeded", s.majorants_exceeded},
        {"bent_rays", s.bent_rays},         {"bent_rays_lost", s.bent_rays_lost},
        {"bent_rays_met", s.bent_rays_met}, {"seconds", s.seconds},
        {"seconds_trace", s.seconds_trace}, {"lanes", s.lane_slots ? double(s.lanes) / double(s.lane_slots) : 0.0}};
}

}  // namespace tr
