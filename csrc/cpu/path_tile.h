// A tile of paths on one thread: all of them take a step, then the next. A step traces all rays, shades the hits model
// by model, and traces the shadow rays. Where they are recorded the vertices are on the path tape, and `sweep` runs
// over it backwards.
#pragma once

#include <optional>
#include <utility>

#include "core/adjoint/polarized_sweep.h"
#include "core/integrator/camera.h"
#include "medium_stage.h"

namespace tr {

template <class F>
class PathTile {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    static constexpr uint32_t W = uint32_t(Lanes<F>::Width);

public:
    Wavefront<F> wavefront;
    SlotColumns<S> &slots = wavefront.slots;
    RenderStats take_stats() { return wavefront.take_stats(); }

    PathTile(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> *derivative)
        : wavefront(call, capacity, derivative, false),
          call_(call),
          config_(call.config),
          capacity_(capacity),
          differentiates_(derivative != nullptr),
          unit_adjoint_(derivative && !derivative->adjoint) {
        if (!config_.volumetric) return;
        media_.emplace(wavefront, capacity, derivative != nullptr);
        if (!config_.stokes || !media_->media.differential) return;
        TapeGroups groups = wavefront.tape.groups();
        groups.motion = false;
        branch_tape_.emplace(groups);
        branch_tape_->origin = int(BranchLevel);
    }

    // The first n slots, whose rays follow.
    void begin(size_t n) {
        n_slots_ = uint32_t(n);
        wavefront.queues[0].n = 0;
        wavefront.keys.common = false;
    }

    // Camera rays of the first n slots; in reverse mode paths whose adjoint is zero are not started.
    void start(size_t n, bool skip_zero_adjoint) {
        begin(n);
        wavefront.find_keys(n);
        PathQueue<S> &queue = wavefront.queues[0];
        PathContext<F> c = wavefront.context(false);
        for (uint32_t i = 0; i < n_slots_; i += W)
            start_paths(c, S(call_.film_width), S(call_.film_height), skip_zero_adjoint, i, n_slots_, queue);
    }

    // Traces the paths to their ends. Without a limit of depth a path may go on for ever: `stop` is asked at every
    // vertex, and ends the paths. `first` vertices are behind the rays already. `traced`: what the rays meet is known.
    // `scattered`: after the first vertex paths go on in directions of smooth BSDFs alone.
    void run(bool recording, const Stop &stop, int first = 0, bool traced = false, bool scattered = false) {
        wavefront.tape.begin_block(0);
        wavefront.tape.checkpoints.clear();
        PathQueue<S> *queues = wavefront.queues;
        if ((config_.max_depth >= 0 && first >= config_.max_depth) || queues[0].n == 0) return;
        if (media_) return run_volumetric(recording, stop);
        if (wavefront.bender) wavefront.bender->begin(queues[0]);
        if (!traced) wavefront.trace(queues[0]);
        if (config_.hide_emitters && first == 0 && !traced) wavefront.pass_emitters();
        const bool scatters = config_.max_depth < 0 || config_.max_depth > first + 1;
        for (int split = 0; split < (first == 0 ? splits(config_) : 1) && !stop(); ++split) {
            if (split > 0) {
                if (wavefront.recorder.on()) wavefront.recorder.set_split(size_t(split));
                if (wavefront.replay.on()) wavefront.replay.set_split(size_t(split));
                wavefront.trace(queues[0]);
            }
            PathQueue<S> *current = &queues[0], *next = &queues[1], *spare = &queues[2];
            step(*current, *next, {first, split, scatters}, recording, TapeLevel<S>::NoParent);
            if (scattered) keep_smooth(*next);
            for (int depth = first + 1; next->n > 0 && !stop() && (config_.max_depth < 0 || depth < config_.max_depth);
                 ++depth) {
                current = next;
                std::swap(next, spare);
                const bool last = config_.max_depth >= 0 && depth + 1 >= config_.max_depth;
                if (last) keep_rays_to_lights(*current, recording);
                if (config_.max_depth == depth + 2) keep_rays_to_bsdfs(*current, recording);
                if (current->n == 0) break;
                wavefront.trace(*current, false, !recording);
                step(*current, *next, {depth, 0, !last}, recording, wavefront.tape.size() - 1);
                spare = current;
            }
        }
    }

