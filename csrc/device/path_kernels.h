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
template <class S>
struct StartPaths {
    static constexpr const char *Name = TR_KERNEL_NAME(StartPaths), *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    PathStage<S> stage;
    PathQueue<S> out;
    int32_t *key;
    uint32_t n;
    bool skip_zero_adjoint;

    TR_HD void operator()(uint32_t i) const {
        PathQueue<S> own = out;
        own.n = i;
        stage.with_context(i, [&](const PathContext<S> &c) {
            start_paths<S>(c, stage.width, stage.height, skip_zero_adjoint, i, n, own);
        });
        key[i] = own.n != i ? Kept : Gone;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), out.for_arrays(visit), visit(key);
    }
};

// Where the samples are on the film, which AddToFilm then weights.
template <class S>
struct PlaceSamples {
    static constexpr const char *Name = TR_KERNEL_NAME(PlaceSamples), *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    PathConfig config;
    SlotColumns<S> slots;

    TR_HD void operator()(uint32_t i) const { choose_position<S>(config, slots, false, i); }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        slots.for_arrays(visit);
    }
};

// Of *n rays that go on those in directions of smooth BSDFs, which have a density.
template <class S>
struct KeepSmooth {
    static constexpr const char *Name = TR_KERNEL_NAME(KeepSmooth), *Header = "device/path_kernels.h";
    const S *pdf;
    const uint32_t *n;
    int32_t *key;

    TR_HD void operator()(uint32_t i) const {
        if (i < *n && key[i] == Kept && pdf[i] == 0) key[i] = Gone;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(pdf), visit(n), visit(key);
    }
};

// Of ray i of a queue, in single precision as in all trees. `Any`: whatever it meets.
template <bool Any, class Queue>
TR_HD inline TreeHit trace_entry(const TreeView &tree, const Queue &rays, uint32_t i) {
    const float o[] = {float(rays.o.x[i]), float(rays.o.y[i]), float(rays.o.z[i])},
                d[] = {float(rays.d.x[i]), float(rays.d.y[i]), float(rays.d.z[i])};
    return trace<Any>(tree, o, d, float(rays.length[i]));
}

// ... the closest; `passes`: it goes on behind what emits.
template <class S, class Queue>
TR_HD inline TreeHit trace_past(const TreeView &tree, const SceneView<S> &scene, const Queue &rays, uint32_t i,
                                bool passes) {
    TreeHit hit = trace_entry<false>(tree, rays, i);
    for (int pass = 0; passes && pass < MostPasses && passes_emitter(scene, hit.shape); ++pass) {
        Vec3<S> o = rays.o.get(i);
        pass_behind(o, rays.d.get(i), S(hit.t), rays.length[i]);
        rays.o.set(i, o);
        hit = trace_entry<false>(tree, rays, i);
    }
    return hit;
}

// Closest hits. `passes`: rays go on behind what emits.
template <class S>
struct TracePaths {
    static constexpr const char *Name = TR_KERNEL_NAME(TracePaths), *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Shapes;
    SceneView<S> scene;
    TreeView tree;
    PathQueue<S> queue;
    HitColumns<S> hits;
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
template <class S>
struct ClassifyHits {
    static constexpr const char *Name = TR_KERNEL_NAME(ClassifyHits), *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    PathStage<S> stage;
    PathStep step;
    TR_FACT(bool, viewed, !TR_LIGHT_PATHS);  // from the camera's side
    PathQueue<S> queue;
    HitColumns<S> hits;
    const int32_t *kinds;  // by bsdf
    EntryList rays;
    int32_t *key;

