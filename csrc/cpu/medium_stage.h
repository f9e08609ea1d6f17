// The part of a tile of paths that knows media: free flight before the vertices are shaded, shadow rays through media,
// and the paths that derivatives of the extinction ask for.
#pragma once

#include "core/integrator/shadow_transmittance.h"
#include "tracker.h"
#include "wavefront.h"

namespace tr {

template <class F>
class MediumStage {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    static constexpr uint32_t W = uint32_t(Lanes<F>::Width);

public:
    MediumContext<F> media;

    MediumStage(Wavefront<F> &wavefront, size_t capacity, bool differentiates)
        : media(wavefront.scene(), differentiates ? &wavefront.needs() : nullptr),
          w_(wavefront),
          scene_(wavefront.scene()),
          tracker_(scene_, wavefront.call().config, wavefront.slots) {
        const size_t n = capacity + 2 * W;
        arena_.allocate(n, media.flight, media.branch);
        shadow_arena_.allocate(2 * n, transmittance_, pending_rays_);
        index_arena_.declare([&](Arena &arena) {
            for (uint32_t **p : {&pending_, &queue_, &met_}) arena.array(*p, 2 * n);
        });
    }

    // Of camera rays.
    void begin(PathQueue<S> &queue, uint32_t n_slots) {
        PathContext<F> c = w_.context(false);
        for (uint32_t i = 0; i < queue.n; i += W) begin_media(c, queue, i);
        for (uint32_t i = 0; i < n_slots; i += W) begin_media_slots(c, media, i);
    }

    // After the query: where rays collide in their media, that is what they hit.
    void fly(PathQueue<S> &queue, uint32_t level, bool recording) {
        media.level = level;
        PathContext<F> c = w_.context(false);
        for (uint32_t i = 0; i < queue.n; i += W) begin_flight(c, media, queue, w_.queries.hits, i);
        const TrackedQueue<S> rays{queue.o, queue.d, queue.ray_offset, queue.slot};
        for (int32_t m = 0; m < scene_.n_media; ++m) {
            size_t n = 0;
            uint32_t *order = w_.scratch();
            for (uint32_t i = 0; i < queue.n; ++i) {
                order[n] = i;
                n += queue.medium[i] == m;
            }
            if (n > 0) tracker_.fly(m, rays, media.flight, order, n, media.keeps_points());
        }
        for (uint32_t i = 0; i < queue.n; i += W) finish_flight(c, media, queue, w_.queries.hits, !recording, i);
    }

    // Shadow rays of a step, whose radiance is added up or, `recording`, written onto the tape.
    void trace_shadows(uint32_t level, bool recording) {
        const ShadowQueue<S> &shadows = w_.shadows;
        if (shadows.n == 0) return;
        const bool moves = recording && w_.needs().geometry;
        for (uint32_t k = 0; k < shadows.n; ++k) pending_[k] = k, begin_shadow(transmittance_, k, recording, moves);
        uint32_t n = shadows.n;
        for (uint32_t round = 0; n > 0; ++round) {
            trace_parts(level, round, n);
            for (int32_t m = 0; m < scene_.n_media; ++m) {
                size_t waiting = 0;
                for (uint32_t j = 0; j < n; ++j)
                    if (shadows.medium[pending_[j]] == m && w_.queries.hits.at.shape[j] != MediumHit)
                        met_[waiting] = j, queue_[waiting++] = pending_[j];
                if (waiting == 0) continue;
                tracker_.transmit(m, {shadows.o, shadows.d, shadows.ray_offset, shadows.slot}, transmittance_, queue_,
                                  waiting);
                if (!recording || !media.differential) continue;
                for (size_t q = 0; q < waiting; ++q)
                    choose_point(shadows, transmittance_, queue_[q], m, w_.queries.hits.at.get(met_[q]), moves);
            }
            n = cross_boundaries(n, moves);
        }
        for (uint32_t k = 0; k < shadows.n; ++k)
            if (recording)
                record_shadow(w_.tape.last().columns, shadows, transmittance_, k, media.differential, moves);
            else
                for (int c = 0; c < SpectrumSize; ++c)
                    w_.slots.radiance[c][shadows.slot[k]] +=
                        transmittance_.transmittance[c][k] * shadows.contribution[c][k];
    }

