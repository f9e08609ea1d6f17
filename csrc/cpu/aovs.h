// Outputs besides radiance, for the wanted pixels of a film.
#pragma once

#include "core/integrator/aovs.h"
#include "core/state/queues.h"
#include "render.h"

namespace tr {

// For every wanted pixel: tensors (n, channels) by kind, null where not wanted; identifiers (n), may be null.
template <class S>
struct AovOutput {
    std::array<S *, AovCount> data{};
    int32_t *shape = nullptr, *primitive = nullptr, *material = nullptr;
    S *covered = nullptr;  // primal: weight of the samples that hit something, of all
    std::array<int32_t, AovAttributes> attributes{-1, -1, -1, -1};  // numbers of their names
    std::vector<uint64_t> seeds;                                    // of each pass
    bool zero_at_misses = false;  // averages over all samples, zero where nothing is hit, in place of those that hit
};

template <class S>
AovLayout layout_of(const AovOutput<S> &out, int colors) {
    AovLayout r(colors, [&](int kind) { return out.data[size_t(kind)] != nullptr; });
    r.attributes = out.attributes;
    return r;
}
template <class S>
AovLayout no_outputs(const RenderCall<S> &call) {
    return AovLayout(call.values, [](int) { return false; });
}
// What averages over the samples that hit something are weighted with: filters with negative lobes would make anything
// of them beside an outline, where such a lobe may be all that reaches the object.
template <class S>
Filter filter_of(const AovOutput<S> &out, const Filter &filter) {
    return out.zero_at_misses ? filter : filter.magnitude();
}

// What averages are divided by, for every wanted pixel: the sum of the filter's weights over samples, (n), and with the
// weights of outputs besides radiance over those that hit something, and over all, (n, 2). Null where not wanted.
struct PixelWeights {
    double *samples = nullptr, *hits = nullptr;
};

// Hands the channels of the film's pixels out, whose sums are those of the channels, of the weights of samples that hit
// something, and of all weights: averages, or infinity or zero where nothing was hit.
template <class S>
void write_outputs(const TileSchedule &schedule, const AovLayout &layout, const double *film, const AovOutput<S> &out,
                   bool derivative) {
    for (size_t i = 0; i < schedule.n_results(); ++i) {
        const double *p = film + schedule.target_of(i) * size_t(layout.n + 2);
        double total = out.zero_at_misses ? p[layout.n + 1] : p[layout.n];  // the first may be negative
        if (out.covered) out.covered[i] = p[layout.n + 1] != 0 ? S(p[layout.n] / p[layout.n + 1]) : S(0);
        for (int kind = 0; kind < AovCount; ++kind) {
            if (!layout.wants(kind)) continue;
            int n = layout.count(kind);
            bool infinite = aov_names[kind].infinite && !out.zero_at_misses && !derivative;
            S none = infinite ? S(INFINITY) : S(0), *to = out.data[size_t(kind)] + i * size_t(n);
            for (int c = 0; c < n; ++c) to[c] = total != 0 ? S(p[layout.offset[kind] + c] / total) : none;
        }
    }
}

// Of a result, what the ray through the centre of its pixel has hit.
template <class S>
void write_identifiers(const SceneView<S> &scene, size_t i, uint32_t shape, uint32_t primitive,
                       const AovOutput<S> &out) {
    const bool hit = shape != NoHit;
    if (out.shape) out.shape[i] = hit ? int32_t(shape) : -1;
    if (out.primitive) out.primitive[i] = hit ? int32_t(primitive) : -1;
    if (out.material) out.material[i] = hit ? scene.shapes[shape].bsdf : -1;
}

template <class S>
RenderStats pixel_weights(const RenderCall<S> &call, const AovOutput<S> &out, const PixelWeights &weights);
template <class S>
RenderStats render_aov(const RenderCall<S> &call, const AovOutput<S> &out);
// out.data: derivatives of the loss with respect to the outputs, read only.
template <class S>
RenderStats reverse_aov(const RenderCall<S> &call, const AovOutput<S> &out, DerivativeCall<S> &derivative);
// out.data: derivatives of the outputs along the tangent.
template <class S>
RenderStats forward_aov(const RenderCall<S> &call, const AovOutput<S> &out, const DerivativeCall<S> &derivative);

}  // namespace tr
