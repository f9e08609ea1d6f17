// The part of a tile that knows media: free flight before the vertices are shaded, collisions, boundaries that do not
// scatter, and the paths that derivatives of the extinction ask for.
#pragma once

#include "shadow_ways.h"

namespace tr {

template <class F, int C>
class VolumeTile : public ShadowWays<F, C> {
protected:
    using Base = ShadowWays<F, C>;
    using Base::call_, Base::scene_, Base::derivative_, Base::hit_shape_, Base::hit_t_, Base::order_;
    using Base::tracker_, Base::volumetric_, Base::probing_, Base::CollisionShape, Base::push_shadow;
    using Base::W, Base::pixel, Base::sample, Base::radiance, Base::n_slots_, Base::NullKind;
    using typename Base::I;
    using typename Base::M;
    using typename Base::S;
    using typename Base::U;
    static constexpr uint32_t NoLevel = 0xFFFFFFFFu;

public:
    VolumeTile(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> *derivative)
        : Base(call, capacity, derivative) {
        if (!volumetric_) return;
        for (int m = 0; m < scene_.n_media; ++m) {
            chromatic_ |= C > 1 && (scene_.media[m].flags & IsChromatic) != 0;
            emissive_ |= scene_.media[m].emission >= 0;
        }
        size_t n = capacity + 2 * W;
        flight_.allocate(n);
        paths_.allocate([&](Arena &a) {
            for (uint32_t **p : {&hero_, &chosen_level_, &chosen_entry_, &branch_medium_, &branch_depth_})
                a.column(*p, n);
            for (S **p : {&choice_, &total_weight_}) a.column(*p, n);
            for (auto *p : {&branch_o_, &branch_d_}) a.column(*p, n);
            for (auto *p : {&branch_beta_, &branch_channel_, &branch_}) a.column(*p, n);
            for (auto *p : {&first_, &probe_channel_}) a.column(*p, n);
        });
    }

protected:
    // Whether a path may scatter once more after `depth` scatterings.
    M may_scatter(const U &depth) const {
        return call_.config.max_depth < 0 ? M(true) : mask<F>(I(depth) + 1 < I(call_.config.max_depth));
    }

    // Of camera rays.
    void begin_volumetric(Front<S, C> &front) {
        std::fill_n(front.medium, front.n, uint32_t(camera_medium(scene_.sensors[call_.config.sensor])));
        std::fill_n(front.depth, front.n, 0u);
        std::fill_n(front.lag, front.n, S(0));
        for (int c = 0; c < C; ++c) std::fill_n(front.channel[c], front.n, S(1));
        for (size_t i = 0; i < n_slots_; i += W) {
            auto u = random4<F>(call_.config.seed, call_.config.sensor, load_uint<F>(pixel + i),
                                load_uint<F>(sample + i), ChannelBlock);
            store(hero_ + i, U(I(u.u[0] * F(C))));
        }
        std::fill_n(total_weight_, n_slots_, S(0));
        std::fill_n(chosen_level_, n_slots_, NoLevel);
        for (int c = 0; c < C; ++c) std::fill_n(branch_[c], n_slots_, S(0));
    }

    // After the query: where rays collide in their media, that is what they hit.
    template <bool Derivative>
    void fly(Front<S, C> &front, uint32_t level) {
        const PathConfig &config = call_.config;
        for (size_t i = 0; i < front.n; i += W) {
            M active = mask<F>(U(uint32_t(i)) + lane_index<F>() < U(uint32_t(front.n)));
            M missed = mask<F>(load_uint<F>(hit_shape_ + i) == U(Accel::Miss));
            store(flight_.end + i, select(missed, load<F>(front.length + i), load<F>(hit_t_ + i)));
            for (S *p : {flight_.start, flight_.length}) store(p + i, F(0));
            store(flight_.collided + i, U(0u));
            if (chromatic_)  // grey media do not write them
                for (auto *weight : {&flight_.weight, &flight_.probe_weight, &flight_.glow_weight})
                    for (int c = 0; c < C; ++c) store((*weight)[c] + i, F(1));
            M inside = active && mask<F>(I(load_uint<F>(front.medium + i)) >= 0);
            if (!any(inside)) continue;
            U slot = select(mask<U>(active), load_uint<F>(front.slot + i), U(0u));
            LaneSet<F> lanes(slot, active);
            auto bits = random_bits4<F>(config.seed, config.sensor, lanes.get(pixel), lanes.get(sample),
                                        U(SegmentBlock + BlocksPerSegment * level));
            store(flight_.seed[0] + i, bits.bits[0] | U(1u));
            store(flight_.seed[1] + i, bits.bits[1]);
            store(choice_ + i, uniform_of<F>(bits.bits[2]));
            if (chromatic_) store(flight_.hero + i, lanes.get(hero_));
        }
        for (int32_t m = 0; m < scene_.n_media; ++m) {
            size_t n = queue_of(front.medium, front.n, m, order_);
            if (n > 0) tracker_.fly(m, front.o, front.d, front.lag, flight_, order_, n, probing_ || emissive_);
        }
        for (size_t i = 0; i < front.n; i += W) {
            M collided = mask<F>(load_uint<F>(flight_.collided + i) != U(0u));
            U shape = load_uint<F>(hit_shape_ + i);
            store(hit_shape_ + i, select(mask<U>(collided), U(CollisionShape), shape));
            F end = load<F>(flight_.start + i) + load<F>(flight_.length + i);
            store(hit_t_ + i, select(collided, end, load<F>(hit_t_ + i)));
        }
        if (chromatic_) weigh_channels(front);
        if (emissive_ && !Derivative) add_emission(front);
    }

