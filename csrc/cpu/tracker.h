// Segments of many rays through media: free flight to the next collision, and transmittance. The rays of one medium
// wait in a queue; a packet works on as many as it has lanes, and a lane whose ray is done takes the next one.
#pragma once

#include "core/integrator/config.h"
#include "core/medium/estimators.h"

namespace tr {

template <class F>
class Tracker {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    static constexpr int W = Lanes<F>::Width;

public:
    Tracker(const SceneView<S> &scene, const PathConfig &config, const SlotColumns<S> &slots)
        : scene_(scene), config_(config), slots_(slots) {}

    // The entries `order`[0 .. n), ascending, are in the medium. `points`: see FlightEstimator.
    void fly(int32_t medium, const TrackedQueue<S> &rays, const FlightColumns<S> &at, const uint32_t *order, size_t n,
             bool points);
    void transmit(int32_t medium, const TrackedQueue<S> &rays, const TransmittanceColumns<S> &at, const uint32_t *order,
                  size_t n);

    uint64_t collisions = 0;  // tentative ones
    uint64_t exceeded = 0;    // of them with an extinction above the majorant: there must be none

private:
    const SceneView<S> &scene_;
    const PathConfig &config_;
    const SlotColumns<S> &slots_;

    // Calls visit(extinction, lanes, entries) for packets of the order.
    template <class Visit>
    void for_constant(const MediumInfo &medium, const TrackedQueue<S> &rays, const uint32_t *order, size_t n,
                      Visit &&visit) const;

    template <class Columns, class Estimator>
    void walk(const MediumInfo &medium, const TrackedQueue<S> &rays, const Columns &at, const uint32_t *order, size_t n,
              const Estimator &estimator);
    template <int N, class Columns, class Estimator>
    void walk_components(const MediumInfo &medium, const TrackedQueue<S> &rays, const Columns &at,
                         const uint32_t *order, size_t n, const Estimator &estimator);
    // Calls visit(lanes, entries) for packets of the order.
    template <class Visit>
    static void for_packets(const uint32_t *order, size_t n, Visit &&visit);
};

}  // namespace tr
