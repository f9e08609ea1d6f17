// The derivative of moving outlines on a device: the samples of boundary_{seen,outputs,lights,reflections}.h by the
// kernels of device/{sight,output_sight,shadow,vertex}_kernels.h, their paths and light by those of paths. Not of
// polarised light, wavelengths, media that light bends in, and of more in media than the camera sees, which nobody
// computes.
#pragma once

#include <functional>
#include <utility>

#include "boundary_call.h"
#include "device/device_scene.h"
#include "device/output_sight_kernels.h"
#include "device/vertex_edge_kernels.h"
#include "device/vertex_outline_kernels.h"
#include "device_derivative.h"
#include "device_outlines.h"
#include "device_tile.h"

namespace tr {

// Columns in a device's memory.
template <class Columns>
class DeviceColumns {
public:
    Columns at{};

    void reserve(Launcher &launcher, size_t n) {
        if (n <= n_) return;
        const size_t aligned = (n + 63) / 64 * 64;  // arrays begin at lines of the memory
        size_t bytes = 0;
        at.for_arrays([&](auto *&array) { bytes += aligned * sizeof(*array); });
        n_ = 0;
        memory_.reserve(launcher, bytes);
        uint8_t *next = memory_.get();
        at.for_arrays([&](auto *&array) {
            array = reinterpret_cast<std::remove_reference_t<decltype(array)>>(next);
            next += aligned * sizeof(*array);
        });
        n_ = n;
    }

private:
    DeviceArray<uint8_t> memory_;
    size_t n_ = 0;
};

template <class S>
class DeviceBoundary {
public:
    // The launcher and the scene's tables have to live longer. `memory`: bytes of a batch, see DevicePaths;
    // release_others() gives back what others have of the device's.
    DeviceBoundary(Launcher &launcher, DeviceScene<S> &scene, size_t memory, std::function<void()> release_others)
        : launcher_(launcher),
          scene_(scene),
          paths_(launcher),
          ends_(launcher),
          light_(launcher),
          memory_(memory),
          release_others_(std::move(release_others)) {}

    // As boundary_reverse and boundary_forward. std::invalid_argument for what is not there, see the beginning.
    std::vector<RenderStats> reverse(const std::vector<RenderCall<S>> &calls,
                                     const std::vector<BoundaryCall<S>> &boundaries, const SceneData<S> &data,
                                     const TreeView &tree, DerivativeCall<S> &derivative);
    RenderStats forward(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const SceneData<S> &data,
                        const TreeView &tree, const DerivativeCall<S> &derivative);
    // The same of pieces, which have no derivative.
    RenderStats look(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const SceneData<S> &data,
                     const TreeView &tree, const DerivativeCall<S> &derivative);

    // What batches take.
    void release();

private:
    struct Work;
    using TapeLevel = typename DeviceTile<S>::TapeLevel;

    Launcher &launcher_;
    DeviceScene<S> &scene_;
    DeviceOutlines outlines_;
    // As on the CPU: the samples' paths, rays to the ends of edges, and what is seen beside outlines, two rays of each.
    DeviceTile<S> paths_, ends_, light_;
    DeviceDerivative<S> derivative_;
    size_t memory_;
    const std::function<void()> release_others_;
    DeviceArray<int32_t> kinds_, lights_;
    DeviceArray<int64_t> cells_;
    DeviceArray<uint8_t> moves_;
    DeviceArray<double> adjoint_, place_, value_, cdf_;
    DeviceArray<uint64_t> non_finite_;  // derivatives that are not, which nobody asks for
    DeviceArray<ShapeInfo> shapes_;     // where lights are dark
    DeviceArray<S> lens_, apart_, carried_, outputs_;
    DeviceArray<SightRecord<S>> sights_;
    // of chosen vertices
    DeviceColumns<AnchorColumns<S>> anchors_;
    DeviceColumns<TowardsColumns<S>> towards_;
    DeviceArray<double> totals_;  // three numbers a slot
    DeviceArray<TapeLevelTable<S>> levels_;
    // of edges: as lights find them, and as vertices get them
    DeviceColumns<ShadowEdgeColumns<S>> edge_columns_[2];
    DeviceArray<ShadowRecord<S>> edges_[2];
    DeviceArray<uint32_t> order_, counts_;
    // of outlines that vertices see
    DeviceArray<uint32_t> copies_, begins_, slots_;
    DeviceArray<OutlineChoice> choices_;
    DeviceArray<OutlineRecord<S>> records_;

    Work begin(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const SceneView<S> &scene,
               const TreeView &tree, const DerivativeCall<S> &derivative, bool forward);
    void reserve(Work &work);
    size_t bytes_per_sample(const Work &work) const;
    void list_lights(Work &work);
    template <class Do>
    auto with_memory(Do &&f);
    RenderStats run(Work &work, const DerivativePlaces<S> &to);
    template <class Places>
    RenderStats tell(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const SceneData<S> &data,
                     const TreeView &tree, const DerivativeCall<S> &derivative, Places &&places);
    void begin_call(const SceneView<S> *&scene, const RenderCall<S> &call, const SceneData<S> &data);

    void see_from_camera(Work &work, uint32_t n, const DerivativePlaces<S> &to);
    void look_up_light(Work &work, uint32_t n);
    void see_from_lights(Work &work, uint32_t n, const DerivativePlaces<S> &to);
    void see_from_vertices(Work &work, uint32_t n, const DerivativePlaces<S> &to);

    // Calls visit(level, its number, kind) for what scatters smoothly.
    template <class Visit>
    void for_smooth(const Work &work, DeviceTile<S> &tile, Visit &&visit);
    void trace_paths(Work &work, uint32_t n);
    void choose_vertices(const Work &work, const VectorColumn<S> &towards);
    void look_at_vertices(const Work &work, bool lobes);
    void scatter(const Work &work, const uint32_t *slots, uint32_t n);
    VertexTotals totals(const Work &work) const;
    TapeLevelTables<S> levels(const Work &work) const;
    void find_edges(Work &work, uint32_t n);
    void share_edges(Work &work, uint32_t n);
    void shade_ends(const Work &work, int depth, uint32_t n);
    void settle(Work &work, uint32_t n, uint32_t which, const DerivativePlaces<S> &to);
    // `slots`: whose radiance gets derivatives.
    void sweep_places(DeviceTile<S> &tile, const DeviceCall<S> &of, const SlotColumns<S> &slots,
                      const DerivativePlaces<S> &to, bool from_camera, bool chosen, const VectorColumn<S> &p_bar);
    // Calls add(to) in reverse mode, where sums are measured first twice.
    template <class Add>
    void hand_back(DerivativePlaces<S> to, Add &&add);
    // ... or in forward mode for every component, whose derivatives go to the radiance of n of these slots.
    template <class Add>
    void hand_on(const Work &work, const SlotColumns<S> &slots, uint32_t n, DerivativePlaces<S> to, Add &&add);
    void download(Work &work, uint32_t n, uint32_t channels, bool places, uint32_t each, uint32_t which);
};

}  // namespace tr
