// `area`: a shape that emits, from its front side, a radiance that may be textured. Sampled uniformly by area, or by
// what an image on a rectangle shows; spheres seen from outside by the cone they fill (Shirley, Wang and Zimmerman,
// "Monte Carlo Techniques for Direct Lighting Calculations", TOG 1996).
#include "on_shape.h"

namespace tr {

struct AreaEmitter {
    static constexpr Field fields[] = {
        {"radiance", Kind::Texture, 1, 0, INFINITY, "interior", "emitted radiance, W / (m^2 sr)"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
        {"stokes", Kind::Vector, 0, -1, 1, "interior",
         "(3,) Q, U and V of the light's Stokes vector over I, Q along dp/du across the ray", nullptr, Optional},
    };
    static constexpr int Radiance = field_index(fields, "radiance");
    static constexpr Model model = {"emitter", "area", "An emitting shape.", fields, 3, IsOnShape, "AreaLight"};
};

namespace {

// Does the point p see the sphere of this shape from outside, and how wide? Cutoff: 1 - cos of the half angle.
template <class F>
struct SphereCone {
    Vec3<F> axis;
    F distance, radius, cutoff;
    MaskOf<F> valid;
};

template <class F, class S>
TR_INLINE SphereCone<F> sphere_cone(const SceneView<S> &scene, const UIntOf<F> &shape, const Vec3<F> &p,
                                    const MaskOf<F> &active) {
    SphereCone<F> r;
    UIntOf<F> m = shape * 24u;
    ShapeLanes<F> info(scene.shapes, shape, active);
    r.valid = active && info.has(IsSphere) && !info.has(FlipNormals);
    F to_world[12];
    gather_matrix<F>(scene.shape_matrices, m, active, to_world);
    Vec3<F> column{to_world[0], to_world[4], to_world[8]}, center{to_world[3], to_world[7], to_world[11]};
    r.radius = norm(column);
    Vec3<F> to_center = center - p;
    r.distance = norm(to_center);
    r.valid = r.valid && mask<F>(r.distance > r.radius * F(1.0001));
    r.axis = to_center * (F(1) / select(r.valid, r.distance, F(1)));
    F sin_max = select(r.valid, r.radius / select(r.valid, r.distance, F(1)), F(0));
    F sin_squared = sin_max * sin_max;
    r.cutoff = sin_squared / (F(1) + sqrt(max(F(1) - sin_squared, F(0))));  // 1 - cos without cancellation
    return r;
}

// Density per solid angle at p of choosing the point `light` (of normal n, in direction d, at this distance) on the
// shape.
template <class F, class S>
TR_INLINE F area_emitter_pdf(const SceneView<S> &scene, const UIntOf<F> &shape, const Vec3<F> &p, const Vec3<F> &n,
                             const Vec3<F> &d, const F &distance, const MaskOf<F> &active) {
    F cosine = abs(dot(n, d));
    F by_area = distance * distance /
                (gather<F>(scene.shape_areas, shape, active) * select(mask<F>(cosine > F(0)), cosine, F(1)));
    by_area = select(mask<F>(cosine > F(0)), by_area, F(0));
    if (any(active && ShapeLanes<F>(scene.shapes, shape, active).has(IsSphere))) {
        SphereCone<F> cone = sphere_cone(scene, shape, p, active);
        by_area = select(cone.valid, F(1 / (2 * Pi)) / select(cone.valid, cone.cutoff, F(1)), by_area);
    }
    return by_area;
}

// A point on the emitting shape for the reference point p. `unfold`: see sample_shape.
template <class F, class S>
TR_INLINE SampledPoint<F> sample_area_emitter(const SceneView<S> &scene, const UIntOf<F> &shape, const Vec3<F> &p,
                                              const F &u0, const F &u1, const F &u2, const MaskOf<F> &active,
                                              const MaskOf<F> &unfold) {
    SampledPoint<F> r = sample_shape<F>(scene, shape, u0, u1, u2, active, unfold);
    if (any(active && ShapeLanes<F>(scene.shapes, shape, active).has(IsSphere))) {
        SphereCone<F> cone = sphere_cone(scene, shape, p, active);
        if (any(cone.valid)) {
            Vec3<F> local = square_to_cone(u1, u2, cone.cutoff);
            // the nearer intersection with the sphere along it, in the frame of the axis; neither the distance along
            // the ray nor the centre's is subtracted from anything, so that small spheres far away keep their shape
            F sine = local.x * local.x + local.y * local.y;
            F half = sqrt(max(cone.radius * cone.radius - cone.distance * cone.distance * sine, F(0)));
            F t = cone.distance * local.z - half;
            Vec3<F> n{local.x * t, local.y * t, -(cone.distance * sine + local.z * half)};
            n = make_frame(cone.axis).to_world(normalize(n));
            Vec3<F> q = p + cone.axis * cone.distance + n * cone.radius;
            F to_object[12];
            gather_matrix<F>(scene.shape_matrices, shape * 24u + 12u, cone.valid, to_object);
            Vec3<F> object = normalize(transform_point(to_object, q));
            Vec2<F> uv = curved_coordinates(object, CurvedKind<F>(cone.valid));
            r.p = select(cone.valid, q, r.p);
            r.n = select(cone.valid, n, r.n);
            r.at.b1 = select(cone.valid, uv.x, r.at.b1);
            r.at.b2 = select(cone.valid, uv.y, r.at.b2);
        }
    }
    return r;
}

template <class F>
struct Area : OnShape<AreaEmitter, F> {
    using Base = OnShape<AreaEmitter, F>;
    using typename Base::M;
    using typename Base::Scene;
    using U = UIntOf<F>;

