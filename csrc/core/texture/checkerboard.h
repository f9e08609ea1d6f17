// `checkerboard`: two textures in alternating squares of half a unit.
#pragma once

#include "../scene.h"

namespace tr {

struct Checkerboard {
    enum { Color0, Color1, ToUv };
    static constexpr Field fields[] = {
        {"color0", Kind::Texture, 0.4, 0, INFINITY, "interior",
         "where the fractional parts of u and v are on the same side of 1/2"},
        {"color1", Kind::Texture, 0.2, 0, INFINITY, "interior", "elsewhere"},
        {"to_uv", Kind::Transform2, None, -INFINITY, INFINITY,
         "none: moves the edges of the squares, a discontinuity that is not implemented yet",
         "homogeneous 3x3 map of the texture coordinates"},
    };
    static constexpr Model model = {"texture", "checkerboard", "Two textures in alternating squares.", fields, 3};

    // which of the two nested textures
    template <class F, class S>
    TR_INLINE static auto second(const SceneView<S> &scene, const Record &record, const Vec2<F> &uv) {
        const S *m = scene.values.constants + record.field[ToUv];
        F u = m[0] * uv.x + m[1] * uv.y + m[2], v = m[3] * uv.x + m[4] * uv.y + m[5];
        F fu = u - floor(u) - F(0.5), fv = v - floor(v) - F(0.5);
        auto a = mask<F>(fu > F(0)), b = mask<F>(fv > F(0));
        return (a && !b) || (!a && b);
    }
};

}  // namespace tr
