// The path tape, one level a vertex of all paths of a batch: what the derivative of a vertex needs (VertexRecord), and
// what it is handed by the vertex behind it. Groups of columns that a scene or a derivative does not need are not
// there: their arrays are null.
#pragma once

#include "../adjoint/vertex.h"
#include "queues.h"

namespace tr {

// clang-format off
// Every vertex; `slot` is NoSlot where nothing has a derivative (see PathContext::bsdfs_alone); `suffix` is the radiance
// from the next one, which the sweep writes.
#define TR_VERTEX_COLUMNS(X) \
    X(Index, slot) X(Index, parent) X(Point, at) X(Spectrum, beta) X(Integer, emission_emitter) \
    X(Number, emission_weight) X(Spectrum, emission_radiance) X(Spectrum, suffix)
// Where it goes on: to an emitter, and along the path.
#define TR_OUTGOING_COLUMNS(X) \
    X(Integer, light_emitter) X(Point, light_at) X(Vector, wo_light) X(Number, light_weight) \
    X(Number, light_distance) X(Spectrum, emitted) X(Vector, wo) X(Integer, lobe) X(Number, inverse_pdf)
// Surfaces that scatter.
#define TR_SCATTERING_COLUMNS(X) X(Integer, bsdf) X(Pair, uv) X(Vector, wi) X(Vector, normal) X(Number, mirror)
// Scenes with stacks of BSDFs, see ResolvedBsdf; and with frames that follow the tangent: their first axis.
#define TR_STACK_COLUMNS(X) X(Number, choice) X(Vector, base_normal)
#define TR_TANGENT_COLUMNS(X) X(Vector, s)
// Where something moves; in media the ray alone. How the ray arrived, see ArrivalKind.
#define TR_ARRIVAL_COLUMNS(X) X(Vector, d) X(Vector, p) X(Vector, segment) X(Number, t) X(Index, arrival)
// What the vertex behind hands on, see NextVertex.
#define TR_NEXT_COLUMNS(X) \
    X(Vector, ray_o_bar) X(Vector, ray_d_bar) X(Vector, next_segment) X(Vector, next_p) X(Point, next_at)
// Segments through media, see SegmentRecord.
#define TR_SEGMENT_COLUMNS(X) \
    X(Integer, medium) X(Number, length) X(Spectrum, weight) X(Spectrum, through) X(Vector, differential_p) \
    X(Spectrum, differential_value) X(Integer, shadow_medium) X(Number, shadow_length) X(Vector, shadow_p) \
    X(Spectrum, shadow_value) X(Vector, emission_p) X(Index, emission_behind) X(Spectrum, first) \
    X(Spectrum, emission_factor)
// ... where something moves: the place that a segment begins at, the boundary at its end and how far that is (NoHit,
// infinity: there is none), distances of its points; the part of the shadow ray that has `shadow_p`, its boundaries and
// distances along the ray's direction; what the vertex behind hands on besides, see NextVertex.
#define TR_MOTION_COLUMNS(X) \
    X(Vector, line) X(Number, ahead) X(Point, end_at) X(Number, reach) X(Number, differential_t) \
    X(Number, emission_t) X(Number, stop_t) X(Vector, shadow_d) X(Point, shadow_from) X(Point, shadow_to) \
    X(Number, shadow_t0) X(Number, shadow_t1) X(Number, shadow_t) X(Vector, rest_bar) X(Vector, from_bar)
// Vertices of light paths, see ConnectionRecord and EmissionRecord.
#define TR_CONNECTION_COLUMNS(X) X(Number, x_bar) X(Number, y_bar) X(Vector, ng) X(Integer, emitter_kind)
// Of polarised light: the row for what arrives from the vertex behind, and the column of that, whose intensity is
// `suffix`; see adjoint/polarization.h. In media the direction to the light that a differential sample has drawn, whose
// `differential_value` then is without the throughput; shares and axis of that light, if some lights are polarised.
#define TR_STOKES_COLUMNS(X) \
    X(Spectrum, row_i) X(Spectrum, row_q) X(Spectrum, row_u) X(Spectrum, row_v) X(Vector, row_axis) \
    X(Spectrum, column_q) X(Spectrum, column_u) X(Spectrum, column_v) X(Vector, column_axis) \
    X(Vector, differential_light) X(Vector, differential_shares) X(Vector, differential_axis)
// ... of light paths: what a connection brings to the film, on its axis, and then its adjoint; the intensity is that of
// `emitted`.
#define TR_CONNECTED_COLUMNS(X) X(Spectrum, q) X(Spectrum, u) X(Spectrum, v)
// clang-format on

constexpr uint32_t NoSlot = 0xFFFFFFFFu;

TR_PACKET(VertexPacket, TR_VERTEX_COLUMNS)
TR_PACKET(OutgoingPacket, TR_OUTGOING_COLUMNS)
TR_PACKET(ScatteringPacket, TR_SCATTERING_COLUMNS)
TR_PACKET(StackPacket, TR_STACK_COLUMNS)
TR_PACKET(TangentPacket, TR_TANGENT_COLUMNS)
TR_PACKET(ArrivalPacket, TR_ARRIVAL_COLUMNS)
TR_PACKET(NextPacket, TR_NEXT_COLUMNS)
TR_PACKET(SegmentPacket, TR_SEGMENT_COLUMNS)
TR_PACKET(MotionPacket, TR_MOTION_COLUMNS)
TR_PACKET(ConnectionPacket, TR_CONNECTION_COLUMNS)

#define TR_TAPE_GROUP(name, LIST) \
    template <class S>            \
    struct name##Columns {        \
        TR_COLUMNS(LIST)          \
    };