    // The vertices that the rays meet, `depth` vertices behind the first one, and nothing after them; recorded.
    void first_vertices(int depth) {
        wavefront.tape.begin_block(0);
        if (wavefront.bender) wavefront.bender->begin(wavefront.queues[0]);
        wavefront.trace(wavefront.queues[0]);
        if (config_.hide_emitters && depth == 0) wavefront.pass_emitters();
        step(wavefront.queues[0], wavefront.queues[1], {depth, 0, true}, true, TapeLevel<S>::NoParent);
    }

    // How often the first vertex is scattered from.
    static int splits(const PathConfig &config) {
        bool scatters = config.max_depth < 0 || config.max_depth > 1;
        return scatters ? std::max(config.emitter_samples, config.bsdf_samples) : 1;
    }

    // In the spectral variant: the slots' radiances become channels of the film, and adjoints of channels those of
    // radiances.
    void to_channels() {
        for_channels([&](const FilmWeights<F> &weights, uint32_t i) {
            for (const auto &column : of_stokes(slots.radiance, slots.q, slots.u, slots.v))
                write(column, i, weights.channels(Entries<F>(i)(column)));
        });
    }
    void pull_adjoints() {
        for_channels([&](const FilmWeights<F> &weights, uint32_t i) {
            for (const auto &column : of_stokes(slots.delta, slots.delta_q, slots.delta_u, slots.delta_v))
                write(column, i, weights.pull(Entries<F>(i)(column)));
        });
    }

    // Of polarised light: the columns, which bring the slots' Stokes vectors.
    void sweep_columns() {
        const SweepContext<F> c = sweep_context(slots, false);
        for_blocks([&](size_t block) { hand_columns(c, block); });
    }
    // ... and, of paths that are on the tape from beginning to end, the rows of these slots' adjoints.
    void hand_rows(const SlotColumns<S> &of) { hand_rows(sweep_context(of, false), nullptr); }
    SweepContext<F> sweep_context(const SlotColumns<S> &of, bool unit_adjoint) {
        return {wavefront.scene(),    config_, of,          wavefront.needs(), S(call_.film_width),
                S(call_.film_height), nullptr, unit_adjoint};
    }

    // Runs over the tape from its end. Without an adjoint in the call the radiance itself is differentiated, in all
    // components.
    void sweep(GradientSink<F> &sink) {
        if (config_.stokes && unit_adjoint_)
            for (const auto &column : of_stokes(slots.radiance, slots.q, slots.u, slots.v))
                for (int c = 0; c < SpectrumSize; ++c) std::fill_n(column[c], n_slots_, S(0));
        for_blocks([&](size_t block) { config_.stokes ? sweep_polarized(sink, block) : sweep_tape(sink, block); });
        wavefront.count_non_finite(sink);
    }
    // Once for each of the sinks, with the adjoints that show(k) puts into the slots; not of polarised light.
    template <class Show>
    void sweep_each(std::vector<GradientSink<F>> &sinks, Show &&show) {
        wavefront.tape.boundaries.resize(std::max(wavefront.tape.boundaries.size(), sinks.size()));
        for_blocks([&](size_t block) {
            for (size_t k = 0; k < sinks.size(); ++k) {
                show(k);
                sweep_levels(sinks[k], false, block, k);
            }
        });
        for (GradientSink<F> &sink : sinks) wavefront.count_non_finite(sink);
    }

private:
    template <class Visit>
    void for_channels(Visit &&visit) {
        if (!config_.spectral.positions) return;
        for (uint32_t i = 0; i < n_slots_; i += W) {
            Entries<F> from(i);
            visit(
                FilmWeights<F>(config_.spectral, chosen_wavelengths<F>(config_, from(slots.pixel), from(slots.sample))),
                i);
        }
    }

