// What the derivative of a hit starts from: the adjoints of the point, and how a ray came to it.
#pragma once

#include "lookup.h"

namespace tr {

template <class F>
struct HitAdjoint {
    // position, unit shading normal, unit geometric normal of a mesh
    Vec3<F> p{F(0), F(0), F(0)}, n{F(0), F(0), F(0)}, ng{F(0), F(0), F(0)};
    Vec3<F> tangent{F(0), F(0), F(0)}, tangent_v{F(0), F(0), F(0)};  // dp/du, dp/dv
    CoordinateAdjoint<F> at;
};

template <class F>
struct RayAdjoint {
    Vec3<F> o, d;
};

// Of a line between two points: of its origin, of its unit direction, and of the point where it ends.
template <class F>
struct LineAdjoint {
    Vec3<F> o{F(0), F(0), F(0)}, d{F(0), F(0), F(0)}, end{F(0), F(0), F(0)};
};

// How a ray came to a point: where `attached`, along the unit vector d from t away; else from a point that is glued to
// its own surface, D away, or, `parallel`, from infinitely far away along D, J being |N.D|. `d_bar` is the adjoint of
// the unit direction, and `log_jacobian_bar`, of glued points, that of log J, J = |N.D| / |D|^3, N being the area
// vector: e1 x e2 of a triangle, det(M) M^-T times the normal of a unit shape.
template <class F>
struct Arrival {
    MaskOf<F> attached;
    Vec3<F> d;
    F t;
    Vec3<F> D, d_bar;
    F log_jacobian_bar;
    MaskOf<F> parallel{false};
};

// Adjoint of v where only its direction counts: n = v / length.
template <class F>
TR_INLINE Vec3<F> unnormalize(const Vec3<F> &n, const Vec3<F> &n_bar, const F &inverse_length) {
    return (n_bar - n * dot(n, n_bar)) * inverse_length;
}

// The adjoint of D, through its direction and through J except for N; `area` is a multiple of N.
template <class F>
TR_INLINE Vec3<F> sweep_displacement(const Arrival<F> &in, const Vec3<F> &area, const F &cosine) {
    F inverse_squared = F(1) / squared_norm(in.D), inverse = sqrt(inverse_squared);
    Vec3<F> bar = unnormalize(in.D * inverse, in.d_bar, inverse) +
                  (area * (F(1) / cosine) - in.D * (F(3) * inverse_squared)) * in.log_jacobian_bar;
    return select(in.parallel, Vec3<F>{F(0), F(0), F(0)}, bar);
}

// The adjoint of the unit direction of parallel light, which changes J = |N.d|.
template <class F>
TR_INLINE Vec3<F> sweep_parallel(const Arrival<F> &in, const Vec3<F> &area, const F &cosine) {
    return in.d_bar + area * (in.log_jacobian_bar * norm(in.D) / cosine);
}

// Adjoints of three numbers of a vertex.
template <class F>
TR_INLINE void sweep_mesh_vertex(VertexArray array, const UIntOf<F> &vertex, const Vec3<F> &g, const MaskOf<F> &active,
                                 GradientSink<F> &sink) {
    UIntOf<F> i = vertex * 3u;
    sink.vertex(array, i, g.x, active);
    sink.vertex(array, i + 1u, g.y, active);
    sink.vertex(array, i + 2u, g.z, active);
}

// Adjoints of the matrix of a curved shape, where they are wanted.
template <class F>
TR_INLINE void sweep_matrix(const UIntOf<F> &shape, const F (&g)[12], const MaskOf<F> &lanes, GradientSink<F> &sink) {
    const MaskOf<F> active = sink.wants_matrix(shape, lanes);
    if (!any(active)) return;
    IntOf<F> offset = IntOf<F>(shape * 12u + sink.matrices);
    for (int i = 0; i < 12; ++i) sink.scalar(offset + i, g[i], active);
}

}  // namespace tr