TR_TAPE_GROUP(Vertex, TR_VERTEX_COLUMNS)
TR_TAPE_GROUP(Outgoing, TR_OUTGOING_COLUMNS)
TR_TAPE_GROUP(Scattering, TR_SCATTERING_COLUMNS)
TR_TAPE_GROUP(Stack, TR_STACK_COLUMNS)
TR_TAPE_GROUP(Tangent, TR_TANGENT_COLUMNS)
TR_TAPE_GROUP(Arrival, TR_ARRIVAL_COLUMNS)
TR_TAPE_GROUP(Next, TR_NEXT_COLUMNS)
TR_TAPE_GROUP(Segment, TR_SEGMENT_COLUMNS)
TR_TAPE_GROUP(Motion, TR_MOTION_COLUMNS)
TR_TAPE_GROUP(Connection, TR_CONNECTION_COLUMNS)
TR_TAPE_GROUP(Stokes, TR_STOKES_COLUMNS)
TR_TAPE_GROUP(Connected, TR_CONNECTED_COLUMNS)
#undef TR_TAPE_GROUP

template <class S>
struct TapeColumns {
    VertexColumns<S> vertex{};
    OutgoingColumns<S> outgoing{};
    ScatteringColumns<S> scattering{};
    ArrivalColumns<S> arrival{};
    NextColumns<S> next{};
    StackColumns<S> stack{};
    TangentColumns<S> tangent{};
    SegmentColumns<S> segment{};
    MotionColumns<S> motion{};
    ConnectionColumns<S> connection{};
    BentColumns<S> bent{};
    StokesColumns<S> stokes{};
    ConnectedColumns<S> connected{};
};

// How a ray came to a vertex: from something glued to its surface; along a ray that moves with what it comes from, so
// that the hit slides; from a direction at infinity; as the second, in a direction that rests.
enum ArrivalKind : uint32_t { Glued = 0, Attached = 1, Parallel = 2, Resting = 3 };

// ------------------------------------------------------------------------------------------------- the derivative's
// view
template <class F>
TR_INLINE VertexRecord<F> read_vertex(const TapeColumns<ScalarOf<F>> &tape, size_t i) {
    Entries<F> from(i);
    const auto &c = tape.vertex;
    VertexRecord<F> v;
    v.at = {from(c.at), {F(0), F(0)}};
    v.emission = {from(c.emission_emitter), v.at};
    v.emission_weight = from(c.emission_weight);
    v.emission_radiance = from(c.emission_radiance);
    v.beta = from(c.beta);
    return v;
}

template <class F>
TR_INLINE void read_outgoing(const TapeColumns<ScalarOf<F>> &tape, size_t i, VertexRecord<F> &v) {
    Entries<F> from(i);
    const auto &c = tape.outgoing;
    v.light = {from(c.light_emitter), from(c.light_at)};
    v.wo_light = from(c.wo_light);
    v.light_weight = from(c.light_weight);
    v.light_distance = from(c.light_distance);
    v.emitted = from(c.emitted);
    v.wo = from(c.wo);
    v.lobe = from(c.lobe);
    v.inverse_pdf = from(c.inverse_pdf);
}

template <class F>
TR_INLINE void read_scattering(const TapeColumns<ScalarOf<F>> &tape, size_t i, VertexRecord<F> &v) {
    Entries<F> from(i);
    const auto &c = tape.scattering;
    v.at.uv = from(c.uv);
    v.bsdf = from(c.bsdf);
    v.wi = from(c.wi);
    v.normal = from(c.normal);
    v.mirror = from(c.mirror);
    read_outgoing(tape, i, v);
    if (tape.stack.choice.at) v.choice = from(tape.stack.choice), v.base_normal = from(tape.stack.base_normal);
    if (tape.tangent.s.x) v.s = from(tape.tangent.s);
}

template <class F>
TR_INLINE void read_arrival(const TapeColumns<ScalarOf<F>> &tape, size_t i, VertexRecord<F> &v) {
    Entries<F> from(i);
    const auto &c = tape.arrival;
    v.d = from(c.d);
    v.p = from(c.p);
    v.segment = from(c.segment);
    v.t = from(c.t);
    UIntOf<F> kind = from(c.arrival);
    v.resting = mask<F>(kind == uint32_t(Resting));
    v.attached = v.resting || mask<F>(kind == uint32_t(Attached));
    v.parallel = mask<F>(kind == uint32_t(Parallel));
}

// `motion`: with the adjoint of the ray, else the radiance alone.
template <class F>
TR_INLINE NextVertex<F> read_next(const TapeColumns<ScalarOf<F>> &tape, size_t i, bool motion) {
    Entries<F> from(i);
    Vec3<F> zero{F(0), F(0), F(0)};
    NextVertex<F> next{from(tape.vertex.suffix), {zero, zero}, zero, zero, {}};
    if (!motion) return next;
    const auto &c = tape.next;
    next.ray = {from(c.ray_o_bar), from(c.ray_d_bar)};
    next.segment = from(c.next_segment);
    if (tape.motion.rest_bar.x) next.rest = from(tape.motion.rest_bar), next.from = from(tape.motion.from_bar);
    // nothing is glued there, and nothing has been written
    if (Lanes<F>::Width == 1 && !any(mask<F>(squared_norm(next.segment) > F(0)))) return next;
    next.p = from(c.next_p);
    next.at = from(c.next_at);
    return next;
}

template <class F>
TR_INLINE ConnectionRecord<F> read_connection(const TapeColumns<ScalarOf<F>> &tape, size_t i) {
    Entries<F> from(i);
    const auto &c = tape.connection;
    return {from(c.x_bar), from(c.y_bar), from(c.ng)};
}

}  // namespace tr
