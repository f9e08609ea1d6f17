// The geometry of a scene: the renderer's tables, areas of lights, and what Embree gets.
#include <algorithm>
#include <atomic>

#include "../accel/sdf_grid.h"
#include "../core/registry.h"
#include "placement.h"
#include "scene_data.h"

namespace tr {

namespace {

constexpr double LargestCoordinate = 1e18;  // its square is still finite in single precision

std::atomic<uint64_t> geometry_versions{0};  // of scenes of both precisions

}  // namespace

// `old`: the constants before this update; `first`: they do not count.
template <class S>
void SceneData<S>::update_shapes(const std::vector<const S *> &params, const std::vector<uint8_t> &dirty,
                                 const std::vector<S> &old, bool first) {
    const std::vector<Record> &records = layout_.records.at("shape");
    auto changed = [&](int32_t offset, int n) {
        return first || !std::equal(&constants_[size_t(offset)], &constants_[size_t(offset)] + n, &old[size_t(offset)]);
    };
    bool rebuild = first, moves = false;  // what Embree keeps, and what it asks for
    for (const MeshSource &mesh : layout_.meshes) {
        if (mesh.radii >= 0) {
            rebuild |= update_curve(mesh, params, dirty, first);
        } else if (mesh.vertices >= 0) {
            rebuild |= update_mesh(mesh, params, dirty, first);
        } else if (changed(records[size_t(mesh.shape)].field[PlanarFields::ToWorld], 12)) {
            update_rectangle(mesh, first);
            rebuild = true;
        }
    }
    for (int i = 0; i < int(shapes_.size()); ++i) {
        const int32_t *field = records[size_t(i)].field;
        bool moved = false;
        if (shapes_[size_t(i)].flags & (IsHeightField | IsSdfGrid)) {
            const bool grid = shapes_[size_t(i)].flags & IsSdfGrid;
            const size_t slot = size_t(shapes_[size_t(i)].heights);
            const bool differs = first || dirty[slot],
                       placed = changed(field[grid ? SdfGridModel::ToWorld : HeightFieldModel::ToWorld], 12);
            if (grid)
                update_sdf_grid(i, params[slot], differs, placed);
            else
                update_heights(i, params[slot], differs, placed);
            moves |= differs || placed;
            continue;
        }
        if (shapes_[size_t(i)].flags & IsSphere)
            moved = changed(field[SphereModel::ToWorld], 12) || changed(field[SphereModel::Center], 3) ||
                    changed(field[SphereModel::Radius], 1);
        if (shapes_[size_t(i)].flags & IsCylinder)
            moved = changed(field[CylinderModel::ToWorld], 12) || changed(field[CylinderModel::P0], 3) ||
                    changed(field[CylinderModel::P1], 3) || changed(field[CylinderModel::Radius], 1);
        if (shapes_[size_t(i)].flags & IsDisk) moved = changed(field[PlanarFields::ToWorld], 12);
        if (!moved) continue;
        update_quadric(i);
        rebuild = true;
    }
    // (of a scene that has taken over another one's shapes it is 0)
    if (rebuild || moves || geometry_version_ == 0) geometry_version_ = ++geometry_versions;
    if (rebuild) accel_->commit(rebuilt_);
}

// Returns whether the mesh moved. `first`: what is stored does not count.
template <class S>
bool SceneData<S>::update_mesh(const MeshSource &mesh, const std::vector<const S *> &params,
                               const std::vector<uint8_t> &dirty, bool first) {
    VertexRow<S> *rows = &vertices_[size_t(mesh.first_vertex)];
    auto copy = [&](int slot, auto column) {
        if (slot < 0 || !dirty[size_t(slot)]) return;
        const S *from = params[size_t(slot)];
        for (int32_t i = 0; i < mesh.n_vertices; ++i)
            for (S &x : rows[i].*column) x = *from++;
    };
    copy(mesh.normals, &VertexRow<S>::n);
    copy(mesh.texcoords, &VertexRow<S>::uv);
    if (!dirty[size_t(mesh.vertices)]) return false;
    const S *from = params[size_t(mesh.vertices)];
    const size_t n = size_t(mesh.n_vertices) * 3;
    // written to, but with the numbers that were there already
    if (!first && same_rows(mesh, &VertexRow<S>::p, from, 0, mesh.n_vertices)) return false;
    for (size_t i = 0; i < n; ++i)
        if (!(std::abs(from[i]) <= S(LargestCoordinate)))
            bad_value(path("shape", mesh.shape) + ": field 'vertices'", "coordinates up to 1e18",
                      std::to_string(from[i]));
    copy(mesh.vertices, &VertexRow<S>::p);
    set_mesh(mesh, from, first);
    return true;
}

// Returns whether the curve changed.
template <class S>
bool SceneData<S>::update_curve(const MeshSource &curve, const std::vector<const S *> &params,
                                const std::vector<uint8_t> &dirty, bool first) {
    const S *points = params[size_t(curve.vertices)], *radii = params[size_t(curve.radii)];
    if (!dirty[size_t(curve.vertices)] && !dirty[size_t(curve.radii)]) return false;
    const size_t n = size_t(curve.n_vertices);
    if (!first && same_rows(curve, &VertexRow<S>::p, points, 0, curve.n_vertices) && same_radii(curve, radii))
        return false;
    std::vector<float> single(4 * n);
    for (size_t i = 0; i < n; ++i) {
        for (size_t k = 0; k < 3; ++k) {
            if (!(std::abs(points[3 * i + k]) <= S(LargestCoordinate)))
                bad_value(path("shape", curve.shape) + ": field 'control_points'", "coordinates up to 1e18",
                          std::to_string(points[3 * i + k]));
            single[4 * i + k] = float(points[3 * i + k]);
        }
        if (!(radii[i] >= 0 && radii[i] <= S(LargestCoordinate)))
            bad_value(path("shape", curve.shape) + ": field 'radii'", "numbers that are not negative",
                      std::to_string(radii[i]));
        single[4 * i + 3] = float(radii[i]);
    }
    VertexRow<S> *rows = &vertices_[size_t(curve.first_vertex)];
    for (size_t i = 0; i < n; ++i) {
        std::copy_n(points + 3 * i, 3, rows[i].p);
        rows[i].n[0] = radii[i];
    }
    const ShapeInfo &info = shapes_[size_t(curve.shape)];
    std::vector<uint32_t> segments(size_t(info.n_faces));
    for (size_t k = 0; k < segments.size(); ++k)
        segments[k] = layout_.faces[(size_t(info.face_offset) + k) * 3] - uint32_t(curve.first_vertex);
    accel_->set_curve(uint32_t(curve.shape), single.data(), n, segments.data(), segments.size(),
                      info.flags & IsStraight);
    ++counters_.meshes;
    return true;
}

// Area, its distribution over the faces of a light, and Embree's copy of a mesh with positions p (n_vertices, 3).
template <class S>
void SceneData<S>::set_mesh(const MeshSource &mesh, const S *p, bool first) {
    const ShapeInfo &info = shapes_[size_t(mesh.shape)];
    size_t n_faces = size_t(info.n_faces);
    const uint32_t *global = &layout_.faces[size_t(info.face_offset) * 3];
    std::vector<uint32_t> faces;  // counted from the mesh's first vertex
    if (first || info.emitter >= 0) {
        faces.resize(n_faces * 3);
        for (size_t i = 0; i < faces.size(); ++i) faces[i] = global[i] - uint32_t(mesh.first_vertex);
    }

    if (info.emitter >= 0) {
        std::vector<double> areas(n_faces);
        for (size_t f = 0; f < n_faces; ++f) {
            double e1[3], e2[3];
            for (size_t k = 0; k < 3; ++k) {
                e1[k] = double(p[faces[3 * f + 1] * 3 + k]) - double(p[faces[3 * f] * 3 + k]);
                e2[k] = double(p[faces[3 * f + 2] * 3 + k]) - double(p[faces[3 * f] * 3 + k]);
            }
            areas[f] = 0.5 * std::hypot(e1[1] * e2[2] - e1[2] * e2[1], e1[2] * e2[0] - e1[0] * e2[2],
                                        e1[0] * e2[1] - e1[1] * e2[0]);
        }
        double total = build_cdf(areas.data(), n_faces, &area_cdf_[size_t(info.cdf_offset)]);
        // Without an area nothing arrives from it: its faces have no side that a point could be on. Any positive number
        // keeps densities finite, see update_emitters.
        dark_[size_t(mesh.shape)] = !(S(total) > 0);
        areas_[size_t(mesh.shape)] = S(total) > 0 ? S(total) : S(1);
    }
    const uint32_t *given = first ? faces.data() : nullptr;
    if constexpr (sizeof(S) == 4) {
        accel_->set_mesh(uint32_t(mesh.shape), p, size_t(mesh.n_vertices), given, n_faces);
    } else {
        std::vector<float> single(p, p + size_t(mesh.n_vertices) * 3);
        accel_->set_mesh(uint32_t(mesh.shape), single.data(), size_t(mesh.n_vertices), given, n_faces);
    }
    ++counters_.meshes;
}

// The map from the unit shape to the world, and its inverse, into the table.
template <class S>
Affine SceneData<S>::set_matrices(int shape) {
    const int32_t *field = layout_.records.at("shape")[size_t(shape)].field;
    const ShapeInfo &info = shapes_[size_t(shape)];
    auto where = [&](const char *name) { return path("shape", shape) + ": field '" + name + "'"; };
    auto require_positive = [&](int32_t offset) {
        double radius = double(constants_[size_t(offset)]);
        if (!(radius > 0)) bad_value(where("radius"), "a positive number", std::to_string(radius));
    };
    if (info.flags & IsSphere) require_positive(field[SphereModel::Radius]);
    if (info.flags & IsCylinder) {
        require_positive(field[CylinderModel::Radius]);
        const S *p0 = &constants_[size_t(field[CylinderModel::P0])],
                *p1 = &constants_[size_t(field[CylinderModel::P1])];
        if (std::equal(p0, p0 + 3, p1)) bad_value(where("p1"), "a point apart from p0", "the same point");
    }
    const Placement placement = placement_of(info, field, constants_.data());
    Affine to_world{};
    add_product(&constants_[size_t(field[0])], placement.map, false, to_world.m);
    if (info.flags & (IsSphere | IsCylinder)) {
        // all axes of a sphere are as long, two of a cylinder's, and they are orthogonal
        const bool sphere = info.flags & IsSphere;
        auto length = [&](int j) { return to_world.column_norm(j); };
        const double l = length(0);
        bool round = std::abs(length(1) - l) <= 5e-4 * l && (!sphere || std::abs(length(2) - l) <= 5e-4 * l);
        for (int j = 0; j < 3; ++j) {
            int k = (j + 1) % 3;
            round &= std::abs(to_world.column_dot(j, k)) <= 1e-3 * length(j) * length(k);
        }
        if (!round)
            bad_value(where("to_world"),
                      sphere ? "a rotation, translation and uniform scale"
                             : "a rotation, a translation and a scale that leaves the cylinder round and right",
                      sphere ? "a matrix that makes an ellipsoid of the sphere"
                             : "a matrix that makes its sections ellipses, or slanted");
    }
    for (double x : to_world.m)
        if (!(std::abs(x) <= LargestCoordinate))
            bad_value(where("to_world"), "coordinates up to 1e18", std::to_string(x));
    Affine to_object = to_world.inverse(where("to_world"));
    std::copy_n(to_world.m, 12, &matrices_[size_t(shape) * 24]);
    std::copy_n(to_object.m, 12, &matrices_[size_t(shape) * 24 + 12]);
    return to_world;
}

template <class S>
void SceneData<S>::update_rectangle(const MeshSource &mesh, bool first) {
    Affine to_world = set_matrices(mesh.shape);
    const double *m = to_world.m;
    S positions[12];
    for (size_t i = 0; i < 4; ++i) {
        VertexRow<S> &row = vertices_[size_t(mesh.first_vertex) + i];
        for (size_t k = 0; k < 3; ++k)
            row.p[k] = positions[3 * i + k] =
                S(m[4 * k] * RectangleCorner[i][0] + m[4 * k + 1] * RectangleCorner[i][1] + m[4 * k + 3]);
        for (size_t k = 0; k < 2; ++k) row.uv[k] = S((RectangleCorner[i][k] + 1) / 2);
    }
    // mirroring turns the faces round, but not the normal that is transformed with the shape
    ShapeInfo &info = shapes_[size_t(mesh.shape)];
    info.flags = layout_.shapes[size_t(mesh.shape)].flags ^ (to_world.determinant() < 0 ? FlipNormals : 0);
    set_mesh(mesh, positions, first);
}

template <class S>
void SceneData<S>::update_quadric(int shape) {
    Affine to_world = set_matrices(shape);
    ShapeInfo &info = shapes_[size_t(shape)];
    QuadricKind kind = QuadricKind::Disk;
    if (info.flags & IsSphere) {
        kind = QuadricKind::Sphere;
        // a mirrored sphere faces inwards, as in Mitsuba
        info.flags = layout_.shapes[size_t(shape)].flags ^ (to_world.determinant() < 0 ? FlipNormals : 0);
        double radius = to_world.column_norm(0);
        areas_[size_t(shape)] = S(4 * Pi * radius * radius);
    } else if (info.flags & IsCylinder) {
        kind = QuadricKind::Cylinder;
        areas_[size_t(shape)] = S(2 * Pi * to_world.column_norm(0) * to_world.column_norm(2));
    } else {
        double xx = to_world.column_dot(0, 0), yy = to_world.column_dot(1, 1), xy = to_world.column_dot(0, 1);
        areas_[size_t(shape)] = S(Pi * std::sqrt(xx * yy - xy * xy));
    }
    float single[24];
    std::copy_n(&matrices_[size_t(shape) * 24], 24, single);
    accel_->set_quadric(uint32_t(shape), kind, single, single + 12);
    ++counters_.quadrics;
}

// The values of a height field or a grid of distances, and what there is to be remembered of them.
template <class S>
const float *SceneData<S>::in_single(int shape, const S *values, bool changed) {
    HeightsCopy &copy = heights_[size_t(shape)];
    const int64_t n = layout_.slot_sizes[size_t(shapes_[size_t(shape)].heights)];
    if (changed) copy.fingerprint = fingerprint(values, n);
    if constexpr (sizeof(S) == 4) {
        return values;
    } else {
        if (changed) copy.single.assign(values, values + n);
        return copy.single.data();
    }
}

// Height fields are not Embree's: nothing is committed.
template <class S>
void SceneData<S>::update_heights(int shape, const S *heights, bool changed, bool moved) {
    const ShapeInfo &info = shapes_[size_t(shape)];
    const auto &sizes = layout_.tensor_shapes[size_t(info.heights)];
    const float *single = in_single(shape, heights, changed);
    if (changed) {
        float largest = accel_->set_heights(uint32_t(shape), single, sizes[0], sizes[2], info.interpolation != 0);
        if (!(largest <= float(LargestCoordinate)))
            bad_value(path("shape", shape) + ": field 'heights'", "heights up to 1e18", std::to_string(largest));
        ++counters_.height_fields;
    } else {
        accel_->refer_heights(uint32_t(shape), single);
    }
    if (!moved) return;
    set_matrices(shape);
    float matrices[24];
    std::copy_n(&matrices_[size_t(shape) * 24], 24, matrices);
    accel_->place_heights(uint32_t(shape), matrices, matrices + 12);
}

// Nor are grids of distances.
template <class S>
void SceneData<S>::update_sdf_grid(int shape, const S *values, bool changed, bool moved) {
    const auto &sizes = layout_.tensor_shapes[size_t(shapes_[size_t(shape)].heights)];  // rows, columns, 1, slices
    const float *single = in_single(shape, values, changed);
    SdfGrid &grid = accel_->sdf_grid(uint32_t(shape));
    if (changed) {
        float largest = grid.set_values(uint32_t(shape), single, {sizes[1], sizes[0], sizes[3]});
        if (!(largest <= float(LargestCoordinate)))
            bad_value(path("shape", shape) + ": field 'grid'", "values up to 1e18", std::to_string(largest));
        ++counters_.sdf_grids;
    } else {
        grid.refer(single);
    }
    if (!moved) return;
    set_matrices(shape);
    float matrices[24];
    std::copy_n(&matrices_[size_t(shape) * 24], 24, matrices);
    grid.set_matrices(matrices, matrices + 12);
}

#define TR_INSTANTIATE(S)                                                                                   \
    template void SceneData<S>::update_shapes(const std::vector<const S *> &, const std::vector<uint8_t> &, \
                                              const std::vector<S> &, bool);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
