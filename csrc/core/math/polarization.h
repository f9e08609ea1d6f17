// Polarised light: what interfaces make of Stokes vectors (I, Q, U, V), and how these turn with their axis.
//
// A Stokes vector is as who receives the light sees it, which travels along k: Q is along the axis, U 45 degrees from
// it counter-clockwise, towards k x axis, V circular to the right. At an interface the axis is the normal of the plane
// of incidence, before and behind it. Signs are those of Muller, "Definitions and Conventions in Ellipsometry", Surface
// Science 16, 1969 (Verdet's); an index of refraction is eta - i k.
//
// With what an interface reflects, or lets through, of unpolarised light as its factor, its Mueller matrix is
//     1  b  0  0
//     b  1  0  0
//     0  0  x -y
//     0  0  y  x
// for which sums over squares, as of a pure state, give b^2 + x^2 + y^2 = 1.
#pragma once

#include "dual.h"

namespace tr {

enum class Polarization : uint8_t {
    None,       // what is scattered is unpolarised
    Metal,      // facets reflect by eta and k
    Interface,  // facets reflect and refract by eta
    Pane,       // of glass, with the reflections inside of it, as light of no phase
    Coat,       // a coat's facets reflect by eta; what the base below scatters is polarised by the coat alone
    Pass,       // what passes is unchanged
    Polarizer,  // plates: their axis passes, the other one is absorbed;
    Retarder,   // the other one lags;
    Circular    // V passes, or -V: I' = I + b V, V' = b I + V
};

template <class T>
struct FacetMatrix {
    T b, x, y;
};

// Of what has no polarisation in between, with an axis of its own on either side: what a base below a coat scatters is
//     1    in      0  0
//     out  out in  0  0
// and zeros. With `both` = 1, and in = out = b, it is a facet's.
template <class T>
struct MuellerMatrix {
    T out, in, both, x, y;

    TR_INLINE MuellerMatrix() = default;
    TR_INLINE MuellerMatrix(const FacetMatrix<T> &m) : out(m.b), in(m.b), both(T(1)), x(m.x), y(m.y) {}
    TR_INLINE MuellerMatrix(const T &out_, const T &in_) : out(out_), in(in_), both(out_ * in_), x(T(0)), y(T(0)) {}
    TR_INLINE MuellerMatrix transposed() const {
        MuellerMatrix r = *this;
        r.out = in, r.in = out, r.y = -y;
        return r;
    }
};

template <class T>
TR_INLINE MuellerMatrix<T> select(const MaskOf<T> &m, const MuellerMatrix<T> &a, const MuellerMatrix<T> &b) {
    MuellerMatrix<T> r;
    r.out = select(m, a.out, b.out), r.in = select(m, a.in, b.in), r.both = select(m, a.both, b.both);
    r.x = select(m, a.x, b.x), r.y = select(m, a.y, b.y);
    return r;
}

// The refracted wave on a facet: A - i B = sqrt(n^2 - sin^2), n = eta - i k, of which L = A^2 + B^2.
template <class T>
struct RefractedWave {
    T c, s2, A, B, L;

