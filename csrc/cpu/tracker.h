// Segments of many rays through media: free flight to the next collision, and transmittance. The rays of one medium
// wait in a queue; a packet works on as many as it has lanes, and a lane whose ray is done takes the next one.
#pragma once

#include "columns.h"
#include "core/medium/tracking.h"

namespace tr {

// Columns by entry. In: the ray up to `end` (from `lag` before its origin), seeds of its random numbers, and the
// channel that distances are sampled for. Out: where the medium begins, the length of the segment in it, whether it
// ends with a collision. Coloured extinction: `weight`, see core/medium/tracking.h. Two points uniform on the segment
// where they are asked for, `probe` for derivatives and `glow` for emission, as distances, with the weights up to
// there.
template <class S, int C>
struct FlightColumns {
    Arena arena;
    S *end, *start, *length, *weight[C];
    S *probe, *probe_weight[C], *glow, *glow_weight[C];
    uint32_t *seed[2], *hero, *collided;

    void allocate(size_t n) {
        arena.allocate([&](Arena &a) {
            for (S **p : {&end, &start, &length, &probe, &glow}) a.column(*p, n);
            for (auto *p : {&weight, &probe_weight, &glow_weight}) a.column(*p, n);
            a.column(seed, n);
            for (uint32_t **p : {&hero, &collided}) a.column(*p, n);
        });
    }
};

// In: seeds. Out: transmittance, which multiplies what is there; the medium's part of the ray.
template <class S, int C>
struct TransmittanceColumns {
    const S *end, *lag;
    const uint32_t *const *seed;
    S *const *transmittance;
    S *start, *length;
};

template <class F, int C>
class Tracker {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using I = IntOf<F>;
    using M = MaskOf<F>;
    static constexpr int W = Lanes<F>::Width;

public:
    explicit Tracker(const SceneView<S> &scene) : scene_(scene) {}

    // The entries `order`[0 .. n), ascending, with rays in the columns o and d, are in the medium.
    void fly(int32_t medium, S *const (&o)[3], S *const (&d)[3], const S *lag, FlightColumns<S, C> &at,
             const uint32_t *order, size_t n, bool probes) {
        const MediumInfo &m = scene_.media[medium];
        const bool colored = is_colored(m);
        FlightSink sink{at, probes};
        if (!(m.flags & IsGrid)) return fly_constant(m, lag, at, order, n, colored, probes);
        if (colored)
            walk<C>(m, o, d, lag, at.end, at.seed, order, n, sink);
        else
            walk<1>(m, o, d, lag, at.end, at.seed, order, n, sink);
    }

    void transmit(int32_t medium, S *const (&o)[3], S *const (&d)[3], const TransmittanceColumns<S, C> &at,
                  const uint32_t *order, size_t n) {
        const MediumInfo &m = scene_.media[medium];
        if (!(m.flags & IsGrid)) return transmit_constant(m, at, order, n);
        TransmittanceSink sink{at};
        if (is_colored(m))
            walk<C>(m, o, d, at.lag, at.end, at.seed, order, n, sink);
        else
            walk<1>(m, o, d, at.lag, at.end, at.seed, order, n, sink);
    }

    uint64_t collisions = 0;  // tentative ones
    uint64_t exceeded = 0;    // of them with an extinction above the majorant: there must be none

private:
    const SceneView<S> &scene_;

    static bool is_colored(const MediumInfo &medium) { return C > 1 && (medium.flags & IsChromatic); }

    // The state of the lanes of a packet.
    template <int N>
    struct State {
        MajorantWalk<F, S> walk;
        TrackingRandom<F> random;
        F depth;  // what is left of the optical depth
        Color<F, N> weight;
        U entry;
        I hero;
        F last, probe, glow;  // reservoirs of coloured segments
        Color<F, N> probe_weight, glow_weight;
    };

