// Derivatives of geometry on the host: from the scene's tables, which the sweep writes and reads, to the parameters'
// tensors and back. A rectangle's vertices and a sphere's matrix are functions of small parameters (see placement.h).
#include <algorithm>

#include "../core/registry.h"
#include "parallel.h"
#include "placement.h"
#include "scene_data.h"

namespace tr {

template <class S>
void SceneData<S>::fill_geometry(const std::vector<const S *> &tangents, const GeometrySizes &sizes,
                                 GeometryArrays<S> &to) const {
    const std::vector<Record> &records = layout_.records.at("shape");
    size_t n_shapes = shapes_.size(), matrices = n_constants();
    to.constants.resize(matrices + 12 * n_shapes, S(0));
    to.positions.assign(sizes.positions, S(0));
    to.normals.assign(sizes.normals, S(0));
    to.texcoords.assign(sizes.texcoords, S(0));
    for (const MeshSource &mesh : layout_.meshes) {
        auto copy = [&](int slot, size_t columns, std::vector<S> &table) {
            const S *from = slot >= 0 ? tangents[size_t(slot)] : nullptr;
            if (from && !table.empty())
                std::copy_n(from, size_t(mesh.n_vertices) * columns, &table[size_t(mesh.first_vertex) * columns]);
        };
        copy(mesh.vertices, 3, to.positions);
        copy(mesh.normals, 3, to.normals);
        copy(mesh.texcoords, 2, to.texcoords);
        if (const S *radii = mesh.radii >= 0 ? tangents[size_t(mesh.radii)] : nullptr; radii && !to.normals.empty())
            for (size_t i = 0; i < size_t(mesh.n_vertices); ++i)
                to.normals[(size_t(mesh.first_vertex) + i) * 3] = radii[i];
        if (mesh.vertices >= 0 || to.positions.empty()) continue;
        const S *m = &to.constants[size_t(records[size_t(mesh.shape)].field[PlanarFields::ToWorld])];
        for (size_t i = 0; i < 4; ++i)
            for (size_t k = 0; k < 3; ++k)
                to.positions[(size_t(mesh.first_vertex) + i) * 3 + k] =
                    S(m[4 * k] * RectangleCorner[i][0] + m[4 * k + 1] * RectangleCorner[i][1] + m[4 * k + 3]);
    }
    for (size_t i = 0; i < n_shapes; ++i) {
        const int32_t *field = records[i].field;
        if (!(shapes_[i].flags & HasMatrix)) continue;
        const Placement placement = placement_of(shapes_[i], field, constants_.data());
        S *matrix = &to.constants[matrices + 12 * i];
        std::fill_n(matrix, 12, S(0));
        add_product(&to.constants[size_t(field[0])], placement.map, false, matrix);
        double change[12] = {};
        for (int k = 0; k < placement.n; ++k)
            for (int j = 0; j < 12; ++j)
                change[j] += placement.derivative[k][j] * double(to.constants[size_t(placement.offset[k])]);
        add_product(&constants_[size_t(field[0])], change, true, matrix);
    }
}

template <class S>
void SceneData<S>::spread_geometry(GradientSums &sums, const std::vector<S *> &gradients, int threads) const {
    const std::vector<Record> &records = layout_.records.at("shape");
    for (const MeshSource &mesh : layout_.meshes) {
        auto add = [&](int slot, size_t columns, const std::vector<double> &table) {
            S *to = slot >= 0 ? gradients[size_t(slot)] : nullptr;
            if (!to || table.empty()) return;
            const double *from = &table[size_t(mesh.first_vertex) * columns];
            for_ranges(size_t(mesh.n_vertices) * columns, threads, [&](size_t begin, size_t end, int) {
                for (size_t i = begin; i < end; ++i) to[i] += S(from[i]);
            });
        };
        add(mesh.vertices, 3, sums.positions);
        add(mesh.normals, 3, sums.normals);
        add(mesh.texcoords, 2, sums.texcoords);
        if (S *radii = mesh.radii >= 0 ? gradients[size_t(mesh.radii)] : nullptr; radii && !sums.normals.empty())
            for (size_t i = 0; i < size_t(mesh.n_vertices); ++i)
                radii[i] += S(sums.normals[(size_t(mesh.first_vertex) + i) * 3]);
        if (mesh.vertices >= 0 || sums.positions.empty()) continue;
        double *m = &sums.constants[size_t(records[size_t(mesh.shape)].field[PlanarFields::ToWorld])];
        for (size_t i = 0; i < 4; ++i)
            for (size_t k = 0; k < 3; ++k) {
                double g = sums.positions[(size_t(mesh.first_vertex) + i) * 3 + k];
                m[4 * k] += g * RectangleCorner[i][0];
                m[4 * k + 1] += g * RectangleCorner[i][1];
                m[4 * k + 3] += g;
            }
    }
    for (size_t i = 0; i < shapes_.size(); ++i) {
        const int32_t *field = records[i].field;
        if (!(shapes_[i].flags & HasMatrix)) continue;
        const Placement placement = placement_of(shapes_[i], field, constants_.data());
        const double *matrix = &sums.constants[n_constants() + 12 * i];
        const S *now = &constants_[size_t(field[0])];
        double *m = &sums.constants[size_t(field[0])];
        for (int r = 0; r < 3; ++r) {
            m[4 * r + 3] += matrix[4 * r + 3];
            for (int l = 0; l < 3; ++l)
                for (int c = 0; c < 4; ++c) {
                    m[4 * r + l] += matrix[4 * r + c] * placement.map[4 * l + c];
                    for (int k = 0; k < placement.n; ++k)
                        sums.constants[size_t(placement.offset[k])] +=
                            matrix[4 * r + c] * double(now[4 * r + l]) * placement.derivative[k][4 * l + c];
                }
        }
    }
}

#define TR_INSTANTIATE(S)                                                                            \
    template void SceneData<S>::fill_geometry(const std::vector<const S *> &, const GeometrySizes &, \
                                              GeometryArrays<S> &) const;                            \
    template void SceneData<S>::spread_geometry(GradientSums &, const std::vector<S *> &, int) const;
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
