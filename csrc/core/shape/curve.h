// Curves with a radius: `bsplinecurve`, what a circle perpendicular to a uniform cubic B-spline sweeps, and
// `linearcurve`, the hulls of two spheres each, whose centres and radii are the control points.
//
// A point has the coordinates b1, the azimuth about the axis in turns, and b2, the place along its segment. With the
// centre c(b2), its derivative d, the radius r and the tangent T = d / |d|, the point is c + r m. The azimuth begins at
// N = z x T, horizontal, and goes towards B = T x N; e = cos N + sin B. On a spline m = e. On a cone m is its normal,
// e sqrt(1 - s^2) + s T with s = -r' / |d|; beyond its ends b2 leaves [0, 1], the centre and the radius stay, and s
// changes by what b2 has too much: those are spheres, which close a curve and fill its joints.
#pragma once

#include "../math/dual.h"
#include "../math/spline.h"
#include "surface_point.h"

namespace tr {

// What the surface about a point of the axis depends on.
template <class T>
struct TubeSection {
    Vec3<T> d, dd;  // derivatives of the centre by b2
    T r, dr, b1, beyond;
};

template <class T>
struct TubePoint {
    Vec3<T> offset, along, around;  // r m; derivatives of the point by b2 and b1
};

template <class F>
struct AxisFrame {
    Vec3<F> t, n, b;
    F inverse_length, level2;  // 1 / |d|, the square of the horizontal part of t

    TR_INLINE explicit AxisFrame(const Vec3<F> &d) {
        inverse_length = F(1) / sqrt(dot(d, d));
        t = d * inverse_length;
        level2 = t.x * t.x + t.y * t.y;
        auto upright = mask<F>(level2 < F(1e-12));  // any direction will do
        level2 = select(upright, F(1), level2);
        F level = F(1) / sqrt(level2);
        n = {select(upright, F(0), -t.y * level), select(upright, F(1), t.x * level), F(0)};
        b = cross(t, n);
    }
};

// `straight`: linear segments; `sphere`: beyond their ends.
template <class T, class M>
TR_INLINE TubePoint<T> tube_point(const TubeSection<T> &at, const M &straight, const M &sphere) {
    const AxisFrame<T> axis(at.d);
    T sine, cosine;
    sincos(at.b1 * T(2 * Pi), sine, cosine);
    Vec3<T> e = axis.n * cosine + axis.b * sine, turned = axis.b * cosine - axis.n * sine;
    T s = select(straight, at.beyond - at.dr * axis.inverse_length, T(0));
    T level = sqrt(max(T(1) - s * s, T(1e-10)));
    Vec3<T> m = e * level + axis.t * s;
    // the frame turns along a spline: e' = kappa e_turned - (T'.e) T, with kappa = N'.B
    Vec3<T> bend = (at.dd - axis.t * dot(axis.t, at.dd)) * axis.inverse_length;
    T kappa = (bend.x * axis.b.y - bend.y * axis.b.x) / sqrt(axis.level2);
    Vec3<T> e_along = turned * kappa - axis.t * dot(bend, e);
    TubePoint<T> r;
    r.offset = m * at.r;
    r.around = turned * (at.r * level * T(2 * Pi));
    r.along = select(sphere, (axis.t - e * (s / level)) * at.r, at.d + m * at.dr + e_along * at.r);
    return r;
}

// A segment of a curve, with its control points.
template <class F>
struct CurveSegment {
    UIntOf<F> index[4];  // vertices
    Vec3<F> p[4];
    F radius[4];
    MaskOf<F> straight;

    template <class S>
    TR_INLINE CurveSegment(const SceneView<S> &scene, const ShapeLanes<F> &shape, const UIntOf<F> &primitive,
                           const MaskOf<F> &active)
        : straight(shape.has(IsStraight)) {
        using U = UIntOf<F>;
        U face[3];
        gather_rows<F>(scene.faces, (U(shape.face_offset) + primitive) * 3u, active, face);
        for (uint32_t k = 0; k < 4; ++k) {
            index[k] = face[0] + select(mask<U>(straight), U(k < 1 ? k : 1u), U(k));
            F row[4];
            gather_rows<F>(scene.vertices, index[k] * VertexRow<S>::Size, active, row);
            p[k] = {row[0], row[1], row[2]};
            radius[k] = row[3];
        }
    }
};

// Where on a segment: weights of the control points, and what they give.
template <class F>
struct CurveAxis {
    F weight[4], slope[4], curvature[4];
    F beyond;          // what b2 has too much
    MaskOf<F> sphere;  // ... if anything
    Vec3<F> c, d, dd, ddd;
    F r, dr, ddr;

    TR_INLINE CurveAxis(const CurveSegment<F> &segment, const F &b2) {
        F f = max(F(0), min(F(1), b2));
        beyond = select(segment.straight, b2 - f, F(0));
        sphere = mask<F>(beyond != F(0));
        spline_weights(f, weight);
        spline_slopes(f, slope);
        spline_curvatures(f, curvature);
        const F line[4] = {F(1) - f, f, F(0), F(0)}, third[4] = {F(-1), F(3), F(-3), F(1)};
        Vec3<F> zero{F(0), F(0), F(0)};
        c = d = dd = ddd = zero;
        r = dr = ddr = F(0);
        for (int k = 0; k < 4; ++k) {
            weight[k] = select(segment.straight, line[k], weight[k]);
            slope[k] = select(segment.straight, F(k == 0 ? -1 : k == 1 ? 1 : 0), slope[k]);
            curvature[k] = select(segment.straight, F(0), curvature[k]);
            c = c + segment.p[k] * weight[k];
            d = d + segment.p[k] * slope[k];
            dd = dd + segment.p[k] * curvature[k];
            ddd = ddd + segment.p[k] * select(segment.straight, F(0), third[k]);
            r = fmadd(segment.radius[k], weight[k], r);
            dr = fmadd(segment.radius[k], slope[k], dr);
            ddr = fmadd(segment.radius[k], curvature[k], ddr);
        }
    }