    // Deterministic packets: what happens to a lane depends on its own entry alone.
    template <int N, class Sink>
    void walk(const MediumInfo &medium, S *const (&o)[3], S *const (&d)[3], const S *lag, const S *length,
              const uint32_t *const *seed, const uint32_t *order, size_t n, Sink &sink) {
        State<N> s;
        clear(s);
        M walking(false), stopped(false);
        alignas(64) uint32_t entries[W] = {}, busy[W] = {};
        size_t taken = 0;
        for (;;) {
            M idle = !(walking || stopped);
            if (taken < n && (W == 1 || count(idle) * 4 >= W || !any(walking || stopped))) {
                store(&busy[0], select(mask<U>(idle), U(0u), U(1u)));
                alignas(64) uint32_t is_fresh[W] = {};
                for (int i = 0; i < W && taken < n; ++i)
                    if (!busy[i]) entries[i] = order[taken++], is_fresh[i] = 1;
                M fresh = mask<F>(load_uint<F>(is_fresh) != U(0u));
                s.entry = load_uint<F>(entries);
                auto get = [&](const S *column) { return gather<F>(column, s.entry, fresh); };
                Vec3<F> from{get(o[0]), get(o[1]), get(o[2])}, along{get(d[0]), get(d[1]), get(d[2])};
                F ahead = get(lag);
                M meets = s.walk.start(scene_, medium, from - along * ahead, along, get(length) + ahead, fresh);
                s.walk.enter = select(fresh, s.walk.enter - ahead, s.walk.enter);
                auto fresh_u = mask<U>(fresh);
                s.random.a = select(fresh_u, gather<U>(seed[0], s.entry, fresh_u), s.random.a);
                s.random.b = select(fresh_u, gather<U>(seed[1], s.entry, fresh_u), s.random.b);
                s.depth = select(fresh, optical_depth(s.random.next(fresh)), s.depth);
                sink.begin(s, fresh);
                M apart = fresh && !meets;
                if (any(apart)) sink.finish(s, apart, M(false));
                walking = walking || meets;
            }
            if (!any(walking || stopped)) {
                if (taken >= n) return;
                continue;
            }
            M left(false);
            do {
                s.walk.advance(scene_, medium, s.depth, walking, stopped, left);
            } while (W > 1 ? count(walking) > count(stopped) && count(left) * 4 < W : any(walking));
            if (any(left)) sink.finish(s, left, M(false));
            // tentative collisions, once they are most of what is left to do
            if (any(stopped) && (count(stopped) * 2 >= count(walking || stopped))) {
                collisions += uint64_t(count(stopped));
                Color<F, N> sigma = grid_extinction<N>(scene_, medium, s.walk.local(), stopped);
                M above = stopped && mask<F>(max_channel(sigma) > s.walk.majorant);
                if (any(above)) exceeded += uint64_t(count(above));
                M goes_on = sink.collide(s, sigma, stopped);
                s.depth = select(goes_on, optical_depth(s.random.next(goes_on)), s.depth);
                walking = walking || goes_on;
                stopped = M(false);
            }
        }
    }

    template <int N>
    static void clear(State<N> &s) {
        F zero(0);
        Vec3<F> none{zero, zero, zero};
        s.walk.o = s.walk.d = none;
        for (F *p : {&s.walk.enter, &s.walk.t, &s.walk.end, &s.walk.majorant, &s.depth, &s.last, &s.probe, &s.glow})
            *p = zero;
        for (int k = 0; k < 3; ++k) s.walk.border[k] = s.walk.width[k] = zero, s.walk.at[k] = s.walk.step[k] = I(0);
        s.random.a = s.random.b = s.entry = U(0u);
        s.hero = I(0);
        s.weight = s.probe_weight = s.glow_weight = uniform_color<N>(F(1));
    }

    template <int N>
    static F of_channel(const Color<F, N> &color, const I &channel) {
        F r = color[0];
        for (int c = 1; c < N; ++c) r = select(mask<F>(channel == c), color[c], r);
        return r;
    }
    static TR_INLINE void put(S *column, const U &entry, const F &value, const M &where) {
        scatter_lanes<F>(column, entry, value, where);
    }

    // Delta tracking.
    struct FlightSink {
        FlightColumns<S, C> &at;
        bool probes;

