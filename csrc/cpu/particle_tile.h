// A tile of light paths on one thread, a step at a time as in PathTile: rays are traced, hits grouped by model and
// shaded. In the place of shadow rays to lights there are connections to the camera, which end anywhere on the film:
// `visit(level, connections)` takes those that are free, the emitters' own first.
#pragma once

#include "core/adjoint/particle.h"
#include "particle_sweep.h"
#include "path_tile.h"

namespace tr {

// Connections whose way is free: place on the film, what they bring, and the entry of the tape's level.
template <class S, int C>
struct Connections {
    size_t n = 0;
    S *x, *y, *value[C];
    uint32_t *position, *slot;
};

template <class F, int C>
class ParticleTile : public PathTile<F, C> {
    using Base = PathTile<F, C>;
    using Base::append, Base::level, Base::finite, Base::entries, Base::bsdf_wanted, Base::no_emission, Base::group;
    using Base::call_, Base::scene_, Base::derivative_, Base::fronts_, Base::shadow_, Base::levels_, Base::n_levels_;
    using Base::hit_shape_, Base::hit_t_, Base::order_, Base::ray_;
    using Base::occluded_, Base::segments_, Base::W, Base::Miss, Base::n_slots_;
    using typename Base::I;
    using typename Base::M;
    using typename Base::S;
    using typename Base::U;

public:
    using Base::pixel, Base::row, Base::column, Base::sample, Base::delta, Base::radiance, Base::film_x, Base::film_y,
        Base::stats;

    ParticleTile(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> *derivative)
        : Base(call, capacity, derivative),
          sensor_(scene_, call.config.sensor, S(call.film_width), S(call.film_height)) {
        place_.allocate([&](Arena &a) {
            a.column(x_, capacity + 2 * size_t(W));
            a.column(y_, capacity + 2 * size_t(W));
        });
    }

    // Traces the paths of the first n slots, whose pixels are strata of the emitters.
    template <bool Derivative, class Stop, class Visit>
    void run(size_t n, Stop &&stop, Visit &&visit) {
        const int32_t max_depth = call_.config.max_depth;
        n_levels_ = 0;
        n_slots_ = n;
        if (max_depth == 0 || scene_.n_emitters == 0) return;
        Front<S, C> *current = &fronts_[0], *next = &fronts_[1];
        start<Derivative>(*current, n);
        finish_connections<Derivative>(visit);
        for (int depth = 0; current->n > 0 && !stop() && (max_depth < 0 || depth + 2 <= max_depth); ++depth) {
            this->trace(*current);
            step<Derivative>(*current, *next, depth, max_depth < 0 || depth + 3 <= max_depth);
            finish_connections<Derivative>(visit);
            std::swap(current, next);
        }
    }

    // Over the tape from its end. What `visit` has written into it are the connections' adjoints.
    template <class Sink>
    void sweep(Sink &sink) {
        ParticleSweep<F, C> sweep(call_, *derivative_, levels_, n_levels_, {delta, radiance, film_x, film_y, n_slots_},
                                  sensor_);
        sweep.run(sink);
        stats.non_finite += sink.non_finite;
        if (sink.non_finite && stats.non_finite_where.empty()) stats.non_finite_where = "a derivative";
        sink.non_finite = 0;
    }

    int n_levels() const { return n_levels_; }
    TapeLevel<S, C> &level_at(int i) { return *levels_[size_t(i)]; }

private:
    void new_level(size_t n) {
        if (size_t(n_levels_) == levels_.size()) levels_.push_back(std::make_unique<TapeLevel<S, C>>());
        TapeLevel<S, C> &level = *levels_[size_t(n_levels_)];
        level.reserve(n, false, true, scene_);
        level.parent_level = n_levels_ - 1;
        level.scatters = true;
        ++n_levels_;
    }

