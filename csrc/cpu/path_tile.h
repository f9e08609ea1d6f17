// A tile of paths on one thread: all of them take a step, then the next. A step queries Embree for all rays, groups the
// hits by the model of their BSDF so that a packet runs one model, shades, queries the shadow rays and compacts the
// survivors. With Derivative the vertices are written to the path tape, and `sweep` runs over it backwards.
#pragma once

#include <algorithm>
#include <utility>

#include "volume_tile.h"

namespace tr {

template <class F, int C>
class PathTile : public VolumeTile<F, C> {
protected:
    using Base = VolumeTile<F, C>;
    using Base::call_, Base::scene_, Base::derivative_, Base::fronts_, Base::shadow_, Base::levels_, Base::n_levels_;
    using Base::hit_shape_, Base::hit_primitive_, Base::hit_t_, Base::hit_b1_, Base::hit_b2_, Base::order_, Base::ray_;
    using Base::kind_, Base::occluded_, Base::segments_;
    using Base::level, Base::append, Base::see, Base::finite, Base::entries, Base::bsdf_wanted, Base::no_emission;
    using Base::n_slots_, Base::W, Base::Miss, Base::Collision, Base::NullKind, Base::CollisionShape;
    using Base::volumetric_, Base::probing_;
    using typename Base::I;
    using typename Base::M;
    using typename Base::S;
    using typename Base::U;
    static constexpr int BySide = -1, Ignore = -2;
    static constexpr bool Viewed = true;  // paths come from the camera

public:
    using Base::alpha, Base::stats, Base::recorder, Base::replay;
    using Base::pixel, Base::row, Base::column, Base::sample, Base::delta, Base::film_x, Base::film_y, Base::radiance;

    PathTile(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> *derivative)
        : Base(call, capacity, derivative) {
        leaf_kind_.resize(size_t(scene_.n_bsdfs));
        for (int b = 0; b < scene_.n_bsdfs; ++b) leaf_kind_[size_t(b)] = kind_below(b);
    }

    // Camera rays of the first n slots; in reverse mode paths whose adjoint is zero are not started.
    void start(size_t n, bool skip_zero_adjoint) {
        Front<S, C> &front = fronts_[0];
        n_slots_ = n;
        const Record &record = scene_.sensors[call_.config.sensor];
        const int numbers = uses_lens(record) ? 4 : 2;
        front.n = 0;
        for (size_t i = 0; i < n; i += W) {
            U slot = U(uint32_t(i)) + lane_index<F>();
            M active = mask<F>(slot < uint32_t(n));
            Random4<F> u = draw4<F>(call_.config, load_uint<F>(pixel + i), load_uint<F>(sample + i), 0, numbers);
            F x = F(I(load_uint<F>(column + i))) + u.u[0], y = F(I(load_uint<F>(row + i))) + u.u[1];
            store(film_x + i, x);
            store(film_y + i, y);
            store(alpha + i, F(0));
            for (int c = 0; c < C; ++c) store(radiance[c] + i, F(0));
            if (skip_zero_adjoint) {
                F size(0);
                for (int c = 0; c < C; ++c) size = size + abs(load<F>(delta[c] + i));
                active = active && !mask<F>(size == F(0));
            }
            if (!any(active)) continue;
            CameraSample<F> at{x, y};
            if (numbers > 2) at.choose_lens(u);
            CameraRay<F> r = camera_ray(scene_, record, at, S(call_.film_width), S(call_.film_height));
            Color<F, C> one = uniform_color<C>(F(1));
            append(front, r.ray, r.length, r.center, F(0), one, one, F(1), slot, U(0u), U(0u), active && r.exists);
        }
    }

