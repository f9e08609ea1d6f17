// What a medium that light bends in does to it along a ray: absorption sigma and emission eps per unit length.
//
// Each kick of weight w stands for a piece of the ray of length l = w step n with the properties of its place. Paths
// carry L / n^2, to which eps / n^2 is added. A piece, from what arrives behind it to what it lets out, is that of a
// homogeneous medium,
//     L = exp(-sigma l) L_behind + eps / n^2 (1 - exp(-sigma l)) / sigma,
// also where the last weight makes l negative: pieces of equal sigma and eps / n^2 join without error.
#pragma once

#include "../volume/volume.h"
#include "bend.h"

namespace tr {

// A volume (-1: none), and from voxels of the medium to the unit cube of a grid.
template <class S>
struct BendVolume {
    int32_t volume;
    S to_local[12];
};

template <class S>
struct BendLight {
    BendVolume<S> extinction, emission;
    int32_t scale_offset;  // of the factor of the extinction, in the block of small parameters
    S step;                // of the parameter t, see bend.h
};

// The volumes of a medium at the wavelengths of a packet.
template <class F>
struct LightAlong {
    using S = ScalarOf<F>;
    const SceneOf<F> &scene;
    const BendLight<S> &light;
    const Wavelengths<F> &waves;

    TR_INLINE bool emits() const { return light.emission.volume >= 0; }
    TR_INLINE F scale() const { return F(scene.values.constants[light.scale_offset]); }
    // Of a volume at q, in voxels of the medium; `values`: the scene's, or a tangent.
    TR_INLINE Spectrum<F> at(const BendVolume<S> &of, const Values<S> &values, const Vec3<F> &q,
                             const MaskOf<F> &active) const {
        const Record &record = scene.volumes[of.volume];
        if (record.kind == int32_t(VolumeKind::Constant))
            return constant_spectrum<F>(values, waves, record.field[ConstantVolume::Value]);
        return eval_grid(values, waves, record, transform_point(of.to_local, q), active);
    }
    TR_INLINE Spectrum<F> extinction(const Vec3<F> &q, const MaskOf<F> &active) const {
        return at(light.extinction, scene.values, q, active) * scale();
    }
    TR_INLINE Spectrum<F> emission(const Vec3<F> &q, const MaskOf<F> &active) const {
        return emits() ? at(light.emission, scene.values, q, active) : uniform_spectrum(F(0));
    }
};

// (1 - exp(-x)) / x, and its derivative.
template <class F>
struct MeanDecay {
    F value, slope, end;  // end: exp(-x)

    TR_INLINE explicit MeanDecay(const F &x) : end(exp(-x)) {
        using S = ScalarOf<F>;
        const MaskOf<F> near = mask<F>(abs(x) < F(S(0.05)));
        const F inverse = F(1) / select(near, F(1), x);
        // sum of (-x)^k / (k + 1)!
        constexpr double c[8] = {1, -1. / 2, 1. / 6, -1. / 24, 1. / 120, -1. / 720, 1. / 5040, -1. / 40320};
        F sum = F(S(c[7])), by_x = F(S(7 * c[7]));
        for (int k = 6; k >= 0; --k) sum = fmadd(sum, x, F(S(c[k])));
        for (int k = 6; k >= 1; --k) by_x = fmadd(by_x, x, F(S(k * c[k])));
        value = select(near, sum, (F(1) - end) * inverse);
        slope = select(near, by_x, (end - value) * inverse);
    }
};

// Optical depth of a ray up to a place, and what has been emitted up to there, as it comes out where the ray begins.
template <class F>
struct LightSum {
    Spectrum<F> depth = uniform_spectrum(F(0)), emitted = uniform_spectrum(F(0));

    // A kick of weight w at q, where the index is n.
    TR_NOINLINE void add(const LightAlong<F> &along, const Vec3<F> &q, const F &n, const F &w,
                         const MaskOf<F> &active) {
        const F length = select(active, w * n * F(along.light.step), F(0));
        const Spectrum<F> sigma = along.extinction(q, active);
        if (along.emits()) {
            const Spectrum<F> eps = along.emission(q, active);
            const F factor = select(mask<F>(n > F(0)), length / (n * n), F(0));
            for (int c = 0; c < SpectrumSize; ++c)
                emitted[c] = fmadd(exp(-depth[c]) * MeanDecay<F>(sigma[c] * length).value, eps[c] * factor, emitted[c]);
        }
        depth = depth + sigma * length;
    }
};

#define TR_ELSEWHERE(S)                                                                                         \
    extern template void LightSum<PacketOf<S>>::add(const LightAlong<PacketOf<S>> &, const Vec3<PacketOf<S>> &, \
                                                    const PacketOf<S> &, const PacketOf<S> &,                   \
                                                    const MaskOf<PacketOf<S>> &);
TR_FOR_EACH_PRECISION(TR_ELSEWHERE)
#undef TR_ELSEWHERE

}  // namespace tr
