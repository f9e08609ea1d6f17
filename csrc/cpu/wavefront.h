// What a batch of paths on one thread consists of, whichever way light travels: samples, queues, ray queries, the tape.
// A step queries all rays and groups the hits by the model of their BSDF, so that a packet runs one model.
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

#include "bender.h"
#include "core/integrator/classify.h"
#include "ray_queries.h"
#include "render.h"
#include "stored_hits.h"
#include "tape.h"

namespace tr {

// Adds the seconds until it ends.
class Stopwatch {
public:
    explicit Stopwatch(double &to) : to_(to) {}
    ~Stopwatch() { to_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count(); }

private:
    double &to_;
    std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
};

// Moves the entries of a queue for which keep(i), the mask of entries i .. i + width, says so to its front, in their
// order.
template <class F, class Queue, class Keep>
void keep_entries(Queue &queue, Keep &&keep) {
    using S = ScalarOf<F>;
    constexpr uint32_t W = uint32_t(Lanes<F>::Width);
    uint32_t kept = 0;
    for (uint32_t i = 0; i < queue.n; i += W) {
        const MaskOf<F> wanted = keep(i) && mask<F>(UIntOf<F>(i) + lane_index<F>() < UIntOf<F>(queue.n));
        const uint32_t n = uint32_t(count(wanted));
        if (kept == i && n == W) {  // they stand where they belong
            kept += W;
            continue;
        }
        queue.for_arrays([&](auto *array) {
            if constexpr (std::is_same_v<decltype(array), S *>)
                store_compressed<F>(array + kept, load<F>(array + i), wanted);
            else
                store_compressed<F>(reinterpret_cast<uint32_t *>(array) + kept,
                                    load_uint<F>(reinterpret_cast<uint32_t *>(array) + i), wanted);
        });
        kept += n;
    }
    queue.n = kept;
}

template <class F>
class Wavefront {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using I = IntOf<F>;
    static constexpr uint32_t W = uint32_t(Lanes<F>::Width);
    static constexpr int Kinds = EmissionKind + 1;

public:
    // by path of the batch; which samples they are is set before a run, `radiance` and `alpha` after it
    SlotColumns<S> slots;
    PathQueue<S> queues[3];
    ShadowQueue<S> shadows;
    RayQueries<S> queries;
    Tape<S> tape;
    CommonKeys keys;  // of the slots that a run begins with
    Diagnostics diagnostics;
    RenderStats stats;
    HitRecorder recorder;             // off unless begun before a run: keeps what its rays hit,
    HitReplay replay;                 // or knows it already
    std::optional<Bender<F>> bender;  // of scenes with media that light bends in

    Wavefront(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> *derivative, bool of_light)
        : queries(*call.accel, entries(shadow_capacity(call, capacity))),
          tape({call.scene->has_stacks, call.scene->follows_tangent, call.config.volumetric,
                call.config.volumetric && derivative && derivative->gradient_needs().geometry, of_light,
                call.scene->bends && derivative, call.config.stokes}),
          call_(call),
          scene_(*call.scene) {
        if (derivative) needs_ = derivative->gradient_needs();
        const size_t n = capacity + 2 * W;
        if (scene_.bends) bender.emplace(scene_, *call.accel, entries(n));
        slots_arena_.allocate(n, slots, queues[0], queues[1], queues[2]);
        shadow_arena_.allocate(shadow_capacity(call, capacity), shadows);
        order_arena_.declare([&](Arena &arena) {
            arena.array(order_, entries(n));
            arena.array(kind_, entries(n));
        });
        kinds_.resize(size_t(scene_.n_bsdfs));
        for (int b = 0; b < scene_.n_bsdfs; ++b) kinds_[size_t(b)] = resolved_kind(scene_, b);
    }
    Wavefront(const Wavefront &) = delete;

    const GradientNeeds &needs() const { return needs_; }
    const SceneView<S> &scene() const { return scene_; }
    const RenderCall<S> &call() const { return call_; }

