// The derivative of a hit: position, shading normal and coordinates of a point on a surface, as functions of the
// surface and, where the point is the intersection with a ray that moves (`attached`), of the ray.
//
// An attached hit slides over the surface: with q the motion of the material point under the hit minus that of the
// ray's point, it moves along d by t' = n.q / n.d, and over the surface by t' d - q. Other points are glued to the
// surface: they keep their coordinates, and the measure in which they are integrated is area, which stretches.
#pragma once

#include "arrival.h"

namespace tr {

// Hands the adjoint g of the point p to the surface, and spends it; returns that of where the ray came from: of its
// origin and, where attached or parallel, of its direction.
template <class F>
TR_LARGE RayAdjoint<F> sweep_surface(const SceneOf<F> &scene, const SurfacePoint<F> &at, const Vec3<F> &p,
                                     const Arrival<F> &in, HitAdjoint<F> &g, const MaskOf<F> &active,
                                     GradientSink<F> &sink);

// The same where only the position of a glued point counts.
template <class F>
TR_LARGE void sweep_position(const SceneOf<F> &scene, const SurfacePoint<F> &at, const Vec3<F> &p, const Vec3<F> &p_bar,
                             const MaskOf<F> &active, GradientSink<F> &sink);

// Hands the adjoints (gu, gv) of dp/du and dp/dv on: to the surface, and to the coordinates of the point on it.
template <class F>
TR_LARGE void sweep_partials(const SceneOf<F> &scene, const SurfacePoint<F> &at, const ShapeLanes<F> &shape,
                             const Vec3<F> &gu, const Vec3<F> &gv, const MaskOf<F> &active, CoordinateAdjoint<F> &to,
                             GradientSink<F> &sink);

// The adjoint of |N.E| / |E|, E from a point that sees it to the point p of a surface, of area vector N; `log_bar` is
// that of its logarithm. Sums up what the surface gets, `hit` being what comes besides and is spent, and returns the
// adjoint of the other point. With the unit normal as E it is that of |N|.
template <class F>
TR_INLINE Vec3<F> sweep_area(const SceneOf<F> &scene, const SurfacePoint<F> &at, const Vec3<F> &p, const Vec3<F> &E,
                             const F &log_bar, HitAdjoint<F> &hit, const MaskOf<F> &active, GradientSink<F> &sink) {
    Vec3<F> zero{F(0), F(0), F(0)};
    Vec3<F> rest = E * (F(2) * log_bar / select(active, squared_norm(E), F(1)));  // J has |N.E| / |E|^3
    hit.p = hit.p + rest;
    Arrival<F> in{MaskOf<F>(false), E, F(1), E, zero, log_bar};
    return sweep_surface(scene, at, p, in, hit, active, sink).o - rest;
}

}  // namespace tr
