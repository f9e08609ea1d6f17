// How many samples of the derivative each pixel gets: in proportion to the adjoint that they see.
//
// The variance of a gradient sum_i a_i D_i, with independent estimates D_i of n_i samples each, is
// sum_i a_i^2 s_i^2 / n_i: for a given sum of n_i it is least with n_i in proportion to |a_i| s_i (Neyman's
// allocation). The deviations s_i are unknown, so every pixel keeps a floor.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "tile_schedule.h"

namespace tr {

// Of the mean over all pixels that have samples at all: pixels below are treated as if they were there.
constexpr double AllocationFloor = 0.25;

// Whole numbers in proportion to `importance` (with the floor) that add up to `total`, which is at least their number:
// at least 1 where it is positive, 0 elsewhere. Deterministic. Empty if all are equal, or if one is not finite.
std::vector<uint32_t> allocate_counts(const std::vector<double> &importance, double total);

// What samples can see, for every sampled pixel in the order of TileSchedule::allocate: the sum of `adjoint`, one
// number a wanted pixel, weighted by the filter's mean over the sampled pixel. Positive wherever a filter may reach a
// positive one.
std::vector<double> seen_adjoint(const TileSchedule &schedule, const Filter &filter, const Film &adjoint);

// Allocates the schedule's spp times the number of its sampled pixels by d loss / d image, (results, channels).
template <class S>
void allocate(TileSchedule &schedule, const Filter &filter, const S *adjoint, int channels) {
    Film sum(schedule, channels), size(schedule, 1);
    for (size_t i = 0; i < schedule.n_results(); ++i)
        for (int c = 0; c < channels; ++c)
            sum.at(schedule.target_of(i))[c] += double(adjoint[i * size_t(channels) + size_t(c)]);
    for (size_t i = 0; i < schedule.n_targets(); ++i)
        for (int c = 0; c < channels; ++c) *size.at(i) += std::fabs(sum.at(i)[c]);
    std::vector<double> seen = seen_adjoint(schedule, filter, size);
    std::vector<uint32_t> counts = allocate_counts(seen, double(schedule.spp()) * double(seen.size()));
    if (!counts.empty()) schedule.allocate(std::move(counts));
}

}  // namespace tr
