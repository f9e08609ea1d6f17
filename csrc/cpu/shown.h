// The outputs that show what BSDFs look up: albedo, specular reflectance, roughness; of mixtures the mixture.
#pragma once

#include <string_view>

#include "aov.h"
#include "core/adjoint/lookup.h"
#include "core/integrator/layers.h"

namespace tr {

namespace detail {

// The field of this name, -1 if a model has none.
template <class Model>
constexpr int field_named(std::string_view name) {
    if constexpr (Model::model.n_fields > 0)
        for (int i = 0; i < Model::model.n_fields; ++i)
            if (name == Model::fields[i].name) return i;
    return -1;
}

// Which field of a model an output shows: of its roughness by the model's own name for it, square root or not.
template <class Model>
constexpr int output_field(int kind) {
    if (kind == AovAlbedo) return Model::Albedo;
    if (kind == AovSpecular) return field_named<Model>("specular_reflectance");
    return field_named<Model>("alpha") >= 0 ? field_named<Model>("alpha") : field_named<Model>("roughness");
}
// What it shows of models that have no such field: no surface but a diffuse one is rough without a number that says so.
template <class Model>
constexpr double output_default(int kind) {
    return kind == AovAlbedo || (kind == AovRoughness && !Model::Delta) ? 1 : 0;
}

// What an output shows of the BSDFs in the lanes: a texture, a number in the block of small parameters (-1: not that),
// else `value`.
template <class F>
struct ShownParameter {
    IntOf<F> texture{-1}, number{-1};
    F value{0};
};

template <class F, class S, class... Models>
TR_NOINLINE ShownParameter<F> shown_parameter(TypeList<Models...>, int output, const SceneView<S> &scene,
                                              const IntOf<F> &bsdf, const MaskOf<F> &active) {
    using I = IntOf<F>;
    ShownParameter<F> r;
    I kind = record_kind<F>(scene.bsdfs, bsdf, active);
    int k = 0;
    auto look = [&](auto model) {
        using Model = decltype(model);
        auto same = active && mask<F>(kind == k++);
        if (!any(same)) return;
        const int field = output_field<Model>(output);
        r.value = select(same, F(S(output_default<Model>(output))), r.value);
        if (field < 0) return;
        I &to = Model::model.fields[field].kind == Kind::Float ? r.number : r.texture;
        to = select(mask<I>(same), record_field<F>(scene.bsdfs, field, bsdf, same), to);
    };
    (look(Models{}), ...);
    return r;
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

// A leaf's part of `output`; roughness is in the first channel.
template <int C, class F, class S>
Color<F, C> eval_shown_leaf(const SceneView<S> &scene, int output, const ShownParameter<F> &of,
                            const TexturedPoint<F> &at, const MaskOf<F> &active) {
    Color<F, C> r = uniform_color<C>(of.value);
    auto textured = active && mask<F>(of.texture >= 0), number = active && mask<F>(of.number >= 0);
    if (any(textured)) r = select(textured, eval_texture<C>(scene, scene.values, of.texture, at, textured), r);
    if (output == AovRoughness) r[0] = luminance(r);
    if (any(number)) r[0] = select(number, gather<F>(scene.values.constants, UIntOf<F>(of.number), number), r[0]);
    return r;
}

// Blends and masks among BSDFs, the parts of which are shown by their weights. A mask's hole is as `null`.
template <class F, class S>
struct ShownMixture {
    MaskOf<F> blend, masked, mixed;
    IntOf<F> weight, first, second;

    ShownMixture(const SceneView<S> &scene, const IntOf<F> &bsdf, const MaskOf<F> &active) {
        RecordLanes<F> record(scene.bsdfs, bsdf, active);
        blend = active && mask<F>(record.kind() == BlendKind);
        masked = active && mask<F>(record.kind() == MaskKind);
        mixed = blend || masked;
        weight = record.field(BlendBsdf::Weight);
        first = record.field(BlendBsdf::First);
        second = select(mask<IntOf<F>>(masked), record.field(MaskBsdf::Nested), record.field(BlendBsdf::Second));
    }
};

template <int C, class F, class S>
Color<F, C> eval_shown(const SceneView<S> &scene, int output, const IntOf<F> &root, const MaskOf<F> &back,
                       const TexturedPoint<F> &at, const MaskOf<F> &active, int depth = 0) {
    IntOf<F> bsdf = below_sides<F>(scene, root, back, active);
    Color<F, C> r =
        eval_shown_leaf<C>(scene, output, shown_parameter<F>(Bsdfs{}, output, scene, bsdf, active), at, active);
    if (!scene.layered || depth == MaxLayers) return r;
    ShownMixture<F, S> mixture(scene, bsdf, active);
    if (!any(mixture.mixed)) return r;
    F w = branch_weight<C>(scene, mixture.weight, at, mixture.mixed);
    Color<F, C> first = uniform_color<C>(F(S(output_default<NullBsdf>(output))));
    if (any(mixture.blend))
        first = select(mixture.blend, eval_shown<C>(scene, output, mixture.first, back, at, mixture.blend, depth + 1),
                       first);
    Color<F, C> second = eval_shown<C>(scene, output, mixture.second, back, at, mixture.mixed, depth + 1);
    return select(mixture.mixed, first * (F(1) - w) + second * w, r);
}

// `g` is the adjoint of the output (of roughness in the first channel alone); with `values` that of textures is given
// to the sink, with `motion` that of where they are looked up is added to `to`.
template <int C, class F, class S, class Sink>
void sweep_shown(const SceneView<S> &scene, int output, const IntOf<F> &root, const MaskOf<F> &back,
                 const TexturedPoint<F> &at, const Color<F, C> &g, bool values, bool motion, const MaskOf<F> &active,
                 CoordinateAdjoint<F> &to, Sink &sink, int depth = 0) {
    const bool scalar = output == AovRoughness;
    IntOf<F> bsdf = below_sides<F>(scene, root, back, active);
    ShownParameter<F> of = shown_parameter<F>(Bsdfs{}, output, scene, bsdf, active);
    auto textured = active && mask<F>(of.texture >= 0), number = active && mask<F>(of.number >= 0);
    if (any(textured)) {
        if (values && scalar) sink.scalar_texture(scene, of.texture, at, g, textured);
        if (values && !scalar) sink.texture(scene, of.texture, at, g, textured);
        if (motion) sweep_lookup<C>(scene, of.texture, at, scalar ? luminance_adjoint(g) : g, textured, to, sink);
    }
    if (values && any(number)) sink.scalar(of.number, g[0], number);
    if (!scene.layered || depth == MaxLayers) return;
    ShownMixture<F, S> mixture(scene, bsdf, active);
    const MaskOf<F> &mixed = mixture.mixed;
    if (!any(mixed)) return;
    F w = branch_weight<C>(scene, mixture.weight, at, mixed);
    Color<F, C> a = uniform_color<C>(F(S(output_default<NullBsdf>(output))));
    Color<F, C> b = eval_shown<C>(scene, output, mixture.second, back, at, mixed, depth + 1);
    if (any(mixture.blend)) {
        a = select(mixture.blend, eval_shown<C>(scene, output, mixture.first, back, at, mixture.blend, depth + 1), a);
        sweep_shown(scene, output, mixture.first, back, at, g * (F(1) - w), values, motion, mixture.blend, to, sink,
                    depth + 1);
    }
    sweep_shown(scene, output, mixture.second, back, at, g * w, values, motion, mixed, to, sink, depth + 1);
    Color<F, C> by_weight = g * (b - a);
    if (scalar)
        for (int c = 1; c < C; ++c) by_weight[c] = F(0);
    auto free = unclamped_weight<C>(scene, mixture.weight, at, mixed);
    if (!any(free)) return;
    if (values) sink.scalar_texture(scene, mixture.weight, at, by_weight, free);
    if (motion) sweep_lookup<C>(scene, mixture.weight, at, luminance_adjoint(by_weight), free, to, sink);
}

}  // namespace detail

}  // namespace tr
