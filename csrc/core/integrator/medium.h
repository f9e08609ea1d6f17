// The path tracer in media: free flight, collisions, boundaries that do not scatter, and what the derivative of a
// segment needs besides. The counterpart of surface.h for points in space.
#pragma once

#include "../medium/tracking.h"
#include "../sensor/camera.h"
#include "surface.h"

namespace tr {

// What media have in common for a batch of paths.
template <class F>
struct MediumContext {
    using S = ScalarOf<F>;
    FlightColumns<S> flight{};
    BranchColumns<S> branch{};
    TR_CHROMATIC_MEDIA(chromatic) = false;  // a medium of the scene is
    bool emissive = false;                  // likewise
    bool differential = false;              // the extinction or a place is: segments have differential samples
    bool replaying = false;                 // levels go onto the tape once more
    uint32_t level = 0;                     // of the segments

    MediumContext() = default;
#if !defined(TR_ONE_SCENE)
    // `needs`: of a derivative; null: there is none.
    MediumContext(const SceneView<S> &scene, const GradientNeeds *needs) {
        for (int m = 0; m < scene.n_media; ++m) {
            chromatic |= (scene.media[m].flags & IsChromatic) != 0;
            emissive |= scene.media[m].emission >= 0;
        }
        differential = needs && (needs->medium.extinction || needs->geometry);
    }
#endif

    // Whether tracking keeps points on the segments.
    TR_HD bool keeps_points() const { return differential || emissive; }
};

// Whether a path may scatter once more after `depth` scatterings.
template <class F>
TR_INLINE MaskOf<F> may_scatter(const PathConfig &config, const UIntOf<F> &depth) {
    using I = IntOf<F>;
    return config.max_depth < 0 ? MaskOf<F>(true) : mask<F>(I(depth) + 1 < I(config.max_depth));
}

// Of entries i on of the queue of camera rays, and of slots i on.
template <class F>
TR_LARGE void begin_media(const PathContext<F> &c, PathQueue<ScalarOf<F>> &queue, uint32_t i);
template <class F>
TR_LARGE void begin_media_slots(const PathContext<F> &c, const MediumContext<F> &m, uint32_t i);

// Before free flight, entries i on of a queue whose rays were traced: how far they may fly, and their random numbers.
template <class F>
TR_LARGE void begin_flight(const PathContext<F> &c, const MediumContext<F> &m, const PathQueue<ScalarOf<F>> &queue,
                           const HitColumns<ScalarOf<F>> &hits, uint32_t i);
// After it: collisions become hits; the components' weights, and with `add_radiance` emission along the segments.
template <class F>
TR_LARGE void finish_flight(const PathContext<F> &c, const MediumContext<F> &m, PathQueue<ScalarOf<F>> &queue,
                            const HitColumns<ScalarOf<F>> &hits, bool add_radiance, uint32_t i);

// A collision.
template <class F>
TR_LARGE void shade_medium(const PathContext<F> &c, const PathStep &step, const PathQueue<ScalarOf<F>> &in,
                           const HitColumns<ScalarOf<F>> &hits, const LaneSet<F> &lanes, uint32_t i,
                           PathQueue<ScalarOf<F>> &out, ShadowQueue<ScalarOf<F>> &shadows);

// A boundary that does not scatter: the ray goes on behind it, as if from where it came.
template <class F>
TR_LARGE void pass_boundary(const PathContext<F> &c, const PathQueue<ScalarOf<F>> &in,
                            const HitColumns<ScalarOf<F>> &hits, const LaneSet<F> &lanes, uint32_t i,
                            const Interaction<F> &si, PathQueue<ScalarOf<F>> &out);

// What the tape keeps of a segment, whatever it ends with, and the emitter sample of its differential sample.
template <class F>
TR_LARGE void record_segment(const PathContext<F> &c, const MediumContext<F> &m, const PathStep &step,
                             const PathQueue<ScalarOf<F>> &in, const HitColumns<ScalarOf<F>> &hits,
                             const LaneSet<F> &lanes, uint32_t i, ShadowQueue<ScalarOf<F>> &shadows);

// The paths that go on from differential samples, slots i on.
template <class F>
TR_LARGE void start_branches(const PathContext<F> &c, const MediumContext<F> &m, uint32_t i, uint32_t n_slots,
                             PathQueue<ScalarOf<F>> &out);
constexpr uint32_t NoLevel = 0xFFFFFFFFu;

}  // namespace tr
