// Surfaces: from what was hit to positions, normals and texture coordinates, and points sampled on emitting shapes.
#pragma once

#include "../math/warp.h"
#include "../scene.h"

namespace tr {

// A point on a surface, as short as it can be stored. On a triangle (b1, b2) are barycentric, on spheres and disks
// they are the texture coordinates.
template <class F>
struct SurfacePoint {
    UIntOf<F> shape, primitive;
    F b1, b2;
};

template <class F>
struct Ray {
    Vec3<F> o, d;
};

template <class F>
struct Interaction {
    SurfacePoint<F> at;
    Vec3<F> p, ng;   // position, unit geometric normal
    Frame<F> frame;  // of the shading normal
    F t;
};

template <class F, class S>
TR_INLINE Vec3<F> gather_vec3(const S *base, const UIntOf<F> &index, const MaskOf<F> &active) {
    UIntOf<F> i = index * 3u;
    return {gather<F>(base, i, active), gather<F>(base, i + 1u, active), gather<F>(base, i + 2u, active)};
}

template <class F, class S>
struct Triangle {
    UIntOf<F> i0, i1, i2;
    Vec3<F> p0, e1, e2;

    TR_INLINE Triangle(const SceneView<S> &scene, const UIntOf<F> &face, const MaskOf<F> &active) {
        UIntOf<F> f = face * 3u;
        i0 = gather<UIntOf<F>>(scene.faces, f, mask<UIntOf<F>>(active));
        i1 = gather<UIntOf<F>>(scene.faces, f + 1u, mask<UIntOf<F>>(active));
        i2 = gather<UIntOf<F>>(scene.faces, f + 2u, mask<UIntOf<F>>(active));
        p0 = gather_vec3<F>(scene.positions, i0, active);
        e1 = gather_vec3<F>(scene.positions, i1, active) - p0;
        e2 = gather_vec3<F>(scene.positions, i2, active) - p0;
    }
};

template <class F, class S>
TR_INLINE UIntOf<F> global_face(const SceneView<S> &scene, const UIntOf<F> &shape, const UIntOf<F> &primitive,
                                const MaskOf<F> &active) {
    return UIntOf<F>(shape_info<F>(scene.shapes, &ShapeInfo::face_offset, shape, active)) + primitive;
}

template <class F, class S>
TR_INLINE Vec2<F> texture_coordinates(const SceneView<S> &scene, const SurfacePoint<F> &at, const MaskOf<F> &active) {
    using U = UIntOf<F>;
    IntOf<F> kind = shape_info<F>(scene.shapes, &ShapeInfo::kind, at.shape, active);
    IntOf<F> flags = shape_info<F>(scene.shapes, &ShapeInfo::flags, at.shape, active);
    auto mesh = active && mask<F>(kind == int32_t(ShapeKind::Mesh));
    auto has = mesh && mask<F>((flags & int32_t(HasTexcoords)) != 0);
    Vec2<F> uv{at.b1, at.b2};
    if (any(has)) {
        U face = global_face<F>(scene, at.shape, at.primitive, has) * 3u;
        F b[3] = {F(1) - at.b1 - at.b2, at.b1, at.b2}, u(0), v(0);
        for (uint32_t k = 0; k < 3; ++k) {
            U i = gather<U>(scene.faces, face + k, mask<U>(has)) * 2u;
            u = fmadd(b[k], gather<F>(scene.texcoords, i, has), u);
            v = fmadd(b[k], gather<F>(scene.texcoords, i + 1u, has), v);
        }
        uv.x = select(has, u, uv.x);
        uv.y = select(has, v, uv.y);
    }
    return uv;
}

// Texture coordinates of a point of the unit sphere (azimuth, polar angle) or the unit disk (radius, azimuth).
template <class F>
TR_INLINE Vec2<F> curved_coordinates(const Vec3<F> &local, const MaskOf<F> &sphere) {
    F phi = atan2(local.y, local.x) * F(1 / (2 * Pi));
    phi = select(mask<F>(phi < F(0)), phi + F(1), phi);
    F polar = acos(max(F(-1), min(F(1), local.z))) * F(1 / Pi);
    F radius = sqrt(local.x * local.x + local.y * local.y);
    return {select(sphere, phi, radius), select(sphere, polar, phi)};
}

// The distance to the unit sphere or disk that is near t, which is known to single precision.
template <class F, class S>
TR_INLINE F refine_distance(const S *to_object, const Ray<F> &ray, const F &t, const MaskOf<F> &sphere) {
    Vec3<F> o = transform_point(to_object, ray.o), d = transform_vector(to_object, ray.d);
    F a = dot(d, d), middle = -dot(o, d) / a;
    F half = sqrt(max(F(1) - squared_norm(o + d * middle), F(0)) / a);
    F plane = -o.z / select(mask<F>(d.z == F(0)), F(1), d.z);
    return select(sphere, middle + select(mask<F>(t < middle), -half, half), plane);
}

// What Embree reports, made into a point with frames. Embree works in single precision: with Float = double the
// distance and the barycentric coordinates are computed again from the shape and triangle it names.
template <class F, class S>
TR_INLINE Interaction<F> make_interaction(const SceneView<S> &scene, const Ray<F> &ray, SurfacePoint<F> at, F t,
                                          const MaskOf<F> &active) {
    Interaction<F> si;
    IntOf<F> kind = shape_info<F>(scene.shapes, &ShapeInfo::kind, at.shape, active);
    IntOf<F> flags = shape_info<F>(scene.shapes, &ShapeInfo::flags, at.shape, active);
    auto mesh = active && mask<F>(kind == int32_t(ShapeKind::Mesh));
    Vec3<F> ns{F(0), F(0), F(1)};
    si.ng = ns;
    si.p = ray.o;
    if (any(mesh)) {
        Triangle<F, S> tri(scene, global_face<F>(scene, at.shape, at.primitive, mesh), mesh);
        Vec3<F> n = cross(tri.e1, tri.e2);
        if constexpr (sizeof(S) == 8) {  // Moeller and Trumbore 1997, for a triangle that is known to be hit
            Vec3<F> q = cross(ray.d, tri.e2), s = ray.o - tri.p0, r = cross(s, tri.e1);
            F inverse = F(1) / dot(tri.e1, q);
            at.b1 = select(mesh, dot(s, q) * inverse, at.b1);
            at.b2 = select(mesh, dot(ray.d, r) * inverse, at.b2);
            t = select(mesh, dot(tri.e2, r) * inverse, t);
        }
        si.p = tri.p0 + tri.e1 * at.b1 + tri.e2 * at.b2;
        n = normalize(n);
        si.ng = n;
        ns = n;
        auto smooth = mesh && mask<F>((flags & int32_t(HasNormals)) != 0);
        if (any(smooth)) {
            Vec3<F> interpolated = gather_vec3<F>(scene.normals, tri.i0, smooth) * (F(1) - at.b1 - at.b2) +
                                   gather_vec3<F>(scene.normals, tri.i1, smooth) * at.b1 +
                                   gather_vec3<F>(scene.normals, tri.i2, smooth) * at.b2;
            F length_squared = squared_norm(interpolated);
            auto usable = smooth && mask<F>(length_squared > F(0));
            interpolated = interpolated * (F(1) / sqrt(select(usable, length_squared, F(1))));
            ns = select(usable, interpolated, ns);
        }
    }
    auto curved = active && !mesh;
    if (any(curved)) {
        F to_world[12], to_object[12];
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u, curved, to_world);
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u + 12u, curved, to_object);
        auto sphere = curved && mask<F>(kind == int32_t(ShapeKind::Sphere));
        if constexpr (sizeof(S) == 8) t = select(curved, refine_distance(to_object, ray, t, sphere), t);
        Vec3<F> local = transform_point(to_object, ray.o + ray.d * t);
        // a point in single precision is off the surface: put it back, so that spawned rays start right
        local = select(sphere, normalize(local), Vec3<F>{local.x, local.y, F(0)});
        Vec2<F> uv = curved_coordinates(local, sphere);
        at.b1 = select(curved, uv.x, at.b1);
        at.b2 = select(curved, uv.y, at.b2);
        Vec3<F> n = normalize(transform_normal(to_object, select(sphere, local, Vec3<F>{F(0), F(0), F(1)})));
        si.p = select(curved, transform_point(to_world, local), si.p);
        si.ng = select(curved, n, si.ng);
        ns = select(curved, n, ns);
    }
    auto flip = mask<F>((flags & int32_t(FlipNormals)) != 0);
    si.ng = select(flip, -si.ng, si.ng);
    ns = select(flip, -ns, ns);
    si.frame = make_frame(ns);
    si.at = at;
    si.t = t;
    return si;
}

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
constexpr double ShadowEpsilon = 8.9406967e-4;  // shadow rays stop this fraction short of the light

