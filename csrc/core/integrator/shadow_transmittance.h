// Shadow rays of volumetric paths: through media, and through boundaries that do not scatter, part by part. Scheduling
// traces the parts and lets the media transmit them (medium/estimators.h).
#pragma once

#include "medium.h"

namespace tr {

// The part of a shadow ray in front of what it has met. `round` counts the parts, `level` the segments of the path;
// `id` are entries of the queue.
template <class F>
TR_LARGE void seed_shadow_rays(const PathContext<F> &c, const ShadowQueue<ScalarOf<F>> &shadows,
                               const TransmittanceColumns<ScalarOf<F>> &at, uint32_t level, uint32_t round,
                               const UIntOf<F> &id, const MaskOf<F> &active);

// Whether rays go on behind this shape.
template <class S>
TR_INLINE bool passes_shadow_rays(const SceneView<S> &scene, uint32_t shape) {
    return scene.bsdfs[scene.shapes[shape].bsdf].kind == NullKind;
}

// Ray k, before its first part. `moves`: the part with its point is kept, see MotionColumns.
template <class S>
TR_INLINE void begin_shadow(const TransmittanceColumns<S> &at, uint32_t k, bool recording, bool moves) {
    for (int c = 0; c < SpectrumSize; ++c) at.transmittance[c][k] = S(1);
    if (recording) at.total_length[k] = S(0);
    if (moves) at.begin[k] = S(0), at.boundary.shape[k] = NoHit;
}

// A point of ray k uniform on all of the parts so far that are in media, of which the last, in medium m, ends at `met`.
template <class S>
TR_INLINE void choose_point(const ShadowQueue<S> &shadows, const TransmittanceColumns<S> &at, uint32_t k, int32_t m,
                            const SurfacePoint<S> &met, bool moves) {
    const S length = at.length[k];
    if (!(length > 0)) return;
    at.total_length[k] += length;
    if (!(at.choice[k] * at.total_length[k] < length)) return;
    at.point_medium[k] = m;
    const S place = at.start[k] + at.place[k] * length;
    at.point.set(k, shadows.o.get(k) + shadows.d.get(k) * place);
    if (!moves) return;
    const S first = at.begin[k] + shadows.ray_offset[k];  // distance of the part's origin
    at.part_from.copy(k, at.boundary, k), at.part_to.set(k, met);
    at.part_t0[k] = at.begin[k], at.part_t1[k] = first + at.end[k], at.part_t[k] = first + place;
}

// The next part of ray k begins at `met`, t behind the origin of the last one.
template <class S>
TR_INLINE void keep_boundary(const ShadowQueue<S> &shadows, const TransmittanceColumns<S> &at, uint32_t k,
                             const SurfacePoint<S> &met, S t) {
    at.begin[k] = at.begin[k] + shadows.ray_offset[k] + t;
    at.boundary.set(k, met);
}

// What ray k brings onto the tape. `differential`: segments have differential samples.
template <class S>
TR_INLINE void record_shadow(const TapeColumns<S> &tape, const ShadowQueue<S> &shadows,
                             const TransmittanceColumns<S> &t, uint32_t k, bool differential, bool moves) {
    const SegmentColumns<S> &segment = tape.segment;
    const uint32_t at = shadows.position[k];
    const bool of_sample = shadows.purpose[k] == uint32_t(ShadowPurpose::Differential);
    const SpectrumColumn<S> &value = of_sample ? segment.differential_value : segment.shadow_value;
    for (int c = 0; c < SpectrumSize; ++c) value[c][at] = t.transmittance[c][k] * shadows.contribution[c][k];
    if (of_sample) return;
    for (int c = 0; c < SpectrumSize; ++c) segment.through[c][at] = t.transmittance[c][k];
    if (!differential || t.total_length[k] == 0) return;
    segment.shadow_p.set(at, t.point.get(k));
    segment.shadow_length[at] = t.total_length[k];
    segment.shadow_medium[at] = t.point_medium[k];
    if (!moves) return;
    const MotionColumns<S> &motion = tape.motion;
    motion.shadow_d.set(at, shadows.d.get(k));
    motion.shadow_from.copy(at, t.part_from, k), motion.shadow_to.copy(at, t.part_to, k);
    motion.shadow_t0[at] = t.part_t0[k], motion.shadow_t1[at] = t.part_t1[k], motion.shadow_t[at] = t.part_t[k];
}

// Rays that have come to such a boundary begin anew behind it; returns those that still bring something.
template <class F>
TR_LARGE MaskOf<F> cross_boundary(const PathContext<F> &c, const ShadowQueue<ScalarOf<F>> &shadows,
                                  const TransmittanceColumns<ScalarOf<F>> &at, const SurfacePoint<F> &hit, const F &t,
                                  const UIntOf<F> &id, const MaskOf<F> &active);

}  // namespace tr
