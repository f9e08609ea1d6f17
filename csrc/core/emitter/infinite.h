// Light from infinitely far away.
#pragma once

#include "kernels.h"

namespace tr {

// A path of light begins on a disk as wide as the scene, in front of it: uniform by (c, d), where r.inverse_pdf is that
// of the direction it comes from.
template <class F>
TR_INLINE void begin_from_afar(const SceneOf<F> &scene, const Vec3<F> &from, const F &c, const F &d,
                               const MaskOf<F> &lanes, EmissionSample<F> &r) {
    using S = ScalarOf<F>;
    Vec2<F> disk = square_to_disk(c, d);
    Vec3<F> center{F(scene.center[0]), F(scene.center[1]), F(scene.center[2])};
    Frame<F> frame = make_frame(from);
    Vec3<F> p = center + (frame.s * disk.x + frame.t * disk.y + from) * F(scene.radius);
    r.p = select(lanes, p, r.p);
    r.n = select(lanes, -from, r.n);
    r.d = select(lanes, -from, r.d);
    r.weight = select(lanes, r.inverse_pdf * F(S(Pi) * scene.radius * scene.radius), r.weight);
}

// What environments share. Model::sample(scene, u1, u2, uv, pdf, lanes) is a direction with its density and the
// coordinates that `eval` takes; Functions has what differs.
template <class Model, class Functions, class F>
struct Environment {
    using M = MaskOf<F>;
    using Scene = SceneOf<F>;

    TR_HD static void sample_direct(const Scene &scene, const Vec3<F> &, const F &, const F &u1, const F &u2,
                                    const M &lanes, EmitterSample<F> &r) {
        Vec2<F> uv;
        F pdf;
        Vec3<F> d = Model::sample(scene, u1, u2, uv, pdf, lanes);
        r.d = select(lanes, d, r.d);
        r.point.at.b1 = select(lanes, uv.x, r.point.at.b1);
        r.point.at.b2 = select(lanes, uv.y, r.point.at.b2);
        r.distance = select(lanes, F(INFINITY), r.distance);
        r.pdf = select(lanes, pdf, r.pdf);
    }

    TR_HD static void sample_emission(const Scene &scene, const F &, const F &a, const F &b, const F &c, const F &d,
                                      const F &inverse_pmf, const M &lanes, EmissionSample<F> &r) {
        Vec2<F> uv;
        F pdf;
        Vec3<F> from = Model::sample(scene, a, b, uv, pdf, lanes);
        r.point.at.b1 = select(lanes, uv.x, r.point.at.b1);
        r.point.at.b2 = select(lanes, uv.y, r.point.at.b2);
        auto possible = lanes && mask<F>(pdf > F(0));
        r.inverse_pdf = select(possible, inverse_pmf / select(possible, pdf, F(1)), r.inverse_pdf);
        begin_from_afar(scene, from, c, d, lanes, r);
    }

    static constexpr EmitterKernels<F> table() {
        return {Model::model,
                Functions::eval,
                sample_direct,
                Functions::pdf_direct,
                Functions::point_of_direction,
                TR_OF_LIGHT_PATHS(sample_emission),
                TR_OF_DERIVATIVES(Functions::vjp),
                nullptr,
                nullptr,
                TR_HOST_POINTER(Functions::power)};
    }
};

}  // namespace tr
