#include "surface.h"

namespace tr {

// The distance to the unit shape that is near t, which is known to single precision.
template <class F, class S>
TR_INLINE F refine_distance(const S *to_object, const Ray<F> &ray, const F &t, const CurvedKind<F> &kind) {
    Vec3<F> o = transform_point(to_object, ray.o), d = transform_vector(to_object, ray.d);
    F plane = -o.z / select(mask<F>(d.z == F(0)), F(1), d.z);
    o.z = select(kind.cylinder, F(0), o.z);
    d.z = select(kind.cylinder, F(0), d.z);
    F a = dot(d, d), middle = -dot(o, d) / a;
    F half = sqrt(max(F(1) - squared_norm(o + d * middle), F(0)) / a);
    return select(kind.sphere || kind.cylinder, middle + select(mask<F>(t < middle), -half, half), plane);
}

template <class F>
TR_LARGE Interaction<F> make_interaction(const SceneOf<F> &scene, const Ray<F> &ray, SurfacePoint<F> at, F t,
                                         const MaskOf<F> &active) {
    using S = ScalarOf<F>;
    Interaction<F> si;
    ShapeLanes<F> shape(scene.shapes, at.shape, active);
    auto mesh = active && !shape.has(IsCurved);
    Vec3<F> ns{F(0), F(0), F(1)};
    si.ng = ns;
    si.p = ray.o;
    Vec2<F> given{F(0), F(0)};
    MaskOf<F> mapped(false);
    if (any(mesh)) {
        auto smooth = mesh && shape.has(HasNormals);
        if (scene.textured) mapped = mesh && shape.has(HasTexcoords);
        Corners<F> corners;
        Triangle<F, S> tri(scene, UIntOf<F>(shape.face_offset) + at.primitive, mesh, smooth || mapped, corners);
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
        if (any(smooth)) {
            const Vec3<F>(&corner)[3] = corners.n;
            Vec3<F> interpolated = corner[0] * (F(1) - at.b1 - at.b2) + corner[1] * at.b1 + corner[2] * at.b2;
            F length_squared = squared_norm(interpolated);
            auto usable = smooth && mask<F>(length_squared > F(0));
            interpolated = interpolated * rsqrt(select(usable, length_squared, F(1)));
            ns = select(usable, interpolated, ns);
        }
        if (any(mapped)) given = interpolate_coordinates(corners.uv, at.b1, at.b2);
    }
    auto field = active && shape.has(IsHeightField);
    if (any(field)) {
        meet_height_fields(scene, at.shape, ray.o, ray.d, field, at.b1, at.b2, t, si.p, ns);
        si.ng = select(field, ns, si.ng);
    }
    auto curve = active && shape.has(IsCurve);
    if (any(curve)) {
        meet_curves(scene, ray.o, ray.d, shape, curve, at, t);
        const CurvePoint<F> point(scene, at, shape, curve);
        si.p = select(curve, point.p, si.p);
        si.ng = select(curve, normalize(point.area), si.ng);
        ns = select(curve, si.ng, ns);
        if (scene.textured) {
            Vec2<F> own = curve_coordinates(scene, at, curve);
            given = {select(curve, own.x, given.x), select(curve, own.y, given.y)};
            mapped = mapped || curve;
        }
    }
    auto grid = active && shape.has(IsSdfGrid);
    if (any(grid)) meet_sdf_grids(scene, at.shape, at.primitive, ray.o, ray.d, grid, at.b1, at.b2, t, si.p, si.ng, ns);
    auto curved = active && !mesh && !field && !curve && !grid;
    if (any(curved)) {
        F to_world[12], to_object[12];
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u, curved, to_world);
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u + 12u, curved, to_object);
        CurvedKind<F> kind(shape, curved);
        if constexpr (sizeof(S) == 8) t = select(curved, refine_distance(to_object, ray, t, kind), t);
        Vec3<F> local = transform_point(to_object, ray.o + ray.d * t);
        // a point in single precision is off the surface: put it back, so that spawned rays start right
        local = kind.project(local);
        Vec2<F> uv = curved_coordinates(local, kind);
        at.b1 = select(curved, uv.x, at.b1);
        at.b2 = select(curved, uv.y, at.b2);
        Vec3<F> n = normalize(transform_normal(to_object, kind.normal(local)));
        si.p = select(curved, transform_point(to_world, local), si.p);
        si.ng = select(curved, n, si.ng);
        ns = select(curved, n, ns);
    }
    auto flip = shape.has(FlipNormals);
    si.ng = select(flip, -si.ng, si.ng);
    ns = select(flip, -ns, ns);
    si.frame = make_frame(ns);
    Vec2<F> uv{select(mapped, given.x, at.b1), select(mapped, given.y, at.b2)};
    si.at = {at, {select(grid, F(0), uv.x), select(grid, F(0), uv.y)}};
    si.shape = shape;
    si.t = t;
    return si;
}

