#include "tabulated.h"

#include "../math/warp.h"
#include "kernels.h"

namespace tr {

namespace {

template <class F>
TR_INLINE Footprint<F, 2> table_footprint(int32_t n, const F &cosine) {
    using I = IntOf<F>;
    F x = fmadd(cosine, F(0.5), F(0.5)) * F(ScalarOf<F>(n - 1));
    I i = max(I(0), min(I(n - 2), I(x)));
    F a = max(F(0), min(F(1), x - F(i)));
    Footprint<F, 2> r;
    r.texel[0] = UIntOf<F>(i), r.texel[1] = UIntOf<F>(i + 1);
    r.weight[0] = F(1) - a, r.weight[1] = a;
    return r;
}

}  // namespace

template <class F>
TR_LARGE F TabulatedPhase::eval(const SceneOf<F> &scene, const Record &record, const Vec3<F> &, const Vec3<F> &d,
                                const Vec3<F> &wo, const MaskOf<F> &) {
    auto at = table_footprint(size(scene, record), dot(d, wo));
    F p[2];
    gather_rows<F>(scene.phase_tables + first(record) + 1, at.texel[0], MaskOf<F>(true), p);
    return fmadd(at.weight[0], p[0], at.weight[1] * p[1]);
}

template <class F>
TR_LARGE Vec3<F> TabulatedPhase::sample(const SceneOf<F> &scene, const Record &record, const Vec3<F> &,
                                        const Vec3<F> &d, const F &, const F &u1, const F &u2,
                                        const MaskOf<F> &active) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    const int32_t n = size(scene, record);
    const S *density = scene.phase_tables + first(record) + 1, *below = density + n;
    U i = search_cdf<F>(below + 1, U(0u), U(uint32_t(n - 1)), u1, active);
    F p[2], share[2];
    gather_rows<F>(density, i, active, p);
    gather_rows<F>(below, i, active, share);
    // within the interval the density is linear: the stable root of a quadratic equation
    F width = share[1] - share[0];
    F u = max(F(0), min(F(1), (u1 - share[0]) / select(mask<F>(width > F(0)), width, F(1))));
    F root = sqrt(fmadd(u, p[1] * p[1], (F(1) - u) * p[0] * p[0])), total = p[0] + root;
    auto some = mask<F>(total > F(0));
    F a = min(F(1), select(some, u * (p[0] + p[1]) / select(some, total, F(1)), F(0)));
    F cosine = fmadd(F(i) + a, F(S(2) / S(n - 1)), F(-1));
    return direction_about(d, cosine, sqrt(max(F(1) - cosine * cosine, F(0))), u2);
}

template <class F>
TR_LARGE F TabulatedPhase::slope(const SceneOf<F> &scene, const Record &record, const Vec3<F> &, const Vec3<F> &d,
                                 const Vec3<F> &wo, const F &, const MaskOf<F> &, Vec3<F> &, GradientSink<F> &) {
    using S = ScalarOf<F>;
    const int32_t n = size(scene, record);
    F p[2];
    gather_rows<F>(scene.phase_tables + first(record) + 1, table_footprint(n, dot(d, wo)).texel[0], MaskOf<F>(true), p);
    return (p[1] - p[0]) * F(S(n - 1) / S(2));
}

// p = v(cos) / (2 pi I): the numerator depends on two values, the integral on all.
template <class F>
TR_LARGE void TabulatedPhase::vjp(const SceneOf<F> &scene, const Record &record, const Vec3<F> &p, const Vec3<F> &d,
                                  const Vec3<F> &wo, const Spectrum<F> &g, const MaskOf<F> &active,
                                  GradientSink<F> &sink) {
    using S = ScalarOf<F>;
    const int32_t n = size(scene, record), slot = record.field[Data];
    const S k = scene.phase_tables[first(record)];
    sink.footprint(scene, slot, table_footprint(n, dot(d, wo)), g * F(k), active);
    // dI / dv is the trapezoidal rule's weight
    sink.trapezoid(slot, n, S(-4 * Pi) * k / S(n - 1), g * eval<F>(scene, record, p, d, wo, active), active);
}

TR_PHASE(TabulatedPhase)

}  // namespace tr
