// What is stored of a point on a surface.
#pragma once

#include "../scene.h"

namespace tr {

// A point on a surface, as short as it can be stored. On a triangle (b1, b2) are barycentric, on curves see curve.h, on
// other curved shapes they are the texture coordinates; grids of distances have none: there all look-ups are at (0, 0).
template <class F>
struct SurfacePoint {
    UIntOf<F> shape, primitive;
    F b1, b2;
};

// Calls f(shape, view, lanes) for every shape that a lane is on, with a View of what it has.
template <template <class> class View, class F, class S, class Function>
TR_INLINE void each_shape(const SceneView<S> &scene, const UIntOf<F> &shape, MaskOf<F> open, Function &&f) {
    while (any(open)) {
        uint32_t one = first_lane(shape, open);
        auto lanes = open && mask<F>(shape == one);
        f(one, View<S>(scene, one), lanes);
        open = open && !lanes;
    }
}

}  // namespace tr
