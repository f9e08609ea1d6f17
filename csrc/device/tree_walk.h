// Ray queries in a tree of the host's memory, one by one.
#pragma once

#include "accel/accel.h"
#include "tree.h"

namespace tr {

// As Accel's.
void walk_tree(const TreeView &tree, const RayBatch &rays, const HitBatch &hits, size_t n);
void walk_tree(const TreeView &tree, const RayBatch &rays, uint8_t *occluded, size_t n);

}  // namespace tr
