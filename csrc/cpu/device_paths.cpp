#include <algorithm>
#include <stdexcept>
#include <string>

#include "device_work.h"

namespace tr {

template <class S>
void DevicePaths<S>::check(const RenderCall<S> &call) {
    const char *missing = call.config.stokes                    ? "polarised light"
                          : call.config.spectral.positions      ? "wavelengths"
                          : call.scene->bends                   ? "media that light bends in"
                          : call.ray_record                     ? "records of rays"
                          : call.keep_hits                      ? "hits that are kept"
                          : call.pixels && call.on_device.image ? "lists of pixels in images that lie there"
                                                                : nullptr;
    if (missing) throw std::invalid_argument(std::string("device: there are no ") + missing + " on devices yet");
}

// ---------------------------------------------------------------------------------------------------------- a call
template <class S>
typename DevicePaths<S>::Work DevicePaths<S>::begin(const RenderCall<S> &call, const SceneData<S> &data,
                                                    const TreeView &tree, const TileSchedule &schedule,
                                                    const DerivativeCall<S> *derivative, int channels) {
    const SceneView<S> &host = *call.scene;
    const bool media = call.config.volumetric, light = channels == Light, paths = channels < 0;
    Work work{{call, {}, tree, kinds_in(host, call.config, derivative && paths, light)}, schedule};
    for (size_t i = 0; i < schedule.n_tiles(); ++i) work.n_paths += schedule.n_paths(i);
    if (call.pixels) work.list = list_pixels(schedule, work.lists);
    size_t memory = memory_, bytes = bytes_per_path({media, light});
    if (!paths) bytes += size_t(channels) * sizeof(S);
    if (derivative) work.parts.motion = derivative->needs.numbers();
    if (derivative && paths) {
        const int depth = call.config.max_depth, levels = depth < 0 || media ? MostLevels : std::min(depth, MostLevels);
        memory *= TapeShare;
        work.parts = {host.has_stacks, host.follows_tangent,         derivative->needs.numbers(), media,
                      light,           light && !derivative->adjoint};
        bytes += size_t(levels + work.splits()) * DeviceTapeLevels<S>::bytes_per_entry(work.parts);
    }
    work.batch = std::max<size_t>(1, std::min(std::max<size_t>(memory / bytes, 1), size_t(work.n_paths)));
    reserve(work.batch, {media, light});
    this->clear_totals();

    SceneFacts &facts = work.facts = SceneFacts(host, call.config);
    facts.records = derivative && paths, facts.forward = derivative && !derivative->adjoint;
    facts.light_paths = light;
    facts.motion = work.parts.motion, facts.fixed_sums = derivative && derivative->fixed_sums;
    launcher_.know(facts);
    const std::vector<int32_t> kinds = kinds_of_bsdfs(host);
    kinds_.upload(launcher_, kinds.data(), kinds.size());
    work.kind_of_bsdf = kinds_.get();
    work.stage = {scene_.upload(launcher_, data, call.on_device.values, call.threads),
                  call.config,
                  at_.slots,
                  at_.lost,
                  S(call.film_width),
                  S(call.film_height)};
    if (derivative) {
        const GradientNeeds needs = work.stage.needs = derivative_.needs(launcher_, *derivative);
        work.stage.records = paths;
        work.stage.bsdfs_alone = !media && needs.bsdf && !needs.emitter && !needs.numbers() && !needs.camera;
    }
    if (media) work.media = this->media(host, derivative && paths ? &work.stage.needs : nullptr);
    return work;
}

// What batches take, of outlines, too.
template <class S>
void DevicePaths<S>::release() {
    release_paths();
    if (boundary_) boundary_->release();
}

template <class S>
RenderStats DevicePaths<S>::render(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                   const RenderOutput<S> &out) {
    return run(call, data, tree, nullptr, Radiance, [&](Work &work, RenderStats &stats) {
        const int colors = call.values, moments = out.to.variance || out.to.second_moment ? colors : 0;
        const int channels = FilmBlock::channels(colors + 1, moments);
        begin_film(work, channels);
        for_batches(work, stats, false, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            trace_paths(work, batch.size);
            add_to_film(work, batch, colors, moments);
        });
        if (stats.interrupted) return;
        finish(work, stats);
        write_image(work, moments, out);
    });
}

template <class S>
RenderStats DevicePaths<S>::reverse(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                    DerivativeCall<S> &derivative) {
    return run(call, data, tree, &derivative, Radiance, [&](Work &work, RenderStats &stats) {
        work.skips_zero_adjoints = true;
        begin_adjoint(work, derivative.adjoint, stats);
        if (stats.interrupted) return;
        const DerivativePlaces<S> to =
            derivative_.begin_gradients(launcher_, derivative, call.on_device, totals_.get() + 3);
        for_batches(work, stats, false, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            if (call.filter.reach() > 0) launcher_.run(PlaceSamples<S>{call.config, at_.slots}, batch.size);
            launcher_.run(
                CollectAdjoints<S>{derivative_.gather(call.filter, at_.slots), at_.slots.alpha.at, at_.slots.delta},
                batch.size);
            trace_paths(work, batch.size);
            sweep_gradients(work, to);
        });
        if (stats.interrupted) return;
        finish(work, stats);
        derivative_.finish_gradients(launcher_, derivative, call.on_device, call.threads);
    });
}

template <class S>
RenderStats DevicePaths<S>::forward(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                    const DerivativeCall<S> &derivative, S *image) {
    return run(call, data, tree, &derivative, Radiance, [&](Work &work, RenderStats &stats) {
        const DerivativePlaces<S> to = derivative_.tangents(launcher_, derivative, call.on_device, totals_.get() + 3);
        const int channels = FilmBlock::channels(call.values + 1, 0);
        begin_film(work, channels);
        for_batches(work, stats, false, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            trace_paths(work, batch.size);
            sweep_components(work, to, batch.size);
            add_to_film(work, batch, call.values, 0);
        });
        if (stats.interrupted) return;
        finish(work, stats);
        write_image(work, 0, {{image}});
    });
}

template <class S>
void DevicePaths<S>::finish(const Work &work, RenderStats &stats) const {
    this->add_totals(stats);
    stats.seconds = work.seconds();
}

// In reverse mode, the gradients of a batch.
template <class S>
void DevicePaths<S>::sweep_gradients(const Work &work, DerivativePlaces<S> to) {
    to.measures = to.fixed;
    sweep(work, to, false);
    if (to.fixed) {
        to.measures = false;
        sweep(work, to, false);
    }
    derivative_.settle(launcher_);
}

// In forward mode, as PathTile::sweep_tape: numbers need a sweep a component.
template <class S>
void DevicePaths<S>::sweep_components(const Work &work, DerivativePlaces<S> to, uint32_t n) {
    if (!work.stage.needs.numbers()) return sweep(work, to, true);
    for (to.component = 0; to.component < work.call.values; ++to.component) {
        for (int c = 0; c < SpectrumSize; ++c) {
            launcher_.run(FillNumbers<S>{at_.slots.delta[c], S(c == to.component ? 1 : 0)}, n);
        }
        sweep(work, to, false);
    }
}

template <class S>
void DevicePaths<S>::release_paths() {
    Base::release();
    values_ = DeviceArray<S>();
}

template <class S>
DeviceBoundary<S> &DevicePaths<S>::boundary() {
    if (!boundary_)
        boundary_ = std::make_unique<DeviceBoundary<S>>(launcher_, scene_, memory_, [this] { release_paths(); });
    return *boundary_;
}

template class DevicePaths<float>;
template class DevicePaths<double>;

}  // namespace tr
