#include "polarization.h"

#include "../bsdf/dielectric_microfacet.h"
#include "scattering.h"

namespace tr {

namespace {

// The number that a row and a column of one colour make, on one axis.
template <class M, class F>
TR_INLINE auto contracted(Polarization kind, const M &m, const Stokes<F> &a, const Stokes<F> &r, int c) {
    if (kind == Polarization::Circular)
        return m.b * (a.at[0][c] * r.at[3][c] + a.at[3][c] * r.at[0][c]) +
               (a.at[0][c] * r.at[0][c] + a.at[3][c] * r.at[3][c]);
    const F same = a.at[0][c] * r.at[0][c] + a.at[1][c] * r.at[1][c];
    return m.b * (a.at[0][c] * r.at[1][c] + a.at[1][c] * r.at[0][c]) +
           m.x * (a.at[2][c] * r.at[2][c] + a.at[3][c] * r.at[3][c]) +
           m.y * (a.at[3][c] * r.at[2][c] - a.at[2][c] * r.at[3][c]) + same;
}

// Where a field's value is among the parameters of a component.
constexpr int number_of(const BsdfInfo &info, int field, int component) {
    int colors = 0, numbers = 0;
    for (int i = 0; i < field; ++i) (info.use[i] == BsdfInfo::Color ? colors : numbers) += 1;
    return info.use[field] == BsdfInfo::Color ? SpectrumSize * colors + component
                                              : SpectrumSize * info.n_colors + numbers;
}

// The axis of a plate: in local coordinates that which its vector in the plate has, and how it changes by an angle in
// degrees; a polariser's is the one that it absorbs, of which what lies across the ray counts (Korger et al., "The
// polarization properties of a tilted polarizer", Optics Express 21(22), 2013).
template <class F>
struct PlateAxis {
    Vec3<F> local, change;
    bool absorbs;

