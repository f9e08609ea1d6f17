// From a record of the scene to the numbers that a BSDF's functions take, and from derivatives by these numbers back to
// the parameters: loops over the fields that the model declares.
#pragma once

#include "../adjoint/lookup.h"
#include "../adjoint/needs.h"
#include "../registry.h"

namespace tr {

// The parameters of the records `bsdf`, all of this model, at a surface point.
template <class F>
TR_LARGE void load_parameters(const SceneOf<F> &scene, const Wavelengths<F> &waves, const BsdfInfo &model,
                              const IntOf<F> &bsdf, const TexturedPoint<F> &at, const MaskOf<F> &active,
                              BsdfParameters<F> &to);

// Adds the adjoints of the model's variables, one number a component of the spectrum, to the gradients of the
// parameters, and to `to` what moving look-ups receive. `g[i]` is that of variable i, which counts if it has a bit in
// `variables`.
template <class F>
TR_LARGE void sweep_parameters(const SceneOf<F> &scene, const BsdfInfo &model, const IntOf<F> &bsdf,
                               const TexturedPoint<F> &at, const Spectrum<F> *g, uint32_t variables,
                               const GradientNeeds &needs, const MaskOf<F> &active, CoordinateAdjoint<F> &to,
                               GradientSink<F> &sink);

// The same of the numbers by which delta lobes are turned: `g[i]` is the adjoint of the i-th number.
template <class F>
TR_LARGE void sweep_numbers(const SceneOf<F> &scene, const BsdfInfo &model, const IntOf<F> &bsdf,
                            const TexturedPoint<F> &at, const F *g, const MaskOf<F> &active, GradientSink<F> &sink);

}  // namespace tr
