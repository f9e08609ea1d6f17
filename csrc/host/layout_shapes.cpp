// Shapes: what is read of each, faces, colours of meshes.
#include <limits>

#include "../core/registry.h"
#include "../core/shape/sdfgrid.h"
#include "layout_builder.h"

namespace tr {

void LayoutBuilder::connect_shapes() {
    out_.shapes.resize(list("shape").size());
    for (int i = 0; i < int(out_.shapes.size()); ++i) {
        const std::string &type = list("shape")[size_t(i)].type;
        ShapeInfo &info = out_.shapes[size_t(i)];
        info = ShapeInfo{};
        info.first_attribute = -1;
        int bsdf, emitter, flip = -1, interior = PlanarFields::Interior;
        if (type == MeshModel::model.type) {
            bsdf = MeshModel::BsdfIndex, emitter = MeshModel::EmitterIndex, flip = MeshModel::Flip;
            interior = MeshModel::Interior;
            add_mesh(i, info);
        } else if (type == SphereModel::model.type) {
            bsdf = SphereModel::BsdfIndex, emitter = SphereModel::EmitterIndex, flip = SphereModel::Flip;
            interior = SphereModel::Interior;
            info.flags |= IsSphere;
        } else if (type == CylinderModel::model.type) {
            bsdf = CylinderModel::BsdfIndex, emitter = CylinderModel::EmitterIndex, flip = CylinderModel::Flip;
            interior = CylinderModel::Interior;
            info.flags |= IsCylinder;
        } else if (type == HeightFieldModel::model.type) {
            bsdf = HeightFieldModel::BsdfIndex, emitter = HeightFieldModel::EmitterIndex;
            flip = HeightFieldModel::Flip, interior = HeightFieldModel::Interior;
            add_height_field(i, info);
        } else if (type == BSplineCurveModel::model.type || type == LinearCurveModel::model.type) {
            bsdf = CurveFields::BsdfIndex, emitter = CurveFields::EmitterIndex, interior = CurveFields::Interior;
            info.flags |= type == LinearCurveModel::model.type ? IsCurve | IsStraight : IsCurve;
            add_curve(i, info);
        } else if (type == SdfGridModel::model.type) {
            bsdf = SdfGridModel::BsdfIndex, emitter = SdfGridModel::EmitterIndex, flip = SdfGridModel::Flip;
            interior = SdfGridModel::Interior;
            add_sdf_grid(i, info);
        } else {
            bsdf = PlanarFields::BsdfIndex, emitter = PlanarFields::EmitterIndex, flip = PlanarFields::Flip;
            if (type == RectangleModel::model.type)
                add_rectangle(i, info);
            else
                info.flags |= IsDisk;
        }
        info.bsdf = value("shape", i, bsdf);
        info.emitter = value("shape", i, emitter);
        info.interior = value("shape", i, interior);
        info.exterior = value("shape", i, interior + 1);
        if (info.bsdf < 0) fail(where("shape", i, "bsdf"), "a bsdf", "none");
        if (info.interior >= 0 && (out_.media[size_t(info.interior)].flags & Bends)) bound_bending(info);
        if (flip >= 0 && value("shape", i, flip)) info.flags |= FlipNormals;
        if (info.emitter >= 0 && !(info.flags & IsCurved)) {
            info.cdf_offset = out_.n_cdf_faces;
            out_.n_cdf_faces += info.n_faces;
        }
    }
}

// Around a medium that light bends in a dielectric is one of a kind of its own.
void LayoutBuilder::bound_bending(ShapeInfo &info) {
    Record record = out_.records["bsdf"][size_t(info.bsdf)];
    if (record.kind != DielectricKind) return;
    record.kind = GradientDielectricKind;
    out_.paths["bsdf"].push_back(out_.paths["bsdf"][size_t(info.bsdf)]);
    out_.records["bsdf"].push_back(record);
    info.bsdf = int32_t(out_.records["bsdf"].size() - 1);
}

void LayoutBuilder::begin_mesh(ShapeInfo &info, int64_t n_vertices, int64_t n_faces, const std::string &at) {
    constexpr int64_t limit = std::numeric_limits<int32_t>::max() / 3;
    if (out_.n_vertices + n_vertices > limit || int64_t(out_.faces.size() / 3) + n_faces > limit)
        fail(at, "a scene of fewer than 2^31 / 3 vertices and faces", "more");
    info.face_offset = int32_t(out_.faces.size() / 3);
    info.n_faces = int32_t(n_faces);
    info.first_vertex = out_.n_vertices;
    out_.n_vertices += int(n_vertices);
}

void LayoutBuilder::add_mesh(int i, ShapeInfo &info) {
    MeshSource mesh{i,
                    value("shape", i, MeshModel::Vertices),
                    value("shape", i, MeshModel::Normals),
                    value("shape", i, MeshModel::Texcoords),
                    0,
                    0};
    auto rows = [&](int slot, int64_t columns, const char *name, int64_t n) {
        const auto &s = shapes_[size_t(slot)];
        if (s.size() != 2 || s[1] != columns || (n >= 0 && s[0] != n))
            fail(where("shape", i, name),
                 "a tensor of shape (" + (n >= 0 ? std::to_string(n) : "V") + ", " + std::to_string(columns) + ")",
                 text(s));
        return s[0];
    };
    int64_t n_vertices = rows(mesh.vertices, 3, "vertices", -1);
    const IndexArray &array = arrays_[size_t(value("shape", i, MeshModel::Faces))];
    std::string at = where("shape", i, "faces");
    if (array.rows < 1 || !array.data) fail(at, "at least one face", "an empty array");
    if (mesh.normals >= 0 && value("shape", i, MeshModel::FaceNormals)) mesh.normals = -1;
    if (mesh.normals >= 0) rows(mesh.normals, 3, "normals", n_vertices);
    if (mesh.texcoords >= 0) rows(mesh.texcoords, 2, "texcoords", n_vertices);
    begin_mesh(info, n_vertices, array.rows, at);
    if (mesh.normals >= 0) info.flags |= HasNormals;
    if (mesh.texcoords >= 0) info.flags |= HasTexcoords;
    out_.faces.reserve(out_.faces.size() + size_t(array.rows) * 3);
    for (int64_t k = 0; k < array.rows * 3; ++k) {
        int32_t index = array.data[k];
        if (index < 0 || index >= n_vertices)
            fail(at, "vertex indices from 0 to " + std::to_string(n_vertices - 1),
                 std::to_string(index) + " in face " + std::to_string(k / 3));
        out_.faces.push_back(uint32_t(info.first_vertex + index));
    }
    mesh.first_vertex = info.first_vertex;
    mesh.n_vertices = int(n_vertices);
    out_.meshes.push_back(mesh);
}

void LayoutBuilder::add_height_field(int i, ShapeInfo &info) {
    info.flags |= IsHeightField;
    info.heights = value("shape", i, HeightFieldModel::Heights);
    info.interpolation = value("shape", i, HeightFieldModel::Interpolation);
    const auto &s = shapes_[size_t(info.heights)];
    if (s.size() != 2) fail(where("shape", i, "heights"), "a tensor of shape (H, W)", text(s));
    if (value("shape", i, HeightFieldModel::EmitterIndex) >= 0)
        fail(where("shape", i, "emitter"), "none: a height field cannot emit", "an emitter");
}

void LayoutBuilder::add_curve(int i, ShapeInfo &info) {
    const int points = value("shape", i, CurveFields::ControlPoints), radii = value("shape", i, CurveFields::Radii);
    const auto &s = shapes_[size_t(points)], &r = shapes_[size_t(radii)];
    if (s.size() != 2 || s[1] != 3) fail(where("shape", i, "control_points"), "a tensor of shape (N, 3)", text(s));
    if (r.size() != 1 || r[0] != s[0])
        fail(where("shape", i, "radii"), "a tensor of shape (" + std::to_string(s[0]) + ",)", text(r));
    for (int f : {CurveFields::EmitterIndex, CurveFields::Interior, CurveFields::Exterior})
        if (value("shape", i, f) >= 0)
            fail(where("shape", i, CurveFields::fields[f].name), "none: a curve neither emits nor bounds a medium",
                 "one");
    const IndexArray &array = arrays_[size_t(value("shape", i, CurveFields::Segments))];
    const std::string at = where("shape", i, "segments");
    if (array.rows < 1 || !array.data) fail(at, "at least one segment", "an empty array");
    const int last = info.flags & IsStraight ? 1 : 3;
    begin_mesh(info, s[0], array.rows, at);
    for (int64_t k = 0; k < array.rows; ++k) {
        int32_t first = array.data[k];
        if (first < 0 || first + last >= s[0])
            fail(at, "control points from 0 to " + std::to_string(s[0] - 1 - last),
                 std::to_string(first) + " for segment " + std::to_string(k));
        for (int corner = 0; corner < 3; ++corner) out_.faces.push_back(uint32_t(info.first_vertex + first));
    }
    MeshSource curve{i, points, -1, -1, info.first_vertex, int(s[0])};
    curve.radii = radii;
    out_.meshes.push_back(curve);
}

void LayoutBuilder::add_sdf_grid(int i, ShapeInfo &info) {
    info.flags |= IsSdfGrid;
    if (value("shape", i, SdfGridModel::Normals) == 0) info.flags |= HasNormals;
    info.heights = value("shape", i, SdfGridModel::Grid);
    const auto &s = shapes_[size_t(info.heights)];
    if (s.size() != 4 || s[3] != 1 || s[0] < 2 || s[1] < 2 || s[2] < 2)
        fail(where("shape", i, "grid"), "a tensor of shape (D, H, W, 1) with D, H, W > 1", text(s));
    int bits = 0;
    for (size_t k = 0; k < 3; ++k) bits += SdfCellBits::of(int32_t(s[k]) - 1);
    if (bits > SdfCellBits::Most)
        fail(where("shape", i, "grid"), "at most 2^29 cells, each side rounded up to a power of two", text(s));
    if (value("shape", i, SdfGridModel::EmitterIndex) >= 0)
        fail(where("shape", i, "emitter"), "none: a grid of distances cannot emit", "an emitter");
    int bsdf = value("shape", i, SdfGridModel::BsdfIndex);
    if (bsdf >= 0) check_without_coordinates(bsdf, where("shape", i, "bsdf"));
}

void LayoutBuilder::check_without_coordinates(int bsdf, const std::string &at) {
    if (is_bsdf(bsdf, FollowsTangent) || is_bsdf(bsdf, PerturbsNormals))
        fail(at, "a bsdf without directions along the surface: an sdfgrid has no texture coordinates",
             "'" + list("bsdf")[size_t(bsdf)].type + "'");
    for_nested(bsdf, [&](int nested, const std::string &) { check_without_coordinates(nested, at); });
}

void LayoutBuilder::add_rectangle(int i, ShapeInfo &info) {
    begin_mesh(info, 4, 2, path("shape", i));
    info.flags |= HasTexcoords;
    for (uint32_t corner : {0u, 1u, 2u, 0u, 2u, 3u}) out_.faces.push_back(uint32_t(info.first_vertex) + corner);
    out_.meshes.push_back({i, -1, -1, -1, info.first_vertex, 4});
}

void LayoutBuilder::connect_attributes() {
    std::set<std::pair<int, int>> seen;
    for (int i = 0; i < int(list("attribute").size()); ++i) {
        int shape = value("attribute", i, AttributeModel::ShapeIndex),
            name = value("attribute", i, AttributeModel::Name);
        bool per_face = value("attribute", i, AttributeModel::PerFace) != 0;
        int slot = value("attribute", i, AttributeModel::Data);
        if (list("shape")[size_t(shape)].type != MeshModel::model.type)
            fail(where("attribute", i, "shape"), "a mesh", "'" + list("shape")[size_t(shape)].type + "'");
        if (!seen.insert({shape, name}).second)
            fail(where("attribute", i, "name"), "one attribute of a name on a mesh", "a second");
        ShapeInfo &info = out_.shapes[size_t(shape)];
        int64_t rows = per_face ? info.n_faces : shapes_[size_t(value("shape", shape, MeshModel::Vertices))][0];
        const auto &s = shapes_[size_t(slot)];
        if (s.size() > 2 || s[0] != rows || (s.size() == 2 && s[1] != 1 && s[1] != out_.texel_channels()))
            fail(where("attribute", i, "data"),
                 "a tensor of shape (" + std::to_string(rows) + ", " + channel_choices() + ")", text(s));
        out_.attributes.push_back({name, slot, per_face, info.first_attribute});
        info.first_attribute = i;
    }
}

}  // namespace tr
