// The rays of renderings, kept as they were queried, and traced again with nothing but Embree: the time that a renderer
// which did nothing else would need for them. For measurements; what renders asks only whether there is a record.
#pragma once

#include <mutex>
#include <vector>

#include "accel.h"

namespace tr {

// The first two ask for the closest hit, the others, from what the camera sees and from further on, for any.
enum class RayKind { Camera, Bounce, CameraShadow, BounceShadow };
constexpr int RayKinds = 4;

class RayRecord {
public:
    // Keeps at most `limit` rays of each kind; batches that come later are only counted.
    explicit RayRecord(size_t limit) : limit_(limit) {}

    // A batch that was queried and how many of its rays have hit something. From any thread. Rays that can hit nothing
    // (see RayBatch) are left out: Embree is not asked about them.
    void add(RayKind kind, const RayBatch &rays, size_t n, size_t hits);

    struct Counts {
        uint64_t rays = 0, hits = 0;  // kept
        uint64_t left_out = 0;        // beyond the limit
    };
    Counts counts(RayKind kind) const;

    struct Replay {
        std::vector<double> seconds;  // by round, wall clock
        uint64_t hits = 0;            // of one round
    };
    // Traces the rays of a kind `rounds` times on `threads` threads, batch by batch, `width` rays a query (1, 4, 8 or
    // 16), which Embree is told are similar if `coherent`. std::invalid_argument if it has no code for that width here.
    Replay replay(const Accel &accel, RayKind kind, int width, bool coherent, int threads, int rounds) const;

private:
    struct Rays {
        std::vector<float> column[7];  // origin, direction, largest distance
        std::vector<size_t> begin;     // of every batch
        Counts counts;
    };
    size_t limit_;
    mutable std::mutex mutex_;
    Rays rays_[RayKinds];
};

}  // namespace tr
