#include "bend_blocks.h"

#include <algorithm>
#include <cmath>

#include "placement.h"
#include "values.h"

namespace tr {

namespace {

using Point = Vec3<double>;

Affine product(const double *a, const double *b) {
    Affine r{};
    add_product(a, b, false, r.m);
    return r;
}

constexpr double Side = 1 << BendBlocks::Bits;

}  // namespace

struct BendBlocks::Box {
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    void include(const Point &p) {
        const double x[3] = {p.x, p.y, p.z};
        for (size_t k = 0; k < 3; ++k) low[k] = std::min(low[k], x[k]), high[k] = std::max(high[k], x[k]);
    }
};

template <class S>
BendBlocks::BendBlocks(const SceneView<S> &scene, const int32_t (&n)[3], const S *to_world, double reach)
    : reach_(reach) {
    size_t blocks = 1;
    for (size_t k = 0; k < 3; ++k) blocks *= size_t(n_[k] = (n[k] + (1 << Bits) - 1) >> Bits);
    words_.assign(blocks / 32 + 1, 0);
    Affine from_voxels;
    std::copy_n(to_world, 12, from_voxels.m);
    const Affine to_voxels = from_voxels.inverse("to_world");
    const auto *rows = reinterpret_cast<const VertexRow<S> *>(scene.vertices);
    auto vertex = [&](uint32_t i) {
        const S(&p)[3] = rows[i].p;
        return transform_point(to_voxels.m, Point{double(p[0]), double(p[1]), double(p[2])});
    };
    for (int32_t s = 0; s < scene.n_shapes; ++s) {
        const ShapeInfo &shape = scene.shapes[s];
        double matrix[24];
        std::copy_n(scene.shape_matrices + 24 * s, 24, matrix);
        if (!(shape.flags & IsCurved)) {
            for (int32_t f = 0; f < shape.n_faces; ++f) {
                const uint32_t *face = scene.faces + 3 * size_t(shape.face_offset + f);
                mark_triangle(vertex(face[0]), vertex(face[1]), vertex(face[2]));
            }
        } else if (shape.flags & IsSphere) {
            mark_sphere(product(matrix + 12, from_voxels.m));
        } else if (shape.flags & (IsDisk | IsCylinder | IsSdfGrid)) {
            const double low = shape.flags & IsSdfGrid ? 0 : -1, top = shape.flags & IsDisk ? 0 : 1;
            const Affine from_object = product(to_voxels.m, matrix);
            Box box;
            for (int i = 0; i < 8; ++i)
                box.include(
                    transform_point(from_object.m, Point{i & 1 ? 1. : low, i & 2 ? 1. : low, i & 4 ? top : 0.}));
            mark(box, [](const Point &) { return true; });
        } else {  // of any size: anywhere
            std::fill(words_.begin(), words_.end(), ~0u);
        }
    }
}

// Blocks of a box, as far as keep(their middle) says so.
template <class Keep>
void BendBlocks::mark(const Box &box, Keep &&keep) {
    int64_t from[3], to[3];
    for (size_t k = 0; k < 3; ++k) {
        if (!(box.low[k] <= box.high[k])) return;
        const double first = std::floor((box.low[k] - reach_) / Side), last = std::floor((box.high[k] + reach_) / Side);
        from[k] = int64_t(std::clamp(first, 0.0, double(n_[k])));
        to[k] = int64_t(std::clamp(last, -1.0, double(n_[k] - 1)));
    }
    for (int64_t z = from[2]; z <= to[2]; ++z)
        for (int64_t y = from[1]; y <= to[1]; ++y)
            for (int64_t x = from[0]; x <= to[0]; ++x) {
                if (!keep(Point{double(x) + 0.5, double(y) + 0.5, double(z) + 0.5} * Side)) continue;
                const size_t i = size_t((z * n_[1] + y) * n_[0] + x);
                words_[i / 32] |= 1u << (i % 32);
            }
}

// Of its box those that its plane comes close to.
void BendBlocks::mark_triangle(const Point &a, const Point &b, const Point &c) {
    Box box;
    box.include(a), box.include(b), box.include(c);
    const Point normal = cross(b - a, c - a);
    const double extent = Side / 2 + reach_,
                 margin = extent * (std::abs(normal.x) + std::abs(normal.y) + std::abs(normal.z));
    mark(box, [&](const Point &middle) { return std::abs(dot(middle - a, normal)) <= margin * 1.001; });
}

// The unit sphere after `to_object`: blocks between two spheres around it.
void BendBlocks::mark_sphere(const Affine &to_object) {
    const Affine back = to_object.inverse("to_world");
    Box box;
    double largest = 0;  // the length of a voxel's diagonal, at most
    for (int k = 0; k < 3; ++k) {
        const double extent = std::hypot(back.m[4 * k], back.m[4 * k + 1], back.m[4 * k + 2]);
        box.low[k] = back.m[4 * k + 3] - extent, box.high[k] = back.m[4 * k + 3] + extent;
        largest += to_object.column_norm(k);
    }
    const double margin = largest * (Side / 2 + reach_);
    mark(box, [&](const Point &middle) { return std::abs(norm(transform_point(to_object.m, middle)) - 1) <= margin; });
}

template BendBlocks::BendBlocks(const SceneView<float> &, const int32_t (&)[3], const float *, double);
template BendBlocks::BendBlocks(const SceneView<double> &, const int32_t (&)[3], const double *, double);

}  // namespace tr
