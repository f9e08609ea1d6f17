// Closest hits and occlusion of batches of rays, through Embree and, of a few faces and of height fields, beside it.
// Geometry is identified by the index of its shape.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

namespace tr {

namespace rtc {
struct Api;
struct SceneObject;
}  // namespace rtc

// Rays as a structure of arrays. They begin at distance 0, where nothing is hit yet, and end at tmax (infinity is
// fine). Rays with tmax < 0, with a non-finite number or without a direction hit nothing; directions need not be
// normalised, t counts in their length.
struct RayBatch {
    const float *o[3], *d[3], *tmax;
};

// Hits of a batch. The distance of a miss is the ray's tmax.
struct HitBatch {
    uint32_t *shape, *primitive;  // shape = Accel::Miss: nothing was hit
    float *t, *b1,
        *b2;  // weights of a triangle's second and third vertex; 0 on quadrics, (u, v) on height fields; on curves
              // b1 is the place along the segment
};

// What measures Embree by itself needs of an acceleration structure.
struct EmbreeScene {
    const rtc::Api *api;
    rtc::SceneObject *scene;
    int widest_query;  // rays a query, at most
};

// The unit sphere, the unit disk in the plane z = 0, and the open cylinder of radius 1 about the z axis from 0 to 1.
enum class QuadricKind { Sphere, Disk, Cylinder };

class SdfGrid;

// Queries by something else, as Accel's.
struct RayWalk {
    virtual ~RayWalk() = default;
    virtual void intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const = 0;
    virtual void occluded(const RayBatch &rays, uint8_t *hit, size_t n) const = 0;
};

class Accel {
public:
    static constexpr uint32_t Miss = 0xffffffffu;

    // Needs a loaded library (load_embree); std::runtime_error otherwise, and from everything that changes geometry.
    Accel();
    ~Accel();
    Accel(Accel &&) noexcept;
    Accel &operator=(Accel &&) noexcept;

    // Copies a mesh: positions (n_vertices, 3), faces (n_faces, 3) counted from this mesh's first vertex. A shape may
    // be set again, with the same numbers of vertices and faces; `faces` null then says that they are the same.
    void set_mesh(uint32_t shape, const float *positions, size_t n_vertices, const uint32_t *faces, size_t n_faces);
    // Where a unit shape is; matrices of 3 rows of 4.
    void set_quadric(uint32_t shape, QuadricKind kind, const float to_world[12], const float to_object[12]);
    // Copies a curve: control points and radii (n_points, 4), the first control point of each segment. May be set again
    // with the same numbers of both.
    void set_curve(uint32_t shape, const float *points, size_t n_points, const uint32_t *segments, size_t n_segments,
                   bool straight);
    // Heights (rows, columns) over the square [-1, 1]^2, see height_field.h, which stay in use; and where they are in
    // the world. Both are to be set, neither needs a commit. `refer`: the same heights at another address. Returns the
    // largest of their absolute values.
    float set_heights(uint32_t shape, const float *heights, int rows, int columns, bool linear);
    void place_heights(uint32_t shape, const float to_world[12], const float to_object[12]);
    void refer_heights(uint32_t shape, const float *heights);
    // Likewise the grid of distances of a shape, made when it is first asked for.
    SdfGrid &sdf_grid(uint32_t shape);
    // Makes the changes visible to queries. The first build is the best one (`fast`: a faster one), that after a first
    // motion a faster one. Where things move again, every mesh has a tree of its own, which then follows the vertices
    // (is refitted), and is built again when it has become bad by it.
    void commit(bool fast = false);

    struct Counters {
        uint64_t builds = 0;    // of everything
        uint64_t refits = 0;    // of one mesh whose vertices moved
        uint64_t rebuilds = 0;  // of one mesh whose tree had become bad
    };
    const Counters &counters() const;

    EmbreeScene embree() const;  // until the next change

    // Lower corner, upper corner; (inf, -inf) without geometry.
    void bounds(float out[6]) const;

    // Any number of rays, from any number of threads. `coherent`: neighbouring rays are similar, as from a camera.
    // hits.t may be the rays' own tmax.
    void intersect(const RayBatch &rays, const HitBatch &hits, size_t n, bool coherent) const;
    // hit[i] = 1 if anything lies between the ray's ends, else 0.
    void occluded(const RayBatch &rays, uint8_t *hit, size_t n) const;

    // From now on something else, which stays in use, answers queries; null: no longer. That is how rays of the CPU
    // find what those of a device find.
    void walk(const RayWalk *walk);

    // Rays a query: 1, 4, 8 or 16, at most what the processor has; 0 gives the default back. For measurements; affects
    // scenes that are made afterwards.
    static void set_query_width(int width);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace tr
