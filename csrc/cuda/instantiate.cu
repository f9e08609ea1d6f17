// The renderer's core compiled for a device, with F = float: the kernels of csrc/device, which the emulated device runs
// (cpu/device_paths.cpp and device_light.cpp have their schedules).
//
// `make cuda-check` compiles and links them, which shows that the core needs nothing that device code does not have:
// functions and data of the host, static variables that are initialised when the program runs, exceptions, virtual
// functions. It says nothing about results.
#include "core_sources.h"  // all .cpp files of the core, see the Makefile
#include "device/adjoint_kernels.h"
#include "device/derivative_kernels.h"
#include "device/film_kernels.h"
#include "device/light_kernels.h"
#include "device/medium_kernels.h"
#include "device/output_sweep_kernels.h"
#include "device/path_kernels.h"
#include "device/ray_kernels.h"
#include "device/sort_kernels.h"
#include "device/splat_kernels.h"

namespace tr {
namespace kernels {

template <class K>
__global__ void run(__grid_constant__ const K kernel, uint32_t n) {
    if constexpr (IsBlockKernel<K>::value) {
        __shared__ typename K::Shared shared;
        for (uint32_t i = blockIdx.x; i < n; i += gridDim.x) kernel(Block<typename K::Shared>{shared, i}, i);
    } else {
        for (uint32_t i = blockIdx.x * blockDim.x + threadIdx.x; i < n; i += gridDim.x * blockDim.x) kernel(i);
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
TR_RUN(StartLightPaths)
TR_RUN(ShadeLightPaths)
TR_RUN(TraceConnections)
TR_RUN(SplatConnections)
TR_RUN(CollectConnections)
TR_RUN(KeepConnections)
TR_RUN(SetAdjoints)
TR_RUN(SplatTangents)
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
TR_RUN(SweepLightVertices)
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

}  // namespace kernels
}  // namespace tr
