// The derivatives of a surface's position by its texture coordinates, dp/du and dp/dv, and the derivatives of these by
// everything that moves them. Coordinates are those that look-ups start from: given ones of a mesh, its barycentric
// ones where it has none, and those of curved shapes (see curved_coordinates). Zero where a triangle's do not vary.
#pragma once

#include "surface.h"

namespace tr {

template <class F>
struct PositionPartials {
    Vec3<F> u, v;
};

// First and second derivatives of a point of a unit shape, or of a height field's square, in its own space.
template <class F>
struct LocalPartials {
    Vec3<F> u, v, uu, uv, vv;
};

template <class F>
TR_INLINE LocalPartials<F> curved_partials(const Vec2<F> &at, const CurvedKind<F> &kind) {
    const F turn(2 * Pi), half(Pi), zero(0);
    F s, c, sine, cosine;
    sincos(select(kind.sphere || kind.cylinder, at.x, at.y) * turn, s, c);
    sincos(at.y * half, sine, cosine);
    const Vec3<F> around{-s * turn, c * turn, zero}, inwards{-c * turn * turn, -s * turn * turn, zero},
        none{zero, zero, zero};
    // the disk
    LocalPartials<F> r{{c, s, zero}, around * at.x, none, around, inwards * at.x};
    auto take = [&](const MaskOf<F> &m, const LocalPartials<F> &x) {
        r = {select(m, x.u, r.u), select(m, x.v, r.v), select(m, x.uu, r.uu), select(m, x.uv, r.uv),
             select(m, x.vv, r.vv)};
    };
    take(kind.sphere, {around * sine,
                       {c * cosine * half, s * cosine * half, -sine * half},
                       inwards * sine,
                       around * (cosine * half),
                       {-c * sine * half * half, -s * sine * half * half, -cosine * half * half}});
    take(kind.cylinder, {around, {zero, zero, F(1)}, inwards, none, none});
    return r;
}

template <class F>
TR_INLINE LocalPartials<F> height_partials(const HeightPoint<F> &h) {
    const F zero(0);
    return {{F(2), zero, h.u}, {zero, F(2), h.v}, {zero, zero, h.uu}, {zero, zero, h.uv}, {zero, zero, h.vv}};
}

// The columns of a triangle's texture coordinates: (d0, d1) = (uv1 - uv0, uv2 - uv0) and the inverse determinant.
template <class F, class S>
struct TriangleMap {
    Triangle<F, S> tri;
    Vec2<F> d0{F(1), F(0)}, d1{F(0), F(1)};
    F inverse{1};  // 0: the coordinates do not vary
    MaskOf<F> mapped;

    static Triangle<F, S> load(const SceneView<S> &scene, const UIntOf<F> &face, const MaskOf<F> &mesh,
                               const MaskOf<F> &mapped, Corners<F> &corners) {
        return Triangle<F, S>(scene, face, mesh, mapped, corners);
    }
    TriangleMap(const SceneView<S> &scene, const ShapeLanes<F> &shape, const UIntOf<F> &primitive,
                const MaskOf<F> &mesh, Corners<F> corners = {})
        : tri(load(scene, UIntOf<F>(shape.face_offset) + primitive, mesh, mesh && shape.has(HasTexcoords), corners)),
          mapped(mesh && shape.has(HasTexcoords)) {
        if (!any(mapped)) return;
        auto edge = [&](int k, const Vec2<F> &bare) {
            return Vec2<F>{select(mapped, corners.uv[k].x - corners.uv[0].x, bare.x),
                           select(mapped, corners.uv[k].y - corners.uv[0].y, bare.y)};
        };
        d0 = edge(1, d0), d1 = edge(2, d1);
        F determinant = d0.x * d1.y - d0.y * d1.x;
        auto usable = mask<F>(determinant != F(0));
        inverse = select(usable, F(1) / select(usable, determinant, F(1)), F(0));
    }
    PositionPartials<F> partials() const {
        return {(tri.e1 * d1.y - tri.e2 * d0.y) * inverse, (tri.e2 * d0.x - tri.e1 * d1.x) * inverse};
    }
};

template <class F, class S>
TR_NOINLINE PositionPartials<F> position_partials(const SceneView<S> &scene, const SurfacePoint<F> &at,
                                                  const ShapeLanes<F> &shape, const MaskOf<F> &active) {
    const Vec3<F> zero{F(0), F(0), F(0)};
    PositionPartials<F> r{zero, zero};
    auto take = [&](const MaskOf<F> &m, const Vec3<F> &u, const Vec3<F> &v) {
        r = {select(m, u, r.u), select(m, v, r.v)};
    };
    auto mesh = active && !shape.has(IsCurved), field = active && shape.has(IsHeightField);
    auto curved = active && !mesh && !field;
    if (any(mesh)) {
        PositionPartials<F> p = TriangleMap<F, S>(scene, shape, at.primitive, mesh).partials();
        take(mesh, p.u, p.v);
    }
    if (any(field))
        each_height_field<F>(scene, at.shape, field,
                             [&](uint32_t one, const HeightView<S> &heights, const MaskOf<F> &lanes) {
                                 auto l = height_partials(height_at(heights, at.b1, at.b2, lanes));
                                 const S *to_world = scene.shape_matrices + 24 * size_t(one);
                                 take(lanes, transform_vector(to_world, l.u), transform_vector(to_world, l.v));
                             });
    if (any(curved)) {
        F to_world[12];
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u, curved, to_world);
        auto l = curved_partials(Vec2<F>{at.b1, at.b2}, CurvedKind<F>(shape, curved));
        take(curved, transform_vector(to_world, l.u), transform_vector(to_world, l.v));
    }
    return r;
}

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
