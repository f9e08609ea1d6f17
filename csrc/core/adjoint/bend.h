// Derivatives of rays that bend: those of exactly the steps that were taken, not of the differential equation, whose
// solution these are not. Rounding counts as the identity.
//
// Backwards, with lambda and mu the adjoints of position and velocity, p = G mu, H the second derivatives of Phi and
// B_i the splines, a kick of weight w and a drift are
//
//     kick:   values_bar_i += w p . grad B_i,  lambda += w H p,  G_bar += w mu (grad Phi)^T,  u -= w F
//     drift:  mu += lambda,  q -= u
//
// A function of the position that was added up, c Phi, has values_bar_i += c B_i and lambda += c grad Phi.
#pragma once

#include <utility>

#include "../medium/bend_medium.h"
#include "../state/queues.h"
#include "bend_light.h"
#include "surface.h"

namespace tr {

namespace detail {

// f(0), f(1), ..., f(N - 1), with constants for arguments.
template <class F, int... I>
TR_INLINE void unroll(F &&f, std::integer_sequence<int, I...>) {
    (f(std::integral_constant<int, I>()), ...);
}
template <int N, class F>
TR_INLINE void unrolled(F &&f) {
    unroll(f, std::make_integer_sequence<int, N>());
}

}  // namespace detail

// values_bar_i += slope . grad B_i + value B_i. Lanes may add to the same numbers: what those in the same cell add is
// summed up first, if there are few cells.
template <int T, class F, class S>
TR_INLINE void splat_spline(const BendField<S> &field, const BendPoint<T, F> &point, const F &value,
                            const Vec3<F> &slope, S *values_bar, const MaskOf<F> &active) {
    constexpr int W = Lanes<F>::Width;
    const SplineAxes<T, F> &at = point.axes;
    // a row along x has w[k] a + d[k] b
    alignas(64) S a[T * T][W], b[T * T][W];
    const LaneRows<F> w(at[0].w), d(at[0].d);
    for (int z = 0; z < T; ++z)
        for (int y = 0; y < T; ++y) {
            const F wz = at[1].w[y] * at[2].w[z];
            store(b[z * T + y], slope.x * wz);
            store(a[z * T + y],
                  fmadd(slope.y, at[1].d[y] * at[2].w[z], fmadd(slope.z, at[1].w[y] * at[2].d[z], value * wz)));
        }
    const size_t row = size_t(field.row()), slice = size_t(field.slice());
    // what these lanes add to a cell that they share
    auto add = [&](uint32_t cell, const uint32_t *lanes, int n) {
        RowSum<S> sums[T * T];
        for (int l = 0; l < n; ++l) {
            const uint32_t i = lanes[l];
            const S *to_w = w[i], *to_d = d[i];
            detail::unrolled<T * T>([&](auto zy) { sums[zy].add(to_d, b[zy][i]), sums[zy].add(to_w, a[zy][i]); });
        }
        for (int z = 0; z < T; ++z)
            for (int y = 0; y < T; ++y) {
                alignas(32) S sum[4];
                sums[z * T + y].put(sum);
                S *to = values_bar + cell + size_t(z) * slice + size_t(y) * row;
                for (int k = 0; k < T; ++k) to[k] += sum[k];
            }
    };
    alignas(64) uint32_t lanes[W];
    if (point.cells.all) {
        for (int c = 0; c < point.cells.n; ++c) {
            const MaskOf<F> here = active && mask<F>(point.cells.which == UIntOf<F>(uint32_t(c)));
            store_compressed<F>(lanes, lane_index<F>(), here);
            if (const int n = count(here)) add(point.cells.value[c], lanes, n);
        }
        return;
    }
    alignas(64) uint32_t from[W];
    store(from, point.cell.first);
    store_compressed<F>(lanes, lane_index<F>(), active);
    for (int l = 0, n = count(active); l < n; ++l) add(from[lanes[l]], lanes + l, 1);
}

// The adjoint of a ray on its way back.
template <class F>
struct BendAdjoint {
    Vec3<F> q, u;                                      // lambda, mu
    F optical, length;                                 // of the sums of Phi and of n over all kicks
    F kick[6] = {F(0), F(0), F(0), F(0), F(0), F(0)};  // G_bar

