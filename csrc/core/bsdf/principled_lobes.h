// The parts that `principled` and its variant for thin sheets are made of: Burley, "Physically Based Shading at
// Disney", SIGGRAPH 2012 course, and "Extending the Disney BRDF to a BSDF with Integrated Subsurface Scattering",
// SIGGRAPH 2015 course.
#pragma once

#include "dielectric_microfacet.h"

namespace tr {

// (1 - cos)^5, the interpolation of Schlick, "An Inexpensive BRDF Model for Physically-based Rendering", 1994
template <class T>
TR_INLINE T schlick_weight(const T &cosine) {
    T m = max(T(1) - cosine, T(0)), m2 = m * m;
    return m2 * m2 * m;
}
template <class T>
TR_INLINE T mix(const T &a, const T &b, const T &t) {
    return a + (b - a) * t;
}

// Schlick's R0, reflectance at normal incidence.
template <class T>
TR_INLINE T schlick_r0(const T &eta) {
    T r = (eta - T(1)) / (eta + T(1));
    return r * r;
}

// The hue of a colour, the colour over its luminance (Burley 2012, section 5.3): white where it has none.
template <class T>
struct Hue {
    MaskOf<T> dark;
    T inverse;
    TR_INLINE explicit Hue(const T &luminance)
        : dark(!mask<T>(luminance > T(0))), inverse(T(1) / select(dark, T(1), luminance)) {}
    TR_INLINE T operator()(const T &color) const { return select(dark, T(1), color * inverse); }
};

// Diffuse reflection with its retro-reflection (Burley 2012, section 5.3), and its flat variant (2015, section 4.3), of
// cosines and Schlick's weights of both directions; `retro90` is 2 roughness cos_d^2.
template <class T, class M>
TR_INLINE T principled_diffuse(const T &ni, const T &no, const T &fi, const T &fo, const T &retro90, const T &flatness,
                               const M &possible) {
    T diffuse = (T(1) - T(0.5) * fi) * (T(1) - T(0.5) * fo) + retro90 * (fo + fi + fo * fi * (retro90 - T(1)));
    T flat90 = retro90 * T(0.5), sum = select(possible, ni + no, T(1));
    T flat = mix(T(1), flat90, fi) * mix(T(1), flat90, fo);
    return mix(diffuse, T(1.25) * (flat * (T(1) / sum - T(0.5)) + T(0.5)), flatness);
}

// GGX microfacets that are rougher along the tangent than across it: alpha / aspect and alpha aspect (Burley 2012,
// section 5.4). By their squares, so that neither roots nor more than one division have derivatives.
template <class T>
struct PrincipledAlpha {
    T square, narrow, wide;  // alpha^2, aspect^2 and its inverse

    TR_INLINE PrincipledAlpha(const T &roughness, const T &anisotropic) {
        using F = std::decay_t<decltype(value_of(roughness))>;
        narrow = at_least(T(1) - T(0.9) * anisotropic, F(0.1));
        wide = T(1) / narrow;
        T alpha = at_least(roughness * roughness, F(MinAlpha) * sqrt(value_of(wide)));
        square = alpha * alpha;
    }
};
template <class T>
TR_INLINE T ggx_distribution_of(const PrincipledAlpha<T> &alpha, const Vec3<T> &h, const T &inverse2) {
    T d = (alpha.narrow * (h.x * h.x) + alpha.wide * (h.y * h.y) + alpha.square * (h.z * h.z)) * inverse2;
    return alpha.square / (d * d * T(Pi));
}
template <class T>
TR_INLINE T projected_roughness2(const PrincipledAlpha<T> &alpha, const Vec3<T> &v) {
    return alpha.square * (alpha.wide * (v.x * v.x) + alpha.narrow * (v.y * v.y));
}
template <class F>
TR_INLINE Vec3<F> stretch(const PrincipledAlpha<F> &alpha, const Vec3<F> &v) {
    return {sqrt(alpha.square * alpha.wide) * v.x, sqrt(alpha.square * alpha.narrow) * v.y, v.z};
}
template <class T, class M>
TR_INLINE T distribution_of(const M &, const PrincipledAlpha<T> &alpha, const Vec3<T> &h, const T &inverse2) {
    return ggx_distribution_of(alpha, h, inverse2);
}
template <class T, class M>
TR_INLINE T smith_g1_over_cos(const M &, const PrincipledAlpha<T> &alpha, const Vec3<T> &v) {
    return ggx_smith_g1_over_cos(alpha, v);
}
template <class F, class M>
TR_INLINE Vec3<F> sample_visible_normal(const M &, const PrincipledAlpha<F> &alpha, const Vec3<F> &wi, const F &u1,
                                        const F &u2) {
    return sample_visible_ggx_normal(alpha, wi, u1, u2);
}

// The tail of the clear coat, "generalized Trowbridge-Reitz" with exponent 1: Burley 2012, appendix B.2.
struct CoatFacets {
    static constexpr double MaskingAlpha = 0.25;  // Burley's choice, whatever the gloss
    template <class T>
    TR_INLINE static T alpha(const T &gloss) {
        return mix(T(0.1), T(0.001), gloss);
    }
    template <class T>
    TR_INLINE static T density(const T &gloss, const T &cos2, const T &sin2) {
        T a = alpha(gloss), a2 = a * a;
        return (a2 - T(1)) / (log(a2) * (a2 * cos2 + sin2) * T(Pi));
    }
    // A normal of the density times its cosine.
    template <class F>
    TR_INLINE static Vec3<F> sample(const F &gloss, const F &u1, const F &u2) {
        F a = alpha(gloss), a2 = a * a, s, c;
        F sin2 = a2 * (exp((u2 - F(1)) * log(a2)) - F(1)) / (F(1) - a2);  // (a2^u - a2) / (1 - a2)
        sin2 = min(max(sin2, F(0)), F(1));
        F sine = sqrt(sin2);
        sincos(u1 * F(2 * Pi), s, c);
        return {sine * c, sine * s, sqrt(F(1) - sin2)};
    }
};

}  // namespace tr
