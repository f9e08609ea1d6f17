// Emitters and what they belong to; sensors.
#include "../core/registry.h"
#include "layout_builder.h"
#include "models.h"

namespace tr {

void LayoutBuilder::connect_emitters() {
    std::vector<Record> &records = out_.records["emitter"];
    std::vector<int> shape_of(records.size(), -1);
    for (size_t s = 0; s < out_.shapes.size(); ++s) {
        int e = out_.shapes[s].emitter;
        if (e < 0) continue;
        std::string at = where("shape", int(s), "emitter");
        const Model &model = model_of("emitter", records[size_t(e)]);
        if (!model.is(IsOnShape)) fail(at, "an area or directionalarea emitter", std::string("'") + model.type + "'");
        if (shape_of[size_t(e)] >= 0)
            fail(at, "an area emitter of its own",
                 path("emitter", e) + ", which belongs to " + path("shape", shape_of[size_t(e)]));
        shape_of[size_t(e)] = int(s);
        // its normal would turn with the vertex normals, but light leaves along the face's
        if (model.is(IsBeam) && (out_.shapes[s].flags & HasNormals))
            fail(at, "a flat shape, or a mesh without vertex normals (face_normals)", "a mesh with vertex normals");
    }
    for (size_t e = 0; e < records.size(); ++e) connect_emitter(int(e), shape_of[e]);
}

void LayoutBuilder::connect_emitter(int emitter, int shape) {
    Record &record = out_.records["emitter"][size_t(emitter)];
    const Model &model = model_of("emitter", record);
    if (model.is(IsOnShape)) {
        if (shape < 0) fail(path("emitter", emitter), "to belong to a shape", "an emitter of surfaces without one");
        record.field[EmitterShape] = shape;
    }
    if (model.is(IsEnvironment)) {
        if (out_.environment >= 0)
            fail(path("emitter", emitter), "one environment emitter in a scene",
                 "a second besides " + path("emitter", out_.environment));
        out_.environment = emitter;
    }
    for (int f = 0; f < model.n_fields; ++f) {
        const Field &field = model.fields[f];
        if (field.kind == Kind::Tensor) check_image("emitter", emitter, f);
        if (field.kind != Kind::Texture || model.is(IsOnShape)) continue;
        check_pattern(where("emitter", emitter, field.name), record.field[f]);
        if (!model.is(HasImageAspect)) continue;
        const Record &image = out_.records["texture"][size_t(record.field[f])];
        double aspect = 1;
        if (image.kind == int32_t(TextureKind::Bitmap)) {
            const auto &size = out_.tensor_shapes[size_t(image.field[Bitmap::Data])];
            aspect = double(size[1]) / double(size[0]);
        }
        record.field[ImageAspect] = int32_t(out_.constants.size());
        out_.constants.push_back(aspect);
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
