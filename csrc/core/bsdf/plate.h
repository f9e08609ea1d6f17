// Thin plates that polarise and that rays go straight through. Of unpolarised light a share passes, the same of all
// polarisations; what they make of Stokes vectors is in math/polarization.h. Their axis is dp/du, turned by `theta`.
#pragma once

#include "kernels.h"

namespace tr {

// `Plate`, the model, says which share passes: passed(params), a colour.
template <class Plate>
struct PassingPlate {
    static constexpr uint32_t Flags = HasDeltaLobes | Transmits | FollowsTangent;
    static constexpr int Albedo = -1;

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &, const IntOf<F> &) {
        using T = std::decay_t<decltype(params.color[0][0] * wi.z)>;
        const auto passed = Plate::passed(params);
        Spectrum<T> r;
        for (int c = 0; c < SpectrumSize; ++c) r[c] = T(passed[c]);
        return r;
    }

    template <class P, class F>
    TR_INLINE static F pdf(const P &, const Vec3<F> &, const Vec3<F> &) {
        return F(0);
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &, const F &, const F &) {
        BsdfSample<F> r;
        r.wo = direction(params, wi, IntOf<F>(0));
        r.pdf = F(1);
        r.eta = F(1);
        r.lobe = IntOf<F>(0);
        r.delta = MaskOf<F>(true);
        return r;
    }

    template <class P, class T>
    TR_INLINE static Vec3<T> direction(const P &, const Vec3<T> &wi, const IntOf<T> &) {
        return -wi;
    }
};

}  // namespace tr
