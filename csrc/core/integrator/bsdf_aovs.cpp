#include "bsdf_aovs.h"

namespace tr {

namespace {

// What an output shows of the BSDFs in the lanes, see BsdfAovRow.
template <class F>
struct ShownParameter {
    IntOf<F> texture, number;
    F value;

    TR_HD ShownParameter(const SceneOf<F> &scene, BsdfAov output, const IntOf<F> &bsdf, const MaskOf<F> &active) {
        using I = IntOf<F>;
        I row[BsdfAovRow::Size];
        gather_few_rows<F>(scene.bsdf_aovs + BsdfAovRow::Size * int(output),
                           UIntOf<F>(bsdf * int32_t(BsdfAovRow::Size * BsdfAovs)), active, row);
        texture = row[0], number = row[1], value = F(row[2]);
    }
};

// The BSDF below `twosided` and normal maps: one that scatters, a blend or a mask.
template <class F>
TR_NOINLINE IntOf<F> below_sides(const SceneOf<F> &scene, IntOf<F> bsdf, const MaskOf<F> &back,
                                 const MaskOf<F> &active) {
    using I = IntOf<F>;
    for (int depth = 0; depth < MaxBsdfDepth; ++depth) {
        RecordLanes<F> record(scene.bsdfs, bsdf, active);
        ResolvedBsdf<F> side = resolve_bsdf<F>(scene, bsdf, back, active);
        auto perturbs = active && (mask<F>(record.kind() == NormalMapKind) || mask<F>(record.kind() == BumpMapKind));
        I next = select(mask<I>(perturbs), record.field(NormalMap::Nested), side.bsdf);
        if (!any(active && mask<F>(next != bsdf))) break;
        bsdf = next;
    }
    return bsdf;
}

// Blends and masks among BSDFs, the parts of which are shown by their weights. A mask's hole is as `null`.
template <class F>
struct ShownMixture {
    MaskOf<F> blend, masked, mixed;
    IntOf<F> weight, first, second;

