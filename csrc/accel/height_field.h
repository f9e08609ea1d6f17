// Ray queries for a height field, see core/shape/height_walk.h.
#pragma once

#include "height_ranges.h"
#include "near_rays.h"

namespace tr {

class HeightField {
public:
    // Heights (rows, columns) stay in use until they are set again; `linear`: bilinear patches. Matrices of 3 rows
    // of 4. Returns the largest of their absolute values.
    float set_heights(uint32_t shape, const float *heights, int rows, int columns, bool linear);
    void set_matrices(const float to_world[12], const float to_object[12]);
    // The same heights at another address.
    void refer(const float *heights) { table_.heights = heights; }

    const Box &bounds() const { return bounds_; }  // in the world

    // The distance of a miss is the ray's tmax; (b1, b2) are the texture coordinates.
    void intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const;
    void occluded(const RayBatch &rays, uint8_t *hit, size_t n) const;

private:
    HeightRanges ranges_;
    HeightTable table_{};
    uint32_t shape_ = 0;
    float to_world_[12]{}, to_object_[12]{};
    Box bounds_;

    void set_bounds();
    template <bool Occlusion>
    PacketIo::M walk(const PacketIo::Rays &rays, PacketIo::F &t, PacketIo::F &u, PacketIo::F &v) const;
};

}  // namespace tr
