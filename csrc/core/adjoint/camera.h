// The derivative of a camera ray with respect to the camera's parameters.
#pragma once

#include "../sensor/camera.h"
#include "surface.h"

namespace tr {

// Of an ideal pinhole, whose ray is one from `center` along a unit vector. `direction_bar`: of FilmPoint::direction,
// where more than the ray depends on it.
template <class F>
TR_LARGE void sweep_pinhole(const SceneOf<F> &scene, const Record &record, const F &x, const F &y, ScalarOf<F> width,
                            ScalarOf<F> height, const RayAdjoint<F> &g, const Vec3<F> &direction_bar,
                            const MaskOf<F> &active, GradientSink<F> &sink);

// Of the ray that `camera_ray` has made of this sample.
template <class F>
TR_LARGE void sweep_camera(const SceneOf<F> &scene, const Record &record, const CameraSample<F> &sample,
                           ScalarOf<F> width, ScalarOf<F> height, const RayAdjoint<F> &g, const F &start_bar,
                           const MaskOf<F> &active, GradientSink<F> &sink);

}  // namespace tr
