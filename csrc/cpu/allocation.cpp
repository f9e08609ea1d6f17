#include "allocation.h"

#include <cmath>
#include <cstdlib>
#include <limits>

namespace tr {

namespace {

// The mean of a filter's magnitude over the pixels at distances 0 .. reach along one axis: a sample that counts
// negatively counts no less.
std::vector<double> pixel_weights(const Filter &filter) {
    const int steps = 32;
    std::vector<double> mean(size_t(filter.reach()) + 1, 0.0);
    for (size_t k = 0; k < mean.size(); ++k)
        for (int i = 0; i < steps; ++i) mean[k] += std::fabs(filter(double(k) + (i + 0.5) / steps - 0.5)) / steps;
    return mean;
}

}  // namespace

std::vector<uint32_t> allocate_counts(const std::vector<double> &importance, double total) {
    double sum = 0;
    size_t active = 0;
    for (double q : importance) {
        if (!std::isfinite(q)) return {};
        sum += q;
        active += q > 0;
    }
    if (active == 0 || !std::isfinite(sum)) return {};
    const double floor = AllocationFloor * sum / double(active);
    double raised = 0;
    for (double q : importance) raised += q > 0 ? std::max(q, floor) : 0;
    if (raised == 0) return {};  // so small that they are rounded to zero
    // one each, the rest in proportion to what is wanted above that
    auto above_one = [&](double q) { return q > 0 ? std::max(0.0, total * (std::max(q, floor) / raised) - 1) : 0.0; };
    double above = 0;
    for (double q : importance) above += above_one(q);
    const double rest = total - double(active), scale = above > 0 ? rest / above : 0;
    const double most = double(std::numeric_limits<uint32_t>::max());
    std::vector<uint32_t> counts(importance.size(), 0);
    // the fractions are handed on from pixel to pixel, so that the sum is right
    double end = 0;
    bool equal = true;
    for (size_t i = 0; i < counts.size(); ++i) {
        double begin = end;
        end += above_one(importance[i]) * scale;
        if (importance[i] > 0)
            counts[i] = uint32_t(std::min(most, 1 + std::floor(end + 0.5) - std::floor(begin + 0.5)));
        equal = equal && counts[i] == counts[0];
    }
    return equal ? std::vector<uint32_t>() : counts;
}

std::vector<double> seen_adjoint(const TileSchedule &schedule, const Filter &filter, const Film &adjoint) {
    const std::vector<double> weight = pixel_weights(filter);
    const double least = std::numeric_limits<double>::min();
    const int reach = filter.reach();
    std::vector<double> seen;
    FilmBlock block;
    for (size_t t = 0; t < schedule.n_tiles(); ++t) {
        Tile tile = schedule.tile(t);
        block.reset(tile.reached, 0);
        schedule.for_targets(tile, [&](size_t target, int y, int x) { *block.at(y, x) = *adjoint.at(target); });
        for (size_t p = 0; p < tile.n; ++p) {
            Pixel at = tile.pixel(p);
            Rect around = intersect({at.y - reach, at.x - reach, at.y + reach + 1, at.x + reach + 1}, tile.reached);
            double sum = 0;
            bool any = false;
            for (int y = around.y0; y < around.y1; ++y)
                for (int x = around.x0; x < around.x1; ++x) {
                    double a = *block.at(y, x);
                    any = any || a != 0;
                    sum += a * weight[size_t(std::abs(y - at.y))] * weight[size_t(std::abs(x - at.x))];
                }
            seen.push_back(any ? std::max(sum, least) : 0);
        }
    }
    return seen;
}

}  // namespace tr
