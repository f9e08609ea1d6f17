// Textures in textures and BSDFs in BSDFs: how deep, and what may stand in what.
#include "../core/registry.h"
#include "layout_builder.h"
#include "models.h"

namespace tr {

namespace {

constexpr int MaxTextureDepth = 8;  // of textures in textures, see visit_texture

}  // namespace

// Also finds textures that contain themselves.
void LayoutBuilder::texture_depth(int index, int depth) {
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

void LayoutBuilder::check_image(const std::string &category, int index, int f) {
    const auto &s = shapes_[size_t(value(category, index, f))];
    bool normals = category == "texture" && normals_.count(index) > 0;
    if (s.size() != 3 || (s[2] != 1 && s[2] != out_.texel_channels() && !(s[2] == 3 && normals)))
        fail(where(category, index, field(category, index, f).name),
             "a tensor of shape (rows, columns, " + channel_choices() + ")", text(s));
}

// Without colours a normal map alone has three channels.
void LayoutBuilder::check_normals(int bsdf) {
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
void LayoutBuilder::check_bsdfs() {
    for (size_t i = 0; i < list("bsdf").size(); ++i) {
        bsdf_depth(int(i), 0);
        const std::string &type = list("bsdf")[i].type;
        if (type == TwoSided::model.type) {
            for_nested(int(i), [&](int nested, const std::string &at) { check_reflects(nested, at); });
        } else if (is_bsdf(int(i), PerturbsNormals)) {
            if (type == NormalMap::model.type) check_normals(int(i));
            for_nested(int(i), [&](int nested, const std::string &at) { check_perturbed(nested, at); });
        }
    }
}

void LayoutBuilder::bsdf_depth(int bsdf, int depth) {
    if (depth > MaxBsdfDepth)
        fail(path("bsdf", bsdf), "BSDFs nested at most " + std::to_string(MaxBsdfDepth) + " deep",
             "a deeper or circular nesting");
    for_nested(bsdf, [&](int nested, const std::string &) { bsdf_depth(nested, depth + 1); });
}

// What holds only where a field is given counts where it is.
bool LayoutBuilder::is_bsdf(int bsdf, uint32_t flag) const {
    const Model &model = model_of("bsdf", out_.records.at("bsdf")[size_t(bsdf)]);
    if (!model.is(flag)) return false;
    bool depends = false, given = false;
    for (int f = 0; f < model.n_fields; ++f) {
        if (!(model.fields[f].traits & flag)) continue;
        depends = true;
        given |= list("bsdf")[size_t(bsdf)].ints[size_t(f)] != -1;
    }
    return given || !depends;
}

void LayoutBuilder::check_reflects(int bsdf, const std::string &at) {
    const std::string &type = list("bsdf")[size_t(bsdf)].type;
    if (type == TwoSided::model.type || is_bsdf(bsdf, Transmits))
        fail(at, "a bsdf that only reflects", "'" + type + "'");
    for_nested(bsdf, [&](int nested, const std::string &) { check_reflects(nested, at); });
}

// Sides are told apart, and normals perturbed, from the surface's own normal.
void LayoutBuilder::check_perturbed(int bsdf, const std::string &at) {
    const std::string &type = list("bsdf")[size_t(bsdf)].type;
    if (type == TwoSided::model.type || is_bsdf(bsdf, PerturbsNormals))
        fail(at, "a bsdf other than " + type + ", which may stand around it", "'" + type + "'");
    for_nested(bsdf, [&](int nested, const std::string &) { check_perturbed(nested, at); });
}

}  // namespace tr
