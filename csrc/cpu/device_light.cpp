// Light tracing on a device: as render_light.cpp, with the kernels of light_kernels.h and splat_kernels.h. Tape,
// batches and gradients are those of device_paths.cpp.
#include "device/light_kernels.h"
#include "device_work.h"
#include "light_film.h"

namespace tr {

namespace {

// All of the film is strata of the emitters, whatever is wanted of it.
template <class S>
RenderCall<S> call_of_paths(const RenderCall<S> &call) {
    RenderCall<S> r = call;
    r.crop = r.samples = Rect{0, 0, call.film_height, call.film_width};
    r.pixels = nullptr;
    r.filter = Filter();
    return r;
}

template <class S>
SplatPlace place_of(const RenderCall<S> &call) {
    return {call.filter, call.crop, call.values};
}

template <class S>
ConnectionAdjoints<S> adjoints_of(const TapeColumns<S> &tape) {
    return {tape.outgoing.emitted, tape.connection.x_bar, tape.connection.y_bar};
}

template <class S>
size_t n_sums(const RenderCall<S> &call) {
    return size_t(call.crop.height()) * size_t(call.crop.width()) * size_t(call.values);
}

}  // namespace

template <class S>
template <class Do>
RenderStats DevicePaths<S>::run_light(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                      const DerivativeCall<S> *derivative, Do &&f) {
    if (n_sums(call) > UINT32_MAX / 4) throw std::invalid_argument("device: the image has too many pixels");
    const RenderCall<S> paths = call_of_paths(call);
    return run(paths, data, tree, derivative, Light, [&](Work &work, RenderStats &stats) {
        const LightSensor<S> sensor(*call.scene, call.config.sensor, work.stage.width, work.stage.height);
        work.light = {sensor.camera, sensor.meter};
        f(work, stats);
    });
}

template <class S>
RenderStats DevicePaths<S>::light(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree, S *image,
                                  FilmSums *sums) {
    return run_light(call, data, tree, nullptr, [&](Work &work, RenderStats &stats) {
        begin_splats(call);
        for_batches(work, stats, false, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            trace_light(work, batch.size, [&](uint32_t n) {
                add_splats(call, SplatConnections<S>{place_of(call), free_connections(), {}}, n);
            });
        });
        if (stats.interrupted) return;
        finish(work, stats);
        write_splats(call, image, sums);
    });
}

template <class S>
RenderStats DevicePaths<S>::reverse_light(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                          DerivativeCall<S> &derivative) {
    static_assert(CollectConnections<S>::Stride == SplatFilm<S>::Stride);
    const std::vector<SplatFilm<S>> adjoint = adjoint_films(call, derivative.adjoint);
    return run_light(call, data, tree, &derivative, [&](Work &work, RenderStats &stats) {
        splat_adjoint_.upload(launcher_, adjoint[0].data(), adjoint[0].size() * CollectConnections<S>::Stride);
        const DerivativePlaces<S> to =
            derivative_.begin_gradients(launcher_, derivative, call.on_device, totals_.get() + 3);
        for_batches(work, stats, false, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            trace_light(work, batch.size, [&](uint32_t n) {
                launcher_.run(CollectConnections<S>{place_of(call), free_connections(), splat_adjoint_.get(),
                                                    adjoints_of(levels_[levels_.size() - 1].tape)},
                              n);
            });
            sweep_gradients(work, to);
        });
        if (stats.interrupted) return;
        finish(work, stats);
        derivative_.finish_gradients(launcher_, derivative, call.on_device, call.threads);
    });
}

template <class S>
RenderStats DevicePaths<S>::forward_light(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                          const DerivativeCall<S> &derivative, S *image) {
    return run_light(call, data, tree, &derivative, [&](Work &work, RenderStats &stats) {
        const DerivativePlaces<S> to = derivative_.tangents(launcher_, derivative, call.on_device, totals_.get() + 3);
        begin_splats(call);
        for_batches(work, stats, false, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            trace_light(work, batch.size, [&](uint32_t n) {
                const TapeLevel &level = levels_[levels_.size() - 1];
                clear(launcher_, level.kept.free.at, level.room);
                launcher_.run(KeepConnections<S>{free_connections(), level.kept, adjoints_of(level.tape)}, n);
            });
            splat_tangents(work, call, to);
        });
        if (stats.interrupted) return;
        finish(work, stats);
        write_splats(call, image, nullptr);
    });
}

