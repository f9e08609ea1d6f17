// The derivative of what the camera sees first, its place and its normals, with respect to the surface and the camera.
#pragma once

#include "camera.h"

namespace tr {

// The camera's frame in the world: x is left in the image, y up, z into it.
template <class S>
struct CameraFrame {
    Vec3<S> origin, axis[3];
    S length[3];  // of the matrix's columns, 1 up to rounding

    TR_HD CameraFrame(const SceneView<S> &scene, const Record &record) {
        const S *m = scene.values.constants + record.field[Perspective::ToWorld];
        origin = {m[3], m[7], m[11]};
        for (int k = 0; k < 3; ++k) {
            axis[k] = {m[k], m[4 + k], m[8 + k]};
            length[k] = norm(axis[k]);
            axis[k] = axis[k] * (S(1) / length[k]);
        }
    }
};

template <class F, class S>
TR_INLINE Vec3<F> widen(const Vec3<S> &v) {
    return {F(v.x), F(v.y), F(v.z)};
}

// Adjoints of the quantities of a hit.
template <class F>
struct OutputAdjoint {
    F depth{0}, distance{0}, ray_length{0};
    Vec3<F> position{F(0), F(0), F(0)}, normal{position}, shading_normal{position}, normal_camera{position},
        shading_normal_camera{position}, partial_u{position}, partial_v{position};
    CoordinateAdjoint<F> at;  // texture coordinates, and what is looked up there
};

// `d`: the camera ray's direction, `center`: where it comes from; `partials`: their adjoints are not all zero.
template <class F>
TR_LARGE void sweep_outputs(const SceneOf<F> &scene, const Record &record, const CameraFrame<ScalarOf<F>> &camera,
                            const CameraSample<F> &sample, ScalarOf<F> width, ScalarOf<F> height, const Vec3<F> &center,
                            const Vec3<F> &d, const Interaction<F> &si, const OutputAdjoint<F> &g, bool camera_wanted,
                            bool partials, const MaskOf<F> &active, GradientSink<F> &sink);

}  // namespace tr
