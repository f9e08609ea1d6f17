// Surfaces: from what was hit to positions, normals and texture coordinates, and points sampled on emitting shapes.
#pragma once

#include "../math/warp.h"
#include "curve.h"
#include "heightfield.h"
#include "sdfgrid.h"

namespace tr {

// The same with its texture coordinates (valid where the scene has textures, see SceneView::textured), which several
// look-ups need.
template <class F>
struct TexturedPoint : SurfacePoint<F> {
    Vec2<F> uv;
};

template <class F>
struct Ray {
    Vec3<F> o, d;
};

template <class F>
struct Interaction {
    TexturedPoint<F> at;
    ShapeLanes<F> shape;
    Vec3<F> p, ng;   // position, unit geometric normal
    Frame<F> frame;  // of the shading normal
    F t;
};

// Normals and texture coordinates at the corners of a triangle, arbitrary where its mesh has none.
template <class F>
struct Corners {
    Vec3<F> n[3];
    Vec2<F> uv[3];
};

template <class F, class S>
struct Triangle {
    UIntOf<F> corner[3];
    Vec3<F> p0, e1, e2;

    TR_INLINE Triangle(const SceneView<S> &scene, const UIntOf<F> &face, const MaskOf<F> &active) {
        gather_rows<F>(scene.faces, face * 3u, active, corner);
        Vec3<F> p[3];
        for (int k = 0; k < 3; ++k) {
            F row[4];  // one load; the last is not used
            gather_rows<F>(scene.vertices, corner[k] * VertexRow<S>::Size, active, row);
            p[k] = {row[0], row[1], row[2]};
        }
        set_edges(p);
    }
    // The same and, where any lane has `more`, the rest of the rows.
    TR_INLINE Triangle(const SceneView<S> &scene, const UIntOf<F> &face, const MaskOf<F> &active, const MaskOf<F> &more,
                       Corners<F> &rest) {
        if (!any(more)) {
            *this = Triangle(scene, face, active);
            return;
        }
        gather_rows<F>(scene.faces, face * 3u, active, corner);
        Vec3<F> p[3];
        for (int k = 0; k < 3; ++k) {
            F row[8];
            gather_long_rows<F>(scene.vertices, corner[k] * VertexRow<S>::Size, active, row);
            p[k] = {row[0], row[1], row[2]};
            rest.n[k] = {row[3], row[4], row[5]};
            rest.uv[k] = {row[6], row[7]};
        }
        set_edges(p);
    }

private:
    TR_INLINE void set_edges(const Vec3<F> (&p)[3]) {
        p0 = p[0];
        e1 = p[1] - p0;
        e2 = p[2] - p0;
    }
};

template <class F>
TR_INLINE Vec2<F> interpolate_coordinates(const Vec2<F> (&uv)[3], const F &b1, const F &b2) {
    const F b[3] = {F(1) - b1 - b2, b1, b2};
    Vec2<F> r{F(0), F(0)};
    for (int k = 0; k < 3; ++k) {
        r.x = fmadd(b[k], uv[k].x, r.x);
        r.y = fmadd(b[k], uv[k].y, r.y);
    }
    return r;
}

template <class F, class S>
TR_INLINE Vec2<F> texture_coordinates(const SceneView<S> &scene, const SurfacePoint<F> &at, const MaskOf<F> &active) {
    ShapeLanes<F> shape(scene.shapes, at.shape, active);
    auto has = active && shape.has(HasTexcoords);
    auto bare = shape.has(IsSdfGrid);
    Vec2<F> uv{select(bare, F(0), at.b1), select(bare, F(0), at.b2)};
    if (any(has)) {
        UIntOf<F> corner[3];
        gather_rows<F>(scene.faces, (UIntOf<F>(shape.face_offset) + at.primitive) * 3u, has, corner);
        Vec2<F> corners[3];
        for (int k = 0; k < 3; ++k) {
            F row[2];
            gather_rows<F>(scene.vertices, corner[k] * VertexRow<S>::Size + VertexRow<S>::Texcoords, has, row);
            corners[k] = {row[0], row[1]};
        }
        Vec2<F> given = interpolate_coordinates(corners, at.b1, at.b2);
        uv = {select(has, given.x, uv.x), select(has, given.y, uv.y)};
    }
    auto curve = active && shape.has(IsCurve);
    if (any(curve)) {
        Vec2<F> own = curve_coordinates(scene, at, curve);
        uv.y = select(curve, own.y, uv.y);
    }
    return uv;
}

// What a look-up starts from.
template <class F, class S>
TR_INLINE Vec2<F> lookup_coordinates(const SceneView<S> &scene, const SurfacePoint<F> &at, const MaskOf<F> &active) {
    return texture_coordinates(scene, at, active);
}
template <class F, class S>
TR_INLINE Vec2<F> lookup_coordinates(const SceneView<S> &, const TexturedPoint<F> &at, const MaskOf<F> &) {
    return at.uv;
}

// What a curved shape is: the unit sphere, the open cylinder of radius 1 about the z axis from 0 to 1, else the unit
// disk in the plane z = 0.
template <class F>
struct CurvedKind {
    MaskOf<F> sphere, cylinder;

