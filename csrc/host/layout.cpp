// From objects to records and constants.
#include <cmath>
#include <limits>

#include "../core/registry.h"
#include "layout_builder.h"

namespace tr {

namespace {

const char *const Categories[] = {"texture", "bsdf",  "emitter", "shape",    "sensor",
                                  "volume",  "phase", "medium",  "attribute"};

}  // namespace

std::string LayoutBuilder::text(const std::vector<int64_t> &shape) {
    std::string r = "(";
    for (size_t i = 0; i < shape.size(); ++i) r += (i ? ", " : "") + std::to_string(shape[i]);
    return "a tensor of shape " + r + (shape.size() == 1 ? ",)" : ")");
}

SceneLayout LayoutBuilder::run() {
    if (out_.channels != 1 && out_.channels != 3) fail("scene: channels", "1 or 3", std::to_string(out_.channels));
    for (const auto &[category, list] : objects_) {
        bool known = false;
        for (const char *name : Categories) known |= category == name;
        if (!known) fail("scene", "one of the known categories", "'" + category + "'");
    }
    describe_slots();
    for (const char *category : Categories) out_.records[category].resize(list(category).size());
    for (const char *category : Categories)
        for (size_t i = 0; i < list(category).size(); ++i) make_record(category, int(i));
    for (size_t i = 0; i < list("texture").size(); ++i) texture_depth(int(i), 1);
    check_bsdfs();
    connect_media();
    lay_out_phases(out_, shapes_);
    lay_out_bsdfs(out_);
    connect_shapes();
    find_enclosed_media();
    connect_emitters();
    connect_attributes();
    check_sensors();
    return std::move(out_);
}

void LayoutBuilder::describe_slots() {
    for (size_t i = 0; i < shapes_.size(); ++i) {
        const auto &s = shapes_[i];
        int64_t size = 1;
        for (int64_t n : s) {
            if (n < 0 || (n > 0 && size > std::numeric_limits<int32_t>::max() / n))
                fail("parameter " + std::to_string(i), "fewer than 2^31 numbers", text(s));
            size *= n;
        }
        out_.slot_sizes.push_back(size);
        auto at = [&](size_t k) { return k < s.size() ? int32_t(s[k]) : 1; };
        // (n, channels) as n rows of one column
        out_.tensor_shapes.push_back(s.size() == 4   ? std::array<int32_t, 4>{at(1), at(2), at(3), at(0)}
                                     : s.size() == 3 ? std::array<int32_t, 4>{at(0), at(1), at(2), 1}
                                                     : std::array<int32_t, 4>{at(0), 1, at(1), 1});
    }
}

const std::vector<int64_t> &LayoutBuilder::slot_shape(int64_t slot, const std::string &at) const {
    if (slot < 0 || slot >= int64_t(shapes_.size()))
        fail(at, "the number of a parameter below " + std::to_string(shapes_.size()), std::to_string(slot));
    return shapes_[size_t(slot)];
}

void LayoutBuilder::make_record(const std::string &category, int index) {
    const SceneObject &object = list(category)[size_t(index)];
    out_.paths[category].push_back(object.path.empty() ? category + " " + std::to_string(index) : object.path);
    const ModelEntry *entry = find_model(category, object.type);
    if (!entry)
        fail(path(category, index), "a " + category + " of type " + model_types(category), "'" + object.type + "'");
    const Model &model = *entry->model;
    if (int(object.ints.size()) != model.n_fields)
        fail(path(category, index), std::to_string(model.n_fields) + " fields", std::to_string(object.ints.size()));
    Record record{};
    record.kind = entry->kind;
    for (int f = 0; f < model.n_fields; ++f)
        record.field[f] =
            resolve(model.fields[f], object.ints[size_t(f)], where(category, index, model.fields[f].name));
    if (object.type == ConstantVolume::model.type) {  // whether one number stands for all channels
        int64_t slot = object.ints[ConstantVolume::Value];
        record.field[Record::Extra] = slot < 0 || out_.slot_sizes[size_t(slot)] == 1;
    }
    out_.records[category][size_t(index)] = record;
}

// The number that stands in the record for a field.
int32_t LayoutBuilder::resolve(const Field &f, int64_t given, const std::string &at) {
    switch (f.kind) {
        case Kind::Texture:
        case Kind::Scalar:
            (&f == &NormalMap::fields[NormalMap::Map] ? normals_ : colours_).insert(given);
            return given == -1 && !std::isnan(f.fallback) ? default_constant("texture", ConstantTexture::model.type, f)
                                                          : reference("texture", given, false, at);
        case Kind::Bsdf:
            return reference("bsdf", given, f.fallback == -1, at);
        case Kind::Emitter:
            return reference("emitter", given, f.fallback == -1, at);
        case Kind::Shape:
            return reference("shape", given, f.fallback == -1, at);
        case Kind::Volume:
            return given == -1 && f.fallback != -1 ? default_constant("volume", ConstantVolume::model.type, f)
                                                   : reference("volume", given, f.fallback == -1, at);
        case Kind::Phase:
            return given == -1 && f.fallback == -1 ? default_phase() : reference("phase", given, false, at);
        case Kind::Medium:
            return reference("medium", given, f.fallback == -1, at);
        case Kind::Int:
            if (given < std::max(f.minimum, double(std::numeric_limits<int32_t>::min())) ||
                given > std::min(f.maximum, double(std::numeric_limits<int32_t>::max())))
                fail(at, "a number from " + number(f.minimum) + " to " + number(f.maximum), std::to_string(given));
            return int32_t(given);
        case Kind::Indices:
            if (given < 0 || given >= int64_t(arrays_.size()))
                fail(at, "the number of an index array below " + std::to_string(arrays_.size()), std::to_string(given));
            return int32_t(given);
        case Kind::Tensor: {
            if (given == -1 && f.fallback == -1) return -1;
            const auto &s = slot_shape(given, at);
            if (s.empty() || s.size() > 4 || out_.slot_sizes[size_t(given)] == 0)
                fail(at, "a tensor that is not empty, with 1 to 4 dimensions", text(s));
            out_.tensors.push_back({int(given), at});
            return int32_t(given);
        }
        default:
            return constant(f, given, at);
    }
}

std::string LayoutBuilder::number(double x) {
    if (std::isinf(x)) return x < 0 ? "-infinity" : "infinity";
    return std::to_string(int64_t(x));
}

int32_t LayoutBuilder::reference(const std::string &category, int64_t given, bool optional, const std::string &at) {
    int64_t n = int64_t(list(category).size());
    if ((given == -1 && optional) || (given >= 0 && given < n)) return int32_t(given);
    fail(at, "the number of a " + category + " below " + std::to_string(n) + (optional ? ", or -1" : ""),
         std::to_string(given));
}

int32_t LayoutBuilder::default_constant(const char *category, const std::string &type, const Field &f) {
    static_assert(int(ConstantTexture::Value) == int(ConstantVolume::Value), "both are filled in as one");
    Record record{};
    record.kind = find_model(category, type)->kind;
    record.field[ConstantTexture::Value] = int32_t(out_.constants.size());
    record.field[Record::Extra] = 1;
    out_.constants.insert(out_.constants.end(), size_t(out_.stored_spectrum()), f.fallback);
    out_.records[category].push_back(record);
    return int32_t(out_.records[category].size()) - 1;
}

int32_t LayoutBuilder::default_phase() {
    Record record{};
    record.kind = find_model("phase", "isotropic")->kind;
    out_.records["phase"].push_back(record);
    return int32_t(out_.records["phase"].size()) - 1;
}

int32_t LayoutBuilder::constant(const Field &f, int64_t given, const std::string &at) {
    const int channels = out_.spectral ? SpectrumSamples : out_.channels;
    const bool vector = f.kind == Kind::Point || f.kind == Kind::Vector;
    int stored = f.kind == Kind::Spectrum    ? out_.stored_spectrum()
                 : f.kind == Kind::Float     ? 1
                 : vector                    ? 3
                 : f.kind == Kind::Transform ? 12
                                             : 9;
    bool matrix = f.kind == Kind::Transform || f.kind == Kind::Transform2;
    int32_t offset = int32_t(out_.constants.size());
    if (given == -1) {
        if (std::isnan(f.fallback) && !matrix) fail(at, "a value", "none");
        out_.constants.insert(out_.constants.end(), size_t(stored), matrix ? 0.0 : f.fallback);
        int columns = f.kind == Kind::Transform ? 4 : 3;
        if (matrix)  // the identity
            for (int i = 0; i < 3; ++i) out_.constants[size_t(offset + i * columns + i)] = 1;
        return offset;
    }
    const auto &s = slot_shape(given, at);
    using Shape = std::vector<int64_t>;
    bool right = f.kind == Kind::Spectrum    ? s.empty() || s == Shape{channels}
                 : f.kind == Kind::Float     ? s.empty()
                 : vector                    ? s == Shape{3}
                 : f.kind == Kind::Transform ? s == Shape{4, 4}
                                             : s == Shape{3, 3};
    if (!right)
        fail(at,
             f.kind == Kind::Spectrum    ? "a tensor of shape () or (" + std::to_string(channels) + ",)"
             : f.kind == Kind::Float     ? "a tensor of shape ()"
             : vector                    ? "a tensor of shape (3,)"
             : f.kind == Kind::Transform ? "a tensor of shape (4, 4)"
                                         : "a tensor of shape (3, 3)",
             text(s));
    out_.constants.insert(out_.constants.end(), size_t(stored), 0.0);
    out_.entries.push_back({int(given), offset, stored, int(out_.slot_sizes[size_t(given)])});
    out_.entry_where.push_back(at);
    return offset;
}

SceneLayout lay_out(const SceneObjects &objects, const std::vector<std::vector<int64_t>> &param_shapes,
                    const std::vector<IndexArray> &index_arrays, int channels, bool spectral) {
    return LayoutBuilder(objects, param_shapes, index_arrays, channels, spectral).run();
}

}  // namespace tr