    // Traces the paths to their ends. Without a limit of depth a path may go on for ever: `stop` is asked at every
    // vertex, and ends the paths.
    template <bool Derivative, class Stop>
    void run(Stop &&stop) {
        n_levels_ = this->first_level_ = 0;
        checkpoints_.clear();
        const PathConfig &config = call_.config;
        if (config.max_depth == 0 || fronts_[0].n == 0) return;
        if (volumetric_) return run_volumetric<Derivative>(stop);
        trace(fronts_[0]);
        if (config.hide_emitters) {
            Front<S, C> &f = fronts_[0];
            pass_emitters(scene_, f.o, f.d, f.length, hit_shape_, hit_t_, f.n, [&] { trace(f, true); });
        }
        bool scatters = config.max_depth < 0 || config.max_depth > 1;
        for (int index = 0; index < splits(config) && !stop(); ++index) {
            if (index > 0) {
                if (recorder.on()) recorder.set_split(size_t(index));
                if (replay.on()) replay.set_split(size_t(index));
                trace(fronts_[0]);
            }
            Front<S, C> *current = &fronts_[0], *next = &fronts_[1], *spare = &fronts_[2];
            step<Derivative>(*current, *next, 0, index, scatters, -1);
            for (int depth = 1; next->n > 0 && !stop() && (config.max_depth < 0 || depth < config.max_depth); ++depth) {
                current = next;
                std::swap(next, spare);
                const bool last = config.max_depth >= 0 && depth + 1 >= config.max_depth;
                if (last) keep_rays_to_lights(*current);
                if (current->n == 0) break;
                trace(*current);
                step<Derivative>(*current, *next, depth, 0, !last, n_levels_ - 1);
                spare = current;
            }
        }
    }

    // How often the first vertex is scattered from.
    static int splits(const PathConfig &config) {
        bool scatters = config.max_depth < 0 || config.max_depth > 1;
        return scatters ? std::max(config.emitter_samples, config.bsdf_samples) : 1;
    }

    // Runs over the tape from its end; `forward`: all adjoints are one.
    template <class Sink>
    void sweep(Sink &sink, bool forward) {
        size_t block = volumetric_ && checkpoints_.size() ? checkpoints_.size() - 1 : 0;
        sweep_tape(sink, forward, block);
        while (block > 0) {
            replay_block(--block);
            boundary_.hand_to(*levels_[size_t(n_levels_ - 1)]);
            sweep_tape(sink, forward, block);
        }
        stats.non_finite += sink.non_finite;
        if (sink.non_finite && stats.non_finite_where.empty()) stats.non_finite_where = "a derivative";
        sink.non_finite = 0;
    }

protected:
    template <bool Derivative, class Stop>
    void run_volumetric(Stop &stop) {
        this->begin_volumetric(fronts_[0]);
        run_levels<Derivative>(0, stop);
        if (!Derivative || !probing_) return;
        this->weigh_branches();
        this->start_branches(fronts_[0]);
        run_levels<false>(BranchLevel, stop);
        this->finish_branches();
    }

    // A level a segment: scatterings and index-matched boundaries alike. `first` numbers the random numbers.
    template <bool Derivative, class Stop>
    void run_levels(uint32_t first, Stop &stop) {
        Front<S, C> *current = &fronts_[0], *next = &fronts_[1];
        for (uint32_t level = first; current->n > 0 && !stop(); ++level) {
            if (Derivative && level % BlockLevels == 0) {
                checkpoints_.save(*current);
                this->first_level_ = int(level);
                n_levels_ = 0;
            }
            run_level<Derivative>(*current, *next, level);
            std::swap(current, next);
        }
        stats.collisions += std::exchange(this->tracker_.collisions, 0);
        stats.majorants_exceeded += std::exchange(this->tracker_.exceeded, 0);
    }

    template <bool Derivative>
    void run_level(Front<S, C> &current, Front<S, C> &next, uint32_t level) {
        trace(current);
        this->template fly<Derivative>(current, level);
        int parents = n_levels_ > 0 ? n_levels_ - 1 : level > 0 ? TapeLevel<S, C>::InBlockBefore : -1;
        step<Derivative>(current, next, int(level), 0, true, parents);
    }

    // The levels of a block onto the tape once more.
    void replay_block(size_t block) {
        Front<S, C> *current = &fronts_[0], *next = &fronts_[1];
        checkpoints_.restore(block, *current);
        const RenderStats before = stats;  // nothing counts twice
        this->replaying_ = true;
        this->first_level_ = int(block) * BlockLevels;
        n_levels_ = 0;
        for (int l = 0; l < BlockLevels; ++l) {
            run_level<true>(*current, *next, uint32_t(this->first_level_ + l));
            std::swap(current, next);
        }
        this->replaying_ = false;
        this->tracker_.collisions = this->tracker_.exceeded = 0;
        stats = before;
    }

