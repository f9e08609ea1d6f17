// All phase functions. The index of a phase function is the same in all lanes: callers go through media one by one.
// Phase functions are their own densities: a sample's value over its density is 1.
#pragma once

#include "../math/dual.h"
#include "../volume/volume.h"
#include "hg.h"
#include "isotropic.h"

namespace tr {

enum class PhaseKind : int32_t { Isotropic = 0, HenyeyGreenstein = 1 };  // order of the registry

// The value (and density per solid angle) of scattering at p from the direction of travel `d` into `wo`.
template <class F, class S>
TR_INLINE F eval_phase(const SceneView<S> &scene, int32_t phase, const Vec3<F> &, const Vec3<F> &d, const Vec3<F> &wo,
                       const MaskOf<F> &) {
    const Record &record = scene.phases[phase];
    if (record.kind == int32_t(PhaseKind::HenyeyGreenstein))
        return HenyeyGreenstein::eval(F(scene.values.constants[record.field[HenyeyGreenstein::G]]), dot(d, wo));
    return F(1 / (4 * Pi));
}

// A direction, distributed as eval_phase says.
template <class F, class S>
TR_INLINE Vec3<F> sample_phase(const SceneView<S> &scene, int32_t phase, const Vec3<F> &, const Vec3<F> &d, const F &,
                               const F &u1, const F &u2, const MaskOf<F> &) {
    const Record &record = scene.phases[phase];
    if (record.kind == int32_t(PhaseKind::Isotropic)) return square_to_sphere(u1, u2);
    F cosine = HenyeyGreenstein::sample(F(scene.values.constants[record.field[HenyeyGreenstein::G]]), u1);
    F sine = sqrt(max(F(0), F(1) - cosine * cosine)), s, c;
    sincos(u2 * F(2 * Pi), s, c);
    return normalize(make_frame(d).to_world({sine * c, sine * s, cosine}));
}

// The derivative of eval_phase with respect to the parameters; `g` is the adjoint of its value, channel by channel.
template <class F, int C, class S, class Sink>
TR_INLINE void sweep_phase(const SceneView<S> &scene, int32_t phase, const Vec3<F> &, const Vec3<F> &d,
                           const Vec3<F> &wo, const Color<F, C> &g, const MaskOf<F> &active, Sink &sink) {
    const Record &record = scene.phases[phase];
    if (record.kind != int32_t(PhaseKind::HenyeyGreenstein)) return;
    int32_t offset = record.field[HenyeyGreenstein::G];
    auto value = HenyeyGreenstein::eval(Dual<F, 1>(F(scene.values.constants[offset]), 0), dot(d, wo));
    sink.number(scene, IntOf<F>(offset), g * value.d[0], active);
}

}  // namespace tr
