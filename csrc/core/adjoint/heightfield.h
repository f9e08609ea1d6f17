// The derivative of a point on a height field, see surface.h: with respect to its heights, its matrix and the ray.
//
// With local = (x, y, z) and p = M local, the normal is along m = M^-T k, k = (-z_x, -z_y, 1). A change of the heights
// lifts the point by the sum of B_k dh_k over the spline's weights B_k, and changes the slopes by their derivatives.
// Where the point slides over the surface the slopes change by the second derivatives of z.
#pragma once

#include "arrival.h"

namespace tr {

// Adds what height and slopes (with respect to u and v) receive to the heights around a point, which share one pass.
template <class F, class S>
TR_INLINE void sweep_heights(const HeightView<S> &heights, const F &u, const F &v, const F &z_bar, const F &by_u,
                             const F &by_v, const MaskOf<F> &active, GradientSink<F> &sink) {
    HeightAxis<F> x(u, heights.columns, heights.linear), y(v, heights.rows, heights.linear);
    Footprint<F, 16> taps;
    for (int j = 0; j < 4; ++j) {
        F weight = z_bar * y.weight[j] + by_v * y.slope[j], slope = by_u * y.weight[j];
        for (int i = 0; i < 4; ++i) {
            taps.texel[4 * j + i] = UIntOf<F>(y.index[j] * heights.columns + x.index[i]);
            taps.weight[4 * j + i] = weight * x.weight[i] + slope * x.slope[i];
        }
    }
    sink.taps(heights.slot, taps, active);
}

template <class F, class S>
TR_NOINLINE Vec3<F> sweep_height_fields(const SceneView<S> &scene, const SurfacePoint<F> &at, const Arrival<F> &in,
                                        const HitAdjoint<F> &g, const MaskOf<F> &active, Vec3<F> &d_bar,
                                        GradientSink<F> &sink) {
    Vec3<F> zero{F(0), F(0), F(0)}, r = zero;
    auto any_wanted = sink.wants_shape(at.shape, active);
    each_shape<HeightView, F>(
        scene, at.shape, active, [&](uint32_t one, const HeightView<S> &heights, MaskOf<F> lanes) {
            const S *to_world = scene.shape_matrices + 24 * size_t(one), *to_object = to_world + 12;
            HeightPoint<F> h = height_at(heights, at.b1, at.b2, lanes);
            Vec3<F> local{F(2) * at.b1 - F(1), F(2) * at.b2 - F(1), h.z};
            Vec3<F> m = transform_normal(to_object, Vec3<F>{F(-0.5) * h.u, F(-0.5) * h.v, F(1)});
            F inverse = rsqrt(squared_norm(m));
            Vec3<F> n = m * inverse;
            F cosine = dot(n, select(in.attached, in.d, in.D));
            lanes = lanes && mask<F>(abs(cosine) > F(0));
            if (!any(lanes)) return;
            cosine = select(lanes, cosine, F(1));
            auto glued = lanes && !in.attached;

            Vec3<F> m_bar = unnormalize(n, g.n, inverse), from_segment = zero;
            if (any(glued)) {
                from_segment = select(glued, sweep_displacement(in, n, cosine), zero);
                m_bar = select(glued, m_bar + in.D * (in.log_jacobian_bar * inverse / cosine), m_bar);
            }
            Vec3<F> k_bar = transform_vector(to_object, m_bar);
            // sliding by du, dv
            F u_bar = g.at.uv.x + g.at.b.x - F(0.5) * (h.uu * k_bar.x + h.uv * k_bar.y);
            F v_bar = g.at.uv.y + g.at.b.y - F(0.5) * (h.uv * k_bar.x + h.vv * k_bar.y);
            Vec3<F> over = transform_normal(to_object, Vec3<F>{F(0.5) * u_bar, F(0.5) * v_bar, F(0)});
            Vec3<F> q = n * ((dot(g.p, in.d) + dot(over, in.d)) / cosine) - over;
            q = select(glued, g.p + from_segment, q);

            auto wanted = lanes && any_wanted;
            if (any(sink.wants_matrix(at.shape, wanted))) {
                const F row[3] = {q.x, q.y, q.z}, column[3] = {local.x, local.y, local.z}, ms[3] = {m.x, m.y, m.z},
                        ks[3] = {k_bar.x, k_bar.y, k_bar.z};
                F determinant = select(glued, in.log_jacobian_bar, F(0)), matrix[12];  // d log det(M) = tr(M^-1 dM)
                for (int i = 0; i < 3; ++i) {
                    for (int j = 0; j < 3; ++j)
                        matrix[4 * i + j] = row[i] * column[j] - ms[i] * ks[j] + determinant * to_object[4 * j + i];
                    matrix[4 * i + 3] = row[i];
                }
                sweep_matrix<F>(at.shape, matrix, wanted, sink);
            }
            if (any(wanted)) {
                F z_bar = q.x * to_world[2] + q.y * to_world[6] + q.z * to_world[10];
                sweep_heights(heights, at.b1, at.b2, z_bar, F(-0.5) * k_bar.x, F(-0.5) * k_bar.y, wanted, sink);
            }
            auto attached = lanes && in.attached;
            Vec3<F> moved = g.p - q;
            d_bar = select(attached, in.d_bar + moved * in.t, d_bar);
            auto parallel = glued && in.parallel;
            if (any(parallel)) d_bar = select(parallel, sweep_parallel(in, n, cosine), d_bar);
            r = select(glued, -from_segment, select(attached, moved, r));
        });
    return r;
}

// The same where only the position of a glued point counts; `active`: on shapes whose derivative is wanted.
template <class F, class S>
TR_NOINLINE void sweep_height_positions(const SceneView<S> &scene, const SurfacePoint<F> &at, const Vec3<F> &p_bar,
                                        const MaskOf<F> &active, GradientSink<F> &sink) {
    each_shape<HeightView, F>(scene, at.shape, active,
                              [&](uint32_t one, const HeightView<S> &heights, const MaskOf<F> &lanes) {
                                  const S *to_world = scene.shape_matrices + 24 * size_t(one);
                                  F z = height_at(heights, at.b1, at.b2, lanes).z;
                                  const F row[3] = {p_bar.x, p_bar.y, p_bar.z},
                                          column[4] = {F(2) * at.b1 - F(1), F(2) * at.b2 - F(1), z, F(1)};
                                  F matrix[12];
                                  for (int i = 0; i < 12; ++i) matrix[i] = row[i / 4] * column[i % 4];
                                  sweep_matrix<F>(at.shape, matrix, lanes, sink);
                                  F z_bar = p_bar.x * to_world[2] + p_bar.y * to_world[6] + p_bar.z * to_world[10];
                                  sweep_heights(heights, at.b1, at.b2, z_bar, F(0), F(0), lanes, sink);
                              });
}

}  // namespace tr
