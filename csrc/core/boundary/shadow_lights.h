// Lights that throw shadows: places on them from which outlines are looked for, what they send, and their motion.
#pragma once

#include <algorithm>

#include "../adjoint/gradient_sink.h"
#include "../adjoint/scattering.h"
#include "../emitter/emitter.h"
#include "../state/queues.h"

namespace tr {

// By slot: a place on a light, the direction to it from the end S of a ray past an outline, and what S gets: the BSDF
// times what arrives, the weight of the power heuristic (negative: nothing else finds the light), |n.c| / |n.d|, and
// the adjoint of S; of polarised light the rest of the Stokes vector of which `value` is the intensity.
// clang-format off
#define TR_SHADOW_EDGE_COLUMNS(X) \
    X(Integer, emitter) X(Point, at) X(Vector, y) X(Vector, yn) X(Number, left) X(Number, inverse_pmf) \
    X(Number, inverse_pdf) X(Vector, travel) X(Vector, d) X(Vector, s) X(Number, distance) X(Spectrum, value) \
    X(Number, mis) X(Number, ratio) X(Vector, s_bar) X(Number, e_distance) X(Number, b_distance) X(Vector, e_bar) \
    X(Spectrum, q) X(Spectrum, u) X(Spectrum, v)
// clang-format on
template <class S>
struct ShadowEdgeColumns {
    TR_COLUMNS(TR_SHADOW_EDGE_COLUMNS)
};

// Of these emitters, before anything is sampled.
template <class F>
TR_HD EmissionSample<F> unsampled_emission(const SceneOf<F> &scene, const IntOf<F> &emitter, const MaskOf<F> &active) {
    const UIntOf<F> none(0u);
    EmissionSample<F> r;
    r.point = {emitter, {none, none, F(0), F(0)}};
    r.kind = emitter_kind<F>(scene, emitter, active);
    r.p = {F(0), F(0), F(0)}, r.n = r.d = {F(0), F(0), F(1)};
    r.weight = r.inverse_pdf = F(0);
    return r;
}

// Which they are, and their probabilities, added up.
struct LightList {
    const int32_t *lights;
    const double *cdf;
    int32_t n;

    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(lights), visit(cdf);
    }
};

// Where a light is: on a shape, infinitely far away, else at a point.
struct LightPlace {
    bool on_shape, far;
};

template <class F>
class ShadowLights {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    using Columns = ShadowEdgeColumns<S>;

public:
    TR_HD ShadowLights(const SceneView<S> &scene, const LightList &list) : scene_(scene), list_(list) {}

    // The light of a slot, by a number in [0, 1).
    TR_HD void choose(const Columns &c, uint32_t slot, double number) const {
        const double all = list_.cdf[list_.n - 1], u = number * all;
        int32_t i = 0;
        while (i + 1 < list_.n && !(list_.cdf[i] > u)) ++i;
        const double before = i ? list_.cdf[i - 1] : 0, p = list_.cdf[i] - before;
        c.emitter[slot] = list_.lights[i];
        c.left[slot] = S(std::min((u - before) / p, 1 - 1e-7));
        c.inverse_pmf[slot] = S(all / p);
    }
    // Places on the lights of slots i on, for two points of the plane.
    TR_HD void find_places(const Columns &c, uint32_t i, const M &active, const Random4<F> &u) const {
        Entries<F> from(i);
        EmissionSample<F> r =
            unsampled_emission<F>(scene_, select(mask<IntOf<F>>(active), from(c.emitter), IntOf<F>(0)), active);
        F left = from(c.left), inverse_pmf = from(c.inverse_pmf);
        for_each_emitter_kind<F>(r.kind, active, [&](const EmitterKernels<F> &emitter, const M &lanes) {
            emitter.sample_emission(scene_, left, u.u[0], u.u[1], u.u[2], u.u[3], inverse_pmf, lanes, r);
            if (emitter.is(HasDeltaPosition)) r.inverse_pdf = select(lanes, inverse_pmf, r.inverse_pdf);
            if (!emitter.is(IsOnShape)) r.n = select(lanes, Vec3<F>{F(0), F(0), F(0)}, r.n);
        });
        write(c.at, i, r.point.at), write(c.y, i, r.p), write(c.yn, i, r.n), write(c.travel, i, r.d);
        write(c.inverse_pdf, i, r.inverse_pdf);
    }

