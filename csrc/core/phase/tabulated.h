// `tabphase`: given by numbers at equal distances of the cosine, from -1 (backward) to 1 (forward), linear in between.
//
// The host makes from the N values v a table of 1 + 2 N numbers: k = 1 / (2 pi I) with the integral I over the cosine;
// the densities p = k v; the share of the distribution below each cosine.
#pragma once

#include "../math/warp.h"
#include "../texture/bitmap.h"

namespace tr {

struct TabulatedPhase {
    enum { Data };
    static constexpr Field fields[] = {
        {"values", Kind::Tensor, None, 0, INFINITY, "interior",
         "at cosines at equal distances from -1 to 1, of any scale"},
    };
    static constexpr Model model = {"phase", "tabphase", "A table over the cosine, interpolated linearly.", fields, 1};

    // Where the host's table begins.
    TR_INLINE static int32_t first(const Record &record) { return record.field[Record::Extra]; }
    template <class S>
    TR_INLINE static int32_t size(const SceneView<S> &scene, const Record &record) {
        return scene.values.tensors[record.field[Data]].shape[0];
    }

    template <class F>
    TR_INLINE static Footprint<F, 2> footprint(int32_t n, const F &cosine) {
        using I = IntOf<F>;
        F x = fmadd(cosine, F(0.5), F(0.5)) * F(ScalarOf<F>(n - 1));
        I i = max(I(0), min(I(n - 2), I(x)));
        F a = max(F(0), min(F(1), x - F(i)));
        Footprint<F, 2> r;
        r.texel[0] = UIntOf<F>(i), r.texel[1] = UIntOf<F>(i + 1);
        r.weight[0] = F(1) - a, r.weight[1] = a;
        return r;
    }

    template <class F, class S>
    TR_INLINE static F eval(const SceneView<S> &scene, const Record &record, const Vec3<F> &d, const Vec3<F> &wo) {
        auto at = footprint(size(scene, record), dot(d, wo));
        F p[2];
        gather_rows<F>(scene.phase_tables + first(record) + 1, at.texel[0], MaskOf<F>(true), p);
        return fmadd(at.weight[0], p[0], at.weight[1] * p[1]);
    }

    template <class F, class S>
    TR_INLINE static Vec3<F> sample(const SceneView<S> &scene, const Record &record, const Vec3<F> &d, const F &u1,
                                    const F &u2, const MaskOf<F> &active) {
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

    // p = v(cos) / (2 pi I): the numerator depends on two values, the integral on all.
    template <class F, int C, class S, class Sink>
    TR_INLINE static void sweep(const SceneView<S> &scene, const Record &record, const Vec3<F> &d, const Vec3<F> &wo,
                                const Color<F, C> &g, const MaskOf<F> &active, Sink &sink) {
        const int32_t n = size(scene, record), slot = record.field[Data];
        const S k = scene.phase_tables[first(record)];
        sink.footprint(scene, slot, footprint(n, dot(d, wo)), g * F(k), active);
        // dI / dv is the trapezoidal rule's weight
        const S inner = S(-4 * Pi) * k / S(n - 1), outer = S(0.5) * inner;
        auto weight = [=](int32_t i) { return i == 0 || i == n - 1 ? outer : inner; };
        sink.weighted_sum(scene, slot, n, weight, g * eval(scene, record, d, wo), active);
    }
};

}  // namespace tr
