// How a surface point moves with its texture coordinates, and the derivative of that: what normal maps are oriented by.
#pragma once

#include "surface.h"

namespace tr {

// dp/du of the unit sphere (azimuth, polar angle) or disk (radius, azimuth), see curved_coordinates.
template <class T, class M>
TR_INLINE Vec3<T> curved_tangent(const Vec3<T> &local, const M &sphere) {
    T squared = local.x * local.x + local.y * local.y;
    auto apart = mask<std::decay_t<decltype(value_of(squared))>>(value_of(squared) > value_of(T(1e-14)));
    T inverse = T(1) / sqrt(select(apart, squared, T(1)));
    return {select(sphere, local.y * T(-2 * Pi), local.x * inverse),
            select(sphere, local.x * T(2 * Pi), local.y * inverse), T(0)};
}

// dp/du: of a mesh without texture coordinates along its first edge.
template <class F, class S>
TR_NOINLINE Vec3<F> surface_tangent(const SceneView<S> &scene, const SurfacePoint<F> &at, const Vec3<F> &p,
                                    const MaskOf<F> &active) {
    ShapeLanes<F> shape(scene.shapes, at.shape, active);
    auto mesh = active && !shape.has(IsCurved);
    Vec3<F> r{F(1), F(0), F(0)};
    if (any(mesh)) {
        auto has = mesh && shape.has(HasTexcoords);
        Corners<F> corners;
        Triangle<F, S> tri(scene, UIntOf<F>(shape.face_offset) + at.primitive, mesh, has, corners);
        r = select(mesh, tri.e1, r);
        if (any(has)) {
            F v1 = corners.uv[1].y - corners.uv[0].y, v2 = corners.uv[2].y - corners.uv[0].y;
            F determinant = (corners.uv[1].x - corners.uv[0].x) * v2 - (corners.uv[2].x - corners.uv[0].x) * v1;
            has = has && mask<F>(determinant != F(0));
            F inverse = F(1) / select(has, determinant, F(1));
            r = select(has, (tri.e1 * v2 - tri.e2 * v1) * inverse, r);
        }
    }
    auto curved = active && !mesh;
    if (any(curved)) {
        F to_world[12], to_object[12];
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u, curved, to_world);
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u + 12u, curved, to_object);
        Vec3<F> local = curved_tangent(transform_point(to_object, p), shape.has(IsSphere));
        r = select(curved, transform_vector(to_world, local), r);
    }
    return r;
}

}  // namespace tr
