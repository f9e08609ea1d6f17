// Samples of outlines that the camera sees, see core/boundary/sights.h: what is on both sides of them, of radiance or
// anything else (boundary_outputs.h).
#pragma once

#include "boundary_folds.h"
#include "core/adjoint/camera.h"
#include "core/boundary/sights.h"

namespace tr {

// Where the camera sees outlines, and what their motion adds to.
template <class F>
class SightTile : public BoundaryFolds<F> {
    using Base = BoundaryFolds<F>;
    using Base::path_call_, Base::view_;

protected:
    using Base::boundary_, Base::call_, Base::paths_, Base::scene_, Base::W;
    using typename Base::M, typename Base::Ray, typename Base::S, typename Base::U, typename Base::V;
    using Sight = tr::Sight<S>;
    const SightSamples<S> samples_{scene_, path_call_.config, view_};
    std::vector<Sight> sights_;
    std::vector<Ray> rays_;  // two for each, beside it
    std::vector<S> lengths_;

    // Samples `first` .. `first` + n of the call. look_up() sees along rays_ and tells by set_jump what is there.
    template <class LookUp>
    void run(uint64_t first, uint32_t n, GradientSink<F> &sink, LookUp &&look_up) {
        this->identify(first, n);
        find(n);
        look_past();
        jumps_.assign(sights_.size() * channels(), 0);
        look_up();
        if (boundary_.weighs)
            return this->tell_weights(
                first, sights_, [&](const Sight &x, int part, int c) { return jumps_of(x)[part * call_.values + c]; });
        auto &slots = paths_.slots;
        if (!sink.forward)
            return add(n, sink, [&](const Sight &x) {
                double adjoint[MostBoundaryChannels], sum = 0;
                this->collect(slots.film_x[x.slot], slots.film_y[x.slot], adjoint);
                for (size_t c = 0; c < channels(); ++c) sum += adjoint[c] * jumps_of(x)[c];
                return S(sum);
            });
        sink.component = 0;
        std::fill_n(slots.radiance[0], n, S(0));
        add(n, sink, [](const Sight &) { return S(1); });
        for (const Sight &x : sights_) {
            const uint64_t row = first + x.slot;
            boundary_.place[2 * row] = double(slots.film_x[x.slot]);
            boundary_.place[2 * row + 1] = double(slots.film_y[x.slot]);
            for (size_t c = 0; c < channels(); ++c)
                boundary_.value[channels() * row + c] = jumps_of(x)[c] * double(slots.radiance[0][x.slot]);
        }
    }
    // What is seen on the sides of -n and of n, in a channel.
    void set_jump(size_t sight, size_t channel, double minus, double plus) {
        jumps_[sight * channels() + channel] = samples_.jump(sights_[sight], minus, plus);
    }
    size_t channels() const { return size_t(boundary_.channels); }

public:
    SightTile(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const DerivativeCall<S> &derivative)
        : Base(call, boundary, derivative) {
        this->keep_lens(paths_.slots);
    }

private:
    std::vector<double> jumps_;

    const double *jumps_of(const Sight &x) const { return jumps_.data() + size_t(&x - sights_.data()) * channels(); }

    void find(uint32_t n) {
        sights_.clear(), rays_.clear(), lengths_.clear();
        if (boundary_.pieces->all.empty()) return;
        for (uint32_t k = 0; k < n; ++k) {
            const OutlineSample sample = this->sample_of(k);
            CameraSample<S> place = samples_.lens_of(sample);
            Sight x{};
            Ray beside[2];
            S length;
            if (!samples_.find(sample, place, x, beside, length)) continue;
            x.slot = k;
            this->keep_place(paths_.slots, k, place);
            for (const Ray &ray : beside) rays_.push_back(ray), lengths_.push_back(length);
            sights_.push_back(x);
        }
    }

