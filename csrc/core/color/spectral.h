// The spectral variant: paths at three wavelengths, chosen for each sample of a pixel, and the two forms that spectra
// have for the core: tables (constants), and per texel the coefficients of a smooth function.
//
// Three wavelengths in place of more: a sample's first number only stratifies the hues of a pixel's samples, so that
// noise of colour falls faster than that of more wavelengths chosen independently.
#pragma once

#include "../math/philox.h"
#include "../math/rows.h"
#include "spectrum.h"

namespace tr {

// Tables have a number a nanometre, and are linear in between.
constexpr int SpectrumSamples = 471;
constexpr double FirstWavelength = 360, LastWavelength = 830;

// Channels of texels that are spectra: a sigmoid's coefficients and a factor, see sigmoid_texels. One channel is grey,
// and three are no colour (a normal).
constexpr int SigmoidChannels = 4;

// What of a call decides the wavelengths of its paths. Addresses of numbers of the scene's precision; null in rgb.
struct SpectralConfig {
    // The inverse of their cumulative distribution at 3 `intervals` + 1 equally spaced numbers: linear in between, so
    // that the density is exact.
    TR_FACT(const void *, positions, nullptr);
    int32_t intervals;
    const void *weights;  // (SpectrumSamples, 3): what a wavelength adds to the channels of the film
    // The bits of both by which samples of a pixel choose their own; what differs in others alone has the same.
    uint32_t pixel_bits = 0xFFFFFFFFu, sample_bits = 0xFFFFFFFFu;
};

// Blocks of random numbers of paths are smaller, see integrator/config.h.
constexpr uint32_t WavelengthBlock = 0x3FFFFFFEu;

template <class F>
struct ChosenWavelengths {
    Wavelengths<F> waves;
    F inverse[SpectrumSize];  // 1 / (3 density), in nm
};

// Sample k of a pixel takes the numbers u_k + c / 3 (mod 1), u_k = (frac(v + k phi) + (k + h) mod 3) / 3 with the
// golden ratio phi; v and h are hashed from seed and pixel. Each of them alone is uniform, the first one within all
// thirds.
template <class F>
TR_NOINLINE ChosenWavelengths<F> choose_wavelengths(const SpectralConfig &config, uint64_t seed, uint32_t sensor,
                                                    const UIntOf<F> &pixel, const UIntOf<F> &sample) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using I = IntOf<F>;
    const U own = sample & config.sample_bits;
    const RandomBits4<F> hash = random_bits4<F>(seed, sensor, pixel & config.pixel_bits, U(0u), U(WavelengthBlock));
    F place = uniform_of<F>(hash.bits[0] + own * 0x9E3779B9u) * F(S(config.intervals));
    F below = floor(place), within = place - below;
    U k = own + (hash.bits[1] >> 1);  // may wrap around: a jump of the order of thirds
    U third = k - (mul_hi(k, U(0xAAAAAAABu)) >> 1) * 3u;
    const S *positions = static_cast<const S *>(config.positions);
    ChosenWavelengths<F> r;
    r.waves.chosen = true;
    for (uint32_t c = 0; c < SpectrumSize; ++c) {
        U index = U(I(below)) + third * uint32_t(config.intervals);
        F end[2];
        gather_rows<F>(positions, index, MaskOf<F>(true), end);
        F length = end[1] - end[0];
        r.waves.at[c] = fmadd(within, length, end[0]);
        r.inverse[c] = length * F(S(config.intervals));
        third = select(mask<U>(third == 2u), U(0u), third + 1u);
    }
    return r;
}

// ---------------------------------------------------------------------------------------------------------- tables
template <class F>
struct TablePlace {
    UIntOf<F> index;
    F fraction;
    TR_INLINE explicit TablePlace(const F &at) {
        using S = ScalarOf<F>;
        F below = max(F(0), min(floor(at), F(S(SpectrumSamples - 2))));
        index = UIntOf<F>(IntOf<F>(below));
        fraction = at - below;
    }
};

// The table that begins at `offset`.
template <class F, class S>
TR_NOINLINE Spectrum<F> table_spectrum(const S *numbers, const Wavelengths<F> &waves, const UIntOf<F> &offset,
                                       const MaskOf<F> &active) {
    Spectrum<F> r;
    for (int c = 0; c < SpectrumSize; ++c) {
        const TablePlace<F> place(waves.at[c]);
        F end[2];
        gather_rows<F>(numbers, offset + place.index, active, end);
        r[c] = fmadd(place.fraction, end[1] - end[0], end[0]);
    }
    return r;
}

// -------------------------------------------------------------------------------------------------------- the film
template <class F>
struct FilmWeights {
    Spectrum<F> by_wave[SpectrumSize];  // of each wavelength, what it adds to the channels

    TR_INLINE FilmWeights(const SpectralConfig &config, const ChosenWavelengths<F> &chosen) {
        const auto *weights = static_cast<const ScalarOf<F> *>(config.weights);
        for (int c = 0; c < SpectrumSize; ++c) {
            const TablePlace<F> place(chosen.waves.at[c]);
            F low[SpectrumSize], high[SpectrumSize];
            gather_rows<F>(weights, place.index * uint32_t(SpectrumSize), MaskOf<F>(true), low);
            gather_rows<F>(weights, (place.index + 1u) * uint32_t(SpectrumSize), MaskOf<F>(true), high);
            for (int j = 0; j < SpectrumSize; ++j)
                by_wave[c][j] = fmadd(place.fraction, high[j] - low[j], low[j]) * chosen.inverse[c];
        }
    }
    // The channels of what arrives, and the adjoint of what arrives, of that of the channels.
    TR_INLINE Spectrum<F> channels(const Spectrum<F> &spectrum) const {
        return by_wave[0] * spectrum[0] + by_wave[1] * spectrum[1] + by_wave[2] * spectrum[2];
    }
    TR_INLINE Spectrum<F> pull(const Spectrum<F> &channels_bar) const {
        Spectrum<F> r;
        for (int c = 0; c < SpectrumSize; ++c) r[c] = component_sum(by_wave[c] * channels_bar);
        return r;
    }
};

