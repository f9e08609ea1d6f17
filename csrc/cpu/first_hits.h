// The first hits of a batch of camera rays, and the outputs that are functions of them.
#pragma once

#include <cstring>
#include <utility>

#include "aovs.h"
#include "core/integrator/camera.h"
#include "ray_queries.h"

namespace tr {

// The ray, which moves on where it passes through emitters; where it began and comes from; the place on the lens.
#define TR_FIRST_RAY_COLUMNS(X) \
    X(Vector, o) X(Vector, d) X(Number, length) X(Vector, first) X(Vector, center) X(Pair, lens)
template <class S>
struct FirstRayColumns {
    TR_COLUMNS(TR_FIRST_RAY_COLUMNS)
};
TR_PACKET(FirstRay, TR_FIRST_RAY_COLUMNS)

template <class F>
class FirstHits {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    static constexpr size_t W = size_t(Lanes<F>::Width);

public:
    SampleColumns<S> samples;  // pixel, row, column and sample are set before `trace`
    S *value[MaxAovChannels];  // by ray, one column a channel of the layout
    RayQueries<S> queries;     // what was hit
    RenderStats stats;
    RenderStats take_stats() { return std::exchange(stats, {}); }

    FirstHits(const RenderCall<S> &call, const AovLayout &layout, size_t capacity)
        : queries(*call.accel, capacity + 2 * W),
          call_(call),
          layout_(layout),
          context_(*call.scene, layout_, call.config.sensor, S(call.film_width), S(call.film_height)) {
        arena_.declare([&](Arena &arena) {
            auto add = [&](auto &columns) {
                columns.for_arrays([&](auto *&array) { arena.array(array, capacity + 2 * W); });
            };
            add(samples), add(rays_);
            for (int k = 0; k < layout.n; ++k) arena.array(value[k], capacity + 2 * W);
        });
    }

    bool is_hit(size_t k) const { return queries.hits.at.shape[k] != NoHit; }

    // Rays through the samples' film positions (choose_position), or through the centres of their pixels.
    void trace(const PathConfig &config, size_t n, bool centres) {
        const Record &sensor = context_.sensor;
        const bool lens = uses_lens(sensor) && !centres;
        for (size_t i = 0; i < n; i += W) {
            Entries<F> from(i);
            CameraSample<F> at;
            if (centres) {
                at.y = F(IntOf<F>(from(samples.row))) + F(0.5), at.x = F(IntOf<F>(from(samples.column))) + F(0.5);
            } else {
                Random4<F> u = choose_position<F>(config, samples, lens, i);
                at.y = from(samples.film_y), at.x = from(samples.film_x);
                if (lens) at.choose_lens(u);
            }
            CameraRay<F> r = camera_ray(context_.scene, sensor, at, context_.width, context_.height);
            // a ray of negative length hits nothing
            write(rays_, i,
                  FirstRay<F>{
                      r.ray.o, r.ray.d, select(r.exists, r.length, F(-1)), r.ray.o, r.center, {at.lens_x, at.lens_y}});
        }
        query(n);
        if (config.hide_emitters) pass_emitters(context_.scene, rays_of(rays_), queries.hits, n, [&] { query(n); });
    }

    // The values of the layout's channels; zero at misses.
    void evaluate(size_t n) {
        clear(n);
        for_hits(n, [&](size_t i, const M &active, const FirstHit<F> &hit) {
            F v[MaxAovChannels];
            eval_aovs(context_, hit, active, v);
            for (int k = 0; k < layout_.n; ++k) store(value[k] + i, select(active, v[k], F(0)));
        });
    }

    // The derivative: in reverse mode `value` holds the adjoints of the channels, in forward mode their derivatives are
    // written there.
    void sweep(size_t n, const GradientNeeds &needs, GradientSink<F> &sink) {
        if (sink.forward) clear(n);
        for_hits(n, [&](size_t i, const M &active, const FirstHit<F> &hit) {
            F v[MaxAovChannels];
            for (int k = 0; k < layout_.n; ++k) v[k] = load<F>(value[k] + i);
            sweep_aovs(context_, hit, needs, active, v, sink);
            if (!sink.forward) return;
            for (int k = 0; k < layout_.n; ++k) store(value[k] + i, select(active, v[k], F(0)));
        });
        stats.count_non_finite(sink.non_finite, "a derivative");
        sink.non_finite = 0;
    }

private:
    void clear(size_t n) {
        for (int k = 0; k < layout_.n; ++k) std::memset(value[k], 0, n * sizeof(S));
    }

    // Calls visit(first entry, active lanes, hit) for packets in which something was hit.
    template <class Visit>
    void for_hits(size_t n, Visit &&visit) {
        for (size_t i = 0; i < n; i += W) {
            Entries<F> from(i);
            SurfacePoint<F> at = from(queries.hits.at);
            M active = mask<F>(at.shape != U(NoHit)) && mask<F>(U(uint32_t(i)) + lane_index<F>() < U(uint32_t(n)));
            if (!any(active)) continue;
            at.shape = select(mask<U>(active), at.shape, U(0u));
            at.primitive = select(mask<U>(active), at.primitive, U(0u));
            FirstRay<F> r;
            read(rays_, from, r);
            FirstHit<F> hit{
                {from(samples.film_x), from(samples.film_y), r.lens.x, r.lens.y}, {r.o, r.d}, r.first, r.center, {},
                {call_.config, from(samples.pixel), from(samples.sample)}};
            hit.si = make_interaction<F>(context_.scene, hit.ray, at, from(queries.hits.t), active);
            visit(i, active, hit);
        }
    }

    void query(size_t n) {
        stats.closest_rays += n;
        queries.intersect(rays_of(rays_), n, true);
    }

    const RenderCall<S> &call_;
    const AovLayout &layout_;
    AovContext<F> context_;
    Arena arena_;
    FirstRayColumns<S> rays_;
};

}  // namespace tr
