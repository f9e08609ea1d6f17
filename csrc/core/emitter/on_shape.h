// What the emitters of shapes share: a textured radiance, and points sampled by area.
#pragma once

#include "kernels.h"

namespace tr {

template <class Model, class F>
struct OnShape {
    using M = MaskOf<F>;
    using Scene = SceneOf<F>;

    TR_HD static void eval(const Scene &scene, const Wavelengths<F> &waves, const EmitterPoint<F> &point,
                           const M &lanes, Spectrum<F> &r) {
        IntOf<F> texture = emitter_field<F>(scene, Model::Radiance, point.emitter, lanes);
        r = select(lanes, eval_texture(scene, waves, texture, point.at, lanes), r);
    }

    TR_HD static void vjp(const Scene &scene, const EmitterPoint<F> &point, const Vec3<F> &, const Spectrum<F> &g,
                          const GradientNeeds &needs, const M &lanes, CoordinateAdjoint<F> &at, Vec3<F> &,
                          GradientSink<F> &sink) {
        IntOf<F> texture = emitter_field<F>(scene, Model::Radiance, point.emitter, lanes);
        if (needs.emitter) sink.texture(scene, texture, point.at, g, lanes);
        if (needs.geometry) sweep_lookup(scene, texture, point.at, g, lanes, at, sink);
    }

protected:
    TR_HD static UIntOf<F> shape_of(const Scene &scene, const IntOf<F> &emitter, const M &lanes) {
        return UIntOf<F>(emitter_field<F>(scene, EmitterShape, emitter, lanes));
    }

    TR_INLINE static void put(const SurfacePoint<F> &from, const M &lanes, SurfacePoint<F> &to) {
        auto lanes_u = mask<UIntOf<F>>(lanes);
        to.shape = select(lanes_u, from.shape, to.shape);
        to.primitive = select(lanes_u, from.primitive, to.primitive);
        to.b1 = select(lanes, from.b1, to.b1);
        to.b2 = select(lanes, from.b2, to.b2);
    }

    // A point, and light that leaves it along its normal.
    TR_HD static SampledPoint<F> sample_point(const Scene &scene, const F &left, const F &a, const F &b,
                                              const F &inverse_pmf, const M &lanes, EmissionSample<F> &r) {
        SampledPoint<F> q = sample_shape<F>(scene, shape_of(scene, r.point.emitter, lanes), left, a, b, lanes, true);
        put(q.at, lanes, r.point.at);
        r.p = select(lanes, q.p, r.p);
        r.n = select(lanes, q.n, r.n);
        r.d = select(lanes, q.n, r.d);
        r.inverse_pdf = select(lanes, inverse_pmf / q.pdf, r.inverse_pdf);
        return q;
    }

    // Of a light path's beginning: the surface's texture coordinates, where nothing else moves.
    TR_HD static void sweep_coordinates(const Scene &scene, const VertexRecord<F> &v, const CoordinateAdjoint<F> &at,
                                        const M &lanes, GradientSink<F> &sink) {
        if (!scene.textured) return;
        HitAdjoint<F> hit;
        hit.at = at;
        sweep_area(scene, v.light.at, v.p, v.normal, F(0), hit, lanes, sink);
    }
};

}  // namespace tr