    // `recording`: onto the tape's last level.
    PathContext<F> context(bool recording) {
        return {scene_,
                call_.config,
                slots,
                diagnostics,
                &needs_,
                recording ? &tape.last().columns : nullptr,
                recorder.on(),
                bender ? &bender->columns : nullptr,
                recording && bsdfs_alone(),
                &keys};
    }

    // Of the first n slots, and of blocks 0 and 1.
    void find_keys(size_t n) {
        keys.of_batch(call_.config.sampler, slots.pixel.at, slots.sample.at, n);
        find_keys_of(0);
    }
    // ... of this block and the next one.
    void find_keys_of(uint32_t block) { keys.find(call_.config.seed, call_.config.sensor, block); }

    // See PathContext. Hits that are replayed belong to all rays.
    bool bsdfs_alone() const {
        const PathConfig &config = call_.config;
        const bool plain = !config.volumetric && !config.stokes && !bender && !replay.on();
        return plain && needs_.bsdf && !needs_.emitter && !needs_.numbers() && !needs_.camera;
    }

    // Records onto another tape, for a derivative by something else, until called again.
    void exchange(Tape<S> &other, GradientNeeds &needs) {
        std::swap(tape, other);
        std::swap(needs_, needs);
    }

    // Entries that n hits take at most once they are grouped.
    static constexpr size_t entries(size_t n) { return n + size_t(Kinds + 1) * 2 * W; }

    // Closest hits. `again`: of the same rays those that have passed through an emitter go on, the others hit what they
    // have hit. `adds`: what media that bend rays emit along them is added to what the slots have.
    void trace(PathQueue<S> &queue, bool again = false, bool adds = false) {
        Stopwatch watch(stats.seconds_trace);
        if (bender) bender->hold(queue);
        RayBatch rays = queries.batch(rays_of(queue), queue.n);
        HitBatch hits = queries.hit_batch();
        const bool coherent = &queue == &queues[0];
        auto moved = [&](size_t i) { return !again || passes_emitter(scene_, hits.shape[i]); };
        if (replay.on()) {
            stats.closest_rays += replay.intersect(*call_.accel, rays, queue.slot.at, hits, queue.n, coherent, moved);
        } else {
            if (recorder.on()) recorder.choose(queue.n, moved);
            call_.accel->intersect(rays, hits, queue.n, coherent);
            if (recorder.on()) recorder.put(queue.slot.at, hits);
            stats.closest_rays += queue.n;
        }
        queries.widen(queue.n);
        if (bender) {
            const PathContext<F> c = context(false);
            bender->run(
                queue, queries.hits,
                [&](const U &slot, const auto &active) {
                    return PacketSamples<F>(c, slot, active).wavelengths(c.config);
                },
                adds ? &slots.radiance : nullptr);
            stats.bent_rays += std::exchange(bender->n, 0), stats.bent_rays_lost += std::exchange(bender->lost, 0);
            stats.bent_rays_met += std::exchange(bender->met, 0);
        }
        if (call_.ray_record && !replay.on()) {
            size_t found = queue.n - size_t(std::count(hits.shape, hits.shape + queue.n, NoHit));
            call_.ray_record->add(coherent ? RayKind::Camera : RayKind::Bounce, rays, queue.n, found);
        }
    }

    // Camera rays, where emitters are hidden.
    void pass_emitters() {
        PathQueue<S> &queue = queues[0];
        tr::pass_emitters(scene_, rays_of(queue), queries.hits, queue.n, [&] { trace(queue, true); });
    }

