// What scattering in a medium makes of Stokes vectors. Particles much smaller than the wavelength have Rayleigh's
// matrix (van de Hulst, "Light Scattering by Small Particles", 1957, section 6.4): on the axis across the plane of
// scattering, with the cosine mu of the angle,
//     3 / (16 pi)  times   1 + mu^2   1 - mu^2     0      0
//                          1 - mu^2   1 + mu^2     0      0
//                              0          0      2 mu     0
//                              0          0        0    2 mu
// and the light of all others is unpolarised. In a blend both kinds add up.
#pragma once

#include "../phase/blend.h"
#include "../phase/phase.h"
#include "lookup.h"

namespace tr {

constexpr int RayleighKind = kind_of_model<Rayleigh>(Phases{}), BlendPhaseKind = kind_of_model<BlendPhase>(Phases{});

// f of the phase function, and what the matrix has besides: b beside the first entry, q and x on the diagonal.
template <class F>
struct ScatteringMatrix {
    F f, b, q, x;
};

// Rayleigh's, times `share`, and its derivative by mu; both without f.
template <class F>
TR_INLINE ScatteringMatrix<F> rayleigh_matrix(const F &mu, const F &share) {
    const F scale = share * F(3 / (16 * Pi)), squared = scale * mu * mu;
    return {F(0), scale - squared, scale + squared, F(2) * scale * mu};
}
template <class F>
TR_INLINE ScatteringMatrix<F> rayleigh_slope(const F &mu, const F &share) {
    const F twice = share * F(6 / (16 * Pi));
    return {F(0), -twice * mu, twice * mu, twice};
}

// Which parts of a phase function, at p, are Rayleigh's: 0, the first part of a blend, the second, both, or all of it.
template <class F>
struct RayleighShare {
    bool whole = false, part[2] = {false, false};
    int32_t weight = -1;  // the blend's volume

    TR_INLINE RayleighShare(const SceneOf<F> &scene, int32_t phase) {
        const Record &record = scene.phases[phase];
        whole = record.kind == RayleighKind;
        if (record.kind != BlendPhaseKind) return;
        part[0] = scene.phases[record.field[BlendPhase::First]].kind == RayleighKind;
        part[1] = scene.phases[record.field[BlendPhase::Second]].kind == RayleighKind;
        whole = part[0] && part[1];
        weight = record.field[BlendPhase::Weight];
    }
    TR_INLINE bool some() const { return whole || part[0] || part[1]; }

    TR_INLINE F at(const SceneOf<F> &scene, const Vec3<F> &p, const MaskOf<F> &active) const {
        if (whole || !some()) return F(whole ? 1 : 0);
        const F second = eval_volume(scene, scene.values, Wavelengths<F>{}, weight, p, active)[0];
        return part[1] ? second : F(1) - second;
    }
    // `g` is the adjoint of the share, component by component. Returns that of p, if it is wanted.
    TR_INLINE Vec3<F> sweep(const SceneOf<F> &scene, const Vec3<F> &p, Spectrum<F> g, bool values, bool place,
                            const MaskOf<F> &active, GradientSink<F> &sink) const {
        if (whole || !some()) return {F(0), F(0), F(0)};
        if (part[0]) g = g * F(-1);
        if (values) sink.volume(scene, weight, p, g, active);
        if (!place) return {F(0), F(0), F(0)};
        Spectrum<F> first = uniform_spectrum(F(0));  // the weight is the first component
        first[0] = component_sum(g);
        return sweep_volume_place(scene, weight, p, first, active, sink);
    }
};

}  // namespace tr
