// Paths through media as kernels: what a step of theirs has besides (path_kernels.h). A ray flies, and a shadow ray is
// followed to its end, in one item each.
#pragma once

#include "core/integrator/shadow_transmittance.h"
#include "core/medium/single_ray.h"
#include "path_kernels.h"

namespace tr {

// Sums over all items: tentative collisions, those of them beyond the majorant, and parts of shadow rays, in copies,
// since many items add at once.
struct TrackingTotals {
    static constexpr uint32_t Copies = 256, Sums = 3, Numbers = Copies * Sums;
    uint64_t *at;  // (copies, sums)

    TR_HD void add(uint32_t item, const TrackingCounts &counts, uint32_t parts = 0) const {
        const uint32_t numbers[Sums] = {counts.collisions, counts.exceeded, parts};
        for (uint32_t i = 0; i < Sums; ++i)
            if (numbers[i] != 0) accumulate(at + Sums * (item % Copies) + i, uint64_t(numbers[i]));
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(at);
    }
};

template <class S, class Visit>
void visit_media(const MediumContext<S> &media, Visit &&visit) {
    media.flight.for_arrays(visit), media.branch.for_arrays(visit);
}

// Of camera rays, one a slot.
template <class S>
struct BeginMedia {
    static constexpr const char *Name = TR_KERNEL_NAME(BeginMedia), *Header = "device/medium_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    PathStage<S> stage;
    MediumContext<S> media;
    PathQueue<S> queue;

