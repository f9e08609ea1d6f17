// What the bindings call: one render, one derivative.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "accel/accel.h"
#include "core/adjoint/sweep.h"
#include "film.h"
#include "host/gradient.h"

namespace tr {

template <class S>
struct RenderCall {
    const SceneView<S> *scene;
    const Accel *accel;
    PathConfig config;
    Filter filter;
    int film_height, film_width;
    Rect crop;     // the pixels that are wanted
    Rect samples;  // the pixels in which samples are drawn
    int64_t spp, sample_offset;
    int threads;
    std::function<bool()> interrupted;  // polled by the calling thread; true stops the call
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
    Wanted wanted{true, true, true, true, true};
    std::vector<uint8_t> bsdf_wanted;   // by bsdf: a parameter of it is differentiated
    std::vector<int32_t> shape_wanted;  // by shape: it moves, or its normals or coordinates do
};

struct RenderStats {
    uint64_t non_finite = 0, closest_rays = 0, shadow_rays = 0, lanes = 0, lane_slots = 0;
    std::string non_finite_where;
    double seconds = 0, seconds_trace = 0;
    bool interrupted = false;
};

// `image` (h, w, C) and, if not null, `alpha` (h, w) of the crop.
template <class S, int C>
RenderStats render_primal(const RenderCall<S> &call, bool packets, S *image, S *alpha);
template <class S, int C>
RenderStats render_reverse(const RenderCall<S> &call, bool packets, DerivativeCall<S> &derivative);
template <class S, int C>
RenderStats render_forward(const RenderCall<S> &call, bool packets, const DerivativeCall<S> &derivative, S *image);

}  // namespace tr