// A point on a shape, uniform by area. `u` choose the face (u0) and the point.
template <class F>
struct SampledPoint {
    SurfacePoint<F> at;
    Vec3<F> p, n;
    F pdf;  // by area
};

template <class F, class S>
TR_INLINE SampledPoint<F> sample_shape(const SceneView<S> &scene, const UIntOf<F> &shape, const F &u0, const F &u1,
                                       const F &u2, const MaskOf<F> &active) {
    using U = UIntOf<F>;
    SampledPoint<F> r;
    IntOf<F> kind = shape_info<F>(scene.shapes, &ShapeInfo::kind, shape, active);
    IntOf<F> flags = shape_info<F>(scene.shapes, &ShapeInfo::flags, shape, active);
    r.at.shape = shape;
    r.at.primitive = U(0u);
    r.pdf = F(1) / gather<F>(scene.shape_areas, shape, active);
    r.p = {F(0), F(0), F(0)};
    r.n = {F(0), F(0), F(1)};
    r.at.b1 = r.at.b2 = F(0);
    auto mesh = active && mask<F>(kind == int32_t(ShapeKind::Mesh));
    if (any(mesh)) {
        U n = U(shape_info<F>(scene.shapes, &ShapeInfo::n_faces, shape, mesh));
        U offset = U(shape_info<F>(scene.shapes, &ShapeInfo::cdf_offset, shape, mesh));
        r.at.primitive = search_cdf<F>(scene.area_cdf, offset, select(mask<U>(mesh), n, U(1u)), u0, mesh);
        Triangle<F, S> tri(scene, global_face<F>(scene, shape, r.at.primitive, mesh), mesh);
        Vec2<F> b = square_to_triangle(u1, u2);
        r.at.b1 = b.x;
        r.at.b2 = b.y;
        r.p = tri.p0 + tri.e1 * b.x + tri.e2 * b.y;
        r.n = normalize(cross(tri.e1, tri.e2));
    }
    auto curved = active && !mesh;
    if (any(curved)) {
        F to_world[12], to_object[12];
        gather_matrix<F>(scene.shape_matrices, shape * 24u, curved, to_world);
        gather_matrix<F>(scene.shape_matrices, shape * 24u + 12u, curved, to_object);
        auto sphere = curved && mask<F>(kind == int32_t(ShapeKind::Sphere));
        Vec3<F> on_sphere = square_to_sphere(u1, u2);
        Vec2<F> disk = square_to_disk(u1, u2);
        Vec3<F> local = select(sphere, on_sphere, Vec3<F>{disk.x, disk.y, F(0)});
        Vec2<F> uv = curved_coordinates(local, sphere);
        r.at.b1 = select(curved, uv.x, r.at.b1);
        r.at.b2 = select(curved, uv.y, r.at.b2);
        Vec3<F> n = normalize(transform_normal(to_object, select(sphere, local, Vec3<F>{F(0), F(0), F(1)})));
        r.p = select(curved, transform_point(to_world, local), r.p);
        r.n = select(curved, n, r.n);
    }
    auto flip = mask<F>((flags & int32_t(FlipNormals)) != 0);
    r.n = select(flip, -r.n, r.n);
    return r;
}

}  // namespace tr