    template <class Sink>
    void sweep_tape(Sink &sink, bool forward, size_t block) {
        typename TapeSweep<F, C>::Paths paths{delta, radiance, film_x, film_y, n_slots_, {}};
        paths.pixel = pixel, paths.sample = sample;
        if (volumetric_ && probing_) paths.branches = this->branches();
        paths.first_level = this->first_level_;
        boundary_.clear();
        if (block > 0) paths.boundary = &boundary_;
        TapeSweep<F, C> sweep(call_, *derivative_, levels_, n_levels_, paths);
        sweep.run(sink, forward);
    }

    // ------------------------------------------------------------------------------------------------------ queries
    // The last ray of a path brings something only if it meets a light: one that passes all of them is not traced.
    void keep_rays_to_lights(Front<S, C> &front) {
        if (scene_.n_light_boxes < 0 || recorder.on() || replay.on()) return;
        size_t kept = 0;
        for (size_t i = 0; i < front.n; i += W) {
            Vec3<F> o = load_vec<F>(front.o, i), d = load_vec<F>(front.d, i);
            M keep = mask<F>(load_uint<F>(front.seen + i) == U(0u));  // what it meets counts as seen, light or not
            const F *from[3] = {&o.x, &o.y, &o.z}, *along[3] = {&d.x, &d.y, &d.z};
            F inverse[3];
            for (int k = 0; k < 3; ++k) {
                M flat = mask<F>(abs(*along[k]) < F(S(1e-18)));
                inverse[k] = F(1) / select(flat, F(S(1e-18)), *along[k]);
            }
            for (int32_t l = 0; l < scene_.n_light_boxes; ++l) {
                const S *box = scene_.light_boxes + 6 * l;
                F first(0), last = F(S(INFINITY));
                for (int k = 0; k < 3; ++k) {
                    F a = (F(box[k]) - *from[k]) * inverse[k], b = (F(box[3 + k]) - *from[k]) * inverse[k];
                    first = max(first, min(a, b));
                    last = min(last, max(a, b));
                }
                keep = keep || mask<F>(first <= last * F(1.00001));
            }
            keep = keep && mask<F>(U(uint32_t(i)) + lane_index<F>() < U(uint32_t(front.n)));
            front.for_columns([&](auto *column) {
                using T = std::remove_pointer_t<decltype(column)>;
                if constexpr (std::is_same_v<T, S>)
                    store_compressed<F>(column + kept, load<F>(column + i), keep);
                else
                    store_compressed<F>(column + kept, load_uint<F>(column + i), keep);
            });
            kept += size_t(count(keep));
        }
        front.n = kept;
    }

    // `again`: of the same rays those that have passed through an emitter go on, the others hit what they have hit.
    void trace(Front<S, C> &front, bool again = false) {
        auto begin = std::chrono::steady_clock::now();
        RayBatch rays = ray_batch(front.o, front.d, front.length, front.n, ray_);
        HitBatch hits = this->hit_columns();
        const bool coherent = &front == &fronts_[0];
        auto moved = [&](size_t i) { return !again || passes_emitter(scene_, hit_shape_[i]); };
        if (replay.on()) {
            stats.closest_rays += replay.intersect(*call_.accel, rays, front.slot, hits, front.n, coherent, moved);
        } else {
            if (recorder.on()) recorder.choose(front.n, moved);
            call_.accel->intersect(rays, hits, front.n, coherent);
            if (recorder.on()) recorder.put(front.slot, hits);
            stats.closest_rays += front.n;
        }
        this->widen_hits(front.n);
        stats.seconds_trace += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
        if (call_.ray_record && !replay.on()) {
            size_t hits = front.n - size_t(std::count(hit_shape_, hit_shape_ + front.n, Accel::Miss));
            call_.ray_record->add(&front == &fronts_[0] ? RayKind::Camera : RayKind::Bounce, rays, front.n, hits);
        }
    }

