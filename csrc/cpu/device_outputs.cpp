// Outputs besides radiance on a device, and their derivatives: as render_aovs.cpp, sample by sample.
#include "device_work.h"

namespace tr {

template <class S>
struct DevicePaths<S>::Outputs {
    const AovOutput<S> &out;
    AovLayout layout;
    Filter filter;
    OutputValues<S> value{};

    Outputs(const RenderCall<S> &call, const AovOutput<S> &out_, const AovLayout &layout_)
        : out(out_), layout(layout_), filter(filter_of(out, call.filter)) {}

    FirstHitStage<S> first_hits(const Work &work, const BatchColumns<S> &at) const {
        return {work.stage, layout, at.queues[0], at.hits, at.out_key};
    }
};

namespace {

// (results, channels): numbers of all outputs, one result after the other.
template <class S>
std::vector<S> interleave(const AovLayout &layout, const AovOutput<S> &out, size_t n) {
    std::vector<S> r(n * size_t(layout.n));
    for (int kind = 0; kind < AovCount; ++kind) {
        if (!layout.wants(kind)) continue;
        const auto channels = size_t(layout.count(kind));
        const S *from = out.data[size_t(kind)];
        for (size_t i = 0; i < n; ++i)
            std::copy_n(from + i * channels, channels, &r[i * size_t(layout.n) + size_t(layout.offset[kind])]);
    }
    return r;
}

template <class S>
size_t n_results(const RenderCall<S> &call) {
    return call.pixels ? call.pixels->size() : size_t(call.crop.height()) * size_t(call.crop.width());
}

}  // namespace

// Calls body(batch) for the batches of all passes, whose camera rays were traced.
template <class S>
template <class Body>
void DevicePaths<S>::for_first_hits(Work &work, RenderStats &stats, const Outputs &outputs, bool silent, Body &&body) {
    for (const uint64_t seed : outputs.out.seeds) {
        work.stage.config.seed = seed;
        for_batches(work, stats, silent, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            start(work, batch.size);
            trace_hits(work, at_.queues[0], camera_, work.stage.config.hide_emitters, batch.size);
            body(batch);
        });
        if (stats.interrupted) return;
    }
}

template <class S>
void DevicePaths<S>::add_outputs(const Work &work, const SampleNumbers &batch, const Outputs &outputs) {
    const auto [first, n_targets] = work.targets(batch.units);
    launcher_.run(AddOutputsToFilm<S>{gather(work, batch, outputs.filter, first), int32_t(outputs.layout.n),
                                      outputs.value, at_.slots.alpha.at},
                  n_targets);
}

template <class S>
RenderStats DevicePaths<S>::outputs(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                    const AovOutput<S> &out) {
    Outputs outputs(call, out, layout_of(out, call.values));
    const int n = outputs.layout.n;
    return run(call, data, tree, nullptr, n, [&](Work &work, RenderStats &stats) {
        if (n > 0) {
            outputs.value = values(work, n);
            begin_film(work, n + 2);
            for_first_hits(work, stats, outputs, false, [&](const SampleNumbers &batch) {
                launcher_.run(EvaluateOutputs<S>{outputs.first_hits(work, at_), outputs.value}, batch.size);
                add_outputs(work, batch, outputs);
            });
        }
        if (!stats.interrupted && (out.shape || out.primitive || out.material)) identify(work, out, stats);
        if (stats.interrupted) return;
        finish(work, stats);
        if (n > 0) write_outputs(work.schedule, outputs.layout, download_film(work, n + 2), out, false);
    });
}

