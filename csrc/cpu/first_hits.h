// The first hits of a batch of camera rays, and the outputs that are functions of them.
#pragma once

#include "aov.h"
#include "core/adjoint/outputs.h"
#include "core/integrator/path.h"
#include "items.h"
#include "queries.h"
#include "shown.h"

namespace tr {

namespace detail {

template <class F, int C>
class FirstHits {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using I = IntOf<F>;
    using M = MaskOf<F>;
    static constexpr size_t W = size_t(Lanes<F>::Width);

public:
    // by ray; the first four are set before `trace`
    uint32_t *row, *column, *pixel, *sample;
    S *film_y, *film_x, *value[MaxAovChannels];  // value: one column a channel of the layout
    uint32_t *shape, *primitive;                 // shape = Miss: nothing was hit
    uint64_t rays = 0;
    static constexpr uint32_t Miss = Accel::Miss;

    FirstHits(const RenderCall<S> &call, const AovLayout &layout, size_t capacity)
        : call_(call), layout_(layout), scene_(*call.scene), camera_(scene_, scene_.sensors[call.config.sensor]) {
        size_t n = capacity + 2 * W;
        arena_.allocate([&](Arena &a) {
            for (uint32_t **p : {&row, &column, &pixel, &sample, &shape, &primitive}) a.column(*p, n);
            for (S **p : {&film_y, &film_x, &length_, &t_, &b1_, &b2_}) a.column(*p, n);
            a.column(o_, n);
            a.column(d_, n);
            a.column(first_, n);
            a.column(center_, n);
            a.column(lens_, n);
            for (int k = 0; k < layout.n; ++k) a.column(value[k], n);
            if (sizeof(S) == 8) a.column(single_, n);
        });
    }

    // Rays through the samples' film positions (choose_positions), or through the centres of their pixels.
    void trace(const PathConfig &config, size_t n, bool centres) {
        const Record &record = scene_.sensors[config.sensor];
        const bool lens = uses_lens(record);
        if (!centres) choose_positions<F>(config, *this, n);
        for (size_t i = 0; i < n; i += W) {
            CameraSample<F> at;
            at.y = centres ? F(I(load_uint<F>(row + i))) + F(0.5) : load<F>(film_y + i);
            at.x = centres ? F(I(load_uint<F>(column + i))) + F(0.5) : load<F>(film_x + i);
            if (lens && !centres)
                at.choose_lens(draw4<F>(config, load_uint<F>(pixel + i), load_uint<F>(sample + i), 0, 4));
            CameraRay<F> r = camera_ray(scene_, record, at, S(call_.film_width), S(call_.film_height));
            put(o_, i, r.ray.o);
            put(first_, i, r.ray.o);
            put(d_, i, r.ray.d);
            put(center_, i, r.center);
            store(lens_[0] + i, at.lens_x);
            store(lens_[1] + i, at.lens_y);
            store(length_ + i, select(r.exists, r.length, F(-1)));  // a ray of negative length hits nothing
        }
        query(n);
        if (config.hide_emitters) pass_emitters(scene_, o_, d_, length_, shape, t_, n, [&] { query(n); });
    }

    // Calls visit(first entry, active lanes, ray, hit) for packets in which something was hit.
    template <class Visit>
    void for_hits(size_t n, Visit &&visit) {
        for (size_t i = 0; i < n; i += W) {
            U at = load_uint<F>(shape + i);
            M active = mask<F>(at != Miss) && mask<F>(U(uint32_t(i)) + lane_index<F>() < U(uint32_t(n)));
            if (!any(active)) continue;
            SurfacePoint<F> point{select(mask<U>(active), at, U(0u)),
                                  select(mask<U>(active), load_uint<F>(primitive + i), U(0u)), load<F>(b1_ + i),
                                  load<F>(b2_ + i)};
            Ray<F> ray{get(o_, i), get(d_, i)};
            visit(i, active, ray, make_interaction<F>(scene_, ray, point, load<F>(t_ + i), active));
        }
    }