    TR_HD static void sample_direct(const Scene &scene, const Vec3<F> &p, const F &u0, const F &u1, const F &u2,
                                    const M &lanes, EmitterSample<F> &r) {
        U shape = Base::shape_of(scene, r.point.emitter, lanes);
        F x = u1, y = u2, density;
        auto cells = choose_light_cell(scene, r.point.emitter, lanes, x, y, density);
        SampledPoint<F> q = sample_area_emitter(scene, shape, p, u0, x, y, lanes, cells);
        Direction<F> to_light(q.p - p);
        auto facing = lanes && mask<F>(dot(q.n, to_light.d) < F(0));
        Base::put(q.at, lanes, r.point.at);
        r.d = select(lanes, to_light.d, r.d);
        r.distance = select(lanes, to_light.length, r.distance);
        F pdf = area_emitter_pdf(scene, shape, p, q.n, to_light.d, to_light.length, facing) * density;
        r.pdf = select(facing, pdf, r.pdf);
    }

    TR_HD static F pdf_direct(const Scene &scene, const EmitterPoint<F> &point, const Vec3<F> &from, const Vec3<F> &p,
                              const Vec3<F> &n, const M &lanes) {
        Direction<F> to_light(p - from);
        return area_emitter_pdf(scene, point.at.shape, from, n, to_light.d, to_light.length, lanes) *
               light_density(scene, point, lanes);
    }

    TR_HD static void sample_emission(const Scene &scene, const F &left, const F &a, const F &b, const F &c, const F &d,
                                      const F &inverse_pmf, const M &lanes, EmissionSample<F> &r) {
        SampledPoint<F> q = Base::sample_point(scene, left, a, b, inverse_pmf, lanes, r);
        r.d = select(lanes, make_frame(q.n).to_world(square_to_cosine_hemisphere(c, d)), r.d);
        r.weight = select(lanes, r.inverse_pdf * F(Pi), r.weight);
    }

    TR_HD static void direct_vjp(const Scene &scene, const DirectAdjoint<F> &g, const M &lanes, Vec3<F> &x_bar,
                                 GradientSink<F> &sink) {
        auto near = lanes && mask<F>(g.distance < F(ScalarOf<F>(1e30)));
        if (!g.shapes || !any(near)) return;
        HitAdjoint<F> hit;
        hit.at = g.at, hit.p = g.end_bar, hit.tangent = g.tangent_bar;
        F distance = select(near, g.distance, F(1));
        Arrival<F> in{M(false), g.w, distance, g.w * distance, g.w_bar, g.log_bar};
        Vec3<F> bar = sweep_surface(scene, g.point.at, g.x + in.D, in, hit, near, sink).o;
        x_bar = select(near, bar, x_bar);
    }

    // Light that leaves an area meets points that are glued to their surfaces.
    TR_HD static void emission_vjp(const Scene &scene, const EmissionRecord<F> &e, const NextVertex<F> &next,
                                   const F &carried, const CoordinateAdjoint<F> &at, const Vec3<F> &, const M &lanes,
                                   GradientSink<F> &sink) {
        const VertexRecord<F> &v = e.v;
        Base::sweep_coordinates(scene, v, at, lanes, sink);
        auto leaves = lanes && mask<F>(squared_norm(next.segment) > F(0));
        if (!any(leaves)) return;
        Vec3<F> D = next.segment * (F(1) / select(leaves, squared_norm(next.segment), F(1)));
        HitAdjoint<F> hit;
        hit.p = next.ray.o;
        Vec3<F> next_bar = sweep_area(scene, v.light.at, v.p, -D, carried, hit, leaves, sink);
        sweep_position(scene, next.at, next.p, next_bar, leaves, sink);
    }

    static double power(EmitterMeans &means, const Record &record) {
        const int32_t shape = record.field[EmitterShape];
        return Pi * means.texture(record.field[AreaEmitter::Radiance], shape) * means.area(shape);
    }

    static constexpr EmitterKernels<F> table() {
        return {AreaEmitter::model,
                Base::eval,
                sample_direct,
                pdf_direct,
                nullptr,
                TR_OF_LIGHT_PATHS(sample_emission),
                TR_OF_DERIVATIVES(Base::vjp),
                TR_OF_DERIVATIVES(direct_vjp),
                TR_OF_DERIVATIVES(TR_OF_LIGHT_PATHS(emission_vjp)),
                TR_HOST_POINTER(power)};
    }
};

}  // namespace

TR_EMITTER(AreaEmitter, Area)

}  // namespace tr