    // ----------------------------------------------------------------------------------------------------- grouping
    // BySide: it depends on the hit.
    int kind_below(int bsdf) const {
        const Record &r = scene_.bsdfs[bsdf];
        if (turns_normals(r.kind)) return kind_below(r.field[NormalMap::Nested]);
        if (r.kind == MaskKind) return BySide;
        if (r.kind == BlendKind) {
            int first = kind_below(r.field[BlendBsdf::First]);
            return first == kind_below(r.field[BlendBsdf::Second]) ? first : BySide;
        }
        if (r.kind != TwoSidedKind) return r.kind;
        int front = kind_below(r.field[TwoSided::Front]);
        return r.field[TwoSided::Back] < 0 || front == kind_below(r.field[TwoSided::Back]) ? front : BySide;
    }

    // The leaf at a hit, whose frame it may turn. `scattering` counts the blocks of random numbers.
    Leaf<F> resolve(Interaction<F> &si, const Vec3<F> &d, const U &slot, uint32_t scattering, bool viewed,
                    bool derivative, const M &active) const {
        if (!scene_.layered) return resolve_bsdf<F>(scene_, si.shape.bsdf, mask<F>(dot(si.frame.n, d) > F(0)), active);
        LaneSet<F> paths(slot, active);
        Random4<F> u = draw4<F>(call_.config, paths.get(pixel), paths.get(sample),
                                BsdfBlock + BlocksPerScattering * scattering, 4);
        return resolve_layers<C>(scene_, si, d, u.u[3], viewed,
                                 derivative && derivative_->wanted.bsdf ? bsdf_wanted() : nullptr, active);
    }

    // Turns the frame to the tangent if the model of this kind asks for that.
    void orient(int kind, Interaction<F> &si, const M &active) const {
        bool oriented = false;
        dispatch(Bsdfs{}, kind, [&](auto m) { oriented = IsOriented<decltype(m)>::value; });
        if (oriented) si.frame = tangent_frame(si.frame.n, surface_tangent(scene_, si.at, active));
    }

    // The kinds of the packet of hits at i: Ignore where nothing is to be done.
    I kinds_at(const Front<S, C> &front, size_t i, const M &active, bool scatters, int depth, uint32_t scattering,
               bool derivative) const {
        U shape = load_uint<F>(hit_shape_ + i);
        if (volumetric_) return volumetric_kinds(front, i, active, shape, scattering, derivative);
        M hit = active && mask<F>(shape != Accel::Miss);
        bool shows = scene_.environment >= 0 && !(call_.config.hide_emitters && depth == 0);
        I kind = select(mask<I>(active && !hit), I(shows ? Miss : Ignore), I(Ignore));
        if (!any(hit)) return kind;
        ShapeLanes<F> info(scene_.shapes, shape, hit);
        if (!scatters && depth > 0) hit = hit && mask<F>(info.emitter >= 0);  // paths may end in the dark
        if (!any(hit)) return kind;
        return surface_kinds(front, i, shape, info, hit, scattering, derivative, kind);
    }

    I volumetric_kinds(const Front<S, C> &front, size_t i, const M &active, const U &shape, uint32_t scattering,
                       bool derivative) const {
        M collided = active && mask<F>(shape == U(CollisionShape)), missed = active && mask<F>(shape == U(Accel::Miss));
        M shows = missed && M(scene_.environment >= 0);
        if (derivative)  // a segment through a medium has a derivative wherever it ends
            shows = shows || (missed && mask<F>(I(load_uint<F>(front.medium + i)) >= 0));
        I kind = select(mask<I>(collided), I(Collision), select(mask<I>(shows), I(Miss), I(Ignore)));
        M hit = active && !collided && !missed;
        if (!any(hit)) return kind;
        ShapeLanes<F> info(scene_.shapes, shape, hit);
        kind = surface_kinds(front, i, shape, info, hit, scattering, derivative, kind);
        if (call_.config.hide_emitters) {  // camera rays pass through lights
            M hidden = hit && mask<F>(info.emitter >= 0) && mask<F>(load_uint<F>(front.depth + i) == U(0u));
            kind = select(mask<I>(hidden), I(NullKind), kind);
        }
        return kind;
    }