    // Whether something is in the way of the shadow rays.
    void trace_shadows(RayKind kind) {
        Stopwatch watch(stats.seconds_trace);
        RayBatch rays = queries.batch(rays_of(shadows), shadows.n);
        uint8_t *occluded = queries.occluded;
        if (replay.on()) {
            stats.shadow_rays += replay.occluded(*call_.accel, rays, shadows.slot.at, occluded, shadows.n);
        } else {
            call_.accel->occluded(rays, occluded, shadows.n);
            if (recorder.on()) recorder.put_shadows(shadows.slot.at, occluded, shadows.n);
            stats.shadow_rays += shadows.n;
        }
        record_shadows(kind, rays);
    }
    void record_shadows(RayKind kind, const RayBatch &rays) {
        if (!call_.ray_record || replay.on()) return;
        const uint8_t *occluded = queries.occluded;
        call_.ray_record->add(kind, rays, shadows.n, size_t(std::count(occluded, occluded + shadows.n, uint8_t(1))));
    }

    // Stable counting sort of the hits by kind; every range starts at a multiple of the packet width, with room for a
    // packet behind the one before.
    void sort(const PathStep &step, const PathQueue<S> &queue, bool viewed, bool recording,
              std::vector<KindRange> &ranges) {
        PathContext<F> c = context(recording);
        uint32_t counts[Kinds] = {}, begin[Kinds], at = 0;
        for (uint32_t i = 0; i < queue.n; i += W) {
            I kind = classify_hits(c, step, queue, queries.hits, kinds_.data(), viewed, i);
            store(kind_ + i, kind);
            for_each_distinct<F>(kind, mask<F>(kind >= 0),
                                 [&](int32_t k, const auto &same) { counts[k] += uint32_t(count(same)); });
        }
        ranges.clear();
        for (int k = 0; k < Kinds; ++k) {
            begin[k] = at;
            if (!counts[k]) continue;
            ranges.push_back({k, at, counts[k]});
            at += (counts[k] + 2 * W - 1) / W * W;
        }
        if (recording) tape.reserve_last(at + 2 * W);
        for (uint32_t i = 0; i < queue.n; i += W) {
            I kind = I(load_uint<F>(reinterpret_cast<const uint32_t *>(kind_) + i));
            for_each_distinct<F>(kind, mask<F>(kind >= 0), [&](int32_t k, const auto &same) {
                store_compressed<F>(order_ + begin[k], U(i) + lane_index<F>(), same);
                begin[k] += uint32_t(count(same));
            });
        }
    }

    // Calls visit(lanes, i) for the packets of a range, i being the entry they have in it.
    template <class Visit>
    void for_packets(const KindRange &range, Visit &&visit) {
        for (uint32_t i = range.begin; i < range.begin + range.count; i += W) {
            LaneSet<F> lanes(order_ + i, range.begin + range.count - i);
            stats.lanes += uint64_t(count(lanes.active));
            stats.lane_slots += W;
            visit(lanes, i);
        }
    }

    // A scratch of as many numbers as there are entries, until hits are sorted.
    uint32_t *scratch() { return order_; }

    // Counts what was not finite, of paths so far and then of their derivative.
    void count_non_finite(GradientSink<F> &sink) {
        count_non_finite();
        if (sink.non_finite) stats.count_non_finite(sink.non_finite, "a derivative");
        sink.non_finite = 0;
    }
    // What was counted since the last time.
    RenderStats take_stats() {
        count_non_finite();
        return std::exchange(stats, {});
    }

private:
    void count_non_finite() {
        if (diagnostics.non_finite)
            stats.count_non_finite(diagnostics.non_finite,
                                   name_of(diagnostics.culprit) + (" " + std::to_string(diagnostics.index)));
        diagnostics = {};
    }

    static size_t shadow_capacity(const RenderCall<S> &call, size_t capacity) {
        return (call.config.volumetric ? 2 : 1) * (capacity + 2 * W);
    }

    const RenderCall<S> &call_;
    const SceneView<S> &scene_;
    GradientNeeds needs_{};
    Arena slots_arena_, shadow_arena_, order_arena_;
    std::vector<int32_t> kinds_;  // by bsdf
    uint32_t *order_;
    int32_t *kind_;
};

#define TR_ELSEWHERE(S) extern template class Wavefront<PacketOf<S>>;
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
