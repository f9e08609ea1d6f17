// The outputs that show what BSDFs look up: albedo, specular reflectance, roughness; of mixtures the mixture.
#pragma once

#include "../adjoint/lookup.h"
#include "bsdf_stack.h"

namespace tr {

enum class BsdfAov { Albedo, Specular, Roughness };  // of roughness in the first component alone
constexpr int BsdfAovs = 3;

// A row of SceneView::bsdf_aovs, which has one of each output for every BSDF: a texture, a number in the block of small
// parameters (-1: not that), else 1 or 0.
struct BsdfAovRow {
    static constexpr int Size = 3;
    int32_t texture = -1, number = -1, one = 0;
};

// Of the BSDFs `bsdf`, which are met from behind where `back`.
template <class F>
TR_LARGE Spectrum<F> eval_bsdf_aov(const SceneOf<F> &scene, const Wavelengths<F> &waves, BsdfAov output,
                                   const IntOf<F> &bsdf, const MaskOf<F> &back, const TexturedPoint<F> &at,
                                   const MaskOf<F> &active, int depth = 0);

// `g` is the adjoint of the output (of roughness in the first component alone); with `values` that of textures is given
// to the sink, with `motion` that of where they are looked up is added to `to`.
template <class F>
TR_LARGE void sweep_bsdf_aov(const SceneOf<F> &scene, BsdfAov output, const IntOf<F> &bsdf, const MaskOf<F> &back,
                             const TexturedPoint<F> &at, const Spectrum<F> &g, bool values, bool motion,
                             const MaskOf<F> &active, CoordinateAdjoint<F> &to, GradientSink<F> &sink, int depth = 0);

}  // namespace tr
