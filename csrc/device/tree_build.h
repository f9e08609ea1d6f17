// Trees are built on the host: binned surface-area heuristic (Wald, "On fast Construction of SAH-based Bounding Volume
// Hierarchies", 2007), on several threads, with the same tree for every number of them.
#pragma once

#include <vector>

#include "tree.h"

namespace tr {

struct Tree {
    std::vector<TreeNode> nodes;
    std::vector<TreeItem> items;  // sorted as the leaves have them
    std::vector<TreeMatrix> matrices;
    // By shape, into the three that follow; none, if no shape is a height field, or a grid.
    std::vector<HeightTable> fields;
    std::vector<SdfTable> grids;
    std::vector<float> values;  // heights, distances
    std::vector<HeightRange> ranges;
    std::vector<uint32_t> empty;
    float lower[3], upper[3];
    double cost = 0;  // surface-area heuristic: boxes and items that a random ray through everything is held against
    double built_cost = 0;  // when the tree was built

    TreeView view() const;

    // Builds the tree of what is in `items` and `matrices`.
    void build(int threads);
    // Boxes for items whose corners have moved, from the leaves up. False: by motion the tree has become bad, and is to
    // be built again.
    bool refit();
};

TreeItem triangle_item(uint32_t shape, uint32_t primitive, const float *p0, const float *p1, const float *p2);
TreeItem quadric_item(uint32_t shape, TreeKind kind, const double to_world[12]);
TreeItem grid_item(uint32_t shape, const SdfTable &grid, const double to_world[12]);
TreeItem field_item(uint32_t shape, const HeightRange &range, const double to_world[12]);

}  // namespace tr
