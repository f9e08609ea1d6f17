#include "polarization.h"

#include "../bsdf/dielectric_microfacet.h"
#include "light.h"

namespace tr {

namespace {

// The number that a row and a column of one colour make, on the axes of the matrix.
template <class M, class F>
TR_INLINE auto contracted(Polarization kind, const M &m, const Stokes<F> &a, const Stokes<F> &r, int c) {
    if (kind == Polarization::Circular)
        return m.out * (a.at[0][c] * r.at[3][c] + a.at[3][c] * r.at[0][c]) +
               (a.at[0][c] * r.at[0][c] + a.at[3][c] * r.at[3][c]);
    return m.in * (a.at[0][c] * r.at[1][c]) + m.out * (a.at[1][c] * r.at[0][c]) + m.both * (a.at[1][c] * r.at[1][c]) +
           m.x * (a.at[2][c] * r.at[2][c] + a.at[3][c] * r.at[3][c]) +
           m.y * (a.at[3][c] * r.at[2][c] - a.at[2][c] * r.at[3][c]) + a.at[0][c] * r.at[0][c];
}

// Through the matrices of a way, or their transposes, onto an axis on the other side.
template <class F>
TR_INLINE Stokes<F> through(Polarization kind, const PolarizedWay<F> &way, bool transposed, const Stokes<F> &from) {
    Stokes<F> s = no_stokes<F>();
    s.axis = transposed ? way.in : way.out;
    for (int c = 0; c < SpectrumSize; ++c) {
        const MuellerMatrix<F> m = transposed ? way.matrix[c].transposed() : way.matrix[c];
        const F i = from.at[0][c] * way.factor[c], q = from.at[1][c] * way.factor[c], u = from.at[2][c] * way.factor[c],
                v = from.at[3][c] * way.factor[c];
        if (kind == Polarization::Circular) {
            s.at[0][c] = i + m.out * v, s.at[3][c] = m.out * i + v;
            continue;
        }
        s.at[0][c] = i + m.in * q, s.at[1][c] = m.out * i + m.both * q;
        s.at[2][c] = m.x * u - m.y * v, s.at[3][c] = m.y * u + m.x * v;
    }
    return s;
}

// A column, on the axis of what arrives, behind the matrices.
template <class F>
TR_INLINE Stokes<F> scattered(Polarization kind, const PolarizedWay<F> &way, const Stokes<F> &arriving) {
    return through(kind, way, false, arriving);
}

// A row, on the axis of what leaves, before the matrices.
template <class F>
TR_INLINE Stokes<F> gathered(Polarization kind, const PolarizedWay<F> &way, const Stokes<F> &leaving) {
    return through(kind, way, true, leaving);
}

template <class F>
TR_INLINE void add(Stokes<F> &to, const Stokes<F> &more) {
    for (int i = 0; i < 4; ++i) to.at[i] = to.at[i] + more.at[i];
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

// Whether the facet is the surface: of delta lobes, and where light passes the coat above a base.
template <class F>
TR_INLINE bool on_surface(const PolarizedVertex<F> &v, const PolarizedWay<F> &way) {
    return v.bsdf.is(HasDeltaLobes) || any(way.base);
}

// Whether the axes are across the surface's normal, and not the facet's, which may be unknown: through a pane light
// goes on as it came.
template <class F>
TR_INLINE MaskOf<F> across_surface(const PolarizedVertex<F> &v, const PolarizedWay<F> &way) {
    return way.base || MaskOf<F>(v.kind == Polarization::Pane);
}

// The matrix of one colour as a function of the cosine at the facet, eta, and k; below a coat of the cosine of what
// leaves, eta, and the cosine of what arrives. With derivatives by these three if T has them.
template <class T, class F>
TR_INLINE MuellerMatrix<T> matrix_of(const PolarizedVertex<F> &v, const PolarizedWay<F> &way, int c) {
    using Facet = FacetMatrix<T>;
    const auto variable = [&](const F &value, int i) {
        if constexpr (std::is_same_v<T, F>)
            return value;
        else
            return T(value, i);
    };
    if (v.kind == Polarization::Circular)
        return Facet{T(select(mask<F>(v.params.choice[0] == 0), F(1), F(-1))), T(F(0)), T(F(0))};
    if (v.kind == Polarization::Retarder) {
        const F delta = v.params.number[number_of(v.bsdf, v.bsdf.eta, c)] * F(Pi / 180);
        const F cosine = cos(delta), sine = sin(delta);
        Facet r{T(F(0)), T(cosine), T(-sine)};
        if constexpr (!std::is_same_v<T, F>) r.x.d[1] = sine * F(-Pi / 180), r.y.d[1] = cosine * F(-Pi / 180);
        return r;
    }
    const bool smooth = v.bsdf.is(HasDeltaLobes);
    const T z = variable(smooth ? v.z : dot(v.wi, way.to), 0);
    if (v.kind == Polarization::Pass || v.kind == Polarization::Polarizer)
        return facet_matrix<T>(v.kind, smooth, way.reflects, z, T(F(1)), T(F(0)));
    T eta = variable(v.params.number[number_of(v.bsdf, v.bsdf.eta, c)], 1), k(F(0));
    if (v.kind == Polarization::Coat) {
        MuellerMatrix<T> base, facet;
        if (any(way.base))
            base = {polarized_by_refraction(variable(v.z, 0), eta), polarized_by_refraction(variable(way.z, 2), eta)};
        if (!any(!way.base)) return base;
        facet = facet_matrix<T>(Polarization::Interface, smooth, MaskOf<F>(true), z, eta, k);
        return any(way.base) ? select(way.base, base, facet) : facet;
    }
    if (v.kind == Polarization::Metal) {
        k = variable(v.params.number[number_of(v.bsdf, v.bsdf.k, c)], 2);
    } else {
        if (!smooth) eta = clamp_eta(eta);
        auto outside = mask<F>(!(v.z < F(0)));
        if (v.kind == Polarization::Interface) eta = select(outside, eta, T(1) / eta);
    }
    return facet_matrix<T>(v.kind, smooth, way.reflects, z, eta, k);
}

}  // namespace

template <class F>
TR_LARGE PolarizedVertex<F>::PolarizedVertex(const SceneOf<F> &scene, const Wavelengths<F> &waves, int bsdf_kind,
                                             const VertexRecord<F> &v, const GradientNeeds &needs,
                                             const MaskOf<F> &active, const PolarizedConnection<F> *connection_)
    : bsdf(bsdf_kernels<F>(bsdf_kind)),
      kind(bsdf.polarizes),
      n_lobes(kind == Polarization::Coat && !bsdf.is(HasDeltaLobes) ? 2 : 1),
      z(v.wi.z),
      lamp(scene, v.light,
           active && mask<F>(v.light_weight > F(0)) && MaskOf<F>(kind != Polarization::None && !connection_)),
      connection(connection_) {
    load_parameters(scene, waves, bsdf, v.bsdf, v.at, active, params);
    const Spectrum<F> one = uniform_spectrum(F(1)), none = uniform_spectrum(F(0));
    const MaskOf<F> lit = active && mask<F>(v.light_weight > F(0)), goes_on = active && mask<F>(v.inverse_pdf > F(0));
    const bool connected = bsdf.is(HasSmoothLobes) && any(lit);
    const Transport transport = connection ? Transport::Importance : Transport::Radiance;
    sent = connection ? connection->film : lamp.of(one);
    Spectrum<F> path_factor = uniform_spectrum(v.inverse_pdf),
                light_factor = (connection ? one : apply(v.through, v.emitted)) * v.light_weight;
    StackAdjoint<F> stack;
    if (scene.has_stacks) {
        stack = StackAdjoint<F>(scene, waves, v, needs, transport, active);
        path_factor = path_factor * stack.bsdf.stack.weight * stack.path_factor;
        light_factor = light_factor * stack.bsdf.stack.weight * stack.light_factor;
        if (connection) light_factor = light_factor * stack.bsdf.stack.inverse_probability;
    }
    const Frame<F> frame = model_frame(scene, v);
    wi = frame.to_world(v.wi), n = frame.n;
    if (connection) {
        auto interpolated =
            has_shading_normal(ShapeLanes<F>(scene.shapes, v.at.shape, active), stack.bsdf.stack, active);
        const auto correction = [&](const Vec3<F> &wo) {
            return shading_correction(wi, frame.to_world(wo), v.normal, connection->record.ng, interpolated);
        };
        path_factor = path_factor * correction(v.wo), light_factor = light_factor * correction(v.wo_light);
    }
    for (int l = 0; l < n_lobes; ++l) {
        PolarizedWay<F> &path = lobes[l].path, &light = lobes[l].light;
        BsdfDerivative<F> value;
        const IntOf<F> part(n_lobes == 2 ? l + 1 : 0);
        bsdf.vjp(params, v.wi, v.wo, n_lobes == 2 ? part : v.lobe, transport, one, one, {0, false}, value);
        path.factor = select(goes_on, apply(value.f, path_factor), none);
        light.factor = none;
        if (connected) {
            bsdf.vjp(params, v.wi, v.wo_light, part, transport, one, one, {0, false}, value);
            light.factor = select(lit, apply(value.f, light_factor), none);
        }
        if (kind == Polarization::None) return;
        const bool coat = kind == Polarization::Coat;
        path.base = MaskOf<F>(coat) && (n_lobes == 2 ? MaskOf<F>(l == 1) : mask<F>(v.lobe == 0));
        light.base = MaskOf<F>(coat && (n_lobes == 1 || l == 1));
        const auto find = [&](PolarizedWay<F> &way, const Vec3<F> &local) {
            way.to = frame.to_world(local), way.z = local.z;
            way.reflects = mask<F>(v.wi.z * local.z > F(0));
            way.out = way.in = is_plate(kind) ? across_plate(PlateAxis<F>(*this), frame, wi) : axis_between(wi, way.to);
            const MaskOf<F> surface = across_surface(*this, way);
            if (any(surface))
                way.out = select(surface, axis_between(wi, n), way.out),
                way.in = select(surface, axis_between(way.to, n), way.in);
            for (int c = 0; c < SpectrumSize; ++c) way.matrix[c] = matrix_of<F>(*this, way, c);
        };
        // (where nothing comes from, any direction that is finite)
        find(path, select(goes_on, v.wo, v.wi));
        if (bsdf.is(HasSmoothLobes)) find(light, select(lit, v.wo_light, v.wi));
    }
}

template <class F>
TR_LARGE Stokes<F> PolarizedVertex<F>::column(const Stokes<F> &arriving) const {
    Stokes<F> r = no_stokes<F>();
    if (kind == Polarization::None) {
        r.at[0] = apply(lobes[0].path.factor, arriving.at[0]) + apply(lobes[0].light.factor, sent.at[0]);
        r.axis = arriving.axis;
        return r;
    }
    r.axis = lobes[0].path.out;
    for (int l = 0; l < n_lobes; ++l) {
        const PolarizedWay<F> &path = lobes[l].path, &light = lobes[l].light;
        add(r, turned_column(scattered(kind, path, turned_column(arriving, path.in, -path.to)), r.axis, wi));
        if (!bsdf.is(HasSmoothLobes)) continue;
        add(r, turned_column(scattered(kind, light, turned_column(sent, light.in, -light.to)), r.axis, wi));
    }
    return r;
}

template <class F>
TR_LARGE Stokes<F> PolarizedVertex<F>::row(const Stokes<F> &leaving, bool connected) const {
    const auto along = [&](int l) -> const PolarizedWay<F> & { return connected ? lobes[l].light : lobes[l].path; };
    Stokes<F> a = no_stokes<F>();
    if (kind == Polarization::None) {
        a.at[0] = pull(leaving.at[0], along(0).factor), a.axis = leaving.axis;
        return a;
    }
    if (connected && !bsdf.is(HasSmoothLobes)) return a;
    a.axis = along(0).in;
    for (int l = 0; l < n_lobes; ++l) {
        const PolarizedWay<F> &way = along(l);
        add(a, turned_row(gathered(kind, way, turned_row(leaving, way.out, wi)), a.axis, -way.to));
    }
    return a;
}

template <class F>
TR_LARGE Spectrum<F> PolarizedVertex<F>::direct(const Stokes<F> &leaving) const {
    if (kind == Polarization::None) return pull(leaving.at[0], lobes[0].light.factor);
    Spectrum<F> r = uniform_spectrum(F(0));
    for (int l = 0; l < n_lobes && bsdf.is(HasSmoothLobes); ++l) {
        const PolarizedWay<F> &light = lobes[l].light;
        r = r + number_between(leaving, scattered(kind, light, turned_column(sent, light.in, -light.to)), wi);
    }
    return r;
}

// What the angle of a plate's axis makes of `angle`: of theta, of the surface, and of the ray.
template <class F>
TR_HD void PolarizedVertex<F>::sweep_plate(const SceneOf<F> &scene, const VertexRecord<F> &v, const Spectrum<F> &angle,
                                           const GradientNeeds &needs, const MaskOf<F> &active, HitAdjoint<F> &hit,
                                           Adjoints &bar) const {
    const PlateAxis<F> plate(*this);
    VertexFrame<F> frame(scene, v, true);
    const Vec3<F> a = frame.frame.to_world(plate.local), change = frame.frame.to_world(plate.change),
                  m = plate.across(a, wi);
    const F length2 = squared_norm(m);
    auto some = mask<F>(length2 > F(1e-12));
    const Vec3<F> turn = cross(wi, m) * select(some, F(1) / select(some, length2, F(1)), F(0));
    Spectrum<F> &by_theta = bar.by_variable[bsdf.theta];
    by_theta = by_theta + angle * dot(plate.across(change, wi), turn);
    if (!needs.geometry) return;
    const Vec3<F> m_bar = turn * component_sum(angle);
    Vec3<F> a_bar = m_bar;
    if (plate.absorbs)
        a_bar = cross(wi, m_bar), bar.wi = bar.wi + cross(m_bar, a);
    else
        bar.wi = bar.wi - m_bar * dot(a, wi);
    frame.out_of(plate.local, a_bar);
    frame.hand_to(hit, scene, v, active);
}

// What the matrices of a way and its axes depend on, between the row of what leaves and the column of what arrives.
template <class F>
TR_HD void PolarizedVertex<F>::sweep_way(const PolarizedWay<F> &way, const Stokes<F> &leaving, const Stokes<F> &column,
                                         const GradientNeeds &needs, Vec3<F> &to_bar, Adjoints &bar) const {
    using D = Dual<F, 3>;
    const Stokes<F> a = turned_row(leaving, way.out, wi), r = turned_column(column, way.in, -way.to);
    if (bsdf.eta >= 0) {
        F by_cosine(0), by_base(0);
        for (int c = 0; c < SpectrumSize; ++c) {
            const D value = contracted(kind, matrix_of<D>(*this, way, c), a, r, c) * way.factor[c];
            by_cosine = by_cosine + value.d[0];
            bar.by_variable[bsdf.eta][c] = bar.by_variable[bsdf.eta][c] + value.d[1];
            if (bsdf.k >= 0)
                bar.by_variable[bsdf.k][c] = bar.by_variable[bsdf.k][c] + value.d[2];
            else
                by_base = by_base + value.d[2];
        }
        if (on_surface(*this, way)) {
            bar.wi = bar.wi + n * by_cosine, to_bar = to_bar + n * by_base;
            bar.n = bar.n + wi * by_cosine + way.to * by_base;
        } else {
            bar.wi = bar.wi + way.to * by_cosine, to_bar = to_bar + wi * by_cosine;
        }
    }
    if (!needs.numbers() || is_plate(kind)) return;
    // of what arrives, the column turns with this vertex' axis; of what leaves, against it
    const F arriving = component_sum(by_angle(gathered(kind, way, a), r)),
            left = -component_sum(by_angle(leaving, turned_column(scattered(kind, way, r), leaving.axis, wi)));
    const MaskOf<F> surface = across_surface(*this, way);
    if (any(surface)) {
        sweep_axis(way.to, n, -way.to, select(surface, arriving, F(0)), to_bar, bar.n);
        sweep_axis(wi, n, wi, select(surface, left, F(0)), bar.wi, bar.n);
    }
    if (any(!surface)) {
        sweep_axis(wi, way.to, -way.to, select(surface, F(0), arriving), bar.wi, to_bar);
        sweep_axis(wi, way.to, wi, select(surface, F(0), left), bar.wi, to_bar);
    }
}

// Of the light that comes this way: its shares and its axis.
template <class F>
TR_HD void PolarizedVertex<F>::sweep_lamp(const SceneOf<F> &scene, const VertexRecord<F> &v, const PolarizedWay<F> &way,
                                          const Stokes<F> &leaving, const GradientNeeds &needs, const MaskOf<F> &active,
                                          HitAdjoint<F> &hit, Vec3<F> &to_bar, GradientSink<F> &sink) const {
    const MaskOf<F> lit = active && mask<F>(v.light_weight > F(0));
    const Stokes<F> row = gathered(kind, way, turned_row(leaving, way.out, wi));
    Vec3<F> travel_bar{F(0), F(0), F(0)};
    const Vec3<F> tangent_bar =
        lamp.sweep(scene, v.light, -way.to, row, uniform_spectrum(F(1)), needs, lit, travel_bar, sink);
    to_bar = to_bar - travel_bar;
    if (!needs.geometry) return;
    const Vec3<F> zero{F(0), F(0), F(0)};
    const CoordinateAdjoint<F> nowhere;
    DirectAdjoint<F> g{v.light, v.p, way.to, v.light_distance, zero, F(0), nowhere, true};
    g.tangent_bar = tangent_bar;
    hit.p = hit.p + sweep_direct(scene, g, lit, sink);
}

// Of a connection to the camera: the film's axis, which turns with the camera and with where it is seen from.
template <class F>
TR_HD void PolarizedVertex<F>::sweep_film(const SceneOf<F> &scene, const PolarizedWay<F> &way, const Stokes<F> &leaving,
                                          const GradientNeeds &needs, const MaskOf<F> &active, Vec3<F> &to_bar,
                                          GradientSink<F> &sink) const {
    const Stokes<F> row = turned_row(gathered(kind, way, turned_row(leaving, way.out, wi)), sent.axis, -way.to);
    Vec3<F> k_bar{F(0), F(0), F(0)};
    // the column turns against its axis
    sweep_film_axis(scene, connection->sensor_index, -way.to, -component_sum(by_angle(row, sent)), needs.camera, active,
                    k_bar, sink);
    to_bar = to_bar - k_bar;
}

template <class F>
TR_LARGE F PolarizedVertex<F>::sweep(const SceneOf<F> &scene, int bsdf_kind, const VertexRecord<F> &vertex,
                                     const Stokes<F> &leaving, const Stokes<F> &arriving, const NextVertex<F> &behind,
                                     const GradientNeeds &needs, const MaskOf<F> &active, HitAdjoint<F> &hit,
                                     Vec3<F> &d_bar, GradientSink<F> &sink) const {
    const bool connected = bsdf.is(HasSmoothLobes),
               depends = needs.bsdf || needs.numbers() || (needs.emitter && scene.polarized_lights);
    const Vec3<F> zero{F(0), F(0), F(0)};
    ConnectionRecord<F> record;
    if (connection) record = connection->record;
    const auto sweep_unpolarized = [&](const VertexRecord<F> &v, const Spectrum<F> &a, NextVertex<F> &next) {
        return connection ? sweep_light_scattering(scene, connection->sensor, bsdf_kind, v, record, a, next, needs,
                                                   active, hit, d_bar, sink)
                          : sweep_scattering(scene, bsdf_kind, v, a, next, needs, active, hit, d_bar, sink);
    };
    F sum(0);
    for (int l = 0; l < n_lobes; ++l) {
        const PolarizedWay<F> &path = lobes[l].path, &light = lobes[l].light;
        VertexRecord<F> v = vertex;
        NextVertex<F> next = behind;
        if (n_lobes == 2) v.lobe = IntOf<F>(l + 1);
        if (l > 0) next.ray = {zero, zero}, v.way = {}, record.x_bar = record.y_bar = F(0);  // once is enough
        if (kind == Polarization::None) {
            next.radiance = arriving.at[0];
            if (connection) v.emitted = sent.at[0];
            return contract(leaving.at[0], sweep_unpolarized(v, leaving.at[0], next));
        }
        const Stokes<F> a = turned_row(leaving, path.out, wi), r = turned_column(arriving, path.in, -path.to);
        for (int c = 0; c < SpectrumSize; ++c) next.radiance[c] = contracted(kind, path.matrix[c], a, r, c);
        if (connected) {
            const Stokes<F> row = turned_row(leaving, light.out, wi), column = turned_column(sent, light.in, -light.to);
            for (int c = 0; c < SpectrumSize; ++c) {
                const F number = contracted(kind, light.matrix[c], row, column, c);
                if (connection)
                    v.emitted[c] = number;
                else
                    v.through[c] = v.through[c] * number;
            }
        }
        if (depends) {
            Adjoints bar{zero, zero, zero, zero, {}};
            for (int i = 0; i < bsdf.n_variables; ++i) bar.by_variable[i] = uniform_spectrum(F(0));
            sweep_way(path, leaving, arriving, needs, bar.path, bar);
            if (connected) sweep_way(light, leaving, sent, needs, bar.light, bar);
            if (connected && connection && needs.geometry)
                sweep_film(scene, light, leaving, needs, active, bar.light, sink);
            if (connected && !connection && scene.polarized_lights)
                sweep_lamp(scene, v, light, leaving, needs, active, hit, bar.light, sink);
            if (is_plate(kind)) {
                const Stokes<F> left = turned_column(scattered(kind, path, r), leaving.axis, wi);
                const Spectrum<F> angle = by_angle(gathered(kind, path, a), r) - by_angle(leaving, left);
                sweep_plate(scene, v, angle, needs, active, hit, bar);
            }
            const uint32_t variables = needs.variables_of(bsdf_kind);
            if (variables && (bsdf.eta >= 0 || bsdf.theta >= 0))
                sweep_parameters(scene, bsdf, v.bsdf, v.at, bar.by_variable, variables, needs, active, hit.at, sink);
            if (needs.numbers()) {
                hit.n = hit.n + bar.n * v.mirror;
                next.ray.d = next.ray.d + bar.path;
                v.way.d = v.way.d + bar.light;
                d_bar = d_bar - bar.wi;
            }
        }
        sum = sum + component_sum(sweep_unpolarized(v, uniform_spectrum(F(1)), next));
    }
    return sum;
}

#define TR_INSTANTIATE(F, S) template struct PolarizedVertex<F>;
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
