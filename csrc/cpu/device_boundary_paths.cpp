// Samples of outlines on a device that have paths, or rays to the ends of edges, with a tape.
#include <algorithm>

#include "device_boundary_work.h"

namespace tr {

namespace {

// Columns of as many numbers, one after the other.
template <class S>
SpectrumColumn<S> spectrum_in(S *at, size_t n) {
    SpectrumColumn<S> r{};
    for (int c = 0; c < SpectrumSize; ++c) r.c[c] = at + size_t(c) * n;
    return r;
}

template <class S>
PathStage<S> on_level(const DeviceCall<S> &of, const typename DeviceTapeLevels<S>::Level &level) {
    PathStage<S> r = of.stage;
    r.tape = level.tape;
    return r;
}

}  // namespace

// ------------------------------------------------------------------------------------------------------------ vertices
template <class S>
VertexTotals DeviceBoundary<S>::totals(const Work &work) const {
    return {totals_.get(), totals_.get() + work.batch, totals_.get() + 2 * size_t(work.batch)};
}

template <class S>
TapeLevelTables<S> DeviceBoundary<S>::levels(const Work &work) const {
    return {levels_.get(), work.smooth};
}

// Of the samples of a batch.
template <class S>
void DeviceBoundary<S>::trace_paths(Work &work, uint32_t n) {
    const SlotColumns<S> &slots = paths_.at().slots;
    launcher_.know(work.paths.facts);
    launcher_.run(NumberOutlines<S>{work.stage(paths_.totals()), slots, anchors_.at, totals(work)}, n);
    paths_.trace_paths(work.paths, n, work.boundary.glued);
    launcher_.run(KeepInPixels<S>{slots}, n);
    std::vector<TapeLevelTable<S>> tables;
    for (int l = 0; l < paths_.levels().size(); ++l) {
        const TapeLevel &level = paths_.levels()[l];
        tables.push_back({level.tape, level.begin, level.total, level.parents});
    }
    levels_.upload(launcher_, tables.data(), tables.size());
}

// One of each path; they count more close to `towards`, if there is one.
template <class S>
void DeviceBoundary<S>::choose_vertices(const Work &work, const VectorColumn<S> &towards) {
    for (const bool chooses : {false, true})
        for_smooth(work, paths_, [&](const TapeLevel &level, int l, int32_t kind) {
            launcher_.run(ChooseVertices<S>{work.stage(paths_.totals()), level.tape.vertex, level.tape.arrival.p, kind,
                                            uint32_t(l), level.begin, level.total, work.call.values, towards,
                                            totals(work), anchors_.at, chooses},
                          level.room);
        });
}

template <class S>
void DeviceBoundary<S>::look_at_vertices(const Work &work, bool lobes) {
    for_smooth(work, paths_, [&](const TapeLevel &level, int l, int32_t kind) {
        launcher_.run(LookAtVertices<S>{on_level(work.paths, level), kind, uint32_t(l), level.begin, level.total,
                                        anchors_.at, lobes},
                      level.room, kind);
    });
}

// Of n directions from chosen vertices of these slots.
template <class S>
void DeviceBoundary<S>::scatter(const Work &work, const uint32_t *slots, uint32_t n) {
    for_smooth(work, paths_, [&](const TapeLevel &level, int l, int32_t kind) {
        launcher_.run(ScatterTowards<S>{on_level(work.paths, level), kind, uint32_t(l), level.begin, level.total,
                                        anchors_.at, slots, towards_.at},
                      n, kind);
    });
}

// As BoundaryTile::sweep_places.
template <class S>
void DeviceBoundary<S>::sweep_places(DeviceTile<S> &tile, const DeviceCall<S> &of, const SlotColumns<S> &slots,
                                     const DerivativePlaces<S> &to, bool from_camera, bool chosen,
                                     const VectorColumn<S> &p_bar) {
    for (int l = tile.levels().size() - 1; l >= 0; --l) {
        const TapeLevel &level = tile.levels()[l];
        PathStage<S> stage = on_level(of, level);
        const PairColumn<S> lens = stage.slots.lens;
        stage.slots = slots, stage.slots.lens = lens;
        TapeBefore<S> before;
        if (level.parents >= 0) before.next = tile.levels()[level.parents].tape.next;
        for (const int32_t kind : of.kinds) {
            if (kind >= MissKind) continue;
            launcher_.run(SweepPlaces<S>{stage, kind, uint32_t(l), level.scatters, level.begin, level.total, before, to,
                                         from_camera, chosen ? anchors_.at.level.at : nullptr, anchors_.at.entry.at,
                                         p_bar, anchors_.at.p_bar},
                          level.room, kind);
        }
    }
}

// -------------------------------------------------------------------------------------------------------------- lights
template <class S>
void DeviceBoundary<S>::see_from_lights(Work &work, uint32_t n, const DerivativePlaces<S> &to) {
    const SlotColumns<S> &slots = work.ends.stage.slots;
    const BoundaryPart part = work.part();
    if (work.deep()) trace_paths(work, n);
    find_edges(work, n);
    shade_ends(work, 0, n);
    launcher_.run(ConnectEdges<S>{edge_columns_[0].at, edges_[0].get(), nullptr, {}}, n);
    if (part == BoundaryPart::Pilot) {
        launcher_.run(TellEdges<S>{edges_[0].get(), slots, work.film, true}, n);
        return download(work, n, 1, true, 1, 0);
    }
    settle(work, n, 0, to);
    if (!work.deep()) return;
    share_edges(work, n);
    settle(work, n, 1, to);
}

// With rays from the camera to their ends, whose number of levels is one.
template <class S>
void DeviceBoundary<S>::find_edges(Work &work, uint32_t n) {
    static const SamplerConfig sequence = make_sampler(SamplerKind::Sobol, 0, LargestPattern);
    const BatchColumns<S> &at = ends_.at();
    SceneFacts facts = work.paths.facts;
    facts.light_paths = true;
    launcher_.know(facts);
    launcher_.run(FindEdges<S>{work.stage(ends_.totals()),
                               work.lights,
                               work.choice,
                               sequence,
                               moves_.get(),
                               edge_columns_[0].at,
                               edges_[0].get(),
                               {work.ends.stage.slots, at.queues[0], at.out_key}},
                  n);
    launcher_.know(work.paths.facts);
}

// What the places get of the lights that rays from the camera, or vertices, to the ends of edges find.
template <class S>
void DeviceBoundary<S>::shade_ends(const Work &work, int depth, uint32_t n) {
    const bool first = depth == 0;
    const PathConfig &config = work.call.config;
    const BoundaryCall<S> &b = work.boundary;
    ends_.list_started(n);
    ends_.first_vertices(work.ends, depth, n);
    for_smooth(work, ends_, [&](const TapeLevel &level, int, int32_t kind) {
        launcher_.run(ShadeEnds<S>{on_level(work.ends, level), kind, level.begin, level.total, work.lights,
                                   edge_columns_[first ? 0 : 1].at, b.near, first ? b.in_view : 1,
                                   first ? config.emitter_samples : 1, first ? config.bsdf_samples : 1},
                      level.room, kind);
    });
}

// As ShadowTile::share_edges and see_from_vertices.
template <class S>
void DeviceBoundary<S>::share_edges(Work &work, uint32_t n) {
    const BoundaryStage<S> stage = work.stage(paths_.totals());
    const ShadowEdgeColumns<S> &at = edge_columns_[1].at;
    ShadowRecord<S> *const edges = edges_[1].get();
    launcher_.run(ListEdges<S>{edges_[0].get(), n, work.group, order_.get(), counts_.get()}, work.n_groups(n));
    launcher_.run(ShareEdges<S>{stage, edges_[0].get(), edge_columns_[0].at, order_.get(), counts_.get(), n, work.group,
                                edges, at},
                  n);
    choose_vertices(work, at.s);
    look_at_vertices(work, false);
    launcher_.run(AimAtEdges<S>{levels(work), anchors_.at, edges, at, towards_.at}, n);
    scatter(work, nullptr, n);
    const BatchColumns<S> &ends = ends_.at();
    const SpectrumColumn<S> carried = spectrum_in(carried_.get(), work.batch);
    launcher_.run(SeeEdges<S>{stage,
                              levels(work),
                              anchors_.at,
                              totals(work).inverse,
                              at,
                              towards_.at,
                              {work.ends.stage.slots, ends.queues[0], ends.out_key},
                              apart_.get(),
                              carried},
                  n);
    shade_ends(work, 1, n);
    launcher_.run(ConnectEdges<S>{at, edges, apart_.get(), carried}, n);
}

// Hands on what the camera (0), or vertices (1), have got of edges.
template <class S>
void DeviceBoundary<S>::settle(Work &work, uint32_t n, uint32_t which, const DerivativePlaces<S> &given) {
    const bool camera = which == 0, pieces = work.part() == BoundaryPart::Pieces, weighs = work.boundary.weighs;
    const SlotColumns<S> &slots = camera ? work.ends.stage.slots : paths_.at().slots;
    const ShadowEdgeColumns<S> &at = edge_columns_[which].at;
    if (pieces || weighs) {
        launcher_.run(WeighEdges<S>{edges_[which].get(), work.call.values, pieces, value_.get()}, n);
        return download(work, n, 1, false, 1, 0);
    }
    const auto add = [&](const DerivativePlaces<S> &to) {
        launcher_.run(AddEdges<S>{work.view, work.gradients(to), MissKind, work.lights, at, edges_[which].get(), slots,
                                  anchors_.at.p_bar, work.film},
                      n, MissKind);
    };
    hand_on(work, slots, n, given, [&](const DerivativePlaces<S> &to) {
        add(to);
        if (work.boundary.glued) return;
        sweep_places(ends_, work.ends, slots, to, camera, false, at.s_bar);
        if (!camera) sweep_places(paths_, work.paths, slots, to, true, true, anchors_.at.p_bar);
    });
    if (!given.forward) return;
    launcher_.run(TellEdges<S>{edges_[which].get(), slots, work.film, false}, n);
    download(work, n, uint32_t(work.boundary.channels), true, 2, which);
}

// ------------------------------------------------------------------------------------------- what vertices look past
template <class S>
void DeviceBoundary<S>::see_from_vertices(Work &work, uint32_t n, const DerivativePlaces<S> &given) {
    const uint32_t room = work.room(n);
    const SlotColumns<S> &slots = paths_.at().slots;
    const BatchColumns<S> &light = light_.at();
    const VertexShares shares{copies_.get(), begins_.get()};
    const BoundaryStage<S> stage = work.stage(paths_.totals());
    trace_paths(work, n);
    choose_vertices(work, {});
    look_at_vertices(work, true);
    launcher_.run(SlideVertices<S>{stage, levels(work), anchors_.at, totals(work), moves_.get()}, n);
    launcher_.run(ShareOutlines<S>{stage, totals(work), n, work.group, shares, slots_.get()}, work.n_groups(n));
    launcher_.run(ChooseOutlines<S>{stage, levels(work), anchors_.at, shares, moves_.get(), choices_.get()}, n);
    launcher_.run(FindOutlines<S>{stage, levels(work), anchors_.at, shares, totals(work).inverse, slots_.get(),
                                  choices_.get(), records_.get(), towards_.at},
                  room);
    scatter(work, slots_.get(), room);
    launcher_.run(LookPastOutlines<S>{stage, levels(work), anchors_.at, towards_.at, records_.get()}, room);
    for (int l = 0; l < paths_.levels().size(); ++l) {
        if (!paths_.levels()[l].scatters) continue;
        const uint32_t level = uint32_t(l);
        launcher_.know(work.light.facts);
        launcher_.run(StartOutlines<S>{records_.get(),
                                       anchors_.at.level.at,
                                       level,
                                       work.boundary.first + work.first,
                                       {light.slots, light.queues[0], light.hits, light.out_key}},
                      2 * room);
        light_.list_started(2 * room);
        if (const uint32_t started = light_.n_started(); started > 0) light_.run(work.light, started, l + 1, true);
        launcher_.know(work.paths.facts);
        launcher_.run(TakeOutlines<S>{stage, records_.get(), anchors_.at.level.at, level, light.slots.radiance}, room);
    }
    if (work.boundary.weighs) {
        launcher_.run(WeighOutlines<S>{shares, records_.get(), work.call.values, value_.get()}, n);
        return download(work, n, 1, false, 1, 0);
    }
    const auto add = [&](const DerivativePlaces<S> &to) {
        launcher_.run(AddOutlines<S>{work.view, work.gradients(to), MissKind, levels(work), anchors_.at, shares,
                                     records_.get(), slots, work.film},
                      n, MissKind);
    };
    hand_on(work, slots, n, given, [&](const DerivativePlaces<S> &to) {
        add(to);
        if (!work.boundary.glued) sweep_places(paths_, work.paths, slots, to, true, true, anchors_.at.p_bar);
    });
    if (!given.forward) return;
    launcher_.run(TellEdges<S>{nullptr, slots, work.film, false}, n);
    download(work, n, uint32_t(work.boundary.channels), true, 1, 0);
}

template class DeviceBoundary<float>;
template class DeviceBoundary<double>;

}  // namespace tr
