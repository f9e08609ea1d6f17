// Rays of a path queue that are in a medium whose index of refraction varies: what they meet, in place of what is met
// straight on, and the straight ray that would come to it in the same direction.
#pragma once

#include "arena.h"
#include "bent_rays.h"
#include "core/state/queues.h"

namespace tr {

template <class F>
class Bender {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using I = IntOf<F>;
    using M = MaskOf<F>;
    static constexpr uint32_t W = uint32_t(Lanes<F>::Width);

public:
    BentColumns<S> columns;  // by entry of the queue that was bent last
    // rays since these numbers were taken; of them given up: they bring nothing; that met another such medium
    uint64_t n = 0, lost = 0, met = 0;

    Bender(const SceneView<S> &scene, const Accel &accel, size_t capacity) : scene_(scene), accel_(accel) {
        arena_.declare([&](Arena &arena) {
            columns.for_arrays([&](auto *&array) { arena.array(array, capacity); });
            arena.array(order_, capacity);
        });
    }

    // Straight: rays that begin at a camera outside.
    void begin(PathQueue<S> &queue) { std::fill_n(queue.medium.at, queue.n, -1); }

    // Rays that bend meet nothing straight on.
    void hold(PathQueue<S> &queue) {
        for (uint32_t i = 0; i < queue.n; ++i)
            if (queue.medium[i] >= 0 && scene_.media[queue.medium[i]].flags & Bends) queue.length[i] = -1;
    }

    // waves(slots, lanes): the wavelengths of paths. `radiance`: null, or where the light that media emit is added, by
    // slot.
    template <class Waves>
    void run(const PathQueue<S> &queue, const HitColumns<S> &hits, Waves &&waves, const SpectrumColumn<S> *radiance) {
        std::fill_n(columns.medium.at, queue.n + W, -1);
        for (int32_t m = 0; m < scene_.n_media; ++m) {
            if (!(scene_.media[m].flags & Bends)) continue;
            uint32_t found = 0;
            for (uint32_t i = 0; i < queue.n; ++i)
                if (queue.medium[i] == m) order_[found++] = i;
            for (uint32_t k = 0; k < found; k += W) {
                LaneSet<F> lanes(order_ + k, found - k);
                U entry = U(order_[k]);
                entry = select(mask<U>(lanes.active), load_uint<F>(order_ + k), entry);
                const Wavelengths<F> at = waves(lanes(queue.slot), lanes.active);
                bend(scene_.bends[m], m, queue, hits, lanes, entry, at, radiance);
            }
        }
    }

private:
    const SceneView<S> &scene_;
    const Accel &accel_;
    Arena arena_;
    uint32_t *order_;

    void bend(const BendMedium<S> &medium, int32_t number, const PathQueue<S> &queue, const HitColumns<S> &hits,
              const LaneSet<F> &lanes, const U &entry, const Wavelengths<F> &waves, const SpectrumColumn<S> *radiance) {
        const M active = lanes.active;
        // surfaces count from where a straight ray would begin, which is a little off the one that it leaves
        const Vec3<F> from = lanes(queue.from), offset = lanes(queue.o) - from;
        const F index = local_index<F>(medium, from, active).n;
        const Vec3<F> u = transform_vector(medium.to_voxels, lanes(queue.d)) * (index * F(medium.step));
        const LightAlong<F> light{scene_, medium.light, waves};
        FlightEnd<F> end = fly<F>(medium, accel_, transform_point(medium.to_voxels, from), u, offset, active,
                                  medium.varies ? &light : nullptr);
        const M hit = active && !mask<F>(end.shape == U(BentTooLong)) && !mask<F>(end.shape == U(BentTooFar));
        n += uint64_t(count(active)), lost += uint64_t(count(active) - count(hit));

        const int bits = position_bits<F>(medium.field);
        const Vec3<F> o = transform_point(medium.to_world, position_of(end.state, bits)),
                      v = transform_vector(medium.to_world, velocity_of(end.state));
        const F speed = norm(v), inverse = F(1) / select(mask<F>(speed > F(0)), speed, F(1));
        SurfacePoint<F> at{select(mask<U>(hit), end.shape, U(0u)), select(mask<U>(hit), end.primitive, U(0u)), end.b1,
                           end.b2};
        const I behind = inner_medium<F>(scene_, at, hit);
        met += uint64_t(count(bends<F>(scene_, behind, hit) && !mask<F>(behind == I(number))));
        const Interaction<F> si = make_interaction(scene_, Ray<F>{o, v * inverse}, at, end.t * speed, hit);
        const F rest = si.t * inverse;
        const LocalIndex<F> at_end = local_index<F>(medium, si.p, hit);
        const F left = rest - F(S(0.5));  // the last kick is of what is left of it
        const Vec3<F> kick = symmetric_times<F>(medium.field.kick, at_end.slope) * left;
        const Vec3<F> d = normalize(v + transform_vector(medium.to_world, kick));
        const F length = (end.length + at_end.n * left) * F(medium.step);
        if (medium.varies)
            end.light.add(light, position_of(state_at(medium, si.p), bits), at_end.n, left, hit);
        else
            end.light.depth = light.extinction(si.p, hit) * length;

        auto number_to = [&](S *to, const F &x, const M &m) { scatter_lanes<F>(to, entry, x, m); };
        auto vector_to = [&](const VectorColumn<S> &to, const Vec3<F> &x) {
            number_to(to.x, x.x, hit), number_to(to.y, x.y, hit), number_to(to.z, x.z, hit);
        };
        vector_to(queue.o, si.p - d * si.t), vector_to(queue.d, d);
        vector_to(columns.q, {to_bits<F>(end.state.q[0]), to_bits<F>(end.state.q[1]), to_bits<F>(end.state.q[2])});
        vector_to(columns.u, {to_bits<F>(end.state.u[0]), to_bits<F>(end.state.u[1]), to_bits<F>(end.state.u[2])});
        number_to(columns.rest.at, rest, hit), number_to(hits.t.at, si.t, hit);
        number_to(columns.length.at, length, hit);
        number_to(hits.at.b1, end.b1, hit), number_to(hits.at.b2, end.b2, hit);
        scatter_lanes<F>(columns.steps.at, entry, U(end.steps), hit);
        scatter_lanes<F>(columns.medium.at, entry, I(number), hit);
        scatter_lanes<F>(hits.at.shape, entry, select(mask<U>(hit), end.shape, U(NoHit)), active);
        scatter_lanes<F>(hits.at.primitive, entry, end.primitive, hit);
        const Spectrum<F> none = uniform_spectrum(F(0)), kept = select(hit, transmittance<F>(end.light.depth), none);
        const Spectrum<F> begin = lanes(queue.beta), beta = begin * kept, survival = lanes(queue.survival) * kept;
        auto spectrum_to = [&](const SpectrumColumn<S> &to, const Spectrum<F> &x, const M &m) {
            for (int c = 0; c < SpectrumSize; ++c) scatter_lanes<F>(to[c], entry, x[c], m);
        };
        spectrum_to(queue.beta, beta, active), spectrum_to(queue.survival, survival, active);
        spectrum_to(columns.begin, begin, hit), spectrum_to(columns.depth, end.light.depth, hit);
        spectrum_to(columns.emitted, end.light.emitted, hit);
        if (radiance && light.emits()) add_to_entries<F>(*radiance, lanes(queue.slot), begin * end.light.emitted, hit);
    }
};

#define TR_ELSEWHERE(S) extern template class Bender<PacketOf<S>>;
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
