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
// Only the wanted ones.
template <class U>
TR_INLINE void sobol_reversed(const SamplerConfig &sampler, U index_reversed, uint32_t wanted, U (&x)[4]) {
    const bool pair = (wanted & PairWanted) != 0, others = (wanted & ~PairWanted) != 0;
    U first(0u), second(0u);
    for (int32_t i = 0; i < sampler.bits + 2 * sampler.tile_bits; ++i) {
        const U set = U(IntOf<U>(index_reversed) >> 31);  // the uppermost bit, everywhere
        if (pair) first = first ^ (set & U(sampler.flips[0][i]));
        if (others) second = second ^ (set & U(sampler.flips[1][i]));
        index_reversed = index_reversed + index_reversed;
    }
    const U half(0xffffu);
    x[0] = first & half, x[1] = first >> 16;
    x[2] = second & half, x[3] = second >> 16;
}

// Position of a pixel in its tile, in Morton order. `pixel` has the column in its lower half and the row in its upper.
template <class U>
TR_INLINE U morton_in_tile(const U &pixel, int32_t tile_bits) {
    const uint32_t inside = (1u << tile_bits) - 1u;
    U r = pixel & U(inside | inside << 16);  // at most four bits of each, which are spread to every other place
    r = (r | (r << 2)) & U(0x00330033u);
    r = (r | (r << 1)) & U(0x00550055u);
    return (r | (r >> 15)) & U(0xffu);
}

// Where in a sequence samples of pixels are: the sequence is that of a tile and a pattern, see SamplerConfig.
template <class U>
struct SobolPlace {
    U tile, begin;     // its uppermost left pixel; the pattern's first sample
    U index_reversed;  // in the sequence

    SobolPlace() = default;
    TR_INLINE SobolPlace(const SamplerConfig &sampler, const U &pixel, const U &sample) {
        const uint32_t inside = (1u << sampler.tile_bits) - 1u;
        const U within = (sample - U(sampler.first)) & U((1u << sampler.bits) - 1u);
        tile = pixel & U(~(inside | inside << 16));
        begin = sample - within;
        index_reversed = reverse_bits(U(morton_in_tile(pixel, sampler.tile_bits) << sampler.bits | within));
    }
};

// What shuffles a sequence and scrambles its coordinates, anew in every block.
template <class U>
TR_INLINE void sobol_keys(uint64_t seed, uint32_t sensor, const U &tile, const U &begin, uint32_t block, U (&key)[4]) {
    key[0] = tile, key[1] = begin, key[2] = U(block | KeyBlocks), key[3] = U(sensor);
    philox(key, uint32_t(seed), uint32_t(seed >> 32));
}

// The keys of two blocks in a row, where all samples of a batch are of one sequence: found once for many packets.
struct CommonKeys {
    bool common = false;
    uint32_t tile, begin, first_block;
    uint32_t key[2][4];

#if !defined(TR_ONE_SCENE)  // on the host
    // Looks at the samples of a batch.
    void of_batch(const SamplerConfig &sampler, const uint32_t *pixel, const uint32_t *sample, size_t n) {
        common = sampler.kind == SamplerKind::Sobol && n > 0;
        if (!common) return;
        const SobolPlace<uint32_t> first(sampler, pixel[0], sample[0]);
        uint32_t differs = 0;
        for (size_t i = 0; i < n; ++i) {
            const SobolPlace<uint32_t> at(sampler, pixel[i], sample[i]);
            differs |= (at.tile ^ first.tile) | (at.begin ^ first.begin);
        }
        common = differs == 0;
        tile = first.tile, begin = first.begin;
    }
    void find(uint64_t seed, uint32_t sensor, uint32_t block) {
        first_block = block;
        for (uint32_t k = 0; common && k < 2; ++k) sobol_keys(seed, sensor, tile, begin, block + k, key[k]);
    }
#endif
    // Those of a block; null: not found.
    TR_HD const uint32_t *operator()(uint32_t block) const {
        return common && block - first_block < 2 ? key[block - first_block] : nullptr;
    }
};

// The wanted ones of four coordinates; the others are not numbers. `common`: the keys of all lanes, if they are known.
template <class F>
TR_NOINLINE Random4<F> sobol4(const SamplerConfig &sampler, uint64_t seed, uint32_t sensor,
                              const SobolPlace<UIntOf<F>> &at, uint32_t block, uint32_t wanted,
                              const uint32_t *common = nullptr) {
    using U = UIntOf<F>;
    U key[4];
    if (common)
        for (int k = 0; k < 4; ++k) key[k] = U(common[k]);
    else
        sobol_keys(seed, sensor, at.tile, at.begin, block, key);
    // Scrambling the index shuffles the pixels of a tile and the samples of a pixel; what it does to higher bits is
    // left out, for it would be one digital shift of all points, which their own scrambling swallows.
    U x[4];
    sobol_reversed(sampler, scramble_reversed(at.index_reversed, key[0]), wanted, x);
    auto number = [](const U &x, const U &scramble) {
        return unit_number<F>(reverse_bits(scramble_reversed(x, scramble)));
    };
    Random4<F> r{{F(NAN), F(NAN), F(NAN), F(NAN)}};
    if (wanted & PairWanted) r.u[0] = number(x[0], key[1]), r.u[1] = number(x[1], key[2]);
    if (wanted & ThirdWanted) r.u[2] = number(x[2], key[3]);
    if (wanted & FourthWanted) {  // a fifth key from two of them: the finaliser of MurmurHash3
        U fifth = key[2] ^ (key[3] >> 1);
        fifth = (fifth ^ (fifth >> 16)) * U(0x85ebca6bu);
        fifth = (fifth ^ (fifth >> 13)) * U(0xc2b2ae35u);
        r.u[3] = number(x[3], fifth ^ (fifth >> 16));
    }
    return r;
}

#define TR_ELSEWHERE(S)                                                                                         \
    extern template Random4<PacketOf<S>> sobol4<PacketOf<S>>(const SamplerConfig &, uint64_t, uint32_t,         \
                                                             const SobolPlace<UIntOf<PacketOf<S>>> &, uint32_t, \
                                                             uint32_t, const uint32_t *);
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
