// What travels along a path: radiance, throughput, and what a BSDF makes of them, at a few wavelengths or in a few
// colour channels at once. A scene without colours uses the same numbers, all of them equal.
//
// Three things are not the same although rgb gives each of them three numbers: the channels of a tensor (one, or those
// of the scene's colours: a run-time number, see TensorView), the spectrum along a path, and the numbers of a pixel
// (a run-time number, see RenderCall::values). In the spectral variant a path has three wavelengths, see spectral.h.
#pragma once

#include "../math/facts.h"
#include "../math/vector.h"

namespace tr {

constexpr int SpectrumSize = 3;

template <class F, int N = SpectrumSize>
struct Spectrum {
    F c[N];

    TR_INLINE F &operator[](int i) { return c[i]; }
    TR_INLINE const F &operator[](int i) const { return c[i]; }
};

// The wavelengths that a packet's spectra are at, which every look-up of a colour receives. In rgb there are none, and
// a spectrum's components are the channels.
template <class F>
struct Wavelengths {
    bool chosen = false;
    F at[SpectrumSize];  // in nm above FirstWavelength
    TR_INLINE bool spectral() const { return facts::Spectral && chosen; }
};

template <int N = SpectrumSize, class F>
TR_INLINE Spectrum<F, N> uniform_spectrum(const F &x) {
    Spectrum<F, N> r;
    for (int i = 0; i < N; ++i) r.c[i] = x;
    return r;
}
#define TR_SPECTRUM_OP(op)                                                         \
    template <class A, class B, int N>                                             \
    TR_INLINE auto operator op(const Spectrum<A, N> &a, const Spectrum<B, N> &b) { \
        Spectrum<decltype(a.c[0] op b.c[0]), N> r;                                 \
        for (int i = 0; i < N; ++i) r.c[i] = a.c[i] op b.c[i];                     \
        return r;                                                                  \
    }
TR_SPECTRUM_OP(+)
TR_SPECTRUM_OP(-)
TR_SPECTRUM_OP(*)
#undef TR_SPECTRUM_OP
template <class A, class B, int N>
TR_INLINE auto operator*(const Spectrum<A, N> &a, const B &s) {
    Spectrum<decltype(a.c[0] * s), N> r;
    for (int i = 0; i < N; ++i) r.c[i] = a.c[i] * s;
    return r;
}
template <class M, class F, int N>
TR_INLINE Spectrum<F, N> select(const M &m, const Spectrum<F, N> &a, const Spectrum<F, N> &b) {
    Spectrum<F, N> r;
    for (int i = 0; i < N; ++i) r.c[i] = select(m, a.c[i], b.c[i]);
    return r;
}
template <class F, int N>
TR_INLINE Spectrum<F, N> max_with(const Spectrum<F, N> &a, const F &b) {
    Spectrum<F, N> r;
    for (int i = 0; i < N; ++i) r.c[i] = max(a.c[i], b);
    return r;
}
template <class F, int N>
TR_INLINE Spectrum<F, N> magnitude(const Spectrum<F, N> &a) {
    Spectrum<F, N> r;
    for (int i = 0; i < N; ++i) r.c[i] = abs(a.c[i]);
    return r;
}

// The largest magnitude: a step of an optimiser may make a colour negative, which must not end paths.
template <class F, int N>
TR_INLINE F max_component(const Spectrum<F, N> &a) {
    F r = abs(a.c[0]);
    for (int i = 1; i < N; ++i) r = max(r, abs(a.c[i]));
    return r;
}
template <class F, int N>
TR_INLINE MaskOf<F> is_finite(const Spectrum<F, N> &a) {
    F sum = a.c[0] - a.c[0];  // NaN unless finite
    for (int i = 1; i < N; ++i) sum = sum + (a.c[i] - a.c[i]);
    return mask<F>(sum == F(0));
}

// The sum over components: what an adjoint and a value make, or the adjoint of a number that all of them depend on.
template <class F, int N>
TR_INLINE F component_sum(const Spectrum<F, N> &a) {
    F r = a[0];
    for (int c = 1; c < N; ++c) r = r + a[c];
    return r;
}

// Adjoints are rows and radiance is a column. apply(f, x): what a factor f of a path makes of radiance that arrives
// there; pull(a, f): what it makes of the adjoint of what leaves; contract(a, x): the number that an adjoint and a
// value make. Components of rgb do not mix: all of these are products component by component.
template <class F>
TR_INLINE Spectrum<F> apply(const Spectrum<F> &f, const Spectrum<F> &x) {
    return f * x;
}
template <class F>
TR_INLINE Spectrum<F> pull(const Spectrum<F> &a, const Spectrum<F> &f) {
    return a * f;
}
template <class F>
TR_INLINE F contract(const Spectrum<F> &a, const Spectrum<F> &x) {
    return component_sum(a * x);
}

// ITU-R BT.709 luminance of linear red, green and blue.
constexpr double LuminanceRed = 0.2126, LuminanceGreen = 0.7152, LuminanceBlue = 0.0722;
template <class F>
TR_INLINE F luminance(const Spectrum<F> &a) {
    return F(LuminanceRed) * a.c[0] + F(LuminanceGreen) * a.c[1] + F(LuminanceBlue) * a.c[2];
}
// The adjoint of a colour of whose luminance g is the adjoint, by components of what depends on it.
template <class F>
TR_INLINE Spectrum<F> luminance_adjoint(const Spectrum<F> &g) {
    F sum = component_sum(g);
    return {{F(LuminanceRed) * sum, F(LuminanceGreen) * sum, F(LuminanceBlue) * sum}};
}

}  // namespace tr
