// Spectra of the colours of a texture, and their derivatives.
#pragma once

#include "core/color/upsampling.h"

namespace tr {

template <class S>
struct UpsamplingCall {
    SigmoidTable<S> table;
    bool light;
    int threads;
    size_t n;
    const S *rgb;  // (n, 3)
};

// `out` (n, SigmoidChannels); of reverse mode the adjoint of that, `out` being (n, 3); of forward mode the tangent of
// the colours.
template <class S>
void upsample(const UpsamplingCall<S> &call, S *out);
template <class S>
void upsample_reverse(const UpsamplingCall<S> &call, const S *adjoint, S *out);
template <class S>
void upsample_forward(const UpsamplingCall<S> &call, const S *tangent, S *out);

}  // namespace tr
