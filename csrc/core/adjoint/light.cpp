#include "light.h"

namespace tr {

namespace {

// Sums up the gradients of a pinhole's parameters and returns the adjoint of p, which `connect` has connected along
// -w; `parallel` as there. `w_bar` is the adjoint of the unit direction to the pinhole, `log_bar` that of log W,
// `origin_bar` what the pinhole's place gets besides.
template <class F>
TR_NOINLINE Vec3<F> sweep_camera_connection(const SceneOf<F> &scene, const LightSensor<ScalarOf<F>> &sensor,
                                            const Vec3<F> &p, const MaskOf<F> &parallel, const Vec3<F> &w_bar,
                                            const F &log_bar, const ConnectionRecord<F> &connection,
                                            const Vec3<F> &origin_bar, bool wanted, const MaskOf<F> &active,
                                            GradientSink<F> &sink) {
    using S = ScalarOf<F>;
    const Record &record = sensor.record;
    const Pinhole<S> &camera = sensor.camera;
    const F &x_bar = connection.x_bar, &y_bar = connection.y_bar;
    Vec3<F> origin{F(camera.origin.x), F(camera.origin.y), F(camera.origin.z)}, zero{F(0), F(0), F(0)};
    Vec3<F> y = select(parallel, p, p - origin), q = camera.to_camera(y);
    F inverse = F(1) / norm(y), inverse_z = F(1) / q.z;
    F a = q.x * inverse_z * F(S(1) / camera.slope), b = q.y * inverse_z * F(S(1) / camera.rise);
    F a_bar = x_bar * F(camera.width * S(-0.5)), b_bar = y_bar * F(camera.height * S(-0.5));
    Vec3<F> q_bar{a_bar * inverse_z * F(S(1) / camera.slope), b_bar * inverse_z * F(S(1) / camera.rise),
                  -(a_bar * a + b_bar * b + F(3) * log_bar) * inverse_z};
    const S *m = camera.inverse;
    Vec3<F> turned{q_bar.x * m[0] + q_bar.y * m[3] + q_bar.z * m[6], q_bar.x * m[1] + q_bar.y * m[4] + q_bar.z * m[7],
                   q_bar.x * m[2] + q_bar.y * m[5] + q_bar.z * m[8]};
    // log W has log |y|, or 3 log |y| of a direction, which is at rest
    Vec3<F> y_bar3 = turned + y * (log_bar * inverse * inverse) - unnormalize(y * -inverse, w_bar, inverse);
    Vec3<F> result = select(parallel, zero, y_bar3);
    if (!wanted) return result;
    auto add = [&](int field, const F &value) { sink.scalar(IntOf<F>(record.field[field]), value, active); };
    Vec3<F> move = origin_bar - result;
    const F row[3] = {turned.x, turned.y, turned.z}, column[3] = {q.x, q.y, q.z}, at[3] = {move.x, move.y, move.z};
    int32_t to_world = record.field[Perspective::ToWorld];
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j)
            sink.scalar(IntOf<F>(to_world + 4 * i + j), -(row[i] * column[j]) - log_bar * F(m[3 * j + i]), active);
        sink.scalar(IntOf<F>(to_world + 4 * i + 3), at[i], active);
    }
    add(Perspective::OffsetX, x_bar * F(-camera.width));
    add(Perspective::OffsetY, y_bar * F(-camera.height));
    F by_rise = -(b_bar * b + log_bar);  // d / d log(rise)
    add(Perspective::Aspect, by_rise * F(S(1) / scene.values.constants[record.field[Perspective::Aspect]]));
    S degrees = (S(1) + camera.slope * camera.slope) / camera.slope * S(Pi / 360);  // d log(slope) / d fov
    add(Perspective::Fov, (by_rise - a_bar * a - log_bar) * F(degrees));
    return result;
}

// Adjoint of the shading correction of wi and wo, whose value has the weight `g` (in logarithms).
template <class F>
struct CorrectionAdjoint {
    Vec3<F> wi, wo, ns, ng;

    TR_INLINE CorrectionAdjoint(const Vec3<F> &wi_, const Vec3<F> &wo_, const Vec3<F> &s, const Vec3<F> &g,
                                const F &weight) {
        auto over = [&](const Vec3<F> &a, const Vec3<F> &b) {
            F x = dot(a, b);
            auto usable = mask<F>(x != F(0));
            return select(usable, weight / select(usable, x, F(1)), F(0));
        };
        F is = over(wi_, s), ig = over(wi_, g), os = over(wo_, s), og = over(wo_, g);
        wi = s * is - g * ig;
        wo = g * og - s * os;
        ns = wi_ * is - wo_ * os;
        ng = wo_ * og - wi_ * ig;
    }
};

