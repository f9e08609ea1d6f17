#include "blend.h"

#include "../adjoint/lookup.h"
#include "kernels.h"

namespace tr {

namespace {

// The records of its parts, which are no blends, and the weight of the second at p.
template <class F>
struct Parts {
    const Record *part[2];
    F weight;

    TR_INLINE Parts(const SceneOf<F> &scene, const Record &record, const Vec3<F> &p, const MaskOf<F> &active)
        : part{scene.phases + record.field[BlendPhase::First], scene.phases + record.field[BlendPhase::Second]},
          weight(eval_volume(scene, scene.values, Wavelengths<F>{}, record.field[BlendPhase::Weight], p, active)[0]) {}
    // Calls visit(table) for a part.
    template <class Visit>
    TR_INLINE auto with(int i, Visit &&visit) const {
        return visit_phase_kind<F, false>(part[i]->kind, visit);
    }
};

}  // namespace

template <class F>
TR_LARGE F BlendPhase::eval(const SceneOf<F> &scene, const Record &record, const Vec3<F> &p, const Vec3<F> &d,
                            const Vec3<F> &wo, const MaskOf<F> &active) {
    Parts<F> parts(scene, record, p, active);
    F value[2];
    for (int i = 0; i < 2; ++i)
        value[i] = parts.with(i, [&](const auto &part) { return part.eval(scene, *parts.part[i], p, d, wo, active); });
    return fmadd(parts.weight, value[1] - value[0], value[0]);
}

template <class F>
TR_LARGE Vec3<F> BlendPhase::sample(const SceneOf<F> &scene, const Record &record, const Vec3<F> &p, const Vec3<F> &d,
                                    const F &u0, const F &u1, const F &u2, const MaskOf<F> &active) {
    Parts<F> parts(scene, record, p, active);
    auto second = mask<F>(u0 < parts.weight);
    Vec3<F> wo = d;
    for (int i = 0; i < 2; ++i) {
        auto lanes = active && (i ? second : !second);
        if (!any(lanes)) continue;
        wo = select(
            lanes,
            parts.with(i,
                       [&](const auto &part) { return part.sample(scene, *parts.part[i], p, d, u0, u1, u2, lanes); }),
            wo);
    }
    return wo;
}

template <class F>
TR_LARGE F BlendPhase::slope(const SceneOf<F> &scene, const Record &record, const Vec3<F> &p, const Vec3<F> &d,
                             const Vec3<F> &wo, const F &g, const MaskOf<F> &active, Vec3<F> &p_bar,
                             GradientSink<F> &sink) {
    Parts<F> parts(scene, record, p, active);
    F value[2], slope[2];
    for (int i = 0; i < 2; ++i) {
        slope[i] = parts.with(i, [&](const auto &part) {
            value[i] = part.eval(scene, *parts.part[i], p, d, wo, active);
            return part.slope(scene, *parts.part[i], p, d, wo, g, active, p_bar, sink);
        });
    }
    Spectrum<F> weight_bar = uniform_spectrum(F(0));  // the weight is the first component
    weight_bar[0] = g * (value[1] - value[0]);
    p_bar = p_bar + sweep_volume_place(scene, record.field[Weight], p, weight_bar, active, sink);
    return fmadd(parts.weight, slope[1] - slope[0], slope[0]);
}

template <class F>
TR_LARGE void BlendPhase::vjp(const SceneOf<F> &scene, const Record &record, const Vec3<F> &p, const Vec3<F> &d,
                              const Vec3<F> &wo, const Spectrum<F> &g, const MaskOf<F> &active, GradientSink<F> &sink) {
    Parts<F> parts(scene, record, p, active);
    F value[2];
    for (int i = 0; i < 2; ++i) {
        parts.with(i, [&](const auto &part) {
            value[i] = part.eval(scene, *parts.part[i], p, d, wo, active);
            if (part.vjp)
                part.vjp(scene, *parts.part[i], p, d, wo, g * (i ? parts.weight : F(1) - parts.weight), active, sink);
        });
    }
    sink.volume(scene, record.field[Weight], p, g * (value[1] - value[0]), active);
}

TR_PHASE(BlendPhase)

}  // namespace tr
