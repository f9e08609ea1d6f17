// A few faces, all of which every ray is tested against, a packet of rays at a time. On the Cornell box (36 triangles)
// that takes a quarter of the time that rays of all directions take in a tree.
#pragma once

#include <vector>

#include "near_rays.h"

namespace tr {

class FaceList {
public:
    // As many faces as pay where there is nothing else, which depends on the width of packets.
    static size_t limit();

    void clear();
    void add_mesh(uint32_t shape, const float *positions, const uint32_t *faces, size_t n_faces);
    size_t size() const { return parallelograms_.size() + triangles_.size(); }
    const Box &bounds() const { return bounds_; }

    void intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const;
    void occluded(const RayBatch &rays, uint8_t *hit, size_t n) const;

private:
    // The plane through `origin` with unit normal n, and the dual basis of its two edges: x lies at
    // (dot(u, x - origin), dot(v, x - origin)).
    struct Plane {
        float origin[3], n[3], u[3], v[3];
    };
    // Whose face it is. Two triangles q0 q1 q2 and q0 q2 q3 of a parallelogram are one face; where their own first
    // vertices are in these orders is in `turns`, 4 * that of the second + that of the first.
    struct Owner {
        uint32_t shape, first, second, turns;
    };
    static bool plane_of(const double *q0, const double *q1, const double *q2, Plane &plane);
    bool add_parallelogram(uint32_t shape, uint32_t face, const float *positions, const uint32_t *a, const uint32_t *b);
    void add_triangle(uint32_t shape, uint32_t face, const float *positions, const uint32_t *corners);

    Box bounds_;
    std::vector<Plane> parallelograms_, triangles_;
    std::vector<Owner> parallelogram_owners_, triangle_owners_;
};

}  // namespace tr