    TR_INLINE CurvedKind(const ShapeLanes<F> &shape, const MaskOf<F> &curved)
        : sphere(curved && shape.has(IsSphere)), cylinder(curved && shape.has(IsCylinder)) {}
    TR_INLINE explicit CurvedKind(const MaskOf<F> &sphere) : sphere(sphere), cylinder(false) {}

    // A point near the surface, put on it.
    TR_INLINE Vec3<F> project(const Vec3<F> &p) const {
        F z = select(cylinder, F(0), p.z);
        Vec3<F> round = normalize(Vec3<F>{p.x, p.y, z});
        round.z = select(cylinder, p.z, round.z);
        return select(sphere || cylinder, round, Vec3<F>{p.x, p.y, F(0)});
    }
    // The normal of the unit shape at one of its points.
    TR_INLINE Vec3<F> normal(const Vec3<F> &local) const {
        Vec3<F> around{local.x, local.y, select(sphere, local.z, F(0))};
        return select(sphere || cylinder, around, Vec3<F>{F(0), F(0), F(1)});
    }
};

// Texture coordinates of a point of the unit sphere (azimuth, polar angle), the unit disk (radius, azimuth) or a
// cylinder (azimuth, height).
template <class F>
TR_INLINE Vec2<F> curved_coordinates(const Vec3<F> &local, const CurvedKind<F> &kind) {
    F phi = atan2(local.y, local.x) * F(1 / (2 * Pi));
    phi = select(mask<F>(phi < F(0)), phi + F(1), phi);
    F polar = acos(max(F(-1), min(F(1), local.z))) * F(1 / Pi);
    F radius = sqrt(local.x * local.x + local.y * local.y);
    return {select(kind.sphere || kind.cylinder, phi, radius),
            select(kind.sphere, polar, select(kind.cylinder, local.z, phi))};
}
// The point of the unit shape that has these coordinates.
template <class F>
TR_INLINE Vec3<F> curved_point(const Vec2<F> &uv, const CurvedKind<F> &kind) {
    F sin_phi, cos_phi, sin_theta, cos_theta;
    sincos(select(kind.sphere || kind.cylinder, uv.x, uv.y) * F(2 * Pi), sin_phi, cos_phi);
    sincos(uv.y * F(Pi), sin_theta, cos_theta);
    F radius = select(kind.sphere, sin_theta, select(kind.cylinder, F(1), uv.x));
    F z = select(kind.sphere, cos_theta, select(kind.cylinder, uv.y, F(0)));
    return {radius * cos_phi, radius * sin_phi, z};
}

// What the queries report, made into a point with frames. They work in single precision: with Float = double the
// distance and the coordinates are computed again from the shape and triangle they name.
template <class F>
TR_LARGE Interaction<F> make_interaction(const SceneOf<F> &scene, const Ray<F> &ray, SurfacePoint<F> at, F t,
                                         const MaskOf<F> &active);

// The position of a point on a surface, from what is stored of it.
template <class F>
TR_LARGE Vec3<F> surface_position(const SceneOf<F> &scene, const SurfacePoint<F> &at, const MaskOf<F> &active);

// Rays leave a surface from a point moved off it, by an amount relative to the coordinates: 1500 / 2 units in the last
// place of single precision, which is what Embree's tests need (the same amount as Mitsuba's, so that images agree).
template <class F>
TR_INLINE F offset_amount(const Vec3<F> &p) {
    return (F(1) + max_abs(p)) * F(8.9406967e-5);
}
template <class F>
TR_INLINE Vec3<F> offset_origin(const Vec3<F> &p, const Vec3<F> &ng, const Vec3<F> &d) {
    return p + ng * mulsign(offset_amount(p), dot(ng, d));
}
// ... of a ray that goes straight on through the surface: it stays on its line.
template <class F>
TR_INLINE F offset_along(const Vec3<F> &p, const Vec3<F> &ng, const Vec3<F> &d) {
    return offset_amount(p) / max(abs(dot(ng, d)), F(0.0625));
}
// A ray that goes on behind what it has met at the distance t.
template <class S>
TR_INLINE void pass_behind(Vec3<S> &o, const Vec3<S> &d, const S &t, S &length) {
    const Vec3<S> p{o.x + d.x * t, o.y + d.y * t, o.z + d.z * t};
    const S behind = offset_amount(p);
    o = {p.x + d.x * behind, p.y + d.y * behind, p.z + d.z * behind};
    length -= t + behind;
}
constexpr double ShadowEpsilon = 8.9406967e-4;  // shadow rays stop this fraction short of the light

template <class F>
struct SampledPoint {
    SurfacePoint<F> at;
    Vec3<F> p, n;
    F pdf;  // by area
};

// A point on a shape, uniform by area. `u` choose the face (u0) and the point. `unfold`: where a mesh has two faces of
// one size, (u1, u2) choose the face, too: a rectangle is filled as evenly as they fill the unit square.
template <class F>
TR_LARGE SampledPoint<F> sample_shape(const SceneOf<F> &scene, const UIntOf<F> &shape, const F &u0, const F &u1,
                                      const F &u2, const MaskOf<F> &active, const MaskOf<F> &unfold);

}  // namespace tr