    TR_HD ShownMixture(const SceneOf<F> &scene, const IntOf<F> &bsdf, const MaskOf<F> &active) {
        RecordLanes<F> record(scene.bsdfs, bsdf, active);
        blend = active && mask<F>(record.kind() == BlendKind);
        masked = active && mask<F>(record.kind() == MaskKind);
        mixed = blend || masked;
        weight = record.field(BlendBsdf::Weight);
        first = record.field(BlendBsdf::First);
        second = select(mask<IntOf<F>>(masked), record.field(MaskBsdf::Nested), record.field(BlendBsdf::Second));
    }
};

template <class F>
TR_INLINE Spectrum<F> hole_value(BsdfAov output) {
    return uniform_spectrum(F(ScalarOf<F>(output == BsdfAov::Albedo ? 1 : 0)));
}

}  // namespace

template <class F>
TR_LARGE Spectrum<F> eval_bsdf_aov(const SceneOf<F> &scene, const Wavelengths<F> &waves, BsdfAov output,
                                   const IntOf<F> &root, const MaskOf<F> &back, const TexturedPoint<F> &at,
                                   const MaskOf<F> &active, int depth) {
    IntOf<F> bsdf = below_sides<F>(scene, root, back, active);
    ShownParameter<F> of(scene, output, bsdf, active);
    Spectrum<F> r = uniform_spectrum(of.value);
    auto textured = active && mask<F>(of.texture >= 0), number = active && mask<F>(of.number >= 0);
    if (any(textured)) r = select(textured, eval_texture(scene, waves, of.texture, at, textured), r);
    if (output == BsdfAov::Roughness) r[0] = luminance(r);
    if (any(number)) r[0] = select(number, gather<F>(scene.values.constants, UIntOf<F>(of.number), number), r[0]);
    if (!scene.has_stacks || depth == MaxBsdfDepth) return r;
    ShownMixture<F> mixture(scene, bsdf, active);
    if (!any(mixture.mixed)) return r;
    F w = branch_weight(scene, waves, mixture.weight, at, mixture.mixed);
    auto part = [&](const IntOf<F> &of_bsdf, const MaskOf<F> &lanes) {
        return eval_bsdf_aov(scene, waves, output, of_bsdf, back, at, lanes, depth + 1);
    };
    Spectrum<F> first = hole_value<F>(output);
    if (any(mixture.blend)) first = select(mixture.blend, part(mixture.first, mixture.blend), first);
    Spectrum<F> second = part(mixture.second, mixture.mixed);
    return select(mixture.mixed, first * (F(1) - w) + second * w, r);
}

template <class F>
TR_LARGE void sweep_bsdf_aov(const SceneOf<F> &scene, BsdfAov output, const IntOf<F> &root, const MaskOf<F> &back,
                             const TexturedPoint<F> &at, const Spectrum<F> &g, bool values, bool motion,
                             const MaskOf<F> &active, CoordinateAdjoint<F> &to, GradientSink<F> &sink, int depth) {
    const bool scalar = output == BsdfAov::Roughness;
    IntOf<F> bsdf = below_sides<F>(scene, root, back, active);
    ShownParameter<F> of(scene, output, bsdf, active);
    auto textured = active && mask<F>(of.texture >= 0), number = active && mask<F>(of.number >= 0);
    if (any(textured)) {
        if (values && scalar) sink.scalar_texture(scene, of.texture, at, g, textured);
        if (values && !scalar) sink.texture(scene, of.texture, at, g, textured);
        if (motion) sweep_lookup(scene, of.texture, at, scalar ? luminance_adjoint(g) : g, textured, to, sink);
    }
    if (values && any(number)) sink.scalar(of.number, g[0], number);
    if (!scene.has_stacks || depth == MaxBsdfDepth) return;
    ShownMixture<F> mixture(scene, bsdf, active);
    const MaskOf<F> &mixed = mixture.mixed;
    if (!any(mixed)) return;
    F w = branch_weight(scene, sink.waves, mixture.weight, at, mixed);
    auto part = [&](const IntOf<F> &of_bsdf, const MaskOf<F> &lanes) {
        return eval_bsdf_aov(scene, sink.waves, output, of_bsdf, back, at, lanes, depth + 1);
    };
    auto sweep_part = [&](const IntOf<F> &of_bsdf, const Spectrum<F> &part_g, const MaskOf<F> &lanes) {
        sweep_bsdf_aov(scene, output, of_bsdf, back, at, part_g, values, motion, lanes, to, sink, depth + 1);
    };
    Spectrum<F> first = hole_value<F>(output), second = part(mixture.second, mixed);
    if (any(mixture.blend)) {
        first = select(mixture.blend, part(mixture.first, mixture.blend), first);
        sweep_part(mixture.first, g * (F(1) - w), mixture.blend);
    }
    sweep_part(mixture.second, g * w, mixed);
    Spectrum<F> by_weight = g * (second - first);
    if (scalar)
        for (int c = 1; c < SpectrumSize; ++c) by_weight[c] = F(0);
    auto free = unclamped_weight(scene, sink.waves, mixture.weight, at, mixed);
    if (!any(free)) return;
    if (values) sink.scalar_texture(scene, mixture.weight, at, by_weight, free);
    if (motion) sweep_lookup(scene, mixture.weight, at, luminance_adjoint(by_weight), free, to, sink);
}

#define TR_INSTANTIATE(F, S)                                                                                    \
    template Spectrum<F> eval_bsdf_aov(const SceneView<S> &, const Wavelengths<F> &, BsdfAov, const IntOf<F> &, \
                                       const MaskOf<F> &, const TexturedPoint<F> &, const MaskOf<F> &, int);    \
    template void sweep_bsdf_aov(const SceneView<S> &, BsdfAov, const IntOf<F> &, const MaskOf<F> &,            \
                                 const TexturedPoint<F> &, const Spectrum<F> &, bool, bool, const MaskOf<F> &,  \
                                 CoordinateAdjoint<F> &, GradientSink<F> &, int);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
