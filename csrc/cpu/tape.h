// The columns of a tile: the front of the paths (one entry a ray in flight), the shadow rays of a step, and the path
// tape, one level a vertex.
#pragma once

#include <vector>

#include "columns.h"
#include "core/adjoint/medium.h"
#include "core/adjoint/particle.h"

namespace tr {

template <class S, int C>
struct Front {
    Arena arena;
    size_t n = 0;
    S *o[3], *d[3], *length;  // the ray
    S *from[3], *pdf;         // Origin
    S *beta[C], *eta;
    S *survival[C];  // the throughput that roulette looks at; beta itself in the primal
    uint32_t *slot, *parent, *seen;
    // volumetric paths: the medium the ray is in or -1, scatterings so far, the weights of the channels' densities
    // where extinction is coloured, and how far the ray's origin is ahead of the surface it leaves: the medium begins
    // there
    uint32_t *medium, *depth;
    S *channel[C], *lag;

    // An upper bound for the columns below.
    static constexpr size_t Columns = 18 + 3 * C;
    template <class Visit>
    void for_columns(Visit &&visit) const {
        for (S *p : {o[0], o[1], o[2], d[0], d[1], d[2], length, from[0], from[1], from[2], pdf, eta, lag}) visit(p);
        for (auto *p : {&beta, &survival, &channel})
            for (int c = 0; c < C; ++c) visit((*p)[c]);
        for (uint32_t *p : {slot, parent, seen, medium, depth}) visit(p);
    }

    void allocate(size_t capacity) {
        arena.allocate([&](Arena &a) {
            for (S **p :
                 {&o[0], &o[1], &o[2], &d[0], &d[1], &d[2], &length, &from[0], &from[1], &from[2], &pdf, &eta, &lag})
                a.column(*p, capacity);
            for (auto *p : {&beta, &survival, &channel}) a.column(*p, capacity);
            for (uint32_t **p : {&slot, &parent, &seen, &medium, &depth}) a.column(*p, capacity);
        });
    }
};

template <class S, int C>
struct ShadowRays {
    Arena arena;
    size_t n = 0;
    S *o[3], *d[3], *length, *lag, *contribution[C];
    uint32_t *slot, *position;   // position: entry of the tape level
    uint32_t *medium, *purpose;  // volumetric paths, see ShadowPurpose

    void allocate(size_t capacity) {
        arena.allocate([&](Arena &a) {
            a.column(o, capacity);
            a.column(d, capacity);
            a.column(length, capacity);
            a.column(lag, capacity);
            a.column(contribution, capacity);
            for (uint32_t **p : {&slot, &position, &medium, &purpose}) a.column(*p, capacity);
        });
    }
};

// Entries that one BSDF model handles, or the environment, or the media that rays have collided with, or emitters, from
// which light paths begin.
struct Segment {
    static constexpr int Miss = LeafBsdfs::Size, Collision = Miss + 1, Emission = Collision + 1;
    int kind;
    uint32_t begin, count;
};

// The columns of a level that volumetric paths add, see FlightRecord. By entry of the level.
template <class S, int C>
struct VolumeColumns {
    Arena arena;
    int32_t *medium, *shadow_medium;
    uint32_t *glow_behind;
    S *length, *probe[3], *shadow[3], *shadow_length, *glow[3];
    S *probe_value[C], *shadow_value[C], *through[C], *first[C], *weight[C], *glow_weight[C];

    void allocate(size_t n) {
        arena.allocate([&](Arena &a) {
            for (int32_t **p : {&medium, &shadow_medium}) a.column(*p, n);
            a.column(glow_behind, n);
            for (S **p : {&length, &shadow_length}) a.column(*p, n);
            for (auto *p : {&probe, &shadow, &glow}) a.column(*p, n);
            for (auto *p : {&probe_value, &shadow_value, &through, &first, &weight, &glow_weight}) a.column(*p, n);
        });
    }