// ---------------------------------------------------------------------------------------------------------- texels
// A sigmoid of a quadratic, s(q) = 1/2 + q / (2 sqrt(1 + q^2)), q = c0 x^2 + c1 x + c2, and its slope by q; x goes from
// 0 to 1 over the visible wavelengths. Jakob and Hanika, "A Low-Dimensional Function Space for Efficient Spectral
// Upsampling", Eurographics 2019.
template <class F>
struct Sigmoid {
    F x, value, slope;
    TR_INLINE Sigmoid(const F &at, const F (&row)[SigmoidChannels])
        : x(at * F(ScalarOf<F>(1 / (LastWavelength - FirstWavelength)))) {
        F q = fmadd(fmadd(row[0], x, row[1]), x, row[2]);
        F inverse = F(1) / sqrt(fmadd(q, q, F(1))), half = F(0.5) * inverse;
        value = fmadd(q, half, F(0.5));
        slope = half * inverse * inverse;
    }
};

// The weighted sum of texels' spectra: not of their coefficients, so that it is that of their colours. `base`: the
// texels of which `data` is the tangent, or null.
template <class F, class S>
TR_NOINLINE Spectrum<F> sigmoid_texels(const S *data, const S *base, const Wavelengths<F> &waves,
                                       const UIntOf<F> *texel, const F *weight, int n, const MaskOf<F> &active) {
    Spectrum<F> r = uniform_spectrum(F(0));
    for (int i = 0; i < n; ++i) {
        F row[SigmoidChannels], at[SigmoidChannels];
        gather_rows<F>(data, texel[i] * uint32_t(SigmoidChannels), active, row);
        if (base) gather_rows<F>(base, texel[i] * uint32_t(SigmoidChannels), active, at);
        for (int c = 0; c < SpectrumSize; ++c) {
            if (!base) {
                r[c] = fmadd(weight[i], row[3] * Sigmoid<F>(waves.at[c], row).value, r[c]);
                continue;
            }
            const Sigmoid<F> s(waves.at[c], at);
            F change = fmadd(fmadd(row[0], s.x, row[1]), s.x, row[2]);
            r[c] = fmadd(weight[i], fmadd(at[3] * s.slope, change, row[3] * s.value), r[c]);
        }
    }
    return r;
}

// The transposed of that: hands visit(i, adjoints of the numbers of texel i) on; g: the adjoint of the sum.
template <class F, class S, class Visit>
TR_INLINE void sweep_sigmoid_texels(const S *data, const Wavelengths<F> &waves, const UIntOf<F> *texel, const F *weight,
                                    int n, const Spectrum<F> &g, const MaskOf<F> &active, Visit &&visit) {
    for (int i = 0; i < n; ++i) {
        F at[SigmoidChannels], bar[SigmoidChannels] = {F(0), F(0), F(0), F(0)};
        gather_rows<F>(data, texel[i] * uint32_t(SigmoidChannels), active, at);
        for (int c = 0; c < SpectrumSize; ++c) {
            const Sigmoid<F> s(waves.at[c], at);
            F w = weight[i] * g[c], change = w * at[3] * s.slope;
            bar[2] = bar[2] + change;
            bar[1] = fmadd(change, s.x, bar[1]);
            bar[0] = fmadd(change * s.x, s.x, bar[0]);
            bar[3] = fmadd(w, s.value, bar[3]);
        }
        visit(i, bar);
    }
}

// ------------------------------------------------------------------------------------------------------- luminance
// Luminance in daylight as the mean over these wavelengths, which are so many equal shares of it (the CIE's observer of
// 1931 and D65): for what is no light on its way, where a number of its own is needed of a colour. A third of them.
constexpr int LuminanceNodes = 9;
template <class F>
TR_INLINE Wavelengths<F> luminance_wavelengths(int third) {
    constexpr double nodes[LuminanceNodes] = {492.48, 518.03, 532.05, 543.97, 555.41, 567.35, 580.61, 597.45, 624.05};
    Wavelengths<F> r;
    r.chosen = true;
    for (int c = 0; c < SpectrumSize; ++c) r.at[c] = F(ScalarOf<F>(nodes[SpectrumSize * third + c] - FirstWavelength));
    return r;
}

#define TR_ELSEWHERE(S)                                                                                             \
    extern template ChosenWavelengths<PacketOf<S>> choose_wavelengths<PacketOf<S>>(                                 \
        const SpectralConfig &, uint64_t, uint32_t, const UIntOf<PacketOf<S>> &, const UIntOf<PacketOf<S>> &);      \
    extern template Spectrum<PacketOf<S>> table_spectrum(const S *, const Wavelengths<PacketOf<S>> &,               \
                                                         const UIntOf<PacketOf<S>> &, const MaskOf<PacketOf<S>> &); \
    extern template Spectrum<PacketOf<S>> sigmoid_texels(const S *, const S *, const Wavelengths<PacketOf<S>> &,    \
                                                         const UIntOf<PacketOf<S>> *, const PacketOf<S> *, int,     \
                                                         const MaskOf<PacketOf<S>> &);
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
