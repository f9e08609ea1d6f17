// Ray queries for a grid of signed distances, see core/shape/sdf_walk.h.
#pragma once

#include "near_rays.h"
#include "sdf_blocks.h"

namespace tr {

class SdfGrid {
public:
    // As SdfBlocks'; values stay in use until they are set again.
    float set_values(uint32_t shape, const float *values, const std::array<int32_t, 3> &n);
    void set_matrices(const float to_world[12], const float to_object[12]);
    // The same values at another address.
    void refer(const float *values) { blocks_.refer(values); }

    const Box &bounds() const { return bounds_; }  // in the world, of the cells that the surface meets

    // The distance of a miss is the ray's tmax; the primitive and (b1, b2): core/shape/sdfgrid.h.
    void intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const;
    void occluded(const RayBatch &rays, uint8_t *hit, size_t n) const;

private:
    SdfBlocks blocks_;
    uint32_t shape_ = 0;
    float to_world_[12]{}, to_object_[12]{};
    Box bounds_;

    void set_bounds();
    template <bool Occlusion>
    PacketIo::M walk(const PacketIo::Rays &rays, SdfFound<PacketIo::F> &found) const;
};

}  // namespace tr
