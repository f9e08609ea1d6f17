// What a derivative needs of a scene: which parts of it, from the addresses of gradients or tangents that are given,
// and these in the layouts that the core uses.
#pragma once

#include "core/registry.h"
#include "host/gradient_requirements.h"
#include "host/scene_data.h"
#include "render.h"

namespace tr {

// One a parameter, by the number of its slot; 0: not given.
using Addresses = std::vector<uintptr_t>;

template <class S>
std::vector<const S *> read_only(const Addresses &addresses) {
    std::vector<const S *> r;
    for (uintptr_t a : addresses) r.push_back(reinterpret_cast<const S *>(a));
    return r;
}

// Large tensors, used where they lie.
template <class S>
std::vector<S *> tensors_of(const SceneData<S> &data, const Addresses &addresses) {
    std::vector<S *> r(addresses.size(), nullptr);
    for (const ParameterUse &use : data.layout().tensors)
        r[size_t(use.slot)] = reinterpret_cast<S *>(addresses[size_t(use.slot)]);
    return r;
}

// `light`: of light paths.
template <class S>
DerivativeCall<S> derivative_call(const SceneData<S> &data, const PathConfig &path, bool light,
                                  const Addresses &addresses) {
    const SceneLayout &layout = data.layout();
    auto count = [&](const char *category) { return layout.records.at(category).size(); };
    std::vector<bool> needs_grad;
    for (uintptr_t a : addresses) needs_grad.push_back(a != 0);
    const GradientRequirements requires_(layout, needs_grad);
    DerivativeCall<S> d;
    d.sizes = layout.slot_sizes;
    GradientNeeds &needs = d.needs;
    needs = {false, false, requires_.point_position(), false, false, {}};
    for (size_t i = 0; i < layout.media.size() && path.volumetric; ++i) {
        const MediumNeeds medium = requires_.medium(i);
        needs.medium.extinction |= medium.extinction;
        needs.medium.albedo |= medium.albedo;
        needs.medium.emission |= medium.emission;
        needs.medium.phase |= medium.phase;
    }
    if (path.sensor < count("sensor")) {
        // a light that moves changes what is on its way through media
        needs.geometry = requires_.motion(path.sensor) || ((light || path.volumetric) && needs.light_position);
        needs.camera = requires_.camera(path.sensor);
    }
    d.variables.assign(FirstWrapper, 0);
    for (size_t i = 0; i < count("bsdf"); ++i) {
        d.bsdfs.push_back(requires_.values("bsdf", i));
        needs.bsdf |= d.bsdfs.back() != 0;
        const int kind = layout.records.at("bsdf")[i].kind;
        if (kind >= FirstWrapper || !(d.bsdfs.back() || needs.geometry)) continue;
        d.variables[size_t(kind)] |= requires_.variables(i, bsdf_kernels<PacketOf<S>>(kind), needs.geometry);
    }
    for (size_t i = 0; i < count("emitter"); ++i) needs.emitter |= requires_.values("emitter", i);
    const bool bsdfs_alone = needs.bsdf && !needs.emitter && !needs.numbers() && !needs.camera;  // see Wavefront
    if (bsdfs_alone && !light && !path.volumetric && !path.stokes && path.max_depth > 2)
        d.boxes = data.boxes_with(d.bsdfs);
    needs.black_light = needs.emitter || (needs.geometry && requires_.emitters_vary());
    for (size_t i = 0; i < layout.shapes.size(); ++i)
        d.shapes.push_back((requires_.shape(i) ? ShapeMoves : 0) | (requires_.shape_matrix(i) ? MatrixMoves : 0));
    d.geometry_sizes = requires_.geometry_sizes();
    d.matrices = uint32_t(data.n_constants());
    d.n_constants = data.n_constants() + 12 * layout.shapes.size();
    return d;
}

// Gradients of large tensors are added to where they lie, the others by add_gradients.
template <class S>
DerivativeCall<S> reverse_call(const SceneData<S> &data, const PathConfig &path, bool light,
                               const Addresses &gradients) {
    DerivativeCall<S> d = derivative_call(data, path, light, gradients);
    d.gradients = tensors_of(data, gradients);
    for (const MeshSource &mesh : data.layout().meshes)  // these have tables of their own
        for (int slot : {mesh.vertices, mesh.normals, mesh.texcoords})
            if (slot >= 0) d.gradients[size_t(slot)] = nullptr;
    return d;
}

template <class S>
void add_gradients(const SceneData<S> &data, DerivativeCall<S> &d, const Addresses &gradients, int threads) {
    if (d.sums.constants.empty()) return;
    if (d.needs.geometry) data.spread_geometry(d.sums, tensors_of(data, gradients), threads);
    for (const ConstantEntry &e : data.constant_entries()) {
        S *to = reinterpret_cast<S *>(gradients[size_t(e.slot)]);
        if (!to) continue;
        for (int i = 0; i < e.stored; ++i) to[e.count == 1 ? 0 : i] += S(d.sums.constants[size_t(e.offset + i)]);
    }
}

// Tangents in the layouts that the core reads them in, which the call refers to.
template <class S>
struct ForwardCall {
    GeometryArrays<S> arrays;
    std::vector<TensorView<S>> tensors;
    DerivativeCall<S> call;

    ForwardCall(const SceneData<S> &data, const PathConfig &path, bool light, const Addresses &tangents)
        : call(derivative_call(data, path, light, tangents)) {
        data.fill_values(read_only<S>(tangents), arrays.constants, tensors);
        for (size_t i = 0; i < tensors.size(); ++i) tensors[i].base = data.view().values.tensors[i].data;
        if (call.needs.geometry) data.fill_geometry(read_only<S>(tangents), call.geometry_sizes, arrays);
        call.tangent = {arrays.constants.data(), tensors.data()};
        const std::vector<S> *vertices[VertexArrays] = {&arrays.positions, &arrays.normals, &arrays.texcoords};
        for (int k = 0; k < VertexArrays; ++k)
            call.vertex_tangent[k] = vertices[k]->empty() ? nullptr : vertices[k]->data();
    }
    ForwardCall(const ForwardCall &) = delete;
};

}  // namespace tr
