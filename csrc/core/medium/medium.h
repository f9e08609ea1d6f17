// A medium while rendering: its records and what the host derives from them.
#pragma once

#include "models.h"

namespace tr {

enum MediumFlags : int32_t {
    IsGrid = 1,       // the extinction is a grid, otherwise the same everywhere
    IsChromatic = 2,  // the extinction differs between channels
    Bends = 4         // a gradient index, of which nothing else is here
};

struct MediumInfo {
    int32_t extinction, albedo, emission, phase, scale;  // volumes (emission: or -1), a phase function, a constant
    int32_t flags;
    // Majorants of a grid: cells of `cell` voxels along every axis, `cells` of them, from `first` in the table.
    int32_t cell, cells[3], first;
    // all light comes from infinitely far away, and the medium is within boundaries that let none straight in: emitter
    // samples from within are in vain
    int32_t enclosed;
};

template <class F, class S>
TR_INLINE MaskOf<F> inside_grid(const SceneView<S> &scene, const MediumInfo &medium, const Vec3<F> &p) {
    Vec3<F> q = to_volume(scene, medium.extinction, p);
    return mask<F>(min(min(q.x, q.y), q.z) >= F(0)) && mask<F>(max(max(q.x, q.y), q.z) <= F(1));
}

}  // namespace tr
