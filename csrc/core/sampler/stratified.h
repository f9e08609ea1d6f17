// Jittered numbers: of the n samples of a pixel each takes one of n strata. In two dimensions these are the rows of a
// grid's cells and what a row is divided into, in one of them, while the other one has the grid's columns ("correlated
// multi-jittered" for any n: Kensler, Pixar Technical Memo 13-01, 2013, section 5). Which sample takes which stratum is
// permuted anew for every pixel, block and seed.
#pragma once

#include "../math/philox.h"
#include "config.h"

namespace tr {

// A pair, a number that is stratified by itself (not a number unless it is wanted), and one that is not. With one
// sample a pixel they are those of `random4`.
template <class F>
TR_NOINLINE Random4<F> stratified4(const SamplerConfig &sampler, uint64_t seed, uint32_t sensor, const UIntOf<F> &pixel,
                                   const UIntOf<F> &sample, uint32_t block, uint32_t wanted) {
    using U = UIntOf<F>;
    uint32_t k0 = uint32_t(seed), k1 = uint32_t(seed >> 32);
    U within;
    divide(sampler.all, U(sample - U(sampler.first)), within);
    U jitter[4] = {pixel, sample, U(block), U(sensor)};
    philox(jitter, k0, k1);
    U key[4] = {pixel, sample - within, U(block | KeyBlocks), U(sensor)};
    philox(key, k0, k1);
    U stratum = permute(within, sampler.all.n, key[0]), column;
    U row = divide(sampler.columns, stratum, column);
    U x_jitter = place(sampler.rows, permute(row, sampler.rows.n, key[1]), jitter[0]);
    U x = place(sampler.columns, permute(column, sampler.columns.n, key[2]), x_jitter);
    U y = place(sampler.all, stratum, jitter[1]);
    Random4<F> r{{unit_number<F>(x), unit_number<F>(y), F(NAN), unit_number<F>(jitter[3])}};
    if (wanted & ThirdWanted)
        r.u[2] = unit_number<F>(place(sampler.all, permute(within, sampler.all.n, key[3]), jitter[2]));
    return r;
}

#define TR_ELSEWHERE(S)                                                                                      \
    extern template Random4<PacketOf<S>> stratified4<PacketOf<S>>(const SamplerConfig &, uint64_t, uint32_t, \
                                                                  const UIntOf<PacketOf<S>> &,               \
                                                                  const UIntOf<PacketOf<S>> &, uint32_t, uint32_t);
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
