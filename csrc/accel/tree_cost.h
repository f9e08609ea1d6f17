// How much worse a tree over triangles has become by following their motion.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace tr {

// A stand-in for a tree whose boxes cannot be looked at: a binary tree over the triangles in the order of a Morton
// curve through their centroids. Its boxes grow with the motion as those of the real one do when it is refitted. Of
// large meshes it has evenly spread runs of triangles only, so that to look is cheaper than to refit.
class TreeCost {
public:
    // Remembers the order, and the cost, of these triangles: from now on growth() is relative to them.
    void reset(const float *positions, const uint32_t *faces, size_t n_faces);
    // Cost now by the surface area heuristic, the areas of all boxes over that of the root, over the cost at `reset`;
    // 1 after a rigid motion or a change of scale of the whole.
    double growth(const float *positions) const;

private:
    double cost(const float *positions) const;

    std::vector<uint32_t> faces_;  // in the order of the curve
    double cost_ = 0;
};

}  // namespace tr