    // The queue of the paths that go on from differential samples, one a slot at most.
    void start_branches(PathQueue<S> &queue, uint32_t n_slots) {
        PathContext<F> c = w_.context(false);
        queue.n = 0;
        for (uint32_t i = 0; i < n_slots; i += W) tr::start_branches(c, media, i, n_slots, queue);
    }
    // Keeps what these have brought, and makes room for the rest.
    void finish_branches(uint32_t n_slots) {
        for (int c = 0; c < SpectrumSize; ++c) {
            std::copy_n(w_.slots.radiance[c], n_slots, media.branch.radiance[c]);
            std::fill_n(w_.slots.radiance[c], n_slots, S(0));
        }
    }

    void add_stats() {
        w_.stats.collisions += std::exchange(tracker_.collisions, 0);
        w_.stats.majorants_exceeded += std::exchange(tracker_.exceeded, 0);
    }
    void forget_stats() { tracker_.collisions = tracker_.exceeded = 0; }

private:
    // The parts of the rays in front of what they hit, which is MediumHit where nothing goes on.
    void trace_parts(uint32_t level, uint32_t round, uint32_t n) {
        const ShadowQueue<S> &shadows = w_.shadows;
        for (uint32_t j = 0; j < n; ++j) {
            uint32_t k = pending_[j];
            pending_rays_.o.set(j, shadows.o.get(k)), pending_rays_.d.set(j, shadows.d.get(k));
            pending_rays_.length[j] = shadows.length[k];
        }
        {
            Stopwatch watch(w_.stats.seconds_trace);
            w_.queries.intersect(rays_of(pending_rays_), n, false);
            w_.stats.shadow_rays += n;
        }
        PathContext<F> c = w_.context(false);
        for (uint32_t j = 0; j < n; j += W) {
            M active = mask<F>(U(j) + lane_index<F>() < U(n));
            seed_shadow_rays(c, shadows, transmittance_, level, round, pending(j, active), active);
        }
        const HitColumns<S> &hits = w_.queries.hits;
        for (uint32_t j = 0; j < n; ++j) {
            uint32_t k = pending_[j], &shape = hits.at.shape[j];
            bool hit = shape != NoHit;
            transmittance_.end[k] = hit ? hits.t[j] : shadows.length[k];
            if (!hit || passes_shadow_rays(scene_, shape)) continue;
            for (int c = 0; c < SpectrumSize; ++c) transmittance_.transmittance[c][k] = S(0);
            shape = MediumHit;
        }
    }

    // Returns how many rays go on behind boundaries.
    uint32_t cross_boundaries(uint32_t n, bool moves) {
        PathContext<F> c = w_.context(false);
        const HitColumns<S> &hits = w_.queries.hits;
        uint32_t left = 0;
        for (uint32_t j = 0; j < n; j += W) {
            Entries<F> from(j);
            SurfacePoint<F> at = from(hits.at);
            M on = mask<F>(U(j) + lane_index<F>() < U(n)) && !mask<F>(at.shape == U(NoHit)) &&
                   !mask<F>(at.shape == U(MediumHit));
            if (!any(on)) continue;
            U id = pending(j, on);
            for (uint32_t q = j; moves && q < j + W && q < n; ++q)
                if (lane_is_set(on, int(q - j)))
                    keep_boundary(w_.shadows, transmittance_, pending_[q], hits.at.get(q), hits.t[q]);
            on = cross_boundary(c, w_.shadows, transmittance_, at, from(hits.t), id, on);
            store_compressed<F>(pending_ + left, id, on);
            left += uint32_t(count(on));
        }
        return left;
    }
    U pending(uint32_t j, const M &active) const { return select(mask<U>(active), load_uint<F>(pending_ + j), U(0u)); }

    struct PendingRays {
        VectorColumn<S> o, d;
        NumberColumn<S> length;
        template <class Visit>
        void for_arrays(Visit &&visit) {
            o.each(visit), d.each(visit), length.each(visit);
        }
    };

    Wavefront<F> &w_;
    const SceneView<S> &scene_;
    Tracker<F> tracker_;
    Arena arena_, shadow_arena_, index_arena_;
    TransmittanceColumns<S> transmittance_;
    PendingRays pending_rays_;  // of the shadow rays in flight
    uint32_t *pending_, *queue_, *met_;
};

#define TR_ELSEWHERE(S) extern template class MediumStage<PacketOf<S>>;
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