        template <int N>
        TR_INLINE void begin(State<N> &s, const M &fresh) {
            if constexpr (N > 1) {
                s.hero = select(mask<I>(fresh), I(gather<U>(at.hero, s.entry, mask<U>(fresh))), s.hero);
                for (Color<F, N> *w : {&s.weight, &s.probe_weight, &s.glow_weight})
                    *w = select(fresh, uniform_color<N>(F(1)), *w);
                for (F *p : {&s.last, &s.probe, &s.glow}) *p = select(fresh, F(0), *p);
            }
        }
        // Returns the lanes whose collision was with nothing.
        template <int N>
        TR_INLINE M collide(State<N> &s, const Color<F, N> &sigma, const M &stopped) {
            F sampled = of_channel(sigma, s.hero);
            M real = stopped && mask<F>(s.random.next(stopped) * s.walk.majorant < sampled);
            M goes_on = stopped && !real;
            if constexpr (N > 1) {
                if (probes) reserve(s, stopped);
                F here = F(1) / select(real, sampled, F(1));
                F nothing = F(1) / select(goes_on, s.walk.majorant - sampled, F(1));
                for (int c = 0; c < N; ++c) {
                    F ratio = select(real, sigma[c] * here, (s.walk.majorant - sigma[c]) * nothing);
                    s.weight[c] = select(stopped, s.weight[c] * ratio, s.weight[c]);
                }
            }
            if (any(real)) finish(s, real, real);
            return goes_on;
        }
        template <int N>
        TR_INLINE void finish(State<N> &s, const M &done, const M &collided) {
            F length = min(s.walk.t, s.walk.end);
            put(at.start, s.entry, s.walk.enter, done);
            put(at.length, s.entry, length, done);
            scatter_lanes<F>(at.collided, s.entry, select(mask<U>(collided), U(1u), U(0u)), done);
            if constexpr (N > 1) {
                if (probes && !any(collided)) reserve(s, done);
                for (int c = 0; c < C; ++c) put(at.weight[c], s.entry, s.weight[c], done);
                if (!probes) return;
                put(at.probe, s.entry, s.walk.enter + s.probe, done);
                put(at.glow, s.entry, s.walk.enter + s.glow, done);
                for (int c = 0; c < C; ++c) {
                    put(at.probe_weight[c], s.entry, s.probe_weight[c], done);
                    put(at.glow_weight[c], s.entry, s.glow_weight[c], done);
                }
            } else if (probes) {
                put(at.probe, s.entry, s.walk.enter + s.random.next(done) * length, done);
                put(at.glow, s.entry, s.walk.enter + s.random.next(done) * length, done);
            }
        }

    private:
        // Points uniform on the segment so far: the stretch since the last collision takes the place of the old point
        // with the share that it has of the whole; weights are constant along it.
        template <int N>
        TR_INLINE void reserve(State<N> &s, const M &where) {
            F t = min(s.walk.t, s.walk.end);
            F *points[2] = {&s.probe, &s.glow};
            Color<F, N> *weights[2] = {&s.probe_weight, &s.glow_weight};
            for (int k = 0; k < 2; ++k) {
                F position = t - s.random.next(where) * t;  // uniform in (0, t]: kept where it is in the new stretch
                M take = where && mask<F>(position > s.last);
                *points[k] = select(take, position, *points[k]);
                *weights[k] = select(take, s.weight, *weights[k]);
            }
            s.last = select(where, t, s.last);
        }
    };

    // Ratio tracking; a ray that brings little is ended by roulette.
    struct TransmittanceSink {
        const TransmittanceColumns<S, C> &at;

        template <int N>
        TR_INLINE void begin(State<N> &s, const M &fresh) {
            s.weight = select(fresh, uniform_color<N>(F(1)), s.weight);
        }
        template <int N>
        TR_INLINE M collide(State<N> &s, const Color<F, N> &sigma, const M &stopped) {
            F inverse = F(1) / select(stopped, s.walk.majorant, F(1)), largest(0);
            for (int c = 0; c < N; ++c) {
                s.weight[c] = select(stopped, s.weight[c] * max(F(1) - sigma[c] * inverse, F(0)), s.weight[c]);
                largest = max(largest, s.weight[c]);
            }
            M small = stopped && mask<F>(largest < F(0.1));
            if (!any(small)) return stopped;
            F keep = select(mask<F>(largest > F(0)), max(largest * F(4), F(0.05)), F(0));
            M lost = small && mask<F>(s.random.next(small) >= keep);
            M survives = small && !lost;
            F up = F(1) / select(survives, keep, F(1));
            for (int c = 0; c < N; ++c)
                s.weight[c] = select(lost, F(0), select(survives, s.weight[c] * up, s.weight[c]));
            if (any(lost)) finish(s, lost, lost);
            return stopped && !lost;
        }
        template <int N>
        TR_INLINE void finish(State<N> &s, const M &done, const M &) {
            for (int c = 0; c < C; ++c) {
                F old = gather<F>(at.transmittance[c], s.entry, done);
                put(at.transmittance[c], s.entry, old * s.weight[N == 1 ? 0 : c], done);
            }
            // the whole way through the grid, whether or not it was walked
            put(at.start, s.entry, s.walk.enter, done);
            put(at.length, s.entry, s.walk.end, done);
        }
    };