template <class F>
TR_LARGE Vec3<F> surface_position(const SceneOf<F> &scene, const SurfacePoint<F> &at, const MaskOf<F> &active) {
    using S = ScalarOf<F>;
    ShapeLanes<F> shape(scene.shapes, at.shape, active);
    Vec3<F> p{F(0), F(0), F(0)};
    auto mesh = active && !shape.has(IsCurved), field = active && shape.has(IsHeightField);
    auto curve = active && shape.has(IsCurve), grid = active && shape.has(IsSdfGrid);
    auto curved = active && !mesh && !field && !curve && !grid;
    if (any(curve)) p = select(curve, CurvePoint<F>(scene, at, shape, curve).p, p);
    if (any(grid)) sdf_positions(scene, at.shape, at.primitive, at.b1, at.b2, grid, p);
    if (any(mesh)) {
        Triangle<F, S> tri(scene, UIntOf<F>(shape.face_offset) + at.primitive, mesh);
        p = select(mesh, tri.p0 + tri.e1 * at.b1 + tri.e2 * at.b2, p);
    }
    if (any(field))
        each_shape<HeightView, F>(
            scene, at.shape, field, [&](uint32_t one, const HeightView<S> &heights, const MaskOf<F> &lanes) {
                Vec3<F> local{F(2) * at.b1 - F(1), F(2) * at.b2 - F(1), height_at(heights, at.b1, at.b2, lanes).z};
                p = select(lanes, transform_point(scene.shape_matrices + 24 * size_t(one), local), p);
            });
    if (any(curved)) {
        F to_world[12];
        gather_matrix<F>(scene.shape_matrices, at.shape * 24u, curved, to_world);
        Vec3<F> local = curved_point(Vec2<F>{at.b1, at.b2}, CurvedKind<F>(shape, curved));
        p = select(curved, transform_point(to_world, local), p);
    }
    return p;
}

template <class F>
TR_LARGE SampledPoint<F> sample_shape(const SceneOf<F> &scene, const UIntOf<F> &shape, const F &u0, const F &u1,
                                      const F &u2, const MaskOf<F> &active, const MaskOf<F> &unfold) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    SampledPoint<F> r;
    ShapeLanes<F> info(scene.shapes, shape, active);
    r.at.shape = shape;
    r.at.primitive = U(0u);
    r.pdf = F(1) / gather<F>(scene.shape_areas, shape, active);
    r.p = {F(0), F(0), F(0)};
    r.n = {F(0), F(0), F(1)};
    r.at.b1 = r.at.b2 = F(0);
    auto mesh = active && !info.has(IsCurved);
    if (any(mesh)) {
        U faces[2];  // their number, where their cdf begins
        gather_few_rows<F>(&scene.shapes->n_faces, shape * 16u, mesh, faces);
        U n = select(mask<U>(mesh), faces[0], U(1u));
        r.at.primitive = search_cdf<F>(scene.area_cdf, faces[1], n, u0, mesh);
        Vec2<F> b = square_to_triangle(u1, u2);
        if (any(mesh && unfold)) {
            auto two = mesh && unfold && mask<F>(n == 2u) &&
                       mask<F>(abs(gather<F>(scene.area_cdf, faces[1], mesh) - F(0.5)) < F(1e-5));
            auto second = mask<F>(u2 > u1);
            r.at.primitive = select(mask<U>(two), select(mask<U>(second), U(1u), U(0u)), r.at.primitive);
            b = {select(two, select(second, u1, u1 - u2), b.x), select(two, select(second, u2 - u1, u2), b.y)};
        }
        Triangle<F, S> tri(scene, U(info.face_offset) + r.at.primitive, mesh);
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
        CurvedKind<F> kind(info, curved);
        Vec3<F> on_sphere = square_to_sphere(u1, u2);
        Vec2<F> disk = square_to_disk(u1, u2);
        Vec3<F> local = select(kind.sphere, on_sphere, Vec3<F>{disk.x, disk.y, F(0)});
        if (any(kind.cylinder)) local = select(kind.cylinder, curved_point(Vec2<F>{u1, u2}, kind), local);
        Vec2<F> uv = curved_coordinates(local, kind);
        r.at.b1 = select(curved, uv.x, r.at.b1);
        r.at.b2 = select(curved, uv.y, r.at.b2);
        Vec3<F> n = normalize(transform_normal(to_object, kind.normal(local)));
        r.p = select(curved, transform_point(to_world, local), r.p);
        r.n = select(curved, n, r.n);
    }
    auto flip = info.has(FlipNormals);
    r.n = select(flip, -r.n, r.n);
    return r;
}

#define TR_INSTANTIATE(F, S)                                                                                        \
    template Interaction<F> make_interaction(const SceneView<S> &, const Ray<F> &, SurfacePoint<F>, F,              \
                                             const MaskOf<F> &);                                                    \
    template Vec3<F> surface_position(const SceneView<S> &, const SurfacePoint<F> &, const MaskOf<F> &);            \
    template SampledPoint<F> sample_shape(const SceneView<S> &, const UIntOf<F> &, const F &, const F &, const F &, \
                                          const MaskOf<F> &, const MaskOf<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
