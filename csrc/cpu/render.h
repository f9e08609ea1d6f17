// What the bindings call: one render, one derivative.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "accel/ray_record.h"
#include "core/adjoint/sweep.h"
#include "film.h"
#include "host/gradient.h"
#include "plan.h"
#include "stored_hits.h"

namespace tr {

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
    int64_t spp, sample_offset;
    int threads;
    RayRecord *ray_record = nullptr;        // not null: keeps the rays that are queried
    StoredHits *keep_hits = nullptr;        // primal: what is hit is kept there
    const StoredHits *kept_hits = nullptr;  // reverse: what a primal call of the same samples has kept
    std::function<bool()> interrupted;      // polled by the calling thread; true stops the call
};

// What a derivative needs besides.
template <class S>
struct DerivativeCall {
    const S *adjoint = nullptr;  // reverse: d loss / d image, (h, w, C)
    std::vector<S *> gradients;  // reverse: by slot, null where not wanted; added to
    GradientSums sums;           // reverse: filled by the call
    size_t n_constants = 0;      // with the matrices of curved shapes
    GeometrySizes geometry_sizes;
    uint32_t matrices = 0;                // where those begin
    std::vector<int64_t> sizes;           // numbers in each slot's tensor
    Values<S> tangent{nullptr, nullptr};  // forward
    GeometryTables<const S> geometry_tangent;
    Wanted wanted{true, true, true, true, true, {1, 1, 1, 1}};
    std::vector<int32_t> bsdf_wanted;   // by bsdf: a parameter of it is differentiated
    bool adaptive = false;              // reverse: more samples where the adjoint is larger, see allocation.h
    std::vector<int32_t> shape_wanted;  // by shape: it moves, or its normals or coordinates do
};

struct RenderStats {
    uint64_t non_finite = 0, closest_rays = 0, shadow_rays = 0, lanes = 0, lane_slots = 0;
    uint64_t collisions = 0, majorants_exceeded = 0;  // tentative collisions in gridded media
    std::string non_finite_where;
    double seconds = 0, seconds_trace = 0;
    bool interrupted = false;
};

// Results for every wanted pixel, in rows or in the order of the list: `image` (n, C) and, if not null, `alpha` (n) and
// `variance` (n, C), the variance of the image's values.
template <class S>
struct RenderOutput {
    S *image, *alpha = nullptr, *variance = nullptr;
};

template <class S, int C>
RenderStats render_primal(const RenderCall<S> &call, bool packets, const RenderOutput<S> &out);
template <class S, int C>
RenderStats render_reverse(const RenderCall<S> &call, bool packets, DerivativeCall<S> &derivative);
template <class S, int C>
RenderStats render_forward(const RenderCall<S> &call, bool packets, const DerivativeCall<S> &derivative, S *image);

// The same by light tracing, without alpha and variance.
template <class S, int C>
RenderStats trace_light(const RenderCall<S> &call, bool packets, S *image);
template <class S, int C>
RenderStats trace_light_reverse(const RenderCall<S> &call, bool packets, DerivativeCall<S> &derivative);
template <class S, int C>
RenderStats trace_light_forward(const RenderCall<S> &call, bool packets, const DerivativeCall<S> &derivative, S *image);

}  // namespace tr
