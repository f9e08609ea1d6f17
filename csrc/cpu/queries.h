// What all camera rays share, whether radiance is estimated along them or other outputs: how they become a query, and
// how they pass through lights that are hidden.
#pragma once

#include "accel/accel.h"
#include "core/shape/surface.h"

namespace tr {

// Columns of rays as Embree takes them: as they are, or converted into the seven columns `single`.
template <class S>
RayBatch ray_batch(S *const (&o)[3], S *const (&d)[3], const S *length, size_t n, float *const *single) {
    if constexpr (sizeof(S) == 4) {
        return {{o[0], o[1], o[2]}, {d[0], d[1], d[2]}, length};
    } else {
        const S *from[7] = {o[0], o[1], o[2], d[0], d[1], d[2], length};
        for (int k = 0; k < 7; ++k)
            for (size_t i = 0; i < n; ++i) single[k][i] = float(from[k][i]);
        return {{single[0], single[1], single[2]}, {single[3], single[4], single[5]}, single[6]};
    }
}

// Whether a camera ray that has hit this shape goes on behind it.
template <class S>
bool passes_emitter(const SceneView<S> &scene, uint32_t shape) {
    return shape != Accel::Miss && scene.shapes[shape].emitter >= 0;
}

// Camera rays pass through the shapes that emit: those that have hit one go on behind it. Calls query() for all rays
// again until none has (rare; those that did not move hit the same).
template <class S, class Query>
void pass_emitters(const SceneView<S> &scene, S *const (&o)[3], S *const (&d)[3], S *length, const uint32_t *shape,
                   const S *t, size_t n, Query &&query) {
    for (int pass = 0; pass < 256; ++pass) {
        bool again = false;
        for (size_t i = 0; i < n; ++i) {
            if (!passes_emitter(scene, shape[i])) continue;
            Vec3<S> p{o[0][i] + d[0][i] * t[i], o[1][i] + d[1][i] * t[i], o[2][i] + d[2][i] * t[i]};
            S behind = offset_amount(p);
            o[0][i] = p.x + d[0][i] * behind;
            o[1][i] = p.y + d[1][i] * behind;
            o[2][i] = p.z + d[2][i] * behind;
            length[i] -= t[i] + behind;
            again = true;
        }
        if (!again) return;
        query();
    }
}

}  // namespace tr
