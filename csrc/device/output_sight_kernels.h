// Outputs besides radiance on both sides of outlines that the camera sees as kernels: see cpu/boundary_outputs.h.
#pragma once

#include "output_kernels.h"
#include "sight_kernels.h"

namespace tr {

// The values of the layout's channels and, as a last one, whether there is anything. An item is a ray beside an
// outline.
template <class S>
struct LookUpOutputs {
    static constexpr const char *Name = TR_KERNEL_NAME(LookUpOutputs), *Header = "device/output_sight_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    BoundaryStage<S> stage;
    AovLayout layout;
    const SightRecord<S> *from;
    OutputValues<S> value;  // by ray

    TR_HD void operator()(uint32_t k) const {
        const SightRecord<S> &r = from[k / 2];
        if (!r.kept) return;
        const OutlineRay<S> &ray = r.beside[k % 2];
        const bool is_hit = ray.at.shape != NoHit;
        S v[MaxAovChannels] = {};
        if (is_hit) evaluate(stage.sample(k / 2), r, ray, v);
        for (int c = 0; c < layout.n; ++c) value(c, k) = v[c];
        value(layout.n, k) = is_hit ? S(1) : S(0);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(from), visit(value.at);
    }

private:
    TR_HD void evaluate(const OutlineSample &sample, const SightRecord<S> &r, const OutlineRay<S> &ray, S *v) const {
        const AovContext<S> c(stage.scene, layout, stage.config.sensor, stage.view.width, stage.view.height);
        FirstHit<S> seen{r.place, {ray.met_from, ray.d},
                         ray.o,   ray.o + ray.d * (r.x.t - r.x.distance),
                         {},      {stage.config, sample.low, sample.high}};
        seen.si = make_interaction<S>(stage.scene, seen.ray, ray.at, ray.t, true);
        eval_aovs<S>(c, seen, true, v);
    }
};

// What the outlines' motion makes of them. An item is a sample.
template <class S>
struct AddOutputSights {
    static constexpr const char *Name = TR_KERNEL_NAME(AddOutputSights), *Header = "device/output_sight_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Derivative;
    bool adds() const { return sums.adds(); }
    SightSums<S> sums;
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    OutputValues<S> value;

    TR_HD void operator()(uint32_t i) const {
        sums.template add<MaxAovChannels + 1>(i, [&](int32_t c, uint32_t k) { return value(c, k); });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        sums.for_pointers(visit), visit(value.at);
    }
};

}  // namespace tr