    // The values of the layout's channels; zero at misses.
    void evaluate(size_t n) {
        for (int k = 0; k < layout_.n; ++k) std::memset(value[k], 0, n * sizeof(S));
        for_hits(n, [&](size_t i, const M &active, const Ray<F> &ray, const Interaction<F> &si) {
            auto put_number = [&](int kind, int c, const F &x) {
                store(value[layout_.offset[kind] + c] + i, select(active, x, F(0)));
            };
            auto put_vector = [&](int kind, const Vec3<F> &v) {
                put_number(kind, 0, v.x), put_number(kind, 1, v.y), put_number(kind, 2, v.z);
            };
            auto put_turned = [&](int kind, const Vec3<F> &v) {
                put_vector(kind, {dot(v, axis(0)), dot(v, axis(1)), dot(v, axis(2))});
            };
            Vec3<F> from = si.p - Vec3<F>{F(camera_.origin.x), F(camera_.origin.y), F(camera_.origin.z)};
            if (wants(AovDepth)) put_number(AovDepth, 0, dot(from, axis(2)));
            if (wants(AovDistance)) put_number(AovDistance, 0, norm(si.p - get(center_, i)));
            if (wants(AovRayLength)) put_number(AovRayLength, 0, dot(si.p - get(first_, i), ray.d));
            if (wants(AovPosition)) put_vector(AovPosition, si.p);
            if (wants(AovNormal)) put_vector(AovNormal, si.ng);
            if (wants(AovShadingNormal)) put_vector(AovShadingNormal, si.frame.n);
            if (wants(AovNormalCamera)) put_turned(AovNormalCamera, si.ng);
            if (wants(AovShadingNormalCamera)) put_turned(AovShadingNormalCamera, si.frame.n);
            if (wants(AovUv)) {
                Vec2<F> uv = texture_coordinates<F>(scene_, si.at, active);
                put_number(AovUv, 0, uv.x), put_number(AovUv, 1, uv.y);
            }
            if (wants(AovBarycentric)) put_number(AovBarycentric, 0, si.at.b1), put_number(AovBarycentric, 1, si.at.b2);
            if (wants(AovPartialU) || wants(AovPartialV)) {
                PositionPartials<F> partials = position_partials(scene_, si.at, si.shape, active);
                if (wants(AovPartialU)) put_vector(AovPartialU, partials.u);
                if (wants(AovPartialV)) put_vector(AovPartialV, partials.v);
            }
            for (int kind : {AovAlbedo, AovSpecular, AovRoughness}) {
                if (!wants(kind)) continue;
                Color<F, C> color = eval_shown<C>(scene_, kind, si.shape.bsdf, behind(ray, si), si.at, active);
                for (int c = 0; c < layout_.count(kind); ++c) put_number(kind, c, color[c]);
            }
            for (int k = 0; k < AovAttributes; ++k) {
                if (!wants(AovAttribute + k)) continue;
                Color<F, C> color = uniform_color<C>(F(0));
                each_attribute(
                    k, si, active, [&](const AttributeInfo &info, const Footprint<F, 3> &at, const M &lanes) {
                        color =
                            select(lanes, gather_footprint<C>(scene_.values.tensors[info.tensor], at, lanes), color);
                    });
                for (int c = 0; c < C; ++c) put_number(AovAttribute + k, c, color[c]);
            }
        });
    }

    // The derivative: with ReverseSink `value` holds the adjoints of the channels, with ForwardSink their derivatives
    // are written there.
    template <class Sink>
    void sweep(size_t n, const Wanted &wanted, Sink &sink) {
        constexpr bool forward = std::is_same_v<Sink, ForwardSink<F, C>>;
        if (forward)
            for (int k = 0; k < layout_.n; ++k) std::memset(value[k], 0, n * sizeof(S));
        for_hits(n, [&](size_t i, const M &active, const Ray<F> &ray, const Interaction<F> &si) {
            // what a channel is linear in: textures, numbers and colours of meshes
            auto sweep_values = [&](int kind, auto &&give) {
                S *const *to = value + layout_.offset[kind];
                const int channels = layout_.count(kind);
                Color<F, C> g = uniform_color<C>(F(1));
                if (!forward)
                    for (int c = 0; c < C; ++c) g[c] = load<F>(to[std::min(c, channels - 1)] + i);
                if constexpr (forward) sink.channel = 0;
                sink.begin();
                give(g);
                if constexpr (forward)
                    for (int c = 0; c < channels; ++c) store(to[c] + i, select(active, sink.derivative[c], F(0)));
            };
            for (int kind : {AovAlbedo, AovSpecular, AovRoughness}) {
                if (!wants(kind) || !wanted.bsdf) continue;
                CoordinateAdjoint<F> none;
                sweep_values(kind, [&](const Color<F, C> &g) {
                    sweep_shown(scene_, kind, si.shape.bsdf, behind(ray, si), si.at,
                                kind == AovRoughness ? only_first(g) : g, true, false, active, none, sink);
                });
            }
            for (int k = 0; k < AovAttributes; ++k) {
                if (!wants(AovAttribute + k)) continue;
                sweep_values(AovAttribute + k, [&](const Color<F, C> &g) {
                    each_attribute(k, si, active,
                                   [&](const AttributeInfo &info, const Footprint<F, 3> &at, const M &lanes) {
                                       sink.footprint(scene_, info.tensor, at, g, lanes);
                                   });
                });
            }
            if (!wanted.geometry) return;
            if constexpr (forward) {
                sink.channel = 0;  // one number after the other, whatever it is
                for (int k = 0; k < layout_.n; ++k) {
                    sink.begin();
                    sweep_motion(i, active, ray, si, wanted, sink,
                                 [&](int channel) { return F(channel == k ? S(1) : S(0)); });
                    store(value[k] + i, load<F>(value[k] + i) + select(active, sink.derivative[0], F(0)));
                }
            } else {
                sweep_motion(i, active, ray, si, wanted, sink,
                             [&](int channel) { return load<F>(value[channel] + i); });
            }
        });
    }

private:
    bool wants(int kind) const { return layout_.wants(kind); }
    Vec3<F> axis(int k) const { return {F(camera_.axis[k].x), F(camera_.axis[k].y), F(camera_.axis[k].z)}; }

