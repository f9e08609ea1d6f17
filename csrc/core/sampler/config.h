// How the random numbers of a rendering are chosen. Each sampler gives four numbers for a block of dimensions of a
// sample, a function of seed, sensor, pixel, sample and block alone.
#pragma once

#include "../math/facts.h"
#include "strata.h"

namespace tr {

enum class SamplerKind : int32_t { Independent, Stratified, Sobol };

struct SamplerConfig {
    TR_FACT(SamplerKind, kind, SamplerKind(TR_SAMPLER));
    uint32_t first;             // number of the first sample of a pixel
    Strata all, columns, rows;  // stratified: samples of a pattern, and the grid of cells that has at least as many
    // Sobol: a pattern has 2^bits samples of each pixel of a tile of 2^tile_bits pixels on a side. Bit i of the index
    // flips these bits of the first two coordinates, in reverse order (the lower and upper half), and of the other two.
    int32_t bits, tile_bits;
    uint32_t flips[2][16];
};

// Patterns are not larger: what more strata would gain is far below what other dimensions leave.
constexpr int32_t LargestBits = 16, LargestTileBits = 4;
constexpr int64_t LargestPattern = 1 << LargestBits;

#if !defined(TR_ONE_SCENE)  // on the host
// For samples first .. first + count - 1 of every pixel. More samples than a pattern has are several patterns; if a
// sampler is asked for samples beyond, they begin another one.
inline SamplerConfig make_sampler(SamplerKind kind, int64_t first, int64_t count) {
    SamplerConfig r{};
    r.kind = kind;
    r.first = uint32_t(first);
    count = count < 1 ? 1 : count;
    int64_t patterns = (count + LargestPattern - 1) / LargestPattern;
    uint32_t n = uint32_t((count + patterns - 1) / patterns);
    r.all = make_strata(n);
    uint32_t columns = 1;
    while (uint64_t(columns + 1) * (columns + 1) <= n) ++columns;
    r.columns = make_strata(columns);
    r.rows = make_strata((n + columns - 1) / columns);
    while (r.bits < LargestBits && (int64_t(1) << r.bits) < count) ++r.bits;
    r.tile_bits = (LargestBits - r.bits) / 2 < LargestTileBits ? (LargestBits - r.bits) / 2 : LargestTileBits;
    // Columns of the generator matrices, of ones and by the recurrences of the dimensions' primitive polynomials x + 1,
    // x^2 + x + 1 and x^3 + x + 1 with initial numbers (1), (1, 3) and (1, 3, 1).
    uint32_t a = 1, b[2] = {1, 3}, c[3] = {1, 3, 4};
    for (int i = 0; i < LargestBits; ++i) {
        r.flips[0][i] = 1u << i | a << 16;
        r.flips[1][i] = b[0] | c[0] << 16;
        a ^= a << 1;
        uint32_t b2 = b[1] ^ b[0] ^ b[0] << 2, c3 = c[1] ^ c[0] ^ c[0] << 3;
        b[0] = b[1], b[1] = b2;
        c[0] = c[1], c[1] = c[2], c[2] = c3;
    }
    return r;
}
#endif

// Which of a block's four numbers are wanted: two that are a point in the plane, and two that are chosen by themselves.
enum Wanted : uint32_t { PairWanted = 1, ThirdWanted = 2, FourthWanted = 4, AllWanted = 7 };

// What tells the numbers that choose permutations and scrambles from those that are used themselves.
constexpr uint32_t KeyBlocks = 1u << 31;

// A 32-bit fraction as a number in [0, 1), a multiple of 2^-24.
template <class F>
TR_INLINE F unit_number(const UIntOf<F> &fraction) {
    return convert<F>(convert<IntOf<F>>((fraction >> 8))) * F(1.0 / 16777216.0);
}

}  // namespace tr
