// Boxes of shapes that count for paths: of those that emit, and of those whose BSDFs are differentiated.
#include <algorithm>
#include <array>
#include <cmath>

#include "../core/registry.h"
#include "models.h"
#include "scene_data.h"

namespace tr {

namespace {

// The box of n points, a little larger than what rounding may shift, behind the others: least coordinates, then
// largest.
template <class B, class Point>
void add_box(std::vector<B> &boxes, int n, Point &&point) {
    double low[3], high[3], size = 0;
    for (int i = 0; i < n; ++i) {
        const std::array<double, 3> p = point(i);
        for (size_t k = 0; k < 3; ++k) {
            low[k] = i == 0 ? p[k] : std::min(low[k], p[k]);
            high[k] = i == 0 ? p[k] : std::max(high[k], p[k]);
        }
    }
    for (int k = 0; k < 3; ++k) size = std::max({size, std::abs(low[k]), std::abs(high[k])});
    for (double *corner : {low, high})
        for (int k = 0; k < 3; ++k) boxes.push_back(B(corner[k] + (corner == low ? -1e-4 : 1e-4) * size));
}

}  // namespace

// Adds the box of a shape. False: it has more vertices than are to be looked at, or no box that is known.
template <class S>
template <class B>
bool SceneData<S>::add_shape_box(size_t shape, int most_vertices, std::vector<B> &boxes) const {
    const int32_t flags = shapes_[shape].flags;
    if (flags & (IsHeightField | IsSdfGrid | IsCurve)) return false;
    if (flags & IsCurved) {
        const S *m = &matrices_[24 * shape];
        add_box(boxes, 8, [&](int c) {  // corners of the unit cube
            std::array<double, 3> p;
            for (size_t r = 0; r < 3; ++r)
                p[r] = double(m[4 * r]) * (c & 1 ? 1 : -1) + double(m[4 * r + 1]) * (c & 2 ? 1 : -1) +
                       double(m[4 * r + 2]) * (c & 4 ? 1 : -1) + double(m[4 * r + 3]);
            return p;
        });
        return true;
    }
    for (const MeshSource &mesh : layout_.meshes) {
        if (size_t(mesh.shape) != shape) continue;
        if (mesh.n_vertices > most_vertices) return false;
        add_box(boxes, mesh.n_vertices, [&](int v) {
            const S *p = vertices_[size_t(mesh.first_vertex + v)].p;
            return std::array<double, 3>{double(p[0]), double(p[1]), double(p[2])};
        });
        return true;
    }
    return false;
}

// A ray that meets none of these boxes meets no light.
template <class S>
void SceneData<S>::update_light_boxes() {
    constexpr size_t Most = 8;
    n_light_boxes_ = -1;
    light_boxes_.clear();
    if (layout_.environment >= 0) return;
    for (size_t i = 0; i < shapes_.size(); ++i) {
        if (shapes_[i].emitter < 0) continue;
        if (light_boxes_.size() == 6 * Most || !add_shape_box(i, 4096, light_boxes_)) return;
    }
    n_light_boxes_ = int(light_boxes_.size() / 6);
}

template <class S>
std::optional<std::vector<float>> SceneData<S>::boxes_with(const std::vector<int32_t> &bsdfs) const {
    constexpr size_t Most = 4;
    const std::vector<Record> &records = layout_.records.at("bsdf");
    std::vector<uint8_t> with(records.size(), 0);
    for (int depth = 0; depth <= MaxBsdfDepth; ++depth)
        for (size_t i = 0; i < records.size(); ++i) {
            with[i] |= bsdfs[i] != 0;
            const Model &model = model_of("bsdf", records[i]);
            for (int f = 0; f < model.n_fields; ++f) {
                const int32_t nested = records[i].field[f];
                if (model.fields[f].kind == Kind::Bsdf && nested >= 0) with[i] |= with[size_t(nested)];
            }
        }
    std::vector<float> boxes;
    for (size_t i = 0; i < shapes_.size(); ++i) {
        if (shapes_[i].bsdf < 0 || !with[size_t(shapes_[i].bsdf)]) continue;
        if (boxes.size() == 6 * Most || !add_shape_box(i, 65536, boxes)) return std::nullopt;
    }
    return boxes;
}

#define TR_INSTANTIATE(S)                             \
    template void SceneData<S>::update_light_boxes(); \
    template std::optional<std::vector<float>> SceneData<S>::boxes_with(const std::vector<int32_t> &) const;
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
