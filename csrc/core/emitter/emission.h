// Light as it leaves an emitter: where the paths of the particle tracer begin.
#pragma once

#include "emitter.h"

namespace tr {

// A ray of light. What it carries is `weight` times what the emitter sends there (eval_emission), `weight` being the
// cosine over the density of the choice. How it moves when the emitter does, see adjoint/particle.h.
template <class F>
struct EmissionSample {
    EmitterPoint<F> point;
    IntOf<F> kind;
    Vec3<F> p, n, d;  // where on the emitter (or on a disk in front of the scene), its normal, unit direction of travel
    F weight;
    F inverse_pdf;  // of the emitter and of p, by area; of light from afar of the direction, by solid angle
    MaskOf<F> active;
};

// What the emitter sends from a point: as eval_emitter, and of emitters that it does not know.
template <int C, class F, class S>
TR_INLINE Color<F, C> eval_emission(const SceneView<S> &scene, const EmitterPoint<F> &point, const IntOf<F> &kind,
                                    const MaskOf<F> &active) {
    Color<F, C> r = eval_emitter<C>(scene, point, active);
    auto beam = active && mask<F>(kind == int32_t(EmitterKind::DirectionalArea));
    if (any(beam)) {
        IntOf<F> texture = record_field<F>(scene.emitters, DirectionalAreaEmitter::Radiance, point.emitter, beam);
        r = select(beam, eval_texture<C>(scene, scene.values, texture, point.at, beam), r);
    }
    return r;
}

// `choice` chooses the emitter and, with what is left of it, the face of a mesh; (a, b) is a point of the unit square,
// which is spread over the surface (of an environment: over its directions), (c, d) gives the direction (of an
// environment: the place).
template <class F, class S>
TR_INLINE EmissionSample<F> sample_emission(const SceneView<S> &scene, const F &choice, const F &a, const F &b,
                                            const F &c, const F &d, MaskOf<F> active) {
    using U = UIntOf<F>;
    using I = IntOf<F>;
    EmissionSample<F> r;
    ChosenEmitter<F> chosen = choose_emitter(scene, choice, active);
    r.point.emitter = I(chosen.index);
    r.point.at = {U(0u), U(0u), F(0), F(0)};
    r.kind = record_kind<F>(scene.emitters, r.point.emitter, active);
    r.p = {F(0), F(0), F(0)};
    r.n = r.d = {F(0), F(0), F(1)};
    r.weight = r.inverse_pdf = F(0);
    F inverse_pmf = F(1) / max(chosen.pmf, F(1e-20));
    auto is = [&](EmitterKind kind) { return active && mask<F>(r.kind == int32_t(kind)); };

    auto beam = is(EmitterKind::DirectionalArea), surface = is(EmitterKind::Area) || beam;
    if (any(surface)) {
        U shape = U(record_field<F>(scene.emitters, AreaEmitter::ShapeIndex, r.point.emitter, surface));
        SampledPoint<F> q = sample_shape(scene, shape, chosen.left, a, b, surface, true);
        r.point.at.shape = select(mask<U>(surface), q.at.shape, r.point.at.shape);
        r.point.at.primitive = select(mask<U>(surface), q.at.primitive, r.point.at.primitive);
        r.point.at.b1 = select(surface, q.at.b1, r.point.at.b1);
        r.point.at.b2 = select(surface, q.at.b2, r.point.at.b2);
        r.p = select(surface, q.p, r.p);
        r.n = select(surface, q.n, r.n);
        r.d = select(surface, q.n, r.d);
        auto spread = surface && !beam;
        if (any(spread)) r.d = select(spread, make_frame(q.n).to_world(square_to_cosine_hemisphere(c, d)), r.d);
        r.inverse_pdf = select(surface, inverse_pmf / q.pdf, r.inverse_pdf);
        r.weight = select(surface, r.inverse_pdf * select(beam, F(1), F(Pi)), r.weight);
    }
    for_each_point_light<F>(r.kind, active, [&](auto model, const MaskOf<F> &lanes) {
        using Model = decltype(model);
        LightNumbers<Model, F> numbers(scene, r.point.emitter, lanes);
        F inverse_pdf;
        Vec3<F> local = Model::sample(numbers.value, a, b, inverse_pdf);
        auto frame = point_light_frame<Model, F>(scene, r.point.emitter, lanes);
        r.p = select(lanes, frame.p, r.p);
        r.weight = select(lanes, inverse_pmf * inverse_pdf, r.weight);
        if constexpr (Model::Oriented) {
            Vec2<F> at = direction_to_point(local);
            r.point.at.b1 = select(lanes, at.x, r.point.at.b1);
            r.point.at.b2 = select(lanes, at.y, r.point.at.b2);
            local = normalize(frame.to_world(local));
        }
        r.d = select(lanes, local, r.d);
    });
    // through a disk as wide as the scene, from in front of it
    auto from_afar = [&](const Vec3<F> &from, const MaskOf<F> &lanes) {
        Vec2<F> disk = square_to_disk(c, d);
        Vec3<F> center{F(scene.center[0]), F(scene.center[1]), F(scene.center[2])};
        Frame<F> frame = make_frame(from);
        Vec3<F> p = center + (frame.s * disk.x + frame.t * disk.y + from) * F(scene.radius);
        r.p = select(lanes, p, r.p);
        r.n = select(lanes, -from, r.n);
        r.d = select(lanes, -from, r.d);
        r.weight = select(lanes, r.inverse_pdf * F(S(Pi) * scene.radius * scene.radius), r.weight);
    };
    auto directional = is(EmitterKind::Directional);
    if (any(directional)) {
        r.inverse_pdf = select(directional, inverse_pmf, r.inverse_pdf);
        from_afar(-normalize(DirectionalEmitter::axis<F>(scene, r.point.emitter, directional)), directional);
    }
    if (scene.environment >= 0) {
        auto here = active && mask<F>(r.point.emitter == scene.environment);
        if (any(here)) {
            Vec2<F> uv;
            F pdf;
            Vec3<F> from = sample_environment(scene, a, b, uv, pdf, here);
            r.point.at.b1 = select(here, uv.x, r.point.at.b1);
            r.point.at.b2 = select(here, uv.y, r.point.at.b2);
            auto possible = here && mask<F>(pdf > F(0));
            r.inverse_pdf = select(possible, inverse_pmf / select(possible, pdf, F(1)), r.inverse_pdf);
            from_afar(from, here);
        }
    }
    r.active = active && mask<F>(r.weight > F(0));
    return r;
}

}  // namespace tr
