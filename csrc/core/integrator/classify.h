// Which hits belong together: those of one BSDF model, whatever it is wrapped in, so that a packet runs one model.
#pragma once

#include "surface.h"

namespace tr {

// Kinds besides those of the registry's BSDFs: rays that left the scene, collisions in media, and emitters, from which
// light paths begin.
constexpr int MissKind = Bsdfs::Size, CollisionKind = MissKind + 1, EmissionKind = CollisionKind + 1;
constexpr int IgnoredKind = -1;    // nothing is to be done
constexpr int DependentKind = -2;  // of a BSDF: it depends on the hit

// The kind of what a BSDF of the scene is resolved to.
template <class S>
TR_HD int resolved_kind(const SceneView<S> &scene, int bsdf) {
    const Record &r = scene.bsdfs[bsdf];
    auto common = [&](int a, int b) {
        int kind = resolved_kind(scene, a);
        return kind == resolved_kind(scene, b) ? kind : DependentKind;
    };
    if (r.kind < FirstWrapper) return r.kind;
    if (perturbs_normals(r.kind)) return resolved_kind(scene, r.field[NormalMap::Nested]);
    if (r.kind == BlendKind) return common(r.field[BlendBsdf::First], r.field[BlendBsdf::Second]);
    if (r.kind == TwoSidedKind) {
        int front = r.field[TwoSided::Front], back = r.field[TwoSided::Back];
        return common(front, back < 0 ? front : back);
    }
    return DependentKind;  // a mask
}

// The kinds of entries i on of a queue whose rays were traced. `kinds`: by bsdf, resolved_kind. `viewed`: paths from
// the camera, which an environment shines on.
template <class F>
TR_LARGE IntOf<F> classify_hits(const PathContext<F> &c, const PathStep &step, const PathQueue<ScalarOf<F>> &queue,
                                const HitColumns<ScalarOf<F>> &hits, const int32_t *kinds, bool viewed, uint32_t i);

}  // namespace tr
