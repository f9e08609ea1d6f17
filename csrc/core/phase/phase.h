// All phase functions. The index of a phase function is the same in all lanes: callers go through media one by one.
// Phase functions are their own densities: a sample's value over its density is 1.
#pragma once

#include "../volume/volume.h"
#include "blend.h"
#include "hg.h"
#include "isotropic.h"
#include "rayleigh.h"
#include "tabulated.h"

namespace tr {

enum class PhaseKind : int32_t {
    Isotropic = 0,
    HenyeyGreenstein = 1,
    Rayleigh = 2,
    Tabulated = 3,
    Blend = 4
};  // order of the registry

// Calls visit with a value of the model, which is no blend.
template <class Visit>
TR_INLINE auto with_phase_model(const Record &record, Visit &&visit) {
    switch (PhaseKind(record.kind)) {
        case PhaseKind::HenyeyGreenstein:
            return visit(HenyeyGreenstein{});
        case PhaseKind::Rayleigh:
            return visit(Rayleigh{});
        case PhaseKind::Tabulated:
            return visit(TabulatedPhase{});
        default:
            return visit(Isotropic{});
    }
}

// A blend while rendering: the records of its parts and the weight of the second at p.
template <class F, class S>
struct Blend {
    const Record *part[2];
    F weight;

    TR_INLINE Blend(const SceneView<S> &scene, const Record &record, const Vec3<F> &p, const MaskOf<F> &active)
        : part{scene.phases + record.field[BlendPhase::First], scene.phases + record.field[BlendPhase::Second]},
          weight(eval_volume<1>(scene, scene.values, record.field[BlendPhase::Weight], p, active)[0]) {}
};

template <class F, class S>
TR_INLINE F eval_single_phase(const SceneView<S> &scene, const Record &record, const Vec3<F> &d, const Vec3<F> &wo) {
    return with_phase_model(record, [&](auto model) { return decltype(model)::eval(scene, record, d, wo); });
}

template <class F, class S>
TR_INLINE Vec3<F> sample_single_phase(const SceneView<S> &scene, const Record &record, const Vec3<F> &d, const F &u1,
                                      const F &u2, const MaskOf<F> &active) {
    return with_phase_model(record,
                            [&](auto model) { return decltype(model)::sample(scene, record, d, u1, u2, active); });
}

template <class F, int C, class S, class Sink>
TR_INLINE void sweep_single_phase(const SceneView<S> &scene, const Record &record, const Vec3<F> &d, const Vec3<F> &wo,
                                  const Color<F, C> &g, const MaskOf<F> &active, Sink &sink) {
    with_phase_model(record, [&](auto model) { decltype(model)::sweep(scene, record, d, wo, g, active, sink); });
}

// Blends stay out of the way of what is called at every collision.
template <class F, class S>
TR_NOINLINE F eval_blend(const SceneView<S> &scene, const Record &record, const Vec3<F> &p, const Vec3<F> &d,
                         const Vec3<F> &wo, const MaskOf<F> &active) {
    Blend<F, S> blend(scene, record, p, active);
    F value[2];
    for (int i = 0; i < 2; ++i) value[i] = eval_single_phase(scene, *blend.part[i], d, wo);
    return fmadd(blend.weight, value[1] - value[0], value[0]);
}

template <class F, class S>
TR_NOINLINE Vec3<F> sample_blend(const SceneView<S> &scene, const Record &record, const Vec3<F> &p, const Vec3<F> &d,
                                 const F &u0, const F &u1, const F &u2, const MaskOf<F> &active) {
    Blend<F, S> blend(scene, record, p, active);
    auto second = mask<F>(u0 < blend.weight);
    Vec3<F> wo = d;
    for (int i = 0; i < 2; ++i) {
        auto lanes = active && (i ? second : !second);
        if (any(lanes)) wo = select(lanes, sample_single_phase(scene, *blend.part[i], d, u1, u2, lanes), wo);
    }
    return wo;
}

template <class F, int C, class S, class Sink>
TR_NOINLINE void sweep_blend(const SceneView<S> &scene, const Record &record, const Vec3<F> &p, const Vec3<F> &d,
                             const Vec3<F> &wo, const Color<F, C> &g, const MaskOf<F> &active, Sink &sink) {
    Blend<F, S> blend(scene, record, p, active);
    F value[2];
    for (int i = 0; i < 2; ++i) {
        value[i] = eval_single_phase(scene, *blend.part[i], d, wo);
        sweep_single_phase(scene, *blend.part[i], d, wo, g * (i ? blend.weight : F(1) - blend.weight), active, sink);
    }
    const int32_t volume = record.field[BlendPhase::Weight];
    const Record &weight = scene.volumes[volume];
    Color<F, C> by_weight = g * (value[1] - value[0]);
    if (weight.kind == int32_t(VolumeKind::Constant)) {
        sink.color(scene, IntOf<F>(weight.field[ConstantVolume::Value]), by_weight, active);
        return;
    }
    const int32_t slot = weight.field[GridVolume::Data];
    const TensorView<S> &grid = scene.values.tensors[slot];
    sink.footprint(scene, slot, GridVolume::footprint(grid, weight, to_volume(scene, volume, p)), by_weight, active);
}

// The value (and density per solid angle) of scattering at p from the direction of travel `d` into `wo`.
template <class F, class S>
TR_INLINE F eval_phase(const SceneView<S> &scene, int32_t phase, const Vec3<F> &p, const Vec3<F> &d, const Vec3<F> &wo,
                       const MaskOf<F> &active) {
    const Record &record = scene.phases[phase];
    if (record.kind == int32_t(PhaseKind::Blend)) return eval_blend(scene, record, p, d, wo, active);
    return eval_single_phase(scene, record, d, wo);
}

// A direction, distributed as eval_phase says. u0 chooses between the parts of a blend.
template <class F, class S>
TR_INLINE Vec3<F> sample_phase(const SceneView<S> &scene, int32_t phase, const Vec3<F> &p, const Vec3<F> &d,
                               const F &u0, const F &u1, const F &u2, const MaskOf<F> &active) {
    const Record &record = scene.phases[phase];
    if (record.kind == int32_t(PhaseKind::Blend)) return sample_blend(scene, record, p, d, u0, u1, u2, active);
    return sample_single_phase(scene, record, d, u1, u2, active);
}

// The derivative of eval_phase with respect to the parameters; `g` is the adjoint of its value, channel by channel.
template <class F, int C, class S, class Sink>
TR_INLINE void sweep_phase(const SceneView<S> &scene, int32_t phase, const Vec3<F> &p, const Vec3<F> &d,
                           const Vec3<F> &wo, const Color<F, C> &g, const MaskOf<F> &active, Sink &sink) {
    const Record &record = scene.phases[phase];
    if (record.kind == int32_t(PhaseKind::Blend)) return sweep_blend(scene, record, p, d, wo, g, active, sink);
    sweep_single_phase(scene, record, d, wo, g, active, sink);
}

}  // namespace tr
