// Counter-based random numbers: Philox4x32 with 7 rounds (Salmon et al., "Parallel Random Numbers: As Easy as 1, 2, 3",
// SC 2011; 7 rounds pass BigCrush there). Keyed by the seed; counted by (pixel, sample, sensor and dimension block), so
// a number depends on nothing else: no thread, no tile, no lane.
#pragma once

#include "lanes.h"

namespace tr {

template <class F>
struct Random4 {
    F u[4];  // in [0, 1), multiples of 2^-24: the same numbers in single and double precision
};

template <class U>
TR_INLINE void philox(U (&c)[4], uint32_t k0, uint32_t k1) {
    const U m0(0xD2511F53u), m1(0xCD9E8D57u);
    for (int round = 0; round < 7; ++round) {
        U hi0 = mul_hi(m0, c[0]), lo0 = m0 * c[0], hi1 = mul_hi(m1, c[2]), lo1 = m1 * c[2];
        c[0] = hi1 ^ c[1] ^ U(k0);
        c[1] = lo1;
        c[2] = hi0 ^ c[3] ^ U(k1);
        c[3] = lo0;
        k0 += 0x9E3779B9u;
        k1 += 0xBB67AE85u;
    }
}

// `block` counts groups of four dimensions along a path: 0 is the camera's, see integrator/path.h.
template <class F>
struct RandomBits4 {
    UIntOf<F> bits[4];
};
template <class F>
TR_INLINE RandomBits4<F> random_bits4(uint64_t seed, uint32_t sensor, const UIntOf<F> &pixel, const UIntOf<F> &sample,
                                      const UIntOf<F> &block) {
    using U = UIntOf<F>;
    RandomBits4<F> r{{pixel, sample, block, U(sensor)}};
    philox(r.bits, uint32_t(seed), uint32_t(seed >> 32));
    return r;
}
// In [0, 1), from the upper 24 bits.
template <class F>
TR_INLINE F uniform_of(const UIntOf<F> &bits) {
    return convert<F>(convert<IntOf<F>>(bits >> 8)) * F(1.0 / 16777216.0);
}

template <class F>
TR_INLINE Random4<F> random4(uint64_t seed, uint32_t sensor, UIntOf<F> pixel, UIntOf<F> sample, uint32_t block) {
    auto [c] = random_bits4<F>(seed, sensor, pixel, sample, UIntOf<F>(block));
    Random4<F> r;
    for (int i = 0; i < 4; ++i) r.u[i] = uniform_of<F>(c[i]);
    return r;
}

}  // namespace tr
