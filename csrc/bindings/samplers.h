// Samplers by name, and their numbers for tests.
#pragma once

#include <stdexcept>
#include <string>

#include "core/integrator/config.h"
#include "cpu/arena.h"

namespace tr {

inline SamplerKind sampler_kind(const std::string &name) {
    if (name == "independent") return SamplerKind::Independent;
    if (name == "stratified") return SamplerKind::Stratified;
    if (name == "sobol") return SamplerKind::Sobol;
    throw std::invalid_argument("sampler: expected independent, stratified or sobol, got " + name);
}

// Four numbers of each of n samples, (n, 4), as the renderer draws them.
template <class F>
void draw_numbers(const PathConfig &config, uint32_t block, int numbers, size_t n, const uint32_t *pixels,
                  const uint32_t *samples, double *out) {
    constexpr size_t W = size_t(Lanes<F>::Width);
    const uint32_t wanted = PairWanted | (numbers > 2 ? ThirdWanted : 0u) | (numbers > 3 ? FourthWanted : 0u);
    Arena arena;
    uint32_t *pixel, *sample;
    arena.declare([&](Arena &a) {
        a.array(pixel, n + W);
        a.array(sample, n + W);
    });
    std::copy_n(pixels, n, pixel);
    std::copy_n(samples, n, sample);
    for (size_t i = 0; i < n; i += W) {
        const PathNumbers<F> of(config, load_uint<F>(pixel + i), load_uint<F>(sample + i));
        Random4<F> r = of.draw(block, wanted);
        for (size_t k = 0; k < std::min(W, n - i); ++k)
            for (size_t c = 0; c < 4; ++c) out[4 * (i + k) + c] = double(lane(r.u[c], int(k)));
    }
}

}  // namespace tr