    template <bool Derivative>
    void start(Front<S, C> &front, size_t n) {
        front.n = shadow_.n = 0;
        if (Derivative) {
            new_level(n + W);
            level().segments.assign(1, {Segment::Emission, 0, uint32_t(n)});
        }
        for (size_t i = 0; i < n; i += W) {
            U slot = U(uint32_t(i)) + lane_index<F>();
            M active = mask<F>(slot < uint32_t(n));
            U path_pixel = load_uint<F>(pixel + i), path_sample = load_uint<F>(sample + i);
            Random4<F> u = draw4<F>(call_.config, path_pixel, path_sample, 0, 2);
            Random4<F> v = draw4<F>(call_.config, path_pixel, path_sample, EmissionBlock, 3);
            F a = (F(I(load_uint<F>(column + i))) + u.u[0]) * F(S(1) / S(call_.film_width));
            F b = (F(I(load_uint<F>(row + i))) + u.u[1]) * F(S(1) / S(call_.film_height));
            for (int c = 0; c < C; ++c) store(radiance[c] + i, F(0));
            EmissionSample<F> e = sample_emission(scene_, v.u[0], a, b, v.u[1], v.u[2], active);
            Color<F, C> sent = eval_emission<C>(scene_, e.point, e.kind, e.active);
            e.active = e.active && finite(sent, e.active, "emitter", e.point.emitter);
            M parallel = is_parallel<F>(e.kind);
            if (Derivative)
                level().template put_emission<F>(i, slot, sent, e.point, e.p, e.n, e.d, e.kind,
                                                 select(e.active, e.weight, F(0)));
            if (!call_.config.hide_emitters && sensor_.meter < 0)
                connect_emitter<Derivative>(e, sent, parallel, slot, i);

            M beam = mask<F>(e.kind == int32_t(EmitterKind::DirectionalArea));
            M surface = beam || mask<F>(e.kind == int32_t(EmitterKind::Area));
            // a path without light may still have a derivative
            M alive = Derivative ? e.active : e.active && mask<F>(max_channel(sent) > F(0));
            if (!any(alive)) continue;
            Ray<F> ray{select(surface, offset_origin(e.p, e.n, e.d), e.p), e.d};
            append(front, ray, F(S(INFINITY)), e.p, select(beam, F(0), select(parallel, F(-1), F(1))), sent * e.weight,
                   uniform_color<C>(F(1)), F(1), slot, slot, U(1u), alive);
        }
    }

    // The light itself, as the camera sees it.
    template <bool Derivative>
    void connect_emitter(const EmissionSample<F> &e, const Color<F, C> &sent, const M &parallel, const U &slot,
                         size_t i) {
        M visible = e.active && (mask<F>(e.kind == int32_t(EmitterKind::Area)) || is_surrounding<F>(e.kind));
        if (!any(visible)) return;
        Vec3<F> p = select(parallel, -e.d, e.p);
        Connection<F> to = connect(sensor_.camera, p, parallel, visible);
        F cosine = emission_cosine(e, to.d);
        M seen = to.seen && mask<F>(cosine > F(0));
        if (!any(seen)) return;
        F weight = cosine * e.inverse_pdf * to.importance;
        Vec3<F> o = offset_origin(e.p, e.n, to.d), d = to.d;
        F length = to.clear;
        if (any(parallel)) {  // from the camera to where light comes from
            Vec3<F> origin{F(sensor_.camera.origin.x), F(sensor_.camera.origin.y), F(sensor_.camera.origin.z)};
            o = select(parallel, origin - to.d * (to.distance - to.clear), o);
            d = select(parallel, -to.d, d);
            length = select(parallel, F(S(INFINITY)), length);
        }
        if (Derivative) level().template put_connection<F>(i, Vec3<F>{F(0), F(0), F(1)}, select(seen, weight, F(0)));
        push<Derivative>(o, d, length, to, sent * weight, slot, i, seen);
    }

    template <bool Derivative>
    void push(const Vec3<F> &o, const Vec3<F> &d, const F &length, const Connection<F> &to, const Color<F, C> &value,
              const U &slot, size_t i, M wanted) {
        // what is black brings nothing, but may have a derivative
        if (!Derivative) wanted = wanted && mask<F>(max_channel(value) > F(0));
        if (!any(wanted)) return;
        size_t n = shadow_.n;
        const F *numbers[9] = {&o.x, &o.y, &o.z, &d.x, &d.y, &d.z, &length, &to.x, &to.y};
        S *columns[9] = {
            shadow_.o[0], shadow_.o[1], shadow_.o[2], shadow_.d[0], shadow_.d[1], shadow_.d[2], shadow_.length, x_, y_};
        for (int k = 0; k < 9; ++k) store_compressed<F>(columns[k] + n, *numbers[k], wanted);
        for (int c = 0; c < C; ++c) store_compressed<F>(shadow_.contribution[c] + n, value[c], wanted);
        store_compressed<F>(shadow_.slot + n, slot, wanted);
        store_compressed<F>(shadow_.position + n, U(uint32_t(i)) + lane_index<F>(), wanted);
        shadow_.n += size_t(count(wanted));
    }

