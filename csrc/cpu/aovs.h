// Outputs besides radiance, for the wanted pixels of a film.
#pragma once

#include "core/integrator/aovs.h"
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
