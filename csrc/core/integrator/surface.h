// The path tracer at a surface: emission that is found there, a connection to an emitter, and the ray that goes on.
// Scheduling (tiles, queries, threads or kernels) is elsewhere and calls these functions for packets of one BSDF model.
//
// Unidirectional, with delta lobes and Russian roulette on throughput * eta^2. Notation of the derivative
// (adjoint/scattering.h): at vertex k
//   E_k  emission found by BSDF sampling,   N_k  emission found by emitter sampling,
//   f_k / (p_k q_k)  the weight with which the path goes on;   L = beta_0 (E_0 + N_0 + f_0 / (p_0 q_0) (E_1 + ...)).
#pragma once

#include "bsdf_stack.h"
#include "emission.h"

namespace tr {

// A step of all paths of a batch. `depth` counts the vertices before, boundaries included; the first vertex may be
// scattered from several times, `split` says which it is.
struct PathStep {
    int depth, split;
    bool scatters;  // else emission alone counts

    TR_INLINE uint32_t scattering() const { return uint32_t(depth + split); }  // counts blocks of random numbers
};

// Whether the last ray of a path can bring anything, of entries i on of a queue: it does only if it meets a light. What
// it meets counts as seen, light or not.
template <class F>
TR_INLINE MaskOf<F> last_ray_counts(const SceneOf<F> &scene, const PathQueue<ScalarOf<F>> &queue, uint32_t i) {
    Entries<F> from(i);
    const auto meets = may_meet(scene.light_boxes, scene.n_light_boxes, from(queue.o), from(queue.d));
    return meets || mask<F>(from(queue.seen) == UIntOf<F>(0u));
}
// Whether the ray to the last vertex that scatters has a derivative by BSDFs alone: it does if a vertex before has one,
// or if it may meet such a BSDF.
template <class F>
TR_INLINE MaskOf<F> last_scattering_counts(const GradientNeeds &needs, const PathQueue<ScalarOf<F>> &queue,
                                           uint32_t i) {
    Entries<F> from(i);
    const auto meets = may_meet(needs.boxes, needs.n_boxes, from(queue.o), from(queue.d));
    return meets || has_differentiated<F>(from(queue.seen));
}

// Where rays hit; lanes that are not active get any place there is.
template <class F>
TR_INLINE Interaction<F> hit_interaction(const PathContext<F> &c, const Ray<F> &ray, SurfacePoint<F> at, const F &t,
                                         const MaskOf<F> &active) {
    using U = UIntOf<F>;
    at.shape = select(mask<U>(active), at.shape, U(0u));
    at.primitive = select(mask<U>(active), at.primitive, U(0u));
    return make_interaction(c.scene, ray, at, t, active);
}

// The BSDF at a hit, whose frame it may perturb. `viewed`: paths come from where the image is seen from.
template <class F>
TR_LARGE ResolvedBsdf<F> resolve_hit(const PathContext<F> &c, const PacketSamples<F> &samples, Interaction<F> &si,
                                     const Vec3<F> &d, uint32_t scattering, bool viewed, const MaskOf<F> &active);

// The frame in which the model's directions are: that of the hit, or one that follows the tangent.
template <class F>
TR_INLINE void orient(const PathContext<F> &c, const BsdfInfo &bsdf, Interaction<F> &si, const MaskOf<F> &active) {
    if (c.scene.follows_tangent && bsdf.is(FollowsTangent))
        si.frame = tangent_frame(si.frame.n, surface_tangent(c.scene, si.at, active));
}

// The medium behind a surface, for a ray that leaves it along d.
template <class F>
TR_INLINE IntOf<F> medium_behind(const SceneOf<F> &scene, const UIntOf<F> &shape, const Vec3<F> &ng, const Vec3<F> &d,
                                 const IntOf<F> &current, const MaskOf<F> &active) {
    using I = IntOf<F>;
    I sides[2];
    gather_few_rows<F>(&scene.shapes->interior, shape * 16u, active, sides);
    auto boundary = active && (mask<F>(sides[0] >= 0) || mask<F>(sides[1] >= 0));
    I next = select(mask<I>(dot(ng, d) > F(0)), sides[1], sides[0]);
    return select(mask<I>(boundary), next, current);
}

// Lanes whose BSDF, or a weight above it, has a derivative that is wanted.
template <class F>
TR_INLINE MaskOf<F> is_differentiated(const PathContext<F> &c, const ResolvedBsdf<F> &r, const MaskOf<F> &active) {
    using I = IntOf<F>;
    auto wanted = mask<F>(gather<I>(c.needs->bsdfs, UIntOf<F>(r.bsdf), mask<I>(active)) != 0);
    return c.scene.has_stacks ? wanted || r.stack.differentiated : wanted;
}

// The hits of `lanes`, all of one kind (of the registry's BSDFs), entry i on of the tape's level.
template <class F>
TR_LARGE void shade_surface(const PathContext<F> &c, int kind, const PathStep &step, const PathQueue<ScalarOf<F>> &in,
                            const HitColumns<ScalarOf<F>> &hits, const LaneSet<F> &lanes, uint32_t i,
                            PathQueue<ScalarOf<F>> &out, ShadowQueue<ScalarOf<F>> &shadows);

// Rays that left the scene.
template <class F>
TR_LARGE void shade_environment(const PathContext<F> &c, const PathStep &step, const PathQueue<ScalarOf<F>> &in,
                                const LaneSet<F> &lanes, uint32_t i);

// ------------------------------------------------------------------------------------------------------ tape entries
// A path's slot, of vertices that the sweep is to visit.
template <class F>
TR_INLINE UIntOf<F> slot_on_tape(const PathContext<F> &c, const UIntOf<F> &slot, const UIntOf<F> &seen) {
    using U = UIntOf<F>;
    return c.bsdfs_alone ? select(mask<U>(has_differentiated<F>(seen)), slot, U(NoSlot)) : slot;
}

template <class F>
TR_INLINE void write_vertex(const PathContext<F> &c, size_t i, const UIntOf<F> &slot, const UIntOf<F> &parent,
                            const Spectrum<F> &beta, const SurfacePoint<F> &at, const FoundEmission<F> &e) {
    Spectrum<F> none = uniform_spectrum(F(0));
    write(c.tape->vertex, i, VertexPacket<F>{slot, parent, at, beta, e.point.emitter, e.weight, e.radiance, none});
    const auto &stokes = c.tape->stokes;
    if (!stokes.column_axis.x) return;
    write(stokes.column_q, i, none), write(stokes.column_u, i, none), write(stokes.column_v, i, none);
    write(stokes.column_axis, i, Vec3<F>{F(0), F(0), F(0)});
}

template <class F>
TR_INLINE void write_arrival(const PathContext<F> &c, size_t i, const Vec3<F> &d, const Vec3<F> &p,
                             const Vec3<F> &segment, const F &t, const UIntOf<F> &kind) {
    Vec3<F> zero{F(0), F(0), F(0)};
    write(c.tape->arrival, i, ArrivalPacket<F>{d, p, segment, t, kind});
    const auto &next = c.tape->next;
    write(next.ray_o_bar, i, zero), write(next.ray_d_bar, i, zero), write(next.next_segment, i, zero);
    const auto &motion = c.tape->motion;
    if (motion.rest_bar.x) write(motion.rest_bar, i, zero), write(motion.from_bar, i, zero);
}
template <class F>
TR_INLINE UIntOf<F> arrival_kind(const MaskOf<F> &attached) {
    using U = UIntOf<F>;
    return select(mask<U>(attached), U(uint32_t(Attached)), U(uint32_t(Glued)));
}

// How bent rays came, of scenes with media that bend them.
template <class F>
TR_INLINE void write_bent(const PathContext<F> &c, size_t i, const LaneSet<F> &lanes) {
    BentPacket<F> flight;
    read(*c.bent, lanes, flight);
    write(c.tape->bent, i, flight);
}

// No emitter sample, and what comes along the path weighted with `inverse_pdf`.
template <class F>
TR_INLINE OutgoingPacket<F> passing(const F &inverse_pdf) {
    EmitterSample<F> none = no_emitter_sample<F>();
    Vec3<F> z{F(0), F(0), F(1)};
    return {none.point.emitter, none.point.at, z, F(0), F(1), uniform_spectrum(F(0)), z, IntOf<F>(0), inverse_pdf};
}

template <class F>
TR_INLINE void write_scattering(const PathContext<F> &c, size_t i, const ResolvedBsdf<F> &r, const Interaction<F> &si,
                                const Vec3<F> &wi, const OutgoingPacket<F> &to) {
    write(c.tape->outgoing, i, to);
    write(c.tape->scattering, i,
          ScatteringPacket<F>{r.bsdf, si.at.uv, wi, si.frame.n, select(r.mirrored, F(-1), F(1))});
    if (c.scene.has_stacks) write(c.tape->stack, i, StackPacket<F>{r.choice, r.base_normal});
    if (c.scene.follows_tangent) write(c.tape->tangent, i, TangentPacket<F>{si.frame.s});
}

}  // namespace tr
