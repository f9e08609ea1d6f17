// Free flight and transmittance of one ray, of which each thread of a device has one; packets of a CPU take turns
// (cpu/tracker.h). In rgb: each medium has one extinction for all.
#pragma once

#include "../integrator/medium.h"
#include "estimators.h"

namespace tr {

// Tentative collisions, and those of them with an extinction above the majorant.
struct TrackingCounts {
    uint32_t collisions = 0, exceeded = 0;
};

template <int N, class S, class Columns, class Estimator>
TR_INLINE void walk_ray(const SceneView<S> &scene, const MediumInfo &medium, const TrackedQueue<S> &rays,
                        const Columns &at, uint32_t entry, const Estimator &estimator, TrackingCounts &counts) {
    TrackedRay<S, N> ray;
    ray.entry = entry;
    bool walking = ray.start(scene, medium, rays, at, estimator, true);
    while (walking) {
        bool stopped = false, left = false, above = false;
        do ray.walk.advance(scene, medium, ray.depth, walking, stopped, left);
        while (walking);
        if (left) return estimator.finish(ray, true, false);
        walking = ray.collide(scene, medium, estimator, stopped, above);
        ++counts.collisions, counts.exceeded += above ? 1 : 0;
    }
}

// With an estimator for grids; in constant media `constant` does it.
template <class S, class Columns, class Estimator, class Constant>
TR_INLINE void track_ray(const SceneView<S> &scene, const MediumContext<S> &media, int32_t m,
                         const TrackedQueue<S> &rays, const Columns &at, uint32_t entry, const Estimator &estimator,
                         TrackingCounts &counts, Constant &&constant) {
    const MediumInfo &medium = scene.media[m];
    const bool chromatic = media.chromatic && (medium.flags & IsChromatic) != 0;
    if (!(medium.flags & IsGrid)) return constant(constant_extinction<S>(scene, {}, medium), chromatic);
    if (chromatic)
        walk_ray<SpectrumSize>(scene, medium, rays, at, entry, estimator, counts);
    else
        walk_ray<1>(scene, medium, rays, at, entry, estimator, counts);
}

// In medium m.
template <class S>
TR_INLINE void fly_ray(const SceneView<S> &scene, const MediumContext<S> &media, int32_t m, const TrackedQueue<S> &rays,
                       uint32_t entry, TrackingCounts &counts) {
    const bool points = media.keeps_points();
    const FlightColumns<S> &at = media.flight;
    track_ray(scene, media, m, rays, at, entry, FlightEstimator<S>{at, points}, counts,
              [&](const Spectrum<S> &sigma, bool chromatic) {
                  fly_constant(sigma, rays.ray_offset, at, chromatic, points, LaneSet<S>(&entry, 1), entry);
              });
}

template <class S>
TR_INLINE void transmit_ray(const SceneView<S> &scene, const MediumContext<S> &media, int32_t m,
                            const TrackedQueue<S> &rays, const TransmittanceColumns<S> &at, uint32_t entry,
                            TrackingCounts &counts) {
    track_ray(scene, media, m, rays, at, entry, TransmittanceEstimator<S>{at}, counts,
              [&](const Spectrum<S> &sigma, bool) {
                  transmit_constant(sigma, rays.ray_offset, at, LaneSet<S>(&entry, 1), entry);
              });
}

}  // namespace tr
