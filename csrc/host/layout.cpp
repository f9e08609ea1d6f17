#include "layout.h"

#include <cmath>
#include <limits>
#include <set>
#include <stdexcept>

#include "../core/registry.h"
#include "../core/sensor/camera.h"
#include "models.h"

namespace tr {

namespace {

const char *const Categories[] = {"texture", "bsdf",  "emitter", "shape",    "sensor",
                                  "volume",  "phase", "medium",  "attribute"};
constexpr int MaxTextureDepth = 8;  // of textures in textures, see visit_texture

[[noreturn]] void fail(const std::string &where, const std::string &expected, const std::string &got) {
    throw std::invalid_argument(where + ": expected " + expected + ", got " + got);
}

std::string text(const std::vector<int64_t> &shape) {
    std::string r = "(";
    for (size_t i = 0; i < shape.size(); ++i) r += (i ? ", " : "") + std::to_string(shape[i]);
    return "a tensor of shape " + r + (shape.size() == 1 ? ",)" : ")");
}

class Builder {
public:
    Builder(const SceneObjects &objects, const std::vector<std::vector<int64_t>> &shapes,
            const std::vector<IndexArray> &arrays, int channels)
        : objects_(objects), shapes_(shapes), arrays_(arrays) {
        out_.channels = channels;
    }

