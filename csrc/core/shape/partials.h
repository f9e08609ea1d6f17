// The derivatives of a surface's position by its texture coordinates, dp/du and dp/dv. Coordinates are those that
// look-ups start from: given ones of a mesh, its barycentric ones where it has none, and those of curved shapes (see
// curved_coordinates). Zero where a triangle's do not vary, and on grids of distances.
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

    TR_INLINE static Triangle<F, S> load(const SceneView<S> &scene, const UIntOf<F> &face, const MaskOf<F> &mesh,
                                         const MaskOf<F> &mapped, Corners<F> &corners) {
        return Triangle<F, S>(scene, face, mesh, mapped, corners);
    }
    TR_INLINE TriangleMap(const SceneView<S> &scene, const ShapeLanes<F> &shape, const UIntOf<F> &primitive,
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
    TR_INLINE PositionPartials<F> partials() const {
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
    auto curve = active && shape.has(IsCurve);
    auto curved = active && !mesh && !field && !curve && !shape.has(IsSdfGrid);  // grids have no coordinates
    if (any(curve)) {
        const CurvePoint<F> point(scene, at, shape, curve);
        take(curve, point.around, point.along * curve_segments<F>(scene, at.shape, curve));
    }
    if (any(mesh)) {
        PositionPartials<F> p = TriangleMap<F, S>(scene, shape, at.primitive, mesh).partials();
        take(mesh, p.u, p.v);
    }
    if (any(field))
        each_shape<HeightView, F>(scene, at.shape, field,
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

// dp/du alone.
template <class F, class S>
TR_INLINE Vec3<F> surface_tangent(const SceneView<S> &scene, const SurfacePoint<F> &at, const MaskOf<F> &active) {
    return position_partials(scene, at, ShapeLanes<F>(scene.shapes, at.shape, active), active).u;
}

// The part of a tangent u that is orthogonal to the unit normal n: along = u - (n.u) n, and 1 / |along|, 0 where there
// is none.
template <class F>
struct TangentPart {
    Vec3<F> along;
    F up, inverse;
    TR_INLINE TangentPart(const Vec3<F> &n, const Vec3<F> &u) : up(dot(n, u)) {
        along = u - n * up;
        F size2 = squared_norm(along);
        auto usable = mask<F>(size2 > F(1e-12) * squared_norm(u));
        inverse = select(usable, F(1) / sqrt(select(usable, size2, F(1))), F(0));
    }
};

// The frame of models that follow the tangent, turned about the normal n until s is along the tangent.
template <class F>
TR_INLINE Frame<F> tangent_frame(const Vec3<F> &n, const Vec3<F> &u) {
    TangentPart<F> part(n, u);
    Frame<F> frame = make_frame(n);
    frame.s = select(mask<F>(part.inverse > F(0)), part.along * part.inverse, frame.s);
    frame.t = cross(n, frame.s);
    return frame;
}

#define TR_ELSEWHERE(S)                                                                           \
    extern template PositionPartials<PacketOf<S>> position_partials(                              \
        const SceneView<S> &, const SurfacePoint<PacketOf<S>> &, const ShapeLanes<PacketOf<S>> &, \
        const MaskOf<PacketOf<S>> &);
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
