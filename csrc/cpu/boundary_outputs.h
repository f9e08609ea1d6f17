// What the motion of outlines adds to outputs besides radiance. These are averages over the samples that hit something,
//
//     O = N / D,  N = integral of |h| v,  D = integral of |h| where there is something,  dO = (dN - O dD) / D,
//
// so that a place on the film gets the channels of v, zero where there is nothing, and in a last one whether there is.
#pragma once

#include "boundary_seen.h"

namespace tr {

template <class F>
class OutputTile : public SightTile<F> {
    using Base = SightTile<F>;
    using Base::boundary_, Base::call_, Base::paths_, Base::scene_, Base::sights_, Base::rays_, Base::W;
    using typename Base::M, typename Base::Ray, typename Base::S, typename Base::Sight, typename Base::U,
        typename Base::V;

    AovContext<F> context_;
    std::vector<S> value_;  // a column a channel, by ray

public:
    OutputTile(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const DerivativeCall<S> &derivative)
        : Base(call, boundary, derivative),
          context_(*call.scene, *boundary.layout, call.config.sensor, S(call.film_width), S(call.film_height)) {}

    void run(uint64_t first, uint32_t n, GradientSink<F> &sink, const Stop &) {
        Base::run(first, n, sink, [&] { look_up(); });
    }

private:
    void look_up() {
        const int channels = boundary_.layout->n;
        const size_t rows = rays_.size() + W;
        value_.assign(size_t(channels) * rows, S(0));
        for (size_t i = 0; i < rays_.size(); i += W) evaluate(i, value_.data() + i, rows);
        for (size_t k = 0; k < sights_.size(); ++k) {
            for (size_t c = 0; c < size_t(channels); ++c) {
                const S *v = value_.data() + c * rows + 2 * k;
                this->set_jump(k, c, double(v[0]), double(v[1]));
            }
            this->set_jump(k, size_t(channels), is_hit(2 * k), is_hit(2 * k + 1));
        }
    }
    bool is_hit(size_t ray) const { return rays_[ray].at.shape != NoHit; }

    // The channels of a packet of rays from number i on, columns of so many rows.
    void evaluate(size_t i, S *to, size_t rows) {
        struct Numbers {
            alignas(64) S at[W] = {};
        };
        struct Vectors {
            Numbers x, y, z;
            void set(size_t k, const V &v) { x.at[k] = v.x, y.at[k] = v.y, z.at[k] = v.z; }
            Vec3<F> load() const { return {tr::load<F>(x.at), tr::load<F>(y.at), tr::load<F>(z.at)}; }
        };
        Numbers film[2], lens[2], b1, b2, t;
        Vectors o, d, first, center;
        alignas(64) uint32_t shape[W] = {}, primitive[W] = {}, pixel[W] = {}, sample[W] = {}, hit[W] = {};
        const size_t n = std::min(size_t(W), rays_.size() - i);
        const auto &slots = paths_.slots;
        for (size_t k = 0; k < n; ++k) {
            const Ray &ray = rays_[i + k];
            const Sight &sight = sights_[(i + k) / 2];
            CameraSample<S> place = this->samples_.lens_of(this->sample_of(sight.slot));
            if (slots.lens.x) place.lens_x = slots.lens.x[sight.slot], place.lens_y = slots.lens.y[sight.slot];
            film[0].at[k] = slots.film_x[sight.slot], film[1].at[k] = slots.film_y[sight.slot];
            lens[0].at[k] = place.lens_x, lens[1].at[k] = place.lens_y;
            o.set(k, ray.met_from), d.set(k, ray.d), first.set(k, ray.o);
            center.set(k, ray.o + ray.d * (sight.t - sight.distance));
            pixel[k] = slots.pixel[sight.slot], sample[k] = slots.sample[sight.slot];
            if (!is_hit(i + k)) continue;
            hit[k] = 1, shape[k] = ray.at.shape, primitive[k] = ray.at.primitive;
            b1.at[k] = ray.at.b1, b2.at[k] = ray.at.b2, t.at[k] = ray.t;
        }
        const M active = mask<F>(load_uint<F>(hit) != U(0u));
        if (!any(active)) return;
        const auto number = [](const Numbers &from) { return load<F>(from.at); };
        FirstHit<F> seen{{number(film[0]), number(film[1]), number(lens[0]), number(lens[1])},
                         {o.load(), d.load()},
                         first.load(),
                         center.load(),
                         {},
                         {call_.config, load_uint<F>(pixel), load_uint<F>(sample)}};
        const SurfacePoint<F> at{load_uint<F>(shape), load_uint<F>(primitive), number(b1), number(b2)};
        seen.si = make_interaction<F>(scene_, seen.ray, at, number(t), active);
        F v[MaxAovChannels];
        eval_aovs(context_, seen, active, v);
        for (int c = 0; c < boundary_.layout->n; ++c) store(to + size_t(c) * rows, select(active, v[c], F(0)));
    }
};

}  // namespace tr