    // ------------------------------------------------------------------------------------------------------- tracing
    void run_volumetric(bool recording, const Stop &stop) {
        PathQueue<S> &first = wavefront.queues[0];
        media_->begin(first, n_slots_);
        run_levels(recording, 0, stop);
        if (!recording || !media_->media.differential) return;
        media_->start_branches(first, n_slots_);
        if (branch_tape_) return run_polarized_branches(stop);
        run_levels(false, BranchLevel, stop);
        media_->finish_branches(n_slots_);
    }

    // They are recorded for their columns alone.
    void run_polarized_branches(const Stop &stop) {
        GradientNeeds needs{};
        wavefront.exchange(*branch_tape_, needs);
        media_->media.differential = false;
        wavefront.tape.checkpoints.clear();
        wavefront.tape.begin_block(int(BranchLevel));
        run_levels(true, BranchLevel, stop);
        SweepContext<F> c = sweep_context(slots, false);
        c.columns_to = &media_->media.branch;
        for_blocks([&](size_t block) { hand_columns(c, block); });
        media_->media.differential = true;
        wavefront.exchange(*branch_tape_, needs);
    }

    // A level a segment: scatterings and index-matched boundaries alike. `first` numbers the random numbers.
    void run_levels(bool recording, uint32_t first, const Stop &stop) {
        Tape<S> &tape = wavefront.tape;
        PathQueue<S> *current = &wavefront.queues[0], *next = &wavefront.queues[1];
        for (uint32_t level = first; current->n > 0 && !stop(); ++level) {
            if (recording && level % Tape<S>::BlockLevels == 0) {
                tape.checkpoints.save(*current);
                if (config_.stokes && differentiates_ && level > 0 && first == 0) keep_rows();
                tape.begin_block(int(level));
            }
            run_level(*current, *next, level, recording);
            std::swap(current, next);
        }
        media_->add_stats();
    }

    void run_level(PathQueue<S> &current, PathQueue<S> &next, uint32_t level, bool recording) {
        const Tape<S> &tape = wavefront.tape;
        wavefront.trace(current);
        media_->fly(current, level, recording);
        int parents = tape.size() > 0            ? tape.size() - 1
                      : int(level) > tape.origin ? TapeLevel<S>::InBlockBefore
                                                 : TapeLevel<S>::NoParent;
        step(current, next, {int(level), 0, true}, recording, parents);
    }

    // The levels of a block onto the tape once more.
    void replay_block(size_t block) {
        Tape<S> &tape = wavefront.tape;
        PathQueue<S> *current = &wavefront.queues[0], *next = &wavefront.queues[1];
        tape.checkpoints.restore(block, *current);
        const RenderStats before = wavefront.stats;  // nothing counts twice
        const Diagnostics found = wavefront.diagnostics;
        media_->media.replaying = true;
        tape.begin_block(tape.origin + int(block) * Tape<S>::BlockLevels);
        for (int l = 0; l < Tape<S>::BlockLevels; ++l) {
            run_level(*current, *next, uint32_t(tape.first_level + l), true);
            std::swap(current, next);
        }
        media_->media.replaying = false;
        media_->forget_stats();
        wavefront.stats = before, wavefront.diagnostics = found;
    }

