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

// Rays that have come to such a boundary begin anew behind it; returns those that still bring something.
template <class F>
TR_LARGE MaskOf<F> cross_boundary(const PathContext<F> &c, const ShadowQueue<ScalarOf<F>> &shadows,
                                  const TransmittanceColumns<ScalarOf<F>> &at, const SurfacePoint<F> &hit, const F &t,
                                  const UIntOf<F> &id, const MaskOf<F> &active);

}  // namespace tr
