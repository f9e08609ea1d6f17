// Owen-scrambled Sobol points, padded: every block takes the first four dimensions of the sequence (the first two are a
// (0,2)-sequence), shuffled and scrambled anew for every block and seed, as in Burley, "Practical Hash-based Owen
// Scrambling", JCGT 9(4), 2020. The generator matrices are those of new-joe-kuo-6.21201 (Joe and Kuo, "Constructing
// Sobol sequences with better two-dimensional projections", SIAM J. Sci. Comput. 30(5), 2008).
//
// The pixels of a tile take one sequence, in Morton order (Ahmed and Wonka, "Screen-Space Blue-Noise Diffusion of
// Monte Carlo Sampling Error via Hierarchical Ordering of Pixels", ACM TOG 39(6), 2020): a pixel's own points are as
// good as with a sequence of its own, and those of neighbours together are so as well, which is what filters, and
// derivatives of what many pixels see, sum over.
#pragma once

#include "../math/philox.h"
#include "config.h"

namespace tr {

// Exchanges the groups of N bits that `low` has with those above them.
template <int N, class U>
TR_INLINE U swap_bits(const U &x, uint32_t low) {
    return ((x >> N) & U(low)) | ((x & U(low)) << N);
}

template <class U>
TR_INLINE U reverse_bits(const U &x) {
    U r = swap_bits<4>(swap_bits<2>(swap_bits<1>(x, 0x55555555u), 0x33333333u), 0x0f0f0f0fu);
    return swap_bits<16>(swap_bits<8>(r, 0x00ff00ffu), 0x0000ffffu);
}

// Owen's scrambling of a number whose bits come in reverse order: every bit is flipped or not depending on those below.
// The hash is that of Laine and Karras with the constants that Vegdahl found ("Building a Better LK Hash", 2021).
template <class U>
TR_INLINE U scramble_reversed(U x, const U &key) {
    x = x ^ (x * U(0x3d20adeau));
    x = x + key;
    x = x * ((key >> 16) | U(1u));
    x = x ^ (x * U(0x05526c56u));
    return x ^ (x * U(0x53a22864u));
}

// Points of the sequence with the bits of their coordinates in reverse order; `index_reversed` is reversed as well.
// Only the first two coordinates if no more are wanted.
template <class U>
TR_INLINE void sobol_reversed(const SamplerConfig &sampler, U index_reversed, bool all, U (&x)[4]) {
    U first(0u), second(0u);
    for (int32_t i = 0; i < sampler.bits + 2 * sampler.tile_bits; ++i) {
        // the uppermost bit; AVX-512 packets of Dr.Jit compare unsigned numbers as if they were signed
        auto set = IntOf<U>(index_reversed) < 0;
        first = select(set, first ^ U(sampler.flips[0][i]), first);
        if (all) second = select(set, second ^ U(sampler.flips[1][i]), second);
        index_reversed = index_reversed + index_reversed;
    }
    const U half(0xffffu);
    x[0] = first & half, x[1] = first >> 16;
    x[2] = second & half, x[3] = second >> 16;
}

// Position of a pixel in its tile, in Morton order. `pixel` has the column in its lower half and the row in its upper.
template <class U>
TR_INLINE U morton_in_tile(const U &pixel, int32_t tile_bits) {
    U r(0u);
    for (int32_t i = 0; i < tile_bits; ++i)
        r = r | ((pixel >> i) & U(1u)) << (2 * i) | ((pixel >> (16 + i)) & U(1u)) << (2 * i + 1);
    return r;
}

// Four coordinates, or so many of them; the others are not numbers.
template <class F>
TR_NOINLINE Random4<F> sobol4(const SamplerConfig &sampler, uint64_t seed, uint32_t sensor, const UIntOf<F> &pixel,
                              const UIntOf<F> &sample, uint32_t block, int wanted) {
    using U = UIntOf<F>;
    U index = sample - U(sampler.first);
    const U low((1u << sampler.bits) - 1u);
    const uint32_t inside = (1u << sampler.tile_bits) - 1u;
    U key[4] = {pixel & U(~(inside | inside << 16)), sample - (index & low), U(block | KeyBlocks), U(sensor)};
    philox(key, uint32_t(seed), uint32_t(seed >> 32));
    index = morton_in_tile(pixel, sampler.tile_bits) << sampler.bits | (index & low);
    // Scrambling the index shuffles the pixels of a tile and the samples of a pixel; what it does to higher bits is
    // left out, for it would be one digital shift of all points, which their own scrambling swallows.
    U x[4];
    sobol_reversed(sampler, scramble_reversed(reverse_bits(index), key[0]), wanted > 2, x);
    auto number = [](const U &x, const U &scramble) {
        return unit_number<F>(reverse_bits(scramble_reversed(x, scramble)));
    };
    Random4<F> r{{number(x[0], key[1]), number(x[1], key[2]), F(NAN), F(NAN)}};
    if (wanted > 2) r.u[2] = number(x[2], key[3]);
    if (wanted > 3) {  // a fifth key from two of them: the finaliser of MurmurHash3
        U fifth = key[2] ^ (key[3] >> 1);
        fifth = (fifth ^ (fifth >> 16)) * U(0x85ebca6bu);
        fifth = (fifth ^ (fifth >> 13)) * U(0xc2b2ae35u);
        r.u[3] = number(x[3], fifth ^ (fifth >> 16));
    }
    return r;
}

#define TR_ELSEWHERE(S)                                                                                                \
    extern template Random4<PacketOf<S>> sobol4<PacketOf<S>>(const SamplerConfig &, uint64_t, uint32_t,                \
                                                             const UIntOf<PacketOf<S>> &, const UIntOf<PacketOf<S>> &, \
                                                             uint32_t, int);
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