    TR_INLINE RefractedWave(const T &cosine, const T &eta, const T &k) : c(cosine), s2(T(1) - cosine * cosine) {
        T a = eta * eta - k * k - s2;
        L = sqrt(max(a * a + T(4) * eta * eta * k * k, T(0)));
        T larger = sqrt(max(T(0.5) * (L + abs(a)), T(0)));
        auto some = mask<T>(T(0) < larger), negative = mask<T>(a < T(0));
        T smaller = eta * k / select(some, larger, T(1));
        A = select(negative, smaller, larger), B = select(negative, larger, smaller);
    }
    // With r_p = r_s (s2 - c q) / (s2 + c q), q = A - i B.
    TR_INLINE FacetMatrix<T> reflection() const {
        T p2 = s2 * s2, r2 = c * c * L, sum = p2 + r2;
        T inverse = T(1) / select(mask<T>(T(0) < sum), sum, T(1)), twice = T(2) * s2 * c * inverse;
        return {twice * A, (p2 - r2) * inverse, twice * B};
    }
    // |r_s|^2
    TR_INLINE T reflected() const {
        T less = c - A, more = c + A, bottom = more * more + B * B;
        return (less * less + B * B) / select(mask<T>(T(0) < bottom), bottom, T(1));
    }
};

// Of light that is refracted, by the cosines on both sides and the index behind over that before.
template <class T>
TR_INLINE FacetMatrix<T> refraction_matrix(const T &ci, const T &ct, const T &eta) {
    T q = eta * ct, u = eta * eta * ci + q, v = eta * (ci + q), u2 = u * u, v2 = v * v, sum = u2 + v2;
    T inverse = T(1) / select(mask<T>(T(0) < sum), sum, T(1));
    return {(u2 - v2) * inverse, T(2) * u * v * inverse, T(0)};
}

// How much of s less than of p an interface lets through, over both: the same from either side. `cosine` is that
// outside, `eta` the index inside over that outside.
template <class T>
TR_INLINE T polarized_by_refraction(const T &cosine, const T &eta) {
    const T inside = sqrt(max(T(1) - (T(1) - cosine * cosine) / (eta * eta), T(0)));
    return refraction_matrix(cosine, inside, eta).b;
}

// Of a pane, whose inner reflections add up without interference. `r` and `t` are one face's for the amplitudes'
// product r_p r_s and t_p t_s: r + t^2 r / (1 - r^2), and t^2 / (1 - r^2). A film of air may reflect all, with phases.
template <class T>
TR_INLINE FacetMatrix<T> pane_matrix(const MaskOf<T> &reflects, const T &cosine, const T &eta) {
    RefractedWave<T> wave(cosine, eta, T(0));
    FacetMatrix<T> face = wave.reflection();
    T s = wave.reflected(), mean = s / (T(1) + face.b);  // of both polarisations
    T p = T(2) * mean - s, r = mean * face.x;
    T ct = sqrt(max(T(1) - wave.s2 / (eta * eta), T(0)));
    T t = refraction_matrix(cosine, ct, eta).x * (T(1) - mean), within = T(1) - r * r;
    T inverse = T(1) / select(mask<T>(T(1e-12) < within), within, T(1));
    T inner = t * t * inverse, s2 = T(2) * s / (T(1) + s), p2 = T(2) * p / (T(1) + p);
    T as = select(reflects, s2, T(1) - s2), ap = select(reflects, p2, T(1) - p2), sum = as + ap;
    T normal = T(1) / select(mask<T>(T(0) < sum), sum, T(1));
    return {(as - ap) * normal, T(2) * select(reflects, r + inner * r, inner) * normal,
            T(2) * select(reflects, mean * face.y, T(0)) * normal};
}

// At a smooth facet z is the cosine of the arriving direction, at a rough one that between both directions; `eta` is
// the index behind over that before.
template <class T>
TR_INLINE FacetMatrix<T> facet_matrix(Polarization kind, bool smooth, const MaskOf<T> &reflects, const T &z,
                                      const T &eta, const T &k) {
    if (kind == Polarization::Pass) return {T(0), T(1), T(0)};
    if (kind == Polarization::Polarizer) return {T(1), T(0), T(0)};
    T c = abs(z);
    if (!smooth) c = sqrt(max(T(0.5) * (T(1) + z), T(0)));
    if (kind == Polarization::Metal) return RefractedWave<T>(c, eta, k).reflection();
    if (kind == Polarization::Pane) return pane_matrix(reflects, c, eta);
    T ci = c, ct = sqrt(max(T(1) - (T(1) - c * c) / (eta * eta), T(0)));
    if (!smooth) {  // on the normal of the facet, along wi + eta wo
        T length2 = max(T(1) + eta * (T(2) * z + eta), T(1e-20)), inverse = T(1) / sqrt(length2);
        ci = abs(T(1) + eta * z) * inverse, ct = abs(z + eta) * inverse;
    }
    FacetMatrix<T> reflected = RefractedWave<T>(c, eta, T(0)).reflection(), refracted = refraction_matrix(ci, ct, eta);
    return {select(reflects, reflected.b, refracted.b), select(reflects, reflected.x, refracted.x),
            select(reflects, reflected.y, refracted.y)};
}

// From the axis `from` to the axis `to`, both perpendicular to k: cosine and sine of twice the angle.
template <class F>
struct StokesRotation {
    F c, s;

    TR_INLINE StokesRotation(const Vec3<F> &from, const Vec3<F> &to, const Vec3<F> &k) {
        F x = dot(from, to), y = dot(to, cross(k, from)), length = x * x + y * y;
        auto some = mask<F>(length > F(0));
        F inverse = F(1) / select(some, length, F(1));
        c = select(some, (x * x - y * y) * inverse, F(1));
        s = F(2) * x * y * inverse;
    }
};

}  // namespace tr