    // Traces them and hands those that are free to `visit`; others have no weight on the tape.
    template <bool Derivative, class Visit>
    void finish_connections(Visit &visit) {
        if (shadow_.n == 0) return;
        auto begin = std::chrono::steady_clock::now();
        RayBatch rays = ray_batch(shadow_.o, shadow_.d, shadow_.length, shadow_.n, ray_);
        if (sensor_.meter >= 0)
            std::fill_n(occluded_, shadow_.n, uint8_t(0));
        else if (call_.config.hide_emitters)
            pass_lights();
        else
            call_.accel->occluded(rays, occluded_, shadow_.n);
        stats.shadow_rays += sensor_.meter >= 0 ? 0 : shadow_.n;
        stats.seconds_trace += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
        if (call_.ray_record && sensor_.meter < 0) {
            size_t hits = size_t(std::count(occluded_, occluded_ + shadow_.n, uint8_t(1)));
            call_.ray_record->add(RayKind::BounceShadow, rays, shadow_.n, hits);
        }
        Connections<S, C> free{0, x_, y_, {}, shadow_.position, shadow_.slot};
        for (int c = 0; c < C; ++c) free.value[c] = shadow_.contribution[c];
        for (size_t k = 0; k < shadow_.n; ++k) {
            if (occluded_[k]) {
                if (Derivative) level().light_weight[shadow_.position[k]] = S(0);
                continue;
            }
            size_t to = free.n++;
            x_[to] = x_[k], y_[to] = y_[k];
            for (int c = 0; c < C; ++c) free.value[c][to] = free.value[c][k];
            free.position[to] = free.position[k], free.slot[to] = free.slot[k];
        }
        visit(n_levels_ - 1, free);
        shadow_.n = 0;
    }

    // Connections of an image without lights: these do not stand in the way.
    void pass_lights() {
        size_t n = shadow_.n;
        auto query = [&] {
            call_.accel->intersect(ray_batch(shadow_.o, shadow_.d, shadow_.length, n, ray_), this->hit_columns(), n,
                                   false);
            this->widen_hits(n);
        };
        query();
        pass_emitters(scene_, shadow_.o, shadow_.d, shadow_.length, hit_shape_, hit_t_, n, query);
        for (size_t k = 0; k < n; ++k) occluded_[k] = hit_shape_[k] != Accel::Miss;
    }

    template <bool Derivative>
    void step(const Front<S, C> &front, Front<S, C> &next, int depth, bool goes_on) {
        next.n = shadow_.n = 0;
        std::vector<Segment> *segments = &segments_;
        if (Derivative) {
            new_level(entries(front.n));
            segments = &level().segments;
        }
        group(front, true, depth, uint32_t(depth), Derivative, *segments);
        auto missed = [](const Segment &s) { return s.kind == Miss; };
        segments->erase(std::remove_if(segments->begin(), segments->end(), missed), segments->end());
        for (const Segment &segment : *segments)
            for (uint32_t i = segment.begin; i < segment.begin + segment.count; i += W) {
                LaneSet<F> lanes(order_ + i, segment.begin + segment.count - i);
                stats.lanes += uint64_t(count(lanes.active));
                stats.lane_slots += W;
                shade<Derivative>(segment.kind, front, next, lanes, i, depth, goes_on);
            }
    }

