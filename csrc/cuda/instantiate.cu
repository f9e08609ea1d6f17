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
#include "device/output_sight_kernels.h"
#include "device/output_sweep_kernels.h"
#include "device/path_kernels.h"
#include "device/ray_kernels.h"
#include "device/sort_kernels.h"
#include "device/splat_kernels.h"
#include "device/vertex_edge_kernels.h"
#include "device/vertex_outline_kernels.h"

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
TR_RUN(StartPaths<float>)
TR_RUN(TracePaths<float>)
TR_RUN(ClassifyHits<float>)
TR_RUN(ShadeHits<float>)
TR_RUN(TraceShadows<float>)
TR_RUN(BeginMedia<float>)
TR_RUN(FlyRays<float>)
TR_RUN(ShadeInMedia<float>)
TR_RUN(TransmitShadows<float>)
TR_RUN(StartBranches<float>)
TR_RUN(FinishBranches<float>)
TR_RUN(StartLightPaths<float>)
TR_RUN(ShadeLightPaths<float>)
TR_RUN(TraceConnections<float>)
TR_RUN(SplatConnections<float>)
TR_RUN(CollectConnections<float>)
TR_RUN(KeepConnections<float>)
TR_RUN(SetAdjoints<float>)
TR_RUN(SplatTangents<float>)
TR_RUN(CountKeys)
TR_RUN(SumKeys)
TR_RUN(PlaceKeys)
TR_RUN(FillWords)
TR_RUN(FillNumbers<float>)
TR_RUN(NumberSamples<float>)
TR_RUN(AddToFilm<float>)
TR_RUN(PlaceSamples<float>)
TR_RUN(KeepSmooth<float>)
TR_RUN(DivideAdjoint<float>)
TR_RUN(CollectAdjoints<float>)
TR_RUN(SweepVertices<float>)
TR_RUN(SweepLightVertices<float>)
TR_RUN(SumCopies)
TR_RUN(SettleSums<float>)
TR_RUN(EvaluateOutputs<float>)
TR_RUN(StartCentres<float>)
TR_RUN(AddOutputsToFilm<float>)
TR_RUN(CollectOutputs<float>)
TR_RUN(SweepOutputs<float>)
TR_RUN(FindSights<float>)
TR_RUN(StartSights<float>)
TR_RUN(AddSights<float>)
TR_RUN(LookUpOutputs<float>)
TR_RUN(AddOutputSights<float>)
TR_RUN(FindEdges<float>)
TR_RUN(ShadeEnds<float>)
TR_RUN(ConnectEdges<float>)
TR_RUN(AddEdges<float>)
TR_RUN(TellEdges<float>)
TR_RUN(SweepPlaces<float>)
TR_RUN(NumberOutlines<float>)
TR_RUN(KeepInPixels<float>)
TR_RUN(ChooseVertices<float>)
TR_RUN(LookAtVertices<float>)
TR_RUN(ScatterTowards<float>)
TR_RUN(ListEdges<float>)
TR_RUN(ShareEdges<float>)
TR_RUN(AimAtEdges<float>)
TR_RUN(SeeEdges<float>)
TR_RUN(SlideVertices<float>)
TR_RUN(ShareOutlines<float>)
TR_RUN(ChooseOutlines<float>)
TR_RUN(FindOutlines<float>)
TR_RUN(LookPastOutlines<float>)
TR_RUN(StartOutlines<float>)
TR_RUN(TakeOutlines<float>)
TR_RUN(AddOutlines<float>)
TR_RUN(WeighSights<float>)
TR_RUN(WeighEdges<float>)
TR_RUN(WeighOutlines<float>)
TR_RUN(IntersectRays)
TR_RUN(OccludeRays)
#undef TR_RUN

}  // namespace kernels
}  // namespace tr
