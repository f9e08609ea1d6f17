// What becomes of rays in one medium: free flight by delta tracking, transmittance by ratio tracking; in constant media
// both in closed form. A grid's rays walk from one tentative collision to the next, lane by lane, each on its own; who
// schedules them (cpu/tracker.h) calls begin, collide and finish.
#pragma once

#include <initializer_list>

#include "../state/queues.h"
#include "tracking.h"

namespace tr {

// Rays by entry.
template <class S>
struct TrackedQueue {
    VectorColumn<S> o, d;
    NumberColumn<S> ray_offset;  // they begin before their origins
    IndexColumn<S> slot;         // of their paths
};

// A ray in a grid: N components of the extinction matter, 1 or those of the spectrum.
template <class F, int N>
struct TrackedRay {
    MajorantWalk<F, ScalarOf<F>> walk;
    TrackingRandom<F> random;
    F depth;  // what is left of the optical depth
    Spectrum<F, N> weight;
    UIntOf<F> entry;
    IntOf<F> hero;
    F last, differential, emission;  // reservoirs of coloured segments
    Spectrum<F, N> differential_weight, emission_weight;

    TR_INLINE TrackedRay() {
        F zero(0);
        Vec3<F> none{zero, zero, zero};
        walk.o = walk.d = none;
        for (F *p : {&walk.enter, &walk.t, &walk.end, &walk.majorant, &depth, &last, &differential, &emission})
            *p = zero;
        for (int k = 0; k < 3; ++k) {
            walk.border[k] = walk.width[k] = zero;
            walk.at[k] = walk.step[k] = IntOf<F>(0);
        }
        random.a = random.b = entry = UIntOf<F>(0u);
        hero = IntOf<F>(0);
        weight = differential_weight = emission_weight = uniform_spectrum<N>(F(1));
    }

    // Takes the rays `entry` in the lanes of `fresh`; returns those that meet the grid, the others are finished.
    template <class S, class Columns, class Estimator>
    TR_INLINE MaskOf<F> start(const SceneView<S> &scene, const MediumInfo &medium, const TrackedQueue<S> &rays,
                              const Columns &at, const Estimator &estimator, const MaskOf<F> &fresh) {
        using U = UIntOf<F>;
        Gathered<F> from(entry, fresh);
        Vec3<F> origin = from(rays.o), along = from(rays.d);
        F ahead = from(rays.ray_offset);
        MaskOf<F> meets = walk.start(scene, medium, origin - along * ahead, along, from(at.end) + ahead, fresh);
        walk.enter = select(fresh, walk.enter - ahead, walk.enter);
        random.a = select(mask<U>(fresh), from(at.seed_a), random.a);
        random.b = select(mask<U>(fresh), from(at.seed_b), random.b);
        depth = select(fresh, optical_depth(random.next(fresh)), depth);
        estimator.begin(*this, fresh);
        MaskOf<F> apart = fresh && !meets;
        if (any(apart)) estimator.finish(*this, apart, MaskOf<F>(false));
        return meets;
    }

    // Tentative collisions; returns the lanes that walk on. `above`: where the extinction is above the majorant.
    template <class S, class Estimator>
    TR_INLINE MaskOf<F> collide(const SceneView<S> &scene, const MediumInfo &medium, const Estimator &estimator,
                                const MaskOf<F> &stopped, MaskOf<F> &above) {
        Spectrum<F, N> sigma = grid_extinction<N>(scene, medium, walk.local(), stopped);
        above = stopped && mask<F>(max_component(sigma) > walk.majorant);
        MaskOf<F> goes_on = estimator.collide(*this, sigma, stopped);
        depth = select(goes_on, optical_depth(random.next(goes_on)), depth);
        return goes_on;
    }
};

template <class F, int N>
TR_INLINE F component(const Spectrum<F, N> &spectrum, const IntOf<F> &index) {
    F r = spectrum[0];
    for (int c = 1; c < N; ++c) r = select(mask<F>(index == c), spectrum[c], r);
    return r;
}

template <class F, class S>
TR_INLINE void put(const NumberColumn<S> &column, const UIntOf<F> &entry, const F &value, const MaskOf<F> &where) {
    scatter_lanes<F>(column.at, entry, value, where);
}

// Delta tracking. `points`: those uniform on the segment are asked for.
template <class F>
struct FlightEstimator {
    using S = ScalarOf<F>;
    using M = MaskOf<F>;
    const FlightColumns<S> &at;
    bool points;