    I surface_kinds(const Front<S, C> &front, size_t i, const U &shape, const ShapeLanes<F> &info, const M &hit,
                    uint32_t scattering, bool derivative, I kind) const {
        I leaf[1];
        gather_few_rows<F>(leaf_kind_.data(), U(info.bsdf), hit, leaf);
        kind = select(mask<I>(hit), leaf[0], kind);
        M by_side = hit && mask<F>(kind == BySide);
        if (any(by_side)) {
            Ray<F> ray{load_vec<F>(front.o, i), load_vec<F>(front.d, i)};
            SurfacePoint<F> at{shape, load_uint<F>(hit_primitive_ + i), load<F>(hit_b1_ + i), load<F>(hit_b2_ + i)};
            Interaction<F> si = make_interaction(scene_, ray, at, load<F>(hit_t_ + i), by_side);
            U slot = select(mask<U>(by_side), load_uint<F>(front.slot + i), U(0u));
            Leaf<F> leaf = resolve(si, ray.d, slot, scattering, Viewed, derivative, by_side);
            kind = select(mask<I>(by_side), tr::leaf_kind(scene_, leaf, by_side), kind);
        }
        return kind;
    }

    // Stable counting sort by model; every segment starts at a multiple of the packet width, with room for a packet
    // behind the one before.
    void group(const Front<S, C> &front, bool scatters, int depth, uint32_t scattering, bool derivative,
               std::vector<Segment> &segments) {
        uint32_t counts[Collision + 1] = {}, begin[Collision + 1];
        for (size_t i = 0; i < front.n; i += W) {
            U entry = U(uint32_t(i)) + lane_index<F>();
            I kind = kinds_at(front, i, mask<F>(entry < U(uint32_t(front.n))), scatters, depth, scattering, derivative);
            store(kind_ + i, kind);
            for_each_distinct<F>(kind, mask<F>(kind >= 0),
                                 [&](int32_t k, const M &same) { counts[k] += uint32_t(count(same)); });
        }
        segments.clear();
        uint32_t at = 0;
        for (int k = 0; k <= Collision; ++k) {
            begin[k] = at;
            if (counts[k]) segments.push_back({k, at, counts[k]});
            at += room(counts[k]);
        }
        for (size_t i = 0; i < front.n; i += W) {
            I kind = I(load_uint<F>(reinterpret_cast<const uint32_t *>(kind_) + i));
            for_each_distinct<F>(kind, mask<F>(kind >= 0), [&](int32_t k, const M &same) {
                store_compressed<F>(order_ + begin[k], U(uint32_t(i)) + lane_index<F>(), same);
                begin[k] += uint32_t(count(same));
            });
        }
    }
    static constexpr uint32_t room(uint32_t n) { return n ? (n + 2 * W - 1) / W * W : 0; }

    // --------------------------------------------------------------------------------------------------------- steps
    template <bool Derivative>
    void step(const Front<S, C> &front, Front<S, C> &next, int depth, int index, bool scatters, int parent_level) {
        next.n = 0;
        shadow_.n = 0;
        std::vector<Segment> *segments = &segments_;
        if (Derivative) {
            if (size_t(n_levels_) == levels_.size()) levels_.push_back(std::make_unique<TapeLevel<S, C>>());
            TapeLevel<S, C> &level = *levels_[size_t(n_levels_++)];
            level.reserve(entries(front.n), volumetric_, false, scene_);
            level.parent_level = parent_level;
            level.scatters = scatters;
            segments = &level.segments;
        }
        group(front, scatters, depth, uint32_t(depth + index), Derivative, *segments);
        for (const Segment &segment : *segments) {
            for (uint32_t i = segment.begin; i < segment.begin + segment.count; i += W) {
                LaneSet<F> lanes(order_ + i, segment.begin + segment.count - i);
                stats.lanes += uint64_t(count(lanes.active));
                stats.lane_slots += W;
                if (Derivative && volumetric_) this->put_flight(front, lanes, i, depth);
                if (segment.kind == Collision)
                    this->template shade_collision<Derivative>(front, next, lanes, i, depth);
                else if (segment.kind == Miss)
                    shade_environment<Derivative>(front, lanes, i, depth, index);
                else
                    shade<Derivative>(segment.kind, front, next, lanes, i, depth, index, scatters);
            }
        }
        if (volumetric_)
            this->template trace_through<Derivative>(uint32_t(depth));
        else
            trace_shadow<Derivative>(depth);
    }