    SceneLayout run() {
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

private:
    const SceneObjects &objects_;
    const std::vector<std::vector<int64_t>> &shapes_;
    const std::vector<IndexArray> &arrays_;
    SceneLayout out_;
    std::set<int64_t> normals_, colours_;  // textures that are looked up as vectors, and those that are as colours

    const std::vector<SceneObject> &list(const std::string &category) const {
        static const std::vector<SceneObject> none;
        auto found = objects_.find(category);
        return found == objects_.end() ? none : found->second;
    }
    const std::string &path(const std::string &category, int i) const { return out_.paths.at(category)[size_t(i)]; }
    std::string where(const std::string &category, int i, const char *field) const {
        return path(category, i) + ": field '" + field + "'";
    }
    const Field &field(const std::string &category, int i, int f) const {
        return find_model(category, list(category)[size_t(i)].type)->model->fields[f];
    }
    int32_t value(const std::string &category, int i, int f) const {
        return out_.records.at(category)[size_t(i)].field[f];
    }

    void describe_slots() {
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

    const std::vector<int64_t> &slot_shape(int64_t slot, const std::string &at) const {
        if (slot < 0 || slot >= int64_t(shapes_.size()))
            fail(at, "the number of a parameter below " + std::to_string(shapes_.size()), std::to_string(slot));
        return shapes_[size_t(slot)];
    }

    void make_record(const std::string &category, int index) {
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
    int32_t resolve(const Field &f, int64_t given, const std::string &at) {
        switch (f.kind) {
            case Kind::Texture:
            case Kind::Scalar:
                (&f == &NormalMap::fields[NormalMap::Map] ? normals_ : colours_).insert(given);
                return given == -1 && !std::isnan(f.fallback) ? default_texture(f)
                                                              : reference("texture", given, false, at);
            case Kind::Bsdf:
                return reference("bsdf", given, f.fallback == -1, at);
            case Kind::Emitter:
                return reference("emitter", given, f.fallback == -1, at);
            case Kind::Shape:
                return reference("shape", given, f.fallback == -1, at);
            case Kind::Volume:
                return given == -1 && f.fallback != -1 ? default_volume(f)
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
                    fail(at, "the number of an index array below " + std::to_string(arrays_.size()),
                         std::to_string(given));
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

    static std::string number(double x) {
        if (std::isinf(x)) return x < 0 ? "-infinity" : "infinity";
        return std::to_string(int64_t(x));
    }

    int32_t reference(const std::string &category, int64_t given, bool optional, const std::string &at) {
        int64_t n = int64_t(list(category).size());
        if ((given == -1 && optional) || (given >= 0 && given < n)) return int32_t(given);
        fail(at, "the number of a " + category + " below " + std::to_string(n) + (optional ? ", or -1" : ""),
             std::to_string(given));
    }

    int32_t default_texture(const Field &f) {
        Record record{};
        record.kind = find_model("texture", "constant")->kind;
        record.field[ConstantTexture::Value] = int32_t(out_.constants.size());
        record.field[Record::Extra] = 1;
        out_.constants.insert(out_.constants.end(), size_t(out_.channels), f.fallback);
        out_.records["texture"].push_back(record);
        return int32_t(out_.records["texture"].size()) - 1;
    }

    int32_t default_volume(const Field &f) {
        Record record{};
        record.kind = find_model("volume", "constvolume")->kind;
        record.field[ConstantVolume::Value] = int32_t(out_.constants.size());
        record.field[Record::Extra] = 1;
        out_.constants.insert(out_.constants.end(), size_t(out_.channels), f.fallback);
        out_.records["volume"].push_back(record);
        return int32_t(out_.records["volume"].size()) - 1;
    }

    int32_t default_phase() {
        Record record{};
        record.kind = find_model("phase", "isotropic")->kind;
        out_.records["phase"].push_back(record);
        return int32_t(out_.records["phase"].size()) - 1;
    }

    int32_t constant(const Field &f, int64_t given, const std::string &at) {
        const int channels = out_.channels;
        int stored = f.kind == Kind::Spectrum    ? channels
                     : f.kind == Kind::Float     ? 1
                     : f.kind == Kind::Point     ? 3
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
                     : f.kind == Kind::Point     ? s == Shape{3}
                     : f.kind == Kind::Transform ? s == Shape{4, 4}
                                                 : s == Shape{3, 3};
        if (!right)
            fail(at,
                 f.kind == Kind::Spectrum    ? "a tensor of shape () or (" + std::to_string(channels) + ",)"
                 : f.kind == Kind::Float     ? "a tensor of shape ()"
                 : f.kind == Kind::Point     ? "a tensor of shape (3,)"
                 : f.kind == Kind::Transform ? "a tensor of shape (4, 4)"
                                             : "a tensor of shape (3, 3)",
                 text(s));
        out_.constants.insert(out_.constants.end(), size_t(stored), 0.0);
        out_.entries.push_back({int(given), offset, stored, int(out_.slot_sizes[size_t(given)])});
        out_.entry_where.push_back(at);
        return offset;
    }

    // Also finds textures that contain themselves.
    void texture_depth(int index, int depth) {
        if (depth > MaxTextureDepth)
            fail(path("texture", index), "textures nested at most " + std::to_string(MaxTextureDepth) + " deep",
                 "a deeper or circular nesting");
        const std::string &type = list("texture")[size_t(index)].type;
        const Model &model = *find_model("texture", type)->model;
        for (int f = 0; f < model.n_fields; ++f) {
            int32_t nested = value("texture", index, f);
            if (model.fields[f].kind == Kind::Texture && nested < int32_t(list("texture").size()))
                texture_depth(nested, depth + 1);
        }
        if (type == Bitmap::model.type) check_image("texture", index, Bitmap::Data);
    }

    void check_image(const std::string &category, int index, int f) {
        const auto &s = shapes_[size_t(value(category, index, f))];
        bool normals = category == "texture" && normals_.count(index) > 0;
        if (s.size() != 3 || (s[2] != 1 && s[2] != out_.channels && !(s[2] == 3 && normals)))
            fail(where(category, index, field(category, index, f).name),
                 out_.channels == 1 ? "a tensor of shape (rows, columns, 1)"
                                    : "a tensor of shape (rows, columns, 1 or 3)",
                 text(s));
    }

    // Without colours a normal map alone has three channels.
    void check_normals(int bsdf) {
        if (out_.channels == 3) return;
        int32_t image = value("bsdf", bsdf, NormalMap::Map);
        const std::string at = where("bsdf", bsdf, "normalmap");
        const std::string &type = list("texture")[size_t(image)].type;
        if (type != Bitmap::model.type) fail(at, "a bitmap, in a scene without colours", "a " + type);
        const auto &s = shapes_[size_t(value("texture", image, Bitmap::Data))];
        if (colours_.count(image)) fail(at, "an image of its own, in a scene without colours", "one that others show");
        if (s[2] != 3) fail(at, "a bitmap of shape (rows, columns, 3)", text(s));
    }

    // Also finds BSDFs that contain themselves.
    void check_bsdfs() {
        for (size_t i = 0; i < list("bsdf").size(); ++i) {
            bsdf_depth(int(i), 0);
            const std::string &type = list("bsdf")[i].type;
            if (type == TwoSided::model.type) {
                for_nested(int(i), [&](int nested, const std::string &at) { check_reflects(nested, at); });
            } else if (type == NormalMap::model.type || type == BumpMap::model.type) {
                if (type == NormalMap::model.type) check_normals(int(i));
                for_nested(int(i), [&](int nested, const std::string &at) { check_turned(nested, at); });
            }
        }
    }

    template <class Visit>
    void for_nested(int bsdf, Visit &&visit) {
        const Model &model = *find_model("bsdf", list("bsdf")[size_t(bsdf)].type)->model;
        for (int f = 0; f < model.n_fields; ++f) {
            if (model.fields[f].kind != Kind::Bsdf) continue;
            int32_t nested = value("bsdf", bsdf, f);
            if (nested >= 0 && nested < int32_t(list("bsdf").size()))
                visit(nested, where("bsdf", bsdf, model.fields[f].name));
        }
    }

    void bsdf_depth(int bsdf, int depth) {
        if (depth > MaxLayers)
            fail(path("bsdf", bsdf), "BSDFs nested at most " + std::to_string(MaxLayers) + " deep",
                 "a deeper or circular nesting");
        for_nested(bsdf, [&](int nested, const std::string &) { bsdf_depth(nested, depth + 1); });
    }

    void check_reflects(int bsdf, const std::string &at) {
        const std::string &type = list("bsdf")[size_t(bsdf)].type;
        for (const Model *model : {&TwoSided::model, &Dielectric::model, &NullBsdf::model, &RoughDielectric::model,
                                   &ThinDielectric::model, &AnisotropicDielectric::model, &MaskBsdf::model})
            if (type == model->type) fail(at, "a bsdf that only reflects", "'" + type + "'");
        for_nested(bsdf, [&](int nested, const std::string &) { check_reflects(nested, at); });
    }

    // Sides are told apart, and normals turned, from the surface's own normal.
    void check_turned(int bsdf, const std::string &at) {
        const std::string &type = list("bsdf")[size_t(bsdf)].type;
        for (const Model *model : {&TwoSided::model, &NormalMap::model, &BumpMap::model})
            if (type == model->type)
                fail(at, "a bsdf other than " + type + ", which may stand around it", "'" + type + "'");
        for_nested(bsdf, [&](int nested, const std::string &) { check_turned(nested, at); });
    }

    void connect_media() {
        const int grid = find_model("volume", GridVolume::model.type)->kind;
        const std::vector<Record> &volumes = out_.records["volume"];
        for (int i = 0; i < int(list("volume").size()); ++i) {
            if (volumes[size_t(i)].kind != grid) continue;
            const auto &s = shapes_[size_t(value("volume", i, GridVolume::Data))];
            if (s.size() != 4 || (s[3] != 1 && s[3] != out_.channels))
                fail(where("volume", i, "data"),
                     out_.channels == 1 ? "a tensor of shape (Z, Y, X, 1)" : "a tensor of shape (Z, Y, X, 1 or 3)",
                     text(s));
        }
        for (int i = 0; i < int(list("medium").size()); ++i) {
            const int32_t *field = out_.records["medium"][size_t(i)].field;
            MediumInfo info{};
            info.extinction = field[MediumFields::Extinction];
            info.albedo = field[MediumFields::Albedo];
            info.emission = field[MediumFields::Emission];
            info.phase = field[MediumFields::PhaseIndex];
            info.scale = field[MediumFields::Scale];
            const Record &extinction = volumes[size_t(info.extinction)];
            if (extinction.kind != grid) {
                info.flags = out_.channels > 1 && !extinction.field[Record::Extra] ? IsChromatic : 0;
            } else {
                if (list("medium")[size_t(i)].type == HomogeneousMedium::model.type)
                    fail(where("medium", i, "sigma_t"), "a constant", "a grid, which a heterogeneous medium may have");
                const auto &shape = out_.tensor_shapes[size_t(extinction.field[GridVolume::Data])];
                const int n[3] = {shape[1], shape[0], shape[3]};
                info.flags = IsGrid | (shape[2] > 1 ? IsChromatic : 0);
                info.cell = majorant_cell(n);
                info.first = out_.n_majorants;
                int64_t cells = 1;
                for (int k = 0; k < 3; ++k) cells *= info.cells[k] = (n[k] + info.cell - 1) / info.cell;
                out_.n_majorants += int(cells);
            }
            out_.media.push_back(info);
        }
    }

    // Voxels along the side of a majorant's cell: small enough to follow the density, large enough that rays do not
    // stop at a cell's border more often than at a collision.
    static int majorant_cell(const int (&n)[3]) {
        int largest = std::max(n[0], std::max(n[1], n[2]));
        return largest >= 64 ? 8 : largest >= 16 ? 4 : 2;
    }

    bool lets_through(int32_t bsdf) const {
        const Record &record = out_.records.at("bsdf")[size_t(bsdf)];
        return record.kind == kind_of_model<NullBsdf>(Bsdfs{});
    }

    void find_enclosed_media() {
        for (const Record &emitter : out_.records["emitter"])
            if (!is_parallel<float>(emitter.kind)) return;
        for (size_t m = 0; m < out_.media.size(); ++m) {
            bool bounded = false, open = false;
            for (const Record &sensor : out_.records["sensor"]) open |= camera_medium(sensor) == int32_t(m);
            for (const ShapeInfo &shape : out_.shapes) {
                if (shape.interior != int32_t(m) && shape.exterior != int32_t(m)) continue;
                bounded = true;
                open |= lets_through(shape.bsdf) || shape.exterior == int32_t(m);
            }
            out_.media[m].enclosed = bounded && !open;
        }
    }

    void connect_shapes() {
        out_.shapes.resize(list("shape").size());
        for (int i = 0; i < int(out_.shapes.size()); ++i) {
            const std::string &type = list("shape")[size_t(i)].type;
            ShapeInfo &info = out_.shapes[size_t(i)];
            info = ShapeInfo{};
            info.first_attribute = -1;
            int bsdf, emitter, flip, interior = PlanarFields::Interior;
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
            if (value("shape", i, flip)) info.flags |= FlipNormals;
            if (info.emitter >= 0 && !(info.flags & IsCurved)) {
                info.cdf_offset = out_.n_cdf_faces;
                out_.n_cdf_faces += info.n_faces;
            }
        }
    }

    void begin_mesh(ShapeInfo &info, int64_t n_vertices, int64_t n_faces, const std::string &at) {
        constexpr int64_t limit = std::numeric_limits<int32_t>::max() / 3;
        if (out_.n_vertices + n_vertices > limit || int64_t(out_.faces.size() / 3) + n_faces > limit)
            fail(at, "a scene of fewer than 2^31 / 3 vertices and faces", "more");
        info.face_offset = int32_t(out_.faces.size() / 3);
        info.n_faces = int32_t(n_faces);
        info.first_vertex = out_.n_vertices;
        out_.n_vertices += int(n_vertices);
    }

    void add_mesh(int i, ShapeInfo &info) {
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

    void add_height_field(int i, ShapeInfo &info) {
        info.flags |= IsHeightField;
        info.heights = value("shape", i, HeightFieldModel::Heights);
        info.interpolation = value("shape", i, HeightFieldModel::Interpolation);
        const auto &s = shapes_[size_t(info.heights)];
        if (s.size() != 2) fail(where("shape", i, "heights"), "a tensor of shape (H, W)", text(s));
        if (value("shape", i, HeightFieldModel::EmitterIndex) >= 0)
            fail(where("shape", i, "emitter"), "none: a height field cannot emit", "an emitter");
    }

    void add_rectangle(int i, ShapeInfo &info) {
        begin_mesh(info, 4, 2, path("shape", i));
        info.flags |= HasTexcoords;
        for (uint32_t corner : {0u, 1u, 2u, 0u, 2u, 3u}) out_.faces.push_back(uint32_t(info.first_vertex) + corner);
        out_.meshes.push_back({i, -1, -1, -1, info.first_vertex, 4});
    }

    void connect_emitters() {
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
    void check_pattern(const std::string &at, int32_t texture) const {
        const Record &record = out_.records.at("texture")[size_t(texture)];
        if (record.kind == int32_t(TextureKind::MeshAttribute))
            fail(at, "a texture with coordinates: this light is no mesh", "a mesh_attribute");
        if (record.kind == int32_t(TextureKind::Volume))
            fail(at, "a texture with coordinates: this light has no surface", "a volume");
        if (record.kind == int32_t(TextureKind::Checkerboard))
            for (int f : {Checkerboard::Color0, Checkerboard::Color1}) check_pattern(at, record.field[f]);
    }

    void check_sensors() {
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

    void check_table(int sensor, const std::string &type, int f, int64_t size) {
        if (list("sensor")[size_t(sensor)].type != type || value("sensor", sensor, f) < 0) return;
        const auto &s = shapes_[size_t(value("sensor", sensor, f))];
        if (s.size() != 1 || s[0] != size)
            fail(where("sensor", sensor, field("sensor", sensor, f).name),
                 "a tensor of shape (" + std::to_string(size) + ",)", text(s));
    }

    void connect_attributes() {
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
            if (s.size() > 2 || s[0] != rows || (s.size() == 2 && s[1] != 1 && s[1] != out_.channels))
                fail(where("attribute", i, "data"),
                     "a tensor of shape (" + std::to_string(rows) + ", 1" + (out_.channels == 3 ? " or 3)" : ")"),
                     text(s));
            out_.attributes.push_back({name, slot, per_face, info.first_attribute});
            info.first_attribute = i;
        }
    }
};

}  // namespace

SceneLayout lay_out(const SceneObjects &objects, const std::vector<std::vector<int64_t>> &param_shapes,
                    const std::vector<IndexArray> &index_arrays, int channels) {
    return Builder(objects, param_shapes, index_arrays, channels).run();
}

}  // namespace tr