// As LightTile::run. Calls visit(n) once the connections of a vertex are traced, n of them at most.
template <class S>
template <class Visit>
void DevicePaths<S>::trace_light(const Work &work, uint32_t n, Visit &&visit) {
    const int depth = work.call.config.max_depth;
    levels_.begin(work.parts);
    if (depth == 0 || work.call.scene->n_emitters == 0) return;
    PathQueue<S> *current = &at_.queues[0], *next = &at_.queues[1];
    Sorted ranges;
    const PathStage<S> first = begin_step(work, TapeLevel::NoParents, true, n, ranges);
    if (first.records) {
        launcher_.run(FillWords{ranges.begin + EmissionKind, 0}, 1);
        launcher_.run(FillWords{ranges.total + EmissionKind, n}, 1);
    }
    launcher_.run(StartLightPaths<S>{first, work.light, *current, at_.shadows, at_.out_key, at_.shadow_key, n}, n);
    list_started(n, camera_);
    trace_connections(work, first, n);
    visit(n);
    uint32_t most = n;  // that may be left
    for (int level = 0; most > 0 && (depth < 0 || level + 2 <= depth); ++level) {
        const EntryList &rays = level == 0 ? camera_ : live_;
        trace_hits(work, *current, rays, false, most);
        const PathStage<S> stage = begin_step(work, levels_.size() - 1, true, most, ranges);
        current->n = uint32_t(capacity_);  // any entry of it may be asked for
        // the last vertex, too, is connected and therefore sorted by its BSDF
        sort_hits(work, stage, {level, 0, true}, *current, rays, most, ranges);
        ShadeLightPaths<S> paths{shading(stage, {level, 0, depth < 0 || level + 3 <= depth}, *current, *next, ranges),
                                 work.light};
        for (const int32_t kind : work.kinds) {
            paths.shading.kind = kind;
            launcher_.run(paths, most, kind);
        }
        trace_connections(work, stage, most);
        visit(most);
        keep(at_.out_key, sorted_.n, live_, most);
        std::swap(current, next);
        if ((level + 1) % LevelsBetweenLooks == 0) most = live();
    }
}

// Those of a launch of n items, of which free_connections() are left.
template <class S>
void DevicePaths<S>::trace_connections(const Work &work, const PathStage<S> &stage, uint32_t n) {
    keep(at_.shadow_key, sorted_.n, lit_, n);
    if (work.light.meter >= 0) return;  // nothing is in the way
    launcher_.run(TraceConnections<S>{stage.scene, work.tree, at_.shadows, lit_, at_.shadow_key,
                                      stage.records ? stage.tape.outgoing.light_weight.at : nullptr, totals_.get() + 1,
                                      work.call.config.hide_emitters},
                  n);
}

template <class S>
void DevicePaths<S>::begin_splats(const RenderCall<S> &call) {
    const size_t n = n_sums(call);
    splats_.reserve(launcher_, n), sums_.reserve(launcher_, n);
    clear(launcher_, splats_.get(), n), clear(launcher_, sums_.get(), n);
}

// Launches a kernel that splats, and adds what it has found to the sums.
template <class S>
template <class Splat>
void DevicePaths<S>::add_splats(const RenderCall<S> &call, Splat splat, uint32_t n) {
    for (const bool measures : {true, false}) {
        splat.film = {splats_.get(), measures};
        launcher_.run(splat, n);
    }
    launcher_.run(SettleSums<S>{splats_.get(), 1, sums_.get(), nullptr}, uint32_t(n_sums(call)));
}

template <class S>
void DevicePaths<S>::write_splats(const RenderCall<S> &call, S *image, FilmSums *sums) {
    const size_t n = n_sums(call);
    auto *film = static_cast<double *>(film_.reserve(launcher_, n * sizeof(double)));
    sums_.download(film, n);
    const Rect &crop = call.crop;
    write_light(call, image, sums, [&](size_t, int row, int column, int c) {
        const size_t pixel = size_t(row - crop.y0) * size_t(crop.width()) + size_t(column - crop.x0);
        return film[pixel * size_t(call.values) + size_t(c)];
    });
}

// As LightTangents::sweep. Those of a level come before the sweeps of the levels behind, so that nothing is handed to
// it.
template <class S>
void DevicePaths<S>::splat_tangents(const Work &work, const RenderCall<S> &call, DerivativePlaces<S> to) {
    const bool moves = work.stage.needs.geometry;
    std::vector<int32_t> parts;
    if (!moves) parts.push_back(SplatPart::All);
    for (int c = 0; moves && c < call.values; ++c) parts.push_back(c);
    if (moves) parts.insert(parts.end(), {SplatPart::PlaceX, SplatPart::PlaceY});
    for (int l = 0; l < levels_.size(); ++l) {
        const TapeLevel &level = levels_[l];
        const ConnectionAdjoints<S> adjoints = adjoints_of(level.tape);
        for (const int32_t which : parts) {
            const SplatPart part{which};
            launcher_.run(SetAdjoints<S>{part, level.kept, adjoints}, level.room);
            for (int c = 0; c < SpectrumSize; ++c) clear(launcher_, at_.slots.radiance[c], capacity_);
            to.component = which >= 0 && !part.moves() ? which : 0;
            sweep(work, to, false, l);
            add_splats(
                call,
                SplatTangents<S>{part, place_of(call), level.kept, level.tape.vertex.slot.at, at_.slots.radiance, {}},
                level.room);
        }
        launcher_.run(SetAdjoints<S>{{SplatPart::Nothing}, level.kept, adjoints}, level.room);
    }
}

template class DevicePaths<float>;
template class DevicePaths<double>;

}  // namespace tr
