// The renderer's core compiled for a device, with F = float: the kernels of csrc/device, which the emulated device runs
// (cpu/device_paths.cpp has their schedule), and for all else that a schedule of the CPU calls for a packet a kernel
// that calls it for one lane. Such a kernel builds the context and the accessors from its arguments and does nothing
// else; nothing launches it yet.
//
// `make cuda` compiles and links them, which shows that the core needs nothing that device code does not have:
// functions and data of the host, static variables that are initialised when the program runs, exceptions, virtual
// functions. It says nothing about results.
#include "core/medium/estimators.h"
#include "core_sources.h"  // all .cpp files of the core, see the Makefile
#include "device/adjoint_kernels.h"
#include "device/derivative_kernels.h"
#include "device/film_kernels.h"
#include "device/output_sweep_kernels.h"
#include "device/path_kernels.h"
#include "device/ray_kernels.h"
#include "device/sort_kernels.h"

namespace tr {
namespace stages {

using F = float;
using S = ScalarOf<F>;

// What a PathContext refers to. The tables lie in the device's memory.
struct Stage {
    SceneView<S> scene;
    PathConfig config;
    SlotColumns<S> slots;
    GradientNeeds needs;
    TapeColumns<S> tape;
    S width, height;           // of the film
    Diagnostics *diagnostics;  // by thread
    bool recording, keeps_black;

    __device__ PathContext<F> context() const {
        Diagnostics &own = diagnostics[blockIdx.x * blockDim.x + threadIdx.x];
        return {scene, config, slots, own, &needs, recording ? &tape : nullptr, keeps_black};
    }
    __device__ LightSensor<S> light_sensor() const { return {scene, config.sensor, width, height}; }
};

// A range of hits of one kind, from `begin` on: there `order` has their entries in the queue, and a tape their
// vertices.
struct Hits {
    int kind;
    PathStep step;
    const uint32_t *order;
    uint32_t begin, count;
    const PathQueue<S> *queue;
    HitColumns<S> hits;

