#include "polarized_medium.h"

#include "scattering.h"

namespace tr {

namespace {

// At p, of light that is scattered out of the direction wo into -d; lanes may be in different media.
template <class F>
TR_INLINE ScatteringMatrix<F> scattering_matrix(const SceneOf<F> &scene, const IntOf<F> &medium, const Vec3<F> &p,
                                                const Vec3<F> &d, const Vec3<F> &wo, const MaskOf<F> &active) {
    ScatteringMatrix<F> r{F(1), F(0), F(0), F(0)};
    for_each_distinct<F>(medium, active, [&](int32_t m, const MaskOf<F> &lanes) {
        const int32_t phase = scene.media[m].phase;
        r.f = select(lanes, eval_phase(scene, phase, p, d, wo, lanes), r.f);
        const RayleighShare<F> rayleigh(scene, phase);
        if (!rayleigh.some()) return;
        const ScatteringMatrix<F> found = rayleigh_matrix(dot(d, wo), rayleigh.at(scene, p, lanes));
        r.b = select(lanes, found.b, r.b), r.q = select(lanes, found.q, r.q), r.x = select(lanes, found.x, r.x);
    });
    return r;
}

}  // namespace

template <class F>
TR_LARGE PolarizedCollision<F>::PolarizedCollision(const SceneOf<F> &scene, const Wavelengths<F> &waves,
                                                   const IntOf<F> &medium_, const VertexRecord<F> &v,
                                                   const MaskOf<F> &active)
    : medium(medium_),
      polarizes(false),
      wi(-v.d),
      wo(v.wo),
      wo_light(v.wo_light),
      axis(axis_between(wi, wo)),
      light_axis(axis_between(wi, wo_light)),
      albedo(uniform_spectrum(F(0))),
      inverse_pdf(v.inverse_pdf),
      share(F(0)),
      from_light(apply(v.through, v.emitted) * v.light_weight),
      lamp(scene, v.light, active && mask<F>(v.light_weight > F(0))),
      path(scattering_matrix(scene, medium_, v.p, v.d, v.wo, active)),
      light(scattering_matrix(scene, medium_, v.p, v.d, v.wo_light, active)) {
    for_each_distinct<F>(medium, active, [&](int32_t m, const MaskOf<F> &lanes) {
        const MediumInfo &info = scene.media[m];
        albedo = select(lanes, eval_volume(scene, scene.values, waves, info.albedo, v.p, lanes), albedo);
        const RayleighShare<F> rayleigh(scene, info.phase);
        polarizes = polarizes || rayleigh.some();
        share = select(lanes, rayleigh.at(scene, v.p, lanes), share);
    });
}

template <class F>
TR_HD Stokes<F> PolarizedCollision<F>::scattered(const Way &way, const Stokes<F> &r) const {
    const ScatteringMatrix<F> &m = way.matrix;
    return {{apply(way.factor, r.at[0] * m.f + r.at[1] * m.b), apply(way.factor, r.at[0] * m.b + r.at[1] * m.q),
             apply(way.factor, r.at[2] * m.x), apply(way.factor, r.at[3] * m.x)},
            way.axis};
}

template <class F>
TR_LARGE Stokes<F> PolarizedCollision<F>::column(const Stokes<F> &arriving) const {
    if (!polarizes) {
        Stokes<F> s = no_stokes<F>();
        s.at[0] = apply(albedo, arriving.at[0] * (inverse_pdf * path.f) + from_light * light.f), s.axis = axis;
        return s;
    }
    Stokes<F> s = scattered(path_way(), turned_column(arriving, axis, -wo));
    const Stokes<F> direct = turned_column(scattered(light_way(), sent()), axis, wi);
    for (int i = 0; i < 4; ++i) s.at[i] = s.at[i] + direct.at[i];
    return s;
}

// (the matrix is symmetric)
template <class F>
TR_LARGE Stokes<F> PolarizedCollision<F>::row(const Stokes<F> &leaving) const {
    if (polarizes) return scattered(path_way(), turned_row(leaving, axis, wi));
    Stokes<F> a = no_stokes<F>();
    a.at[0] = pull(leaving.at[0], albedo) * (inverse_pdf * path.f), a.axis = axis;
    return a;
}

template <class F>
TR_LARGE Spectrum<F> PolarizedCollision<F>::direct(const Stokes<F> &leaving) const {
    if (!polarizes) return pull(leaving.at[0], apply(albedo, from_light)) * light.f;
    return number_between(leaving, scattered(light_way(), sent()), wi);
}

template <class F>
TR_HD void PolarizedCollision<F>::sweep_way(const Way &way, const Stokes<F> &leaving, const Stokes<F> &a,
                                            const Stokes<F> &r, Vec3<F> &wi_bar, Vec3<F> &to_bar) const {
    const F by_cosine = contract(way.factor, polarized_part(rayleigh_slope(-dot(wi, way.to), share), a, r));
    wi_bar = wi_bar - way.to * by_cosine, to_bar = to_bar - wi * by_cosine;
    // of what arrives, the column turns with the axis; of what leaves, against it
    const F arriving = component_sum(by_angle(scattered(way, a), r)),
            left = -component_sum(by_angle(leaving, turned_column(scattered(way, r), leaving.axis, wi)));
    sweep_axis(wi, way.to, -way.to, arriving, wi_bar, to_bar);
    sweep_axis(wi, way.to, wi, left, wi_bar, to_bar);
}

// Of the emitter sample's light: its shares and its axis.
template <class F>
TR_HD void PolarizedCollision<F>::sweep_lamp(const SceneOf<F> &scene, const VertexRecord<F> &v, const Stokes<F> &row,
                                             const GradientNeeds &needs, const MaskOf<F> &active, HitAdjoint<F> &hit,
                                             Vec3<F> &to_bar, GradientSink<F> &sink) const {
    const MaskOf<F> lit = active && mask<F>(v.light_weight > F(0));
    const Vec3<F> zero{F(0), F(0), F(0)};
    Vec3<F> travel_bar = zero;
    const Vec3<F> tangent_bar = lamp.sweep(scene, v.light, -wo_light, scattered(light_way(), row),
                                           uniform_spectrum(F(1)), needs, lit, travel_bar, sink);
    to_bar = to_bar - travel_bar;
    if (!needs.geometry) return;
    const CoordinateAdjoint<F> nowhere;
    DirectAdjoint<F> g{v.light, v.p, wo_light, v.light_distance, zero, F(0), nowhere, true};
    g.tangent_bar = tangent_bar;
    hit.p = hit.p + sweep_direct(scene, g, lit, sink);
}

template <class F>
TR_LARGE F PolarizedCollision<F>::sweep(const SceneOf<F> &scene, int, VertexRecord<F> v, const Stokes<F> &leaving,
                                        const Stokes<F> &arriving, NextVertex<F> next, const GradientNeeds &needs,
                                        const MaskOf<F> &active, HitAdjoint<F> &hit, Vec3<F> &d_bar,
                                        GradientSink<F> &sink) const {
    const Spectrum<F> one = uniform_spectrum(F(1)), &a = leaving.at[0];
    PolarizedScattering<F> extra;
    if (polarizes) {
        const Stokes<F> row = turned_row(leaving, axis, wi), r = turned_column(arriving, axis, -wo),
                        light_row = turned_row(leaving, light_axis, wi), sent_ = sent();
        extra.path = polarized_part(path, row, r) * inverse_pdf;
        extra.emitted = apply(v.through, polarized_part(light, light_row, sent_)) * v.light_weight;
        extra.light = apply(extra.emitted, v.emitted);
        if (needs.medium.phase || needs.numbers())
            for_each_distinct<F>(medium, active, [&](int32_t m, const MaskOf<F> &lanes) {
                const RayleighShare<F> rayleigh(scene, scene.media[m].phase);
                const F inverse = F(1) / select(mask<F>(share > F(0)), share, F(1));
                const Spectrum<F> g = apply(albedo, extra.path + extra.light) * inverse;
                const Vec3<F> p_bar = rayleigh.sweep(scene, v.p, g, needs.medium.phase, needs.numbers(), lanes, sink);
                hit.p = select(lanes, hit.p + p_bar, hit.p);
            });
        Vec3<F> wi_bar{F(0), F(0), F(0)}, wo_bar = wi_bar, light_bar = wi_bar;
        if (scene.polarized_lights && (needs.emitter || needs.numbers()))
            sweep_lamp(scene, v, light_row, needs, active, hit, light_bar, sink);
        if (needs.numbers()) {
            sweep_way(path_way(), leaving, row, r, wi_bar, wo_bar);
            sweep_way(light_way(), leaving, light_row, sent_, wi_bar, light_bar);
            next.ray.d = next.ray.d + wo_bar;
            v.way.d = v.way.d + light_bar;
            d_bar = d_bar - wi_bar;
        }
    }
    next.radiance = a * arriving.at[0];
    v.through = a * v.through;
    return component_sum(
        sweep_collision(scene, v, medium, one, next, needs, active, hit.p, d_bar, sink, polarizes ? &extra : nullptr));
}

template <class F>
TR_LARGE Spectrum<F> segment_emission(const SceneOf<F> &scene, const Wavelengths<F> &waves, const SegmentPacket<F> &v,
                                      const MaskOf<F> &active) {
    Spectrum<F> r = uniform_spectrum(F(0));
    for_each_distinct<F>(v.medium, active && mask<F>(v.medium >= 0), [&](int32_t m, const MaskOf<F> &lanes) {
        const int32_t emission = scene.media[m].emission;
        if (emission < 0) return;
        const Spectrum<F> found = eval_volume(scene, scene.values, waves, emission, v.emission_p, lanes);
        r = select(lanes, apply(v.emission_factor * v.length, found), r);
    });
    return r;
}

template <class F>
TR_LARGE Spectrum<F> differential_number(const SceneOf<F> &scene, const SegmentPacket<F> &v, const Vec3<F> &d,
                                         const Vec3<F> &wo, const Spectrum<F> &factor, const Stokes<F> &arriving,
                                         const Stokes<F> &row, const MaskOf<F> &active) {
    const ScatteringMatrix<F> m = scattering_matrix(scene, v.medium, v.differential_p, d, wo, active);
    const Vec3<F> axis = axis_between(-d, wo);
    const Stokes<F> a = turned_row(row, axis, -d), r = turned_column(arriving, axis, -wo);
    const F inverse = F(1) / select(mask<F>(m.f > F(0)), m.f, F(1));
    return select(active, apply(factor, a.at[0] * r.at[0] + polarized_part(m, a, r) * inverse), uniform_spectrum(F(0)));
}

#define TR_INSTANTIATE(F, S)                                                                                      \
    template struct PolarizedCollision<F>;                                                                        \
    template Spectrum<F> segment_emission(const SceneView<S> &, const Wavelengths<F> &, const SegmentPacket<F> &, \
                                          const MaskOf<F> &);                                                     \
    template Spectrum<F> differential_number(const SceneView<S> &, const SegmentPacket<F> &, const Vec3<F> &,     \
                                             const Vec3<F> &, const Spectrum<F> &, const Stokes<F> &,             \
                                             const Stokes<F> &, const MaskOf<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
