// `heightfield`: z = h(u, v) over x, y in [-1, 1], u = (x + 1) / 2, v = (y + 1) / 2. The heights lie like a bitmap's
// texels, clamped outside, and are the control values of a uniform cubic B-spline or the corners of bilinear patches.
#pragma once

#include "../math/spline.h"
#include "surface_point.h"

namespace tr {

// The heights of one shape.
template <class S>
struct HeightView {
    const S *data;
    int32_t rows, columns, slot;
    bool linear;

    TR_INLINE HeightView(const SceneView<S> &scene, uint32_t shape) {
        const ShapeInfo &info = scene.shapes[shape];
        slot = info.heights;
        const TensorView<S> &tensor = scene.values.tensors[slot];  // (rows, columns) is rows of so many channels
        data = tensor.data, rows = tensor.shape[0], columns = tensor.shape[2];
        linear = info.interpolation != 0;
    }
};

// Four of n heights along one axis, their weights and the derivatives of these with respect to the coordinate in
// [0, 1].
template <class F>
struct HeightAxis {
    IntOf<F> index[4];
    F weight[4], slope[4], curvature[4];
    MaskOf<F> inside;  // the four lie one after the other

    TR_INLINE HeightAxis(const F &u, int32_t n, bool linear) {
        using I = IntOf<F>;
        F scale{ScalarOf<F>(n)};
        // points of other lanes may lie anywhere
        F at = max(F(-1), min(F(ScalarOf<F>(n)), u * scale - F(0.5))), before = floor(at), f = at - before;
        I first(before);
        inside = mask<F>(first >= 1) && mask<F>(first <= n - 3);
        for (int k = 0; k < 4; ++k) {
            index[k] = max(I(0), min(I(n - 1), first + (k - 1)));
            curvature[k] = F(0);
        }
        if (linear) {
            linear_weights(f, weight);
            linear_slopes(slope);
        } else {
            spline_weights(f, weight);
            spline_slopes(f, slope);
            spline_curvatures(f, curvature);
        }
        for (int k = 0; k < 4; ++k) {
            slope[k] = slope[k] * scale;
            curvature[k] = curvature[k] * (scale * scale);
        }
    }
};

// The height and its derivatives at a point.
template <class F>
struct HeightPoint {
    F z, u, v, uu, uv, vv;
};

template <class F, class S>
TR_INLINE HeightPoint<F> height_at(const HeightView<S> &heights, const F &u, const F &v, const MaskOf<F> &active) {
    using U = UIntOf<F>;
    HeightAxis<F> x(u, heights.columns, heights.linear), y(v, heights.rows, heights.linear);
    HeightPoint<F> r{F(0), F(0), F(0), F(0), F(0), F(0)};
    const bool rows = !any(active && !x.inside);
    for (int j = 0; j < 4; ++j) {
        F h[4], value(0), slope(0), curvature(0);
        if (rows) {
            gather_rows<F>(heights.data, U(y.index[j] * heights.columns + x.index[0]), active, h);
        } else {
            for (int i = 0; i < 4; ++i)
                h[i] = gather<F>(heights.data, U(y.index[j] * heights.columns + x.index[i]), active);
        }
        for (int i = 0; i < 4; ++i) {
            value = fmadd(h[i], x.weight[i], value);
            slope = fmadd(h[i], x.slope[i], slope);
            curvature = fmadd(h[i], x.curvature[i], curvature);
        }
        r.z = fmadd(value, y.weight[j], r.z);
        r.u = fmadd(slope, y.weight[j], r.u);
        r.v = fmadd(value, y.slope[j], r.v);
        r.uu = fmadd(curvature, y.weight[j], r.uu);
        r.uv = fmadd(slope, y.slope[j], r.uv);
        r.vv = fmadd(value, y.curvature[j], r.vv);
    }
    return r;
}

// Distance and coordinates of the intersection near t, which is known to single precision: Newton's iteration, whose
// steps count only where they come nearer.
template <class F, class S>
TR_INLINE void refine_height(const HeightView<S> &heights, const Vec3<F> &o, const Vec3<F> &d, F &t, F &u, F &v,
                             const MaskOf<F> &lanes) {
    F best = F(INFINITY), next = t;
    for (int step = 0; step < 12; ++step) {
        F x = (o.x + next * d.x + F(1)) * F(0.5), y = (o.y + next * d.y + F(1)) * F(0.5);
        HeightPoint<F> h = height_at(heights, x, y, lanes);
        F f = o.z + next * d.z - h.z, slope = d.z - F(0.5) * (h.u * d.x + h.v * d.y);
        auto nearer = lanes && mask<F>(abs(f) < best);
        if (!any(nearer)) break;
        best = select(nearer, abs(f), best);
        t = select(nearer, next, t);
        u = select(nearer, x, u);
        v = select(nearer, y, v);
        next = t - select(mask<F>(slope == F(0)), F(0), f / select(mask<F>(slope == F(0)), F(1), slope));
    }
    u = max(F(0), min(F(1), u));
    v = max(F(0), min(F(1), v));
}

// What the query for height fields reports, a distance and the coordinates (u, v), made into points and unit normals.
template <class F, class S>
TR_NOINLINE void meet_height_fields(const SceneView<S> &scene, const UIntOf<F> &shape, const Vec3<F> &o,
                                    const Vec3<F> &d, const MaskOf<F> &active, F &u, F &v, F &t, Vec3<F> &p,
                                    Vec3<F> &n) {
    each_shape<HeightView, F>(
        scene, shape, active, [&](uint32_t one, const HeightView<S> &heights, const MaskOf<F> &lanes) {
            const S *to_world = scene.shape_matrices + 24 * size_t(one), *to_object = to_world + 12;
            if constexpr (sizeof(S) == 8)
                refine_height(heights, transform_point(to_object, o), transform_vector(to_object, d), t, u, v, lanes);
            HeightPoint<F> h = height_at(heights, u, v, lanes);
            Vec3<F> local{F(2) * u - F(1), F(2) * v - F(1), h.z}, up{F(-0.5) * h.u, F(-0.5) * h.v, F(1)};
            p = select(lanes, transform_point(to_world, local), p);
            n = select(lanes, normalize(transform_normal(to_object, up)), n);
        });
}

}  // namespace tr
