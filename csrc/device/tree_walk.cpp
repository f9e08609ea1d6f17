#include "tree_walk.h"

#include "ray_kernels.h"

namespace tr {

namespace {

RayTable table_of(const RayBatch &rays) {
    return {{rays.o[0], rays.o[1], rays.o[2], rays.d[0], rays.d[1], rays.d[2], rays.tmax}};
}

}  // namespace

// By the kernels' own functors, of which an item is a call.
void TreeWalk::intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const {
    const IntersectRays kernel{tree, table_of(rays), hits.shape, hits.primitive, hits.t, hits.b1, hits.b2};
    for (size_t i = 0; i < n; ++i) kernel(uint32_t(i));
}

void TreeWalk::occluded(const RayBatch &rays, uint8_t *hit, size_t n) const {
    const OccludeRays kernel{tree, table_of(rays), hit};
    for (size_t i = 0; i < n; ++i) kernel(uint32_t(i));
}

}  // namespace tr
