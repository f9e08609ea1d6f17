// Emitters and what they belong to; sensors.
#include "../core/registry.h"
#include "layout_builder.h"

namespace tr {

void LayoutBuilder::connect_emitters() {
    std::vector<Record> &records = out_.records["emitter"];
    std::vector<int> shape_of(records.size(), -1);
    for (size_t s = 0; s < out_.shapes.size(); ++s) {
        int e = out_.shapes[s].emitter;
        if (e < 0) continue;
        std::string at = where("shape", int(s), "emitter");
        if (!is_surface_emitter(records[size_t(e)].kind))
            fail(at, "an area or directionalarea emitter", "'" + list("emitter")[size_t(e)].type + "'");
        if (shape_of[size_t(e)] >= 0)
            fail(at, "an area emitter of its own",
                 path("emitter", e) + ", which belongs to " + path("shape", shape_of[size_t(e)]));
        shape_of[size_t(e)] = int(s);
        // its normal would turn with the vertex normals, but light leaves along the face's
        if (records[size_t(e)].kind == int32_t(EmitterKind::DirectionalArea) && (out_.shapes[s].flags & HasNormals))
            fail(at, "a flat shape, or a mesh without vertex normals (face_normals)", "a mesh with vertex normals");
    }
    for (size_t e = 0; e < records.size(); ++e) {
        const std::string &type = list("emitter")[e].type;
        if (is_surface_emitter(records[e].kind)) {
            if (shape_of[e] < 0)
                fail(path("emitter", int(e)), "to belong to a shape", "an emitter of surfaces without one");
            records[e].field[AreaEmitter::ShapeIndex] = shape_of[e];
        } else if (type == ConstantEmitter::model.type || type == EnvironmentMap::model.type) {
            if (out_.environment >= 0)
                fail(path("emitter", int(e)), "one environment emitter in a scene",
                     "a second besides " + path("emitter", out_.environment));
            out_.environment = int(e);
            if (type == EnvironmentMap::model.type) check_image("emitter", int(e), EnvironmentMap::Data);
        }
        for_each_point_light<float>(records[e].kind, true, [&](auto model, bool) {
            constexpr int image = decltype(model)::TextureField;
            if constexpr (image >= 0)
                check_pattern(where("emitter", int(e), model.model.fields[image].name), records[e].field[image]);
        });
        if (type == ProjectorEmitter::model.type) {
            const Record &image = out_.records["texture"][size_t(records[e].field[ProjectorEmitter::Irradiance])];
            double aspect = 1;
            if (image.kind == int32_t(TextureKind::Bitmap)) {
                const auto &size = out_.tensor_shapes[size_t(image.field[Bitmap::Data])];
                aspect = double(size[1]) / double(size[0]);
            }
            records[e].field[ProjectorEmitter::AspectOffset] = int32_t(out_.constants.size());
            out_.constants.push_back(aspect);
        }
    }
}

// The image of a light that is no surface.
void LayoutBuilder::check_pattern(const std::string &at, int32_t texture) const {
    const Record &record = out_.records.at("texture")[size_t(texture)];
    if (record.kind == int32_t(TextureKind::MeshAttribute))
        fail(at, "a texture with coordinates: this light is no mesh", "a mesh_attribute");
    if (record.kind == int32_t(TextureKind::Volume))
        fail(at, "a texture with coordinates: this light has no surface", "a volume");
    if (record.kind == int32_t(TextureKind::Checkerboard))
        for (int f : {Checkerboard::Color0, Checkerboard::Color1}) check_pattern(at, record.field[f]);
}

void LayoutBuilder::check_sensors() {
    for (int i = 0; i < int(list("sensor").size()); ++i) {
        check_table(i, Perspective::model.type, Perspective::Distortion, 8);
        check_table(i, Fisheye::model.type, Fisheye::Distortion, 4);
        check_table(i, Distant::model.type, Distant::Target, 3);
        if (list("sensor")[size_t(i)].type != IrradianceMeter::model.type) continue;
        int shape = value("sensor", i, IrradianceMeter::ShapeIndex);
        if (!(out_.shapes[size_t(shape)].flags & HasTexcoords))
            fail(where("sensor", i, "shape"), "a rectangle, or a mesh with texture coordinates",
                 "'" + list("shape")[size_t(shape)].type + "' without");
    }
}

void LayoutBuilder::check_table(int sensor, const std::string &type, int f, int64_t size) {
    if (list("sensor")[size_t(sensor)].type != type || value("sensor", sensor, f) < 0) return;
    const auto &s = shapes_[size_t(value("sensor", sensor, f))];
    if (s.size() != 1 || s[0] != size)
        fail(where("sensor", sensor, field("sensor", sensor, f).name),
             "a tensor of shape (" + std::to_string(size) + ",)", text(s));
}

}  // namespace tr