    TR_INLINE explicit PlateAxis(const PolarizedVertex<F> &v) : absorbs(v.kind == Polarization::Polarizer) {
        const F theta = v.params.number[number_of(v.bsdf, v.bsdf.theta, 0)] * F(Pi / 180);
        const F c = cos(theta), s = sin(theta), unit(Pi / 180);
        // (a polariser's angle has the other sense than a retarder's in Mitsuba, whose files we read)
        local = absorbs ? Vec3<F>{s, c, F(0)} : Vec3<F>{c, s, F(0)};
        change = (absorbs ? Vec3<F>{c, -s, F(0)} : Vec3<F>{-s, c, F(0)}) * unit;
    }
    // `k`: where the light travels.
    TR_INLINE Vec3<F> across(const Vec3<F> &a, const Vec3<F> &k) const {
        return absorbs ? cross(a, k) : a - k * dot(a, k);
    }
};

TR_HD inline bool is_plate(Polarization kind) {
    return kind == Polarization::Polarizer || kind == Polarization::Retarder;
}

// (seen along itself it has no axis)
template <class F>
TR_INLINE Vec3<F> across_plate(const PlateAxis<F> &plate, const Frame<F> &frame, const Vec3<F> &k) {
    Vec3<F> m = plate.across(frame.to_world(plate.local), k), s, t;
    coordinate_system(k, s, t);
    return select(mask<F>(squared_norm(m) > F(1e-12)), m, s);
}

// The matrix of one colour as a function of z, eta and k, with derivatives by these if T has them.
template <class T, class F>
TR_INLINE FacetMatrix<T> matrix_of(const PolarizedVertex<F> &v, const Vec3<F> &to, const F &local_z,
                                   const MaskOf<F> &reflects, int c) {
    const auto variable = [&](const F &value, int i) {
        if constexpr (std::is_same_v<T, F>)
            return value;
        else
            return T(value, i);
    };
    if (v.kind == Polarization::Circular)
        return {T(select(mask<F>(v.params.choice[0] == 0), F(1), F(-1))), T(F(0)), T(F(0))};
    if (v.kind == Polarization::Retarder) {
        const F delta = v.params.number[number_of(v.bsdf, v.bsdf.eta, c)] * F(Pi / 180);
        const F cosine = cos(delta), sine = sin(delta);
        FacetMatrix<T> r{T(F(0)), T(cosine), T(-sine)};
        if constexpr (!std::is_same_v<T, F>) r.x.d[1] = sine * F(-Pi / 180), r.y.d[1] = cosine * F(-Pi / 180);
        return r;
    }
    const T z = variable(v.smooth ? local_z : dot(v.wi, to), 0);
    if (v.kind == Polarization::Pass || v.kind == Polarization::Polarizer)
        return facet_matrix<T>(v.kind, v.smooth, reflects, z, T(F(1)), T(F(0)));
    T eta = variable(v.params.number[number_of(v.bsdf, v.bsdf.eta, c)], 1), k(F(0));
    if (v.kind == Polarization::Metal) {
        k = variable(v.params.number[number_of(v.bsdf, v.bsdf.k, c)], 2);
    } else {
        if (!v.smooth) eta = clamp_eta(eta);
        auto outside = mask<F>(!(local_z < F(0)));
        if (v.kind == Polarization::Interface) eta = select(outside, eta, T(F(1)) / eta);
    }
    return facet_matrix<T>(v.kind, v.smooth, reflects, z, eta, k);
}

}  // namespace

template <class F>
TR_LARGE PolarizedVertex<F>::PolarizedVertex(const SceneOf<F> &scene, const Wavelengths<F> &waves, int bsdf_kind,
                                             const VertexRecord<F> &v, const GradientNeeds &needs,
                                             const MaskOf<F> &active)
    : bsdf(bsdf_kernels<F>(bsdf_kind)), kind(bsdf.polarizes), smooth(!bsdf.is(HasSmoothLobes)) {
    load_parameters(scene, waves, bsdf, v.bsdf, v.at, active, params);
    const Spectrum<F> one = uniform_spectrum(F(1)), none = uniform_spectrum(F(0));
    const MaskOf<F> lit = active && mask<F>(v.light_weight > F(0));
    BsdfDerivative<F> value;
    bsdf.vjp(params, v.wi, v.wo, v.lobe, Transport::Radiance, one, one, {false, false}, value);
    const MaskOf<F> goes_on = active && mask<F>(v.inverse_pdf > F(0));
    path = select(goes_on, value.f * v.inverse_pdf, none);
    light = none;
    if (bsdf.is(HasSmoothLobes) && any(lit)) {
        bsdf.vjp(params, v.wi, v.wo_light, IntOf<F>(0), Transport::Radiance, one, one, {false, false}, value);
        light = select(lit, apply(value.f, v.emitted) * v.light_weight, none);
    }
    if (scene.has_stacks) {
        const StackAdjoint<F> stack(scene, waves, v, needs, Transport::Radiance, active);
        path = path * stack.bsdf.stack.weight * stack.path_factor;
        light = light * stack.bsdf.stack.weight * stack.light_factor;
    }
    if (kind == Polarization::None) return;
    Frame<F> frame = vertex_frame(scene, v);
    frame.n = frame.n * v.mirror;
    // (where nothing comes from, any direction that is finite)
    const Vec3<F> from = select(goes_on, v.wo, v.wi), from_light = select(lit, v.wo_light, v.wi);
    wi = frame.to_world(v.wi), wo = frame.to_world(from), wo_light = frame.to_world(from_light), n = frame.n;
    axis = is_plate(kind)               ? across_plate(PlateAxis<F>(*this), frame, wi)
           : kind == Polarization::Pane ? axis_between(n, wi)  // (light that passes goes on as it came)
                                        : axis_between(wi, wo);
    light_axis = axis_between(wi, wo_light);
    reflects = mask<F>(v.wi.z * from.z > F(0)), light_reflects = mask<F>(v.wi.z * from_light.z > F(0));
    for (int c = 0; c < SpectrumSize; ++c) {
        matrix[c] = matrix_of<F>(*this, wo, v.wi.z, reflects, c);
        if (!smooth) of_light[c] = matrix_of<F>(*this, wo_light, v.wi.z, light_reflects, c);
    }
}

template <class F>
TR_HD Stokes<F> PolarizedVertex<F>::scattered(const Stokes<F> &r) const {
    Stokes<F> out{{}, axis};
    for (int c = 0; c < SpectrumSize; ++c) {
        const auto &m = matrix[c];
        const F i = r.at[0][c], q = r.at[1][c], u = r.at[2][c], v = r.at[3][c];
        if (kind == Polarization::Circular) {
            out.at[0][c] = path[c] * (i + m.b * v), out.at[3][c] = path[c] * (m.b * i + v);
            out.at[1][c] = out.at[2][c] = F(0);
            continue;
        }
        out.at[0][c] = path[c] * (i + m.b * q), out.at[1][c] = path[c] * (m.b * i + q);
        out.at[2][c] = path[c] * (m.x * u - m.y * v), out.at[3][c] = path[c] * (m.y * u + m.x * v);
    }
    return out;
}

template <class F>
TR_LARGE Stokes<F> PolarizedVertex<F>::column(const Stokes<F> &arriving) const {
    if (kind == Polarization::None) {
        Stokes<F> r = no_stokes<F>();
        r.at[0] = apply(path, arriving.at[0]) + light, r.axis = arriving.axis;
        return r;
    }
    Stokes<F> r = scattered(turned_column(arriving, axis, -wo));
    if (smooth) return r;
    Stokes<F> direct = no_stokes<F>();
    direct.axis = light_axis;
    for (int c = 0; c < SpectrumSize; ++c) direct.at[0][c] = light[c], direct.at[1][c] = light[c] * of_light[c].b;
    direct = turned_column(direct, axis, wi);
    for (int i = 0; i < 4; ++i) r.at[i] = r.at[i] + direct.at[i];
    return r;
}

template <class F>
TR_LARGE Stokes<F> PolarizedVertex<F>::row(const Stokes<F> &leaving) const {
    Stokes<F> r = no_stokes<F>();
    if (kind == Polarization::None) {
        r.at[0] = pull(leaving.at[0], path), r.axis = leaving.axis;
        return r;
    }
    const Stokes<F> a = turned_row(leaving, axis, wi);
    r.axis = axis;
    for (int c = 0; c < SpectrumSize; ++c) {
        const auto &m = matrix[c];
        if (kind == Polarization::Circular) {
            r.at[0][c] = path[c] * (a.at[0][c] + m.b * a.at[3][c]);
            r.at[3][c] = path[c] * (m.b * a.at[0][c] + a.at[3][c]);
            continue;
        }
        r.at[0][c] = path[c] * (a.at[0][c] + m.b * a.at[1][c]), r.at[1][c] = path[c] * (m.b * a.at[0][c] + a.at[1][c]);
        r.at[2][c] = path[c] * (m.x * a.at[2][c] + m.y * a.at[3][c]);
        r.at[3][c] = path[c] * (m.x * a.at[3][c] - m.y * a.at[2][c]);
    }
    return r;
}

// What the angle of a plate's axis makes of `angle`: of theta, of the surface, and of the ray.
template <class F>
TR_HD void PolarizedVertex<F>::sweep_plate(const SceneOf<F> &scene, const VertexRecord<F> &v, const Spectrum<F> &angle,
                                           Spectrum<F> &by_theta, const GradientNeeds &needs, const MaskOf<F> &active,
                                           HitAdjoint<F> &hit, Vec3<F> &wi_bar) const {
    const PlateAxis<F> plate(*this);
    VertexFrame<F> frame(scene, v, true);
    const Vec3<F> a = frame.frame.to_world(plate.local), change = frame.frame.to_world(plate.change),
                  m = plate.across(a, wi);
    const F length2 = squared_norm(m);
    auto some = mask<F>(length2 > F(1e-12));
    const Vec3<F> turn = cross(wi, m) * select(some, F(1) / select(some, length2, F(1)), F(0));
    by_theta = by_theta + angle * dot(plate.across(change, wi), turn);
    if (!needs.geometry) return;
    const Vec3<F> m_bar = turn * component_sum(angle);
    Vec3<F> a_bar = m_bar;
    if (plate.absorbs)
        a_bar = cross(wi, m_bar), wi_bar = wi_bar + cross(m_bar, a);
    else
        wi_bar = wi_bar - m_bar * dot(a, wi);
    frame.out_of(plate.local, a_bar);
    frame.hand_to(hit, scene, v, active);
}

template <class F>
TR_LARGE F PolarizedVertex<F>::sweep(const SceneOf<F> &scene, int bsdf_kind, VertexRecord<F> v,
                                     const Stokes<F> &leaving, const Stokes<F> &arriving, NextVertex<F> next,
                                     const GradientNeeds &needs, const MaskOf<F> &active, HitAdjoint<F> &hit,
                                     Vec3<F> &d_bar, GradientSink<F> &sink) const {
    if (kind == Polarization::None) {
        next.radiance = arriving.at[0];
        const Spectrum<F> &a = leaving.at[0];
        return contract(a, sweep_scattering(scene, bsdf_kind, v, a, next, needs, active, hit, d_bar, sink));
    }
    const Stokes<F> a = turned_row(leaving, axis, wi), r = turned_column(arriving, axis, -wo),
                    of_direct = turned_row(leaving, light_axis, wi);
    Stokes<F> unpolarised = no_stokes<F>();
    unpolarised.at[0] = light;
    for (int c = 0; c < SpectrumSize; ++c) {
        next.radiance[c] = contracted(kind, matrix[c], a, r, c);
        if (!smooth) v.through[c] = v.through[c] * (of_direct.at[0][c] + of_light[c].b * of_direct.at[1][c]);
    }

    // what the matrices depend on: z, eta, k
    using D = Dual<F, 3>;
    const bool depends = (bsdf.eta >= 0 || bsdf.theta >= 0) && (needs.bsdf || needs.numbers());
    Spectrum<F> by_variable[BsdfInfo::MaxVariables];
    for (int i = 0; i < bsdf.n_variables; ++i) by_variable[i] = uniform_spectrum(F(0));
    F z_bar(0), light_z_bar(0);
    for (int c = 0; depends && c < SpectrumSize; ++c) {
        const auto add = [&](const FacetMatrix<D> &m, const Stokes<F> &row, const Stokes<F> &column, const F &weight,
                             F &to) {
            const D value = contracted(kind, m, row, column, c) * weight;
            to = to + value.d[0];
            if (bsdf.eta >= 0) by_variable[bsdf.eta][c] = by_variable[bsdf.eta][c] + value.d[1];
            if (bsdf.k >= 0) by_variable[bsdf.k][c] = by_variable[bsdf.k][c] + value.d[2];
        };
        add(matrix_of<D>(*this, wo, v.wi.z, reflects, c), a, r, path[c], z_bar);
        if (!smooth)
            add(matrix_of<D>(*this, wo_light, v.wi.z, light_reflects, c), of_direct, unpolarised, F(1), light_z_bar);
    }
    // the axes: of what arrives, the column turns with this vertex' axis; of what leaves, against it
    const Stokes<F> left = turned_column(scattered(r), leaving.axis, wi);
    const Spectrum<F> arriving_angle = by_angle(row(leaving), r), leaving_angle = by_angle(leaving, left) * F(-1);
    Vec3<F> wi_bar{F(0), F(0), F(0)}, wo_bar = wi_bar, light_bar = wi_bar;
    if (is_plate(kind)) {
        const Spectrum<F> angle = arriving_angle + leaving_angle;
        sweep_plate(scene, v, angle, by_variable[bsdf.theta], needs, active, hit, wi_bar);
    }
    if (depends && (needs.bsdf || (needs.geometry && needs.lookups)))
        sweep_parameters(scene, bsdf, v.bsdf, v.at, by_variable, needs, active, hit.at, sink);
    if (needs.numbers()) {
        if (smooth) {
            wi_bar = wi_bar + n * z_bar;
            hit.n = hit.n + wi * (z_bar * v.mirror);
        } else {
            wi_bar = wo * z_bar + wo_light * light_z_bar;
            wo_bar = wi * z_bar, light_bar = wi * light_z_bar;
            Stokes<F> direct = no_stokes<F>();
            direct.axis = light_axis;
            for (int c = 0; c < SpectrumSize; ++c) direct.at[1][c] = light[c] * of_light[c].b;
            const Spectrum<F> angle = by_angle(leaving, turned_column(direct, leaving.axis, wi));
            sweep_axis(wi, wo_light, wi, -component_sum(angle), wi_bar, light_bar);
        }
        if (kind == Polarization::Pane) {
            Vec3<F> n_bar{F(0), F(0), F(0)};
            sweep_axis(n, wi, -wo, component_sum(arriving_angle), n_bar, wi_bar);
            sweep_axis(n, wi, wi, component_sum(leaving_angle), n_bar, wi_bar);
            hit.n = hit.n + n_bar * v.mirror;
        } else if (!is_plate(kind)) {
            sweep_axis(wi, wo, -wo, component_sum(arriving_angle), wi_bar, wo_bar);
            sweep_axis(wi, wo, wi, component_sum(leaving_angle), wi_bar, wo_bar);
        }
        next.ray.d = next.ray.d + wo_bar;
        v.way.d = v.way.d + light_bar;
        d_bar = d_bar - wi_bar;
    }
    const Spectrum<F> one = uniform_spectrum(F(1));
    return component_sum(sweep_scattering(scene, bsdf_kind, v, one, next, needs, active, hit, d_bar, sink));
}

#define TR_INSTANTIATE(F, S) template struct PolarizedVertex<F>;
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