    // Collisions in media.
    template <bool Derivative>
    void shade_collision(const Front<S, C> &front, Front<S, C> &next, const LaneSet<F> &lanes, uint32_t i, int depth) {
        const PathConfig &config = call_.config;
        Ray<F> ray{lanes.vec(front.o), lanes.vec(front.d)};
        Vec3<F> p = ray.o + ray.d * lanes.get(hit_t_);
        I medium = I(lanes.get(front.medium));
        U slot = lanes.get(front.slot), path_depth = lanes.get(front.depth);
        Color<F, C> beta = lanes.template color<C>(front.beta);
        if (Derivative) {
            Emission<F, C> none = this->no_emission();
            this->level().template put_vertex<F>(i, slot, lanes.get(front.parent), beta, none.point.at, none);
            this->level().template put_point<F>(i, p, ray.d);
        } else {
            this->see(slot, lanes.get(front.seen), lanes.active);
        }
        M may = lanes.active && may_scatter(path_depth);
        LaneSet<F> paths(slot, lanes.active);
        U path_pixel = paths.get(pixel), path_sample = paths.get(sample);
        uint32_t block = BlocksPerScattering * uint32_t(depth);
        Random4<F> ue = draw4<F>(config, path_pixel, path_sample, EmitterBlock + block, 4);
        Random4<F> ub = draw4<F>(config, path_pixel, path_sample, BsdfBlock + block, 3);
        MediumScattering<F, C> s = no_medium_scattering<C, F>();
        scatter_in_medium<C>(scene_, medium, p, ray.d, ue, ub, may, s);
        Color<F, C> contribution = beta * s.albedo * s.emitted * (s.phase_light * s.light_weight);
        M lit = s.shadow_ray && this->finite(contribution, s.shadow_ray, "medium", medium);
        s.light_weight = select(lit, s.light_weight, F(0));
        if (!Derivative) lit = lit && mask<F>(max_channel(contribution) > F(0));
        push_shadow(p, s.light, contribution, medium, slot, U(i) + lane_index<F>(), ShadowPurpose::Vertex, lit);

        Color<F, C> survival = lanes.template color<C>(front.survival);
        M alive = may;
        if (Derivative) {
            // a path that an albedo of zero would end goes on where that albedo has a derivative
            survival = survival * (derivative_->wanted.medium.albedo ? max_with(s.albedo, F(0.05)) : s.albedo);
        } else {
            survival = beta * s.albedo;
        }
        F eta = lanes.get(front.eta), largest = max_channel(survival), keep(1);
        alive = alive && mask<F>(largest > F(0));
        M roulette = alive && mask<F>(I(path_depth) + 1 >= I(config.rr_depth));
        if (any(roulette)) {
            F q = min(largest * eta * eta, F(0.95));
            alive = alive && (!roulette || mask<F>(ue.u[3] < q));
            keep = select(alive && roulette, F(1) / select(alive, q, F(1)), F(1));
        }
        if (Derivative) {
            this->level().template put_light<F>(i, s.light.point, s.light.d, s.light_weight, s.emitted,
                                                s.light.distance);
            this->level().template put_direction<F>(i, s.wo, I(0),
                                                    select(alive, keep / select(alive, s.pdf, F(1)), F(0)));
        }
        if (!any(alive)) return;
        M weighted = samples_lights<F>(scene_, medium, alive);
        size_t at = next.n;
        this->append(next, {p, s.wo}, F(S(INFINITY)), p, select(weighted, s.pdf, F(0)), beta * s.albedo * keep,
                     survival * keep, eta, slot, U(i) + lane_index<F>(), U(1u), alive);
        put_volumetric(next, at, medium, path_depth + 1u, F(0), lanes.template color<C>(front.channel), alive);
    }

