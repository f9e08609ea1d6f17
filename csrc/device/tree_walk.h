// Ray queries in a tree of the host's memory, one by one.
#pragma once

#include "accel/accel.h"
#include "tree.h"

namespace tr {

struct TreeWalk final : RayWalk {
    TreeView tree{};

    void intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const override;
    void occluded(const RayBatch &rays, uint8_t *hit, size_t n) const override;
};

}  // namespace tr