    __device__ LaneSet<F> lanes(uint32_t i) const { return {order + i, 1}; }
};

__device__ inline uint32_t thread_index() { return blockIdx.x * blockDim.x + threadIdx.x; }

// Calls f with the thread's number if it is below n.
template <class Do>
__device__ void each(uint32_t n, Do &&f) {
    const uint32_t i = thread_index();
    if (i < n) f(i);
}
template <class Do>
__device__ void each(const Hits &at, Do &&f) {
    const uint32_t i = thread_index();
    if (i < at.count) f(at.begin + i, at.lanes(at.begin + i));
}

#define TR_STAGE __grid_constant__ const Stage stage
#define TR_HITS __grid_constant__ const Hits at

// A queue of its own for an item, which appends `most` entries at most to it; `end` is told where they end.
template <class Queue, class Do>
__device__ void append_own(const Queue &queue, uint32_t *end, uint32_t i, uint32_t most, Do &&f) {
    Queue own = queue;
    own.n = i * most;
    f(own);
    end[i] = own.n;
}

// -------------------------------------------------------------------------------------- surfaces, rays and the film
template <class K>
__global__ void run(__grid_constant__ const K kernel, uint32_t n) {
    if constexpr (IsBlockKernel<K>::value) {
        __shared__ typename K::Shared shared;
        for (uint32_t i = blockIdx.x; i < n; i += gridDim.x) kernel(Block<typename K::Shared>{shared, i}, i);
    } else {
        each(n, [&](uint32_t i) { kernel(i); });
    }
}
#define TR_RUN(K) template __global__ void run(__grid_constant__ const K, uint32_t);
TR_RUN(StartPaths)
TR_RUN(TracePaths)
TR_RUN(ClassifyHits)
TR_RUN(ShadeHits)
TR_RUN(TraceShadows)
TR_RUN(CountKeys)
TR_RUN(SumKeys)
TR_RUN(PlaceKeys)
TR_RUN(FillWords)
TR_RUN(NumberSamples)
TR_RUN(AddToFilm)
TR_RUN(PlaceSamples)
TR_RUN(DivideAdjoint)
TR_RUN(CollectAdjoints)
TR_RUN(SweepVertices)
TR_RUN(SumCopies)
TR_RUN(SettleSums)
TR_RUN(EvaluateOutputs)
TR_RUN(StartCentres)
TR_RUN(AddOutputsToFilm)
TR_RUN(CollectOutputs)
TR_RUN(SweepOutputs)
TR_RUN(IntersectRays)
TR_RUN(OccludeRays)
#undef TR_RUN

// ------------------------------------------------------------------------------------------------------------- media
__global__ void begin_media(TR_STAGE, PathQueue<S> *queue) {
    each(queue->n, [&](uint32_t i) { tr::begin_media(stage.context(), *queue, i); });
}

__global__ void begin_media_slots(TR_STAGE, MediumContext<F> media, uint32_t n_slots) {
    each(n_slots, [&](uint32_t i) { tr::begin_media_slots(stage.context(), media, i); });
}

__global__ void begin_flight(TR_STAGE, MediumContext<F> media, const PathQueue<S> *queue, HitColumns<S> hits) {
    each(queue->n, [&](uint32_t i) { tr::begin_flight(stage.context(), media, *queue, hits, i); });
}

__global__ void finish_flight(TR_STAGE, MediumContext<F> media, PathQueue<S> *queue, HitColumns<S> hits,
                              bool add_radiance) {
    each(queue->n, [&](uint32_t i) { tr::finish_flight(stage.context(), media, *queue, hits, add_radiance, i); });
}

__global__ void shade_media(TR_STAGE, TR_HITS, PathQueue<S> out, ShadowQueue<S> shadows, uint32_t *out_end,
                            uint32_t *shadow_end) {
    each(at, [&](uint32_t i, const LaneSet<F> &lanes) {
        append_own(out, out_end, i, 1, [&](PathQueue<S> &own) {
            append_own(shadows, shadow_end, i, 1, [&](ShadowQueue<S> &own_shadows) {
                shade_medium(stage.context(), at.step, *at.queue, at.hits, lanes, i, own, own_shadows);
            });
        });
    });
}

__global__ void record_segments(TR_STAGE, TR_HITS, MediumContext<F> media, ShadowQueue<S> shadows, uint32_t *end) {
    each(at, [&](uint32_t i, const LaneSet<F> &lanes) {
        append_own(shadows, end, i, 1, [&](ShadowQueue<S> &own) {
            record_segment(stage.context(), media, at.step, *at.queue, at.hits, lanes, i, own);
        });
    });
}

__global__ void start_branches(TR_STAGE, MediumContext<F> media, uint32_t n_slots, PathQueue<S> out, uint32_t *end) {
    each(n_slots, [&](uint32_t i) {
        append_own(out, end, i, 1,
                   [&](PathQueue<S> &own) { tr::start_branches(stage.context(), media, i, n_slots, own); });
    });
}

// Entries of a queue that are in one medium.
struct Tracked {
    const MediumInfo *medium;
    const uint32_t *order;
    uint32_t n;
    TrackedQueue<S> rays;
};

__global__ void fly_through_constant(TR_STAGE, Tracked tracked, FlightColumns<S> at, bool colored, bool points) {
    each(tracked.n, [&](uint32_t i) {
        const Spectrum<F> sigma = constant_extinction<F>(stage.scene, {}, *tracked.medium);
        const uint32_t *entry = tracked.order + i;
        fly_constant(sigma, tracked.rays.ray_offset, at, colored, points, LaneSet<F>(entry, 1), *entry);
    });
}

__global__ void transmit_through_constant(TR_STAGE, Tracked tracked, TransmittanceColumns<S> at) {
    each(tracked.n, [&](uint32_t i) {
        const Spectrum<F> sigma = constant_extinction<F>(stage.scene, {}, *tracked.medium);
        const uint32_t *entry = tracked.order + i;
        transmit_constant(sigma, tracked.rays.ray_offset, at, LaneSet<F>(entry, 1), *entry);
    });
}

// Steps of rays through a grid: they start, advance to a tentative collision or to the end, collide and advance again.
struct Progress {
    bool walking, stopped;
};

template <int N, class Columns, class Estimator>
__global__ void start_tracking(TR_STAGE, Tracked tracked, Columns at, Estimator estimator, TrackedRay<F, N> *rays,
                               Progress *progress) {
    each(tracked.n, [&](uint32_t i) {
        rays[i].entry = tracked.order[i];
        progress[i] = {rays[i].start(stage.scene, *tracked.medium, tracked.rays, at, estimator, true), false};
    });
}

template <int N, class Estimator>
__global__ void advance_tracking(TR_STAGE, Tracked tracked, Estimator estimator, TrackedRay<F, N> *rays,
                                 Progress *progress) {
    each(tracked.n, [&](uint32_t i) {
        Progress &p = progress[i];
        bool left = false;
        rays[i].walk.advance(stage.scene, *tracked.medium, rays[i].depth, p.walking, p.stopped, left);
        if (left) estimator.finish(rays[i], left, false);
    });
}

template <int N, class Estimator>
__global__ void collide_tracking(TR_STAGE, Tracked tracked, Estimator estimator, TrackedRay<F, N> *rays,
                                 Progress *progress, uint32_t *exceeded) {
    each(tracked.n, [&](uint32_t i) {
        Progress &p = progress[i];
        bool above;
        p.walking |= rays[i].collide(stage.scene, *tracked.medium, estimator, p.stopped, above);
        p.stopped = false;
        accumulate(exceeded, uint32_t(count(above)));
    });
}

#define TR_TRACKING(N, Columns, Estimator)                                                                      \
    template __global__ void start_tracking(TR_STAGE, Tracked, Columns<S>, Estimator<F>, TrackedRay<F, N> *,    \
                                            Progress *);                                                        \
    template __global__ void advance_tracking(TR_STAGE, Tracked, Estimator<F>, TrackedRay<F, N> *, Progress *); \
    template __global__ void collide_tracking(TR_STAGE, Tracked, Estimator<F>, TrackedRay<F, N> *, Progress *,  \
                                              uint32_t *);
TR_TRACKING(1, FlightColumns, FlightEstimator)
TR_TRACKING(SpectrumSize, FlightColumns, FlightEstimator)
TR_TRACKING(1, TransmittanceColumns, TransmittanceEstimator)
TR_TRACKING(SpectrumSize, TransmittanceColumns, TransmittanceEstimator)
#undef TR_TRACKING

__global__ void seed_shadow_rays(TR_STAGE, ShadowQueue<S> *shadows, TransmittanceColumns<S> transmittance,
                                 uint32_t level, uint32_t round, const uint32_t *pending, uint32_t n) {
    each(n, [&](uint32_t i) {
        tr::seed_shadow_rays<F>(stage.context(), *shadows, transmittance, level, round, pending[i], true);
    });
}

__global__ void cross_boundaries(TR_STAGE, ShadowQueue<S> *shadows, TransmittanceColumns<S> transmittance,
                                 HitColumns<S> hits, const uint32_t *pending, uint32_t n, bool *goes_on) {
    each(n, [&](uint32_t i) {
        Entries<F> from(i);
        goes_on[i] =
            cross_boundary<F>(stage.context(), *shadows, transmittance, from(hits.at), from(hits.t), pending[i], true);
    });
}

// ------------------------------------------------------------------------------------------------------- light paths
__global__ void start_light_paths(TR_STAGE, uint32_t n_slots, PathQueue<S> out, ShadowQueue<S> connections,
                                  uint32_t *out_end, uint32_t *end) {
    each(n_slots, [&](uint32_t i) {
        append_own(out, out_end, i, 1, [&](PathQueue<S> &own) {
            append_own(connections, end, i, 1, [&](ShadowQueue<S> &own_connections) {
                tr::start_light_paths(stage.context(), stage.light_sensor(), i, n_slots, own, own_connections);
            });
        });
    });
}

__global__ void shade_light_paths(TR_STAGE, TR_HITS, PathQueue<S> out, ShadowQueue<S> connections, uint32_t *out_end,
                                  uint32_t *end) {
    each(at, [&](uint32_t i, const LaneSet<F> &lanes) {
        append_own(out, out_end, i, 1, [&](PathQueue<S> &own) {
            append_own(connections, end, i, 1, [&](ShadowQueue<S> &own_connections) {
                shade_light_path(stage.context(), stage.light_sensor(), at.kind, at.step, *at.queue, at.hits, lanes, i,
                                 own, own_connections);
            });
        });
    });
}

// --------------------------------------------------------------------------------------------------- the derivative
// Entries of one kind of a tape's level, the level of those before them, and where their gradients go: all lanes add to
// one gradient, each through a sink of its own.
struct Sweep {
    int kind;
    uint32_t begin, count, level;
    bool scatters, has_parents, has_branches, unit_adjoint;
    TapeColumns<S> parents;
    BranchColumns<S> branches;
    GradientSink<F> sink;
    uint32_t *non_finite;

    __device__ SweepContext<F> context(const Stage &stage) const {
        return {stage.scene,
                stage.config,
                stage.slots,
                stage.needs,
                stage.width,
                stage.height,
                has_branches ? &branches : nullptr,
                unit_adjoint};
    }
    template <class Do>
    __device__ void each(Do &&f) const {
        const uint32_t i = thread_index();
        if (i >= count) return;
        GradientSink<F> own = sink;
        f(begin + i, has_parents ? &parents : nullptr, own);
        accumulate(non_finite, own.non_finite);
    }
};

__global__ void sweep_light_vertices(TR_STAGE, __grid_constant__ const Sweep sweep) {
    sweep.each([&](uint32_t i, const TapeColumns<S> *parents, GradientSink<F> &sink) {
        sweep_light_vertex(sweep.context(stage), stage.light_sensor(), stage.tape, parents, sweep.kind, i, true, sink);
    });
}

}  // namespace stages
}  // namespace tr
