// The output `albedo`: a texture of the BSDF, white where that has none, and of mixtures the mixture.
#pragma once

#include "core/adjoint/lookup.h"
#include "core/integrator/layers.h"

namespace tr {

namespace detail {

// The texture that is the albedo of a BSDF; -1 where it is white.
template <class F, class S, class... Models>
TR_INLINE IntOf<F> albedo_texture(TypeList<Models...>, const SceneView<S> &scene, const IntOf<F> &bsdf,
                                  const MaskOf<F> &active) {
    using I = IntOf<F>;
    I kind = record_kind<F>(scene.bsdfs, bsdf, active), texture(-1);
    int k = 0;
    auto look = [&](auto model) {
        using Model = decltype(model);
        auto same = active && mask<F>(kind == k++);
        if constexpr (Model::Albedo >= 0)
            if (any(same))
                texture = select(mask<I>(same), record_field<F>(scene.bsdfs, Model::Albedo, bsdf, same), texture);
    };
    (look(Models{}), ...);
    return texture;
}

// The BSDF below `twosided` and normal maps: a leaf, a blend or a mask. A mask's hole is white.
template <class F, class S>
IntOf<F> below_sides(const SceneView<S> &scene, IntOf<F> bsdf, const MaskOf<F> &back, const MaskOf<F> &active) {
    using I = IntOf<F>;
    for (int depth = 0; depth < MaxLayers; ++depth) {
        RecordLanes<F> record(scene.bsdfs, bsdf, active);
        Leaf<F> side = resolve_bsdf<F>(scene, bsdf, back, active);
        auto turns = active && (mask<F>(record.kind() == NormalMapKind) || mask<F>(record.kind() == BumpMapKind));
        I next = select(mask<I>(turns), record.field(NormalMap::Nested), side.bsdf);
        if (!any(active && mask<F>(next != bsdf))) break;
        bsdf = next;
    }
    return bsdf;
}

template <int C, class F, class S>
Color<F, C> eval_albedo(const SceneView<S> &scene, const IntOf<F> &root, const MaskOf<F> &back,
                        const TexturedPoint<F> &at, const MaskOf<F> &active, int depth = 0) {
    IntOf<F> bsdf = below_sides<F>(scene, root, back, active);
    IntOf<F> texture = albedo_texture<F>(Bsdfs{}, scene, bsdf, active);
    auto textured = active && mask<F>(texture >= 0);
    Color<F, C> r =
        select(textured, eval_texture<C>(scene, scene.values, texture, at, textured), uniform_color<C>(F(1)));
    if (!scene.layered || depth == MaxLayers) return r;
    RecordLanes<F> record(scene.bsdfs, bsdf, active);
    auto blend = active && mask<F>(record.kind() == BlendKind), masked = active && mask<F>(record.kind() == MaskKind);
    auto mixed = blend || masked;
    if (!any(mixed)) return r;
    F w = branch_weight<C>(scene, record.field(BlendBsdf::Weight), at, mixed);
    Color<F, C> first = uniform_color<C>(F(1)), second = first;
    if (any(blend)) {
        first = eval_albedo<C>(scene, record.field(BlendBsdf::First), back, at, blend, depth + 1);
        second = eval_albedo<C>(scene, record.field(BlendBsdf::Second), back, at, blend, depth + 1);
    }
    if (any(masked))
        second =
            select(masked, eval_albedo<C>(scene, record.field(MaskBsdf::Nested), back, at, masked, depth + 1), second);
    first = select(masked, uniform_color<C>(F(1)), first);
    return select(mixed, first * (F(1) - w) + second * w, r);
}

// `g` is the adjoint of the albedo; with `values` that of textures is given to the sink, with `motion` that of where
// they are looked up is added to `to`.
template <int C, class F, class S, class Sink>
void sweep_albedo(const SceneView<S> &scene, const IntOf<F> &root, const MaskOf<F> &back, const TexturedPoint<F> &at,
                  const Color<F, C> &g, bool values, bool motion, const MaskOf<F> &active, CoordinateAdjoint<F> &to,
                  Sink &sink, int depth = 0) {
    IntOf<F> bsdf = below_sides<F>(scene, root, back, active);
    IntOf<F> texture = albedo_texture<F>(Bsdfs{}, scene, bsdf, active);
    auto textured = active && mask<F>(texture >= 0);
    if (any(textured)) {
        if (values) sink.texture(scene, texture, at, g, textured);
        if (motion) sweep_lookup<C>(scene, texture, at, g, textured, to, sink);
    }
    if (!scene.layered || depth == MaxLayers) return;
    RecordLanes<F> record(scene.bsdfs, bsdf, active);
    auto blend = active && mask<F>(record.kind() == BlendKind), masked = active && mask<F>(record.kind() == MaskKind);
    auto mixed = blend || masked;
    if (!any(mixed)) return;
    IntOf<F> weight = record.field(BlendBsdf::Weight), second = record.field(BlendBsdf::Second);
    second = select(mask<IntOf<F>>(masked), record.field(MaskBsdf::Nested), second);
    F w = branch_weight<C>(scene, weight, at, mixed);
    Color<F, C> a = uniform_color<C>(F(1)), b = eval_albedo<C>(scene, second, back, at, mixed, depth + 1);
    if (any(blend)) {
        a = select(blend, eval_albedo<C>(scene, record.field(BlendBsdf::First), back, at, blend, depth + 1), a);
        sweep_albedo(scene, record.field(BlendBsdf::First), back, at, g * (F(1) - w), values, motion, blend, to, sink,
                     depth + 1);
    }
    sweep_albedo(scene, second, back, at, g * w, values, motion, mixed, to, sink, depth + 1);
    Color<F, C> by_weight = g * (b - a);
    if (values) sink.scalar_texture(scene, weight, at, by_weight, mixed);
    if (motion) sweep_lookup<C>(scene, weight, at, luminance_adjoint(by_weight), mixed, to, sink);
}

}  // namespace detail

}  // namespace tr