    // Boundaries that do not scatter: the ray goes on behind them, as if from where it came.
    template <bool Derivative>
    void pass(const Front<S, C> &front, Front<S, C> &next, const LaneSet<F> &lanes, uint32_t i,
              const Interaction<F> &si, const U &slot, const Color<F, C> &beta) {
        Vec3<F> d = lanes.vec(front.d);
        F length = lanes.get(front.length) - lanes.get(hit_t_);
        M on = lanes.active && mask<F>(length > F(0));
        if (Derivative) this->level().template put_passage<F>(i, select(on, F(1), F(0)));
        if (!any(on)) return;
        size_t at = next.n;
        I medium = I(lanes.get(front.medium));
        Vec3<F> o = offset_origin(si.p, si.ng, d);
        this->append(next, {o, d}, length, lanes.vec(front.from), lanes.get(front.pdf), beta,
                     lanes.template color<C>(front.survival), lanes.get(front.eta), slot, U(i) + lane_index<F>(),
                     lanes.get(front.seen), on);
        put_volumetric(next, at, medium_behind(scene_, si.at.shape, si.ng, d, medium, on), lanes.get(front.depth),
                       dot(o - si.p, d), lanes.template color<C>(front.channel), on);
    }

    TR_INLINE void put_volumetric(Front<S, C> &f, size_t at, const I &medium, const U &depth, const F &lag,
                                  const Color<F, C> &channel, const M &m) {
        store_compressed<F>(f.medium + at, U(medium), m);
        store_compressed<F>(f.depth + at, depth, m);
        store_compressed<F>(f.lag + at, lag, m);
        for (int c = 0; c < C; ++c) store_compressed<F>(f.channel[c] + at, channel[c], m);
    }

    // What the tape keeps of a segment, and the emitter sample of its probe.
    void put_flight(const Front<S, C> &front, const LaneSet<F> &lanes, uint32_t i, int depth) {
        VolumeColumns<S, C> &tape = this->level().volume;
        I medium = I(lanes.get(front.medium));
        M inside = lanes.active && mask<F>(medium >= 0);
        F length = lanes.get(flight_.length);
        // a segment may have no length and end with a collision all the same
        tape.put_flight(i, select(mask<I>(inside), medium, I(-1)), length);
        inside = inside && mask<F>(length > F(0));
        Color<F, C> beta = lanes.template color<C>(front.beta);
        if (chromatic_) tape.template put_weight<F>(i, lanes.template color<C>(flight_.weight));
        if (!any(inside)) return;
        Vec3<F> o = lanes.vec(front.o), d = lanes.vec(front.d);
        F probe = lanes.get(flight_.probe);
        if (emissive_) {
            F glow = lanes.get(flight_.glow);
            Color<F, C> one = uniform_color<C>(F(1));
            tape.template put_glow<F>(i, o + d * glow, mask<F>(glow > probe),
                                      chromatic_ ? lanes.template color<C>(flight_.glow_weight) : one,
                                      chromatic_ ? lanes.template color<C>(first_) : beta);
        }
        if (!probing_) return;
        Vec3<F> p = o + d * probe;
        tape.template put_probe<F>(i, p);
        U slot = lanes.get(front.slot), path_depth = lanes.get(front.depth);
        M may = inside && may_scatter(path_depth);
        if (!any(may)) return;
        if (chromatic_) beta = lanes.template color<C>(flight_.probe_weight);
        LaneSet<F> paths(slot, lanes.active);
        Random4<F> ue = draw4<F>(call_.config, paths.get(pixel), paths.get(sample),
                                 EmitterBlock + BlocksPerScattering * uint32_t(depth), 4);
        MediumScattering<F, C> s = no_medium_scattering<C, F>();
        for_each_distinct<F>(medium, may, [&](int32_t m, const M &same) {
            const MediumInfo &info = scene_.media[m];
            s.albedo = select(same, eval_volume<C>(scene_, scene_.values, info.albedo, p, same), s.albedo);
            sample_light(scene_, info, p, d, ue, same, s);
        });
        Color<F, C> scattered = beta * s.albedo;
        Color<F, C> contribution = scattered * s.emitted * (s.phase_light * s.light_weight);
        M lit = s.shadow_ray && is_finite(contribution) && mask<F>(max_channel(contribution) > F(0));
        push_shadow(p, s.light, contribution, medium, slot, U(i) + lane_index<F>(), ShadowPurpose::Probe, lit);
        choose_branch(front, lanes, i, p, d, length * max_channel(scattered), scattered, may);
    }