    TR_HD LightPlace place(const Columns &c, uint32_t slot) const {
        LightPlace r{};
        const IntOf<F> kind(scene_.emitters[c.emitter[slot]].kind);
        for_each_emitter_kind<F>(kind, M(true), [&](const EmitterKernels<F> &light, const M &) {
            r = {light.is(IsOnShape), light.is(IsInfinite)};
        });
        return r;
    }

    // What the lights of these slots send to points p in the directions d to them: radiance, of points intensity, of
    // parallel light irradiance across it; where on the light; and the density of d for emitter samples, 0 where no ray
    // finds the light.
    TR_HD Spectrum<F> arriving(const Columns &c, const Wavelengths<F> &waves, const Vec3<F> &p, const Vec3<F> &d,
                               const Gathered<F> &from, const M &active, EmitterPoint<F> &point, F &density) const {
        IntOf<F> emitter = select(mask<IntOf<F>>(active), from(c.emitter), IntOf<F>(list_.lights[0]));
        point = {emitter, from(c.at)};
        const Vec3<F> y = from(c.y), yn = from(c.yn);
        IntOf<F> kind = emitter_kind<F>(scene_, emitter, active);
        density = F(0);
        for_each_emitter_kind<F>(kind, active, [&](const EmitterKernels<F> &light, const M &lanes) {
            if (light.is(IsOnShape)) {
                density = select(lanes, shape_emitter_pdf<F>(scene_, point, p, y, yn, lanes), density);
            } else if (light.is(IsEnvironment)) {
                F pdf;
                EmitterPoint<F> there = environment_point<F>(scene_, d, pdf, lanes);
                point.at.b1 = select(lanes, there.at.b1, point.at.b1);
                point.at.b2 = select(lanes, there.at.b2, point.at.b2);
                density = select(lanes, pdf, density);
            } else {
                EmitterSample<F> r = no_emitter_sample<F>();
                r.point.emitter = emitter;
                light.sample_direct(scene_, p, F(S(0.5)), F(S(0.5)), F(S(0.5)), lanes, r);
                point.at.b1 = select(lanes, r.point.at.b1, point.at.b1);
                point.at.b2 = select(lanes, r.point.at.b2, point.at.b2);
            }
        });
        return eval_emitter<F>(scene_, waves, point, active);
    }

    // The adjoints of places on the lights of slots i on.
    TR_HD void sweep(const Columns &c, uint32_t i, const M &there, const SlotColumns<S> &slots,
                     GradientSink<F> &sink) const {
        Entries<F> from(i);
        const Vec3<F> e_bar = from(c.e_bar);
        M active = there && mask<F>(max_abs(e_bar) > F(0));
        if (!any(active)) return;
        sink.begin();
        IntOf<F> emitter = select(mask<IntOf<F>>(active), from(c.emitter), IntOf<F>(list_.lights[0]));
        SurfacePoint<F> at = from(c.at);
        at.shape = select(mask<U>(active), at.shape, U(0u));
        const F distance = from(c.e_distance);
        const CoordinateAdjoint<F> nothing;
        IntOf<F> kind = emitter_kind<F>(scene_, emitter, active);
        for_each_emitter_kind<F>(kind, active, [&](const EmitterKernels<F> &light, const M &lanes) {
            M moves = lanes;
            if (light.is(IsOnShape)) moves = sink.wants_shape(at.shape, lanes);
            if (!light.direct_vjp || !any(moves)) return;
            // the direction from S turns by de / distance; that of parallel light is against its travel
            Vec3<F> w_bar = e_bar * (light.is(IsInfinite) ? F(S(-1)) : distance), x_bar{F(0), F(0), F(0)};
            const DirectAdjoint<F> g{{emitter, at}, from(c.s), from(c.d), distance, w_bar, F(0), nothing, true};
            light.direct_vjp(scene_, g, moves, x_bar, sink);
        });
        if (sink.forward) add_to_entries<F>(slots.radiance, U(i) + lane_index<F>(), sink.derivative, active);
    }

private:
    const SceneView<S> &scene_;
    const LightList &list_;
};

}  // namespace tr
