// A tree of boxes over triangles, spheres, disks, cylinders, height fields and grids of distances, as plain tables that
// host and device read alike.
#pragma once

#include "core/shape/height_walk.h"
#include "core/shape/sdf_walk.h"

namespace tr {

// Of both children: their boxes, and where they are.
struct alignas(64) TreeNode {
    float lower[2][3], upper[2][3];
    uint32_t child[2];
    uint32_t count[2];  // 0: `child` is a node. Else so many items from there on.
};
static_assert(sizeof(TreeNode) == 64);

enum class TreeKind : uint32_t { Triangle, Sphere, Disk, Cylinder, HeightField, SdfGrid };

struct alignas(16) TreeItem {
    float p[3][3];  // corners; of the others, the box: lower corner, upper corner
    uint32_t shape, primitive;
    TreeKind kind;
};
static_assert(sizeof(TreeItem) == 48);

// From the world to the unit shape, 3 rows of 4.
struct TreeMatrix {
    double to_object[12];
};

struct TreeView {
    const TreeNode *nodes;
    const TreeItem *items;
    const TreeMatrix *matrices;  // by shape; only read for those that are no meshes
    const HeightTable *fields;   // by shape; only read for height fields
    const SdfTable *grids;       // ... for grids of distances
    uint32_t n_items;
    float lower[3], upper[3];  // of everything

    template <class Visit>
    TR_HD void for_pointers(Visit &&visit) const {
        visit(nodes), visit(items), visit(matrices), visit(fields), visit(grids);
    }
};

// No path in a tree is longer.
constexpr int TreeDepth = 60;

struct TreeHit {
    static constexpr uint32_t Miss = 0xffffffffu;
    uint32_t shape, primitive;
    float t, b1, b2;  // weights of a triangle's second and third corner, else 0
};

}  // namespace tr
