// The derivative of outputs besides radiance as a kernel, an item of which is a sample.
#pragma once

#include "derivative_kernels.h"
#include "output_kernels.h"
#if defined(__CUDACC_RTC__)
#include "core/adjoint/outputs.cpp"
#endif

namespace tr {

// In reverse mode `value` holds the adjoints of the channels, in forward mode their derivatives are written there.
template <class S>
struct SweepOutputs {
    static constexpr const char *Name = TR_KERNEL_NAME(SweepOutputs), *Header = "device/output_sweep_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Derivative;
    bool adds() const { return !to.fixed && !to.forward; }
    FirstHitStage<S> first;
    OutputValues<S> value;
    DerivativePlaces<S> to;

    TR_HD void operator()(uint32_t i) const {
        const int n = first.layout.n;
        const bool is_hit = first.is_hit(i), forward = to.forward;
        S v[MaxAovChannels] = {};
        if (is_hit) {
            for (int c = 0; c < n && !forward; ++c) v[c] = value(c, i);
            GradientSink<S> sink = to.sink(i);
            first.with_hit(i, [&](const AovContext<S> &c, const FirstHit<S> &hit) {
                sweep_aovs<S>(c, hit, first.stage.needs, true, v, sink);
            });
            if (sink.non_finite != 0 && !to.measures) accumulate(to.non_finite, uint64_t(sink.non_finite));
        }
        for (int c = 0; c < n && forward; ++c) value(c, i) = v[c];
        first.stage.slots.alpha[i] = is_hit ? 1.f : 0.f;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        first.for_pointers(visit), visit(value.at), to.for_pointers(visit);
    }
};

}  // namespace tr