    template <int N>
    TR_INLINE void begin(TrackedRay<F, N> &s, const M &fresh) const {
        if constexpr (N > 1) {
            Gathered<F> from(s.entry, fresh);
            s.hero = select(mask<IntOf<F>>(fresh), IntOf<F>(from(at.hero)), s.hero);
            for (Spectrum<F, N> *w : {&s.weight, &s.differential_weight, &s.emission_weight})
                *w = select(fresh, uniform_spectrum<N>(F(1)), *w);
            for (F *p : {&s.last, &s.differential, &s.emission}) *p = select(fresh, F(0), *p);
        }
    }
    // Returns the lanes whose collision was with nothing.
    template <int N>
    TR_INLINE M collide(TrackedRay<F, N> &s, const Spectrum<F, N> &sigma, const M &stopped) const {
        F sampled = component(sigma, s.hero);
        M real = stopped && mask<F>(s.random.next(stopped) * s.walk.majorant < sampled);
        M goes_on = stopped && !real;
        if constexpr (N > 1) {
            if (points) take_points(s, stopped);
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
    TR_INLINE void finish(TrackedRay<F, N> &s, const M &done, const M &collided) const {
        using U = UIntOf<F>;
        F length = min(s.walk.t, s.walk.end);
        put(at.start, s.entry, s.walk.enter, done);
        put(at.length, s.entry, length, done);
        scatter_lanes<F>(at.collided.at, s.entry, select(mask<U>(collided), U(1u), U(0u)), done);
        if constexpr (N > 1) {
            if (points && !any(collided)) take_points(s, done);
            for (int c = 0; c < N; ++c) scatter_lanes<F>(at.weight[c], s.entry, s.weight[c], done);
            if (!points) return;
            put(at.differential, s.entry, s.walk.enter + s.differential, done);
            put(at.emission, s.entry, s.walk.enter + s.emission, done);
            for (int c = 0; c < N; ++c) {
                scatter_lanes<F>(at.differential_weight[c], s.entry, s.differential_weight[c], done);
                scatter_lanes<F>(at.emission_weight[c], s.entry, s.emission_weight[c], done);
            }
        } else if (points) {
            put(at.differential, s.entry, s.walk.enter + s.random.next(done) * length, done);
            put(at.emission, s.entry, s.walk.enter + s.random.next(done) * length, done);
        }
    }

private:
    // Points uniform on the segment so far: the stretch since the last collision takes the place of the old point with
    // the share that it has of the whole; weights are constant along it.
    template <int N>
    TR_INLINE void take_points(TrackedRay<F, N> &s, const M &where) const {
        F t = min(s.walk.t, s.walk.end);
        F *place[2] = {&s.differential, &s.emission};
        Spectrum<F, N> *weight[2] = {&s.differential_weight, &s.emission_weight};
        for (int k = 0; k < 2; ++k) {
            F position = t - s.random.next(where) * t;  // uniform in (0, t]: kept where it is in the new stretch
            M take = where && mask<F>(position > s.last);
            *place[k] = select(take, position, *place[k]);
            *weight[k] = select(take, s.weight, *weight[k]);
        }
        s.last = select(where, t, s.last);
    }
};

// Ratio tracking; a ray that brings little is ended by roulette.
template <class F>
struct TransmittanceEstimator {
    using S = ScalarOf<F>;
    using M = MaskOf<F>;
    const TransmittanceColumns<S> &at;

    template <int N>
    TR_INLINE void begin(TrackedRay<F, N> &s, const M &fresh) const {
        s.weight = select(fresh, uniform_spectrum<N>(F(1)), s.weight);
    }
    template <int N>
    TR_INLINE M collide(TrackedRay<F, N> &s, const Spectrum<F, N> &sigma, const M &stopped) const {
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
        for (int c = 0; c < N; ++c) s.weight[c] = select(lost, F(0), select(survives, s.weight[c] * up, s.weight[c]));
        if (any(lost)) finish(s, lost, lost);
        return stopped && !lost;
    }
    template <int N>
    TR_INLINE void finish(TrackedRay<F, N> &s, const M &done, const M &) const {
        for (int c = 0; c < SpectrumSize; ++c) {
            F old = gather<F>(at.transmittance[c], s.entry, done);
            scatter_lanes<F>(at.transmittance[c], s.entry, old * s.weight[N == 1 ? 0 : c], done);
        }
        // the whole way through the grid, whether or not it was walked
        put(at.start, s.entry, s.walk.enter, done);
        put(at.length, s.entry, s.walk.end, done);
    }
};

// ---------------------------------------------------------------------------------------------------- constant media
template <class F>
TR_INLINE Spectrum<F> constant_extinction(const SceneOf<F> &scene, const Wavelengths<F> &waves,
                                          const MediumInfo &medium) {
    Vec3<F> anywhere{F(0), F(0), F(0)};
    return eval_volume(scene, scene.values, waves, medium.extinction, anywhere, MaskOf<F>(true)) *
           F(scene.values.constants[medium.scale]);
}

// The entries of a packet, of rays that begin `ray_offset` before their origins.
template <class F>
TR_INLINE void fly_constant(const Spectrum<F> &sigma, const NumberColumn<ScalarOf<F>> &ray_offset,
                            const FlightColumns<ScalarOf<F>> &at, bool colored, bool points, const LaneSet<F> &lanes,
                            const UIntOf<F> &entry) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    const auto m = lanes.active;
    TrackingRandom<F> random{lanes(at.seed_a), lanes(at.seed_b)};
    IntOf<F> hero = colored ? IntOf<F>(lanes(at.hero)) : IntOf<F>(0);
    F ahead = lanes(ray_offset), sampled = component(sigma, hero), end = lanes(at.end) + ahead;
    auto some = mask<F>(sampled > F(0));
    F t = select(some, optical_depth(random.next(m)) / select(some, sampled, F(1)), F(S(INFINITY)));
    auto collides = m && mask<F>(t < end);
    F length = select(collides, t, end);
    auto endless = !mask<F>(length < F(S(1e30)));  // through nothing
    length = select(endless, F(0), length);
    put(at.start, entry, -ahead, m);
    put(at.length, entry, length, m);
    scatter_lanes<F>(at.collided.at, entry, select(mask<U>(collides), U(1u), U(0u)), m);
    F differential = random.next(m) * length, emission = random.next(m) * length;
    if (points) {
        put(at.differential, entry, differential - ahead, m);
        put(at.emission, entry, emission - ahead, m);
    }
    if (!colored) return;
    F inverse = F(1) / select(collides, sampled, F(1));
    for (int c = 0; c < SpectrumSize; ++c) {
        F more = sigma[c] - sampled;
        F fading = select(endless && mask<F>(more > F(0)), F(0), exp(-more * length));
        scatter_lanes<F>(at.weight[c], entry, select(collides, fading * sigma[c] * inverse, fading), m);
        if (!points) continue;
        scatter_lanes<F>(at.differential_weight[c], entry, exp(-more * differential), m);
        scatter_lanes<F>(at.emission_weight[c], entry, exp(-more * emission), m);
    }
}

template <class F>
TR_INLINE void transmit_constant(const Spectrum<F> &sigma, const NumberColumn<ScalarOf<F>> &ray_offset,
                                 const TransmittanceColumns<ScalarOf<F>> &at, const LaneSet<F> &lanes,
                                 const UIntOf<F> &entry) {
    using S = ScalarOf<F>;
    F ahead = lanes(ray_offset), end = lanes(at.end) + ahead;
    auto near = mask<F>(end < F(S(1e30)));
    Spectrum<F> before = lanes(at.transmittance);
    for (int c = 0; c < SpectrumSize; ++c) {
        F through =
            select(near, exp(-sigma[c] * select(near, end, F(0))), select(mask<F>(sigma[c] > F(0)), F(0), F(1)));
        scatter_lanes<F>(at.transmittance[c], entry, before[c] * through, lanes.active);
    }
    put(at.start, entry, -ahead, lanes.active);
    put(at.length, entry, select(near, end, F(0)), lanes.active);
}

}  // namespace tr
