// The derivative of a hit: position, shading normal and coordinates of a point on a surface, as functions of the
// surface and, where the point is the intersection with a ray that moves (`attached`), of the ray.
//
// An attached hit slides over the surface: with q the motion of the material point under the hit minus that of the
// ray's point, it moves along d by t' = n.q / n.d, and over the surface by t' d - q. Other points are glued to the
// surface: they keep their coordinates, and the measure in which they are integrated is area, which stretches.
#pragma once

#include "heightfield.h"
#include "partials.h"

namespace tr {

template <class F, class S, class Sink>
TR_INLINE Vec3<F> sweep_triangle(const SceneView<S> &scene, const SurfacePoint<F> &at, const Arrival<F> &in,
                                 HitAdjoint<F> g, const ShapeLanes<F> &shape, const MaskOf<F> &mesh, Vec3<F> &d_bar,
                                 Sink &sink) {
    using U = UIntOf<F>;
    using Tables = decltype(sink.geometry);
    Vec3<F> zero{F(0), F(0), F(0)};
    auto smooth = mesh && shape.has(HasNormals), has = mesh && shape.has(HasTexcoords);
    Corners<F> corners;
    Triangle<F, S> tri(scene, U(shape.face_offset) + at.primitive, mesh, smooth || has, corners);
    F b1 = at.b1, b2 = at.b2, b0 = F(1) - b1 - b2;
    Vec3<F> area = cross(tri.e1, tri.e2);
    F area_squared = squared_norm(area), cosine = dot(area, select(in.attached, in.d, in.D));
    auto usable = mesh && mask<F>(area_squared > F(0)) && mask<F>(abs(cosine) > F(0));
    if (!any(usable)) return zero;
    cosine = select(usable, cosine, F(1));
    F inverse_area = F(1) / sqrt(select(usable, area_squared, F(1)));
    auto glued = usable && !in.attached;
    auto wanted = usable && mask<F>(gather<IntOf<F>>(sink.geometry.wanted, at.shape, mask<IntOf<F>>(usable)) != 0);

    // normal: of the vertices or of the face
    Vec3<F> area_bar = select(glued, in.D * (in.log_jacobian_bar / cosine), zero);
    smooth = smooth && usable;
    has = has && usable;
    if (any(smooth)) {
        const Vec3<F> &n0 = corners.n[0], &n1 = corners.n[1], &n2 = corners.n[2];
        Vec3<F> m = n0 * b0 + n1 * b1 + n2 * b2;
        F length_squared = squared_norm(m);
        smooth = smooth && mask<F>(length_squared > F(0));
        F inverse = F(1) / sqrt(select(smooth, length_squared, F(1)));
        Vec3<F> m_bar = unnormalize(m * inverse, g.n, inverse);
        g.at.b.x = select(smooth, g.at.b.x + dot(m_bar, n1 - n0), g.at.b.x);
        g.at.b.y = select(smooth, g.at.b.y + dot(m_bar, n2 - n0), g.at.b.y);
        auto to_normals = smooth && wanted;
        if (any(to_normals)) {
            sweep_vertex(&Tables::normals, tri.corner[0], m_bar * b0, to_normals, sink);
            sweep_vertex(&Tables::normals, tri.corner[1], m_bar * b1, to_normals, sink);
            sweep_vertex(&Tables::normals, tri.corner[2], m_bar * b2, to_normals, sink);
        }
    }
    g.ng = select(smooth, g.ng, g.ng + g.n);
    area_bar = area_bar + unnormalize(area * inverse_area, g.ng, inverse_area);

    // texture coordinates
    if (any(has)) {
        const Vec2<F>(&uv)[3] = corners.uv;
        F by_b1 = g.at.uv.x * (uv[1].x - uv[0].x) + g.at.uv.y * (uv[1].y - uv[0].y);
        F by_b2 = g.at.uv.x * (uv[2].x - uv[0].x) + g.at.uv.y * (uv[2].y - uv[0].y);
        g.at.b.x = select(has, g.at.b.x + by_b1, g.at.b.x);
        g.at.b.y = select(has, g.at.b.y + by_b2, g.at.b.y);
        auto to_texcoords = has && wanted;
        if (any(to_texcoords)) {
            const F weight[3] = {b0, b1, b2};
            for (int k = 0; k < 3; ++k) {
                U index = tri.corner[k] * 2u;
                sink.vertex(&Tables::texcoords, index, g.at.uv.x * weight[k], to_texcoords);
                sink.vertex(&Tables::texcoords, index + 1u, g.at.uv.y * weight[k], to_texcoords);
            }
        }
    }
    auto bare = usable && !has;
    g.at.b.x = select(bare, g.at.b.x + g.at.uv.x, g.at.b.x);
    g.at.b.y = select(bare, g.at.b.y + g.at.uv.y, g.at.b.y);

    // attached: barycentric coordinates are dot products with the dual basis of the edges
    F inverse_squared = inverse_area * inverse_area;
    Vec3<F> over =
        cross(tri.e2, area) * (g.at.b.x * inverse_squared) + cross(area, tri.e1) * (g.at.b.y * inverse_squared);
    Vec3<F> q = area * ((dot(g.p, in.d) + dot(over, in.d)) / cosine) - over;
    Vec3<F> moved = g.p - q, from_segment = zero;
    if (any(glued)) from_segment = sweep_segment(in, area, cosine);
    q = select(glued, g.p + from_segment, q);
    if (any(wanted)) {
        Vec3<F> e1_bar = cross(tri.e2, area_bar), e2_bar = cross(area_bar, tri.e1);
        sweep_vertex(&Tables::positions, tri.corner[0], q * b0 - e1_bar - e2_bar, wanted, sink);
        sweep_vertex(&Tables::positions, tri.corner[1], q * b1 + e1_bar, wanted, sink);
        sweep_vertex(&Tables::positions, tri.corner[2], q * b2 + e2_bar, wanted, sink);
    }
    auto attached = usable && in.attached;
    d_bar = select(attached, in.d_bar + moved * in.t, zero);
    auto parallel = glued && in.parallel;
    if (any(parallel)) d_bar = select(parallel, sweep_parallel(in, area, cosine), d_bar);
    return select(glued, -from_segment, select(attached, moved, zero));
}

// Spheres, disks and cylinders: p = M local with |local| = 1, local.z = 0 or |local.xy| = 1. The normal is M^-T times
// that of the unit shape.
template <class F, class S, class Sink>
TR_INLINE Vec3<F> sweep_curved(const SceneView<S> &scene, const SurfacePoint<F> &at, const Vec3<F> &p,
                               const Arrival<F> &in, const HitAdjoint<F> &g, const MaskOf<F> &curved,
                               const CurvedKind<F> &kind, Vec3<F> &d_bar, Sink &sink) {
    Vec3<F> zero{F(0), F(0), F(0)};
    F to_object[12];
    gather_matrix<F>(scene.shape_matrices, at.shape * 24u + 12u, curved, to_object);
    Vec3<F> local = kind.project(transform_point(to_object, p));
    Vec3<F> up = transform_normal(to_object, kind.normal(local));
    F inverse = F(1) / select(curved, norm(up), F(1));
    Vec3<F> n = up * inverse;
    F cosine = dot(n, select(in.attached, in.d, in.D));
    auto usable = curved && mask<F>(abs(cosine) > F(0));
    cosine = select(usable, cosine, F(1));
    auto glued = usable && !in.attached;

    Vec3<F> up_bar = unnormalize(n, g.n, inverse);
    // attached: the point and with it the normal of a sphere or cylinder slide
    auto round = kind.sphere || kind.cylinder;
    Vec3<F> local_bar = select(round, transform_vector(to_object, up_bar), zero);
    local_bar.z = select(kind.cylinder, F(0), local_bar.z);
    // the coordinates are (azimuth, polar angle), (radius, azimuth) or (azimuth, height), see curved_coordinates
    F u = g.at.uv.x + g.at.b.x, v = g.at.uv.y + g.at.b.y;
    F around = local.x * local.x + local.y * local.y;
    auto apart = usable && mask<F>(around > F(1e-12));
    F inverse_around = F(1) / select(apart, around, F(1)), inverse_radius = sqrt(inverse_around);
    F azimuth = select(round, u, v) * F(1 / (2 * Pi)) * inverse_around;
    F radial = select(round, F(0), u) * inverse_radius;
    Vec3<F> by_coordinates{radial * local.x - azimuth * local.y, radial * local.y + azimuth * local.x,
                           select(kind.sphere, v * F(-1 / Pi) * inverse_radius, select(kind.cylinder, v, F(0)))};
    local_bar = select(apart, local_bar + by_coordinates, local_bar);
    Vec3<F> over = transform_normal(to_object, local_bar);
    Vec3<F> q = n * ((dot(g.p, in.d) + dot(over, in.d)) / cosine) - over;
    Vec3<F> moved = g.p - q, from_segment = zero;
    if (any(glued)) {
        from_segment = sweep_segment(in, n, cosine);
        up_bar = select(glued, up_bar + in.D * (in.log_jacobian_bar * inverse / cosine), up_bar);
        q = select(glued, g.p + from_segment, q);
    }
    auto wanted = usable && mask<F>(gather<IntOf<F>>(sink.geometry.wanted, at.shape, mask<IntOf<F>>(usable)) != 0);
    if (any(wanted)) {
        Vec3<F> a = transform_vector(to_object, up_bar);
        const F row[3] = {q.x, q.y, q.z}, column[3] = {local.x, local.y, local.z}, ups[3] = {up.x, up.y, up.z},
                as[3] = {a.x, a.y, a.z};
        F determinant = select(glued, in.log_jacobian_bar, F(0));  // d log det(M) = tr(M^-1 dM)
        F matrix[12];
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j)
                matrix[4 * i + j] = row[i] * column[j] - ups[i] * as[j] + determinant * to_object[4 * j + i];
            matrix[4 * i + 3] = row[i];
        }
        sweep_matrix<F>(at.shape, matrix, wanted, sink);
    }
    auto attached = usable && in.attached;
    d_bar = select(attached, in.d_bar + moved * in.t, zero);
    auto parallel = glued && in.parallel;
    if (any(parallel)) d_bar = select(parallel, sweep_parallel(in, n, cosine), d_bar);
    return select(glued, -from_segment, select(attached, moved, zero));
}

