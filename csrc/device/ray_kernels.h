// Ray queries as kernels, an item a ray.
#pragma once

#include "knowledge.h"
#include "tree_traversal.h"

namespace tr {

// Rays as columns: origin, direction, length.
struct RayTable {
    const float *column[7];

    template <class Visit>
    TR_HD void for_pointers(Visit &&visit) const {
        for (const float *p : column) visit(p);
    }
};

template <bool Any>
TR_HD TreeHit trace(const TreeView &tree, const RayTable &rays, uint32_t i) {
    const float o[] = {rays.column[0][i], rays.column[1][i], rays.column[2][i]};
    const float d[] = {rays.column[3][i], rays.column[4][i], rays.column[5][i]};
    return trace<Any>(tree, o, d, rays.column[6][i]);
}

struct IntersectRays {
    static constexpr const char *Name = "tr::IntersectRays", *Header = "device/ray_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Shapes;
    TreeView tree;
    RayTable rays;
    uint32_t *shape, *primitive;
    float *t, *b1, *b2;

    TR_HD void operator()(uint32_t i) const {
        const TreeHit hit = trace<false>(tree, rays, i);
        shape[i] = hit.shape, primitive[i] = hit.primitive;
        t[i] = hit.t, b1[i] = hit.b1, b2[i] = hit.b2;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        tree.for_pointers(visit), rays.for_pointers(visit);
        visit(shape), visit(primitive), visit(t), visit(b1), visit(b2);
    }
};

struct OccludeRays {
    static constexpr const char *Name = "tr::OccludeRays", *Header = "device/ray_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Shapes;
    TreeView tree;
    RayTable rays;
    uint8_t *hit;

    TR_HD void operator()(uint32_t i) const { hit[i] = trace<true>(tree, rays, i).shape != TreeHit::Miss; }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        tree.for_pointers(visit), rays.for_pointers(visit);
        visit(hit);
    }
};

}  // namespace tr