// Where light is measured: a place is a pair of texture coordinates, and W is texels per area.
template <class F>
TR_NOINLINE void sweep_measurement(const SceneOf<F> &scene, const Pinhole<ScalarOf<F>> &film, const VertexRecord<F> &v,
                                   const ConnectionRecord<F> &connection, const F &value, const MaskOf<F> &active,
                                   HitAdjoint<F> &hit, GradientSink<F> &sink) {
    hit.at.uv.x = select(active, hit.at.uv.x + connection.x_bar * F(film.width), hit.at.uv.x);
    hit.at.uv.y = select(active, hit.at.uv.y + connection.y_bar * F(film.height), hit.at.uv.y);
    HitAdjoint<F> nothing;
    sweep_area(scene, v.at, v.p, connection.ng, -value, nothing, active, sink);
}

}  // namespace

template <class F>
TR_LARGE Spectrum<F> sweep_light_scattering(const SceneOf<F> &scene, const LightSensor<ScalarOf<F>> &sensor, int kind,
                                            const VertexRecord<F> &v, const ConnectionRecord<F> &connection,
                                            Spectrum<F> a, NextVertex<F> &next, const GradientNeeds &needs,
                                            const MaskOf<F> &active, HitAdjoint<F> &hit, Vec3<F> &d_bar,
                                            GradientSink<F> &sink) {
    const bool has_stack = scene.has_stacks, measured = sensor.meter >= 0;  // what arrives, not what is scattered
    VertexFrame<F> frame(scene, v, bsdf_kernels<F>(kind).is(FollowsTangent));
    Vec3<F> wi = -v.d, wo = frame.frame.to_world(v.wo), to_camera = frame.frame.to_world(v.wo_light);
    StackAdjoint<F> stack;
    if (has_stack) stack = StackAdjoint<F>(scene, sink.waves, v, needs, Transport::Importance, active);
    auto interpolated = has_shading_normal(ShapeLanes<F>(scene.shapes, v.at.shape, active), stack.bsdf.stack, active);
    auto lit = active && mask<F>(v.light_weight > F(0)), scattered_lit = lit && !MaskOf<F>(measured);
    F path_correction = shading_correction(wi, wo, v.normal, connection.ng, interpolated);
    F correction = shading_correction(wi, to_camera, v.normal, connection.ng, interpolated);
    Spectrum<F> camera_factor = v.emitted * (measured ? F(0) : v.light_weight * correction);
    Spectrum<F> path_factor = next.radiance * (v.inverse_pdf * path_correction), whole = a;  // above the stack
    F weight = stack.bsdf.stack.weight;
    if (has_stack) {
        a = a * weight;
        camera_factor = camera_factor * (stack.light_factor * stack.bsdf.stack.inverse_probability);
        path_factor = path_factor * stack.path_factor;
    }
    BsdfAdjoint<F> bsdf(scene, kind, v, Transport::Importance, a, path_factor, camera_factor, needs, scattered_lit,
                        active, hit, sink);
    const Spectrum<F> &f = bsdf.path.f, &f_camera = bsdf.light.f;
    Spectrum<F> scattered = apply(f, path_factor), total;
    if (bsdf.connected) scattered = scattered + apply(f_camera, camera_factor);
    total = has_stack ? scattered * weight : scattered;
    if (measured) total = total + v.emitted * v.light_weight;  // what a meter gets is above the stack
    if (needs.geometry) {
        Vec3<F> zero{F(0), F(0), F(0)}, wi_bar = zero, wi_world = zero, camera_bar = zero;
        F brought = select(scattered_lit, contract(a, apply(f_camera, camera_factor)), F(0));
        F carried = contract(a, apply(f, path_factor));
        if (any(interpolated)) {
            CorrectionAdjoint<F> path(wi, wo, v.normal, connection.ng, select(interpolated, carried, F(0)));
            CorrectionAdjoint<F> camera(wi, to_camera, v.normal, connection.ng, select(interpolated, brought, F(0)));
            next.ray.d = next.ray.d + path.wo;
            camera_bar = camera.wo;
            wi_world = path.wi + camera.wi;
            hit.n = hit.n + path.ns + camera.ns;
            hit.ng = hit.ng + path.ng + camera.ng;
        }
        if (has_stack && any(stack.factor.shadowed))
            stack.sweep_shadowing(v.normal, Transport::Importance, brought, carried, camera_bar, next.ray.d, wi_world);
        bsdf.sweep_continuation(scene, v, next, active, frame, wi_bar, hit, sink);
        if (measured && any(lit))
            sweep_measurement(scene, sensor.camera, v, connection, contract(whole, v.emitted * v.light_weight), lit,
                              hit, sink);
        if (bsdf.connected) {
            wi_bar = wi_bar + bsdf.light.wi_bar;
            Vec3<F> w_bar = frame.into(v.wo_light, bsdf.light.wo_bar) + camera_bar + v.way.d;
            Vec3<F> p_bar = sweep_camera_connection(scene, sensor, v.p, MaskOf<F>(false), w_bar, brought, connection,
                                                    zero, needs.camera, lit, sink);
            hit.p = select(lit, hit.p + p_bar, hit.p);
        }
        d_bar = d_bar - frame.into(v.wi, wi_bar) - wi_world;
        frame.hand_to(hit, scene, v, active);
    }
    if (has_stack) stack.finish(scene, v, apply(whole, scattered), needs, active, hit, sink);
    return total;
}