    template <bool Derivative>
    void shade_environment(const Front<S, C> &front, LaneSet<F> lanes, uint32_t i, int depth, int index) {
        if (index > 0) return emission_only<Derivative>(front, lanes, i);
        if (volumetric_) {
            M hidden = call_.config.hide_emitters ? mask<F>(lanes.get(front.depth) == U(0u)) : M(false);
            if (scene_.environment < 0 || all(hidden || !lanes.active))
                return emission_only<Derivative>(front, lanes, i);
            lanes.active = lanes.active && !hidden;
        }
        Origin<F> from{lanes.vec(front.from), lanes.get(front.pdf)};
        Emission<F, C> e =
            environment_emission<C>(scene_, call_.config, lanes.vec(front.d), from, lanes.active, depth == 1);
        Color<F, C> beta = lanes.template color<C>(front.beta);
        U slot = lanes.get(front.slot);
        if (Derivative) {
            level().template put_vertex<F>(i, slot, lanes.get(front.parent), beta, e.point.at, e);
            put_ray_that_left(front, lanes, i);
        } else {
            add_to_slots<F>(radiance, slot, beta * e.radiance,
                            finite(e.radiance, lanes.active, "environment", e.point.emitter));
        }
    }

    void put_ray_that_left(const Front<S, C> &front, const LaneSet<F> &lanes, uint32_t i) {
        if (!derivative_->wanted.geometry) return;
        Vec3<F> zero{F(0), F(0), F(0)};
        level().template put_motion<F>(i, lanes.vec(front.d), zero, zero, F(0), mask<F>(lanes.get(front.pdf) == F(0)));
    }

    // A vertex whose emission another split has already counted.
    template <bool Derivative>
    void emission_only(const Front<S, C> &front, const LaneSet<F> &lanes, uint32_t i) {
        if (!Derivative) return;
        Emission<F, C> e = no_emission();
        level().template put_vertex<F>(i, lanes.get(front.slot), lanes.get(front.parent),
                                       lanes.template color<C>(front.beta), e.point.at, e);
        put_ray_that_left(front, lanes, i);
    }