    template <bool Derivative>
    void shade(int kind, const Front<S, C> &front, Front<S, C> &next, const LaneSet<F> &lanes, uint32_t i, int depth,
               bool goes_on) {
        const PathConfig &config = call_.config;
        M active = lanes.active;
        Ray<F> ray{lanes.vec(front.o), lanes.vec(front.d)};
        Interaction<F> si = this->interaction(ray, lanes);
        Color<F, C> beta = lanes.template color<C>(front.beta);
        U slot = lanes.get(front.slot);
        if (Derivative) {
            level().template put_vertex<F>(i, slot, lanes.get(front.parent), beta, si.at, no_emission());
            if (derivative_->wanted.geometry) {
                Vec3<F> segment = si.p - lanes.vec(front.from);
                F arrival = lanes.get(front.pdf);
                level().template put_motion<F>(i, ray.d, si.p, segment, norm(segment), mask<F>(arrival == F(0)),
                                               mask<F>(arrival < F(0)));
            }
        }
        Leaf<F> leaf = this->resolve(si, ray.d, slot, uint32_t(depth), false, Derivative, active);
        if (scene_.oriented) this->orient(kind, si, active);
        Vec3<F> wi = si.frame.to_local(-ray.d);
        wi.z = select(leaf.mirrored, -wi.z, wi.z);
        LaneSet<F> paths(slot, active);
        U path_pixel = paths.get(pixel), path_sample = paths.get(sample);
        uint32_t block = BlocksPerScattering * uint32_t(depth);
        bool roulette = goes_on && depth + 1 >= config.rr_depth;
        Random4<F> ub{};
        if (goes_on) ub = draw4<F>(config, path_pixel, path_sample, BsdfBlock + block, 3);
        Connection<F> to{};
        bool smooth = false;
        dispatch(LeafBsdfs{}, kind, [&](auto m) { smooth = decltype(m)::Smooth; });
        if (smooth && sensor_.meter < 0) to = connect(sensor_.camera, si.p, M(false), active);
        if (config.hide_emitters) to.seen = to.seen && mask<F>(si.shape.emitter < 0);
        LightScattering<F, C> s;
        dispatch(LeafBsdfs{}, kind,
                 [&](auto m) { scatter_light<decltype(m)>(scene_, si, ray.d, wi, leaf, to, ub, goes_on, active, s); });
        if (sensor_.meter >= 0) {
            to = IrradianceMeter::measure(scene_, sensor_.meter, si, ray.d, S(call_.film_width), S(call_.film_height),
                                          active);
            s.connected = to.seen;
            s.f_camera = uniform_color<C>(F(1));
        }

        Color<F, C> brought = beta * s.f_camera * to.importance;
        M connected = s.connected;
        if (any(connected)) connected = connected && finite(brought, connected, "bsdf", leaf.bsdf);
        Color<F, C> weight = s.f * s.inverse_pdf, survival = lanes.template color<C>(front.survival);
        M alive = s.alive && finite(weight, s.alive, "bsdf", leaf.bsdf);
        Color<F, C> kept = weight;
        if (Derivative && derivative_->wanted.bsdf) {
            // a path that an albedo of zero would end goes on where that albedo has a derivative
            M wanted = mask<F>(gather<I>(bsdf_wanted(), U(leaf.bsdf), mask<I>(active)) != 0);
            if (scene_.layered) wanted = wanted || leaf.layers.wanted;
            kept = select(wanted, max_with(magnitude(weight), F(0.05)), weight);
        }
        survival = survival * kept;
        F largest = max_channel(survival), keep(1);
        alive = alive && mask<F>(largest > F(0));
        if (roulette) {
            Random4<F> ue = draw4<F>(config, path_pixel, path_sample, EmitterBlock + block, 4);
            F q = min(largest, F(0.95));
            alive = alive && mask<F>(ue.u[3] < q);
            keep = select(alive, F(1) / select(alive, q, F(1)), F(1));
        }
        if (Derivative) {
            level().template put_light_scattering<F>(i, leaf, si.at.uv, wi, si.frame, si.ng, s,
                                                     select(alive, s.inverse_pdf * keep, F(0)));
            level().template put_connection<F>(i, s.wo_camera, select(connected, to.importance, F(0)));
        }
        if (any(connected))
            push<Derivative>(offset_origin(si.p, si.ng, to.d), to.d, to.clear, to, brought, slot, i, connected);
        if (!any(alive)) return;
        Vec3<F> wo = s.sample.wo;
        wo.z = select(leaf.mirrored, -wo.z, wo.z);
        Ray<F> out;
        out.d = normalize(si.frame.to_world(wo));
        out.o = offset_origin(si.p, si.ng, out.d);
        append(next, out, F(S(INFINITY)), si.p, select(s.sample.delta, F(0), s.sample.pdf), beta * weight * keep,
               survival * keep, F(1), slot, U(i) + lane_index<F>(), U(1u), alive);
    }

    LightSensor<S> sensor_;
    Arena place_;
    S *x_, *y_;  // on the film, beside shadow_
};

}  // namespace tr