    void weigh_branches() {
        for (size_t s = 0; s < n_slots_; ++s)
            for (int c = 0; c < C; ++c) branch_beta_[c][s] *= total_weight_[s];
    }

    // The front of the paths that go on from probes, one a slot at most.
    void start_branches(Front<S, C> &front) {
        front.n = 0;
        for (size_t i = 0; i < n_slots_; i += W) {
            U slot = U(uint32_t(i)) + lane_index<F>();
            M active = mask<F>(slot < U(uint32_t(n_slots_))) && !mask<F>(load_uint<F>(chosen_level_ + i) == U(NoLevel));
            if (!any(active)) continue;
            Vec3<F> p = load_vec<F>(branch_o_, i), d = load_vec<F>(branch_d_, i);
            I medium = I(load_uint<F>(branch_medium_ + i));
            Random4<F> u = draw4<F>(call_.config, load_uint<F>(pixel + i), load_uint<F>(sample + i),
                                    BsdfBlock + BlocksPerScattering * (BranchLevel - 1), 3);
            Vec3<F> wo = d;
            F pdf(0);
            for_each_distinct<F>(medium, active, [&](int32_t m, const M &same) {
                const MediumInfo &info = scene_.media[m];
                wo = select(same, sample_phase(scene_, info.phase, p, d, u.u[0], u.u[1], u.u[2], same), wo);
                if (!info.enclosed) pdf = select(same, eval_phase(scene_, info.phase, p, d, wo, same), pdf);
            });
            Color<F, C> beta = load_color<F>(branch_beta_, i), channel = load_color<F>(branch_channel_, i);
            size_t at = front.n;
            this->append(front, {p, wo}, F(S(INFINITY)), p, pdf, beta, beta, F(1), slot, U(0u), U(1u), active);
            put_volumetric(front, at, medium, load_uint<F>(branch_depth_ + i), F(0), channel, active);
        }
    }

    // Keeps what the branches have brought, and makes room for the rest.
    void finish_branches() {
        for (int c = 0; c < C; ++c) {
            std::copy_n(radiance[c], n_slots_, branch_[c]);
            std::fill_n(radiance[c], n_slots_, S(0));
        }
    }

    BranchColumns<S, C> branches() const { return {chosen_level_, chosen_entry_, branch_}; }

    FlightColumns<S, C> flight_;
    bool chromatic_ = false, emissive_ = false, replaying_ = false;
    int first_level_ = 0;  // number of the tape's first level

private:
    // Entries whose medium is m, ascending.
    static size_t queue_of(const uint32_t *medium, size_t n, int32_t m, uint32_t *to) {
        size_t found = 0;
        for (size_t i = 0; i < n; ++i) {
            to[found] = uint32_t(i);
            found += medium[i] == uint32_t(m);
        }
        return found;
    }

    // Spectral MIS: throughput and the densities of the channels after the segment, whose mean stays one.
    void weigh_channels(Front<S, C> &front) {
        for (size_t i = 0; i < front.n; i += W) {
            M inside = mask<F>(I(load_uint<F>(front.medium + i)) >= 0);
            Color<F, C> p = load_color<F>(front.channel, i), beta = load_color<F>(front.beta, i);
            Color<F, C> survival = load_color<F>(front.survival, i);
            for (int c = 0; c < C; ++c) store(first_[c] + i, beta[c]);
            auto ratio = [&](S *const(&column)[C], Color<F, C> &weight) {
                F mean(0);
                for (int c = 0; c < C; ++c) {
                    weight[c] = select(inside, load<F>(column[c] + i), F(1));
                    mean = fmadd(p[c], weight[c], mean);
                }
                return F(C) / mean;
            };
            Color<F, C> w;
            F scale = ratio(flight_.weight, w);
            for (int c = 0; c < C; ++c) {
                F factor = select(inside, w[c] * scale, F(1));
                store(flight_.weight[c] + i, factor);
                store(front.beta[c] + i, beta[c] * factor);
                store(front.survival[c] + i, survival[c] * factor);
                store(front.channel[c] + i, p[c] * factor);
            }
            if (!probing_ && !emissive_) continue;
            scale = ratio(flight_.probe_weight, w);
            for (int c = 0; c < C; ++c) {
                store(flight_.probe_weight[c] + i, beta[c] * w[c] * scale);
                store(probe_channel_[c] + i, p[c] * w[c] * scale);
            }
            scale = ratio(flight_.glow_weight, w);
            for (int c = 0; c < C; ++c) store(flight_.glow_weight[c] + i, w[c] * scale);
        }
    }

