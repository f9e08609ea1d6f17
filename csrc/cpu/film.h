// The film: reconstruction filters and the sum of samples into pixels.
//
// A tile of pixels, anchored to the film and not to the crop, sums into its own block; blocks are merged in the order
// of the tiles. The order of all additions is therefore the same for any number of threads and any crop.
#pragma once

#include <cmath>
#include <map>
#include <mutex>
#include <vector>

#include "core/math/lanes.h"

namespace tr {

enum class FilterKind { Box, Tent, Gaussian };

struct Filter {
    FilterKind kind = FilterKind::Box;
    double parameter = 0.5;  // radius of the tent, standard deviation of the Gaussian

    double radius() const {
        return kind == FilterKind::Box ? 0.5 : kind == FilterKind::Tent ? parameter : 4 * parameter;
    }
    // pixels on each side of the sample's own that a sample can reach
    int reach() const { return kind == FilterKind::Box ? 0 : int(std::ceil(radius() - 0.5)); }
    double operator()(double x) const {
        double a = std::fabs(x), r = radius();
        if (kind == FilterKind::Tent) return a < r ? 1 - a / r : 0;
        if (kind == FilterKind::Gaussian) {
            double s = 0.5 / (parameter * parameter);
            return a < r ? std::exp(-s * a * a) - std::exp(-s * r * r) : 0;
        }
        return 1;
    }
};

struct Rect {
    int y0, x0, y1, x1;  // half open
    int height() const { return y1 - y0; }
    int width() const { return x1 - x0; }
    bool contains(int y, int x) const { return y >= y0 && y < y1 && x >= x0 && x < x1; }
};

inline Rect intersect(const Rect &a, const Rect &b) {
    return {std::max(a.y0, b.y0), std::max(a.x0, b.x0), std::min(a.y1, b.y1), std::min(a.x1, b.x1)};
}

// Sums of value channels and of filter weights over a rectangle.
struct FilmBlock {
    Rect rect{0, 0, 0, 0};
    int channels = 0;  // the last one is the weight
    std::vector<double> sum;

    void reset(const Rect &r, int n) {
        rect = r;
        channels = n;
        sum.assign(size_t(std::max(0, r.height())) * size_t(std::max(0, r.width())) * size_t(n), 0.0);
    }
    double *at(int y, int x) {
        return &sum[(size_t(y - rect.y0) * size_t(rect.width()) + size_t(x - rect.x0)) * size_t(channels)];
    }
    const double *at(int y, int x) const { return const_cast<FilmBlock *>(this)->at(y, x); }

    // Adds a sample at film position (y, x) in pixels; `value` has channels - 1 numbers.
    void splat(const Filter &filter, double y, double x, const double *value) {
        int py = int(std::floor(y)), px = int(std::floor(x)), reach = filter.reach(), n = channels;
        if (reach == 0) {
            if (!rect.contains(py, px)) return;
            double *p = at(py, px);
            for (int c = 0; c + 1 < n; ++c) p[c] += value[c];
            p[n - 1] += 1;
            return;
        }
        double wx[64], v[16];
        reach = std::min(reach, 31);
        for (int i = -reach; i <= reach; ++i) wx[i + reach] = filter(px + i + 0.5 - x);
        for (int j = std::max(py - reach, rect.y0); j <= std::min(py + reach, rect.y1 - 1); ++j) {
            double wy = filter(j + 0.5 - y);
            if (wy == 0) continue;
            for (int c = 0; c + 1 < n; ++c) v[c] = value[c] * wy;
            v[n - 1] = wy;
            for (int i = std::max(px - reach, rect.x0); i <= std::min(px + reach, rect.x1 - 1); ++i) {
                double *p = at(j, i), w = wx[i - px + reach];
                for (int c = 0; c < n; ++c) p[c] += w * v[c];
            }
        }
    }

    void add(const FilmBlock &other) {
        Rect r = intersect(rect, other.rect);
        for (int y = r.y0; y < r.y1; ++y) {
            double *to = at(y, r.x0);
            const double *from = other.at(y, r.x0);
            for (size_t i = 0, n = size_t(std::max(0, r.width())) * size_t(channels); i < n; ++i) to[i] += from[i];
        }
    }
};

// Merges the blocks of tiles in their order, whoever finishes first.
class OrderedMerge {
public:
    explicit OrderedMerge(FilmBlock &film) : film_(film) {}

    void push(size_t tile, FilmBlock &&block) {
        std::lock_guard<std::mutex> lock(mutex_);
        waiting_.emplace(tile, std::move(block));
        for (auto it = waiting_.find(next_); it != waiting_.end(); it = waiting_.find(next_)) {
            film_.add(it->second);
            waiting_.erase(it);
            ++next_;
        }
    }

private:
    FilmBlock &film_;
    std::mutex mutex_;
    std::map<size_t, FilmBlock> waiting_;
    size_t next_ = 0;
};

}  // namespace tr
