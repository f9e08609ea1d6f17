#include "device_boundary.h"

#include <algorithm>
#include <chrono>
#include <stdexcept>

#include "device_boundary_work.h"

namespace tr {

namespace {

template <class S>
void check(const RenderCall<S> &call, const BoundaryCall<S> &boundary) {
    const bool elsewhere = !is_of_camera(boundary.part);
    const char *missing = call.config.stokes                    ? "polarised light"
                          : call.config.spectral.positions      ? "wavelengths"
                          : call.scene->bends                   ? "media that light bends in"
                          : call.config.volumetric && elsewhere ? "what vertices and lights see in media"
                                                                : nullptr;
    if (missing) throw std::invalid_argument(std::string("device: there are no derivatives of outlines of ") + missing);
    if (boundary.weighs && boundary.part == BoundaryPart::Outputs)
        throw std::invalid_argument("device: there are no weights of outputs besides radiance");
}

}  // namespace

template <class S>
typename DeviceBoundary<S>::Work DeviceBoundary<S>::begin(const RenderCall<S> &given, const BoundaryCall<S> &boundary,
                                                          const SceneView<S> &copied, const TreeView &tree,
                                                          const DerivativeCall<S> &derivative, bool forward) {
    check(given, boundary);
    auto light_path = std::make_unique<const LightPathCall<S>>(given, boundary.glued);
    const RenderCall<S> &call = light_path->call;
    const SceneView<S> &host = *call.scene;
    SceneView<S> scene = copied;
    if (light_path->changes_scene()) {
        shapes_.upload(launcher_, host.shapes, size_t(host.n_shapes));
        scene.shapes = shapes_.get(), scene.environment = host.environment;
    }
    auto path_call = std::make_unique<const RenderCall<S>>(outline_path_call(call, boundary.part));
    const std::vector<int32_t> kinds = kinds_in(host, call.config, true, false);
    const RenderCall<S> &own = *path_call;
    Work work{std::move(light_path),
              call,
              boundary,
              std::move(path_call),
              {own, {}, tree, kinds},
              {own, {}, tree, kinds},
              {call, {}, tree, kinds_in(host, call.config, false, false)},
              view_of(call, boundary),
              0,
              {},
              {},
              {},
              0,
              0,
              0,
              {},
              {}};
    work.group = uint32_t(group_of(boundary));
    for (const int32_t kind : kinds)
        if (kind < MissKind && bsdf_kernels<S>(kind).is(HasSmoothLobes)) work.smooth |= 1u << kind;

    const std::vector<int32_t> kind_of = kinds_of_bsdfs(host);
    kinds_.upload(launcher_, kind_of.data(), kind_of.size());
    GradientNeeds needs = derivative_.needs(launcher_, derivative);
    needs.geometry = true;  // paths keep where they arrived although lights alone may move
    for (DeviceCall<S> *of : {&work.paths, &work.ends}) {
        of->parts = {host.has_stacks, host.follows_tangent, true, false, false, false};
        of->stage.needs = needs, of->stage.records = true;
        of->facts = {host, of->call.config};
        of->facts.records = of->facts.motion = true;
        of->facts.forward = forward, of->facts.fixed_sums = !forward && derivative.fixed_sums;
    }
    work.light.facts = {host, call.config};
    for (DeviceCall<S> *of : {&work.paths, &work.ends, &work.light}) {
        of->kind_of_bsdf = kinds_.get();
        of->stage.scene = scene, of->stage.config = of->call.config;
        of->stage.width = S(call.film_width), of->stage.height = S(call.film_height);
    }

    moves_.upload(launcher_, boundary.moves, size_t(host.n_shapes));
    cells_.upload(launcher_, boundary.cells, 2 * boundary.n_cells);
    work.view.outlines = outlines_.table(launcher_, *boundary.outlines);
    work.view.pieces = {};
    if (work.of_camera()) work.view.pieces = outlines_.pieces(launcher_, *boundary.pieces);
    work.view.cells = cells_.get();
    if (work.of_lights()) list_lights(work);
    reserve(work);
    return work;
}

template <class S>
void DeviceBoundary<S>::list_lights(Work &work) {
    const SceneView<S> &host = *work.call.scene;
    const LightTable found = shadow_lights<S>(host, work.part() == BoundaryPart::Pilot);
    lights_.upload(launcher_, found.lights.data(), found.lights.size());
    cdf_.upload(launcher_, found.cdf.data(), found.cdf.size());
    work.lights = {lights_.get(), cdf_.get(), int32_t(found.lights.size())};
    const ShadowPieces &shadows = *work.boundary.shadows;
    work.choice = {outlines_.shadows(launcher_, shadows), int32_t(shadows.of.size()),
                   work.part() == BoundaryPart::Pieces ? work.boundary.emitter : -1};
}

template <class S>
size_t DeviceBoundary<S>::bytes_per_sample(const Work &work) const {
    const size_t tile = DeviceTile<S>::bytes_per_path(), light = DeviceTile<S>::bytes_per_path(work.light_parts());
    const size_t entry = DeviceTapeLevels<S>::bytes_per_entry(work.paths.parts);
    const int depth = work.path_call->config.max_depth, levels = depth < 0 ? MostLevels : std::min(depth, MostLevels);
    size_t bytes = 4 * sizeof(double) * size_t(work.boundary.channels + 2);
    if (work.has_paths()) bytes += tile + size_t(levels) * entry + 64 * sizeof(S);
    if (work.of_lights()) bytes += tile + entry + 2 * (sizeof(ShadowRecord<S>) + 64 * sizeof(S));
    if (work.of_camera()) bytes += sizeof(SightRecord<S>);
    if (work.part() == BoundaryPart::Silhouettes) bytes += 2 * light;
    if (work.part() == BoundaryPart::Outputs) bytes += 2 * sizeof(S) * size_t(work.boundary.channels);
    if (work.part() == BoundaryPart::Reflections) bytes += 2 * light + sizeof(OutlineRecord<S>) + 8 * sizeof(S);
    return bytes;
}

// Room for a batch.
template <class S>
void DeviceBoundary<S>::reserve(Work &work) {
    const RenderCall<S> &call = work.call;
    const BoundaryCall<S> &boundary = work.boundary;
    const uint64_t most = memory_ * DeviceTile<S>::TapeShare / bytes_per_sample(work) / work.group;
    const uint32_t n = work.batch = uint32_t(std::min(std::max<uint64_t>(most, 1) * work.group, boundary.count));
    auto open = [&](DeviceTile<S> &tile, DeviceCall<S> &of, uint32_t paths, const BatchParts &parts = {}) {
        tile.reserve(paths, parts);
        tile.clear_totals();
        of.stage.slots = tile.at().slots, of.stage.lost = tile.at().lost;
    };
    if (work.has_paths()) {
        open(paths_, work.paths, n);
        totals_.reserve(launcher_, 3 * size_t(n));
        towards_.reserve(launcher_, std::max(n, work.room(n)));
    }
    if (work.has_paths() || work.of_lights()) anchors_.reserve(launcher_, n);
    if (work.of_lights()) {
        open(ends_, work.ends, n);
        for (int k = 0; k < (work.deep() ? 2 : 1); ++k)
            edge_columns_[k].reserve(launcher_, n), edges_[k].reserve(launcher_, n);
        order_.reserve(launcher_, n), counts_.reserve(launcher_, work.n_groups(n));
        apart_.reserve(launcher_, n), carried_.reserve(launcher_, size_t(SpectrumSize) * n);
        if (call.scene->sensors[call.config.sensor].kind == kind_of_model<Distant>(Sensors{})) {
            lens_.reserve(launcher_, 2 * size_t(n));
            work.ends.stage.slots.lens = {lens_.get(), lens_.get() + n};
        }
    }
    if (work.of_camera()) sights_.reserve(launcher_, n);
    if (work.part() == BoundaryPart::Silhouettes) open(light_, work.light, 2 * n, work.light_parts());
    if (work.part() == BoundaryPart::Outputs) {
        open(light_, work.light, 1, work.light_parts());  // which counts rays
        outputs_.reserve(launcher_, 2 * size_t(n) * size_t(boundary.channels));
    }
    if (work.part() == BoundaryPart::Reflections) {
        const uint32_t room = work.room(n);
        open(light_, work.light, 2 * room, work.light_parts());
        copies_.reserve(launcher_, n), begins_.reserve(launcher_, n), slots_.reserve(launcher_, room);
        choices_.reserve(launcher_, room), records_.reserve(launcher_, room);
    }
    if (work.light_parts().media) work.light.media = light_.media(*call.scene, nullptr);
    BoundaryFilm<S> &film = work.film;
    film.channels = boundary.channels;
    place_.reserve(launcher_, 2 * size_t(n)), film.place = place_.get();
    value_.reserve(launcher_, size_t(n) * size_t(film.channels)), film.value = value_.get();
    if (boundary.adjoint) {
        const size_t size = size_t(call.crop.height()) * size_t(call.crop.width()) * size_t(film.channels);
        adjoint_.upload(launcher_, boundary.adjoint, size);
        film.adjoint = {boundary.filter, std::min(boundary.filter.reach(), MaxReach),
                        film.channels,   {call.crop, nullptr},
                        adjoint_.get(),  {}};
    }
}

template <class S>
void DeviceBoundary<S>::release() {
    launcher_.synchronize();
    paths_.release(), ends_.release(), light_.release();
    anchors_ = {}, towards_ = {}, sights_ = {}, choices_ = {}, records_ = {};
    for (int k = 0; k < 2; ++k) edge_columns_[k] = {}, edges_[k] = {};
    lens_ = {}, apart_ = {}, carried_ = {}, outputs_ = {};
    place_ = {}, value_ = {}, totals_ = {};
    order_ = {}, counts_ = {}, copies_ = {}, begins_ = {}, slots_ = {};
}

// What f() returns; where memory is short, with smaller batches. Nothing is written before all is computed.
template <class S>
template <class Do>
auto DeviceBoundary<S>::with_memory(Do &&f) {
    return tr::with_memory(
        launcher_, memory_,
        [&] {
            release();
            release_others_();
        },
        f);
}

template <class S>
RenderStats DeviceBoundary<S>::run(Work &work, const DerivativePlaces<S> &to) {
    const auto begun = std::chrono::steady_clock::now();
    const uint64_t count = work.boundary.count;
    RenderStats stats;
    const bool nothing = work.of_lights() ? work.lights.n == 0 : work.of_camera() && work.view.pieces.n == 0;
    for (uint64_t &first = work.first; first < count && !nothing && !stats.interrupted; first += work.batch) {
        const uint32_t n = uint32_t(std::min<uint64_t>(work.batch, count - first));
        if (work.of_lights())
            see_from_lights(work, n, to);
        else if (work.part() == BoundaryPart::Reflections)
            see_from_vertices(work, n, to);
        else
            see_from_camera(work, n, to);
        launcher_.synchronize();
        const RenderCall<S> &call = work.call;
        stats.interrupted = call.interrupted && call.interrupted(double(first + n) / double(count));
    }
    if (work.has_paths()) paths_.add_totals(stats);
    if (work.of_lights()) ends_.add_totals(stats);
    if (!work.of_lights()) light_.add_totals(stats);
    stats.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
    return stats;
}

template <class S>
void DeviceBoundary<S>::see_from_camera(Work &work, uint32_t n, const DerivativePlaces<S> &given) {
    const BatchColumns<S> &at = light_.at();
    const bool of_outputs = work.part() == BoundaryPart::Outputs;
    const OutputValues<S> outputs{outputs_.get(), 2 * work.batch};
    launcher_.know(work.paths.facts);
    launcher_.run(FindSights<S>{work.stage(light_.totals()), sights_.get()}, n);
    if (of_outputs)
        launcher_.run(LookUpOutputs<S>{work.stage(nullptr), *work.boundary.layout, sights_.get(), outputs}, 2 * n);
    else
        look_up_light(work, n);
    if (work.boundary.weighs) {
        launcher_.know(work.paths.facts);
        launcher_.run(WeighSights<S>{work.stage(light_.totals()), sights_.get(), at.slots.radiance, work.call.values,
                                     value_.get()},
                      n);
        return download(work, n, 1, false, 1, 0);
    }
    const auto add = [&](const DerivativePlaces<S> &to) {
        const SightSums<S> sums{work.view, work.gradients(to), sights_.get(), work.film};
        if (of_outputs)
            launcher_.run(AddOutputSights<S>{sums, MissKind, outputs}, n, MissKind);
        else
            launcher_.run(AddSights<S>{sums, MissKind, at.slots.radiance, at.slots.alpha.at}, n, MissKind);
    };
    launcher_.know(work.paths.facts);
    if (!given.forward) return hand_back(given, add);
    DerivativePlaces<S> to = given;
    to.component = 0;  // one number of all components
    add(to);
    download(work, n, uint32_t(work.boundary.channels), true, 1, 0);
}

// Along the rays beside what is seen.
template <class S>
void DeviceBoundary<S>::look_up_light(Work &work, uint32_t n) {
    const BatchColumns<S> &at = light_.at();
    const LightRays<S> rays{at.slots, at.queues[0], at.hits, at.out_key};
    launcher_.know(work.light.facts);
    launcher_.run(StartSights<S>{sights_.get(), work.boundary.first + work.first, rays}, 2 * n);
    light_.list_started(2 * n);
    light_.run(work.light, 2 * n, 0, !work.call.config.hide_emitters, work.boundary.glued);
}

// What n samples have told: `channels` numbers each, and their places on the film, which of `each` rows of a sample.
template <class S>
void DeviceBoundary<S>::download(Work &work, uint32_t n, uint32_t channels, bool places, uint32_t each,
                                 uint32_t which) {
    const BoundaryCall<S> &b = work.boundary;
    work.value.resize(size_t(channels) * each * b.count), work.place.resize(places ? 2 * size_t(each) * b.count : 0);
    std::vector<double> place(places ? 2 * size_t(n) : 0), value(size_t(channels) * n);
    place_.download(place.data(), place.size()), value_.download(value.data(), value.size());
    for (size_t i = 0; i < n; ++i) {
        const size_t row = each * (size_t(work.first) + i) + which;
        for (size_t c = 0; c < channels; ++c) work.value[channels * row + c] += value[channels * i + c];
        for (size_t k = 0; k < 2 && places; ++k) work.place[2 * row + k] = place[2 * i + k];
    }
}

template <class S>
void DeviceBoundary<S>::begin_call(const SceneView<S> *&scene, const RenderCall<S> &call, const SceneData<S> &data) {
    scene = &scene_.upload(launcher_, data, call.on_device.values, call.threads);
    non_finite_.reserve(launcher_, 1);
    clear(launcher_, non_finite_.get(), 1);
}

template <class S>
std::vector<RenderStats> DeviceBoundary<S>::reverse(const std::vector<RenderCall<S>> &calls,
                                                    const std::vector<BoundaryCall<S>> &boundaries,
                                                    const SceneData<S> &data, const TreeView &tree,
                                                    DerivativeCall<S> &derivative) {
    return with_memory([&] {
        const SceneView<S> *scene;
        begin_call(scene, calls[0], data);
        const DerivativePlaces<S> to = derivative_.begin_gradients(launcher_, derivative, {}, non_finite_.get());
        std::vector<RenderStats> stats;
        for (size_t i = 0; i < calls.size(); ++i) {
            if (boundaries[i].count == 0) {
                stats.emplace_back();
                continue;
            }
            Work work = begin(calls[i], boundaries[i], *scene, tree, derivative, false);
            stats.push_back(run(work, to));
            if (stats.back().interrupted) return stats;
        }
        derivative_.finish_gradients(launcher_, derivative, {}, calls[0].threads);
        return stats;
    });
}

template <class S>
template <class Places>
RenderStats DeviceBoundary<S>::tell(const RenderCall<S> &call, const BoundaryCall<S> &boundary,
                                    const SceneData<S> &data, const TreeView &tree, const DerivativeCall<S> &derivative,
                                    Places &&places) {
    if (boundary.count == 0) return {};
    return with_memory([&] {
        const SceneView<S> *scene;
        begin_call(scene, call, data);
        const DerivativePlaces<S> to = places();
        Work work = begin(call, boundary, *scene, tree, derivative, true);
        RenderStats stats = run(work, to);
        for (size_t i = 0; i < work.value.size(); ++i) boundary.value[i] += work.value[i];
        std::copy(work.place.begin(), work.place.end(), boundary.place);
        return stats;
    });
}

template <class S>
RenderStats DeviceBoundary<S>::forward(const RenderCall<S> &call, const BoundaryCall<S> &boundary,
                                       const SceneData<S> &data, const TreeView &tree,
                                       const DerivativeCall<S> &derivative) {
    return tell(call, boundary, data, tree, derivative,
                [&] { return derivative_.tangents(launcher_, derivative, {}, non_finite_.get()); });
}

template <class S>
RenderStats DeviceBoundary<S>::look(const RenderCall<S> &call, const BoundaryCall<S> &boundary,
                                    const SceneData<S> &data, const TreeView &tree,
                                    const DerivativeCall<S> &derivative) {
    return tell(call, boundary, data, tree, derivative, [] {
        DerivativePlaces<S> to{};
        to.forward = true, to.copies = 1;
        return to;
    });
}

template class DeviceBoundary<float>;
template class DeviceBoundary<double>;

}  // namespace tr