template <class F>
TR_LARGE void sweep_emission(const SceneOf<F> &scene, const LightSensor<ScalarOf<F>> &sensor,
                             const EmissionRecord<F> &e, const NextVertex<F> &next, const GradientNeeds &needs,
                             const MaskOf<F> &active, GradientSink<F> &sink) {
    if (!needs.emitter && !needs.geometry) return;
    const VertexRecord<F> &v = e.v;
    Spectrum<F> by_path = next.radiance * v.inverse_pdf, by_camera = v.emitted * v.light_weight,
                g = by_path + by_camera;
    Vec3<F> light_d_bar{F(0), F(0), F(0)};  // of -v.d
    CoordinateAdjoint<F> at;
    for_each_emitter_kind<F>(e.kind, active, [&](const EmitterKernels<F> &emitter, const MaskOf<F> &lanes) {
        emitter.vjp(scene, v.light, -v.d, g, needs, lanes, at, light_d_bar, sink);
    });
    if (!needs.geometry) return;
    F carried = contract(e.radiance, by_path), seen = contract(e.radiance, by_camera);
    for_each_emitter_kind<F>(e.kind, active, [&](const EmitterKernels<F> &emitter, const MaskOf<F> &lanes) {
        if (emitter.emission_vjp) emitter.emission_vjp(scene, e, next, carried, at, light_d_bar, lanes, sink);
    });
    auto lit = active && mask<F>(v.light_weight > F(0));
    if (!any(lit)) return;
    const auto &o = sensor.camera.origin;
    Vec3<F> origin{F(o.x), F(o.y), F(o.z)}, zero{F(0), F(0), F(0)}, origin_bar = zero;
    const EmitterFlags<F> flags(scene, e.kind);
    auto on_shape = lit && flags.has(IsOnShape);
    if (any(on_shape)) {
        HitAdjoint<F> nothing;
        Vec3<F> o_bar = sweep_area(scene, v.light.at, v.p, v.p - origin, seen, nothing, on_shape, sink);
        origin_bar = select(on_shape, o_bar, zero);
    }
    auto infinite = active && flags.has(IsInfinite);
    Vec3<F> p_bar = sweep_camera_connection(scene, sensor, select(infinite, -v.d, v.p), infinite, v.way.d, seen,
                                            e.connection, origin_bar, needs.camera, lit, sink);
    if (any(on_shape)) sweep_position(scene, v.light.at, v.p, p_bar, on_shape, sink);
}

#define TR_INSTANTIATE(F, S)                                                                                       \
    template Spectrum<F> sweep_light_scattering(const SceneView<S> &, const LightSensor<S> &, int,                 \
                                                const VertexRecord<F> &, const ConnectionRecord<F> &, Spectrum<F>, \
                                                NextVertex<F> &, const GradientNeeds &, const MaskOf<F> &,         \
                                                HitAdjoint<F> &, Vec3<F> &, GradientSink<F> &);                    \
    template void sweep_emission(const SceneView<S> &, const LightSensor<S> &, const EmissionRecord<F> &,          \
                                 const NextVertex<F> &, const GradientNeeds &, const MaskOf<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
