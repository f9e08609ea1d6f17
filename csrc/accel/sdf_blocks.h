// The empty space around the surface of a grid of distances, which rays pass in few steps. As primitives of Embree's,
// the cells that the surface meets would be a tree, whose building takes longer than one rendering of a grid that is
// optimised.
#pragma once

#include <array>
#include <vector>

#include "core/shape/sdf_walk.h"

namespace tr {

class SdfBlocks {
public:
    // Numbers n = (W, H, D) of values at the corners of cells, x fastest. Returns the largest of their absolute values.
    float set(const float *values, const std::array<int32_t, 3> &n);
    // The same values at another address.
    void refer(const float *values) { table_.values = values; }
    // The grid as tables, until it is set again.
    const SdfTable &table() const { return table_; }
    const std::vector<uint32_t> &empty() const { return empty_; }

private:
    SdfTable table_{};
    std::vector<uint32_t> empty_;
};

// Around the cells that the surface meets, in the world; a matrix of 3 rows of 4.
void sdf_box(const float to_world[12], const SdfTable &grid, float lower[3], float upper[3]);

}  // namespace tr
