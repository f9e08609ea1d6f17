// The derivative of a light path, one vertex at a time, from its end to its beginning: as sweep.h, with the roles of
// camera and light exchanged. A connection to the camera brings v = beta f W, W the camera's importance, to the place u
// on the film: with the image's adjoint g and the filter h the loss changes by
//     dv sum_p g_p h(p - u) - v sum_p g_p grad h(p - u) . du.
// So every connection has an adjoint of its own, in each channel for v and one for u, and they are part of what the
// vertices hand on: the path's adjoint is one.
//
// What moves: light that leaves an area or a point light meets points that are glued to their surfaces, through
// |N_0.D| |N_1.D| / |D|^4 and |N_1.D| / |D|^3, as after a smooth BSDF; that of an environment and parallel light
// through |N_1.d|, an environment's d being at rest. A beam (`directionalarea`) is a ray that moves with its surface,
// and what it hits slides.
#pragma once

#include "../integrator/particle.h"
#include "sweep.h"

namespace tr {

// What the tape keeps of a connection besides VertexRecord, whose `light_weight` is W where the way is free, else 0,
// and whose `emitted` is the adjoint of v.
template <class F>
struct ConnectionRecord {
    F x_bar, y_bar;  // of the place on the film
    Vec3<F> ng;      // geometric normal of the vertex
};

// Sums up the gradients of a pinhole's parameters and returns the adjoint of p, which `connect` has connected along
// -w; `parallel` as there. `w_bar` is the adjoint of the unit direction to the pinhole, `log_bar` that of log W,
// `origin_bar` what the pinhole's place gets besides.
template <class F, class S, class Sink>
TR_NOINLINE Vec3<F> sweep_connection(const SceneView<S> &scene, const Record &record, const Pinhole<S> &camera,
                                     const Vec3<F> &p, const MaskOf<F> &parallel, const Vec3<F> &w_bar,
                                     const F &log_bar, const F &x_bar, const F &y_bar, const Vec3<F> &origin_bar,
                                     bool wanted, const MaskOf<F> &active, Sink &sink) {
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

// The adjoint of |N.E| / |E|, E from a point that sees it to the point p of a surface, of area vector N; `log_bar` is
// that of its logarithm. Sums up what the surface gets, `hit` being what comes besides, and returns the adjoint of the
// other point. With the unit normal as E it is that of |N|.
template <class F, class S, class Sink>
TR_INLINE Vec3<F> sweep_area(const SceneView<S> &scene, const SurfacePoint<F> &at, const Vec3<F> &p, const Vec3<F> &E,
                             const F &log_bar, HitAdjoint<F> hit, const MaskOf<F> &active, Sink &sink) {
    Vec3<F> zero{F(0), F(0), F(0)};
    Vec3<F> rest = E * (F(2) * log_bar / select(active, squared_norm(E), F(1)));  // J has |N.E| / |E|^3
    hit.p = hit.p + rest;
    Arrival<F> in{MaskOf<F>(false), E, F(1), E, zero, log_bar};
    return sweep_surface(scene, at, p, in, hit, active, sink).o - rest;
}

// Where light is measured: a place is a pair of texture coordinates, and W is texels per area.
template <class F, int C, class S, class Sink>
TR_NOINLINE void sweep_measurement(const SceneView<S> &scene, const LightSensor<S> &sensor, const VertexRecord<F, C> &v,
                                   const ConnectionRecord<F> &connection, const Color<F, C> &value,
                                   const MaskOf<F> &active, HitAdjoint<F> &hit, Sink &sink) {
    hit.at.uv.x = select(active, hit.at.uv.x + connection.x_bar * F(sensor.camera.width), hit.at.uv.x);
    hit.at.uv.y = select(active, hit.at.uv.y + connection.y_bar * F(sensor.camera.height), hit.at.uv.y);
    sweep_area(scene, v.at, v.p, connection.ng, -channel_sum(value), HitAdjoint<F>{}, active, sink);
}

// One scattering vertex. Returns what the light that arrives along v.d brings, divided by its throughput a, every
// connection being weighted with its adjoint; adds the adjoints of the hit and of the direction.
template <class Model, int C, class F, class S, class Sink>
TR_INLINE Color<F, C> sweep_light_scattering(const SceneView<S> &scene, const LightSensor<S> &sensor,
                                             const VertexRecord<F, C> &v, const ConnectionRecord<F> &connection,
                                             Color<F, C> a, NextVertex<F, C> next, const Wanted &wanted,
                                             const MaskOf<F> &active, HitAdjoint<F> &hit, Vec3<F> &d_bar, Sink &sink) {
    constexpr Transport importance = Transport::Importance;
    auto params = load_params<Model, C>(scene, v.bsdf, v.at, active);
    FrameOf<Model, F> frame(vertex_frame(scene, v), v.mirror);
    Vec3<F> wi = -v.d, wo = frame.frame.to_world(v.wo), to_camera = frame.frame.to_world(v.wo_light);
    LayerSweep<F> layers;
    if (scene.layered) layers = begin_layers<C>(scene, v, wanted, importance, active);
    auto interpolated = has_shading_normal(ShapeLanes<F>(scene.shapes, v.at.shape, active), layers.leaf, active);
    auto lit = active && mask<F>(v.light_weight > F(0));
    F path_correction = shading_correction(wi, wo, v.normal, connection.ng, interpolated);
    F correction = shading_correction(wi, to_camera, v.normal, connection.ng, interpolated);
    const bool measured = sensor.meter >= 0;  // what arrives, not what is scattered
    Color<F, C> light_factor = v.emitted * (measured ? F(0) : v.light_weight * correction);
    Color<F, C> path_factor = next.radiance * (v.inverse_pdf * path_correction);
    Color<F, C> f, f_light, whole = a;  // above the layers
    F weight = layers.leaf.layers.weight;
    if (scene.layered) {
        a = a * weight;
        light_factor = light_factor * (layers.light_factor * layers.leaf.layers.inverse_probability);
        path_factor = path_factor * layers.path_factor;
    }
    sweep_parameters<importance, Model, C>(scene, v, params, a, light_factor, path_factor, wanted, active, hit, f,
                                           f_light, sink);
    Color<F, C> scattered = f * path_factor, direct = uniform_color<C>(F(0));  // what a meter gets is above the layers
    if (measured)
        direct = v.emitted * v.light_weight;
    else if constexpr (Model::Smooth)
        scattered = scattered + f_light * light_factor;
    Color<F, C> total = scene.layered ? scattered * weight + direct : scattered + direct;
    if (!wanted.geometry) {
        if (scene.layered) finish_layers<C>(scene, v, layers, whole * scattered, wanted, active, hit, sink);
        return total;
    }

    Vec3<F> zero{F(0), F(0), F(0)}, wi_bar = zero, wi_world = zero, camera_bar = zero;
    F brought = select(lit && !MaskOf<F>(measured), channel_sum(a * f_light * light_factor), F(0));
    if (any(interpolated)) {
        CorrectionAdjoint<F> path(wi, wo, v.normal, connection.ng,
                                  select(interpolated, channel_sum(a * f * path_factor), F(0)));
        CorrectionAdjoint<F> light(wi, to_camera, v.normal, connection.ng, select(interpolated, brought, F(0)));
        next.ray.d = next.ray.d + path.wo;
        camera_bar = light.wo;
        wi_world = path.wi + light.wi;
        hit.n = hit.n + path.ns + light.ns;
        hit.ng = hit.ng + path.ng + light.ng;
    }
    if (scene.layered && any(layers.factor.shadowed))
        layers.sweep_shadowing(v.normal, importance, brought, channel_sum(a * f * path_factor), camera_bar, next.ray.d,
                               wi_world);
    sweep_continuation<importance, Model, C>(scene, v, params, a * path_factor, next, active, frame, wi_bar, hit, sink);
    if (measured) {
        if (any(lit))
            sweep_measurement(scene, sensor, v, connection, whole * v.emitted * v.light_weight, lit, hit, sink);
    } else if constexpr (Model::Smooth) {
        if (any(lit)) {
            Vec3<F> wo_bar;
            sweep_directions<importance, Model, C>(params, v.wi, v.wo_light, IntOf<F>(0), a * light_factor, wi_bar,
                                                   wo_bar);
            Vec3<F> w_bar = frame.into(v.wo_light, wo_bar) + camera_bar;
            Vec3<F> p_bar = sweep_connection(scene, sensor.record, sensor.camera, v.p, MaskOf<F>(false), w_bar, brought,
                                             connection.x_bar, connection.y_bar, zero, wanted.camera, lit, sink);
            hit.p = select(lit, hit.p + p_bar, hit.p);
        }
    }
    d_bar = d_bar - frame.into(v.wi, wi_bar) - wi_world;
    frame.hand_to(hit, scene, v, active);
    if (scene.layered) finish_layers<C>(scene, v, layers, whole * scattered, wanted, active, hit, sink);
    return total;
}

// What the tape keeps of a path's beginning, see EmissionSample; `v` holds its connection, and in `inverse_pdf` the
// weight of the light that leaves along d.
template <class F, int C>
struct EmissionRecord {
    VertexRecord<F, C> v;
    ConnectionRecord<F> connection;
    IntOf<F> kind;
    Color<F, C> radiance;
};

template <int C, class F, class S, class Sink>
TR_NOINLINE void sweep_emission(const SceneView<S> &scene, const LightSensor<S> &sensor, const EmissionRecord<F, C> &e,
                                const NextVertex<F, C> &next, const Wanted &wanted, const MaskOf<F> &active,
                                Sink &sink) {
    const VertexRecord<F, C> &v = e.v;
    auto is = [&](EmitterKind kind) { return active && mask<F>(e.kind == int32_t(kind)); };
    auto beam = is(EmitterKind::DirectionalArea), area = is(EmitterKind::Area);
    auto directional = is(EmitterKind::Directional), parallel = active && is_parallel<F>(e.kind);
    Color<F, C> by_path = next.radiance * v.inverse_pdf, by_camera = v.emitted * v.light_weight;
    Vec3<F> light_d_bar{F(0), F(0), F(0)};  // of -v.d
    if (wanted.emitter || wanted.geometry) {
        CoordinateAdjoint<F> at;
        sweep_emitter(scene, v.light, -v.d, by_path + by_camera, wanted, active, at, light_d_bar, sink);
        if (any(beam)) {
            IntOf<F> texture = record_field<F>(scene.emitters, DirectionalAreaEmitter::Radiance, v.light.emitter, beam);
            Color<F, C> g = by_path + by_camera;
            if (wanted.emitter) sink.texture(scene, texture, v.light.at, g, beam);
            if (wanted.geometry) sweep_lookup<C>(scene, texture, v.light.at, g, beam, at, sink);
        }
        auto surface = area || beam;
        if (wanted.geometry && scene.textured && any(surface)) {  // texture coordinates, where nothing else moves
            HitAdjoint<F> hit;
            hit.at = at;
            sweep_area(scene, v.light.at, v.p, v.normal, F(0), hit, surface, sink);
        }
    }
    if (!wanted.geometry) return;
    Vec3<F> zero{F(0), F(0), F(0)};
    F carried = channel_sum(e.radiance * by_path), seen = channel_sum(e.radiance * by_camera);
    if (any(beam)) {
        HitAdjoint<F> hit;
        hit.p = next.ray.o;
        hit.n = next.ray.d;
        sweep_area(scene, v.light.at, v.p, v.normal, carried, hit, beam, sink);
    }
    auto leaves = area && mask<F>(squared_norm(next.segment) > F(0));
    if (any(leaves)) {
        Vec3<F> D = next.segment * (F(1) / select(leaves, squared_norm(next.segment), F(1)));
        HitAdjoint<F> hit;
        hit.p = next.ray.o;
        Vec3<F> next_bar = sweep_area(scene, v.light.at, v.p, -D, carried, hit, leaves, sink);
        sweep_position(scene, next.at, next.p, next_bar, leaves, sink);
    }
    for_each_point_light<F>(e.kind, active, [&](auto model, const MaskOf<F> &lanes) {
        Vec3<F> D_bar = zero;
        if constexpr (decltype(model)::Oriented) {  // the intensity changes with the direction to the next point
            D_bar = direction_adjoint(next.segment, -light_d_bar);
            auto meets = lanes && mask<F>(squared_norm(next.segment) > F(0));
            if (any(meets)) sweep_position(scene, next.at, next.p, D_bar, meets, sink);
        }
        sweep_light_place<decltype(model)>(scene, v.light.emitter, next.ray.o - D_bar, lanes, sink);
    });
    if (any(directional)) sweep_light_axis(scene, v.light.emitter, next.ray.d, directional, sink);
    auto lit = active && mask<F>(v.light_weight > F(0));
    if (!any(lit)) return;
    const Vec3<S> &o = sensor.camera.origin;
    Vec3<F> origin{F(o.x), F(o.y), F(o.z)}, origin_bar = zero;
    auto on_light = lit && area;
    if (any(on_light)) {
        Vec3<F> o_bar = sweep_area(scene, v.light.at, v.p, v.p - origin, seen, HitAdjoint<F>{}, on_light, sink);
        origin_bar = select(on_light, o_bar, zero);
    }
    Vec3<F> to = select(parallel, -v.d, v.p);
    Vec3<F> p_bar = sweep_connection(scene, sensor.record, sensor.camera, to, parallel, zero, seen, e.connection.x_bar,
                                     e.connection.y_bar, origin_bar, wanted.camera, lit, sink);
    if (any(on_light)) sweep_position(scene, v.light.at, v.p, p_bar, on_light, sink);
}

}  // namespace tr