    Color<F, C> constant_extinction(const MediumInfo &medium) const {
        const S *value = scene_.values.constants + scene_.volumes[medium.extinction].field[ConstantVolume::Value];
        Color<F, C> r;
        for (int c = 0; c < C; ++c) r[c] = F(value[c] * scene_.values.constants[medium.scale]);
        return r;
    }

    void fly_constant(const MediumInfo &medium, const S *lag, FlightColumns<S, C> &at, const uint32_t *order, size_t n,
                      bool colored, bool probes) {
        Color<F, C> sigma = constant_extinction(medium);
        for (size_t i = 0; i < n; i += W) {
            LaneSet<F> lanes(order + i, uint32_t(n - i));
            const M &m = lanes.active;
            U entry = load_entries(order + i, lanes);
            TrackingRandom<F> random{lanes.get(at.seed[0]), lanes.get(at.seed[1])};
            I hero = colored ? I(lanes.get(at.hero)) : I(0);
            F ahead = lanes.get(lag), sampled = of_channel(sigma, hero), end = lanes.get(at.end) + ahead;
            M some = mask<F>(sampled > F(0));
            F t = select(some, optical_depth(random.next(m)) / select(some, sampled, F(1)), F(S(INFINITY)));
            M collides = m && mask<F>(t < end);
            F length = select(collides, t, end);
            M endless = !mask<F>(length < F(S(1e30)));  // through nothing
            length = select(endless, F(0), length);
            put(at.start, entry, -ahead, m);
            put(at.length, entry, length, m);
            scatter_lanes<F>(at.collided, entry, select(mask<U>(collides), U(1u), U(0u)), m);
            F probe = random.next(m) * length, glow = random.next(m) * length;
            if (probes) {
                put(at.probe, entry, probe - ahead, m);
                put(at.glow, entry, glow - ahead, m);
            }
            if (!colored) continue;
            F inverse = F(1) / select(collides, sampled, F(1));
            for (int c = 0; c < C; ++c) {
                F more = sigma[c] - sampled;
                F fading = select(endless && mask<F>(more > F(0)), F(0), exp(-more * length));
                put(at.weight[c], entry, select(collides, fading * sigma[c] * inverse, fading), m);
                if (!probes) continue;
                put(at.probe_weight[c], entry, exp(-more * probe), m);
                put(at.glow_weight[c], entry, exp(-more * glow), m);
            }
        }
    }

    void transmit_constant(const MediumInfo &medium, const TransmittanceColumns<S, C> &at, const uint32_t *order,
                           size_t n) {
        Color<F, C> sigma = constant_extinction(medium);
        for (size_t i = 0; i < n; i += W) {
            LaneSet<F> lanes(order + i, uint32_t(n - i));
            U entry = load_entries(order + i, lanes);
            F ahead = lanes.get(at.lag), end = lanes.get(at.end) + ahead;
            M near = mask<F>(end < F(S(1e30)));
            for (int c = 0; c < C; ++c) {
                F through = select(near, exp(-sigma[c] * select(near, end, F(0))),
                                   select(mask<F>(sigma[c] > F(0)), F(0), F(1)));
                put(at.transmittance[c], entry, lanes.get(at.transmittance[c]) * through, lanes.active);
            }
            put(at.start, entry, -ahead, lanes.active);
            put(at.length, entry, select(near, end, F(0)), lanes.active);
        }
    }

    static U load_entries(const uint32_t *order, const LaneSet<F> &lanes) {
        return select(mask<U>(lanes.active), load_uint<F>(order), U(order[0]));
    }
};

}  // namespace tr
