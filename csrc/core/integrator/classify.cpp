#include "classify.h"

#include "../medium/bend_medium.h"

namespace tr {

namespace {

template <class F>
TR_INLINE IntOf<F> surface_kinds(const PathContext<F> &c, const PathStep &step, const PathQueue<ScalarOf<F>> &queue,
                                 const HitColumns<ScalarOf<F>> &hits, const int32_t *kinds, bool viewed,
                                 const IntOf<F> &bsdf, const MaskOf<F> &hit, uint32_t i, IntOf<F> kind) {
    using U = UIntOf<F>;
    using I = IntOf<F>;
    I found[1];
    gather_few_rows<F>(kinds, U(bsdf), hit, found);
    kind = select(mask<I>(hit), found[0], kind);
    auto dependent = hit && mask<F>(kind == DependentKind);
    if (!any(dependent)) return kind;
    Entries<F> from(i);
    Ray<F> ray{from(queue.o), from(queue.d)};
    Interaction<F> si = hit_interaction(c, ray, from(hits.at), from(hits.t), dependent);
    PacketSamples<F> samples(c, select(mask<U>(dependent), from(queue.slot), U(0u)), dependent);
    ResolvedBsdf<F> r = resolve_hit(c, samples, si, ray.d, step.scattering(), viewed, dependent);
    return select(mask<I>(dependent), resolved_kind(c.scene, r, dependent), kind);
}

}  // namespace

template <class F>
TR_LARGE IntOf<F> classify_hits(const PathContext<F> &c, const PathStep &step, const PathQueue<ScalarOf<F>> &queue,
                                const HitColumns<ScalarOf<F>> &hits, const int32_t *kinds, bool viewed, uint32_t i) {
    using U = UIntOf<F>;
    using I = IntOf<F>;
    using M = MaskOf<F>;
    const bool volumetric = c.config.volumetric, looks_behind = viewed && c.scene.environment >= 0;
    Entries<F> from(i);
    U shape = from.get(hits.at.shape);
    M active = mask<F>(U(i) + lane_index<F>() < U(queue.n));
    M missed = active && mask<F>(shape == U(NoHit)), hit = active && !missed;
    M shows = missed && M(looks_behind);
    if (!volumetric && c.config.hide_emitters && step.depth == 0) shows = M(false);
    I kind(IgnoredKind);
    if (volumetric) {
        M collided = active && mask<F>(shape == U(MediumHit));
        hit = hit && !collided;
        // a segment through a medium has a derivative wherever it ends
        if (c.tape) shows = shows || (missed && mask<F>(from(queue.medium) >= 0));
        kind = select(mask<I>(collided), I(CollisionKind), kind);
    }
    kind = select(mask<I>(shows), I(MissKind), kind);
    if (!any(hit)) return kind;
    ShapeLanes<F> info(c.scene.shapes, shape, hit);
    // at their last vertex paths bring emission alone, of which that on the way is known unless it has a derivative
    if (!volumetric && !step.scatters && step.depth > 0) {
        M brings = mask<F>(info.emitter >= 0);
        if (c.tape && c.bent) brings = brings || emits<F>(c.scene, from(c.bent->medium), hit);
        hit = hit && brings;
    }
    if (!any(hit)) return kind;
    kind = surface_kinds(c, step, queue, hits, kinds, viewed, info.bsdf, hit, i, kind);
    if (volumetric && c.config.hide_emitters) {  // camera rays pass through lights
        M hidden = hit && mask<F>(info.emitter >= 0) && mask<F>(from(queue.depth) == U(0u));
        kind = select(mask<I>(hidden), I(NullKind), kind);
    }
    return kind;
}

#define TR_INSTANTIATE(F, S)                                                                        \
    template IntOf<F> classify_hits(const PathContext<F> &, const PathStep &, const PathQueue<S> &, \
                                    const HitColumns<S> &, const int32_t *, bool, uint32_t);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
