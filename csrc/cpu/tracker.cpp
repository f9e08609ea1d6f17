#include "tracker.h"

namespace tr {

template <class F>
template <class Visit>
void Tracker<F>::for_packets(const uint32_t *order, size_t n, Visit &&visit) {
    for (size_t i = 0; i < n; i += W) {
        LaneSet<F> lanes(order + i, uint32_t(n - i));
        visit(lanes, select(mask<U>(lanes.active), load_uint<F>(order + i), U(order[i])));
    }
}

// Where there are wavelengths, each ray has its own extinction.
template <class F>
template <class Visit>
void Tracker<F>::for_constant(const MediumInfo &medium, const TrackedQueue<S> &rays, const uint32_t *order, size_t n,
                              Visit &&visit) const {
    const bool spectral = config_.spectral.positions != nullptr;
    Spectrum<F> sigma;
    if (!spectral) sigma = constant_extinction<F>(scene_, {}, medium);
    for_packets(order, n, [&](const LaneSet<F> &lanes, const U &entry) {
        if (spectral) {
            Gathered<F> path(select(mask<U>(lanes.active), lanes(rays.slot), U(0u)), lanes.active);
            const auto waves = wavelengths_of<F>(config_, path(slots_.pixel), path(slots_.sample));
            sigma = constant_extinction<F>(scene_, waves, medium);
        }
        visit(sigma, lanes, entry);
    });
}

template <class F>
void Tracker<F>::fly(int32_t medium, const TrackedQueue<S> &rays, const FlightColumns<S> &at, const uint32_t *order,
                     size_t n, bool points) {
    const MediumInfo &m = scene_.media[medium];
    if (m.flags & IsGrid) return walk(m, rays, at, order, n, FlightEstimator<F>{at, points});
    for_constant(m, rays, order, n, [&](const Spectrum<F> &sigma, const LaneSet<F> &lanes, const U &entry) {
        fly_constant(sigma, rays.ray_offset, at, (m.flags & IsChromatic) != 0, points, lanes, entry);
    });
}

template <class F>
void Tracker<F>::transmit(int32_t medium, const TrackedQueue<S> &rays, const TransmittanceColumns<S> &at,
                          const uint32_t *order, size_t n) {
    const MediumInfo &m = scene_.media[medium];
    if (m.flags & IsGrid) return walk(m, rays, at, order, n, TransmittanceEstimator<F>{at});
    for_constant(m, rays, order, n, [&](const Spectrum<F> &sigma, const LaneSet<F> &lanes, const U &entry) {
        transmit_constant(sigma, rays.ray_offset, at, lanes, entry);
    });
}

template <class F>
template <class Columns, class Estimator>
void Tracker<F>::walk(const MediumInfo &medium, const TrackedQueue<S> &rays, const Columns &at, const uint32_t *order,
                      size_t n, const Estimator &estimator) {
    if (medium.flags & IsChromatic)
        walk_components<SpectrumSize>(medium, rays, at, order, n, estimator);
    else
        walk_components<1>(medium, rays, at, order, n, estimator);
}

// Deterministic packets: what happens to a lane depends on its own entry alone.
template <class F>
template <int N, class Columns, class Estimator>
void Tracker<F>::walk_components(const MediumInfo &medium, const TrackedQueue<S> &rays, const Columns &at,
                                 const uint32_t *order, size_t n, const Estimator &estimator) {
    TrackedRay<F, N> s;
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
            walking = walking || s.start(scene_, medium, rays, at, estimator, fresh);
        }
        if (!any(walking || stopped)) {
            if (taken >= n) return;
            continue;
        }
        M left(false);
        do {
            s.walk.advance(scene_, medium, s.depth, walking, stopped, left);
        } while (W > 1 ? count(walking) > count(stopped) && count(left) * 4 < W : any(walking));
        if (any(left)) estimator.finish(s, left, M(false));
        // tentative collisions, once they are most of what is left to do
        if (any(stopped) && (count(stopped) * 2 >= count(walking || stopped))) {
            collisions += uint64_t(count(stopped));
            M above(false);
            walking = walking || s.collide(scene_, medium, estimator, stopped, above);
            if (any(above)) exceeded += uint64_t(count(above));
            stopped = M(false);
        }
    }
}

#define TR_INSTANTIATE(F, S) template class Tracker<F>;
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
