// The derivatives of dp/du and dp/dv (shape/partials.h) by everything that moves them.
#pragma once

#include "../shape/partials.h"
#include "heightfield.h"

namespace tr {

// Hands the adjoints (gu, gv) of dp/du and dp/dv on: to the surface, and to the coordinates of the point on it.
template <class F, class S, class Sink>
TR_NOINLINE void sweep_partials(const SceneView<S> &scene, const SurfacePoint<F> &at, const ShapeLanes<F> &shape,
                                const Vec3<F> &gu, const Vec3<F> &gv, const MaskOf<F> &active, CoordinateAdjoint<F> &to,
                                Sink &sink) {
    using Tables = decltype(sink.geometry);
    auto wanted = active && mask<F>(gather<IntOf<F>>(sink.geometry.wanted, at.shape, mask<IntOf<F>>(active)) != 0);
    auto mesh = active && !shape.has(IsCurved), field = active && shape.has(IsHeightField);
    auto curved = active && !mesh && !field;
    if (any(mesh && wanted)) {
        TriangleMap<F, S> map(scene, shape, at.primitive, mesh);
        auto lanes = mesh && wanted, mapped = lanes && map.mapped;
        const auto &corner = map.tri.corner;
        // with P = (dp/du, dp/dv), E = (e1, e2) and D = (d0, d1): P D = E
        Vec3<F> e1_bar = (gu * map.d1.y - gv * map.d1.x) * map.inverse,
                e2_bar = (gv * map.d0.x - gu * map.d0.y) * map.inverse;
        sweep_vertex(&Tables::positions, corner[0], -(e1_bar + e2_bar), lanes, sink);
        sweep_vertex(&Tables::positions, corner[1], e1_bar, lanes, sink);
        sweep_vertex(&Tables::positions, corner[2], e2_bar, lanes, sink);
        if (any(mapped)) {
            PositionPartials<F> p = map.partials();
            const Vec2<F> d_bar[2] = {{-dot(p.u, e1_bar), -dot(p.v, e1_bar)}, {-dot(p.u, e2_bar), -dot(p.v, e2_bar)}};
            auto put = [&](int k, const F &u, const F &v) {
                sink.vertex(&Tables::texcoords, corner[k] * 2u, u, mapped);
                sink.vertex(&Tables::texcoords, corner[k] * 2u + 1u, v, mapped);
            };
            put(0, -(d_bar[0].x + d_bar[1].x), -(d_bar[0].y + d_bar[1].y));
            put(1, d_bar[0].x, d_bar[0].y);
            put(2, d_bar[1].x, d_bar[1].y);
        }
    }
    auto hand_on = [&](const auto &to_world, const LocalPartials<F> &l, const MaskOf<F> &lanes) {
        // transposed: m^T g
        Vec3<F> u = transform_normal(to_world, gu), v = transform_normal(to_world, gv);
        to.b.x = select(lanes, to.b.x + dot(u, l.uu) + dot(v, l.uv), to.b.x);
        to.b.y = select(lanes, to.b.y + dot(u, l.uv) + dot(v, l.vv), to.b.y);
        const F us[3] = {gu.x, gu.y, gu.z}, vs[3] = {gv.x, gv.y, gv.z}, lu[3] = {l.u.x, l.u.y, l.u.z},
                lv[3] = {l.v.x, l.v.y, l.v.z};
        F matrix[12];
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) matrix[4 * i + j] = us[i] * lu[j] + vs[i] * lv[j];
            matrix[4 * i + 3] = F(0);
        }
        auto moved = lanes && wanted;
        if (any(moved)) sweep_matrix<F>(at.shape, matrix, moved, sink);
    };
    if (any(field))
        each_height_field<F>(scene, at.shape, field,
                             [&](uint32_t one, const HeightView<S> &heights, const MaskOf<F> &lanes) {
                                 const S *to_world = scene.shape_matrices + 24 * size_t(one);
                                 hand_on(to_world, height_partials(height_at(heights, at.b1, at.b2, lanes)), lanes);
                                 auto moved = lanes && wanted;
                                 if (any(moved))
                                     sweep_heights(heights, at.b1, at.b2, F(0), transform_normal(to_world, gu).z,
                                                   transform_normal(to_world, gv).z, moved, sink);
                             });
    if (any(curved)) {
        F to_world[12];
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u, curved, to_world);
        const F *matrix = to_world;
        hand_on(matrix, curved_partials(Vec2<F>{at.b1, at.b2}, CurvedKind<F>(shape, curved)), curved);
    }
}

}  // namespace tr
