// The path tracer as kernels: an item is a sample, a ray or a hit, and calls what is in core/integrator for one lane.
//
// An item appends to queues of its own, which begin at its entry: where paths end, entries are left empty. What is left
// is listed afterwards, in the order of the entries (sort_kernels.h). So no two items of a launch write to one place,
// and nothing depends on the order of the items.
//
// How many items there are to be done is known on the device alone: a launch has as many as there may be, and those
// behind the end do nothing.
#pragma once

#include "core/integrator/camera.h"
#include "core/integrator/classify.h"
#include "core/integrator/medium.h"
#include "entries.h"
#include "path_stage.h"
#include "tree_traversal.h"
#if defined(__CUDACC_RTC__)
#include "core_parts.h"
#endif

namespace tr {

// Camera rays of the samples; `skip_zero_adjoint`: see start_paths.
struct StartPaths {
    static constexpr const char *Name = "tr::StartPaths", *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    PathStage stage;
    PathQueue<float> out;
    int32_t *key;
    uint32_t n;
    bool skip_zero_adjoint;

    TR_HD void operator()(uint32_t i) const {
        PathQueue<float> own = out;
        own.n = i;
        stage.with_context(i, [&](const PathContext<float> &c) {
            start_paths<float>(c, stage.width, stage.height, skip_zero_adjoint, i, n, own);
        });
        key[i] = own.n != i ? Kept : Gone;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), out.for_arrays(visit), visit(key);
    }
};

// Where the samples are on the film, which AddToFilm then weights.
struct PlaceSamples {
    static constexpr const char *Name = "tr::PlaceSamples", *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    PathConfig config;
    SlotColumns<float> slots;

    TR_HD void operator()(uint32_t i) const { choose_position<float>(config, slots, false, i); }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        slots.for_arrays(visit);
    }
};

// Of ray i of a queue. `Any`: whatever it meets.
template <bool Any, class Queue>
TR_HD inline TreeHit trace_entry(const TreeView &tree, const Queue &rays, uint32_t i) {
    const float o[] = {rays.o.x[i], rays.o.y[i], rays.o.z[i]}, d[] = {rays.d.x[i], rays.d.y[i], rays.d.z[i]};
    return trace<Any>(tree, o, d, rays.length[i]);
}

// ... the closest; `passes`: it goes on behind what emits.
template <class Queue>
TR_HD inline TreeHit trace_past(const TreeView &tree, const SceneView<float> &scene, const Queue &rays, uint32_t i,
                                bool passes) {
    TreeHit hit = trace_entry<false>(tree, rays, i);
    for (int pass = 0; passes && pass < MostPasses && passes_emitter(scene, hit.shape); ++pass) {
        Vec3<float> o = rays.o.get(i);
        pass_behind(o, rays.d.get(i), hit.t, rays.length[i]);
        rays.o.set(i, o);
        hit = trace_entry<false>(tree, rays, i);
    }
    return hit;
}

// Closest hits. `passes`: rays go on behind what emits.
struct TracePaths {
    static constexpr const char *Name = "tr::TracePaths", *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Shapes;
    SceneView<float> scene;
    TreeView tree;
    PathQueue<float> queue;
    HitColumns<float> hits;
    EntryList rays;
    uint64_t *traced;
    bool passes;

    TR_HD void operator()(uint32_t k) const {
        if (k == 0) *traced += *rays.n;
        if (k >= *rays.n) return;
        const uint32_t i = rays.entry[k];
        const TreeHit hit = trace_past(tree, scene, queue, i, passes);
        hits.at.shape[i] = hit.shape, hits.at.primitive[i] = hit.primitive;
        hits.at.b1[i] = hit.b1, hits.at.b2[i] = hit.b2, hits.t[i] = hit.t;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        scene.for_pointers(visit), tree.for_pointers(visit), queue.for_arrays(visit), hits.for_arrays(visit);
        rays.for_pointers(visit), visit(traced);
    }
};

// Which model shades them.
struct ClassifyHits {
    static constexpr const char *Name = "tr::ClassifyHits", *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    PathStage stage;
    PathStep step;
    TR_FACT(bool, viewed, !TR_LIGHT_PATHS);  // from the camera's side
    PathQueue<float> queue;
    HitColumns<float> hits;
    const int32_t *kinds;  // by bsdf
    EntryList rays;
    int32_t *key;