    void add_emission(const Front<S, C> &front) {
        for (size_t i = 0; i < front.n; i += W) {
            M active = mask<F>(U(uint32_t(i)) + lane_index<F>() < U(uint32_t(front.n)));
            I medium = I(load_uint<F>(front.medium + i));
            F length = load<F>(flight_.length + i);
            active = active && mask<F>(medium >= 0) && mask<F>(length > F(0));
            for_each_distinct<F>(medium, active, [&](int32_t m, const M &same) {
                const MediumInfo &info = scene_.media[m];
                if (info.emission < 0) return;
                Vec3<F> p = load_vec<F>(front.o, i) + load_vec<F>(front.d, i) * load<F>(flight_.glow + i);
                Color<F, C> r = eval_volume<C>(scene_, scene_.values, info.emission, p, same) * length;
                for (int c = 0; c < C; ++c)
                    r[c] = r[c] * (chromatic_ ? load<F>(first_[c] + i) * load<F>(flight_.glow_weight[c] + i)
                                              : load<F>(front.beta[c] + i));
                add_to_slots<F>(radiance, load_uint<F>(front.slot + i), r, same);
            });
        }
    }

    // One of the path's segments, drawn in proportion to `weight` as they come by.
    void choose_branch(const Front<S, C> &front, const LaneSet<F> &lanes, uint32_t i, const Vec3<F> &p,
                       const Vec3<F> &d, const F &weight, const Color<F, C> &beta, const M &may) {
        if (replaying_) return;  // chosen when the path was traced first
        alignas(64) uint32_t slots[W], set[W], media[W], depths[W];
        alignas(64) S w[W], u[W], numbers[6][W], colors[2][C][W];
        store(&slots[0], lanes.get(front.slot));
        store(&set[0], select(mask<U>(may && mask<F>(weight > F(0))), U(1u), U(0u)));
        store(&media[0], lanes.get(front.medium));
        store(&depths[0], lanes.get(front.depth));
        store(&w[0], weight);
        store(&u[0], lanes.get(choice_));
        const F *from[6] = {&p.x, &p.y, &p.z, &d.x, &d.y, &d.z};
        for (int k = 0; k < 6; ++k) store(&numbers[k][0], *from[k]);
        for (int c = 0; c < C; ++c) {
            store(&colors[0][c][0], beta[c]);
            store(&colors[1][c][0], chromatic_ ? lanes.get(probe_channel_[c]) : F(1));
        }
        const uint32_t level = uint32_t(first_level_ + this->n_levels_ - 1);
        for (int l = 0; l < W; ++l) {
            if (!set[l]) continue;
            uint32_t s = slots[l];
            total_weight_[s] += w[l];
            if (!(u[l] * total_weight_[s] < w[l])) continue;
            chosen_level_[s] = level;
            chosen_entry_[s] = i + uint32_t(l);
            branch_medium_[s] = media[l];
            branch_depth_[s] = depths[l] + 1;
            for (int a = 0; a < 3; ++a) branch_o_[a][s] = numbers[a][l], branch_d_[a][s] = numbers[3 + a][l];
            for (int c = 0; c < C; ++c) {
                branch_beta_[c][s] = colors[0][c][l] / w[l];  // times the total weight, which is known at the end
                branch_channel_[c][s] = colors[1][c][l];
            }
        }
    }

    Arena paths_;
    // by slot
    uint32_t *hero_, *chosen_level_, *chosen_entry_, *branch_medium_, *branch_depth_;
    S *total_weight_, *branch_o_[3], *branch_d_[3], *branch_beta_[C], *branch_channel_[C], *branch_[C];
    // by entry of the front
    S *choice_, *first_[C], *probe_channel_[C];
};

}  // namespace tr
