// The sweep over the tape of a tile from its end to its beginning: what core/adjoint/sweep.h says of a vertex, for all.
#pragma once

#include "checkpoints.h"
#include "core/adjoint/camera.h"
#include "render.h"

namespace tr {

template <class F, int C>
class TapeSweep {
protected:
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    static constexpr int W = Lanes<F>::Width;

public:
    struct InMedium {};  // in the place of a BSDF model
    using Levels = std::vector<std::unique_ptr<TapeLevel<S, C>>>;
    // Columns by slot of the tile: adjoint and derivative of a path's radiance, position on the film.
    struct Paths {
        S *const *delta, *const *radiance;
        const S *film_x, *film_y;
        size_t n;
        BranchColumns<S, C> branches{};
        int first_level = 0;                      // number of the tape's first level among all
        BlockBoundary<S, C> *boundary = nullptr;  // takes what that hands to the level before it
        const uint32_t *pixel = nullptr, *sample = nullptr;
    };

    TapeSweep(const RenderCall<S> &call, const DerivativeCall<S> &derivative, Levels &levels, int n_levels,
              const Paths &paths)
        : call_(call),
          scene_(*call.scene),
          derivative_(derivative),
          levels_(levels),
          n_levels_(n_levels),
          paths_(paths),
          wanted_(derivative.wanted) {
        if (wanted_.bsdf) wanted_.bsdfs = derivative.bsdf_wanted.data();
    }

    // `unit_adjoint`: the radiance itself is differentiated, in all channels. Adjoints of numbers are sums over
    // channels: in forward mode every channel then has a sweep of its own.
    template <class Sink>
    void run(Sink &sink, bool unit_adjoint) {
        if constexpr (std::is_same_v<Sink, ForwardSink<F, C>>) {
            if (derivative_.wanted.numbers()) {
                for (int channel = 0; channel < C; ++channel) {
                    for (int c = 0; c < C; ++c) std::fill_n(paths_.delta[c], paths_.n, S(c == channel ? 1 : 0));
                    sink.channel = channel;
                    sweep_levels(sink, false);
                }
                return;
            }
        }
        sweep_levels(sink, unit_adjoint);
    }

protected:
    template <class Sink>
    void sweep_levels(Sink &sink, bool unit_adjoint) {
        for (int l = n_levels_ - 1; l >= 0; --l) {
            TapeLevel<S, C> &level = *levels_[size_t(l)];
            for (const Segment &segment : level.segments)
                if (segment.kind == Segment::Collision)
                    sweep_segment<InMedium>(l, segment, sink, unit_adjoint);
                else if (segment.kind == Segment::Miss || !level.scatters)
                    sweep_segment<void>(l, segment, sink, unit_adjoint);
                else
                    dispatch(LeafBsdfs{}, segment.kind,
                             [&](auto m) { sweep_segment<decltype(m)>(l, segment, sink, unit_adjoint); });
        }
    }

    template <class Model, class Sink>
    void sweep_segment(int number, const Segment &segment, Sink &sink, bool unit_adjoint) {
        constexpr bool collision = std::is_same_v<Model, InMedium>;
        constexpr bool scattering = !std::is_void_v<Model> && !collision;
        TapeLevel<S, C> &level = *levels_[size_t(number)];
        const Wanted &wanted = wanted_;
        const bool volumetric = call_.config.volumetric;
        for (uint32_t i = segment.begin; i < segment.begin + segment.count; i += W) {
            M active = mask<F>(lane_index<F>() < U(segment.begin + segment.count - i));
            VertexRecord<F, C> v =
                collision ? level.template get_collision<F>(i) : level.template get<F>(i, scattering);
            FlightRecord<F, C> flight;
            if (volumetric) {
                flight = level.volume.template get<F>(i);
                for (int c = 0; c < C; ++c) v.through[c] = load<F>(level.volume.through[c] + i);
            }
            if (wanted.geometry) level.template get_motion<F>(i, v);
            U slot = select(mask<U>(active), load_uint<F>(level.slot + i), U(0u));
            Color<F, C> delta = uniform_color<C>(F(1));
            if (!unit_adjoint) {
                LaneSet<F> paths(slot, active);
                for (int c = 0; c < C; ++c) delta[c] = paths.get(paths_.delta[c]);
            }
            Color<F, C> a = v.beta * delta;
            sink.begin();
            HitAdjoint<F> hit;
            Vec3<F> d_bar{F(0), F(0), F(0)};
            Color<F, C> r = v.emission_radiance;
            M lit = active && mask<F>(v.emission_weight > F(0));
            if ((wanted.emitter || wanted.geometry) && any(lit))
                sweep_emitter(scene_, v.emission, v.d, a * v.emission_weight, wanted, lit, hit.at, d_bar, sink);
            if constexpr (scattering)
                r = r + sweep_scattering<Model, C>(scene_, v, a, level.template get_next<F>(i, wanted.geometry), wanted,
                                                   active, hit, d_bar, sink);
            if constexpr (collision)
                r = r + sweep_collision(scene_, v, flight.medium, a, level.template get_next<F>(i, false).radiance,
                                        wanted, active, sink);
            if (volumetric)
                r = sweep_flight<C>(scene_, flight, delta, v.beta, r,
                                    branch(paths_.first_level + number, i, slot, active), wanted.medium, active, sink);
            TapeLevel<S, C> *parents = level.parent_level >= 0 ? levels_[size_t(level.parent_level)].get() : nullptr;
            if (parents)
                hand_to_parent(*parents, level.parent + i, r, active);
            else if (level.parent_level == level.InBlockBefore)
                keep_for_parent(level.parent + i, r, active);
            if (wanted.geometry) {
                RayAdjoint<F> ray{{F(0), F(0), F(0)}, d_bar};
                Vec3<F> u{F(0), F(0), F(0)};
                if (segment.kind != Segment::Miss) {
                    Arrival<F> in{v.attached, v.d, v.t, v.segment, d_bar, channel_sum(a * r)};
                    ray = sweep_surface(scene_, v.at, v.p, in, hit, active, sink);
                    F squared = squared_norm(v.segment);
                    auto glued = active && !v.attached && mask<F>(squared > F(0));
                    u = v.segment * select(glued, F(1) / squared, F(0));
                }
                if (parents)
                    hand_motion(*parents, level, i, ray, u, active);
                else if (wanted.camera)
                    sweep_start(slot, ray, active, sink);
            }
            if constexpr (std::is_same_v<Sink, ForwardSink<F, C>>)
                add_to_slots<F>(paths_.radiance, slot, sink.derivative, active);
        }
    }

