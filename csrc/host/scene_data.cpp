#include "scene_data.h"

#include <algorithm>
#include <cmath>

#include "../core/emitter/envmap.h"
#include "../core/registry.h"
#include "models.h"

namespace tr {

template <class S>
void SceneData<S>::build(const Objects &objects, const std::vector<std::vector<int64_t>> &param_shapes,
                         const std::vector<IndexArray> &index_arrays, int channels, SceneData *previous,
                         bool spectral) {
    SceneLayout layout = lay_out(objects, param_shapes, index_arrays, channels, spectral);
    std::unique_ptr<Accel> accel = std::make_unique<Accel>();
    accel_ = std::move(accel);
    layout_ = std::move(layout);
    all_dirty_ = geometry_dirty_ = environment_dirty_ = true;
    environment_ = {};
    tensors_.resize(layout_.slot_sizes.size());
    for (size_t i = 0; i < tensors_.size(); ++i) {
        tensors_[i].data = tensors_[i].base = nullptr;
        std::copy(layout_.tensor_shapes[i].begin(), layout_.tensor_shapes[i].end(), tensors_[i].shape);
    }
    constants_.assign(layout_.constants.begin(), layout_.constants.end());
    mean_texels_.clear();
    by_weight_ = by_power_ = {};
    allocate_geometry();
    if (previous && previous->accel_) take_over(*previous);
    refresh_view();
}

template <class S>
void SceneData<S>::allocate_geometry() {
    size_t n_vertices = size_t(layout_.n_vertices), n_shapes = layout_.shapes.size();
    shapes_ = layout_.shapes;
    vertices_.assign(n_vertices, VertexRow<S>{});
    matrices_.assign(n_shapes * 24, S(0));
    areas_.assign(n_shapes, S(0));
    dark_.assign(n_shapes, 0);
    heights_.assign(n_shapes, {});
    area_cdf_.assign(size_t(layout_.n_cdf_faces), S(0));
}

template <class S>
bool SceneData<S>::same_geometry(const SceneData &other) const {
    const SceneLayout &a = layout_, &b = other.layout_;
    auto same_mesh = [](const MeshSource &x, const MeshSource &y) {
        return x.shape == y.shape && x.vertices == y.vertices && x.normals == y.normals && x.texcoords == y.texcoords &&
               x.first_vertex == y.first_vertex && x.n_vertices == y.n_vertices && x.radii == y.radii;
    };
    auto same_shape = [&](const ShapeInfo &x, const ShapeInfo &y) {
        if (x.flags & y.flags & (IsHeightField | IsSdfGrid))
            return x.flags == y.flags && x.heights == y.heights && x.interpolation == y.interpolation &&
                   a.tensor_shapes[size_t(x.heights)] == b.tensor_shapes[size_t(y.heights)];
        return x.flags == y.flags && x.face_offset == y.face_offset && x.n_faces == y.n_faces &&
               x.first_vertex == y.first_vertex && x.cdf_offset == y.cdf_offset && x.emitter == y.emitter;
    };
    return std::equal(a.meshes.begin(), a.meshes.end(), b.meshes.begin(), b.meshes.end(), same_mesh) &&
           std::equal(a.shapes.begin(), a.shapes.end(), b.shapes.begin(), b.shapes.end(), same_shape) &&
           a.faces == b.faces;
}

template <class S>
void SceneData<S>::take_over(SceneData &previous) {
    counters_ = previous.counters();
    rebuilt_ = true;
    if (previous.all_dirty_ || constants_.size() != previous.constants_.size()) return;
    all_dirty_ = false;
    constants_ = previous.constants_;
    if (!previous.environment_dirty_ && layout_.environment == previous.layout_.environment) {
        std::swap(environment_, previous.environment_);
        environment_dirty_ = false;
        previous.environment_dirty_ = true;
    }
    if (!previous.geometry_dirty_ && same_geometry(previous)) {
        counters_.accel = previous.counters_.accel;  // the structure brings its own
        std::swap(accel_, previous.accel_);
        std::swap(shapes_, previous.shapes_);
        std::swap(dark_, previous.dark_);
        std::swap(heights_, previous.heights_);
        std::swap(vertices_, previous.vertices_);
        for (auto member : {&SceneData::matrices_, &SceneData::areas_, &SceneData::area_cdf_})
            std::swap(this->*member, previous.*member);
        for (size_t i = 0; i < shapes_.size(); ++i) {
            const ShapeInfo &now = layout_.shapes[i];
            shapes_[i].bsdf = now.bsdf, shapes_[i].interior = now.interior, shapes_[i].exterior = now.exterior;
        }
        geometry_dirty_ = false;
        previous.geometry_dirty_ = previous.rebuilt_ = true;
    }
}

template <class S>
typename SceneData<S>::Counters SceneData<S>::counters() const {
    Counters all = counters_;
    if (accel_) {
        all.accel.builds += accel_->counters().builds;
        all.accel.refits += accel_->counters().refits;
        all.accel.rebuilds += accel_->counters().rebuilds;
    }
    return all;
}

template <class S>
void SceneData<S>::update(const std::vector<const S *> &params, const std::vector<uint8_t> &dirty, bool look,
                          const std::vector<uint8_t> &elsewhere) {
    if (!accel_) throw std::invalid_argument("scene: update before build");
    if (params.size() != n_params() || dirty.size() != n_params())
        bad_value("scene: update", std::to_string(n_params()) + " parameters", std::to_string(params.size()));
    for (size_t i = 0; i < params.size(); ++i)
        if (!params[i] && layout_.slot_sizes[i] > 0) bad_value("parameter " + std::to_string(i), "an address", "null");

    // until the end is reached nothing counts as up to date
    const std::vector<uint8_t> all(params.size(), 1), changed = all_dirty_ ? all
                                                                : look     ? with_silent_changes(params, dirty)
                                                                           : dirty;
    for (size_t i = 0; i < params.size(); ++i)
        if (changed[i]) mean_texels_.erase(int(i));
    bool first = all_dirty_ || geometry_dirty_, new_environment = all_dirty_ || environment_dirty_;
    all_dirty_ = true;
    for (const ParameterUse &use : layout_.tensors)
        if (changed[size_t(use.slot)] && (elsewhere.empty() || !elsewhere[size_t(use.slot)]))
            require_finite(params[size_t(use.slot)], layout_.slot_sizes[size_t(use.slot)], use.where);
    std::vector<S> old = constants_;
    read_constants(params);
    update_shapes(params, first ? all : changed, old, first);
    update_environment(params, new_environment ? all : changed);
    update_emitters();
    update_light_boxes();
    update_ball();
    update_media(first ? all : changed);
    update_phases(first ? all : changed);
    update_bsdfs();
    refresh_view();
    update_light_cells();
    update_bends();
    all_dirty_ = geometry_dirty_ = environment_dirty_ = false;
}

// `dirty`, and what was written without a word (through `.data` in torch, or an array that shares the memory) of the
// tensors that something is derived from.
template <class S>
std::vector<uint8_t> SceneData<S>::with_silent_changes(const std::vector<const S *> &params,
                                                       std::vector<uint8_t> dirty) const {
    auto compare = [&](int slot, size_t n, const S *copy) {
        if (slot >= 0 && !dirty[size_t(slot)]) dirty[size_t(slot)] = !std::equal(copy, copy + n, params[size_t(slot)]);
    };
    for (const MeshSource &mesh : layout_.meshes) {
        // a few rows at a time, which stay in the cache for all of their columns
        constexpr int32_t Rows = 256;
        auto compare_rows = [&](int slot, auto column, int32_t begin, int32_t end) {
            if (slot >= 0 && !dirty[size_t(slot)])
                dirty[size_t(slot)] = !same_rows(mesh, column, params[size_t(slot)], begin, end);
        };
        for (int32_t begin = 0; begin < mesh.n_vertices; begin += Rows) {
            int32_t end = std::min(begin + Rows, mesh.n_vertices);
            compare_rows(mesh.vertices, &VertexRow<S>::p, begin, end);
            compare_rows(mesh.normals, &VertexRow<S>::n, begin, end);
            compare_rows(mesh.texcoords, &VertexRow<S>::uv, begin, end);
        }
        if (mesh.radii >= 0 && !dirty[size_t(mesh.radii)])
            dirty[size_t(mesh.radii)] = !same_radii(mesh, params[size_t(mesh.radii)]);
    }
    for (size_t i = 0; i < layout_.shapes.size(); ++i) {
        const ShapeInfo &shape = layout_.shapes[i];
        if (!(shape.flags & (IsHeightField | IsSdfGrid)) || dirty[size_t(shape.heights)]) continue;
        const int64_t n = layout_.slot_sizes[size_t(shape.heights)];
        dirty[size_t(shape.heights)] = fingerprint(params[size_t(shape.heights)], n) != heights_[i].fingerprint;
    }
    if (layout_.environment >= 0 && !environment_.texels.empty()) {
        const Record &record = layout_.records.at("emitter")[size_t(layout_.environment)];
        compare(record.field[EnvironmentMap::Data], environment_.texels.size(), environment_.texels.data());
    }
    return dirty;
}

template <class S>
void SceneData<S>::read_constants(const std::vector<const S *> &params) {
    for (size_t i = 0; i < layout_.entries.size(); ++i) {
        const ConstantEntry &e = layout_.entries[i];
        const S *from = params[size_t(e.slot)];
        const std::string &where = layout_.entry_where[i];
        require_finite(from, e.count, where);
        if (e.count == 16 && (from[12] != 0 || from[13] != 0 || from[14] != 0 || from[15] != 1))
            bad_value(where, "an affine matrix, whose last row is 0 0 0 1", "another last row");
    }
    fill_values(params, constants_, tensors_);
    for (size_t i = 0; i < constants_.size(); ++i) constants_[i] += S(layout_.constants[i]);
}

template <class S>
void SceneData<S>::fill_values(const std::vector<const S *> &tangents, std::vector<S> &constants,
                               std::vector<TensorView<S>> &tensors) const {
    constants.assign(layout_.constants.size(), S(0));
    for (const ConstantEntry &e : layout_.entries) {
        const S *from = tangents[size_t(e.slot)];
        if (!from) continue;
        for (int i = 0; i < e.stored; ++i) constants[size_t(e.offset + i)] = from[e.count == 1 ? 0 : i];
    }
    tensors.resize(layout_.slot_sizes.size());
    for (size_t i = 0; i < tensors.size(); ++i) {
        tensors[i].data = tangents[i], tensors[i].base = nullptr;
        std::copy(layout_.tensor_shapes[i].begin(), layout_.tensor_shapes[i].end(), tensors[i].shape);
    }
}

template <class S>
void SceneData<S>::update_environment(const std::vector<const S *> &params, const std::vector<uint8_t> &dirty) {
    if (layout_.environment < 0) return;
    const Record &record = layout_.records.at("emitter")[size_t(layout_.environment)];
    Affine to_world{{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
    if (record.kind == kind_of_model<EnvironmentMap>(Emitters{})) {
        std::copy_n(&constants_[size_t(record.field[EnvironmentMap::ToWorld])], 12, to_world.m);
        int slot = record.field[EnvironmentMap::Data];
        if (dirty[size_t(slot)]) {
            environment_.build(tensors_[size_t(slot)]);
            const S *texels = params[size_t(slot)];
            environment_.texels.assign(texels, texels + layout_.slot_sizes[size_t(slot)]);
            ++counters_.environments;
        }
    }
    Affine to_local = to_world.inverse(path("emitter", layout_.environment) + ": field 'to_world'");
    std::copy_n(to_world.m, 12, env_to_world_);
    std::copy_n(to_local.m, 12, env_to_local_);
}

template <class S>
void SceneData<S>::update_ball() {
    float box[6];
    accel_->bounds(box);
    double squared = 0;
    for (int k = 0; k < 3; ++k) {
        bool any = box[k] <= box[3 + k];
        view_.center[k] = any ? S((double(box[k]) + double(box[3 + k])) / 2) : S(0);
        double half = any ? (double(box[3 + k]) - double(box[k])) / 2 : 0;
        squared += half * half;
    }
    view_.radius = S(std::sqrt(squared) * 1.001 + 1e-6);
}

template <class S>
void SceneData<S>::bounds(S out[6]) const {
    float box[6];
    accel_->bounds(box);
    std::copy_n(box, 6, out);
}

template <class S>
void SceneData<S>::refresh_view() {
    auto count = [&](const char *category) { return int32_t(layout_.records.at(category).size()); };
    view_.values = {constants_.data(), tensors_.data()};
    for_tables([&](auto member, auto *table, size_t) { view_.*member = table; });
    view_.n_textures = count("texture"), view_.n_bsdfs = count("bsdf");
    view_.n_emitters = count("emitter"), view_.n_sensors = count("sensor");
    view_.n_shapes = int32_t(shapes_.size());
    view_.n_media = int32_t(layout_.media.size());
    const auto &textures = layout_.records.at("texture");
    view_.textured = std::any_of(textures.begin(), textures.end(),
                                 [](const Record &r) { return r.kind != int32_t(TextureKind::Constant); });
    const auto &bsdfs = layout_.records.at("bsdf");
    view_.has_stacks = std::any_of(bsdfs.begin(), bsdfs.end(), [](const Record &r) { return r.kind > TwoSidedKind; });
    view_.follows_tangent = std::any_of(bsdfs.begin(), bsdfs.end(), [&](const Record &r) {
        if (!model_of("bsdf", r).is(FollowsTangent)) return false;
        const int by = bsdf_kernels<PacketOf<S>>(r.kind).tangent_of;
        return by < 0 || !is_default(textures[size_t(r.field[by])]);
    });
    const auto &emitters = layout_.records.at("emitter");
    view_.polarized_lights = std::any_of(emitters.begin(), emitters.end(), [&](const Record &r) {
        const int field = emitter_kernels<PacketOf<S>>(r.kind).stokes;
        return field >= 0 && std::any_of(layout_.entries.begin(), layout_.entries.end(),
                                         [&](const ConstantEntry &e) { return e.offset == r.field[field]; });
    });
    for (const Record &sensor : layout_.records.at("sensor")) view_.textured |= sensor.kind == IrradianceMeterKind;
    choose_emitters(false);
    view_.environment = layout_.environment;
    view_.n_light_boxes = n_light_boxes_;
    view_.env_columns = environment_.columns;
    view_.env_rows = environment_.rows;
}

#define TR_INSTANTIATE(S) template class SceneData<S>;
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
