// Isotropic microfacet distributions: densities of normals, masking and the sampling of visible normals, for all rough
// models. Walter, Marschner, Li and Torrance, "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007.
//
// A microsurface has the roughness alpha; a Beckmann surface has Gaussian slopes of variance alpha^2 / 2. Directions
// are local, +z is the macroscopic normal. The mask `ggx` chooses lane by lane.
#pragma once

#include "../math/erf.h"

namespace tr {

enum class Microfacets : int32_t { Beckmann, Ggx };

// Lobes of smaller alpha are so narrow that directions in single precision no longer resolve them.
constexpr double MinAlpha = 1e-3;

// A number within [low, ...): below, `low` is taken, with the derivative there (an optimiser finds back).
template <class T, class F>
TR_INLINE T at_least(const T &x, const F &low) {
    return with_value(x, max(value_of(x), low));
}

// Density of normals per solid angle and per area of the macroscopic surface, D(h), by the squared cosine and sine of
// h: equations 25 and 33.
template <class T, class M>
TR_INLINE T microfacet_density(const M &ggx, const T &alpha, const T &cos2, const T &sin2) {
    T a2 = alpha * alpha, r(0);
    if (any(ggx)) {
        T d = a2 * cos2 + sin2;  // without the cancellation of 1 + (alpha^2 - 1) cos^2
        r = a2 / (d * d * T(Pi));
    }
    if (!all(ggx)) {
        T c = max(cos2, T(1e-8));  // exp() is 0 there
        r = select(ggx, r, exp(-(sin2 / (a2 * c))) / (a2 * c * c * T(Pi)));
    }
    return r;
}

// Smith's masking over the cosine, G1(v) / |v.z|, which grazing directions do not make infinite: equations 34 and
// (exactly, not by its rational fit) 26.
template <class T, class M>
TR_INLINE T masking_over_cosine(const M &ggx, const T &alpha, const Vec3<T> &v) {
    T z = abs(v.z), s2 = v.x * v.x + v.y * v.y, r(0);
    if (any(ggx)) r = T(2) / (z + sqrt(z * z + alpha * alpha * s2));
    if (!all(ggx)) {
        T s = alpha * sqrt(max(s2, T(1e-14)));
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

// A normal visible from wi (wi.z >= 0), of density D(m) G1(wi) max(wi.m, 0) / wi.z. For GGX by the spherical caps of
// Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", HPG 2023, of the same distribution as Heitz,
// "Sampling the GGX Distribution of Visible Normals", JCGT 7(4), 2018.
template <class F, class M>
TR_INLINE Vec3<F> sample_visible_normal(const M &ggx, const F &alpha, const Vec3<F> &wi, const F &u1, const F &u2) {
    Vec3<F> stretched = normalize(Vec3<F>{alpha * wi.x, alpha * wi.y, wi.z}), m{F(0), F(0), F(1)};
    if (any(ggx)) {
        F above = F(1) - u2, z = fmadd(above, F(1) + stretched.z, -stretched.z), s, c;
        F r = sqrt(max(u2 * (F(1) + stretched.z) * (F(1) + z), F(0)));  // sqrt(1 - z^2)
        sincos(u1 * F(2 * Pi), s, c);
        Vec3<F> h{fmadd(r, c, stretched.x), fmadd(r, s, stretched.y), max(above * (F(1) + stretched.z), F(1e-20))};
        m = normalize(Vec3<F>{alpha * h.x, alpha * h.y, h.z});
    }
    if (!all(ggx)) {
        F s = sqrt(stretched.x * stretched.x + stretched.y * stretched.y);
        auto tilted = mask<F>(s > F(1e-15));
        F inverse = select(tilted, F(1) / select(tilted, s, F(1)), F(0));
        F c = select(tilted, stretched.x * inverse, F(1)), d = stretched.y * inverse;
        Vec2<F> slope = visible_beckmann_slopes(s, stretched.z, u1, u2);
        F x = c * slope.x - d * slope.y, y = d * slope.x + c * slope.y;
        m = select(ggx, m, normalize(Vec3<F>{-alpha * x, -alpha * y, F(1)}));
    }
    return m;
}

}  // namespace tr
