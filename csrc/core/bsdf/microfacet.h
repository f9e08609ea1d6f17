// Microfacet distributions: densities of normals, masking and the sampling of visible normals, for all rough models.
// Walter, Marschner, Li and Torrance, "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007.
//
// A microsurface has the roughness alpha; a Beckmann surface has Gaussian slopes of variance alpha^2 / 2. Directions
// are local, +z is the macroscopic normal. The mask `ggx` chooses lane by lane.
//
// Where alpha is a Vec2, roughness differs along x and y: slopes are those of the surface of alpha 1, each times its
// own alpha (Heitz, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", JCGT 3(2), 2014,
// section 5.3).
#pragma once

#include "../math/erf.h"

namespace tr {

enum class Microfacets : int32_t { Beckmann, Ggx };

// Lobes of smaller alpha are so narrow that directions in single precision no longer resolve them.
constexpr double MinAlpha = 1e-3;

// The lanes whose surfaces have GGX microfacets, by the switch of a model.
template <class F>
TR_INLINE MaskOf<F> is_ggx(const IntOf<F> &distribution) {
    return mask<F>(distribution == int32_t(Microfacets::Ggx));
}

// A number within [low, ...): below, `low` is taken, with the derivative there (an optimiser finds back).
template <class T, class F>
TR_INLINE T at_least(const T &x, const F &low) {
    return with_value(x, max(value_of(x), low));
}

// Density of normals per solid angle and per area of the macroscopic surface, D(h), by the squared cosine and sine of
// h: equations 25 and 33.
template <class T>
TR_INLINE T ggx_density(const T &alpha, const T &cos2, const T &sin2) {
    T a2 = alpha * alpha, d = a2 * cos2 + sin2;  // without the cancellation of 1 + (alpha^2 - 1) cos^2
    return a2 / (d * d * T(Pi));
}
template <class T, class M>
TR_INLINE T microfacet_distribution(const M &ggx, const T &alpha, const T &cos2, const T &sin2) {
    T r(0);
    if (any(ggx)) r = ggx_density(alpha, cos2, sin2);
    if (!all(ggx)) {
        T a2 = alpha * alpha;
        T c = max(cos2, T(1e-8));  // exp() is 0 there
        r = select(ggx, r, exp(-(sin2 / (a2 * c))) / (a2 * c * c * T(Pi)));
    }
    return r;
}

// D of the normal along h, by |h|^-2.
template <class T, class M>
TR_INLINE T distribution_of(const M &ggx, const T &alpha, const Vec3<T> &h, const T &inverse2) {
    return microfacet_distribution(ggx, alpha, h.z * h.z * inverse2, (h.x * h.x + h.y * h.y) * inverse2);
}
template <class T, class M>
TR_INLINE T distribution_of(const M &ggx, const Vec2<T> &alpha, const Vec3<T> &h, const T &inverse2) {
    T x = h.x / alpha.x, y = h.y / alpha.y;
    T cos2 = h.z * h.z * inverse2, stretched2 = (x * x + y * y) * inverse2, area = alpha.x * alpha.y * T(Pi), r(0);
    if (any(ggx)) {
        T d = cos2 + stretched2;
        r = T(1) / (area * d * d);
    }
    if (!all(ggx)) {
        T c = max(cos2, T(1e-8));
        r = select(ggx, r, exp(-(stretched2 / c)) / (area * c * c));
    }
    return r;
}

// The part of v along the surface, times the roughness in its direction, squared; and its root, which has a derivative
// everywhere.
template <class T>
TR_INLINE T projected_roughness2(const T &alpha, const Vec3<T> &v) {
    return alpha * alpha * (v.x * v.x + v.y * v.y);
}
template <class T>
TR_INLINE T projected_roughness2(const Vec2<T> &alpha, const Vec3<T> &v) {
    T x = alpha.x * v.x, y = alpha.y * v.y;
    return x * x + y * y;
}
template <class T>
TR_INLINE T projected_roughness(const T &alpha, const Vec3<T> &v) {
    return alpha * sqrt(max(v.x * v.x + v.y * v.y, T(1e-14)));
}
template <class T>
TR_INLINE T projected_roughness(const Vec2<T> &alpha, const Vec3<T> &v) {
    return sqrt(max(projected_roughness2(alpha, v), T(1e-20)));
}

// Smith's masking over the cosine, G1(v) / |v.z|, which grazing directions do not make infinite: equations 34 and
// (exactly, not by its rational fit) 26.
template <class A, class T>
TR_INLINE T ggx_smith_g1_over_cos(const A &alpha, const Vec3<T> &v) {
    return T(2) / (abs(v.z) + sqrt(v.z * v.z + projected_roughness2(alpha, v)));
}
template <class A, class T, class M>
TR_INLINE T smith_g1_over_cos(const M &ggx, const A &alpha, const Vec3<T> &v) {
    T r(0);
    if (any(ggx)) r = ggx_smith_g1_over_cos(alpha, v);
    if (!all(ggx)) {
        T z = abs(v.z), s = projected_roughness(alpha, v);
        r = select(ggx, r, T(2) / (T(2) * z + s * (erfc_integral(z / s) * T(1 / SqrtPi))));
    }
    return r;
}

// Visible slopes of a Beckmann surface of alpha 1 seen under the angle theta from direction (1, 0): the distribution of
// the slope along x is proportional to (cos - x sin) exp(-x^2), that of the other is Gaussian (Heitz and d'Eon,
// "Importance Sampling Microfacet-Based BSDFs using the Distribution of Visible Normals", EGSR 2014). The first is
// found by Newton's method in the variable v = (1 + erf(x)) / 2, from the starting point of Jakob, "An Improved Visible
// Normal Sampling Routine for the Beckmann Distribution", 2014; the function is concave, which is why the iteration is
// safe.
template <class F>
TR_INLINE Vec2<F> visible_beckmann_slopes(const F &sin, const F &cos, const F &u1, const F &u2) {
    constexpr bool single = sizeof(ScalarOf<F>) == 4;
    constexpr double least = single ? 1e-8 : 1e-9, most = single ? 1 - 6e-8 : 1 - 1e-9;
    auto inverse = [&](const F &v) { return erf_inverse_of_share(min(max(v, F(least)), F(most))); };
    F cot = min(cos / max(sin, F(1e-10)), F(10)), gauss = exp(-cot * cot);
    F largest = F(1) - F(0.5) * gauss * erfc_scaled(cot);
    F target = u1 * (F(2 * SqrtPi) * cos * largest + sin * gauss);
    F theta = atan2(sin, cos);
    F power = fmadd(theta, fmadd(theta, fmadd(theta, F(-0.0594), F(0.4265)), F(-0.876)), F(1));
    F v = largest * (F(1) - exp(power * log(max(F(1) - u1, F(1e-10)))));
    F x = inverse(v);
    for (int i = 0; i < (single ? 3 : 6); ++i) {
        F excess = F(2 * SqrtPi) * cos * v + sin * exp(-x * x) - target;
        F slope = F(2 * SqrtPi) * max(cos - sin * x, F(1e-7));
        v = min(max(v - excess / slope, v * F(0.125)), largest);
        x = inverse(v);
    }
    return {x, inverse(u2)};
}

// A vector of the surface of alpha 1 as one of the surface of this roughness.
template <class F>
TR_INLINE Vec3<F> stretch(const F &alpha, const Vec3<F> &v) {
    return {alpha * v.x, alpha * v.y, v.z};
}
template <class F>
TR_INLINE Vec3<F> stretch(const Vec2<F> &alpha, const Vec3<F> &v) {
    return {alpha.x * v.x, alpha.y * v.y, v.z};
}

// A normal visible from wi (wi.z >= 0), of density D(m) G1(wi) max(wi.m, 0) / wi.z. For GGX by the spherical caps of
// Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", HPG 2023, of the same distribution as Heitz,
// "Sampling the GGX Distribution of Visible Normals", JCGT 7(4), 2018.
template <class A, class F>
TR_INLINE Vec3<F> sample_visible_ggx_normal(const A &alpha, const Vec3<F> &wi, const F &u1, const F &u2) {
    Vec3<F> stretched = normalize(stretch(alpha, wi));
    F above = F(1) - u2, z = fmadd(above, F(1) + stretched.z, -stretched.z), s, c;
    F r = sqrt(max(u2 * (F(1) + stretched.z) * (F(1) + z), F(0)));  // sqrt(1 - z^2)
    sincos(u1 * F(2 * Pi), s, c);
    Vec3<F> h{fmadd(r, c, stretched.x), fmadd(r, s, stretched.y), max(above * (F(1) + stretched.z), F(1e-20))};
    return normalize(stretch(alpha, h));
}
template <class A, class F, class M>
TR_INLINE Vec3<F> sample_visible_normal(const M &ggx, const A &alpha, const Vec3<F> &wi, const F &u1, const F &u2) {
    Vec3<F> m{F(0), F(0), F(1)};
    if (any(ggx)) m = sample_visible_ggx_normal(alpha, wi, u1, u2);
    if (!all(ggx)) {
        Vec3<F> stretched = normalize(stretch(alpha, wi));
        F s = sqrt(stretched.x * stretched.x + stretched.y * stretched.y);
        auto tilted = mask<F>(s > F(1e-15));
        F inverse = select(tilted, F(1) / select(tilted, s, F(1)), F(0));
        F c = select(tilted, stretched.x * inverse, F(1)), d = stretched.y * inverse;
        Vec2<F> slope = visible_beckmann_slopes(s, stretched.z, u1, u2);
        F x = c * slope.x - d * slope.y, y = d * slope.x + c * slope.y;
        m = select(ggx, m, normalize(stretch(alpha, Vec3<F>{-x, -y, F(1)})));
    }
    return m;
}

// The roughness that a model renders with.
template <class T>
TR_INLINE T clamp_alpha(const T &alpha) {
    using F = std::decay_t<decltype(value_of(alpha))>;
    return at_least(alpha, F(MinAlpha));
}
template <class T>
TR_INLINE Vec2<T> clamp_alpha(const Vec2<T> &alpha) {
    return {clamp_alpha(alpha.x), clamp_alpha(alpha.y)};
}

// Reflection off microfacets into the hemisphere of the normal, for models that reflect only: a surface of density D(h)
// G1(wi) G1(wo) / (4 |cos_i| |cos_o|) times what a microfacet reflects (equation 20).
template <class T>
struct FacetReflection {
    T density;  // D(h) G1(wi) / |cos_i|; a quarter of it is the density of sampled directions
    T cosine;   // of either direction on the microfacet
    MaskOf<T> possible;

