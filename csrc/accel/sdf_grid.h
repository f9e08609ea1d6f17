// Ray queries for a grid of signed distances, beside Embree. Along a ray the trilinear interpolant in a cell is a cubic
// polynomial; its first root is between two of its extrema, where Newton's iteration between bounds finds it (Marmitt,
// Kleer, Wald, Friedrich and Slusallek, "Fast and Accurate Ray-Voxel Intersection Techniques for Iso-Surface Ray
// Tracing", VMV 2004; Hansson-Soederlund, Evans and Akenine-Moeller, "Ray Tracing of Signed Distance Function Grids",
// JCGT 11(3), 2022). From cell to cell rays walk through a table that says of every cell how large the empty block
// around it is, so that a step is one look-up, however far it leads. As primitives of Embree's, the cells that the
// surface meets would be a tree, whose building takes longer than one rendering of a grid that is optimised.
#pragma once

#include <array>
#include <vector>

#include "near_rays.h"

namespace tr {

class SdfGrid {
public:
    // Numbers n = (W, H, D) of values at the corners of cells, x fastest, which stay in use until they are set again.
    // Returns the largest of their absolute values.
    float set_values(uint32_t shape, const float *values, const std::array<int32_t, 3> &n);
    void set_matrices(const float to_world[12], const float to_object[12]);
    // The same values at another address.
    void refer(const float *values) { values_ = values; }

    const Box &bounds() const { return bounds_; }  // in the world, of the cells that the surface meets

    // The distance of a miss is the ray's tmax; the primitive and (b1, b2): core/shape/sdfgrid.h.
    void intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const;
    void occluded(const RayBatch &rays, uint8_t *hit, size_t n) const;

private:
    struct Found {
        PacketIo::F t, b1, b2;
        PacketIo::U primitive;
    };
    template <bool Occlusion>
    PacketIo::M walk(const PacketIo::Rays &rays, Found &found) const;

    const float *values_ = nullptr;
    uint32_t shape_ = 0;
    int32_t cells_[3]{}, stride_[3]{}, bits_[3]{};
    // A byte a cell: 0 where the surface may be, else the side of the largest aligned empty block of cells around it, a
    // power of two.
    std::vector<uint32_t> empty_;
    int32_t first_[3]{}, last_[3]{};  // cells that are not empty lie between these
    float to_world_[12]{}, to_object_[12]{};
    Box bounds_;

    void set_bounds();
};

}  // namespace tr
