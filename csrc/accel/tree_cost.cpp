#include "tree_cost.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace tr {

namespace {

constexpr size_t Leaf = 8;  // triangles in a box of the lowest level
constexpr size_t Run = 64, MostRuns = 512;

struct Box {
    float lower[3], upper[3];

    Box() {
        std::fill_n(lower, 3, std::numeric_limits<float>::infinity());
        std::fill_n(upper, 3, -std::numeric_limits<float>::infinity());
    }
    void add(const float *p, const float *q) {
        for (int i = 0; i < 3; ++i) {
            lower[i] = std::min(lower[i], p[i]);
            upper[i] = std::max(upper[i], q[i]);
        }
    }
    double area() const {
        double x = double(upper[0]) - lower[0], y = double(upper[1]) - lower[1], z = double(upper[2]) - lower[2];
        return x * y + y * z + z * x;
    }
};

// The bits of a number below 1024, two zeros after each.
uint32_t spread(uint32_t x) {
    x = (x | x << 16) & 0x030000ffu;
    x = (x | x << 8) & 0x0300f00fu;
    x = (x | x << 4) & 0x030c30c3u;
    return (x | x << 2) & 0x09249249u;
}

}  // namespace

void TreeCost::reset(const float *positions, const uint32_t *faces, size_t n_faces) {
    Box all;
    for (size_t i = 0; i < 3 * n_faces; ++i)
        all.add(positions + 3 * size_t(faces[i]), positions + 3 * size_t(faces[i]));
    float scale[3];
    for (int k = 0; k < 3; ++k) {
        float extent = all.upper[k] - all.lower[k];
        float s = extent > 0 && extent < std::numeric_limits<float>::max() ? 1023 / extent : 0;
        scale[k] = std::isfinite(s) ? s : 0;
    }
    std::vector<std::pair<uint32_t, uint32_t>> keys(n_faces);
    for (size_t f = 0; f < n_faces; ++f) {
        uint32_t key = 0;
        for (int k = 0; k < 3; ++k) {
            float centre = 0;
            for (size_t j = 0; j < 3; ++j)
                centre += (positions[3 * size_t(faces[3 * f + j]) + size_t(k)] - all.lower[k]) * scale[k] / 3;
            key |= spread(uint32_t(std::clamp(centre, 0.f, 1023.f))) << k;
        }
        keys[f] = {key, uint32_t(f)};
    }
    std::sort(keys.begin(), keys.end());
    size_t runs = (n_faces + Run - 1) / Run, stride = (runs + MostRuns - 1) / MostRuns;
    faces_.clear();
    for (size_t run = 0; run < runs; run += stride)
        for (size_t i = run * Run; i < std::min((run + 1) * Run, n_faces); ++i)
            faces_.insert(faces_.end(), faces + 3 * size_t(keys[i].second), faces + 3 * size_t(keys[i].second) + 3);
    cost_ = cost(positions);
}

double TreeCost::cost(const float *positions) const {
    std::vector<Box> boxes((faces_.size() / 3 + Leaf - 1) / Leaf);
    for (size_t i = 0; i < faces_.size(); ++i) {
        const float *p = positions + 3 * size_t(faces_[i]);
        boxes[i / (3 * Leaf)].add(p, p);
    }
    double sum = 0;
    while (true) {
        for (const Box &box : boxes) sum += box.area();
        if (boxes.size() <= 1) break;
        for (size_t i = 0; i < boxes.size(); i += 2) {
            Box pair = boxes[i];
            if (i + 1 < boxes.size()) pair.add(boxes[i + 1].lower, boxes[i + 1].upper);
            boxes[i / 2] = pair;
        }
        boxes.resize((boxes.size() + 1) / 2);
    }
    double root = boxes.empty() ? 0 : boxes[0].area();
    return root > 0 ? sum / root : 0;
}

double TreeCost::growth(const float *positions) const {
    double now = cost(positions);
    return cost_ > 0 ? now / cost_ : now > 0 ? std::numeric_limits<double>::infinity() : 1;
}

}  // namespace tr