    template <class F>
    TR_INLINE void put_flight(size_t i, const IntOf<F> &medium_, const F &length_) {
        store(medium + i, medium_);
        store(length + i, length_);
        store(shadow_medium + i, IntOf<F>(-1));
        store(shadow_length + i, F(0));
        store(glow_behind + i, UIntOf<F>(0u));
        for (S *const *p : {probe, shadow, glow})
            for (int a = 0; a < 3; ++a) store(p[a] + i, F(0));
        for (S *const *p : {probe_value, shadow_value, first, glow_weight})
            for (int c = 0; c < C; ++c) store(p[c] + i, F(0));
        for (S *const *p : {through, weight})
            for (int c = 0; c < C; ++c) store(p[c] + i, F(1));
    }
    template <class F>
    TR_INLINE void put_weight(size_t i, const Color<F, C> &weight_) {
        for (int c = 0; c < C; ++c) store(weight[c] + i, weight_[c]);
    }
    template <class F>
    TR_INLINE void put_probe(size_t i, const Vec3<F> &p) {
        store(probe[0] + i, p.x), store(probe[1] + i, p.y), store(probe[2] + i, p.z);
    }
    template <class F>
    TR_INLINE void put_glow(size_t i, const Vec3<F> &p, const MaskOf<F> &behind, const Color<F, C> &weight_,
                            const Color<F, C> &first_) {
        store(glow[0] + i, p.x), store(glow[1] + i, p.y), store(glow[2] + i, p.z);
        store(glow_behind + i, select(mask<UIntOf<F>>(behind), UIntOf<F>(1u), UIntOf<F>(0u)));
        for (int c = 0; c < C; ++c) store(glow_weight[c] + i, weight_[c]), store(first[c] + i, first_[c]);
    }

    template <class F>
    TR_INLINE FlightRecord<F, C> get(size_t i) const {
        auto integer = [&](const int32_t *p) {
            return IntOf<F>(load_uint<F>(reinterpret_cast<const uint32_t *>(p) + i));
        };
        FlightRecord<F, C> r;
        r.medium = integer(medium), r.shadow_medium = integer(shadow_medium);
        r.length = load<F>(length + i), r.shadow_length = load<F>(shadow_length + i);
        r.probe = load_vec<F>(probe, i), r.shadow = load_vec<F>(shadow, i), r.glow = load_vec<F>(glow, i);
        r.glow_behind = mask<F>(load_uint<F>(glow_behind + i) != UIntOf<F>(0u));
        r.probe_value = load_color<F>(probe_value, i), r.shadow_value = load_color<F>(shadow_value, i);
        r.first = load_color<F>(first, i), r.weight = load_color<F>(weight, i),
        r.glow_weight = load_color<F>(glow_weight, i);
        return r;
    }
};

// The columns of a level that light paths add, see ConnectionRecord. By entry of the level.
template <class S>
struct LightColumns {
    Arena arena;
    S *x_bar, *y_bar, *ng[3];
    int32_t *emitter_kind;

    void allocate(size_t n) {
        arena.allocate([&](Arena &a) {
            for (S **p : {&x_bar, &y_bar}) a.column(*p, n);
            a.column(ng, n);
            a.column(emitter_kind, n);
        });
    }
    template <class F>
    TR_INLINE void put(size_t i, const Vec3<F> &normal) {
        store(x_bar + i, F(0)), store(y_bar + i, F(0));
        store(ng[0] + i, normal.x), store(ng[1] + i, normal.y), store(ng[2] + i, normal.z);
    }
    template <class F>
    TR_INLINE ConnectionRecord<F> get(size_t i) const {
        return {load<F>(x_bar + i), load<F>(y_bar + i), load_vec<F>(ng, i)};
    }
};

// The columns of a level that layered scenes add: what a leaf was found from, see Leaf. By entry of the level.
template <class S>
struct LayerColumns {
    Arena arena;
    S *choice = nullptr, *base[3];

    void allocate(size_t n) {
        arena.allocate([&](Arena &a) {
            a.column(choice, n);
            a.column(base, n);
        });
    }
    template <class F>
    TR_INLINE void put(size_t i, const F &choice_, const Vec3<F> &base_) {
        if (!choice) return;
        store(choice + i, choice_);
        store(base[0] + i, base_.x), store(base[1] + i, base_.y), store(base[2] + i, base_.z);
    }
    template <class F, int C>
    TR_INLINE void get(size_t i, VertexRecord<F, C> &v) const {
        if (!choice) return;
        v.choice = load<F>(choice + i);
        v.base = load_vec<F>(base, i);
    }
};

// The column of a level that oriented scenes add: the first axis of the local frame. By entry of the level.
template <class S>
struct OrientationColumns {
    Arena arena;
    S *s[3] = {nullptr, nullptr, nullptr};

