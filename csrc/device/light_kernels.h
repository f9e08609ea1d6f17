// Light paths as kernels, see core/integrator/light.h and path_kernels.h: in the place of shadow rays there are
// connections to the camera, of which every vertex has one at most. Those that are free are splatted then
// (splat_kernels.h).
#pragma once

#include "path_kernels.h"

namespace tr {

// Paths of the samples, which begin at emitters, and the connections of these to the camera.
template <class S>
struct StartLightPaths {
    static constexpr const char *Name = TR_KERNEL_NAME(StartLightPaths), *Header = "device/light_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Paths;
    PathStage<S> stage;
    LightView<S> view;
    PathQueue<S> out;
    ShadowQueue<S> connections;
    int32_t *key, *connection_key;
    uint32_t n;

    TR_HD void operator()(uint32_t i) const {
        PathQueue<S> own = out;
        ShadowQueue<S> own_connections = connections;
        own.n = own_connections.n = i;
        stage.with_context(i, [&](const PathContext<S> &c) {
            start_light_paths<S>(c, view.sensor(stage), i, n, own, own_connections);
        });
        key[i] = own.n != i ? Kept : Gone;
        connection_key[i] = own_connections.n != i ? Kept : Gone;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), out.for_arrays(visit), connections.for_arrays(visit);
        visit(key), visit(connection_key);
    }
};

template <class S>
struct ShadeLightPaths {
    static constexpr const char *Name = TR_KERNEL_NAME(ShadeLightPaths), *Header = "device/light_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Bsdf;
    ShadeHits<S> shading;
    LightView<S> view;

    TR_HD void operator()(uint32_t j) const {
        const ShadeHits<S> &at = shading;
        at.template for_hit<1>(j, [&](const PathContext<S> &c, const LaneSet<S> &lanes, uint32_t i, PathQueue<S> &own,
                                      ShadowQueue<S> &connections) {
            shade_light_path<S>(c, view.sensor(at.stage), at.kind, at.step, at.in, at.hits, lanes, i, own, connections);
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        shading.for_pointers(visit);
    }
};

// Connections that meet something: their key is Gone, and on a tape they have no weight. `passes`: what emits is not in
// the way.
template <class S>
struct TraceConnections {
    static constexpr const char *Name = TR_KERNEL_NAME(TraceConnections), *Header = "device/light_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Shapes;
    SceneView<S> scene;
    TreeView tree;
    ShadowQueue<S> connections;
    EntryList rays;
    int32_t *key;
    S *weight;  // of the tape; null: there is none
    uint64_t *traced;
    bool passes;

    TR_HD void operator()(uint32_t k) const {
        if (k == 0) *traced += *rays.n;
        if (k >= *rays.n) return;
        const uint32_t i = rays.entry[k];
        const TreeHit hit =
            passes ? trace_past(tree, scene, connections, i, true) : trace_entry<true>(tree, connections, i);
        if (hit.shape == TreeHit::Miss) return;
        key[i] = Gone;
        if (weight) weight[connections.position[i]] = 0;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        scene.for_pointers(visit), tree.for_pointers(visit), connections.for_arrays(visit), rays.for_pointers(visit);
        visit(key), visit(weight), visit(traced);
    }
};

}  // namespace tr