    TR_INLINE TubeSection<F> section(const F &b1) const { return {d, dd, r, dr, b1, beyond}; }
};

template <class F>
struct CurvePoint {
    Vec3<F> p, area, along, around;  // area: around x along, outwards
    template <class S>
    TR_NOINLINE CurvePoint(const SceneView<S> &scene, const SurfacePoint<F> &at, const ShapeLanes<F> &shape,
                           const MaskOf<F> &active) {
        const CurveSegment<F> segment(scene, shape, at.primitive, active);
        const CurveAxis<F> axis(segment, at.b2);
        auto tube = tube_point(axis.section(at.b1), segment.straight, axis.sphere);
        p = axis.c + tube.offset;
        along = tube.along, around = tube.around;
        area = cross(around, along);
    }
};

// The number of a curve's segments, over which the second texture coordinate runs from 0 to 1.
template <class F, class S>
TR_INLINE F curve_segments(const SceneView<S> &scene, const UIntOf<F> &shape, const MaskOf<F> &active) {
    return F(gather<IntOf<F>>(&scene.shapes->n_faces, shape * 16u, mask<IntOf<F>>(active)));
}
template <class F, class S>
TR_INLINE Vec2<F> curve_coordinates(const SceneView<S> &scene, const SurfacePoint<F> &at, const MaskOf<F> &active) {
    F along = max(F(0), min(F(1), at.b2)) + F(at.primitive);
    return {at.b1, along / select(active, curve_segments<F>(scene, at.shape, active), F(1))};
}

// Coordinates of the point where a ray meets a curve, near what the query reports: the distance t, and in b1 the place
// along the segment.
template <class F, class S>
TR_NOINLINE void meet_curves(const SceneView<S> &scene, const Vec3<F> &o, const Vec3<F> &d, const ShapeLanes<F> &shape,
                             const MaskOf<F> &active, SurfacePoint<F> &at, F &t) {
    const CurveSegment<F> segment(scene, shape, at.primitive, active);
    F f = at.b1;
    auto sphere = segment.straight && (mask<F>(f <= F(0)) || mask<F>(f >= F(1)));
    if constexpr (sizeof(S) == 8) {
        // Newton's iteration for x = o + t d with (x - c).c' = 0 (on a cone -r r') and |x - c| = r; steps count only
        // where they come nearer
        F best(INFINITY), next_t = t, next_f = f;
        for (int step = 0; step < 12; ++step) {
            CurveAxis<F> a(segment, next_f);
            Vec3<F> x = o + d * next_t - a.c;
            F side = select(segment.straight, a.r * a.dr, F(0));
            F f1 = select(sphere, F(0), dot(x, a.d) + side), f2 = squared_norm(x) - a.r * a.r;
            F error = abs(f1) + abs(f2);
            auto nearer = active && mask<F>(error < best);
            if (!any(nearer)) break;
            best = select(nearer, error, best);
            t = select(nearer, next_t, t);
            f = select(nearer, next_f, f);
            F by_f = dot(x, a.dd) - dot(a.d, a.d) + select(segment.straight, a.dr * a.dr, F(0));
            F m00 = select(sphere, F(0), dot(d, a.d)), m01 = select(sphere, F(1), by_f);
            F m10 = F(2) * dot(x, d), m11 = select(sphere, F(0), F(-2) * (dot(x, a.d) + a.r * a.dr));
            F determinant = m00 * m11 - m01 * m10;
            auto usable = mask<F>(abs(determinant) > F(0));
            F inverse = select(usable, F(1) / select(usable, determinant, F(1)), F(0));
            next_t = t - (f1 * m11 - f2 * m01) * inverse;
            next_f = max(F(0), min(F(1), f - (f2 * m00 - f1 * m10) * inverse));
        }
    }
    CurveAxis<F> a(segment, f);
    AxisFrame<F> frame(a.d);
    Vec3<F> x = o + d * t - a.c;
    F azimuth = atan2(dot(x, frame.b), dot(x, frame.n)) * F(1 / (2 * Pi));
    azimuth = select(mask<F>(azimuth < F(0)), azimuth + F(1), azimuth);
    F beyond = dot(x, frame.t) / sqrt(max(squared_norm(x), F(1e-30f))) + a.dr * frame.inverse_length;
    beyond = select(mask<F>(f <= F(0)), min(beyond, F(0)), max(beyond, F(0)));
    at.b1 = select(active, azimuth, at.b1);
    at.b2 = select(active, select(sphere, f + beyond, f), at.b2);
}

#define TR_ELSEWHERE(S)                                                                                          \
    extern template CurvePoint<PacketOf<S>>::CurvePoint(const SceneView<S> &, const SurfacePoint<PacketOf<S>> &, \
                                                        const ShapeLanes<PacketOf<S>> &, const MaskOf<PacketOf<S>> &);
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