    M behind(const Ray<F> &ray, const Interaction<F> &si) const { return mask<F>(dot(si.frame.n, ray.d) > F(0)); }

    // A colour of which the sink of a luminance gets one number.
    static Color<F, C> only_first(Color<F, C> g) {
        for (int c = 1; c < C; ++c) g[c] = F(0);
        return g;
    }

    // Calls visit(attribute, its rows, lanes) where meshes have the colours of output k.
    template <class Visit>
    void each_attribute(int k, const Interaction<F> &si, const M &active, Visit &&visit) const {
        const int32_t name = layout_.attributes[size_t(k)];
        for_each_distinct<F>(I(si.at.shape), active, [&](int32_t shape, const M &lanes) {
            int32_t a = scene_.shapes[shape].first_attribute;
            while (a >= 0 && scene_.attributes[a].name != name) a = scene_.attributes[a].next;
            if (a < 0) return;
            const AttributeInfo &info = scene_.attributes[a];
            visit(info, MeshAttribute::footprint<F>(scene_, info, uint32_t(shape), si.at, lanes), lanes);
        });
    }

    // What moves the hit, its normals or the look-up there; given(channel) is the adjoint of a channel.
    template <class Sink, class Given>
    void sweep_motion(size_t i, const M &active, const Ray<F> &ray, const Interaction<F> &si, const Wanted &wanted,
                      Sink &sink, Given &&given) {
        auto number = [&](int kind, int c) { return wants(kind) ? given(layout_.offset[kind] + c) : F(0); };
        auto vector = [&](int kind) { return Vec3<F>{number(kind, 0), number(kind, 1), number(kind, 2)}; };
        OutputAdjoint<F> g;
        g.depth = number(AovDepth, 0);
        g.distance = number(AovDistance, 0);
        g.ray_length = number(AovRayLength, 0);
        g.position = vector(AovPosition);
        g.normal = vector(AovNormal);
        g.shading_normal = vector(AovShadingNormal);
        g.normal_camera = vector(AovNormalCamera);
        g.shading_normal_camera = vector(AovShadingNormalCamera);
        g.at.uv = {number(AovUv, 0), number(AovUv, 1)};
        g.at.b = {number(AovBarycentric, 0), number(AovBarycentric, 1)};
        g.partial_u = vector(AovPartialU);
        g.partial_v = vector(AovPartialV);
        for (int kind : {AovAlbedo, AovSpecular, AovRoughness}) {
            if (!wants(kind)) continue;
            Color<F, C> color = uniform_color<C>(F(0));
            for (int c = 0; c < layout_.count(kind); ++c) color[c] = number(kind, c);
            sweep_shown(scene_, kind, si.shape.bsdf, behind(ray, si), si.at, color, false, true, active, g.at, sink);
        }
        for (int k = 0; k < AovAttributes; ++k) {
            if (!wants(AovAttribute + k)) continue;
            Color<F, C> color;
            for (int c = 0; c < C; ++c) color[c] = number(AovAttribute + k, c);
            each_attribute(k, si, active, [&](const AttributeInfo &info, const Footprint<F, 3> &at, const M &lanes) {
                sweep_attribute<C>(scene_, info, at, F(1), color, lanes, g.at);
            });
        }
        CameraSample<F> at{load<F>(film_x + i), load<F>(film_y + i), load<F>(lens_[0] + i), load<F>(lens_[1] + i)};
        sweep_outputs(scene_, scene_.sensors[call_.config.sensor], camera_, at, S(call_.film_width),
                      S(call_.film_height), get(center_, i), ray.d, si, g, wanted.camera,
                      wants(AovPartialU) || wants(AovPartialV), active, sink);
    }

    static void put(S *const (&to)[3], size_t i, const Vec3<F> &v) {
        store(to[0] + i, v.x);
        store(to[1] + i, v.y);
        store(to[2] + i, v.z);
    }
    static Vec3<F> get(S *const (&from)[3], size_t i) {
        return {load<F>(from[0] + i), load<F>(from[1] + i), load<F>(from[2] + i)};
    }

    void query(size_t n) {
        rays += n;
        constexpr bool direct = sizeof(S) == 4;
        HitBatch hits{shape, primitive, direct ? (float *)t_ : single_[7], direct ? (float *)b1_ : single_[8],
                      direct ? (float *)b2_ : single_[9]};
        call_.accel->intersect(ray_batch(o_, d_, length_, n, single_), hits, n, true);
        if (!direct)
            for (size_t i = 0; i < n; ++i)
                t_[i] = S(single_[7][i]), b1_[i] = S(single_[8][i]), b2_[i] = S(single_[9][i]);
    }

    const RenderCall<S> &call_;
    const AovLayout &layout_;
    const SceneView<S> &scene_;
    CameraFrame<S> camera_;
    Arena arena_;
    S *o_[3], *d_[3], *first_[3], *center_[3], *lens_[2], *length_, *t_, *b1_, *b2_;
    float *single_[10] = {};
};

}  // namespace detail

}  // namespace tr