    void allocate(size_t n) {
        arena.allocate([&](Arena &a) { a.column(s, n); });
    }
    template <class F>
    TR_INLINE void put(size_t i, const Vec3<F> &axis) {
        if (!s[0]) return;
        store(s[0] + i, axis.x), store(s[1] + i, axis.y), store(s[2] + i, axis.z);
    }
    template <class F, int C>
    TR_INLINE void get(size_t i, VertexRecord<F, C> &v) const {
        if (s[0]) v.s = load_vec<F>(s, i);
    }
};

// Of the paths that go on from probes: the segment each belongs to, and what it brings. By slot of the tile.
template <class S, int C>
struct BranchColumns {
    const uint32_t *level = nullptr, *entry = nullptr;
    S *const *radiance = nullptr;
};

template <class S, int C>
struct TapeLevel {
    Arena arena;
    size_t capacity = 0;
    std::vector<Segment> segments;
    static constexpr int NoParent = -1, InBlockBefore = -2;
    int parent_level = NoParent;
    bool scatters = false;
    VolumeColumns<S, C> volume;         // of volumetric paths
    LightColumns<S> light;              // of light paths
    LayerColumns<S> layers;             // of layered scenes
    OrientationColumns<S> orientation;  // of oriented scenes

    uint32_t *slot, *parent, *shape, *primitive, *light_shape, *light_primitive;
    int32_t *emission_emitter, *bsdf, *light_emitter, *lobe;
    S *b1, *b2, *emission_weight, *wi[3], *wo_light[3], *light_weight, *light_b1, *light_b2, *wo[3], *inverse_pdf;
    S *light_distance, *mirror, *normal[3], *uv[2];
    S *beta[C], *emission_radiance[C], *emitted[C];
    // from the next vertex, written by the sweep; and what only moving things need, see VertexRecord
    S *suffix[C], *ray_bar[6], *next_segment[3], *next_p[3], *next_b[2];
    uint32_t *next_shape, *next_primitive;
    S *d[3], *p[3], *segment[3], *t;
    uint32_t *attached;

    void reserve(size_t n, bool volumetric, bool of_light, const SceneView<S> &scene) {
        if (n <= capacity) return;
        capacity = n;
        if (volumetric) volume.allocate(n);
        if (of_light) light.allocate(n);
        if (scene.layered) layers.allocate(n);
        if (scene.oriented) orientation.allocate(n);
        arena.allocate([&](Arena &a) {
            for (uint32_t **p : {&slot, &parent, &shape, &primitive, &light_shape, &light_primitive, &attached,
                                 &next_shape, &next_primitive})
                a.column(*p, n);
            for (int32_t **p : {&emission_emitter, &bsdf, &light_emitter, &lobe}) a.column(*p, n);
            for (S **p : {&b1, &b2, &emission_weight, &light_weight, &light_b1, &light_b2, &inverse_pdf,
                          &light_distance, &mirror, &t})
                a.column(*p, n);
            for (auto *p : {&wi, &wo_light, &wo, &normal, &d, &this->p, &segment, &next_segment, &next_p})
                a.column(*p, n);
            a.column(ray_bar, n);
            a.column(next_b, n);
            a.column(uv, n);
            for (auto *p : {&beta, &emission_radiance, &emitted, &suffix}) a.column(*p, n);
        });
    }

    // An entry's numbers, written a packet at a time.
    template <class F>
    TR_INLINE void put_vertex(size_t i, const UIntOf<F> &slot_, const UIntOf<F> &parent_, const Color<F, C> &beta_,
                              const SurfacePoint<F> &at, const Emission<F, C> &e) {
        store(slot + i, slot_);
        store(parent + i, parent_);
        store(shape + i, at.shape);
        store(primitive + i, at.primitive);
        store(b1 + i, at.b1);
        store(b2 + i, at.b2);
        store(emission_emitter + i, e.point.emitter);
        store(emission_weight + i, e.weight);
        for (int c = 0; c < C; ++c) {
            store(beta[c] + i, beta_[c]);
            store(emission_radiance[c] + i, e.radiance[c]);
            store(suffix[c] + i, F(0));
        }
    }
    template <class F>
    TR_INLINE void put_motion(size_t i, const Vec3<F> &d_, const Vec3<F> &p_, const Vec3<F> &segment_, const F &t_,
                              const MaskOf<F> &attached_, const MaskOf<F> &parallel = MaskOf<F>(false)) {
        put(d, i, d_);
        put(p, i, p_);
        put(segment, i, segment_);
        store(t + i, t_);
        using U = UIntOf<F>;
        store(attached + i, select(mask<U>(attached_), U(1u), select(mask<U>(parallel), U(2u), U(0u))));
        for (S *column : ray_bar) store(column + i, F(0));
        put(next_segment, i, Vec3<F>{F(0), F(0), F(0)});
    }
    template <class F>
    TR_INLINE void put_scattering(size_t i, const Leaf<F> &leaf, const Vec2<F> &uv_, const Vec3<F> &wi_,
                                  const Frame<F> &frame, const Scattering<F, C> &s, const F &inverse_pdf_) {
        store(bsdf + i, leaf.bsdf);
        store(uv[0] + i, uv_.x);
        store(uv[1] + i, uv_.y);
        put(wi, i, wi_);
        put_light(i, s.light.point, s.wo_light, s.light_weight, s.emitted, s.light.distance);
        put_direction(i, s.sample.wo, s.sample.lobe, inverse_pdf_);
        store(mirror + i, select(leaf.mirrored, F(-1), F(1)));
        put(normal, i, frame.n);
        layers.put(i, leaf.choice, leaf.base);
        orientation.put(i, frame.s);
    }

