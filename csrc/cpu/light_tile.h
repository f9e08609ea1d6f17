// A tile of light paths on one thread, a step at a time: rays are traced, hits grouped by model and shaded. In the
// place of shadow rays to lights there are connections to the camera, which end anywhere on the film: those that are
// free go to visit(level, connections), the emitters' own first.
#pragma once

#include <utility>

#include "core/adjoint/polarized_light_path.h"
#include "wavefront.h"

namespace tr {

template <class F>
class LightTile {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    static constexpr uint32_t W = uint32_t(Lanes<F>::Width);

public:
    Wavefront<F> wavefront;
    SlotColumns<S> &slots = wavefront.slots;
    RenderStats take_stats() { return wavefront.take_stats(); }
    bool numbers() const { return wavefront.needs().numbers(); }

    LightTile(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> *derivative)
        : wavefront(call, capacity, derivative, true),
          call_(call),
          config_(call.config),
          sensor_(*call.scene, call.config.sensor, S(call.film_width), S(call.film_height)) {}

    // Traces the paths of the first n slots, whose pixels are strata of the emitters.
    template <class Visit>
    void run(size_t n, bool recording, const Stop &stop, Visit &&visit) {
        const int32_t max_depth = config_.max_depth;
        wavefront.tape.begin_block(0);
        if (max_depth == 0 || wavefront.scene().n_emitters == 0) return;
        PathQueue<S> *current = &wavefront.queues[0], *next = &wavefront.queues[1];
        start(*current, uint32_t(n), recording);
        if (wavefront.bender) wavefront.bender->begin(*current);
        finish_connections(recording, visit);
        for (int depth = 0; current->n > 0 && !stop() && (max_depth < 0 || depth + 2 <= max_depth); ++depth) {
            wavefront.trace(*current);
            step(*current, *next, {depth, 0, max_depth < 0 || depth + 3 <= max_depth}, recording);
            finish_connections(recording, visit);
            std::swap(current, next);
        }
    }

    // Over the tape from its end. What `visit` has written into it are the connections' adjoints.
    void sweep(GradientSink<F> &sink) {
        const SweepContext<F> c = sweep_context();
        for (int l = wavefront.tape.size() - 1; l >= 0; --l)
            for_vertices(l, [&](const TapeColumns<S> &tape, const TapeColumns<S> *parents, int kind, uint32_t i,
                                const M &active) {
                if (config_.stokes)
                    sweep_polarized_light_vertex(c, sensor_, tape, parents, kind, i, active, sink);
                else
                    sweep_light_vertex(c, sensor_, tape, parents, kind, i, active, sink);
            });
        wavefront.count_non_finite(sink);
    }

private:
    SweepContext<F> sweep_context() {
        return {wavefront.scene(), config_, slots, wavefront.needs(), S(call_.film_width), S(call_.film_height)};
    }

    // Packets of the tape's vertices on a level.
    template <class Visit>
    void for_vertices(int number, Visit &&visit) {
        Tape<S> &tape = wavefront.tape;
        const TapeLevel<S> &level = tape[number];
        const TapeColumns<S> *parents = level.parent_level >= 0 ? &tape[level.parent_level].columns : nullptr;
        for (const KindRange &range : level.ranges)
            for (uint32_t i = range.begin; i < range.begin + range.count; i += W)
                visit(level.columns, parents, range.kind, i,
                      mask<F>(lane_index<F>() < U(range.begin + range.count - i)));
    }

    TapeLevel<S> &add_level() {
        Tape<S> &tape = wavefront.tape;
        return tape.add(tape.size() - 1, true);
    }

    void start(PathQueue<S> &queue, uint32_t n, bool recording) {
        queue.n = wavefront.shadows.n = 0;
        wavefront.find_keys(n);
        if (recording) {
            add_level().ranges.assign(1, {EmissionKind, 0, n});
            wavefront.tape.reserve_last(n + 2 * W);
        }
        PathContext<F> c = wavefront.context(recording);
        for (uint32_t i = 0; i < n; i += W) start_light_paths(c, sensor_, i, n, queue, wavefront.shadows);
    }

    void step(const PathQueue<S> &current, PathQueue<S> &next, const PathStep &step, bool recording) {
        next.n = wavefront.shadows.n = 0;
        std::vector<KindRange> *ranges = recording ? &add_level().ranges : &ranges_;
        wavefront.find_keys_of(EmitterBlock + BlocksPerScattering * step.scattering());
        // the last vertex, too, is connected and therefore sorted by its BSDF
        wavefront.sort({step.depth, step.split, true}, current, false, recording, *ranges);
        PathContext<F> c = wavefront.context(recording);
        for (const KindRange &range : *ranges)
            wavefront.for_packets(range, [&](const LaneSet<F> &lanes, uint32_t i) {
                shade_light_path(c, sensor_, range.kind, step, current, wavefront.queries.hits, lanes, i, next,
                                 wavefront.shadows);
            });
    }

    // Traces them and hands those that are free to `visit`; others have no weight on the tape.
    template <class Visit>
    void finish_connections(bool recording, Visit &visit) {
        ShadowQueue<S> &connections = wavefront.shadows;
        if (connections.n > 0) keep_free(recording);
        const int level = wavefront.tape.size() - 1;
        if (config_.stokes) {
            const SweepContext<F> c = sweep_context();
            for_vertices(level, [&](const TapeColumns<S> &tape, const TapeColumns<S> *parents, int kind, uint32_t i,
                                    const M &active) { hand_light(c, sensor_, tape, parents, kind, i, active); });
        }
        if (connections.n > 0) visit(level, std::as_const(connections));
        connections.n = 0;
    }

    void keep_free(bool recording) {
        ShadowQueue<S> &connections = wavefront.shadows;
        uint8_t *occluded = wavefront.queries.occluded;
        if (sensor_.meter >= 0)
            std::fill_n(occluded, connections.n, uint8_t(0));
        else if (config_.hide_emitters)
            pass_emitters();
        else
            wavefront.trace_shadows(RayKind::BounceShadow);
        if (recording) {
            S *weight = wavefront.tape.last().columns.outgoing.light_weight.at;
            for (uint32_t k = 0; k < connections.n; ++k)
                if (occluded[k]) weight[connections.position[k]] = S(0);
        }
        if (sensor_.meter < 0)  // of a meter all are free
            keep_entries<F>(connections, [&](uint32_t i) {
                alignas(64) uint32_t blocked[W];
                std::copy_n(occluded + i, W, blocked);
                return mask<F>(load_uint<F>(blocked) == U(0u));
            });
    }

    // Connections of an image without lights: these do not stand in the way.
    void pass_emitters() {
        const ShadowQueue<S> &connections = wavefront.shadows;
        const RayColumns<S> rays = rays_of(connections);
        const HitColumns<S> &hits = wavefront.queries.hits;
        const uint32_t n = connections.n;
        {
            Stopwatch watch(wavefront.stats.seconds_trace);
            auto query = [&] { wavefront.queries.intersect(rays, n, false); };
            query();
            tr::pass_emitters(wavefront.scene(), rays, hits, n, query);
            wavefront.stats.shadow_rays += n;
        }
        for (uint32_t k = 0; k < n; ++k) wavefront.queries.occluded[k] = hits.at.shape[k] != NoHit;
        wavefront.record_shadows(RayKind::BounceShadow, wavefront.queries.batch(rays, n));
    }

    const RenderCall<S> &call_;
    const PathConfig &config_;
    LightSensor<S> sensor_;
    std::vector<KindRange> ranges_;
};

}  // namespace tr
