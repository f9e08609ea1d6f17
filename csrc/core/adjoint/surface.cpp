#include "surface.h"

#include "../shape/partials.h"
#include "curve.h"
#include "heightfield.h"
#include "sdfgrid.h"

namespace tr {

template <class F>
TR_LARGE void sweep_partials(const SceneOf<F> &scene, const SurfacePoint<F> &at, const ShapeLanes<F> &shape,
                             const Vec3<F> &gu, const Vec3<F> &gv, const MaskOf<F> &active, CoordinateAdjoint<F> &to,
                             GradientSink<F> &sink) {
    using S = ScalarOf<F>;
    auto wanted = sink.wants_shape(at.shape, active);
    auto mesh = active && !shape.has(IsCurved), field = active && shape.has(IsHeightField);
    auto curve = active && shape.has(IsCurve);
    auto curved = active && !mesh && !field && !curve && !shape.has(IsSdfGrid);
    if (any(curve)) {
        F segments = curve_segments<F>(scene, at.shape, curve);
        CurveAdjoint<F> bar(scene, at, shape, curve);
        bar.add(gv * segments, gu);
        to.b.x = select(curve, to.b.x + bar.b1, to.b.x);
        to.b.y = select(curve, to.b.y + bar.b2, to.b.y);
        bar.spread(Vec3<F>{F(0), F(0), F(0)}, curve && wanted, sink);
    }
    if (any(mesh && wanted)) {
        TriangleMap<F, S> map(scene, shape, at.primitive, mesh);
        auto lanes = mesh && wanted, mapped = lanes && map.mapped;
        const auto &corner = map.tri.corner;
        // with P = (dp/du, dp/dv), E = (e1, e2) and D = (d0, d1): P D = E
        Vec3<F> e1_bar = (gu * map.d1.y - gv * map.d1.x) * map.inverse,
                e2_bar = (gv * map.d0.x - gu * map.d0.y) * map.inverse;
        sweep_mesh_vertex(VertexArray::Positions, corner[0], -(e1_bar + e2_bar), lanes, sink);
        sweep_mesh_vertex(VertexArray::Positions, corner[1], e1_bar, lanes, sink);
        sweep_mesh_vertex(VertexArray::Positions, corner[2], e2_bar, lanes, sink);
        if (any(mapped)) {
            PositionPartials<F> p = map.partials();
            const Vec2<F> d_bar[2] = {{-dot(p.u, e1_bar), -dot(p.v, e1_bar)}, {-dot(p.u, e2_bar), -dot(p.v, e2_bar)}};
            auto put = [&](int k, const F &u, const F &v) {
                sink.vertex(VertexArray::Texcoords, corner[k] * 2u, u, mapped);
                sink.vertex(VertexArray::Texcoords, corner[k] * 2u + 1u, v, mapped);
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
        sweep_matrix<F>(at.shape, matrix, lanes, sink);
    };
    if (any(field))
        each_shape<HeightView, F>(
            scene, at.shape, field, [&](uint32_t one, const HeightView<S> &heights, const MaskOf<F> &lanes) {
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

template <class F, class S>
TR_INLINE Vec3<F> sweep_triangle(const SceneView<S> &scene, const SurfacePoint<F> &at, const Arrival<F> &in,
                                 HitAdjoint<F> g, const ShapeLanes<F> &shape, const MaskOf<F> &mesh, Vec3<F> &d_bar,
                                 GradientSink<F> &sink) {
    using U = UIntOf<F>;
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
    auto wanted = sink.wants_shape(at.shape, usable);

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
            sweep_mesh_vertex(VertexArray::Normals, tri.corner[0], m_bar * b0, to_normals, sink);
            sweep_mesh_vertex(VertexArray::Normals, tri.corner[1], m_bar * b1, to_normals, sink);
            sweep_mesh_vertex(VertexArray::Normals, tri.corner[2], m_bar * b2, to_normals, sink);
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
                sink.vertex(VertexArray::Texcoords, index, g.at.uv.x * weight[k], to_texcoords);
                sink.vertex(VertexArray::Texcoords, index + 1u, g.at.uv.y * weight[k], to_texcoords);
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
    if (any(glued)) from_segment = sweep_displacement(in, area, cosine);
    q = select(glued, g.p + from_segment, q);
    if (any(wanted)) {
        Vec3<F> e1_bar = cross(tri.e2, area_bar), e2_bar = cross(area_bar, tri.e1);
        sweep_mesh_vertex(VertexArray::Positions, tri.corner[0], q * b0 - e1_bar - e2_bar, wanted, sink);
        sweep_mesh_vertex(VertexArray::Positions, tri.corner[1], q * b1 + e1_bar, wanted, sink);
        sweep_mesh_vertex(VertexArray::Positions, tri.corner[2], q * b2 + e2_bar, wanted, sink);
    }
    auto attached = usable && in.attached;
    d_bar = select(attached, in.d_bar + moved * in.t, zero);
    auto parallel = glued && in.parallel;
    if (any(parallel)) d_bar = select(parallel, sweep_parallel(in, area, cosine), d_bar);
    return select(glued, -from_segment, select(attached, moved, zero));
}

// Spheres, disks and cylinders: p = M local with |local| = 1, local.z = 0 or |local.xy| = 1. The normal is M^-T times
// that of the unit shape.
template <class F, class S>
TR_INLINE Vec3<F> sweep_curved(const SceneView<S> &scene, const SurfacePoint<F> &at, const Vec3<F> &p,
                               const Arrival<F> &in, const HitAdjoint<F> &g, const MaskOf<F> &curved,
                               const CurvedKind<F> &kind, Vec3<F> &d_bar, GradientSink<F> &sink) {
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
        from_segment = sweep_displacement(in, n, cosine);
        up_bar = select(glued, up_bar + in.D * (in.log_jacobian_bar * inverse / cosine), up_bar);
        q = select(glued, g.p + from_segment, q);
    }
    auto wanted = sink.wants_shape(at.shape, usable);
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

template <class F>
TR_LARGE RayAdjoint<F> sweep_surface(const SceneOf<F> &scene, const SurfacePoint<F> &at, const Vec3<F> &p,
                                     const Arrival<F> &in, HitAdjoint<F> &g, const MaskOf<F> &active,
                                     GradientSink<F> &sink) {
    ShapeLanes<F> shape(scene.shapes, at.shape, active);
    g.n = select(shape.has(FlipNormals), -g.n, g.n);
    g.ng = select(shape.has(FlipNormals), -g.ng, g.ng);
    if (scene.has_tangents()) sweep_partials(scene, at, shape, g.tangent, g.tangent_v, active, g.at, sink);
    g.p = g.p + g.at.p;
    auto mesh = active && !shape.has(IsCurved);
    auto field = active && shape.has(IsHeightField), curve = active && shape.has(IsCurve);
    auto grid = active && shape.has(IsSdfGrid), curved = active && !mesh && !field && !curve && !grid;
    Vec3<F> zero{F(0), F(0), F(0)};
    RayAdjoint<F> r{zero, zero}, other = r;
    if (any(mesh)) r.o = sweep_triangle(scene, at, in, g, shape, mesh, r.d, sink);
    if (any(field)) {
        other.o = sweep_height_fields(scene, at, in, g, field, other.d, sink);
        r = {select(field, other.o, r.o), select(field, other.d, r.d)};
    }
    if (any(curve)) {
        other.o = sweep_curve(scene, at, in, g, shape, curve, other.d, sink);
        r = {select(curve, other.o, r.o), select(curve, other.d, r.d)};
    }
    if (any(grid)) {
        other.o = sweep_sdf_grids(scene, at, in, g, grid, other.d, sink);
        r = {select(grid, other.o, r.o), select(grid, other.d, r.d)};
    }
    if (any(curved)) {
        other.o = sweep_curved(scene, at, p, in, g, curved, CurvedKind<F>(shape, curved), other.d, sink);
        r = {select(curved, other.o, r.o), select(curved, other.d, r.d)};
    }
    return r;
}

template <class F>
TR_LARGE void sweep_position(const SceneOf<F> &scene, const SurfacePoint<F> &at, const Vec3<F> &p, const Vec3<F> &p_bar,
                             const MaskOf<F> &active, GradientSink<F> &sink) {
    auto wanted = sink.wants_shape(at.shape, active);
    if (!any(wanted)) return;
    ShapeLanes<F> shape(scene.shapes, at.shape, wanted);
    auto mesh = wanted && !shape.has(IsCurved);
    if (any(mesh)) {
        UIntOf<F> corner[3];
        gather_rows<F>(scene.faces, (UIntOf<F>(shape.face_offset) + at.primitive) * 3u, mesh, corner);
        const F weight[3] = {F(1) - at.b1 - at.b2, at.b1, at.b2};
        for (int k = 0; k < 3; ++k) sweep_mesh_vertex(VertexArray::Positions, corner[k], p_bar * weight[k], mesh, sink);
    }
    auto field = wanted && shape.has(IsHeightField), curve = wanted && shape.has(IsCurve);
    auto curved = wanted && !mesh && !field && !curve;
    if (any(curve)) CurveAdjoint<F>(scene, at, shape, curve).spread(p_bar, curve, sink);
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

#define TR_INSTANTIATE(F, S)                                                                                         \
    template RayAdjoint<F> sweep_surface(const SceneView<S> &, const SurfacePoint<F> &, const Vec3<F> &,             \
                                         const Arrival<F> &, HitAdjoint<F> &, const MaskOf<F> &, GradientSink<F> &); \
    template void sweep_position(const SceneView<S> &, const SurfacePoint<F> &, const Vec3<F> &, const Vec3<F> &,    \
                                 const MaskOf<F> &, GradientSink<F> &);                                              \
    template void sweep_partials(const SceneView<S> &, const SurfacePoint<F> &, const ShapeLanes<F> &,               \
                                 const Vec3<F> &, const Vec3<F> &, const MaskOf<F> &, CoordinateAdjoint<F> &,        \
                                 GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