    void look_past() {
        const bool some = call_.config.hide_emitters || call_.config.volumetric;
        auto passes = [&](uint32_t shape) { return some && samples_.lets_through(shape); };
        PathQueue<S> &queue = this->fill(rays_, [&](size_t k) { return lengths_[k]; });
        this->trace(queue, rays_.size(), true);
        pass_through(rays_of(queue), this->queries().hits, rays_.size(), passes,
                     [&] { this->trace(queue, rays_.size(), true); });
        this->keep_hits(rays_);
        this->wanted_.clear();
        for (uint32_t k = 0; k < sights_.size(); ++k) {
            if (!sights_[k].folded) continue;
            samples_.look_closer(sights_[k], &rays_[2 * k], lengths_[2 * k], this->want_both());
        }
        this->look_closer(passes, true);
        size_t kept = 0;
        for (size_t k = 0, i = 0; k < sights_.size(); ++k) {
            const Sight &x = sights_[k];
            Ray both[2] = {rays_[2 * k], rays_[2 * k + 1]};
            const size_t at = x.folded ? 2 * i++ : 0;
            if (!samples_.is_open(x, both, this->wanted_.data() + at, this->closer_.data() + at)) continue;
            for (size_t h = 0; h < 2; ++h) rays_[2 * kept + h] = both[h], lengths_[2 * kept + h] = lengths_[2 * k + h];
            sights_[kept++] = x;
        }
        sights_.resize(kept), rays_.resize(2 * kept), lengths_.resize(2 * kept);
    }

    template <class Weight>
    void add(uint32_t n, GradientSink<F> &sink, Weight &&weight) {
        const auto &o_bar = this->anchors_.p_bar, &d_bar = this->towards_.d;
        const V zero{S(0), S(0), S(0)};
        for (uint32_t k = 0; k < n; ++k) o_bar.set(k, zero), d_bar.set(k, zero);
        PointSink<F> points{sink};
        for (size_t k = 0; k < sights_.size(); ++k) {
            const Sight &x = sights_[k];
            const S w = weight(x);
            if (w == 0 || !std::isfinite(w)) continue;
            V of_origin, of_direction = zero;
            points.derivative = 0;
            samples_.add(x, &rays_[2 * k], w, points, this->glue_to(x.slot), of_origin, of_direction);
            o_bar.set(x.slot, of_origin), d_bar.set(x.slot, of_direction);
            if (sink.forward) paths_.slots.radiance[0][x.slot] += points.derivative;
        }
        this->sweep_glued(sink, paths_.slots);
        if (!paths_.wavefront.needs().camera) return;
        for (uint32_t i = 0; i < n; i += W) {
            Entries<F> from(i);
            const RayAdjoint<F> ray{from(o_bar), from(d_bar)};
            M active = mask<F>(lane_index<F>() < U(n - i)) && mask<F>(max_abs(ray.o) + max_abs(ray.d) > F(0));
            if (!any(active)) continue;
            sink.begin();
            const CameraSample<F> at = camera_sample<F>(path_call_.config, samples_.sensor(), paths_.slots, from);
            sweep_camera(scene_, samples_.sensor(), at, S(call_.film_width), S(call_.film_height), ray, F(0), active,
                         sink);
            if (sink.forward) add_to_entries<F>(paths_.slots.radiance, U(i) + lane_index<F>(), sink.derivative, active);
        }
    }
};

// Of radiance, or Stokes vectors, and coverage.
template <class F>
class SilhouetteTile : public SightTile<F> {
    using Base = SightTile<F>;
    using Base::call_, Base::light_, Base::paths_, Base::sights_, Base::rays_, Base::lengths_;

public:
    using Base::Base;

    void run(uint64_t first, uint32_t n, GradientSink<F> &sink, const Stop &stop) {
        Base::run(first, n, sink, [&] { look_up(stop); });
    }

private:
    void look_up(const Stop &stop) {
        using S = ScalarOf<F>;
        std::vector<S> pdf(rays_.size(), S(0));
        std::vector<uint32_t> key(rays_.size()), seen(rays_.size(), 0u);
        for (size_t i = 0; i < rays_.size(); ++i) key[i] = paths_.slots.pixel[sights_[i / 2].slot];
        BoundaryTile<F>::look_up(rays_, lengths_, pdf, key, seen, 0, !call_.config.hide_emitters, stop);
        light_.to_channels();
        for (int c = 0; c <= call_.numbers(); ++c) {
            const auto slots = this->of_part(light_.slots, c < call_.numbers() ? c / call_.values : 0);
            const S *values = c < call_.numbers() ? slots.radiance[c % call_.values] : slots.alpha.at;
            for (size_t k = 0; k < sights_.size(); ++k)
                this->set_jump(k, size_t(c), double(values[2 * k]), double(values[2 * k + 1]));
        }
    }
};

}  // namespace tr
