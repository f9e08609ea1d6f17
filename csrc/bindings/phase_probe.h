// Phase functions by themselves, in numbers or in packets: values, samples and both modes of the derivative, by the
// functions that the integrators call.
#pragma once

#include "core/adjoint/sink.h"
#include "core/phase/phase.h"

namespace tr {

// Rows of numbers, lane by lane; lanes behind the end repeat the last row.
template <class F, int N>
class ProbeLanes {
    using S = ScalarOf<F>;
    static constexpr size_t W = size_t(Lanes<F>::Width);

public:
    static std::array<F, N> read(const S *from, size_t begin, size_t n) {
        std::array<F, N> r;
        for (size_t k = 0; k < N; ++k) {
            alignas(64) S column[W];
            for (size_t i = 0; i < W; ++i) column[i] = from[N * std::min(begin + i, n - 1) + k];
            r[k] = load<F>(column);
        }
        return r;
    }
    static void write(S *to, size_t begin, size_t n, const std::array<F, N> &x) {
        for (size_t k = 0; k < N; ++k) {
            alignas(64) S column[W];
            store(column, x[k]);
            for (size_t i = begin; i < std::min(begin + W, n); ++i) to[N * i + k] = column[i - begin];
        }
    }
};

// Calls body(p, d, begin, active) for every packet of the n rows of p and d (n, 3).
template <class F, class S, class Body>
void for_each_packet(size_t n, const S *p, const S *d, Body &&body) {
    constexpr uint32_t width = uint32_t(Lanes<F>::Width);
    for (size_t begin = 0; begin < n; begin += width) {
        auto at = ProbeLanes<F, 3>::read(p, begin, n), along = ProbeLanes<F, 3>::read(d, begin, n);
        uint32_t left = uint32_t(std::min(n - begin, size_t(width)));
        body(Vec3<F>{at[0], at[1], at[2]}, Vec3<F>{along[0], along[1], along[2]}, begin,
             mask<F>(lane_index<F>() < UIntOf<F>(left)));
    }
}

// value (n,)
template <class F, class S>
void probe_phase(const SceneView<S> &scene, int phase, size_t n, const S *p, const S *d, const S *wo, S *value) {
    for_each_packet<F>(n, p, d, [&](const Vec3<F> &at, const Vec3<F> &along, size_t begin, const MaskOf<F> &active) {
        auto to = ProbeLanes<F, 3>::read(wo, begin, n);
        F f = eval_phase(scene, phase, at, along, Vec3<F>{to[0], to[1], to[2]}, active);
        ProbeLanes<F, 1>::write(value, begin, n, {f});
    });
}

// wo (n, 3) from uniform numbers u (n, 3)
template <class F, class S>
void probe_phase_sample(const SceneView<S> &scene, int phase, size_t n, const S *p, const S *d, const S *u, S *wo) {
    for_each_packet<F>(n, p, d, [&](const Vec3<F> &at, const Vec3<F> &along, size_t begin, const MaskOf<F> &active) {
        auto v = ProbeLanes<F, 3>::read(u, begin, n);
        Vec3<F> to = sample_phase(scene, phase, at, along, v[0], v[1], v[2], active);
        ProbeLanes<F, 3>::write(wo, begin, n, {to.x, to.y, to.z});
    });
}

// Hands every row to the sink with the adjoint g (n, C); `after` is called with the first row of a packet.
template <class F, int C, class S, class Sink, class After>
void probe_phase_sweep(const SceneView<S> &scene, int phase, size_t n, const S *p, const S *d, const S *wo, const S *g,
                       Sink &sink, After &&after) {
    for_each_packet<F>(n, p, d, [&](const Vec3<F> &at, const Vec3<F> &along, size_t begin, const MaskOf<F> &active) {
        auto to = ProbeLanes<F, 3>::read(wo, begin, n);
        auto adjoint = ProbeLanes<F, C>::read(g, begin, n);
        Color<F, C> color;
        for (int c = 0; c < C; ++c) color[c] = adjoint[size_t(c)];
        sink.begin();
        sweep_phase(scene, phase, at, along, Vec3<F>{to[0], to[1], to[2]}, color, active, sink);
        after(begin);
    });
}

// Adds to `constants` (the block of small parameters) and to `tensors` (by slot, null where none is wanted).
template <class F, int C, class S>
void probe_phase_reverse(const SceneView<S> &scene, int phase, size_t n, const S *p, const S *d, const S *wo,
                         const S *g, double *constants, S *const *tensors) {
    ReverseSink<F, C> sink{};
    sink.constants = constants, sink.tensors = tensors;
    probe_phase_sweep<F, C>(scene, phase, n, p, d, wo, g, sink, [](size_t) {});
}

// derivative (n, C) in the direction `tangent`, times g
template <class F, int C, class S>
void probe_phase_forward(const SceneView<S> &scene, int phase, size_t n, const S *p, const S *d, const S *wo,
                         const S *g, const Values<S> &tangent, S *derivative) {
    ForwardSink<F, C> sink{};
    sink.tangent = tangent;
    probe_phase_sweep<F, C>(scene, phase, n, p, d, wo, g, sink, [&](size_t begin) {
        std::array<F, C> lanes;
        for (int c = 0; c < C; ++c) lanes[size_t(c)] = sink.derivative[c];
        ProbeLanes<F, C>::write(derivative, begin, n, lanes);
    });
}

}  // namespace tr