    template <class Sink>
    void sweep_start(const U &slot, const RayAdjoint<F> &ray, const M &active, Sink &sink) {
        const Record &record = scene_.sensors[call_.config.sensor];
        CameraSample<F> at{gather<F>(paths_.film_x, slot, active), gather<F>(paths_.film_y, slot, active)};
        if (uses_lens(record)) {
            LaneSet<F> paths(slot, active);
            at.choose_lens(draw4<F>(call_.config, paths.get(paths_.pixel), paths.get(paths_.sample), 0, 4));
        }
        sweep_camera(scene_, record, at, S(call_.film_width), S(call_.film_height), ray, F(0), active, sink);
    }

    // What the path that goes on from the probe of these segments has brought; 0 where there is none.
    Color<F, C> branch(int level, uint32_t i, const U &slot, const M &active) {
        Color<F, C> r = uniform_color<C>(F(0));
        const BranchColumns<S, C> &branches = paths_.branches;
        if (!branches.level) return r;
        auto active_u = mask<U>(active);
        M here = active && mask<F>(gather<U>(branches.level, slot, active_u) == U(uint32_t(level))) &&
                 mask<F>(gather<U>(branches.entry, slot, active_u) == U(i) + lane_index<F>());
        if (!any(here)) return r;
        for (int c = 0; c < C; ++c) r[c] = gather<F>(branches.radiance[c], slot, here);
        return r;
    }

    void hand_motion(TapeLevel<S, C> &parents, const TapeLevel<S, C> &level, uint32_t entry, const RayAdjoint<F> &ray,
                     const Vec3<F> &u, const M &active) {
        const F *numbers[9] = {&ray.o.x, &ray.o.y, &ray.o.z, &ray.d.x, &ray.d.y, &ray.d.z, &u.x, &u.y, &u.z};
        alignas(64) S v[9][W];
        for (int k = 0; k < 9; ++k) store(&v[k][0], *numbers[k]);
        uint32_t n = uint32_t(count(active));
        for (uint32_t i = 0; i < n; ++i) {
            uint32_t to = level.parent[entry + i], from = entry + i;
            for (int k = 0; k < 9; ++k) (k < 6 ? parents.ray_bar[k] : parents.next_segment[k - 6])[to] = v[k][i];
            for (int k = 0; k < 3; ++k) parents.next_p[k][to] = level.p[k][from];
            parents.next_b[0][to] = level.b1[from], parents.next_b[1][to] = level.b2[from];
            parents.next_shape[to] = level.shape[from], parents.next_primitive[to] = level.primitive[from];
        }
    }

    void keep_for_parent(const uint32_t *parent, const Color<F, C> &r, const M &active) {
        BlockBoundary<S, C> &to = *paths_.boundary;
        size_t n = size_t(count(active)), before = to.parent.size();
        to.parent.insert(to.parent.end(), parent, parent + n);
        alignas(64) S v[W];
        for (int c = 0; c < C; ++c) {
            store(&v[0], r[c]);
            to.radiance[c].resize(before + n);
            std::copy_n(v, n, &to.radiance[c][before]);
        }
    }

    // every entry has at most one child
    void hand_to_parent(TapeLevel<S, C> &parents, const uint32_t *parent, const Color<F, C> &r, const M &active) {
        alignas(64) S v[C][W];
        for (int c = 0; c < C; ++c) store(&v[c][0], r[c]);
        int n = count(active);  // active lanes come first
        for (int i = 0; i < n; ++i)
            for (int c = 0; c < C; ++c) parents.suffix[c][parent[i]] = v[c][i];
    }

    const RenderCall<S> &call_;
    const SceneView<S> &scene_;
    const DerivativeCall<S> &derivative_;
    Levels &levels_;
    int n_levels_;
    Paths paths_;
    Wanted wanted_;
};

}  // namespace tr
