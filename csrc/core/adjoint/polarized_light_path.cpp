#include "polarized_light_path.h"

#include "sweep_parts.h"

namespace tr {

namespace {

// A vertex of a light path, or its beginning.
template <class F>
struct LightPathEntry {
    bool begins;
    UIntOf<F> slot, parent;
    VertexRecord<F> v;
    ConnectionRecord<F> connection;
    Wavelengths<F> waves;

    TR_INLINE LightPathEntry(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape, int kind, uint32_t i,
                             const MaskOf<F> &active)
        : begins(kind == EmissionKind), v(read_vertex<F>(tape, i)), connection(read_connection<F>(tape, i)) {
        Entries<F> from(i);
        slot = active_only<F>(from(tape.vertex.slot), active);
        parent = active_only<F>(from(tape.vertex.parent), active);
        if (begins) {
            read_outgoing(tape, i, v);
            v.normal = from(tape.scattering.normal);
        } else {
            read_scattering(tape, i, v);
        }
        read_arrival(tape, i, v);
        LaneSet<F> lanes(slot, active);
        waves = wavelengths_of<F>(c.config, lanes(c.slots.pixel), lanes(c.slots.sample));
    }

    // Where light travels to the camera: from the light itself,
    TR_INLINE Vec3<F> emitted_to_camera(const LightSensor<ScalarOf<F>> &sensor) const {
        const auto &o = sensor.camera.origin;
        const Vec3<F> to = Vec3<F>{F(o.x), F(o.y), F(o.z)} - v.p;
        const F length2 = squared_norm(to);
        auto some = mask<F>(length2 > F(0));
        return select(some, to * (F(1) / sqrt(select(some, length2, F(1)))), v.d);
    }
    // ... and from a surface.
    TR_INLINE Vec3<F> scattered_to_camera(const SceneOf<F> &scene) const {
        return model_frame(scene, v).to_world(v.wo_light);
    }
    TR_INLINE PolarizedLight<F> lamp(const SweepContext<F> &c, const MaskOf<F> &active) const {
        return {c.scene, v.light, active};
    }
    // The film's row for what the connection brings along k.
    TR_INLINE Stokes<F> film(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape, uint32_t i,
                             const Vec3<F> &k) const {
        Entries<F> from(i);
        const auto &s = tape.connected;
        return {{v.emitted, from(s.q), from(s.u), from(s.v)}, film_axis(c.scene, c.config.sensor, k)};
    }
};

// The beginning: an emitter's own connection, and its light along the path. Its numbers are those of polarised light;
// its shares, its axis and the film's move besides.
template <class F>
TR_INLINE void sweep_polarized_emission(const SweepContext<F> &c, const LightSensor<ScalarOf<F>> &sensor,
                                        const TapeColumns<ScalarOf<F>> &tape, const LightPathEntry<F> &entry,
                                        uint32_t i, NextVertex<F> next, const MaskOf<F> &active,
                                        GradientSink<F> &sink) {
    const SceneOf<F> &scene = c.scene;
    const GradientNeeds &needs = c.needs;
    VertexRecord<F> v = entry.v;
    EmissionRecord<F> e{v, entry.connection, Entries<F>(i)(tape.connection.emitter_kind), v.beta};
    const PolarizedLight<F> lamp = entry.lamp(c, active);
    const Vec3<F> to_camera = entry.emitted_to_camera(sensor), zero{F(0), F(0), F(0)};
    const Stokes<F> behind = seen_from_behind(column_behind<F>(tape, i)), film = entry.film(c, tape, i, to_camera);
    next.radiance = lamp.contracted(behind, v.d);
    v.emitted = lamp.contracted(film, to_camera);
    if (scene.polarized_lights && (needs.emitter || needs.geometry)) {
        const MaskOf<F> lit = active && mask<F>(v.light_weight > F(0));
        const Spectrum<F> sent = v.beta * v.inverse_pdf, seen = v.beta * v.light_weight;
        Vec3<F> d_bar = zero;
        Vec3<F> tangent_bar = lamp.sweep(scene, v.light, v.d, behind, sent, needs, active, d_bar, sink);
        if (any(lit)) {
            const Vec3<F> by_camera = lamp.sweep(scene, v.light, to_camera, film, seen, needs, lit, v.way.d, sink);
            tangent_bar = tangent_bar + select(lit, by_camera, zero);
        }
        if (needs.geometry) {
            if (any(lit)) {
                const Stokes<F> column = turned_column(lamp.of(seen), film.axis, to_camera);
                sweep_film_axis(scene, c.config.sensor, to_camera, component_sum(by_angle(film, column)), needs.camera,
                                lit, v.way.d, sink);
                v.way.d = select(lit, v.way.d, zero);
            }
            const EmitterFlags<F> flags(scene, e.kind);
            const MaskOf<F> on_shape = active && flags.has(IsOnShape), beam = flags.has(IsBeam),
                            parallel = beam || flags.has(IsInfinite);
            // a direction of its own, or that to the next point
            next.ray.d = next.ray.d + select(parallel, d_bar, zero);
            const Vec3<F> D_bar = direction_adjoint(next.segment, select(parallel, zero, d_bar));
            next.ray.o = next.ray.o - D_bar;
            const MaskOf<F> meets = active && !parallel && mask<F>(squared_norm(next.segment) > F(0));
            if (any(meets)) sweep_position(scene, next.at, next.p, D_bar, meets, sink);
            if (any(on_shape)) {
                HitAdjoint<F> hit;
                hit.tangent = tangent_bar;
                sweep_area(scene, v.light.at, v.p, v.normal, F(0), hit, on_shape, sink);
            }
        }
    }
    sweep_emission(scene, sensor, e, next, needs, active, sink);
}

}  // namespace

template <class F>
TR_LARGE void hand_light(const SweepContext<F> &c, const LightSensor<ScalarOf<F>> &sensor,
                         const TapeColumns<ScalarOf<F>> &tape, const TapeColumns<ScalarOf<F>> *parents, int kind,
                         uint32_t i, const MaskOf<F> &active) {
    const LightPathEntry<F> entry(c, tape, kind, i, active);
    const VertexRecord<F> &v = entry.v;
    Stokes<F> row, brought;
    Vec3<F> k;  // to the camera
    if (entry.begins) {
        k = entry.emitted_to_camera(sensor);
        const PolarizedLight<F> lamp = entry.lamp(c, active);
        row = seen_from_behind(lamp.of(v.beta * v.inverse_pdf));
        brought = lamp.of(v.beta * v.light_weight);
    } else {
        k = entry.scattered_to_camera(c.scene);
        const Stokes<F> arriving = row_before<F>(*parents, entry.parent, active);
        const PolarizedConnection<F> connection{sensor, c.config.sensor, entry.connection, no_stokes<F>()};
        const PolarizedVertex<F> vertex(c.scene, entry.waves, kind, v, c.needs, active, &connection);
        row = vertex.row(arriving);
        brought = seen_from_behind(vertex.row(arriving, true));
    }
    brought = turned_column(brought, film_axis(c.scene, c.config.sensor, k), k);
    write_row<F>(tape, i, row);
    write(tape.outgoing.emitted, i, brought.at[0]), write(tape.connected.q, i, brought.at[1]);
    write(tape.connected.u, i, brought.at[2]), write(tape.connected.v, i, brought.at[3]);
}

template <class F>
TR_LARGE void sweep_polarized_light_vertex(const SweepContext<F> &c, const LightSensor<ScalarOf<F>> &sensor,
                                           const TapeColumns<ScalarOf<F>> &tape,
                                           const TapeColumns<ScalarOf<F>> *parents, int kind, uint32_t i,
                                           const MaskOf<F> &active, GradientSink<F> &sink) {
    const GradientNeeds &needs = c.needs;
    LightPathEntry<F> entry(c, tape, kind, i, active);
    VertexRecord<F> &v = entry.v;
    sink.begin(entry.waves);
    const NextVertex<F> next = read_next<F>(tape, i, needs.geometry);
    if (entry.begins) {
        sweep_polarized_emission(c, sensor, tape, entry, i, next, active, sink);
    } else {
        const Stokes<F> arriving = row_before<F>(*parents, entry.parent, active), behind = column_behind<F>(tape, i);
        const Vec3<F> k = entry.scattered_to_camera(c.scene);
        const PolarizedConnection<F> connection{sensor, c.config.sensor, entry.connection,
                                                seen_from_behind(entry.film(c, tape, i, k))};
        const PolarizedVertex<F> vertex(c.scene, entry.waves, kind, v, needs, active, &connection);
        HitAdjoint<F> hit;
        Vec3<F> d_bar{F(0), F(0), F(0)};
        const F arrived = vertex.sweep(c.scene, kind, v, arriving, behind, next, needs, active, hit, d_bar, sink);
        hand_stokes<F>(*parents, entry.parent, vertex.column(behind), active);
        if (needs.geometry) {
            const RayAdjoint<F> ray =
                sweep_surface(c.scene, v.at, v.p, arrival_of(v, d_bar, arrived), hit, active, sink);
            hand_motion(*parents, entry.parent, ray, glued_segment(v, active), v.p, v.at, active);
        }
    }
    if (sink.forward) add_to_entries<F>(c.slots.radiance, entry.slot, sink.derivative, active);
}

#define TR_INSTANTIATE(F, S)                                                                                  \
    template void hand_light(const SweepContext<F> &, const LightSensor<S> &, const TapeColumns<S> &,         \
                             const TapeColumns<S> *, int, uint32_t, const MaskOf<F> &);                       \
    template void sweep_polarized_light_vertex(const SweepContext<F> &, const LightSensor<S> &,               \
                                               const TapeColumns<S> &, const TapeColumns<S> *, int, uint32_t, \
                                               const MaskOf<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
