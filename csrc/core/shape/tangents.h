// How a surface point moves with its texture coordinates, and the derivative of that: what turned normals are oriented
// by.
#pragma once

#include "surface.h"

namespace tr {

// dp/du and dp/dv.
template <class T>
struct Tangents {
    Vec3<T> u, v;
};

// Those of the unit sphere (azimuth, polar angle) or disk (radius, azimuth), see curved_coordinates.
template <class T, class M>
TR_INLINE Tangents<T> curved_tangents(const Vec3<T> &local, const M &sphere) {
    T squared = local.x * local.x + local.y * local.y;
    auto apart = mask<std::decay_t<decltype(value_of(squared))>>(value_of(squared) > value_of(T(1e-14)));
    T radius = sqrt(select(apart, squared, T(1))), inverse = T(1) / radius;
    Vec3<T> around{local.y * T(-2 * Pi), local.x * T(2 * Pi), T(0)};
    Vec3<T> out{local.x * inverse, local.y * inverse, T(0)};
    Vec3<T> down{out.x * local.z * T(Pi), out.y * local.z * T(Pi), radius * T(-Pi)};
    auto choose = [&](const Vec3<T> &a, const Vec3<T> &b) {
        return Vec3<T>{select(sphere, a.x, b.x), select(sphere, a.y, b.y), select(sphere, a.z, b.z)};
    };
    return {choose(around, out), choose(down, around)};
}

// Those of a triangle with texture coordinates; without them along its edges.
template <class F>
struct TriangleTangents : Tangents<F> {
    F u1, u2, v1, v2, inverse;  // the edges' coordinates, and one over their determinant
    MaskOf<F> mapped;

    TR_INLINE TriangleTangents(const Vec3<F> &e1, const Vec3<F> &e2, const Corners<F> &corners, const MaskOf<F> &has) {
        u1 = corners.uv[1].x - corners.uv[0].x, u2 = corners.uv[2].x - corners.uv[0].x;
        v1 = corners.uv[1].y - corners.uv[0].y, v2 = corners.uv[2].y - corners.uv[0].y;
        F determinant = u1 * v2 - u2 * v1;
        mapped = has && mask<F>(determinant != F(0));
        inverse = F(1) / select(mapped, determinant, F(1));
        this->u = select(mapped, (e1 * v2 - e2 * v1) * inverse, e1);
        this->v = select(mapped, (e2 * u1 - e1 * u2) * inverse, e2);
    }
};

template <class F, class S>
TR_NOINLINE Tangents<F> surface_tangents(const SceneView<S> &scene, const SurfacePoint<F> &at, const Vec3<F> &p,
                                         const MaskOf<F> &active) {
    ShapeLanes<F> shape(scene.shapes, at.shape, active);
    auto mesh = active && !shape.has(IsCurved);
    Tangents<F> r{{F(1), F(0), F(0)}, {F(0), F(1), F(0)}};
    if (any(mesh)) {
        auto has = mesh && shape.has(HasTexcoords);
        Corners<F> corners{};
        Triangle<F, S> tri(scene, UIntOf<F>(shape.face_offset) + at.primitive, mesh, has, corners);
        TriangleTangents<F> t(tri.e1, tri.e2, corners, has);
        r = {select(mesh, t.u, r.u), select(mesh, t.v, r.v)};
    }
    auto curved = active && !mesh;
    if (any(curved)) {
        F to_world[12], to_object[12];
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u, curved, to_world);
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u + 12u, curved, to_object);
        Tangents<F> local = curved_tangents(transform_point(to_object, p), shape.has(IsSphere));
        r.u = select(curved, transform_vector(to_world, local.u), r.u);
        r.v = select(curved, transform_vector(to_world, local.v), r.v);
    }
    return r;
}

// dp/du alone.
template <class F, class S>
TR_INLINE Vec3<F> surface_tangent(const SceneView<S> &scene, const SurfacePoint<F> &at, const Vec3<F> &p,
                                  const MaskOf<F> &active) {
    return surface_tangents(scene, at, p, active).u;
}

}  // namespace tr