// Hands the adjoint of the point p to the surface; returns that of where the ray came from: of its origin and, where
// attached or parallel, of its direction.
template <class F, class S, class Sink>
TR_NOINLINE RayAdjoint<F> sweep_surface(const SceneView<S> &scene, const SurfacePoint<F> &at, const Vec3<F> &p,
                                        const Arrival<F> &in, HitAdjoint<F> g, const MaskOf<F> &active, Sink &sink) {
    ShapeLanes<F> shape(scene.shapes, at.shape, active);
    g.n = select(shape.has(FlipNormals), -g.n, g.n);
    g.ng = select(shape.has(FlipNormals), -g.ng, g.ng);
    if (scene.has_tangents()) sweep_partials(scene, at, shape, g.tangent, g.tangent_v, active, g.at, sink);
    g.p = g.p + g.at.p;
    auto mesh = active && !shape.has(IsCurved);
    auto field = active && shape.has(IsHeightField), curved = active && !mesh && !field;
    Vec3<F> zero{F(0), F(0), F(0)};
    RayAdjoint<F> r{zero, zero}, other = r;
    if (any(mesh)) r.o = sweep_triangle(scene, at, in, g, shape, mesh, r.d, sink);
    if (any(field)) {
        other.o = sweep_height_fields(scene, at, in, g, field, other.d, sink);
        r = {select(field, other.o, r.o), select(field, other.d, r.d)};
    }
    if (any(curved)) {
        other.o = sweep_curved(scene, at, p, in, g, curved, CurvedKind<F>(shape, curved), other.d, sink);
        r = {select(curved, other.o, r.o), select(curved, other.d, r.d)};
    }
    return r;
}

