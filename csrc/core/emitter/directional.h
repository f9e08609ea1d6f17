// `directional`: light from infinitely far away that travels along the +z axis of `to_world`. A delta function of
// direction: only emitter sampling finds it.
#pragma once

#include "pointlight.h"

namespace tr {

struct DirectionalEmitter {
    enum { Irradiance, ToWorld, Weight };
    static constexpr Field fields[] = {
        {"irradiance", Kind::Spectrum, 1, 0, INFINITY, "interior",
         "power per area perpendicular to its direction, W / m^2"},
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY,
         "interior, without moving shadow edges; zero where nothing casts a shadow of it",
         "light travels along its +z axis"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
    };
    static constexpr Model model = {"emitter", "directional", "Parallel light from infinitely far away.", fields, 3};

    // the +z axis, of its length
    template <class F, class S>
    TR_INLINE static Vec3<F> axis(const SceneView<S> &scene, const IntOf<F> &emitter, const MaskOf<F> &active) {
        return gather_frame<F>(scene, record_field<F>(scene.emitters, ToWorld, emitter, active), active).z;
    }
};

}  // namespace tr
