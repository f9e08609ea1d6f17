// How `lay_out` goes about it. Its parts are in files of their own: records and constants (layout.cpp), textures and
// BSDFs in each other (layout_nesting.cpp), shapes (layout_shapes.cpp), media (layout_media.cpp), emitters and sensors
// (layout_links.cpp).
#pragma once

#include <set>
#include <stdexcept>

#include "layout.h"
#include "models.h"

namespace tr {

class LayoutBuilder {
public:
    LayoutBuilder(const SceneObjects &objects, const std::vector<std::vector<int64_t>> &shapes,
                  const std::vector<IndexArray> &arrays, int channels, bool spectral)
        : objects_(objects), shapes_(shapes), arrays_(arrays) {
        out_.channels = channels;
        out_.spectral = spectral;
    }

    SceneLayout run();

private:
    const SceneObjects &objects_;
    const std::vector<std::vector<int64_t>> &shapes_;
    const std::vector<IndexArray> &arrays_;
    SceneLayout out_;
    std::set<int64_t> normals_, colours_;  // textures that are looked up as vectors, and those that are as colours

    [[noreturn]] static void fail(const std::string &where, const std::string &expected, const std::string &got) {
        throw std::invalid_argument(where + ": expected " + expected + ", got " + got);
    }
    static std::string text(const std::vector<int64_t> &shape);  // for messages
    std::string channel_choices() const {
        return out_.channels == 1 ? "1" : "1 or " + std::to_string(out_.texel_channels());
    }

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

    // layout.cpp
    void describe_slots();
    const std::vector<int64_t> &slot_shape(int64_t slot, const std::string &at) const;
    void make_record(const std::string &category, int index);
    int32_t resolve(const Field &f, int64_t given, const std::string &at);
    static std::string number(double x);
    int32_t reference(const std::string &category, int64_t given, bool optional, const std::string &at);
    int32_t default_constant(const char *category, const std::string &type, const Field &f);
    int32_t default_phase();
    int32_t constant(const Field &f, int64_t given, const std::string &at);

    // layout_nesting.cpp
    void texture_depth(int index, int depth);
    void check_image(const std::string &category, int index, int f);
    void check_normals(int bsdf);
    void check_bsdfs();
    void bsdf_depth(int bsdf, int depth);
    bool is_bsdf(int bsdf, uint32_t flag) const;
    void check_reflects(int bsdf, const std::string &at);
    void check_perturbed(int bsdf, const std::string &at);

    // layout_shapes.cpp
    void connect_shapes();
    void begin_mesh(ShapeInfo &info, int64_t n_vertices, int64_t n_faces, const std::string &at);
    void add_mesh(int i, ShapeInfo &info);
    void add_height_field(int i, ShapeInfo &info);
    void add_curve(int i, ShapeInfo &info);
    void add_sdf_grid(int i, ShapeInfo &info);
    void check_without_coordinates(int bsdf, const std::string &at);
    void add_rectangle(int i, ShapeInfo &info);
    void connect_attributes();

    // layout_media.cpp
    void connect_media();
    void check_extinction(int medium, const MediumInfo &info);
    void bound_bending(ShapeInfo &info);
    static int majorant_cell(const int (&n)[3]);
    bool lets_through(int32_t bsdf) const;
    void find_enclosed_media();

    // layout_links.cpp
    void connect_emitters();
    void connect_emitter(int emitter, int shape);
    void check_pattern(const std::string &at, int32_t texture) const;
    void check_sensors();
    void check_table(int sensor, const std::string &type, int f, int64_t size);
};

}  // namespace tr
