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
    T term1 = a2b2 + c2, term2 = T(2) * cos_i * sqrt(max(T(0.5) * (a2b2 + a), T(0)));
    T rs = (term1 - term2) / (term1 + term2);
    T term3 = a2b2 * c2 + s2 * s2, term4 = term2 * s2;
    T rp = rs * (term3 - term4) / (term3 + term4);
    return T(0.5) * (rs + rp);
}

}  // namespace tr
