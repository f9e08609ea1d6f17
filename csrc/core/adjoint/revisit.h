// A vertex of the path tape, met again: how it scatters light from other directions than those of its path.
#pragma once

#include "../registry.h"
#include "../state/tape.h"
#include "polarization.h"

namespace tr {

// About how light from the direction d is scattered along the path: like (1 - share) max(0, n.d) + share / (1 + k (1 -
// axis.d) / 2)^2; n = 0 where it may come from everywhere.
template <class F>
struct ScatteringLobe {
    Vec3<F> n, axis;
    F k, share;
};

// The geometric normal at entries i on of a level.
template <class F>
TR_LARGE Vec3<F> geometric_normal(const SceneOf<F> &scene, const TapeColumns<ScalarOf<F>> &tape, uint32_t i,
                                  const MaskOf<F> &active);

// Of entries i on of a level, all of this kind of BSDF, which has a smooth part.
template <class F>
TR_LARGE ScatteringLobe<F> scattering_lobe(const SceneOf<F> &scene, const Wavelengths<F> &waves, int kind,
                                           const TapeColumns<ScalarOf<F>> &tape, uint32_t i, const MaskOf<F> &active);

// f |cos| from the direction d in the world, with what is above the BSDF, and the density of sampling it; both 0 where
// nothing comes from there.
template <class F>
TR_LARGE BsdfValue<F> scatter_towards(const SceneOf<F> &scene, const Wavelengths<F> &waves, int kind,
                                      const TapeColumns<ScalarOf<F>> &tape, uint32_t i, const Vec3<F> &d,
                                      const GradientNeeds &needs, const MaskOf<F> &active);

// Of polarised light, where scatter_towards has found something: the row for what arrives from there, of the one for
// what leaves along the path; and the column of what leaves, of this radiance from a light there.
template <class F>
TR_LARGE Stokes<F> row_towards(const SceneOf<F> &scene, const Wavelengths<F> &waves, int kind,
                               const TapeColumns<ScalarOf<F>> &tape, uint32_t i, const Vec3<F> &d,
                               const Stokes<F> &leaving, const GradientNeeds &needs, const MaskOf<F> &active);
template <class F>
TR_LARGE Stokes<F> column_towards(const SceneOf<F> &scene, const Wavelengths<F> &waves, int kind,
                                  const TapeColumns<ScalarOf<F>> &tape, uint32_t i, const Vec3<F> &d,
                                  const EmitterPoint<F> &light, const Spectrum<F> &radiance, const GradientNeeds &needs,
                                  const MaskOf<F> &active);

}  // namespace tr
