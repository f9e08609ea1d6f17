// The path tracer on a device: batches of samples as wavefronts (device/path_kernels.h), which add to a film there, and
// outputs of first hits (device/output_kernels.h). In rgb; light goes straight. Of a derivative paths are on a tape,
// over which device/derivative_kernels.h then runs backwards.
#pragma once

#include "aovs.h"
#include "device/device_scene.h"
#include "device/output_sweep_kernels.h"
#include "device_boundary.h"
#include "device_derivative.h"
#include "device_tile.h"
#include "render.h"

namespace tr {

template <class S>
class DevicePaths : DeviceTile<S> {
    using Base = DeviceTile<S>;

public:
    // The launcher has to live longer. `memory`: bytes for the paths of a batch, and `TapeShare` times as many for
    // those of a derivative, less where there is not that much; scene and film have theirs besides.
    DevicePaths(Launcher &launcher, size_t memory) : Base(launcher), memory_(memory) {}
    explicit DevicePaths(Launcher &launcher) : DevicePaths(launcher, launcher.batch_memory()) {}

    // As render_primal, render_reverse and render_forward: the same samples; images are summed in the same order,
    // gradients in any. `call.scene` is that of `data`, and `tree` its tree on the device. std::invalid_argument for
    // what is not there, see the beginning. A call that is interrupted changes nothing.
    RenderStats render(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                       const RenderOutput<S> &out);
    RenderStats reverse(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                        DerivativeCall<S> &derivative);
    RenderStats forward(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                        const DerivativeCall<S> &derivative, S *image);
    // As render_aov, reverse_aov and forward_aov.
    RenderStats outputs(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                        const AovOutput<S> &out);
    RenderStats reverse_outputs(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                const AovOutput<S> &out, DerivativeCall<S> &derivative);
    RenderStats forward_outputs(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                const AovOutput<S> &out, const DerivativeCall<S> &derivative);

    // As trace_light, trace_light_reverse and trace_light_forward, the sums of images being whole multiples of units
    // (FixedSum), in any order.
    RenderStats light(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree, S *image,
                      FilmSums *sums);
    RenderStats reverse_light(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                              DerivativeCall<S> &derivative);
    RenderStats forward_light(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                              const DerivativeCall<S> &derivative, S *image);

    // Derivatives of moving outlines.
    DeviceBoundary<S> &boundary();

    // Of `memory` a path takes, without the tape.
    using Base::bytes_per_path;
    using Base::TapeShare;

private:
    using Base::at_, Base::camera_, Base::capacity_, Base::launcher_, Base::levels_, Base::lit_, Base::live_,
        Base::parts_, Base::sorted_, Base::totals_, Base::tracking_;
    using Base::begin_step, Base::keep, Base::list_started, Base::live, Base::LevelsBetweenLooks, Base::reserve,
        Base::shading, Base::sort_hits, Base::start, Base::sweep, Base::trace_hits, Base::trace_paths;
    using typename Base::Sorted, typename Base::TapeLevel;
    static constexpr int Radiance = -1, Light = -2;  // in place of a number of channels: of paths, of light's

    // What one call is about, and where the pixels of a tile are in a list of them.
    struct Work;
    struct TileList {
        uint32_t pixel = 0, place = 0;
    };

    size_t memory_;
    DeviceScene<S> scene_;
    DeviceArray<int32_t> kinds_, targets_;
    DeviceArray<double> sums_, open_;
    DeviceArray<FixedSum<S>> splats_;  // on their way to the former
    DeviceArray<S> splat_adjoint_;     // of these
    DeviceArray<S> results_;           // of an image
    HostBuffer film_;                  // they, or the sums, on their way back
    DeviceArray<int32_t> pixels_, places_;
    DeviceArray<FilmUnit> units_;
    DeviceArray<OwnSamples> own_;
    DeviceArray<S> values_;  // of outputs, by channel and sample
    DeviceDerivative<S> derivative_;
    std::unique_ptr<DeviceBoundary<S>> boundary_;  // once it was wanted

    static void check(const RenderCall<S> &call);
    static std::vector<OwnSamples> own_samples(const Work &work, const WorkItem &units, size_t unit, const Tile &tile);
    // `channels` of outputs besides radiance, or Radiance.
    template <class Do>
    RenderStats run(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                    const DerivativeCall<S> *derivative, int channels, Do &&f);
    void release();
    void release_paths();
    Work begin(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree, const TileSchedule &schedule,
               const DerivativeCall<S> *derivative, int channels);
    template <class Body>
    void for_batches(const Work &work, RenderStats &stats, bool silent, Body &&body);
    void finish(const Work &work, RenderStats &stats) const;

    // the film
    ListedPixels list_pixels(const TileSchedule &schedule, std::vector<TileList> &lists);
    void begin_film(const Work &work, int channels);
    void number_samples(Work &work, const SampleNumbers &batch);
    FilmGather<S> gather(const Work &work, const SampleNumbers &batch, const Filter &filter, uint32_t first) const;
    void add_to_film(const Work &work, const SampleNumbers &batch, int colors, int moments);
    const double *download_film(const Work &work, int channels);
    void write_image(const Work &work, int moments, const RenderOutput<S> &out);
    void begin_adjoint(Work &work, const S *image, RenderStats &stats);

    // a batch of n paths
    void sweep_gradients(const Work &work, DerivativePlaces<S> to);
    void sweep_components(const Work &work, DerivativePlaces<S> to, uint32_t n);

    // light paths
    template <class Do>
    RenderStats run_light(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                          const DerivativeCall<S> *derivative, Do &&f);
    template <class Visit>
    void trace_light(const Work &work, uint32_t n, Visit &&visit);
    void trace_connections(const Work &work, const PathStage<S> &stage, uint32_t n);
    FreeConnections<S> free_connections() const { return {at_.shadows, lit_, at_.shadow_key}; }
    void begin_splats(const RenderCall<S> &call);
    template <class Splat>
    void add_splats(const RenderCall<S> &call, Splat splat, uint32_t n);
    void write_splats(const RenderCall<S> &call, S *image, FilmSums *sums);
    void splat_tangents(const Work &work, const RenderCall<S> &call, DerivativePlaces<S> to);

    // outputs besides radiance
    struct Outputs;
    template <class Body>
    void for_first_hits(Work &work, RenderStats &stats, const Outputs &outputs, bool silent, Body &&body);
    OutputValues<S> values(const Work &work, int n);
    void add_outputs(const Work &work, const SampleNumbers &batch, const Outputs &outputs);
    void identify(const Work &work, const AovOutput<S> &out, RenderStats &stats);
};

}  // namespace tr