    template <bool Derivative>
    void shade(int kind, const Front<S, C> &front, Front<S, C> &next, const LaneSet<F> &lanes, uint32_t i, int depth,
               int index, bool scatters) {
        const PathConfig &config = call_.config;
        M active = lanes.active;
        Ray<F> ray{lanes.vec(front.o), lanes.vec(front.d)};
        Interaction<F> si = this->interaction(ray, lanes);
        const F cos_i = -dot(si.frame.n, ray.d);
        Origin<F> from{lanes.vec(front.from), lanes.get(front.pdf)};
        Color<F, C> beta = lanes.template color<C>(front.beta);
        U slot = lanes.get(front.slot);
        const bool passes = volumetric_ && kind == NullKind;
        M shown = passes && config.hide_emitters ? active && !mask<F>(lanes.get(front.depth) == U(0u)) : active;
        Emission<F, C> e =
            index == 0 ? surface_emission<C>(scene_, config, si, cos_i, from, shown, depth == 1) : no_emission();
        if (Derivative) {
            level().template put_vertex<F>(i, slot, lanes.get(front.parent), beta, si.at, e);
            if (derivative_->wanted.geometry) {
                Vec3<F> segment = si.p - from.p;
                level().template put_motion<F>(i, ray.d, si.p, segment, depth == 0 ? norm(segment) : si.t,
                                               mask<F>(from.pdf == F(0)));
            }
        } else if (any(active && mask<F>(e.weight > F(0)))) {
            add_to_slots<F>(radiance, slot, beta * e.radiance,
                            finite(e.radiance, active && mask<F>(e.weight > F(0)), "emitter", e.point.emitter));
        }
        U seen = lanes.get(front.seen);
        const bool invisible = kind == NullKind || kind == OpeningKind;
        if (!Derivative && !invisible) see(slot, seen, active);
        if (!scatters) return;
        if (passes) return this->template pass<Derivative>(front, next, lanes, i, si, slot, beta);

        M may = active, counted(true);  // lanes that may scatter; those that roulette may end
        U path_depth = U(uint32_t(depth));
        I medium(-1);
        if (volumetric_) {
            path_depth = lanes.get(front.depth);
            medium = I(lanes.get(front.medium));
            may = active && this->may_scatter(path_depth);
            counted = mask<F>(I(path_depth) + 1 >= I(config.rr_depth));
        }

        Leaf<F> leaf = resolve(si, ray.d, slot, uint32_t(depth + index), Viewed, Derivative, active);
        if (scene_.oriented) orient(kind, si, active);
        Vec3<F> wi = si.frame.to_local(-ray.d);
        wi.z = select(leaf.mirrored, -wi.z, wi.z);
        LaneSet<F> paths(slot, active);
        U path_pixel = paths.get(pixel), path_sample = paths.get(sample);
        uint32_t block = BlocksPerScattering * uint32_t(depth + index);
        bool roulette = volumetric_ ? any(counted) : depth + 1 >= config.rr_depth;
        Random4<F> ue = draw4<F>(config, path_pixel, path_sample, EmitterBlock + block, roulette ? 4 : 3);
        Random4<F> ub = draw4<F>(config, path_pixel, path_sample, BsdfBlock + block, 3);
        Scattering<F, C> s;
        dispatch(LeafBsdfs{}, kind,
                 [&](auto m) { scatter<decltype(m)>(scene_, config, si, wi, leaf, index, depth, ue, ub, may, s); });
        add_shadow_rays<Derivative>(si, s, beta, slot, i, leaf.bsdf, medium);

        // Russian roulette
        Color<F, C> weight = s.f * s.inverse_pdf;
        M alive = s.alive && finite(weight, s.alive, "bsdf", leaf.bsdf);
        Color<F, C> survival = beta;
        if (Derivative) {
            // a path that an albedo of zero would end goes on where that albedo has a derivative
            Color<F, C> kept = weight;
            if (derivative_->wanted.bsdf) {
                M wanted = mask<F>(gather<I>(bsdf_wanted(), U(leaf.bsdf), mask<I>(active)) != 0);
                if (scene_.layered) wanted = wanted || leaf.layers.wanted;
                kept = select(wanted, max_with(magnitude(weight), F(0.05)), weight);
            }
            survival = lanes.template color<C>(front.survival) * kept;
        } else {
            survival = beta * weight;
        }
        F eta = lanes.get(front.eta) * s.sample.eta;
        F largest = max_channel(survival);
        alive = alive && mask<F>(largest > F(0));
        F keep(1);
        if (roulette) {
            F q = min(largest * eta * eta, F(0.95));
            alive = alive && (!counted || mask<F>(ue.u[3] < q));
            keep = select(alive && counted, F(1) / select(alive, q, F(1)), F(1));
        }
        if (Derivative)
            level().put_scattering(i, leaf, si.at.uv, wi, si.frame, s, select(alive, s.inverse_pdf * keep, F(0)));
        if (!any(alive)) return;
        Vec3<F> wo = s.sample.wo;
        wo.z = select(leaf.mirrored, -wo.z, wo.z);
        Ray<F> out;
        out.d = normalize(si.frame.to_world(wo));
        out.o = offset_origin(si.p, si.ng, out.d);
        U now_seen = invisible ? seen : U(1u);
        size_t appended = next.n;
        append(next, out, F(S(INFINITY)), si.p, select(s.sample.delta, F(0), s.sample.pdf), beta * weight * keep,
               survival * keep, eta, slot, U(i) + lane_index<F>(), now_seen, alive);
        if (volumetric_)
            this->put_volumetric(next, appended, medium_behind(scene_, si.at.shape, si.ng, out.d, medium, alive),
                                 path_depth + 1u, dot(out.o - si.p, out.d), lanes.template color<C>(front.channel),
                                 alive);
    }