    void step(PathQueue<S> &current, PathQueue<S> &next, const PathStep &step, bool recording, int parent_level) {
        ShadowQueue<S> &shadows = wavefront.shadows;
        next.n = shadows.n = 0;
        std::vector<KindRange> *ranges = &ranges_;
        if (recording) ranges = &wavefront.tape.add(parent_level, step.scatters).ranges;
        wavefront.find_keys_of(EmitterBlock + BlocksPerScattering * step.scattering());
        wavefront.sort(step, current, true, recording, *ranges);
        PathContext<F> c = wavefront.context(recording);
        const HitColumns<S> &hits = wavefront.queries.hits;
        for (const KindRange &range : *ranges)
            wavefront.for_packets(range, [&](const LaneSet<F> &lanes, uint32_t i) {
                if (recording && media_) record_segment(c, media_->media, step, current, hits, lanes, i, shadows);
                if (range.kind == CollisionKind)
                    shade_medium(c, step, current, hits, lanes, i, next, shadows);
                else if (range.kind == MissKind)
                    shade_environment(c, step, current, lanes, i);
                else
                    shade_surface(c, range.kind, step, current, hits, lanes, i, next, shadows);
            });
        if (media_)
            media_->trace_shadows(uint32_t(step.depth), recording);
        else if (shadows.n > 0)
            trace_shadows(step.depth, recording);
    }

    void trace_shadows(int depth, bool recording) {
        wavefront.trace_shadows(depth == 0 ? RayKind::CameraShadow : RayKind::BounceShadow);
        // Half of them hit, at random: no branches. Pointers are copied, since what is stored could change them.
        const ShadowQueue<S> shadows = wavefront.shadows;
        const uint8_t *occluded = wavefront.queries.occluded;
        if (recording) {
            S *weight = wavefront.tape.last().columns.outgoing.light_weight.at;
            for (uint32_t k = 0; k < shadows.n; ++k) weight[shadows.position[k]] *= S(occluded[k] ? 0 : 1);
            return;
        }
        const auto radiance = slots.radiance;
        for (uint32_t k = 0; k < shadows.n; ++k) {
            const S visible(occluded[k] ? 0 : 1);
            const uint32_t slot = shadows.slot[k];
            for (int c = 0; c < SpectrumSize; ++c) radiance[c][slot] += visible * shadows.contribution[c][k];
        }
    }

    // Without the directions of delta lobes, which have no density.
    static void keep_smooth(PathQueue<S> &queue) {
        keep_entries<F>(queue, [&](uint32_t i) { return !mask<F>(Entries<F>(i)(queue.pdf) == F(0)); });
    }

    // A last ray that passes all lights is not traced, nor one whose light has no derivative.
    void keep_rays_to_lights(PathQueue<S> &queue, bool recording) {
        const SceneView<S> &scene = wavefront.scene();
        const bool bsdfs_alone = recording && wavefront.bsdfs_alone();
        if (wavefront.recorder.on() || wavefront.replay.on() || (scene.n_light_boxes < 0 && !bsdfs_alone)) return;
        keep_entries<F>(queue, [&](uint32_t i) {
            const Entries<F> from(i);
            M kept = M(scene.n_light_boxes < 0) || last_ray_counts<F>(scene, queue, i);
            if (bsdfs_alone) kept = kept && has_differentiated<F>(from(queue.seen));
            return wavefront.bender ? kept || mask<F>(from(queue.medium) >= 0) : kept;
        });
    }

    // Of the rays to vertices that scatter for the last time those that have a derivative.
    void keep_rays_to_bsdfs(PathQueue<S> &queue, bool recording) {
        const GradientNeeds &needs = wavefront.needs();
        if (!recording || wavefront.recorder.on() || needs.n_boxes < 0 || !wavefront.bsdfs_alone()) return;
        keep_entries<F>(queue, [&](uint32_t i) { return last_scattering_counts<F>(needs, queue, i); });
    }

    // ------------------------------------------------------------------------------------------------------ the sweep
    // Calls visit(block) for all blocks, from the last one, which is on the tape, to the first one.
    template <class Visit>
    void for_blocks(Visit &&visit) {
        const size_t n = media_ ? wavefront.tape.checkpoints.size() : 0;
        size_t block = n > 0 ? n - 1 : 0;
        visit(block);
        while (block > 0) {
            replay_block(--block);
            visit(block);
        }
    }

