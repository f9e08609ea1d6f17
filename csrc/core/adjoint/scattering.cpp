#include "scattering.h"

#include "bend.h"

namespace tr {

template <class F>
TR_LARGE void sweep_emitter(const SceneOf<F> &scene, const EmitterPoint<F> &point, const Vec3<F> &d,
                            const Spectrum<F> &g, const GradientNeeds &needs, const MaskOf<F> &active,
                            CoordinateAdjoint<F> &at, Vec3<F> &d_bar, GradientSink<F> &sink) {
    IntOf<F> kind = emitter_kind<F>(scene, point.emitter, active);
    for_each_emitter_kind<F>(kind, active, [&](const EmitterKernels<F> &emitter, const MaskOf<F> &lanes) {
        if (!emitter.is(IsBeam)) emitter.vjp(scene, point, d, g, needs, lanes, at, d_bar, sink);
    });
}

template <class F>
TR_LARGE Vec3<F> sweep_direct(const SceneOf<F> &scene, const DirectAdjoint<F> &g, const MaskOf<F> &lit,
                              GradientSink<F> &sink) {
    Vec3<F> x_bar{F(0), F(0), F(0)};
    IntOf<F> kind = emitter_kind<F>(scene, g.point.emitter, lit);
    for_each_emitter_kind<F>(kind, lit, [&](const EmitterKernels<F> &emitter, const MaskOf<F> &lanes) {
        if (emitter.direct_vjp) emitter.direct_vjp(scene, g, lanes, x_bar, sink);
    });
    return x_bar;
}

template <class F>
TR_LARGE BsdfAdjoint<F>::BsdfAdjoint(const SceneOf<F> &scene, int kind, const VertexRecord<F> &v, Transport transport,
                                     const Spectrum<F> &a, const Spectrum<F> &path_factor,
                                     const Spectrum<F> &light_factor, const GradientNeeds &needs, const MaskOf<F> &lit,
                                     const MaskOf<F> &active, HitAdjoint<F> &hit, GradientSink<F> &sink)
    : bsdf(bsdf_kernels<F>(kind)), connected(bsdf.is(HasSmoothLobes) && any(lit)) {
    load_parameters(scene, sink.waves, bsdf, v.bsdf, v.at, active, params);
    const bool bent = bsdf.bent && (needs.bsdf || needs.geometry);  // its number counts, which is not the record's
    const BsdfNeeds wanted{bent ? BsdfNeeds::All : needs.variables_of(kind), needs.numbers()};
    // at the end of paths, and where rays leave the scene, nothing is behind
    if (any(active && mask<F>(component_sum(magnitude(path_factor)) != F(0))))
        bsdf.vjp(params, v.wi, v.wo, v.lobe, transport, a, path_factor, wanted, path);
    else
        path.clear(bsdf.n_variables);
    if (connected)
        bsdf.vjp(params, v.wi, v.wo_light, bsdf.is(HasDeltaLobes) ? IntOf<F>(0) : v.lobe, transport, a, light_factor,
                 wanted, light);
    else
        light.f = uniform_spectrum(F(0));
    if (!wanted.variables) return;
    // both evaluations share the look-ups: one scatter for their sum
    if (connected)
        for (int i = 0; i < bsdf.n_variables; ++i)
            if (wanted.variables >> i & 1) path.by_variable[i] = path.by_variable[i] + light.by_variable[i];
    sweep_parameters(scene, bsdf, v.bsdf, v.at, path.by_variable, wanted.variables, needs, active, hit.at, sink);
    if (facts::Bends && bsdf.bent)
        sweep_boundary(scene, v.at, v.p, component_sum(path.by_variable[0]), active, hit, sink);
}

template <class F>
TR_LARGE void BsdfAdjoint<F>::sweep_continuation(const SceneOf<F> &scene, const VertexRecord<F> &v,
                                                 const NextVertex<F> &next, const MaskOf<F> &active,
                                                 VertexFrame<F> &frame, Vec3<F> &wi_bar, HitAdjoint<F> &hit,
                                                 GradientSink<F> &sink) const {
    const bool smooth = bsdf.is(HasSmoothLobes);
    wi_bar = wi_bar + path.wi_bar;
    hit.p = hit.p + next.ray.o;
    if (smooth) {
        // (behind a delta lobe of a model that has both, `segment` is 0)
        Vec3<F> w_bar = frame.into(v.wo, path.wo_bar) + next.ray.d;
        Vec3<F> D_bar = direction_adjoint(next.segment, w_bar);
        hit.p = hit.p - D_bar;
        auto glued = active && mask<F>(squared_norm(next.segment) > F(0));
        if (any(glued)) sweep_position(scene, next.at, next.p, D_bar, glued, sink);
    }
    if (bsdf.is(HasDeltaLobes)) {
        Vec3<F> turned = next.ray.d;
        if (smooth) turned = select(mask<F>(v.lobe == 0), Vec3<F>{F(0), F(0), F(0)}, turned);
        F number_bar[BsdfInfo::MaxFields];
        bsdf.direction_vjp(params, v.wi, v.lobe, frame.out_of(v.wo, turned), wi_bar, number_bar);
        if (facts::Bends && bsdf.bent)
            sweep_boundary(scene, v.at, v.p, number_bar[0], active, hit, sink);
        else
            sweep_numbers(scene, bsdf, v.bsdf, v.at, number_bar, active, sink);
    }
}

namespace {

// To the light. Adds to `hit` and to the adjoint of the local wi.
template <class F>
TR_INLINE void sweep_connection(const SceneOf<F> &scene, const VertexRecord<F> &v, const BsdfAdjoint<F> &bsdf,
                                const Spectrum<F> &a, const Spectrum<F> &light_factor, const MaskOf<F> &lit,
                                const Vec3<F> &light_d_bar, const CoordinateAdjoint<F> &light_at,
                                const GradientNeeds &needs, VertexFrame<F> &frame, Vec3<F> &wi_bar, HitAdjoint<F> &hit,
                                GradientSink<F> &sink) {
    wi_bar = wi_bar + bsdf.light.wi_bar;
    Vec3<F> w_bar = frame.into(v.wo_light, bsdf.light.wo_bar) + light_d_bar + v.way.d;
    DirectAdjoint<F> g{v.light,
                       v.p,
                       frame.frame.to_world(v.wo_light),
                       v.light_distance,
                       w_bar,
                       contract(a, apply(bsdf.light.f, light_factor)),
                       light_at,
                       needs.geometry,
                       v.way.end};
    hit.p = hit.p + sweep_direct(scene, g, lit, sink) + v.way.o;
}

}  // namespace

template <class F>
TR_LARGE Spectrum<F> sweep_scattering(const SceneOf<F> &scene, int kind, const VertexRecord<F> &v, Spectrum<F> a,
                                      NextVertex<F> &next, const GradientNeeds &needs, const MaskOf<F> &active,
                                      HitAdjoint<F> &hit, Vec3<F> &d_bar, GradientSink<F> &sink) {
    const bool has_stack = scene.has_stacks;
    Spectrum<F> light_factor = apply(v.through, v.emitted) * v.light_weight;  // N = f_light * light_factor
    Spectrum<F> path_factor = next.radiance * v.inverse_pdf, whole = a;       // above the stack
    auto lit = active && mask<F>(v.light_weight > F(0));
    StackAdjoint<F> stack;
    if (has_stack) {
        stack = StackAdjoint<F>(scene, sink.waves, v, needs, Transport::Radiance, active);
        a = a * stack.bsdf.stack.weight;
        light_factor = light_factor * stack.light_factor;
        path_factor = path_factor * stack.path_factor;
    }
    BsdfAdjoint<F> bsdf(scene, kind, v, Transport::Radiance, a, path_factor, light_factor, needs, lit, active, hit,
                        sink);
    const Spectrum<F> &f = bsdf.path.f, &f_light = bsdf.light.f;
    Spectrum<F> total = apply(f_light, light_factor) + apply(f, path_factor);

    CoordinateAdjoint<F> light_at;
    Vec3<F> light_d_bar{F(0), F(0), F(0)};
    VertexFrame<F> frame(scene, v, bsdf.bsdf.is(FollowsTangent));
    if (bsdf.connected && (needs.emitter || needs.geometry)) {
        Spectrum<F> g = pull(pull(a, f_light), v.through) * v.light_weight;
        if (has_stack) g = g * stack.light_factor;
        sweep_emitter(scene, v.light, frame.frame.to_world(v.wo_light), g, needs, lit, light_at, light_d_bar, sink);
    }
    if (needs.numbers()) {
        if (has_stack && any(stack.factor.shadowed))
            stack.sweep_shadowing(v.normal, Transport::Radiance, contract(a, apply(f_light, light_factor)),
                                  contract(a, apply(f, path_factor)), light_d_bar, next.ray.d, d_bar);
        Vec3<F> wi_bar{F(0), F(0), F(0)};
        bsdf.sweep_continuation(scene, v, next, active, frame, wi_bar, hit, sink);
        if (bsdf.connected)
            sweep_connection(scene, v, bsdf, a, light_factor, lit, light_d_bar, light_at, needs, frame, wi_bar, hit,
                             sink);
        Vec3<F> from_bar = frame.into(v.wi, wi_bar);
        frame.hand_to(hit, scene, v, active);
        d_bar = d_bar - from_bar;
    }
    if (has_stack) {
        stack.finish(scene, v, apply(whole, total), needs, active, hit, sink);
        total = total * stack.bsdf.stack.weight;
    }
    return total;
}

#define TR_INSTANTIATE(F, S)                                                                                          \
    template struct BsdfAdjoint<F>;                                                                                   \
    template void sweep_emitter(const SceneView<S> &, const EmitterPoint<F> &, const Vec3<F> &, const Spectrum<F> &,  \
                                const GradientNeeds &, const MaskOf<F> &, CoordinateAdjoint<F> &, Vec3<F> &,          \
                                GradientSink<F> &);                                                                   \
    template Vec3<F> sweep_direct(const SceneView<S> &, const DirectAdjoint<F> &, const MaskOf<F> &,                  \
                                  GradientSink<F> &);                                                                 \
    template Spectrum<F> sweep_scattering(const SceneView<S> &, int, const VertexRecord<F> &, Spectrum<F>,            \
                                          NextVertex<F> &, const GradientNeeds &, const MaskOf<F> &, HitAdjoint<F> &, \
                                          Vec3<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
