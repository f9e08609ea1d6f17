// The derivative of a light path, one vertex at a time, from its end to its beginning: as scattering.h, with the roles
// of camera and light exchanged. A connection to the camera brings v = beta f W, W the camera's importance, to the
// place u on the film: with the image's adjoint g and the filter h the loss changes by
//     dv sum_p g_p h(p - u) - v sum_p g_p grad h(p - u) . du.
// So every connection has an adjoint of its own, in each component for v and one for u, and they are part of what the
// vertices hand on: the path's adjoint is one.
//
// What moves: light that leaves an area or a point meets points that are glued to their surfaces, through
// |N_0.D| |N_1.D| / |D|^4 and |N_1.D| / |D|^3, as after a smooth BSDF; that of an environment and parallel light
// through |N_1.d|, an environment's d being at rest. A beam (`directionalarea`) is a ray that moves with its surface,
// and what it hits slides.
#pragma once

#include "../integrator/light.h"
#include "scattering.h"

namespace tr {

// One scattering vertex of this kind. Returns what the light that arrives along v.d brings, divided by its throughput
// a, every connection being weighted with its adjoint; adds the adjoints of the hit and of the direction.
// `next` is spent.
template <class F>
TR_LARGE Spectrum<F> sweep_light_scattering(const SceneOf<F> &scene, const LightSensor<ScalarOf<F>> &sensor, int kind,
                                            const VertexRecord<F> &v, const ConnectionRecord<F> &connection,
                                            Spectrum<F> a, NextVertex<F> &next, const GradientNeeds &needs,
                                            const MaskOf<F> &active, HitAdjoint<F> &hit, Vec3<F> &d_bar,
                                            GradientSink<F> &sink);

// The beginning of a path.
template <class F>
TR_LARGE void sweep_emission(const SceneOf<F> &scene, const LightSensor<ScalarOf<F>> &sensor,
                             const EmissionRecord<F> &e, const NextVertex<F> &next, const GradientNeeds &needs,
                             const MaskOf<F> &active, GradientSink<F> &sink);

}  // namespace tr
