// The unit interval in n equal strata, in integers: 32-bit fractions of it, so that numbers, packets and both
// precisions find the same ones.
#pragma once

#include "../math/lanes.h"

namespace tr {

struct Strata {
    uint32_t n;
    uint32_t width;  // floor(2^32 / n); not used for n = 1
    uint32_t rest;   // what that leaves out: floor((2^32 mod n) / n * 2^32)
};

inline Strata make_strata(uint32_t n) {
    uint64_t one = uint64_t(1) << 32;
    return {n, n > 1 ? uint32_t(one / n) : 0u, uint32_t((one % n << 32) / n)};
}

// (stratum + jitter) / n, where jitter and the result are 32-bit fractions; too small by less than 3 of their units.
template <class U>
TR_INLINE U place(const Strata &strata, const U &stratum, const U &jitter) {
    if (strata.n == 1) return jitter;
    return stratum * U(strata.width) + mul_hi(stratum, U(strata.rest)) + mul_hi(jitter, U(strata.width));
}

// floor(x / n) and x mod n. x width / 2^32 is less than 1 below x / n, so that one correction is enough.
template <class U>
TR_INLINE U divide(const Strata &strata, const U &x, U &remainder) {
    remainder = U(0u);
    if (strata.n == 1) return x;
    U quotient = mul_hi(x, U(strata.width));
    remainder = x - quotient * U(strata.n);
    auto more = remainder >= U(strata.n);
    quotient = select(more, quotient + U(1u), quotient);
    remainder = select(more, remainder - U(strata.n), remainder);
    return quotient;
}

// Element of a permutation of 0 .. n - 1 (n <= 2^16) that is chosen by `key`: rounds that are one-to-one on the numbers
// of as many bits as n - 1 has, applied until the result is below n (Kensler, "Correlated Multi-Jittered Sampling",
// Pixar Technical Memo 13-01, 2013, section 4), then a rotation, which makes every result equally frequent. The rounds
// are our own: those of the memo leave out most permutations of few elements, and samples that are near each other in
// all dimensions cost more than stratification gains.
template <class U>
TR_INLINE U permute(const U &element, uint32_t n, const U &key) {
    if (n == 1) return U(0u);
    int bits = 1;
    while (bits < 16 && (n - 1) >> bits) ++bits;
    const int half = (bits + 1) / 2;
    const U all((1u << bits) - 1u);
    U rounds[4] = {key * U(0x9e3779b1u), key * U(0x85ebca6bu), key * U(0xc2b2ae35u), key * U(0x27d4eb2fu)};
    for (U &round : rounds) round = round ^ (round >> 15);
    U i = element;
    auto outside = i < U(n);  // all of them, at first
    do {
        U x = i;
        for (const U &round : rounds) {
            x = ((x + (round >> 16)) * (round | U(1u))) & all;
            x = x ^ (x >> half);
        }
        i = select(outside, x, i);
        outside = i >= U(n);
    } while (any(outside));
    i = i + mul_hi(key * U(0xd3833e81u), U(n));
    return select(i >= U(n), i - U(n), i);
}

}  // namespace tr
