// Dual numbers: a value and N partial derivatives, propagated by the chain rule. A BSDF's `eval` written for a scalar
// type T becomes its own derivative when T is a dual number (compare Ceres Solver, jet.h, for the idea).
#pragma once

#include "vector.h"

namespace tr {

template <class F, int N>
struct Dual {
    F v;
    F d[N];

    Dual() = default;
    TR_INLINE Dual(const F &value) : v(value) {
        for (int i = 0; i < N; ++i) d[i] = F(0);
    }
    template <class T, class = std::enable_if_t<std::is_arithmetic_v<T> && !std::is_same_v<T, F>>>
    TR_INLINE Dual(T value) : Dual(F(value)) {}
    // the i-th independent variable
    TR_INLINE Dual(const F &value, int i) : Dual(value) { d[i] = F(1); }
};

template <class F, int N>
struct Lanes<Dual<F, N>> : Lanes<F> {};

template <class F, int N>
TR_INLINE Dual<F, N> chain(const F &value, const F &derivative, const Dual<F, N> &a) {
    Dual<F, N> r;
    r.v = value;
    for (int i = 0; i < N; ++i) r.d[i] = derivative * a.d[i];
    return r;
}
template <class F, int N>
TR_INLINE Dual<F, N> operator-(const Dual<F, N> &a) {
    return chain(-a.v, F(-1), a);
}
template <class F, int N>
TR_INLINE Dual<F, N> operator+(const Dual<F, N> &a, const Dual<F, N> &b) {
    Dual<F, N> r;
    r.v = a.v + b.v;
    for (int i = 0; i < N; ++i) r.d[i] = a.d[i] + b.d[i];
    return r;
}
template <class F, int N>
TR_INLINE Dual<F, N> operator-(const Dual<F, N> &a, const Dual<F, N> &b) {
    Dual<F, N> r;
    r.v = a.v - b.v;
    for (int i = 0; i < N; ++i) r.d[i] = a.d[i] - b.d[i];
    return r;
}
template <class F, int N>
TR_INLINE Dual<F, N> operator*(const Dual<F, N> &a, const Dual<F, N> &b) {
    Dual<F, N> r;
    r.v = a.v * b.v;
    for (int i = 0; i < N; ++i) r.d[i] = a.d[i] * b.v + a.v * b.d[i];
    return r;
}
template <class F, int N>
TR_INLINE Dual<F, N> operator/(const Dual<F, N> &a, const Dual<F, N> &b) {
    F inverse = F(1) / b.v, value = a.v * inverse;
    Dual<F, N> r;
    r.v = value;
    for (int i = 0; i < N; ++i) r.d[i] = (a.d[i] - value * b.d[i]) * inverse;
    return r;
}
// A plain number on one side has no derivative.
#define TR_DUAL_MIXED(op)                                               \
    template <class F, int N>                                           \
    TR_INLINE Dual<F, N> operator op(const Dual<F, N> &a, const F &b) { \
        return a op Dual<F, N>(b);                                      \
    }                                                                   \
    template <class F, int N>                                           \
    TR_INLINE Dual<F, N> operator op(const F &a, const Dual<F, N> &b) { \
        return Dual<F, N>(a) op b;                                      \
    }
TR_DUAL_MIXED(+)
TR_DUAL_MIXED(-)
TR_DUAL_MIXED(/)
#undef TR_DUAL_MIXED
template <class F, int N>
TR_INLINE Dual<F, N> operator*(const Dual<F, N> &a, const F &b) {
    return chain(a.v * b, b, a);
}
template <class F, int N>
TR_INLINE Dual<F, N> operator*(const F &a, const Dual<F, N> &b) {
    return b * a;
}
template <class F, int N>
TR_INLINE auto operator<(const Dual<F, N> &a, const Dual<F, N> &b) {
    return a.v < b.v;
}
template <class F, int N>
TR_INLINE auto operator>(const Dual<F, N> &a, const Dual<F, N> &b) {
    return a.v > b.v;
}
template <class M, class F, int N>
TR_INLINE Dual<F, N> select(const M &m, const Dual<F, N> &a, const Dual<F, N> &b) {
    Dual<F, N> r;
    r.v = select(m, a.v, b.v);
    for (int i = 0; i < N; ++i) r.d[i] = select(m, a.d[i], b.d[i]);
    return r;
}
template <class F, int N>
TR_INLINE Dual<F, N> sqrt(const Dual<F, N> &a) {
    F root = sqrt(a.v);
    // the derivative at zero is taken as zero, not infinite: the argument is clamped there
    return chain(root, select(mask<F>(root > F(0)), F(0.5) / root, F(0)), a);
}
template <class F, int N>
TR_INLINE Dual<F, N> abs(const Dual<F, N> &a) {
    return select(mask<F>(a.v < F(0)), -a, a);
}
template <class F, int N>
TR_INLINE Dual<F, N> max(const Dual<F, N> &a, const Dual<F, N> &b) {
    return select(mask<F>(a.v > b.v), a, b);
}
template <class F, int N>
TR_INLINE Dual<F, N> min(const Dual<F, N> &a, const Dual<F, N> &b) {
    return select(mask<F>(a.v < b.v), a, b);
}
template <class F, int N>
TR_INLINE Dual<F, N> exp(const Dual<F, N> &a) {
    F value = exp(a.v);
    return chain(value, value, a);
}
template <class F, int N>
TR_INLINE Dual<F, N> log(const Dual<F, N> &a) {
    return chain(log(a.v), F(1) / a.v, a);
}
template <class F, int N>
TR_INLINE void sincos(const Dual<F, N> &a, Dual<F, N> &s, Dual<F, N> &c) {
    F sine, cosine;
    sincos(a.v, sine, cosine);
    s = chain(sine, cosine, a);
    c = chain(cosine, -sine, a);
}
template <class F, int N>
TR_INLINE Dual<F, N> atan2(const Dual<F, N> &y, const Dual<F, N> &x) {
    F squared = x.v * x.v + y.v * y.v;
    auto apart = mask<F>(squared > F(0));
    F inverse = select(apart, F(1) / select(apart, squared, F(1)), F(0));
    Dual<F, N> r;
    r.v = atan2(y.v, x.v);
    for (int i = 0; i < N; ++i) r.d[i] = (x.v * y.d[i] - y.v * x.d[i]) * inverse;
    return r;
}

// x with another value: the derivative stays.
template <class F>
TR_INLINE F with_value(const F &, const F &value) {
    return value;
}
template <class F, int N>
TR_INLINE Dual<F, N> with_value(Dual<F, N> x, const F &value) {
    x.v = value;
    return x;
}

// The value without its derivative.
template <class F>
TR_INLINE const F &value_of(const F &x) {
    return x;
}
template <class F, int N>
TR_INLINE const F &value_of(const Dual<F, N> &x) {
    return x.v;
}

}  // namespace tr
