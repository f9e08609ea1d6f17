// Ray queries for a height field, without a mesh and without a tree. The square is a grid of cells, between whose
// heights the surface is one polynomial. A surface of B-splines or bilinear patches lies in the convex hull of its
// control values, so their least and largest over blocks of 8 x 8 cells, and over 8 x 8 of those, say where a ray has
// nothing to look for (Tevs, Ihrke and Seidel, "Maximum Mipmaps for Fast, Accurate, and Scalable Dynamic Height Field
// Rendering", I3D 2008). Where it has, it walks from cell to cell and is intersected by Newton's iteration between
// bounds.
#pragma once

#include <vector>

#include "near_rays.h"

namespace tr {

class HeightField {
public:
    // Heights (rows, columns) stay in use until they are set again; `linear`: bilinear patches. Matrices of 3 rows
    // of 4. Returns the largest of their absolute values.
    float set_heights(uint32_t shape, const float *heights, int rows, int columns, bool linear);
    void set_matrices(const float to_world[12], const float to_object[12]);
    // The same heights at another address.
    void refer(const float *heights) { heights_ = heights; }

    const Box &bounds() const { return bounds_; }  // in the world

    // The distance of a miss is the ray's tmax; (b1, b2) are the texture coordinates.
    void intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const;
    void occluded(const RayBatch &rays, uint8_t *hit, size_t n) const;

private:
    struct Range {
        float low, high;
    };
    // Ranges of the control values of 8 x 8 cells, and of 64 x 64.
    struct Level {
        int columns = 0, rows = 0;
        std::vector<Range> ranges;
    };
    template <int N>
    struct Walk;
    template <int N, bool Occlusion>
    PacketIo::M walk(const PacketIo::Rays &rays, PacketIo::F &t, PacketIo::F &u, PacketIo::F &v) const;

    const float *heights_ = nullptr;
    uint32_t shape_ = 0;
    int rows_ = 0, columns_ = 0;
    bool linear_ = false;
    float to_world_[12]{}, to_object_[12]{};
    Range range_{};  // of all
    Level fine_, coarse_;
    Box bounds_;

    void set_bounds();
};

}  // namespace tr
