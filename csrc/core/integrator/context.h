// What all stages of a path tracer share: the scene and the settings, where paths leave what they bring, and the tape
// if there is one. With a tape vertices are written down, for a derivative, in place of adding up radiance.
#pragma once

#include "../adjoint/needs.h"
#include "../state/tape.h"
#include "config.h"

namespace tr {

// Values that are not finite and were left out: how many, and where the first one was. Each thread has one of its own,
// of a CPU and of a device.
struct Diagnostics {
    uint64_t non_finite = 0;
    Culprit culprit = Culprit::None;
    int32_t index = -1;
};

template <class F>
struct PathContext {
    using S = ScalarOf<F>;
    const SceneView<S> &scene;
    const PathConfig &config;
    const SlotColumns<S> &slots;
    Diagnostics &diagnostics;
    const GradientNeeds *needs;                                // of the tape
    TR_TAPE(const TapeColumns<S> *, tape) = nullptr;           // the level of this step; null: radiance is added up
    bool keeps_black = false;                                  // shadow rays that bring nothing are traced, too
    TR_FACT(const BentColumns<S> *, bent, nullptr) = nullptr;  // by entry of the queue; null: no medium bends light
    // Of the tape: nothing but values of BSDFs is differentiated, so that light counts from the first such vertex on.
    bool bsdfs_alone = false;
    TR_FACT(const CommonKeys *, keys, nullptr) = nullptr;  // of Sobol' points, of this step; null: none are kept

    TR_INLINE bool differentiates(bool GradientNeeds::*what) const { return tape && needs->*what; }
    // How rays arrive: they move, or polarised light is turned about them.
    TR_INLINE bool keeps_arrivals() const { return needs->geometry || config.stokes; }
};

// The samples of a packet, and their random numbers.
template <class F>
struct PacketSamples : PathNumbers<F> {
    TR_INLINE PacketSamples(const PathContext<F> &c, const UIntOf<F> &slot, const MaskOf<F> &active)
        : PacketSamples(c, LaneSet<F>(slot, active)) {}
    TR_INLINE Wavelengths<F> wavelengths(const PathConfig &config) const {
        return wavelengths_of<F>(config, this->pixel, this->sample);
    }

private:
    TR_INLINE PacketSamples(const PathContext<F> &c, const LaneSet<F> &lanes)
        : PathNumbers<F>(c.config, lanes(c.slots.pixel), lanes(c.slots.sample), c.keys) {}
};

// The numbers that a sample of a BSDF takes.
TR_HD constexpr uint32_t numbers_of(const BsdfInfo &bsdf) {
    return (bsdf.is(HasSmoothLobes) ? PairWanted : 0u) | (bsdf.is(ChoosesLobe) ? ThirdWanted : 0u);
}

// Lanes whose value is finite; the others are counted and the first one remembered.
template <class F>
TR_INLINE MaskOf<F> finite(const PathContext<F> &c, const Spectrum<F> &value, const MaskOf<F> &active, Culprit culprit,
                           const IntOf<F> &index) {
    auto usable = active && is_finite(value);
    int lost = count(active) - count(usable);
    if (lost) {
        Diagnostics &d = c.diagnostics;
        d.non_finite += uint64_t(lost);
        if (d.culprit == Culprit::None) d.culprit = culprit, d.index = first_lane(index, active && !usable);
    }
    return usable;
}

// Paths that see something for the first time.
template <class F>
TR_INLINE void mark_seen(const PathContext<F> &c, const UIntOf<F> &slot, const UIntOf<F> &seen,
                         const MaskOf<F> &active) {
    auto first = active && mask<F>(seen == 0u);
    if (any(first)) scatter_lanes<F>(c.slots.alpha.at, slot, F(1), first);
}

template <class F>
TR_INLINE MaskOf<F> has_differentiated(const UIntOf<F> &seen) {
    return mask<F>((seen & SeenDifferentiated) != 0u);
}

// Of a model that disperses: how paths go through it, and what they are afterwards.
template <class F>
TR_INLINE void follow_waves(const BsdfInfo &model, const UIntOf<F> &seen, BsdfParameters<F> &params) {
    if (model.turned_by < 0) return;
    using I = IntOf<F>;
    params.refraction = select(mask<I>((seen & SingleWave) != 0u), I(RefractsSingle), params.refraction);
}
// After scattering by this lobe.
template <class F>
TR_INLINE UIntOf<F> seen_after(const BsdfInfo &model, const IntOf<F> &lobe, const UIntOf<F> &seen) {
    using U = UIntOf<F>;
    if (model.turned_by < 0) return seen | SeenSomething;
    return seen | select(mask<U>(lobe == RefractsFirst), U(SeenSomething | SingleWave), U(SeenSomething));
}

// Russian roulette: paths of little throughput end, the others count for them. Returns the factor of those that go on.
// `counted`: lanes in which it is played; u: a number of each.
template <class F>
TR_INLINE F play_roulette(const F &throughput, const F &eta, const F &u, const MaskOf<F> &counted, MaskOf<F> &alive) {
    F q = min(throughput * eta * eta, F(0.95));
    alive = alive && (!counted || mask<F>(u < q));
    return select(alive && counted, F(1) / select(alive, q, F(1)), F(1));
}

// The part of a factor that roulette looks at: paths that a factor of zero would end go on where it has a derivative.
template <class F>
TR_INLINE Spectrum<F> kept_factor(const Spectrum<F> &factor, const MaskOf<F> &differentiated) {
    return select(differentiated, max_with(magnitude(factor), F(0.05)), factor);
}

}  // namespace tr
