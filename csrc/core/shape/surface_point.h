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

}  // namespace tr