    // Of a kick G slope of weight w, whose adjoint is m.
    TR_INLINE void add_kick(const F &w, const Vec3<F> &m, const Vec3<F> &slope) {
        const Vec3<F> &g = slope;
        const F change[6] = {
            m.x * g.x, m.y * g.y, m.z * g.z, m.x * g.y + m.y * g.x, m.x * g.z + m.z * g.x, m.y * g.z + m.z * g.y};
        for (int k = 0; k < 6; ++k) kick[k] = fmadd(w, change[k], kick[k]);
    }
};

// One kick of weight w backwards; the values' part goes to add(point, value, slope, lanes). `constant`: that of Phi;
// `light`: null, or what the medium does to it.
template <int T, class F, class S, class Add>
TR_INLINE void kick_back(const BendField<S> &field, S constant, BendState<F> &s, int bits, const F &w,
                         BendAdjoint<F> &adjoint, const MaskOf<F> &active, Add &&add, LightBack<F> *light) {
    const BendPoint<T, F> at(field, s, bits, active);
    const F weight = select(active, w, F(0)), n = refractive_index(at.jet.value, constant);
    const Vec3<F> p = symmetric_times<F>(field.kick, adjoint.u) * weight, &slope = at.jet.slope;
    F value = weight * (adjoint.optical + select(mask<F>(n > F(0)), adjoint.length / n, F(0)));
    if (light) {
        const LightKick<F> own = light->kick(position_of(s, bits), n, weight, active);
        value = value + own.value, adjoint.q = adjoint.q + own.q;
    }
    add(at, value, p, active);
    adjoint.q = adjoint.q + symmetric_times<F>(at.jet.curve, p) + slope * value;
    adjoint.add_kick(weight, adjoint.u, slope);
    kick<F, true>(s, symmetric_times<F>(field.kick, slope) * w, active);
}

// The way back from the last kick over as many steps, which are half a kick, a drift, a kick, ..., a kick.
template <int T, class F, class S, class Add>
TR_INLINE void fly_back(const BendField<S> &field, S constant, BendState<F> &s, int bits, const IntOf<F> &steps,
                        BendAdjoint<F> &adjoint, MaskOf<F> active, Add &&add, LightBack<F> *light = nullptr) {
    IntOf<F> left = steps;
    while (any(active)) {
        const MaskOf<F> goes_on = active && mask<F>(left > IntOf<F>(0));
        kick_back<T, F>(field, constant, s, bits, select(goes_on, F(1), F(S(0.5))), adjoint, active, add, light);
        active = goes_on;
        left = left - 1;
        adjoint.u = select(active, adjoint.u + adjoint.q, adjoint.u);
        drift_back(s, bits, active);
    }
}

// The tangent of a ray on its way.
template <class F>
struct BendTangent {
    Vec3<F> q, u;
    F optical, length;
};

// One kick of weight w with its derivative: forwards. `tangent`: that of the field's values and of G, zero if null;
// `light`: null, or what the medium does to it.
template <int T, class F, class S>
TR_INLINE void kick_tangent(const BendField<S> &field, const BendField<S> &tangent, S constant, BendState<F> &s,
                            int bits, const F &w, BendTangent<F> &d, const MaskOf<F> &active, LightForward<F> *light) {
    const BendPoint<T, F> at(field, s, bits, active);
    const BendJet<F> &jet = at.jet;
    Vec3<F> slope = symmetric_times<F>(jet.curve, d.q);
    F value = dot(jet.slope, d.q);
    if (tangent.values) {
        const BendJet<F> change = at.jet_of(tangent, active);
        slope = slope + change.slope, value = value + change.value;
    }
    const F weight = select(active, w, F(0)), n = refractive_index(jet.value, constant);
    const F d_n = select(mask<F>(n > F(0)), value / n, F(0));
    if (light) light->kick(position_of(s, bits), d.q, n, d_n, weight, active);
    d.u = d.u + (symmetric_times<F>(field.kick, slope) + symmetric_times<F>(tangent.kick, jet.slope)) * weight;
    d.optical = fmadd(weight, value, d.optical);
    d.length = fmadd(weight, d_n, d.length);
    kick<F, false>(s, symmetric_times<F>(field.kick, jet.slope) * w, active);
}

// ------------------------------------------------------------------------------------------------------------ paths
// What becomes of light along the way: adjoints of the way's length, where that is all that matters, and of the light
// where the ray began; and what arrives at its end.
template <class F>
struct BentLight {
    F length_bar{0};
    Spectrum<F> begin_bar = uniform_spectrum(F(0)), arrived = uniform_spectrum(F(0));
};

// A ray that came through a medium to the surface point p, along d at its end, `bent` being what is kept of it: from
// adjoints of the point, of d and of light that of the ray where it entered the medium; that of the medium goes to the
// sink.
template <class F>
TR_LARGE RayAdjoint<F> sweep_flight(const SceneOf<F> &scene, const BendMedium<ScalarOf<F>> &medium,
                                    const BentPacket<F> &bent, const SurfacePoint<F> &at, const Vec3<F> &p,
                                    const Vec3<F> &d, const Vec3<F> &d_bar, const BentLight<F> &light,
                                    HitAdjoint<F> hit, const MaskOf<F> &active, GradientSink<F> &sink);

// Of the index at surface points p: adds its adjoint to the sink, and to that of p.
template <class F>
TR_LARGE void sweep_index(const BendMedium<ScalarOf<F>> &medium, const Vec3<F> &p, const F &n_bar,
                          const MaskOf<F> &active, HitAdjoint<F> &hit, GradientSink<F> &sink);

// Of what refracts at boundaries, see boundary_eta.
template <class F>
TR_LARGE void sweep_boundary(const SceneOf<F> &scene, const SurfacePoint<F> &at, const Vec3<F> &p, const F &eta_bar,
                             const MaskOf<F> &active, HitAdjoint<F> &hit, GradientSink<F> &sink);

}  // namespace tr