    // Adjoints of numbers are sums over components: in forward mode everyone that a pixel shows then has a sweep of its
    // own.
    void sweep_tape(GradientSink<F> &sink, size_t block) {
        if (!sink.forward || !wavefront.needs().numbers()) return sweep_levels(sink, unit_adjoint_, block, 0);
        for (int component = 0; component < call_.values; ++component) {
            for (int c = 0; c < SpectrumSize; ++c) std::fill_n(slots.delta[c], n_slots_, S(c == component ? 1 : 0));
            sink.component = component;
            sweep_levels(sink, false, block, size_t(component));
        }
    }

    void sweep_levels(GradientSink<F> &sink, bool unit_adjoint, size_t block, size_t component) {
        Tape<S> &tape = wavefront.tape;
        BlockBoundary<S> &boundary = tape.boundaries[component];
        if (block + 1 < tape.checkpoints.size()) boundary.hand_to(tape.last());
        const TapeColumns<S> *before = nullptr;
        if (block > 0) before = &boundary.open(Wavefront<F>::entries(capacity_), tape.groups());
        SweepContext<F> c = sweep_context(slots, unit_adjoint);
        if (media_ && media_->media.differential) c.branches = &media_->media.branch;
        for (int l = tape.size() - 1; l >= 0; --l) {
            TapeLevel<S> &level = tape[l];
            const TapeColumns<S> *parents = level.parent_level >= 0 ? &tape[level.parent_level].columns : nullptr;
            if (level.parent_level == TapeLevel<S>::InBlockBefore) parents = before;
            for (const KindRange &range : level.ranges)
                for (uint32_t i = range.begin; i < range.begin + range.count; i += W) {
                    M active = mask<F>(lane_index<F>() < U(range.begin + range.count - i));
                    sweep_vertex(c, level.columns, parents, uint32_t(tape.first_level + l), range.kind, level.scatters,
                                 i, active, sink);
                }
        }
    }

    // ----------------------------------------------------------------------------------------------- polarised light
    // Those of Q, U and V only where they are rendered.
    std::vector<SpectrumColumn<S>> of_stokes(const SpectrumColumn<S> &i, const SpectrumColumn<S> &q,
                                             const SpectrumColumn<S> &u, const SpectrumColumn<S> &v) const {
        if (!config_.stokes) return {i};
        return {i, q, u, v};
    }

    // Packets of the tape's vertices, from its end or from its beginning. `before`: in place of the last level of the
    // block before.
    template <class Visit>
    void for_vertices(bool backwards, const TapeColumns<S> *before, Visit &&visit) {
        Tape<S> &tape = wavefront.tape;
        for (int k = 0; k < tape.size(); ++k) {
            const int l = backwards ? tape.size() - 1 - k : k;
            TapeLevel<S> &level = tape[l];
            const TapeColumns<S> *parents = level.parent_level >= 0 ? &tape[level.parent_level].columns : nullptr;
            if (level.parent_level == TapeLevel<S>::InBlockBefore) parents = before;
            for (const KindRange &range : level.ranges)
                for (uint32_t i = range.begin; i < range.begin + range.count; i += W)
                    visit(level, parents, uint32_t(tape.first_level + l), range.kind, i,
                          mask<F>(lane_index<F>() < U(range.begin + range.count - i)));
        }
    }

    void hand_columns(const SweepContext<F> &c, size_t block) {
        Tape<S> &tape = wavefront.tape;
        if (block + 1 < tape.checkpoints.size()) tape.columns.hand_to(tape.last(), HandedRadiance);
        const TapeColumns<S> *before = nullptr;
        if (block > 0) before = &tape.columns.open(Wavefront<F>::entries(capacity_), tape.groups());
        for_vertices(true, before,
                     [&](const TapeLevel<S> &level, const TapeColumns<S> *parents, uint32_t, int kind, uint32_t i,
                         const M &active) { hand_column(c, level.columns, parents, kind, level.scatters, i, active); });
    }