    TR_HD void operator()(uint32_t i) const {
        PathQueue<S> own = queue;
        stage.with_context(i, [&](const PathContext<S> &c) {
            begin_media<S>(c, own, i);
            begin_media_slots<S>(c, media, i);
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit_media(media, visit), queue.for_arrays(visit);
    }
};

// Rays that were traced: where they collide, that is what they hit.
template <class S>
struct FlyRays {
    static constexpr const char *Name = TR_KERNEL_NAME(FlyRays), *Header = "device/medium_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Paths;
    PathStage<S> stage;
    MediumContext<S> media;
    PathQueue<S> queue;
    HitColumns<S> hits;
    EntryList rays;
    TrackingTotals totals;

    TR_HD void operator()(uint32_t k) const {
        if (k >= *rays.n) return;
        const uint32_t i = rays.entry[k];
        const int32_t medium = queue.medium[i];
        PathQueue<S> own = queue;
        stage.with_context(queue.slot[i], [&](const PathContext<S> &c) {
            begin_flight<S>(c, media, queue, hits, i);
            if (medium >= 0) {
                TrackingCounts counts;
                fly_ray<S>(stage.scene, media, medium, {queue.o, queue.d, queue.ray_offset, queue.slot}, i, counts);
                totals.add(k, counts);
            }
            finish_flight<S>(c, media, own, hits, !stage.records, i);
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit_media(media, visit), queue.for_arrays(visit), hits.for_arrays(visit);
        rays.for_pointers(visit), totals.for_pointers(visit);
    }
};

// Shadow rays that a hit has at most: its own, and that of the segment's differential sample, which is on the tape.
constexpr uint32_t MostShadows = 2;

template <class S>
struct ShadeInMedia {
    static constexpr const char *Name = TR_KERNEL_NAME(ShadeInMedia), *Header = "device/medium_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Bsdf;
    ShadeHits<S> shading;
    MediumContext<S> media;

    TR_HD void operator()(uint32_t j) const {
        shading.template for_hit<MostShadows>(j, [&](const PathContext<S> &c, const LaneSet<S> &lanes, uint32_t i,
                                                     PathQueue<S> &own, ShadowQueue<S> &shadows) {
            if (shading.stage.records)
                record_segment<S>(c, media, shading.step, shading.in, shading.hits, lanes, i, shadows);
            shading.shade(c, lanes, i, own, shadows);
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        shading.for_pointers(visit), visit_media(media, visit);
    }
};

// What is left of shadow rays at their ends: added up or, with a tape, written onto it.
template <class S>
struct TransmitShadows {
    static constexpr const char *Name = TR_KERNEL_NAME(TransmitShadows), *Header = "device/medium_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    PathStage<S> stage;
    MediumContext<S> media;
    TreeView tree;
    ShadowQueue<S> shadows;
    TransmittanceColumns<S> transmittance;
    EntryList rays;
    TrackingTotals totals;

    TR_HD void operator()(uint32_t q) const {
        if (q >= *rays.n) return;
        const uint32_t k = rays.entry[q];
        stage.with_context(shadows.slot[k], [&](const PathContext<S> &c) {
            begin_shadow(transmittance, k, stage.records, moves());
            TrackingCounts counts;
            uint32_t parts = 0;
            while (pass(c, k, parts++, counts)) {}
            totals.add(q, counts, parts);
            if (c.tape) return record_shadow(*c.tape, shadows, transmittance, k, media.differential, moves());
            for (int i = 0; i < SpectrumSize; ++i)
                stage.slots.radiance[i][shadows.slot[k]] +=
                    transmittance.transmittance[i][k] * shadows.contribution[i][k];
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit_media(media, visit), tree.for_pointers(visit), shadows.for_arrays(visit);
        transmittance.for_arrays(visit), rays.for_pointers(visit), totals.for_pointers(visit);
    }

private:
    TR_HD bool moves() const { return stage.records && stage.needs.geometry; }
    // The part of a ray in front of what it meets next; whether it goes on behind that. As MediumStage of the CPU.
    TR_HD bool pass(const PathContext<S> &c, uint32_t k, uint32_t round, TrackingCounts &counts) const {
        const TreeHit hit = trace_entry<false>(tree, shadows, k);
        const bool met = hit.shape != TreeHit::Miss;
        const SurfacePoint<S> place{hit.shape, hit.primitive, S(hit.b1), S(hit.b2)};
        seed_shadow_rays<S>(c, shadows, transmittance, media.level, round, k, true);
        transmittance.end[k] = met ? S(hit.t) : shadows.length[k];
        if (met && !passes_shadow_rays(stage.scene, hit.shape)) {
            for (int i = 0; i < SpectrumSize; ++i) transmittance.transmittance[i][k] = 0;
            return false;
        }
        const int32_t medium = shadows.medium[k];
        if (medium >= 0) {
            transmit_ray<S>(stage.scene, media, medium, {shadows.o, shadows.d, shadows.ray_offset, shadows.slot},
                            transmittance, k, counts);
            if (stage.records && media.differential) choose_point(shadows, transmittance, k, medium, place, moves());
        }
        if (!met) return false;
        if (moves()) keep_boundary(shadows, transmittance, k, place, S(hit.t));
        return cross_boundary<S>(c, shadows, transmittance, place, S(hit.t), k, true);
    }
};

// The paths that go on from differential samples, one a slot at most; `key` says which there are.
template <class S>
struct StartBranches {
    static constexpr const char *Name = TR_KERNEL_NAME(StartBranches), *Header = "device/medium_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    PathStage<S> stage;
    MediumContext<S> media;
    PathQueue<S> out;
    int32_t *key;
    uint32_t n;

    TR_HD void operator()(uint32_t i) const {
        PathQueue<S> own = out;
        own.n = i;
        stage.with_context(i, [&](const PathContext<S> &c) { start_branches<S>(c, media, i, n, own); });
        key[i] = own.n != i ? Kept : Gone;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit_media(media, visit), out.for_arrays(visit), visit(key);
    }
};

// Keeps what these have brought, and makes room for the rest.
template <class S>
struct FinishBranches {
    static constexpr const char *Name = TR_KERNEL_NAME(FinishBranches), *Header = "device/medium_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;  // as what it is compiled with
    SpectrumColumn<S> radiance, branch;

    TR_HD void operator()(uint32_t i) const {
        for (int c = 0; c < SpectrumSize; ++c) branch[c][i] = radiance[c][i], radiance[c][i] = 0;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        radiance.each(visit), branch.each(visit);
    }
};

}  // namespace tr
