// What a call of the renderer takes and returns besides tensors, from and to Python.
#pragma once

#include <pybind11/stl.h>

#include <array>
#include <chrono>
#include <string>

#include "config.h"
#include "samplers.h"

namespace tr {

namespace py = pybind11;

// Asks Python, a few times a second, whether Ctrl-C was pressed, and tells `progress`, if there is one, the share that
// is done. The error stays set in the thread's state. The function is held by the dict that it came in.
class Interruption {
public:
    explicit Interruption(PyObject *progress) : progress_(progress) {}
    bool operator()(double done) {
        auto now = std::chrono::steady_clock::now();
        if (now - last_ < std::chrono::milliseconds(50)) return false;
        last_ = now;
        py::gil_scoped_acquire acquire;
        if (PyErr_CheckSignals() != 0) return true;
        if (!progress_) return false;
        PyObject *result = PyObject_CallFunction(progress_, "d", done);
        Py_XDECREF(result);
        return result == nullptr;
    }

private:
    PyObject *progress_;
    std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

inline Rect rect(const py::handle &h) {
    auto r = h.cast<std::array<int, 4>>();
    return {r[0], r[1], r[0] + r[2], r[1] + r[3]};
}

inline Config read_config(const py::dict &d) {
    Config c{};
    c.path.max_depth = d["max_depth"].cast<int>();
    c.path.rr_depth = d["rr_depth"].cast<int>();
    c.path.hide_emitters = d["hide_emitters"].cast<bool>();
    c.path.emitter_samples = d["emitter_samples"].cast<int>();
    c.path.bsdf_samples = d["bsdf_samples"].cast<int>();
    c.path.seed = d["seed"].cast<uint64_t>();
    c.path.sensor = d["sensor"].cast<uint32_t>();
    auto size = d["film_size"].cast<std::array<int, 2>>();
    c.height = size[0], c.width = size[1];
    c.crop = rect(d["crop"]);
    c.window = d.contains("window") ? rect(d["window"]) : c.crop;
    FilterKind filter = FilterKind::Box;
    if (!filter_of(d["filter"].cast<std::string>(), filter))
        throw std::invalid_argument("filter: unknown type '" + d["filter"].cast<std::string>() + "'");
    auto numbers = d["filter_param"].cast<std::array<double, 2>>();
    c.filter = Filter(filter, numbers[0], numbers[1]);
    if (d.contains("pixels")) {  // (n, 2) rows and columns of the crop, int64
        auto [address, n] = d["pixels"].cast<std::pair<uintptr_t, size_t>>();
        const int64_t *p = reinterpret_cast<const int64_t *>(address);
        c.pixels.emplace(n);
        for (size_t i = 0; i < n; ++i)
            (*c.pixels)[i] = {c.crop.y0 + int32_t(p[2 * i]), c.crop.x0 + int32_t(p[2 * i + 1])};
    }
    c.threads = std::max(1, d["threads"].cast<int>());
    c.spp = d["spp"].cast<int64_t>();
    c.sample_offset = d["sample_offset"].cast<int64_t>();
    // samples of a pixel that are spread together, of which these may be a part: the first and how many
    auto pattern =
        d.contains("pattern") ? d["pattern"].cast<std::pair<int64_t, int64_t>>() : std::pair(c.sample_offset, c.spp);
    c.path.sampler = make_sampler(sampler_kind(d["sampler"].cast<std::string>()), pattern.first, pattern.second);
    c.path.volumetric = d.contains("volumetric") && d["volumetric"].cast<bool>();
    if (d.contains("spectral")) {  // addresses of numbers in the scene's precision, see SpectralConfig
        auto [positions, intervals, weights] = d["spectral"].cast<std::tuple<uintptr_t, int32_t, uintptr_t>>();
        c.path.spectral = {reinterpret_cast<const void *>(positions), intervals,
                           reinterpret_cast<const void *>(weights)};
    }
    c.path.stokes = d.contains("stokes") && d["stokes"].cast<bool>();
    c.light = d["integrator"].cast<std::string>() == "ptracer";
    c.glued = d.contains("glued") && d["glued"].cast<bool>();
    if (d.contains("attributes")) c.attributes = d["attributes"].cast<std::vector<int32_t>>();
    if (d.contains("seeds")) c.seeds = d["seeds"].cast<std::vector<uint64_t>>();
    c.zero_at_misses = d.contains("zero_at_misses") && d["zero_at_misses"].cast<bool>();
    if (d.contains("hits")) {  // radiance: the store, the number of the pass
        auto hits = d["hits"].cast<py::tuple>();
        c.hits = &hits[0].cast<HitStore &>();
        c.hits_pass = hits[1].cast<size_t>();
    }
    if (d.contains("sums")) c.sums = &d["sums"].cast<FilmSums &>();
    c.interrupted = Interruption(d.contains("progress") ? py::object(d["progress"]).ptr() : nullptr);
    c.adaptive = d.contains("adaptive") && d["adaptive"].cast<bool>();
    c.by_power = d.contains("emitter_sampling") && d["emitter_sampling"].cast<std::string>() == "power";
    return c;
}

inline py::dict to_dict(const RenderStats &s) {
    if (s.interrupted) throw py::error_already_set();
    py::dict d;
    d["nonfinite"] = s.non_finite;
    d["nonfinite_where"] = s.non_finite_where;
    d["closest_rays"] = s.closest_rays;
    d["shadow_rays"] = s.shadow_rays;
    d["collisions"] = s.collisions;
    d["majorants_exceeded"] = s.majorants_exceeded;
    d["bent_rays"] = s.bent_rays;
    d["bent_rays_lost"] = s.bent_rays_lost;
    d["bent_rays_met"] = s.bent_rays_met;
    d["seconds"] = s.seconds;
    d["seconds_trace"] = s.seconds_trace;
    d["lanes"] = s.lane_slots ? double(s.lanes) / double(s.lane_slots) : 0.0;
    return d;
}

}  // namespace tr