    template <bool Derivative>
    void add_shadow_rays(const Interaction<F> &si, Scattering<F, C> &s, const Color<F, C> &beta, const U &slot,
                         uint32_t i, const I &bsdf, const I &medium) {
        M wanted = s.shadow_ray;
        if (!any(wanted)) return;
        Color<F, C> contribution = beta * s.f_light * s.emitted * s.light_weight;
        wanted = wanted && finite(contribution, wanted, "bsdf", bsdf);
        s.light_weight = select(wanted, s.light_weight, F(0));
        // what is black contributes nothing, but may have a derivative
        if (!Derivative && !recorder.on()) wanted = wanted && mask<F>(max_channel(contribution) > F(0));
        if (!any(wanted)) return;
        // towards the sampled point from where the ray really starts
        M finite_distance = mask<F>(s.light.distance < F(S(1e30)));
        Vec3<F> o = offset_origin(si.p, si.ng, s.light.d);
        Direction<F> to_light(si.p + s.light.d * select(finite_distance, s.light.distance, F(1)) - o);
        Vec3<F> d = select(finite_distance, to_light.d, s.light.d);
        F length = select(finite_distance, to_light.length * F(1 - ShadowEpsilon), F(S(INFINITY)));
        if (volumetric_)
            return this->push_shadow(o, d, length, dot(o - si.p, d), contribution,
                                     medium_behind(scene_, si.at.shape, si.ng, d, medium, wanted), slot,
                                     U(i) + lane_index<F>(), ShadowPurpose::Vertex, wanted);
        size_t n = shadow_.n;
        const Vec3<F> *vectors[2] = {&o, &d};
        S *const *columns[2] = {shadow_.o, shadow_.d};
        for (int k = 0; k < 2; ++k) {
            store_compressed<F>(columns[k][0] + n, vectors[k]->x, wanted);
            store_compressed<F>(columns[k][1] + n, vectors[k]->y, wanted);
            store_compressed<F>(columns[k][2] + n, vectors[k]->z, wanted);
        }
        store_compressed<F>(shadow_.length + n, length, wanted);
        if (!Derivative)
            for (int c = 0; c < C; ++c) store_compressed<F>(shadow_.contribution[c] + n, contribution[c], wanted);
        store_compressed<F>(shadow_.slot + n, slot, wanted);
        store_compressed<F>(shadow_.position + n, U(i) + lane_index<F>(), wanted);
        shadow_.n += size_t(count(wanted));
    }

    template <bool Derivative>
    void trace_shadow(int depth) {
        if (shadow_.n == 0) return;
        auto begin = std::chrono::steady_clock::now();
        RayBatch rays = ray_batch(shadow_.o, shadow_.d, shadow_.length, shadow_.n, ray_);
        if (replay.on()) {
            stats.shadow_rays += replay.occluded(*call_.accel, rays, shadow_.slot, occluded_, shadow_.n);
        } else {
            call_.accel->occluded(rays, occluded_, shadow_.n);
            if (recorder.on()) recorder.put_shadows(shadow_.slot, occluded_, shadow_.n);
            stats.shadow_rays += shadow_.n;
        }
        stats.seconds_trace += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
        if (call_.ray_record && !replay.on()) {
            size_t hits = size_t(std::count(occluded_, occluded_ + shadow_.n, uint8_t(1)));
            call_.ray_record->add(depth == 0 ? RayKind::CameraShadow : RayKind::BounceShadow, rays, shadow_.n, hits);
        }
        // half of them hit, at random: no branches
        for (size_t k = 0; k < shadow_.n; ++k) {
            S visible(occluded_[k] ? 0 : 1);
            if (Derivative) {
                level().light_weight[shadow_.position[k]] *= visible;
            } else {
                uint32_t slot = shadow_.slot[k];
                for (int c = 0; c < C; ++c) radiance[c][slot] += visible * shadow_.contribution[c][k];
            }
        }
    }

    std::vector<int> leaf_kind_;
    Checkpoints<S, C> checkpoints_;
    BlockBoundary<S, C> boundary_;
};

}  // namespace tr
