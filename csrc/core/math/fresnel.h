// Fresnel equations for unpolarised light.
#pragma once

#include "dual.h"

namespace tr {

template <class T>
struct Fresnel {
    T reflectance;
    T cos_t;   // cosine of the refracted direction, sign opposite to cos_i; 0 in total internal reflection
    T eta_it;  // relative index along the incident direction: eta where cos_i >= 0, 1 / eta below
    T eta_ti;  // its inverse
};

// Reflectance of a dielectric interface by the cosines on both sides, not both zero, and the index behind it over the
// one before it.
template <class T>
TR_INLINE T fresnel_of_cosines(const T &ci, const T &ct, const T &eta_it) {
    T a_s = (ci - eta_it * ct) / (ci + eta_it * ct);
    T a_p = (ct - eta_it * ci) / (ct + eta_it * ci);
    return T(0.5) * (a_s * a_s + a_p * a_p);
}

// Dielectric interface. eta = index below the surface / index above; cos_i may have either sign.
// Born and Wolf, "Principles of Optics", section 1.5.2.
template <class T>
TR_INLINE Fresnel<T> fresnel_dielectric(const T &cos_i, const T &eta) {
    auto outside = mask<T>(!(cos_i < T(0)));
    T inverse = T(1) / eta;
    Fresnel<T> r;
    r.eta_it = select(outside, eta, inverse);
    r.eta_ti = select(outside, inverse, eta);
    T cos_t_squared = T(1) - r.eta_ti * r.eta_ti * (T(1) - cos_i * cos_i);
    T ci = abs(cos_i), ct = sqrt(max(cos_t_squared, T(0)));
    T value = fresnel_of_cosines(ci, ct, r.eta_it);
    // ci = ct = 0 (eta = 1, grazing) is 0 / 0: nothing is reflected where there is no interface
    auto matched = mask<T>(value_of(eta) == value_of(T(1))), grazing = mask<T>(value_of(ci) == value_of(T(0)));
    value = select(matched, T(0), select(grazing, T(1), value));
    r.reflectance = value;
    r.cos_t = select(outside, -ct, ct);
    // a ray goes straight on to the last bit; its derivative is that of Snell's law
    r.cos_t = with_value(r.cos_t, select(matched, -value_of(cos_i), value_of(r.cos_t)));
    return r;
}

// Conductor with complex index eta - i k relative to the medium above; cos_i >= 0.
// Reformulated without complex numbers as in Lagarde, "Memo on Fresnel equations", 2013.
template <class T>
TR_INLINE T fresnel_conductor(const T &cos_i, const T &eta, const T &k) {
    T c2 = cos_i * cos_i, s2 = T(1) - c2;
    T a = eta * eta - k * k - s2;
    T a2b2 = sqrt(max(a * a + T(4) * eta * eta * k * k, T(0)));
    // The real root sqrt((a2b2 + a) / 2); where a < 0, as of metals, by its product eta k with the imaginary one: a sum
    // of nearly opposite numbers would lose the digits, and at eta = 0 the derivative.
    T larger = sqrt(max(T(0.5) * (a2b2 + abs(a)), T(0)));
    auto negative = mask<T>(a < T(0));
    T term1 = a2b2 + c2, term2 = T(2) * cos_i * select(negative, eta * k / select(negative, larger, T(1)), larger);
    T rs = (term1 - term2) / (term1 + term2);
    T term3 = a2b2 * c2 + s2 * s2, term4 = term2 * s2;
    T rp = rs * (term3 - term4) / (term3 + term4);
    return T(0.5) * (rs + rp);
}

// Reflectance of an interface for diffuse light, twice the integral of F(cos) cos over cosines; eta as above, so that
// light from inside has the inverse index. Below 1: the fit of Egan and Hilgeman, "Spectral reflectance of particulate
// materials", Icarus 19, 1973; above: that of d'Eon and Irving, "A Quantized-Diffusion Model for Rendering Translucent
// Materials", SIGGRAPH 2011 (both within 0.3 % for indices up to 1.6).
template <class T>
TR_INLINE T diffuse_fresnel(const T &eta) {
    T inverse = T(1) / eta;
    T below = T(0.0636) * inverse + T(0.6681) + eta * (T(0.7099) - T(1.4399) * eta);
    const double c[] = {-1.36881, 4.98554, -7.80989, 6.75335, -3.4793, 0.919317};
    T above(c[0]);
    for (int i = 1; i < 6; ++i) above = above * inverse + T(c[i]);
    return select(mask<T>(eta < T(1)), below, above);
}

}  // namespace tr
