// The derivative of a point on a curve, see surface.h: with respect to control points, radii and the ray.
#pragma once

#include "../shape/curve.h"
#include "arrival.h"

namespace tr {

// A point and its derivatives along and around a curve, as functions of their coordinates and of the axis (centre, its
// two derivatives, radius and its derivative), whose adjoints add up here.
template <class F>
struct CurveAdjoint {
    enum { B2, B1, D, Dd = D + 3, R = Dd + 3, Dr, Variables };
    using T = Dual<F, Variables>;

    CurveSegment<F> segment;
    CurveAxis<F> axis;
    TubePoint<T> tube;
    F b1{0}, b2{0};  // adjoints
    F of[Variables - D] = {};

    template <class S>
    TR_NOINLINE CurveAdjoint(const SceneView<S> &scene, const SurfacePoint<F> &at, const ShapeLanes<F> &shape,
                             const MaskOf<F> &active)
        : segment(scene, shape, at.primitive, active), axis(segment, at.b2) {
        auto vector = [](const Vec3<F> &v, int first) {
            return Vec3<T>{T(v.x, first), T(v.y, first + 1), T(v.z, first + 2)};
        };
        TubeSection<T> section{vector(axis.d, D), vector(axis.dd, Dd), T(axis.r, R),
                               T(axis.dr, Dr),    T(at.b1, B1),        T(axis.beyond)};
        // b2 moves along the axis, or round the sphere at its end
        auto moves = [&](const F &by) { return select(axis.sphere, F(0), by); };
        section.d.x.d[B2] = moves(axis.dd.x), section.d.y.d[B2] = moves(axis.dd.y),
        section.d.z.d[B2] = moves(axis.dd.z);
        section.dd.x.d[B2] = moves(axis.ddd.x), section.dd.y.d[B2] = moves(axis.ddd.y);
        section.dd.z.d[B2] = moves(axis.ddd.z);
        section.r.d[B2] = moves(axis.dr), section.dr.d[B2] = moves(axis.ddr);
        section.beyond.d[B2] = select(axis.sphere, F(1), F(0));
        tube = tube_point(section, segment.straight, axis.sphere);
        for (F &x : of) x = F(0);
    }

    static TR_INLINE Vec3<F> values(const Vec3<T> &v) { return {v.x.v, v.y.v, v.z.v}; }
    static TR_INLINE F pull(const Vec3<T> &v, const Vec3<F> &bar, int variable) {
        return v.x.d[variable] * bar.x + v.y.d[variable] * bar.y + v.z.d[variable] * bar.z;
    }

    // The adjoints of the derivatives along and around.
    TR_INLINE void add(const Vec3<F> &along, const Vec3<F> &around) {
        auto both = [&](int i) { return pull(tube.along, along, i) + pull(tube.around, around, i); };
        b1 = b1 + both(B1);
        b2 = b2 + both(B2);
        for (int i = D; i < Variables; ++i) of[i - D] = of[i - D] + both(i);
    }

    // Hands everything to the control points, with the adjoint of the position.
    TR_INLINE void spread(const Vec3<F> &p_bar, const MaskOf<F> &active, GradientSink<F> &sink) const {
        if (!any(active)) return;
        F g[Variables - D];
        for (int i = D; i < Variables; ++i) g[i - D] = of[i - D] + pull(tube.offset, p_bar, i);
        Vec3<F> d{g[0], g[1], g[2]}, dd{g[Dd - D], g[Dd - D + 1], g[Dd - D + 2]};
        for (int k = 0; k < 4; ++k) {
            sweep_mesh_vertex(VertexArray::Positions, segment.index[k],
                              p_bar * axis.weight[k] + d * axis.slope[k] + dd * axis.curvature[k], active, sink);
            sink.vertex(VertexArray::Normals, segment.index[k] * 3u,
                        g[R - D] * axis.weight[k] + g[Dr - D] * axis.slope[k], active);
        }
    }
};

template <class F, class S>
TR_NOINLINE Vec3<F> sweep_curve(const SceneView<S> &scene, const SurfacePoint<F> &at, const Arrival<F> &in,
                                HitAdjoint<F> g, const ShapeLanes<F> &shape, const MaskOf<F> &curve, Vec3<F> &d_bar,
                                GradientSink<F> &sink) {
    const Vec3<F> zero{F(0), F(0), F(0)};
    CurveAdjoint<F> bar(scene, at, shape, curve);
    Vec3<F> along = bar.values(bar.tube.along), around = bar.values(bar.tube.around), area = cross(around, along);
    F area_squared = squared_norm(area), cosine = dot(area, select(in.attached, in.d, in.D));
    auto usable = curve && mask<F>(area_squared > F(0)) && mask<F>(abs(cosine) > F(0));
    if (!any(usable)) return zero;
    cosine = select(usable, cosine, F(1));
    F inverse = F(1) / sqrt(select(usable, area_squared, F(1)));
    auto glued = usable && !in.attached;

    Vec3<F> area_bar = unnormalize(area * inverse, g.n, inverse);
    area_bar = select(glued, area_bar + in.D * (in.log_jacobian_bar / cosine), area_bar);
    bar.b1 = g.at.b.x + g.at.uv.x;
    bar.b2 = g.at.b.y + select(bar.axis.sphere, F(0), g.at.uv.y / curve_segments<F>(scene, at.shape, usable));
    bar.add(cross(area_bar, around), cross(along, area_bar));

    // attached: the coordinates are dot products with the dual basis of (around, along)
    F inverse_squared = inverse * inverse;
    Vec3<F> over = cross(along, area) * (bar.b1 * inverse_squared) + cross(area, around) * (bar.b2 * inverse_squared);
    Vec3<F> q = area * ((dot(g.p, in.d) + dot(over, in.d)) / cosine) - over;
    Vec3<F> moved = g.p - q, from_segment = zero;
    if (any(glued)) from_segment = sweep_displacement(in, area, cosine);
    q = select(glued, g.p + from_segment, q);
    bar.spread(q, sink.wants_shape(at.shape, usable), sink);
    auto attached = usable && in.attached;
    d_bar = select(attached, in.d_bar + moved * in.t, zero);
    auto parallel = glued && in.parallel;
    if (any(parallel)) d_bar = select(parallel, sweep_parallel(in, area, cosine), d_bar);
    return select(glued, -from_segment, select(attached, moved, zero));
}

}  // namespace tr
