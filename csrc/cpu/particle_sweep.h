// The sweep over the tape of a tile of light paths, see core/adjoint/particle.h.
#pragma once

#include "core/adjoint/particle.h"
#include "tape_sweep.h"

namespace tr {

template <class F, int C>
class ParticleSweep : TapeSweep<F, C> {
    using Base = TapeSweep<F, C>;
    using Base::scene_, Base::derivative_, Base::levels_, Base::n_levels_, Base::paths_, Base::call_, Base::W;
    using typename Base::M;
    using typename Base::S;
    using typename Base::U;

public:
    ParticleSweep(const RenderCall<S> &call, const DerivativeCall<S> &derivative, typename Base::Levels &levels,
                  int n_levels, const typename Base::Paths &paths, const LightSensor<S> &sensor)
        : Base(call, derivative, levels, n_levels, paths), sensor_(sensor) {}

    template <class Sink>
    void run(Sink &sink) {
        for (int l = n_levels_ - 1; l >= 0; --l)
            for (const Segment &segment : levels_[size_t(l)]->segments)
                if (segment.kind == Segment::Emission)
                    sweep_emissions(segment, sink);
                else
                    dispatch(LeafBsdfs{}, segment.kind, [&](auto m) { sweep_segment<decltype(m)>(l, segment, sink); });
    }

private:
    template <class Model, class Sink>
    void sweep_segment(int number, const Segment &segment, Sink &sink) {
        TapeLevel<S, C> &level = *levels_[size_t(number)];
        const Wanted &wanted = this->wanted_;
        for (uint32_t i = segment.begin; i < segment.begin + segment.count; i += W) {
            M active = mask<F>(lane_index<F>() < U(segment.begin + segment.count - i));
            VertexRecord<F, C> v = level.template get<F>(i, true);
            ConnectionRecord<F> connection = level.light.template get<F>(i);
            M parallel(false);
            if (wanted.geometry) {
                level.template get_motion<F>(i, v);
                parallel = mask<F>(load_uint<F>(level.attached + i) == 2u);
            } else {
                v.d = VertexFrame<F>(vertex_frame(scene_, v), v.mirror).frame.to_world(v.wi) * F(-1);
                v.p = {F(0), F(0), F(0)};
            }
            sink.begin();
            HitAdjoint<F> hit;
            Vec3<F> d_bar{F(0), F(0), F(0)};
            const Color<F, C> &a = v.beta;
            Color<F, C> r = sweep_light_scattering<Model, C>(scene_, sensor_, v, connection, a,
                                                             level.template get_next<F>(i, wanted.geometry), wanted,
                                                             active, hit, d_bar, sink);
            TapeLevel<S, C> &parents = *levels_[size_t(level.parent_level)];
            this->hand_to_parent(parents, level.parent + i, r, active);
            if (wanted.geometry) {
                Arrival<F> in{v.attached, v.d, v.t, v.segment, d_bar, channel_sum(a * r), parallel};
                RayAdjoint<F> ray = sweep_surface(scene_, v.at, v.p, in, hit, active, sink);
                F squared = squared_norm(v.segment);
                auto glued = active && !v.attached && !parallel && mask<F>(squared > F(0));
                this->hand_motion(parents, level, i, ray, v.segment * select(glued, F(1) / squared, F(0)), active);
            }
            keep(level, i, sink, active);
        }
    }

    template <class Sink>
    void sweep_emissions(const Segment &segment, Sink &sink) {
        TapeLevel<S, C> &level = *levels_[0];
        const Wanted &wanted = this->wanted_;
        for (uint32_t i = segment.begin; i < segment.begin + segment.count; i += W) {
            M active = mask<F>(lane_index<F>() < U(segment.begin + segment.count - i));
            sink.begin();
            sweep_emission<C>(scene_, sensor_, level.template get_emission<F>(i),
                              level.template get_next<F>(i, wanted.geometry), wanted, active, sink);
            keep(level, i, sink, active);
        }
    }

    template <class Sink>
    void keep(const TapeLevel<S, C> &level, uint32_t i, Sink &sink, const M &active) {
        if constexpr (std::is_same_v<Sink, ForwardSink<F, C>>) {
            U slot = select(mask<U>(active), load_uint<F>(level.slot + i), U(0u));
            add_to_slots<F>(paths_.radiance, slot, sink.derivative, active);
        }
    }

    const LightSensor<S> &sensor_;
};

}  // namespace tr
