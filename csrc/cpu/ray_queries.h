// From columns of rays to queries of the acceleration structure, which works in single precision, and back.
#pragma once

#include "accel/accel.h"
#include "arena.h"
#include "core/state/queues.h"

namespace tr {

static_assert(NoHit == Accel::Miss);

template <class S>
struct RayColumns {
    VectorColumn<S> o, d;
    NumberColumn<S> length;
};
// Those of a queue.
template <class Queue>
auto rays_of(const Queue &queue) {
    return RayColumns<std::remove_reference_t<decltype(queue.length[0])>>{queue.o, queue.d, queue.length};
}

// Queries of up to as many rays as there is room for; what they find is in `hits` and `occluded`.
template <class S>
class RayQueries {
    static constexpr bool Single = sizeof(S) == 4;

public:
    HitColumns<S> hits;
    uint8_t *occluded;

    RayQueries(const Accel &accel, size_t capacity) : accel_(accel) {
        arena_.declare([&](Arena &arena) {
            hits.for_arrays([&](auto *&array) { arena.array(array, capacity); });
            arena.array(occluded, capacity);
            for (float *&p : ray_) arena.array(p, Single ? 0 : capacity);
            for (float *&p : hit_) arena.array(p, Single ? 0 : capacity);
        });
    }

    // The rays as the acceleration structure takes them: as they are, or converted.
    RayBatch batch(const RayColumns<S> &rays, size_t n) {
        S *from[7] = {rays.o.x, rays.o.y, rays.o.z, rays.d.x, rays.d.y, rays.d.z, rays.length.at};
        const float *to[7];
        for (int k = 0; k < 7; ++k) {
            if constexpr (Single) {
                to[k] = from[k];
            } else {
                for (size_t i = 0; i < n; ++i) ray_[k][i] = float(from[k][i]);
                to[k] = ray_[k];
            }
        }
        return {{to[0], to[1], to[2]}, {to[3], to[4], to[5]}, to[6]};
    }
    // Where hits are written; `widen` converts the first n of them.
    HitBatch hit_batch() const {
        if constexpr (Single)
            return {hits.at.shape, hits.at.primitive, hits.t.at, hits.at.b1, hits.at.b2};
        else
            return {hits.at.shape, hits.at.primitive, hit_[0], hit_[1], hit_[2]};
    }
    void widen(size_t n) {
        if constexpr (!Single)
            for (size_t i = 0; i < n; ++i)
                hits.t[i] = S(hit_[0][i]), hits.at.b1[i] = S(hit_[1][i]), hits.at.b2[i] = S(hit_[2][i]);
    }

    void intersect(const RayColumns<S> &rays, size_t n, bool coherent) {
        accel_.intersect(batch(rays, n), hit_batch(), n, coherent);
        widen(n);
    }

private:
    const Accel &accel_;
    Arena arena_;
    float *ray_[7], *hit_[3];
};

// Rays go on behind the shapes that passes(shape) is true of. Calls query() for all rays again until none has met one
// (rare; those that did not move hit the same).
template <class S, class Passes, class Query>
void pass_through(const RayColumns<S> &rays, const HitColumns<S> &hits, size_t n, Passes &&passes, Query &&query) {
    for (int pass = 0; pass < MostPasses; ++pass) {
        bool again = false;
        for (size_t i = 0; i < n; ++i) {
            if (hits.at.shape[i] == NoHit || !passes(hits.at.shape[i])) continue;
            Vec3<S> o = rays.o.get(i);
            pass_behind(o, rays.d.get(i), hits.t[i], rays.length[i]);
            rays.o.set(i, o);
            again = true;
        }
        if (!again) return;
        query();
    }
}

// ... behind those that emit.
template <class S, class Query>
void pass_emitters(const SceneView<S> &scene, const RayColumns<S> &rays, const HitColumns<S> &hits, size_t n,
                   Query &&query) {
    pass_through(rays, hits, n, [&](uint32_t shape) { return passes_emitter(scene, shape); }, query);
}

}  // namespace tr