// The same where only the position of a glued point counts.
template <class F, class S, class Sink>
TR_NOINLINE void sweep_position(const SceneView<S> &scene, const SurfacePoint<F> &at, const Vec3<F> &p,
                                const Vec3<F> &p_bar, const MaskOf<F> &active, Sink &sink) {
    using Tables = decltype(sink.geometry);
    auto wanted = active && mask<F>(gather<IntOf<F>>(sink.geometry.wanted, at.shape, mask<IntOf<F>>(active)) != 0);
    if (!any(wanted)) return;
    ShapeLanes<F> shape(scene.shapes, at.shape, wanted);
    auto mesh = wanted && !shape.has(IsCurved);
    if (any(mesh)) {
        UIntOf<F> corner[3];
        gather_rows<F>(scene.faces, (UIntOf<F>(shape.face_offset) + at.primitive) * 3u, mesh, corner);
        const F weight[3] = {F(1) - at.b1 - at.b2, at.b1, at.b2};
        for (int k = 0; k < 3; ++k) sweep_vertex(&Tables::positions, corner[k], p_bar * weight[k], mesh, sink);
    }
    auto field = wanted && shape.has(IsHeightField), curved = wanted && !mesh && !field;
    if (any(field)) sweep_height_positions(scene, at, p_bar, field, sink);
    if (any(curved)) {
        F to_object[12];
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u + 12u, curved, to_object);
        Vec3<F> local = transform_point(to_object, p);
        const F row[3] = {p_bar.x, p_bar.y, p_bar.z}, column[4] = {local.x, local.y, local.z, F(1)};
        F matrix[12];
        for (int i = 0; i < 12; ++i) matrix[i] = row[i / 4] * column[i % 4];
        sweep_matrix<F>(at.shape, matrix, curved, sink);
    }
}

}  // namespace tr
