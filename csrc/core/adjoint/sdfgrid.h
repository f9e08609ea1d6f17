// The derivative of a point on a grid of signed distances, see surface.h: with respect to its values, its matrix and
// the ray. Rays to such points keep their directions, so that all of them are attached: seen from a cell the surface is
// a graph over two of its axes, but over other two in the next cell, and no choice of what a glued point keeps goes on
// from the one to the other.
//
// With l = M^-1 (x - tau) and the interpolant f(l) = sum phi_c g_c, the point on the ray x = o + t d moves along d by
//   t' = (m.(dM l + dtau - r) - sum phi_c dg_c) / (m.d),   m = M^-T grad f,   r = do + t dd.
#pragma once

#include "arrival.h"

namespace tr {

// Hands the adjoint of a smooth normal's sum on: adds that of the place in the cell to `at_bar` and those of the cell's
// corners to `corner_bar`; the outer corners' are added to the gradient.
template <class F, class S>
TR_INLINE void sweep_smooth_normal(const SdfGridView<S> &grid, const SdfPoint<F> &p, const SdfSmoothNormal<F> &smooth,
                                   const Vec3<F> &sum_bar, const MaskOf<F> &wanted, F (&at_bar)[3], F (&corner_bar)[8],
                                   GradientSink<F> &sink) {
    F difference_bar[3][2] = {}, share_bar[3] = {};
    for (int a = 0; a < 3; ++a) difference_bar[a][0] = difference_bar[a][1] = share_bar[a] = F(0);
    for (int b = 0; b < 8; ++b) {
        F inverse, part[3];
        Vec3<F> n = smooth.unit(b, inverse);
        for (int a = 0; a < 3; ++a) part[a] = smooth.part(b, a);
        Vec3<F> g = unnormalize(n, sum_bar * (part[0] * part[1] * part[2]), inverse);
        const F by[3] = {g.x, g.y, g.z}, along = dot(n, sum_bar);
        for (int a = 0; a < 3; ++a) {
            const int which = b >> a & 1;
            difference_bar[a][which] = difference_bar[a][which] + by[a];
            F others = along * part[(a + 1) % 3] * part[(a + 2) % 3];
            share_bar[a] = which ? share_bar[a] + others : share_bar[a] - others;
        }
    }
    Footprint<F, 12> taps;
    for (int a = 0; a < 3; ++a) {
        at_bar[a] = fmadd(share_bar[a], smooth.share_slope[a], at_bar[a]);
        for (int k = 0; k < 2; ++k) {
            F &bar = at_bar[(a + 1 + k) % 3];
            for (int which = 0; which < 2; ++which)
                bar = fmadd(difference_bar[a][which], smooth.turning[a][which][k], bar);
        }
        const F scale{S(grid.cells[a])},
            own = difference_bar[a][0] * scale,
            next = select(smooth.after[a], difference_bar[a][1], -difference_bar[a][1]) * scale;
        for (int k = 0; k < 4; ++k) {
            const int c = sdf_face_corner(k, a), high = c | 1 << a;
            F weight = p.weight(c, a);
            // the next cell has one face in common
            F low_bar = select(smooth.after[a], F(0), -next), high_bar = select(smooth.after[a], -next, F(0));
            corner_bar[c] = fmadd(weight, low_bar - own, corner_bar[c]);
            corner_bar[high] = fmadd(weight, high_bar + own, corner_bar[high]);
            IntOf<F> offset((c & 1) + (c >> 1 & 1) * grid.stride[1] + (c >> 2) * grid.stride[2]);
            taps.texel[4 * a + k] = UIntOf<F>(p.first + smooth.outer[a] + offset);
            taps.weight[4 * a + k] = weight * next;
        }
    }
    if (any(wanted)) sink.taps(grid.slot, taps, wanted);
}

template <class F, class S>
TR_NOINLINE Vec3<F> sweep_sdf_grids(const SceneView<S> &scene, const SurfacePoint<F> &at, const Arrival<F> &in,
                                    const HitAdjoint<F> &g, const MaskOf<F> &active, Vec3<F> &d_bar,
                                    GradientSink<F> &sink) {
    Vec3<F> r{F(0), F(0), F(0)};
    auto any_wanted = sink.wants_shape(at.shape, active);
    each_shape<SdfGridView, F>(scene, at.shape, active, [&](uint32_t one, const SdfGridView<S> &grid, MaskOf<F> lanes) {
        const S *to_object = scene.shape_matrices + 24 * size_t(one) + 12;
        const SdfPoint<F> p = sdf_point(grid, at.primitive, at.b1, at.b2, lanes);
        const Vec3<F> m = transform_normal(to_object, p.gradient(grid));
        F along = dot(m, in.d);
        lanes = lanes && mask<F>(abs(along) > F(0));
        if (!any(lanes)) return;
        auto wanted = lanes && any_wanted;
        along = select(lanes, along, F(1));

        F at_bar[3], corner_bar[8], matrix[12];
        for (F &x : at_bar) x = F(0);
        for (F &x : corner_bar) x = F(0);
        for (F &x : matrix) x = F(0);
        // Of a normal along M^-T k: returns the adjoint of k.
        auto turn = [&](const Vec3<F> &turned, const Vec3<F> &n_bar) {
            F squared = squared_norm(turned);
            auto usable = mask<F>(squared > F(0));
            F inverse = select(usable, rsqrt(select(usable, squared, F(1))), F(0));
            Vec3<F> k_bar = transform_vector(to_object, unnormalize(turned * inverse, n_bar, inverse));
            const F ms[3] = {turned.x, turned.y, turned.z}, ks[3] = {k_bar.x, k_bar.y, k_bar.z};
            for (int i = 0; i < 3; ++i)
                for (int j = 0; j < 3; ++j) matrix[4 * i + j] = matrix[4 * i + j] - ms[i] * ks[j];
            return k_bar;
        };
        const bool smooth = scene.shapes[one].flags & HasNormals;
        const Vec3<F> k_bar = turn(m, smooth ? g.ng : g.ng + g.n);
        const F ks[3] = {k_bar.x, k_bar.y, k_bar.z};
        F slope_bar[3];
        for (int a = 0; a < 3; ++a) slope_bar[a] = ks[a] * F(S(grid.cells[a]));
        for (int a = 0; a < 3; ++a) {  // the second derivative by axes a and b is that of the third one
            const int b = (a + 1) % 3, c = (a + 2) % 3;
            at_bar[a] = slope_bar[b] * p.mixed[c] + slope_bar[c] * p.mixed[b];
        }
        const UIntOf<F> axis = at.primitive & ((1u << SdfCellBits::Axis) - 1);
        for (uint32_t a = 0; a < 3; ++a) {  // the coordinates that are stored: outputs have them
            F b_bar = select(mask<F>(axis == (a + 2) % 3), g.at.b.x, g.at.b.y);
            at_bar[a] = select(mask<F>(axis == a), at_bar[a], at_bar[a] + b_bar);
        }
        for (int k = 0; k < 8; ++k)
            for (int a = 0; a < 3; ++a) corner_bar[k] = fmadd(slope_bar[a], p.weight_slope(k, a), corner_bar[k]);
        if (smooth) {
            const SdfSmoothNormal<F> normal(grid, p, lanes);
            Vec3<F> sum_bar = turn(transform_normal(to_object, normal.sum), g.n);
            sweep_smooth_normal(grid, p, normal, sum_bar, wanted, at_bar, corner_bar, sink);
        }

        Vec3<F> local_bar{at_bar[0] * F(S(grid.cells[0])), at_bar[1] * F(S(grid.cells[1])),
                          at_bar[2] * F(S(grid.cells[2]))};
        Vec3<F> over = transform_normal(to_object, local_bar);
        F lift = (dot(g.p, in.d) + dot(over, in.d)) / along;
        Vec3<F> q = m * lift - over, moved = g.p - q;
        if (any(wanted)) {
            Vec3<F> local = p.local(grid);
            const F row[3] = {q.x, q.y, q.z}, column[4] = {local.x, local.y, local.z, F(1)};
            for (int i = 0; i < 12; ++i) matrix[i] = fmadd(row[i / 4], column[i % 4], matrix[i]);
            sweep_matrix<F>(at.shape, matrix, wanted, sink);
            Footprint<F, 8> taps;
            for (int k = 0; k < 8; ++k) {
                taps.texel[k] =
                    UIntOf<F>(p.first + IntOf<F>((k & 1) + (k >> 1 & 1) * grid.stride[1] + (k >> 2) * grid.stride[2]));
                taps.weight[k] = corner_bar[k] - lift * p.weight(k);
            }
            sink.taps(grid.slot, taps, wanted);
        }
        d_bar = select(lanes, in.d_bar + moved * in.t, d_bar);
        r = select(lanes, moved, r);
    });
    return r;
}

}  // namespace tr