template <class S>
RenderStats DevicePaths<S>::reverse_outputs(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                            const AovOutput<S> &out, DerivativeCall<S> &derivative) {
    Outputs outputs(call, out, layout_of(out, call.values)), none(call, out, no_outputs(call));
    const std::vector<S> adjoint = interleave(outputs.layout, out, n_results(call));
    derivative.adjoint = adjoint.data();
    return run(call, data, tree, &derivative, outputs.layout.n, [&](Work &work, RenderStats &stats) {
        begin_film(work, 2);
        for_first_hits(work, stats, none, true, [&](const SampleNumbers &batch) {
            launcher_.run(EvaluateOutputs<S>{none.first_hits(work, at_), none.value}, batch.size);
            add_outputs(work, batch, none);
        });
        if (stats.interrupted) return;
        derivative_.begin_adjoint(launcher_, call, work.schedule, {adjoint.data(), outputs.layout.n},
                                  {sums_.get(), out.zero_at_misses ? 1 : 0});
        outputs.value = values(work, outputs.layout.n);
        DerivativePlaces<S> to = derivative_.begin_gradients(launcher_, derivative, call.on_device, totals_.get() + 3);
        for_first_hits(work, stats, outputs, false, [&](const SampleNumbers &batch) {
            launcher_.run(CollectOutputs<S>{derivative_.gather(outputs.filter, at_.slots), outputs.value}, batch.size);
            for (int sweep = to.fixed ? 0 : 1; sweep < 2; ++sweep) {  // the first of two measures
                to.measures = sweep == 0;
                launcher_.run(SweepOutputs<S>{outputs.first_hits(work, at_), outputs.value, to}, batch.size);
            }
            derivative_.settle(launcher_);
        });
        if (stats.interrupted) return;
        finish(work, stats);
        derivative_.finish_gradients(launcher_, derivative, call.on_device, call.threads);
    });
}

template <class S>
RenderStats DevicePaths<S>::forward_outputs(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                            const AovOutput<S> &out, const DerivativeCall<S> &derivative) {
    Outputs outputs(call, out, layout_of(out, call.values));
    const int n = outputs.layout.n;
    return run(call, data, tree, &derivative, n, [&](Work &work, RenderStats &stats) {
        outputs.value = values(work, n);
        const DerivativePlaces<S> to = derivative_.tangents(launcher_, derivative, call.on_device, totals_.get() + 3);
        begin_film(work, n + 2);
        for_first_hits(work, stats, outputs, false, [&](const SampleNumbers &batch) {
            launcher_.run(SweepOutputs<S>{outputs.first_hits(work, at_), outputs.value, to}, batch.size);
            add_outputs(work, batch, outputs);
        });
        if (stats.interrupted) return;
        finish(work, stats);
        write_outputs(work.schedule, outputs.layout, download_film(work, n + 2), out, true);
    });
}

template <class S>
OutputValues<S> DevicePaths<S>::values(const Work &work, int n) {
    values_.reserve(launcher_, size_t(n) * work.batch);
    return {values_.get(), uint32_t(work.batch)};
}

// What the rays through the centres of the wanted pixels hit.
template <class S>
void DevicePaths<S>::identify(const Work &work, const AovOutput<S> &out, RenderStats &stats) {
    const TileSchedule &schedule = work.schedule;
    const size_t n_all = schedule.n_results();
    std::vector<uint32_t> row, column, shape, primitive;
    for (size_t first = 0; first < n_all && !stats.interrupted; first += work.batch) {
        const size_t n = std::min(work.batch, n_all - first);
        for (auto *numbers : {&row, &column, &shape, &primitive}) numbers->resize(n);
        for (size_t k = 0; k < n; ++k) {
            const Pixel at = schedule.target(schedule.target_of(first + k));
            row[k] = uint32_t(at.y), column[k] = uint32_t(at.x);
        }
        launcher_.upload(at_.slots.row.at, row.data(), n * sizeof(uint32_t));
        launcher_.upload(at_.slots.column.at, column.data(), n * sizeof(uint32_t));
        launcher_.run(StartCentres<S>{work.stage, at_.queues[0], at_.hits, at_.out_key}, uint32_t(n));
        list_started(uint32_t(n), camera_);
        trace_hits(work, at_.queues[0], camera_, work.stage.config.hide_emitters, uint32_t(n));
        launcher_.download(shape.data(), at_.hits.at.shape, n * sizeof(uint32_t));
        launcher_.download(primitive.data(), at_.hits.at.primitive, n * sizeof(uint32_t));
        for (size_t k = 0; k < n; ++k) write_identifiers(*work.call.scene, first + k, shape[k], primitive[k], out);
        stats.interrupted = work.call.interrupted && work.call.interrupted(double(first + n) / double(n_all));
    }
}

template class DevicePaths<float>;
template class DevicePaths<double>;

}  // namespace tr
