// The renderer's core compiled for a device, with F = float: the kernels of csrc/device, which the emulated device runs
// (cpu/device_paths.cpp has their schedule), and for all else that a schedule of the CPU calls for a packet a kernel
// that calls it for one lane. Such a kernel builds the context and the accessors from its arguments and does nothing
// else; nothing launches it yet.
//
// `make cuda` compiles and links them, which shows that the core needs nothing that device code does not have:
// functions and data of the host, static variables that are initialised when the program runs, exceptions, virtual
// functions. It says nothing about results.
#include "core_sources.h"  // all .cpp files of the core, see the Makefile
#include "device/adjoint_kernels.h"
#include "device/derivative_kernels.h"
#include "device/film_kernels.h"
#include "device/medium_kernels.h"
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
TR_RUN(BeginMedia)
TR_RUN(FlyRays)
TR_RUN(ShadeInMedia)
TR_RUN(TransmitShadows)
TR_RUN(StartBranches)
TR_RUN(FinishBranches)
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
    uint32_t begin, count;
    bool has_parents, unit_adjoint;
    TapeColumns<S> parents;
    GradientSink<F> sink;
    uint32_t *non_finite;

    __device__ SweepContext<F> context(const Stage &stage) const {
        return {stage.scene, stage.config, stage.slots, stage.needs, stage.width, stage.height, nullptr, unit_adjoint};
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
