#include "bend_blocks.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace tr {

namespace {

using Point = std::array<double, 3>;

Point minus(const Point &a, const Point &b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Point product(const Point &a, const Point &b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
double inner(const Point &a, const Point &b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

struct Map {
    double m[12];
    template <class S>
    explicit Map(const S *from) {
        std::copy_n(from, 12, m);
    }
    Point operator()(const Point &p) const {
        Point r;
        for (size_t i = 0; i < 3; ++i)
            r[i] = m[4 * i] * p[0] + m[4 * i + 1] * p[1] + m[4 * i + 2] * p[2] + m[4 * i + 3];
        return r;
    }
    Map inverse() const {
        const Point a{m[0], m[4], m[8]}, b{m[1], m[5], m[9]}, c{m[2], m[6], m[10]}, t{m[3], m[7], m[11]};
        const double determinant = inner(a, product(b, c));
        const Point rows[3] = {product(b, c), product(c, a), product(a, b)};
        Map r(m);
        for (size_t i = 0; i < 3; ++i) {
            for (size_t k = 0; k < 3; ++k) r.m[4 * i + k] = rows[i][k] / determinant;
            r.m[4 * i + 3] = -inner(rows[i], t) / determinant;
        }
        return r;
    }
    // This map after another one.
    Map after(const Map &first) const {
        Map r(m);
        for (size_t i = 0; i < 3; ++i)
            for (size_t k = 0; k < 4; ++k)
                r.m[4 * i + k] = m[4 * i] * first.m[k] + m[4 * i + 1] * first.m[4 + k] + m[4 * i + 2] * first.m[8 + k] +
                                 (k == 3 ? m[4 * i + 3] : 0);
        return r;
    }
};

constexpr double Side = 1 << BendBlocks::Bits;

}  // namespace

template <class S>
BendBlocks::BendBlocks(const SceneView<S> &scene, const int32_t (&n)[3], const S *to_world, double reach)
    : reach_(reach) {
    size_t blocks = 1;
    for (size_t k = 0; k < 3; ++k) blocks *= size_t(n_[k] = (n[k] + (1 << Bits) - 1) >> Bits);
    words_.assign(blocks / 32 + 1, 0);
    const Map to_voxels = Map(to_world).inverse();
    const auto *rows = reinterpret_cast<const VertexRow<S> *>(scene.vertices);
    auto vertex = [&](uint32_t i) {
        return to_voxels({double(rows[i].p[0]), double(rows[i].p[1]), double(rows[i].p[2])});
    };
    for (int32_t s = 0; s < scene.n_shapes; ++s) {
        const ShapeInfo &shape = scene.shapes[s];
        const S *matrix = scene.shape_matrices + 24 * s;
        if (!(shape.flags & IsCurved)) {
            for (int32_t f = 0; f < shape.n_faces; ++f) {
                const uint32_t *face = scene.faces + 3 * size_t(shape.face_offset + f);
                mark_triangle(vertex(face[0]), vertex(face[1]), vertex(face[2]));
            }
            continue;
        }
        if (shape.flags & IsSphere) {
            const Map to_object = Map(matrix + 12).after(Map(to_world));
            mark_sphere(to_object.m);
            continue;
        }
        Point corners[8];
        const bool unit = !(shape.flags & (IsDisk | IsCylinder | IsSdfGrid));
        if (unit || (shape.flags & IsHeightField)) {  // of any size: anywhere
            for (uint32_t i = 0; i < 8; ++i)
                for (size_t k = 0; k < 3; ++k) corners[i][k] = i >> k & 1 ? n[k] : 0;
            mark_box(corners, 8);
            continue;
        }
        const Map from_object = to_voxels.after(Map(matrix));
        const bool disk = shape.flags & IsDisk, grid = shape.flags & IsSdfGrid;
        for (uint32_t i = 0; i < 8; ++i)
            corners[i] = from_object({i & 1  ? 1.
                                      : grid ? 0.
                                             : -1.,
                                      i & 2  ? 1.
                                      : grid ? 0.
                                             : -1.,
                                      i & 4 && !disk ? 1. : 0.});
        mark_box(corners, 8);
    }
}

// Blocks between two corners of a box, as far as keep(lower corner of the block) says so.
template <class Keep>
void BendBlocks::mark(const Point &low, const Point &high, Keep &&keep) {
    int64_t from[3], to[3];
    for (size_t k = 0; k < 3; ++k) {
        if (!(low[k] <= high[k])) return;
        const double first = std::floor((low[k] - reach_) / Side), last = std::floor((high[k] + reach_) / Side);
        from[k] = int64_t(std::clamp(first, 0.0, double(n_[k])));
        to[k] = int64_t(std::clamp(last, -1.0, double(n_[k] - 1)));
    }
    for (int64_t z = from[2]; z <= to[2]; ++z)
        for (int64_t y = from[1]; y <= to[1]; ++y)
            for (int64_t x = from[0]; x <= to[0]; ++x) {
                if (!keep(Point{double(x) * Side, double(y) * Side, double(z) * Side})) continue;
                const size_t i = size_t((z * n_[1] + y) * n_[0] + x);
                words_[i / 32] |= 1u << (i % 32);
            }
}

void BendBlocks::mark_box(const Point *corners, size_t n) {
    Point low = corners[0], high = low;
    for (size_t i = 1; i < n; ++i)
        for (size_t k = 0; k < 3; ++k)
            low[k] = std::min(low[k], corners[i][k]), high[k] = std::max(high[k], corners[i][k]);
    mark(low, high, [](const Point &) { return true; });
}

// Of its box those that its plane comes close to.
void BendBlocks::mark_triangle(const Point &a, const Point &b, const Point &c) {
    Point low, high;
    for (size_t k = 0; k < 3; ++k) low[k] = std::min({a[k], b[k], c[k]}), high[k] = std::max({a[k], b[k], c[k]});
    const Point normal = product(minus(b, a), minus(c, a));
    const double extent = Side / 2 + reach_,
                 margin = extent * (std::abs(normal[0]) + std::abs(normal[1]) + std::abs(normal[2]));
    mark(low, high, [&](const Point &block) {
        const Point center{block[0] + Side / 2, block[1] + Side / 2, block[2] + Side / 2};
        return std::abs(inner(minus(center, a), normal)) <= margin * 1.001;
    });
}

// The unit sphere after `to_object`: blocks between two spheres around it.
void BendBlocks::mark_sphere(const double (&to_object)[12]) {
    const Map map(to_object), back = map.inverse();
    Point low, high;
    double largest = 0;  // the length of a voxel's diagonal, at most
    for (size_t k = 0; k < 3; ++k) {
        const double extent = std::hypot(back.m[4 * k], back.m[4 * k + 1], back.m[4 * k + 2]);
        low[k] = back.m[4 * k + 3] - extent, high[k] = back.m[4 * k + 3] + extent;
        largest += std::hypot(map.m[k], map.m[4 + k], map.m[8 + k]);
    }
    const double margin = largest * (Side / 2 + reach_);
    mark(low, high, [&](const Point &block) {
        const Point p = map({block[0] + Side / 2, block[1] + Side / 2, block[2] + Side / 2});
        return std::abs(std::sqrt(inner(p, p)) - 1) <= margin;
    });
}

template BendBlocks::BendBlocks(const SceneView<float> &, const int32_t (&)[3], const float *, double);
template BendBlocks::BendBlocks(const SceneView<double> &, const int32_t (&)[3], const double *, double);

}  // namespace tr