    // The same of a light path; put_connection follows.
    template <class F>
    TR_INLINE void put_light_scattering(size_t i, const Leaf<F> &leaf, const Vec2<F> &uv_, const Vec3<F> &wi_,
                                        const Frame<F> &frame, const Vec3<F> &ng, const LightScattering<F, C> &s,
                                        const F &inverse_pdf_) {
        store(bsdf + i, leaf.bsdf);
        store(uv[0] + i, uv_.x);
        store(uv[1] + i, uv_.y);
        put(wi, i, wi_);
        put_light(i, no_emitter_sample<F>().point, s.wo_camera, F(0), uniform_color<C>(F(0)), F(1));
        put_direction(i, s.sample.wo, s.sample.lobe, inverse_pdf_);
        store(mirror + i, select(leaf.mirrored, F(-1), F(1)));
        put(normal, i, frame.n);
        layers.put(i, leaf.choice, leaf.base);
        orientation.put(i, frame.s);
        light.put(i, ng);
    }
    template <class F>
    TR_INLINE void put_connection(size_t i, const Vec3<F> &wo_camera, const F &weight) {
        put(wo_light, i, wo_camera);
        store(light_weight + i, weight);
    }
    // The beginning of a light path, see EmissionRecord.
    template <class F>
    TR_INLINE void put_emission(size_t i, const UIntOf<F> &slot_, const Color<F, C> &sent, const EmitterPoint<F> &point,
                                const Vec3<F> &p_, const Vec3<F> &n_, const Vec3<F> &d_, const IntOf<F> &kind,
                                const F &weight) {
        Vec3<F> zero{F(0), F(0), F(0)}, z{F(0), F(0), F(1)};
        Emission<F, C> none;
        none.point.emitter = IntOf<F>(-1);
        none.weight = F(0);
        none.radiance = uniform_color<C>(F(0));
        put_vertex(i, slot_, slot_, sent, point.at, none);
        put_motion(i, d_, p_, zero, F(0), MaskOf<F>(false));
        put_light(i, point, z, F(0), uniform_color<C>(F(0)), F(1));
        put_direction(i, z, IntOf<F>(0), weight);
        put(normal, i, n_);
        light.put(i, n_);
        store(light.emitter_kind + i, kind);
    }
    template <class F>
    TR_INLINE EmissionRecord<F, C> get_emission(size_t i) const {
        EmissionRecord<F, C> e;
        e.v = get<F>(i, false);
        get_outgoing(i, e.v);
        get_motion(i, e.v);
        e.v.normal = load_vec<F>(normal, i);
        e.connection = light.template get<F>(i);
        e.kind = IntOf<F>(load_uint<F>(reinterpret_cast<const uint32_t *>(light.emitter_kind) + i));
        e.radiance = e.v.beta;
        return e;
    }

    template <class F>
    TR_INLINE void put_light(size_t i, const EmitterPoint<F> &point, const Vec3<F> &wo_light_, const F &weight_,
                             const Color<F, C> &emitted_, const F &distance_) {
        store(light_emitter + i, point.emitter);
        store(light_shape + i, point.at.shape);
        store(light_primitive + i, point.at.primitive);
        store(light_b1 + i, point.at.b1);
        store(light_b2 + i, point.at.b2);
        put(wo_light, i, wo_light_);
        store(light_weight + i, weight_);
        for (int c = 0; c < C; ++c) store(emitted[c] + i, emitted_[c]);
        store(light_distance + i, distance_);
    }
    template <class F>
    TR_INLINE void put_direction(size_t i, const Vec3<F> &wo_, const IntOf<F> &lobe_, const F &inverse_pdf_) {
        put(wo, i, wo_);
        store(lobe + i, lobe_);
        store(inverse_pdf + i, inverse_pdf_);
    }
    // A boundary that rays pass through unchanged: no emitter sample, and all that comes from behind it.
    template <class F>
    TR_INLINE void put_passage(size_t i, const F &passes) {
        Vec3<F> z{F(0), F(0), F(1)};
        put_light(i, no_emitter_sample<F>().point, z, F(0), uniform_color<C>(F(0)), F(1));
        put_direction(i, z, IntOf<F>(0), passes);
        put(wi, i, z);
        put(normal, i, z);
        store(bsdf + i, IntOf<F>(0));
        store(mirror + i, F(1));
        layers.put(i, F(0), z);
        orientation.put(i, Vec3<F>{F(1), F(0), F(0)});
        for (S *column : uv) store(column + i, F(0));
    }
    // A collision in a medium: where, and the direction of travel.
    template <class F>
    TR_INLINE void put_point(size_t i, const Vec3<F> &p_, const Vec3<F> &d_) {
        put(p, i, p_);
        put(d, i, d_);
    }
    template <class F>
    TR_INLINE VertexRecord<F, C> get_collision(size_t i) const {
        VertexRecord<F, C> v = get<F>(i, false);
        get_outgoing(i, v);
        v.p = load_vec<F>(p, i);
        v.d = load_vec<F>(d, i);
        return v;
    }

