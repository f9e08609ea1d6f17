#include "gradient_requirements.h"

#include <algorithm>
#include <cstring>

#include "../core/registry.h"
#include "models.h"

namespace tr {

namespace {

// Whether rays go elsewhere when a parameter of a BSDF changes, by what its declaration says of the derivative.
bool turns_rays(const Field &field) {
    const char *said = field.derivative;
    return said && (std::strstr(said, "edges seen through") || std::strstr(said, "a normal begins to hide"));
}

}  // namespace

GradientRequirements::GradientRequirements(const SceneLayout &layout, const std::vector<bool> &needs_grad)
    : layout_(layout), needs_grad_(needs_grad) {
    for (const ConstantEntry &e : layout.entries)
        if (needs_grad[size_t(e.slot)]) offsets_.push_back(e.offset);
    std::sort(offsets_.begin(), offsets_.end());
    moved_shapes_.assign(layout.shapes.size(), 0);
    for (size_t i = 0; i < layout.shapes.size(); ++i)
        moved_shapes_[i] = (layout.shapes[i].flags & (IsHeightField | IsSdfGrid)) && tensor(layout.shapes[i].heights);
    for (const MeshSource &mesh : layout.meshes)
        moved_shapes_[size_t(mesh.shape)] =
            tensor(mesh.vertices) || tensor(mesh.normals) || tensor(mesh.texcoords) || tensor(mesh.radii);
}

bool GradientRequirements::number(int32_t offset) const {
    return std::binary_search(offsets_.begin(), offsets_.end(), offset);
}

bool GradientRequirements::any_number(const char *category, size_t index, std::initializer_list<Kind> kinds) const {
    const Record &record = layout_.records.at(category)[index];
    const Model &model = model_of(category, record);
    for (int f = 0; f < model.n_fields; ++f)
        if (std::find(kinds.begin(), kinds.end(), model.fields[f].kind) != kinds.end() && number(record.field[f]))
            return true;
    return false;
}

bool GradientRequirements::values(const char *category, size_t index) const {
    if (any_number(category, index, {Kind::Spectrum, Kind::Float, Kind::Point, Kind::Vector})) return true;
    const Record &record = layout_.records.at(category)[index];
    const Model &model = model_of(category, record);
    for (int f = 0; f < model.n_fields; ++f) {
        Kind kind = model.fields[f].kind;
        if ((kind == Kind::Texture || kind == Kind::Scalar) && values("texture", size_t(record.field[f]))) return true;
        if (record.field[f] >= 0 && ((kind == Kind::Volume && values("volume", size_t(record.field[f]))) ||
                                     (kind == Kind::Phase && values("phase", size_t(record.field[f])))))
            return true;
        if (kind == Kind::Tensor && tensor(record.field[f])) return true;
    }
    if (std::string("texture") == category && std::string("mesh_attribute") == model.type)
        for (const AttributeInfo &a : layout_.attributes)
            if (a.name == record.field[MeshAttribute::Name] && needs_grad_[size_t(a.tensor)]) return true;
    return false;
}

uint32_t GradientRequirements::variables(size_t bsdf, const BsdfInfo &info, bool moves) const {
    const Record &record = layout_.records.at("bsdf")[bsdf];
    uint32_t r = 0;
    for (int i = 0; i < info.n_differentiable; ++i) {
        const int32_t at = record.field[i];
        const bool counts = info.use[i] == BsdfInfo::Number
                                ? number(at)
                                : values("texture", size_t(at)) || (moves && lookup_varies(size_t(at)));
        if (counts) r |= 1u << i;
    }
    if (info.luminance_of >= 0 && (r >> info.luminance_of & 1)) r |= 1u << info.n_differentiable;
    return r;
}

bool GradientRequirements::point_position() const {
    for (size_t i = 0; i < layout_.records.at("emitter").size(); ++i)
        if (any_number("emitter", i, {Kind::Point})) return true;
    return false;
}

MediumNeeds GradientRequirements::medium(size_t index) const {
    const MediumInfo &m = layout_.media[index];
    if (m.flags & Bends) return {};  // no points are sampled in it, see motion()
    auto volume = [&](int32_t i) { return i >= 0 && values("volume", size_t(i)); };
    return {volume(m.extinction) || number(m.scale), volume(m.albedo), volume(m.emission),
            values("phase", size_t(m.phase))};
}

bool GradientRequirements::shape(size_t index) const { return moved_shapes_[index] || shape_matrix(index); }
bool GradientRequirements::shape_matrix(size_t index) const {
    return any_number("shape", index, {Kind::Transform, Kind::Point, Kind::Float});
}

bool GradientRequirements::camera(size_t sensor) const {
    if (any_number("sensor", sensor, {Kind::Float, Kind::Transform})) return true;
    const Record &record = layout_.records.at("sensor")[sensor];
    const Model &model = model_of("sensor", record);
    for (int f = 0; f < model.n_fields; ++f)
        if (model.fields[f].kind == Kind::Tensor && tensor(record.field[f])) return true;
    return false;
}

bool GradientRequirements::motion(size_t sensor) const {
    if (camera(sensor)) return true;
    for (size_t i = 0; i < layout_.shapes.size(); ++i)
        if (shape(i)) return true;
    auto any = [&](const char *category, std::initializer_list<Kind> kinds) {
        for (size_t i = 0; i < layout_.records.at(category).size(); ++i)
            if (any_number(category, i, kinds)) return true;
        return false;
    };
    for (size_t m = 0; m < layout_.media.size(); ++m) {  // bent light comes to other places
        if (!(layout_.media[m].flags & Bends)) continue;
        const int32_t index = layout_.records.at("medium")[m].field[field_index(GradientIndexMedium::fields, "index")];
        if (needs_grad_[size_t(index)] || any_number("medium", m, {Kind::Float, Kind::Transform})) return true;
        // what varies along a ray needs its way back
        const MediumInfo &info = layout_.media[m];
        for (const int32_t volume : {info.extinction, info.emission})
            if (volume >= 0 && values("volume", size_t(volume))) return true;
    }
    // maps of texture coordinates and factors of attributes; places of volumes; the environment's rotation; what turns
    // delta lobes and shading normals
    if (any("texture", {Kind::Transform2, Kind::Float}) || any("volume", {Kind::Transform}) ||
        any("emitter", {Kind::Transform}))
        return true;
    const std::vector<Record> &bsdfs = layout_.records.at("bsdf");
    for (size_t i = 0; i < bsdfs.size(); ++i) {
        const Model &model = model_of("bsdf", bsdfs[i]);
        for (int f = 0; f < model.n_fields; ++f) {
            if (!turns_rays(model.fields[f])) continue;
            const int32_t at = bsdfs[i].field[f];
            if (model.fields[f].kind == Kind::Float ? number(at) : values("texture", size_t(at))) return true;
        }
    }
    return false;
}

bool GradientRequirements::lookup_varies(size_t texture) const {
    const Record &record = layout_.records.at("texture")[texture];
    const bool nearest = record.kind == kind_of_model<Bitmap>(Textures{}) && record.field[Bitmap::Filter] == 1;
    return record.kind != kind_of_model<ConstantTexture>(Textures{}) && !nearest;
}

bool GradientRequirements::emitters_vary() const {
    for (const Record &record : layout_.records.at("emitter")) {
        const Model &model = model_of("emitter", record);
        for (int f = 0; f < model.n_fields; ++f) {
            const Kind kind = model.fields[f].kind;
            if (kind == Kind::Tensor || kind == Kind::Transform) return true;
            if ((kind == Kind::Texture || kind == Kind::Scalar) && lookup_varies(size_t(record.field[f]))) return true;
        }
    }
    return false;
}

GeometrySizes GradientRequirements::geometry_sizes() const {
    GeometrySizes r;
    size_t n = size_t(layout_.n_vertices);
    for (const MeshSource &mesh : layout_.meshes) {
        bool rectangle = mesh.vertices < 0;
        if (rectangle ? shape(size_t(mesh.shape)) : tensor(mesh.vertices)) r.positions = 3 * n;
        if (tensor(mesh.normals) || tensor(mesh.radii)) r.normals = 3 * n;
        if (tensor(mesh.texcoords)) r.texcoords = 2 * n;
    }
    return r;
}

}  // namespace tr