    template <class M, class A>
    TR_INLINE FacetReflection(const M &ggx, const A &alpha, const Vec3<T> &wi, const Vec3<T> &wo) {
        using F = std::decay_t<decltype(value_of(wi.z))>;
        possible = mask<F>(value_of(wi.z) > F(0)) && mask<F>(value_of(wo.z) > F(0));
        Vec3<T> h = wi + wo;
        T length2 = squared_norm(h);
        possible = possible && mask<F>(value_of(length2) > F(1e-20));
        length2 = select(possible, length2, T(1));
        T inverse2 = T(1) / length2;
        cosine = sqrt(length2) * T(0.5);  // wi.h = wo.h = |h|^2 / 2
        density = distribution_of(ggx, alpha, h, inverse2) * smith_g1_over_cos(ggx, alpha, wi);
    }
    // G1(wo), the cosine of wo being positive where reflection is possible
    template <class M, class A>
    TR_INLINE T shadowing(const M &ggx, const A &alpha, const Vec3<T> &wo) const {
        return abs(wo.z) * smith_g1_over_cos(ggx, alpha, wo);
    }
};

// The direction into which a microfacet seen from wi reflects; below the horizon it is no sample.
template <class A, class F, class M>
TR_INLINE Vec3<F> sample_facet_reflection(const M &ggx, const A &alpha, const Vec3<F> &wi, const F &u1, const F &u2) {
    Vec3<F> seen{wi.x, wi.y, abs(wi.z)};
    Vec3<F> m = sample_visible_normal(ggx, alpha, seen, u1, u2);
    return normalize(m * (F(2) * dot(seen, m)) - seen);
}

}  // namespace tr
