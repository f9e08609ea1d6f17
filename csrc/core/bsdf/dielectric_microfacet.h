// A microfacet of a rough interface between two transparent media, for all models that reflect and refract at such
// microfacets: from two directions to the microfacet that takes one into the other. Walter, Marschner, Li and Torrance,
// "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007.
#pragma once

#include "../math/fresnel.h"
#include "microfacet.h"

namespace tr {

// Without an interface nothing would be scattered: the lobe of refraction is a delta there. Indices next to 1 give
// lobes that are too narrow for directions in single precision.
template <class T>
TR_INLINE T clamp_eta(const T &eta) {
    using F = std::decay_t<decltype(value_of(eta))>;
    F v = max(value_of(eta), F(1e-3));
    auto below = mask<F>(v < F(1));
    return with_value(eta, select(below, min(v, F(1 - 1e-3)), max(v, F(1 + 1e-3))));
}

template <class T>
struct DielectricMicrofacet {
    T eta;     // the relative index along wi
    T ci, ct;  // cosines of wi and of the refracted direction on the microfacet (of refraction times |h|); 1 without
               // microfacet
    T cos2, sin2;       // of the microfacet's normal
    Vec3<T> h;          // along it
    T inverse2;         // 1 / |h|^2
    T refraction;       // |wi.h| |wo.h| / (wi.h + eta wo.h)^2 of refraction
    MaskOf<T> outside;  // wi is above the surface
    MaskOf<T> reflects, possible;

    // Half vectors are not normalized; with h = wi + eta wo, the last denominator is |h|^2.
    TR_INLINE DielectricMicrofacet(const T &inside_over_outside, const Vec3<T> &wi, const Vec3<T> &wo) {
        using F = std::decay_t<decltype(value_of(inside_over_outside))>;
        F zi = value_of(wi.z), zo = value_of(wo.z);
        outside = mask<F>(!(zi < F(0)));
        reflects = mask<F>(mulsign(zo, zi) > F(0));
        eta = select(outside, inside_over_outside, T(1) / inside_over_outside);
        h = wi + wo * select(reflects, T(1), eta);
        T length2 = squared_norm(h);
        auto usable = mask<F>(value_of(length2) > F(1e-20));
        inverse2 = T(1) / select(usable, length2, T(1));
        T wi_h = dot(wi, h), wo_h = dot(wo, h);
        // both directions see the microfacet on the side on which they are
        F side = value_of(h.z);
        auto visible = mask<F>(mulsign(mulsign(value_of(wi_h), zi), side) > F(0)) &&
                       mask<F>(mulsign(mulsign(value_of(wo_h), zo), side) > F(0));
        possible = usable && visible && mask<F>(abs(zi) > F(0)) && mask<F>(abs(zo) > F(0));

        // Cosines on the microfacet. Refraction has both of them at hand, so that nothing is singular at the critical
        // angle.
        wi_h = abs(wi_h), wo_h = abs(wo_h);
        ci = wi_h, ct = wo_h;
        if (any(reflects)) {
            T c = sqrt(length2) * T(0.5);  // wi.h = wo.h = |h|^2 / 2
            T t = sqrt(max(T(1) - (T(1) - c * c) / (eta * eta), T(0)));
            ci = select(reflects, c, ci), ct = select(reflects, t, ct);
        }
        refraction = (wi_h * inverse2) * (wo_h * inverse2);
        ci = select(possible, ci, T(1)), ct = select(possible, ct, T(1));
        cos2 = h.z * h.z * inverse2, sin2 = (h.x * h.x + h.y * h.y) * inverse2;
    }
    TR_INLINE T fresnel() const { return fresnel_of_cosines(ci, ct, eta); }
};

}  // namespace tr
