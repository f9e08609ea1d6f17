// What the bindings call: one render, one derivative.
#pragma once

#include <algorithm>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "accel/ray_record.h"
#include "core/adjoint/gradient_sink.h"
#include "core/adjoint/needs.h"
#include "core/integrator/config.h"
#include "film.h"
#include "host/gradient.h"
#include "host/parallel.h"
#include "stored_hits.h"
#include "tile_schedule.h"

namespace tr {

// Whether to stop, asked between batches and between vertices of paths.
using Stop = std::function<bool()>;

// What of a call's tensors lies in the memory of the device that computes, where the host does not reach it. By slot,
// or empty: gradients and tangents, and values. And the image, or the adjoint of it.
struct OnDevice {
    std::vector<uint8_t> slots, values;
    bool image = false;

    bool slot(size_t i) const { return i < slots.size() && slots[i]; }
    bool value(size_t i) const { return i < values.size() && values[i]; }
};

template <class S>
struct RenderCall {
    const SceneView<S> *scene;
    const Accel *accel;
    PathConfig config;
    Filter filter;
    int film_height, film_width;
    Rect crop;                                   // the pixels that are wanted
    const std::vector<Pixel> *pixels = nullptr;  // not null: these are wanted, in this order, in place of the crop
    Rect samples;                                // samples are drawn nowhere else
    int values;  // colours of a pixel: red, green and blue, or the first component of the spectrum
    int numbers() const { return config.stokes ? 4 * values : values; }  // of a pixel of the image
    int64_t spp, sample_offset;
    int threads;
    RayRecord *ray_record = nullptr;          // not null: keeps the rays that are queried
    StoredHits *keep_hits = nullptr;          // primal: what is hit is kept there
    const StoredHits *kept_hits = nullptr;    // reverse: what a primal call of the same samples has kept
    OnDevice on_device;                       // where another device than the CPU computes
    std::function<bool(double)> interrupted;  // polled by the calling thread with the share that is done; true: stop
};

// What a derivative needs besides.
template <class S>
struct DerivativeCall {
    const S *adjoint = nullptr;  // reverse: d loss / d image, (h, w, values)
    std::vector<S *> gradients;  // reverse: by slot, null where not wanted; added to
    GradientSums sums;           // reverse: filled by the call
    size_t n_constants = 0;      // with the matrices of curved shapes
    GeometrySizes geometry_sizes;
    uint32_t matrices = 0;                // where those begin
    std::vector<int64_t> sizes;           // numbers in each slot's tensor
    Values<S> tangent{nullptr, nullptr};  // forward
    const S *vertex_tangent[VertexArrays] = {};
    GradientNeeds needs{true, true, true, true, true, {1, 1, 1, 1}};
    std::vector<int32_t> bsdfs;               // by bsdf: a parameter of it is differentiated
    std::optional<std::vector<float>> boxes;  // of shapes with such a BSDF, see SceneData::boxes_with
    std::vector<uint32_t> variables;          // by a BSDF's kind, see GradientNeeds; empty: all count
    std::vector<int32_t> shapes;              // by shape, see ShapeWants
    bool adaptive = false;                    // reverse: more samples where the adjoint is larger, see allocation.h
    bool fixed_sums = false;                  // reverse, on devices: gradients do not depend on any order

