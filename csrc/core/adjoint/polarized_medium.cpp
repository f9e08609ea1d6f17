#include "polarized_medium.h"

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

// The same over f, which samples of the phase function have as their density.
template <class F>
TR_INLINE ScatteringMatrix<F> normalized(ScatteringMatrix<F> m) {
    const F inverse = F(1) / select(mask<F>(m.f > F(0)), m.f, F(1));
    m.b = m.b * inverse, m.q = m.q * inverse, m.x = m.x * inverse, m.f = F(1);
    return m;
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
TR_HD Stokes<F> PolarizedCollision<F>::from_light_column() const {
    Stokes<F> r = no_stokes<F>();
    const Spectrum<F> one = apply(albedo, from_light);
    r.at[0] = one * light.f, r.at[1] = one * light.b, r.axis = light_axis;
    return r;
}

template <class F>
TR_LARGE Stokes<F> PolarizedCollision<F>::column(const Stokes<F> &arriving) const {
    const Spectrum<F> factor = albedo * inverse_pdf;
    Stokes<F> s = no_stokes<F>(), direct = from_light_column();
    s.axis = axis;
    if (!polarizes) {
        s.at[0] = apply(factor, arriving.at[0]) * path.f + direct.at[0];
        return s;
    }
    const Stokes<F> r = turned_column(arriving, axis, -wo);
    s.at[0] = apply(factor, r.at[0] * path.f + r.at[1] * path.b);
    s.at[1] = apply(factor, r.at[0] * path.b + r.at[1] * path.q);
    s.at[2] = apply(factor, r.at[2] * path.x), s.at[3] = apply(factor, r.at[3] * path.x);
    direct = turned_column(direct, axis, wi);
    for (int i = 0; i < 4; ++i) s.at[i] = s.at[i] + direct.at[i];
    return s;
}

template <class F>
TR_LARGE Stokes<F> PolarizedCollision<F>::row(const Stokes<F> &leaving) const {
    const Spectrum<F> factor = albedo * inverse_pdf;
    Stokes<F> s = no_stokes<F>();
    s.axis = axis;
    if (!polarizes) {
        s.at[0] = pull(leaving.at[0], factor) * path.f;
        return s;
    }
    const Stokes<F> a = turned_row(leaving, axis, wi);
    s.at[0] = pull(a.at[0] * path.f + a.at[1] * path.b, factor);
    s.at[1] = pull(a.at[0] * path.b + a.at[1] * path.q, factor);
    s.at[2] = pull(a.at[2] * path.x, factor), s.at[3] = pull(a.at[3] * path.x, factor);
    return s;
}

template <class F>
TR_LARGE Spectrum<F> PolarizedCollision<F>::direct(const Stokes<F> &leaving) const {
    return number_between(leaving, from_light_column(), wi);
}

// Of the matrices by their cosines and axes.
template <class F>
TR_HD void PolarizedCollision<F>::sweep_directions(const Stokes<F> &leaving, const Stokes<F> &arriving, Vec3<F> &wi_bar,
                                                   Vec3<F> &wo_bar, Vec3<F> &light_bar) const {
    const Stokes<F> a = turned_row(leaving, axis, wi), r = turned_column(arriving, axis, -wo),
                    of_light = turned_row(leaving, light_axis, wi), direct = from_light_column();
    const F cosine = -dot(wi, wo), light_cosine = -dot(wi, wo_light);
    const F bar = contract(albedo * inverse_pdf, polarized_part(rayleigh_slope(cosine, share), a, r)),
            light_cosine_bar =
                contract(apply(albedo, from_light), of_light.at[1]) * rayleigh_slope(light_cosine, share).b;
    wi_bar = wi_bar - wo * bar - wo_light * light_cosine_bar;
    wo_bar = wo_bar - wi * bar, light_bar = light_bar - wi * light_cosine_bar;
    // the axis: the column that arrives turns with it, and what leaves against it
    Stokes<F> sent = column(arriving);
    const Stokes<F> along_light = turned_column(direct, axis, wi);
    for (int i = 0; i < 4; ++i) sent.at[i] = sent.at[i] - along_light.at[i];
    const F arriving_bar = component_sum(by_angle(row(leaving), r)),
            leaving_bar = -component_sum(by_angle(leaving, turned_column(sent, leaving.axis, wi)));
    sweep_axis(wi, wo, -wo, arriving_bar, wi_bar, wo_bar);
    sweep_axis(wi, wo, wi, leaving_bar, wi_bar, wo_bar);
    const F direct_bar = -component_sum(by_angle(leaving, turned_column(direct, leaving.axis, wi)));
    sweep_axis(wi, wo_light, wi, direct_bar, wi_bar, light_bar);
}

template <class F>
TR_LARGE void PolarizedCollision<F>::sweep(const SceneOf<F> &scene, int, VertexRecord<F> v, const Stokes<F> &leaving,
                                           const Stokes<F> &arriving, NextVertex<F> next, const GradientNeeds &needs,
                                           const MaskOf<F> &active, HitAdjoint<F> &hit, Vec3<F> &d_bar,
                                           GradientSink<F> &sink) const {
    const Spectrum<F> one = uniform_spectrum(F(1)), &a = leaving.at[0];
    PolarizedScattering<F> extra;
    if (polarizes) {
        const Stokes<F> row_ = turned_row(leaving, axis, wi), r = turned_column(arriving, axis, -wo);
        extra.path = polarized_part(path, row_, r) * inverse_pdf;
        extra.emitted = turned_row(leaving, light_axis, wi).at[1] * (light.b * v.light_weight);
        extra.emitted = apply(v.through, extra.emitted);
        extra.light = apply(extra.emitted, v.emitted);
        if (needs.medium.phase || needs.numbers())
            for_each_distinct<F>(medium, active, [&](int32_t m, const MaskOf<F> &lanes) {
                const RayleighShare<F> rayleigh(scene, scene.media[m].phase);
                const F inverse = F(1) / select(mask<F>(share > F(0)), share, F(1));
                const Spectrum<F> g = apply(albedo, extra.path + extra.light) * inverse;
                const Vec3<F> p_bar = rayleigh.sweep(scene, v.p, g, needs.medium.phase, needs.numbers(), lanes, sink);
                hit.p = select(lanes, hit.p + p_bar, hit.p);
            });
        if (needs.numbers()) {
            Vec3<F> wi_bar{F(0), F(0), F(0)}, wo_bar = wi_bar, light_bar = wi_bar;
            sweep_directions(leaving, arriving, wi_bar, wo_bar, light_bar);
            next.ray.d = next.ray.d + wo_bar;
            v.way.d = v.way.d + light_bar;
            d_bar = d_bar - wi_bar;
        }
    }
    next.radiance = a * arriving.at[0];
    v.through = a * v.through;
    sweep_collision(scene, v, medium, one, next, needs, active, hit.p, d_bar, sink, polarizes ? &extra : nullptr);
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
                                         const Vec3<F> &wo_light, const Stokes<F> &row, const MaskOf<F> &active) {
    const Spectrum<F> none = uniform_spectrum(F(0));
    const MaskOf<F> lit = active && mask<F>(v.medium >= 0) && mask<F>(max_component(v.differential_value) > F(0));
    if (!any(lit)) return none;
    const ScatteringMatrix<F> m = normalized(scattering_matrix(scene, v.medium, v.differential_p, d, wo_light, lit));
    const Stokes<F> a = turned_row(row, axis_between(-d, wo_light), -d);
    return select(lit, apply(a.at[0] + a.at[1] * m.b, v.differential_value), none);
}

template <class F>
TR_LARGE Spectrum<F> branch_number(const SceneOf<F> &scene, const SegmentPacket<F> &v, const Vec3<F> &d,
                                   const Vec3<F> &wo, const Spectrum<F> &factor, const Stokes<F> &arriving,
                                   const Stokes<F> &row, const MaskOf<F> &active) {
    const ScatteringMatrix<F> m = normalized(scattering_matrix(scene, v.medium, v.differential_p, d, wo, active));
    const Vec3<F> axis = axis_between(-d, wo);
    const Stokes<F> a = turned_row(row, axis, -d), r = turned_column(arriving, axis, -wo);
    return select(active, apply(factor, a.at[0] * r.at[0] + polarized_part(m, a, r)), uniform_spectrum(F(0)));
}

#define TR_INSTANTIATE(F, S)                                                                                       \
    template struct PolarizedCollision<F>;                                                                         \
    template Spectrum<F> segment_emission(const SceneView<S> &, const Wavelengths<F> &, const SegmentPacket<F> &,  \
                                          const MaskOf<F> &);                                                      \
    template Spectrum<F> differential_number(const SceneView<S> &, const SegmentPacket<F> &, const Vec3<F> &,      \
                                             const Vec3<F> &, const Stokes<F> &, const MaskOf<F> &);               \
    template Spectrum<F> branch_number(const SceneView<S> &, const SegmentPacket<F> &, const Vec3<F> &,            \
                                       const Vec3<F> &, const Spectrum<F> &, const Stokes<F> &, const Stokes<F> &, \
                                       const MaskOf<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