    TR_HD void operator()(uint32_t k) const {
        if (k >= *rays.n) return;
        const uint32_t i = rays.entry[k];
        stage.with_context(queue.slot[i], [&](const PathContext<float> &c) {
            key[k] = classify_hits<float>(c, step, queue, hits, kinds, viewed, i);
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), queue.for_arrays(visit), hits.for_arrays(visit);
        visit(kinds), rays.for_pointers(visit), visit(key);
    }
};

// Shades the hits of one kind. `sorted` lists hits by kind, those of each from `begin` on, `total` of them; what goes
// on from a hit has its place in that list.
struct ShadeHits {
    static constexpr const char *Name = "tr::ShadeHits", *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Bsdf;
    PathStage stage;
    PathStep step;
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    bool last;  // rays that go on are the last ones of their paths
    PathQueue<float> in;
    HitColumns<float> hits;
    const uint32_t *sorted, *begin, *total;  // the last two by kind
    PathQueue<float> out;
    ShadowQueue<float> shadows;
    int32_t *out_key, *shadow_key;

    TR_HD void operator()(uint32_t j) const {
        for_hit<1>(j, [&](const PathContext<float> &c, const LaneSet<float> &lanes, uint32_t i, PathQueue<float> &own,
                          ShadowQueue<float> &own_shadows) { shade(c, lanes, i, own, own_shadows); });
    }
    // Calls do_shade(context, hit, i, what goes on from it, its shadow rays) for hit j of the kind, which has up to
    // `Most` of the last.
    template <uint32_t Most, class Shade>
    TR_HD void for_hit(uint32_t j, Shade &&do_shade) const {
        if (j >= total[kind]) return;
        const uint32_t i = begin[kind] + j, first_shadow = Most * i;
        PathQueue<float> own = out;
        ShadowQueue<float> own_shadows = shadows;
        own.n = i, own_shadows.n = first_shadow;
        const LaneSet<float> lanes(sorted + i, 1);
        stage.with_context(in.slot[sorted[i]],
                           [&](const PathContext<float> &c) { do_shade(c, lanes, i, own, own_shadows); });
        out_key[i] = own.n != i && (!last || last_counts(own, i)) ? Kept : Gone;
        for (uint32_t k = first_shadow; k < first_shadow + Most; ++k) shadow_key[k] = k < own_shadows.n ? Kept : Gone;
    }
    TR_HD void shade(const PathContext<float> &c, const LaneSet<float> &lanes, uint32_t i, PathQueue<float> &own,
                     ShadowQueue<float> &own_shadows) const {
        if (kind == MissKind) shade_environment<float>(c, step, in, lanes, i);
#if !defined(TR_BSDF_KIND) || (TR_VOLUMETRIC && !defined(TR_ONE_BSDF))
        else if (kind == CollisionKind)
            shade_medium<float>(c, step, in, hits, lanes, i, own, own_shadows);
#endif
#if !defined(TR_BSDF_KIND) || defined(TR_ONE_BSDF)
        else
            shade_surface<float>(c, kind, step, in, hits, lanes, i, own, own_shadows);
#endif
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), in.for_arrays(visit), hits.for_arrays(visit);
        visit(sorted), visit(begin), visit(total), out.for_arrays(visit), shadows.for_arrays(visit);
        visit(out_key), visit(shadow_key);
    }

private:
    // As PathTile::keep_rays_to_lights.
    TR_HD bool last_counts(const PathQueue<float> &own, uint32_t i) const {
        if (stage.bsdfs_alone && !has_differentiated<float>(own.seen[i])) return false;
        return stage.scene.n_light_boxes < 0 || last_ray_counts<float>(stage.scene, own, i);
    }
};

// Adds what shadow rays bring where nothing is in the way; a path has one of them. On a tape, whose vertices have them,
// those that meet something lose their weight instead.
struct TraceShadows {
    static constexpr const char *Name = "tr::TraceShadows", *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Shapes;
    TreeView tree;
    ShadowQueue<float> shadows;
    EntryList rays;
    SpectrumColumn<float> radiance;
    float *light_weight;  // of the tape; null: there is none
    uint64_t *traced;

    TR_HD void operator()(uint32_t k) const {
        if (k == 0) *traced += *rays.n;
        if (k >= *rays.n) return;
        const uint32_t i = rays.entry[k];
        const bool occluded = trace_entry<true>(tree, shadows, i).shape != TreeHit::Miss;
        if (light_weight && occluded) light_weight[shadows.position[i]] = 0;
        if (light_weight || occluded) return;
        for (int c = 0; c < SpectrumSize; ++c) radiance[c][shadows.slot[i]] += shadows.contribution[c][i];
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        tree.for_pointers(visit), shadows.for_arrays(visit), rays.for_pointers(visit), radiance.each(visit);
        visit(light_weight), visit(traced);
    }
};

}  // namespace tr