    void hand_rows(const SweepContext<F> &c, const TapeColumns<S> *before) {
        for_vertices(false, before,
                     [&](const TapeLevel<S> &level, const TapeColumns<S> *parents, uint32_t, int kind, uint32_t i,
                         const M &active) { hand_row(c, level.columns, parents, kind, level.scatters, i, active); });
    }

    // A level with the rows for what arrives at a block's beginning; null: the film's begin there.
    const TapeColumns<S> *rows_before(size_t block, size_t run) {
        Tape<S> &tape = wavefront.tape;
        if (block == 0) return nullptr;
        const TapeColumns<S> &before = tape.boundaries[run].open(Wavefront<F>::entries(capacity_), tape.groups());
        tape.checkpoints.restore_rows(block, run, before);
        return &before;
    }

    // Of the block that is on the tape, whose successor's queue has just been saved.
    void keep_rows() {
        Tape<S> &tape = wavefront.tape;
        for_runs([&](size_t run, const SlotColumns<S> &of, int) {
            hand_rows(sweep_context(of, false), rows_before(tape.checkpoints.size() - 2, run));
            tape.checkpoints.save_rows(run, tape.last());
        });
    }

    // Calls visit(run, slots, component) for all rows that paths have: one, of the film's gradient, or in forward mode
    // one for each component of the Stokes vector, whose derivative goes to the slots' radiance; and then, where
    // adjoints of numbers are sums over components, one for each of these.
    template <class Visit>
    void for_runs(Visit &&visit) {
        if (!unit_adjoint_) return visit(size_t(0), slots, 0);
        const auto deltas = of_stokes(slots.delta, slots.delta_q, slots.delta_u, slots.delta_v),
                   values = of_stokes(slots.radiance, slots.q, slots.u, slots.v);
        const bool apart = wavefront.needs().numbers();
        size_t run = 0;
        for (size_t p = 0; p < values.size(); ++p) {
            SlotColumns<S> of = slots;
            of.radiance = values[p];
            for (int component = 0; component < (apart ? call_.values : 1); ++component) {
                for (size_t q = 0; q < deltas.size(); ++q)
                    for (int c = 0; c < SpectrumSize; ++c)
                        std::fill_n(deltas[q][c], n_slots_, S(p == q && (!apart || c == component) ? 1 : 0));
                visit(run++, of, component);
            }
        }
    }

    void sweep_polarized(GradientSink<F> &sink, size_t block) {
        Tape<S> &tape = wavefront.tape;
        SweepContext<F> columns = sweep_context(slots, false);
        columns.to_slots = false;
        hand_columns(columns, block);
        for_runs([&](size_t run, const SlotColumns<S> &of, int component) {
            SweepContext<F> c = sweep_context(of, false);
            if (media_ && media_->media.differential) c.branches = &media_->media.branch;
            if (block + 1 < tape.checkpoints.size()) tape.boundaries[run].hand_to(tape.last(), HandedMotion);
            const TapeColumns<S> *before = rows_before(block, run);
            hand_rows(c, before);
            sink.component = component;
            for_vertices(true, before,
                         [&](const TapeLevel<S> &level, const TapeColumns<S> *parents, uint32_t number, int kind,
                             uint32_t i, const M &active) {
                             sweep_polarized_vertex(c, level.columns, parents, number, kind, level.scatters, i, active,
                                                    sink);
                         });
        });
    }

    const RenderCall<S> &call_;
    const PathConfig &config_;
    const size_t capacity_;
    const bool differentiates_, unit_adjoint_;
    std::optional<MediumStage<F>> media_;
    std::optional<Tape<S>> branch_tape_;  // of polarised light, of the paths that go on from differential samples
    uint32_t n_slots_ = 0;
    std::vector<KindRange> ranges_;
};

#define TR_ELSEWHERE(S) extern template class PathTile<PacketOf<S>>;
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