    template <class F>
    TR_INLINE VertexRecord<F, C> get(size_t i, bool scattering) const {
        VertexRecord<F, C> v;
        v.at = {{load_uint<F>(shape + i), load_uint<F>(primitive + i), load<F>(b1 + i), load<F>(b2 + i)}, {F(0), F(0)}};
        v.emission = {IntOf<F>(load_uint<F>(reinterpret_cast<const uint32_t *>(emission_emitter) + i)), v.at};
        v.emission_weight = load<F>(emission_weight + i);
        v.beta = load_color<F>(beta, i);
        v.emission_radiance = load_color<F>(emission_radiance, i);
        if (!scattering) return v;
        v.at.uv = {load<F>(uv[0] + i), load<F>(uv[1] + i)};
        v.bsdf = IntOf<F>(load_uint<F>(reinterpret_cast<const uint32_t *>(bsdf) + i));
        v.wi = load_vec<F>(wi, i);
        get_outgoing(i, v);
        v.mirror = load<F>(mirror + i);
        v.normal = load_vec<F>(normal, i);
        layers.get(i, v);
        orientation.get(i, v);
        return v;
    }
    // To the light, and on along the path.
    template <class F>
    TR_INLINE void get_outgoing(size_t i, VertexRecord<F, C> &v) const {
        auto integer = [&](const int32_t *p) {
            return IntOf<F>(load_uint<F>(reinterpret_cast<const uint32_t *>(p) + i));
        };
        v.light = {integer(light_emitter),
                   {load_uint<F>(light_shape + i), load_uint<F>(light_primitive + i), load<F>(light_b1 + i),
                    load<F>(light_b2 + i)}};
        v.wo_light = load_vec<F>(wo_light, i);
        v.light_weight = load<F>(light_weight + i);
        v.emitted = load_color<F>(emitted, i);
        v.wo = load_vec<F>(wo, i);
        v.lobe = integer(lobe);
        v.inverse_pdf = load<F>(inverse_pdf + i);
        v.light_distance = load<F>(light_distance + i);
    }
    template <class F>
    TR_INLINE void get_motion(size_t i, VertexRecord<F, C> &v) const {
        v.d = load_vec<F>(d, i);
        v.p = load_vec<F>(p, i);
        v.segment = load_vec<F>(segment, i);
        v.t = load<F>(t + i);
        v.attached = mask<F>(load_uint<F>(attached + i) == 1u);
    }
    template <class F>
    TR_INLINE NextVertex<F, C> get_next(size_t i, bool motion) const {
        Vec3<F> zero{F(0), F(0), F(0)};
        NextVertex<F, C> next{load_color<F>(suffix, i), {zero, zero}, zero, zero, {}};
        if (!motion) return next;
        next.ray.o = {load<F>(ray_bar[0] + i), load<F>(ray_bar[1] + i), load<F>(ray_bar[2] + i)};
        next.ray.d = {load<F>(ray_bar[3] + i), load<F>(ray_bar[4] + i), load<F>(ray_bar[5] + i)};
        next.segment = load_vec<F>(next_segment, i);
        next.p = load_vec<F>(next_p, i);
        next.at = {load_uint<F>(next_shape + i), load_uint<F>(next_primitive + i), load<F>(next_b[0] + i),
                   load<F>(next_b[1] + i)};
        return next;
    }

private:
    template <class F>
    TR_INLINE static void put(S *const (&column)[3], size_t i, const Vec3<F> &v) {
        store(column[0] + i, v.x);
        store(column[1] + i, v.y);
        store(column[2] + i, v.z);
    }
};

}  // namespace tr