    GradientNeeds gradient_needs() const {
        GradientNeeds r = needs;
        r.bsdfs = r.bsdf ? bsdfs.data() : nullptr;
        r.variables = variables.empty() ? nullptr : variables.data();
        if (boxes) r.boxes = boxes->data(), r.n_boxes = int32_t(boxes->size() / 6);
        return r;
    }
    // Of a forward sweep; those of reverse mode have buffers of their own (work_items.h).
    template <class F>
    GradientSink<F> forward_sink() const {
        GradientSink<F> sink;
        sink.forward = true;
        sink.matrices = matrices;
        sink.shape_wanted = shapes.data();
        sink.tangent = tangent;
        std::copy_n(vertex_tangent, VertexArrays, sink.vertex_tangent);
        return sink;
    }
};

inline const char *name_of(Culprit culprit) {
    constexpr const char *names[] = {"", "emitter", "environment", "bsdf", "medium"};
    return names[int(culprit)];
}

struct RenderStats {
    uint64_t non_finite = 0, closest_rays = 0, shadow_rays = 0, lanes = 0, lane_slots = 0;
    uint64_t collisions = 0, majorants_exceeded = 0;  // tentative collisions in gridded media
    // in media where they bend; that were given up; that met another such medium from within one
    uint64_t bent_rays = 0, bent_rays_lost = 0, bent_rays_met = 0;
    std::string non_finite_where;
    double seconds = 0, seconds_trace = 0;
    bool interrupted = false;

    void count_non_finite(uint64_t n, const std::string &where) {
        non_finite += n;
        if (n && non_finite_where.empty()) non_finite_where = where;
    }
    void add(const RenderStats &other) {
        count_non_finite(other.non_finite, other.non_finite_where);
        closest_rays += other.closest_rays, shadow_rays += other.shadow_rays;
        lanes += other.lanes, lane_slots += other.lane_slots;
        collisions += other.collisions, majorants_exceeded += other.majorants_exceeded;
        bent_rays += other.bent_rays, bent_rays_lost += other.bent_rays_lost;
        bent_rays_met += other.bent_rays_met;
        seconds_trace += other.seconds_trace;
    }
    // Of another call, in which nothing ran at the same time.
    void add_call(const RenderStats &other) {
        add(other);
        seconds += other.seconds;
        interrupted = interrupted || other.interrupted;
    }
};

// Results for every wanted pixel, in rows or in the order of the list. `sums`, if not null, are those of earlier
// samples of the same pixels: the call adds its own, and the results are those of all. A call that is interrupted
// changes nothing.
template <class S>
struct RenderOutput {
    ImagePlaces<S> to;
    FilmSums *sums = nullptr;
};

// The results of a film of radiance and alpha, and `moments` of radiance: the sums of its wanted pixels, one after the
// other.
template <class S>
void write_results(const RenderCall<S> &call, const TileSchedule &schedule, const double *film, int moments,
                   const RenderOutput<S> &out) {
    const int channels = FilmBlock::channels(call.numbers() + 1, moments);
    if (out.sums) out.sums->begin(schedule.n_results() * size_t(channels), call.spp);
    auto write = [&](size_t i) {
        const double *p = film + schedule.target_of(i) * size_t(channels);
        if (out.sums) p = out.sums->add(i * size_t(channels), p, channels);
        out.to.write(i, p, call.numbers(), moments);
    };
    for_ranges(schedule.n_results(), call.threads, [&](size_t begin, size_t end, int) {
        for (size_t i = begin; i < end; ++i) write(i);
    });
}

template <class S>
RenderStats render_primal(const RenderCall<S> &call, const RenderOutput<S> &out);
template <class S>
RenderStats render_forward(const RenderCall<S> &call, const DerivativeCall<S> &derivative, S *image);

// One pass of paths for adjoints of the same image, each a call; what any of them needs the first one needs, too. More
// than one: not of polarised light, and none of them adaptive.
template <class S>
RenderStats render_reverse(const RenderCall<S> &call, const std::vector<DerivativeCall<S> *> &derivatives);
template <class S>
RenderStats render_reverse(const RenderCall<S> &call, DerivativeCall<S> &derivative) {
    return render_reverse(call, std::vector<DerivativeCall<S> *>{&derivative});
}
// The same by light tracing, without alpha and variance.
template <class S>
RenderStats trace_light(const RenderCall<S> &call, S *image, FilmSums *sums = nullptr);
template <class S>
RenderStats trace_light_reverse(const RenderCall<S> &call, DerivativeCall<S> &derivative);
template <class S>
RenderStats trace_light_forward(const RenderCall<S> &call, const DerivativeCall<S> &derivative, S *image);

}  // namespace tr