    TR_HD void operator()(uint32_t k) const {
        if (k >= *rays.n) return;
        const uint32_t i = rays.entry[k];
        stage.with_context(queue.slot[i], [&](const PathContext<S> &c) {
            key[k] = classify_hits<S>(c, step, queue, hits, kinds, viewed, i);
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
template <class S>
struct ShadeHits {
    static constexpr const char *Name = TR_KERNEL_NAME(ShadeHits), *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Bsdf;
    PathStage<S> stage;
    PathStep step;
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    int32_t left;  // how many vertices more a path may have, rays that go on finding the first; 3: so many, or more
    PathQueue<S> in;
    HitColumns<S> hits;
    const uint32_t *sorted, *begin, *total;  // the last two by kind
    PathQueue<S> out;
    ShadowQueue<S> shadows;
    int32_t *out_key, *shadow_key;

    TR_HD void operator()(uint32_t j) const {
        for_hit<1>(j, [&](const PathContext<S> &c, const LaneSet<S> &lanes, uint32_t i, PathQueue<S> &own,
                          ShadowQueue<S> &own_shadows) { shade(c, lanes, i, own, own_shadows); });
    }
    // Calls do_shade(context, hit, i, what goes on from it, its shadow rays) for hit j of the kind, which has up to
    // `Most` of the last.
    template <uint32_t Most, class Shade>
    TR_HD void for_hit(uint32_t j, Shade &&do_shade) const {
        if (j >= total[kind]) return;
        const uint32_t i = begin[kind] + j, first_shadow = Most * i;
        PathQueue<S> own = out;
        ShadowQueue<S> own_shadows = shadows;
        own.n = i, own_shadows.n = first_shadow;
        const LaneSet<S> lanes(sorted + i, 1);
        stage.with_context(in.slot[sorted[i]],
                           [&](const PathContext<S> &c) { do_shade(c, lanes, i, own, own_shadows); });
        out_key[i] = own.n != i && counts(own, i) ? Kept : Gone;
        for (uint32_t k = first_shadow; k < first_shadow + Most; ++k) shadow_key[k] = k < own_shadows.n ? Kept : Gone;
    }
    TR_HD void shade(const PathContext<S> &c, const LaneSet<S> &lanes, uint32_t i, PathQueue<S> &own,
                     ShadowQueue<S> &own_shadows) const {
        if (kind == MissKind) shade_environment<S>(c, step, in, lanes, i);
#if !defined(TR_BSDF_KIND) || (TR_VOLUMETRIC && !defined(TR_ONE_BSDF))
        else if (kind == CollisionKind)
            shade_medium<S>(c, step, in, hits, lanes, i, own, own_shadows);
#endif
#if !defined(TR_BSDF_KIND) || defined(TR_ONE_BSDF)
        else
            shade_surface<S>(c, kind, step, in, hits, lanes, i, own, own_shadows);
#endif
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), in.for_arrays(visit), hits.for_arrays(visit);
        visit(sorted), visit(begin), visit(total), out.for_arrays(visit), shadows.for_arrays(visit);
        visit(out_key), visit(shadow_key);
    }

private:
    // As PathTile::keep_rays_to_lights and keep_rays_to_bsdfs.
    TR_HD bool counts(const PathQueue<S> &own, uint32_t i) const {
        if (left == 2 && stage.bsdfs_alone && stage.needs.n_boxes >= 0)
            return last_scattering_counts<S>(stage.needs, own, i);
        if (left != 1) return true;
        if (stage.bsdfs_alone && !has_differentiated<S>(own.seen[i])) return false;
        return stage.scene.n_light_boxes < 0 || last_ray_counts<S>(stage.scene, own, i);
    }
};

// Adds what shadow rays bring where nothing is in the way; a path has one of them. On a tape, whose vertices have them,
// those that meet something lose their weight instead.
template <class S>
struct TraceShadows {
    static constexpr const char *Name = TR_KERNEL_NAME(TraceShadows), *Header = "device/path_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Shapes;
    TreeView tree;
    ShadowQueue<S> shadows;
    EntryList rays;
    SpectrumColumn<S> radiance;
    S *light_weight;  // of the tape; null: there is none
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
