// Outputs besides radiance as kernels: an item is a sample whose camera ray was traced (path_kernels.h), and has a
// number of each channel of the layout, which the film then gathers.
#pragma once

#include "core/integrator/aovs.h"
#include "film_kernels.h"
#include "path_kernels.h"
#if defined(__CUDACC_RTC__)
#include "core/integrator/aovs.cpp"
#include "core/integrator/bsdf_aovs.cpp"
#endif

namespace tr {

static_assert(MaxAovChannels <= OutputValues<float>::Most, "kernels have room for all");

// First hits of camera rays, of those samples whose `key` is Kept.
template <class S>
struct FirstHitStage {
    PathStage<S> stage;
    AovLayout layout;
    PathQueue<S> rays;
    HitColumns<S> hits;
    const int32_t *key;

    TR_HD bool is_hit(uint32_t i) const { return key[i] == Kept && hits.at.shape[i] != NoHit; }
    // As FirstHits::for_hits.
    template <class Do>
    TR_HD void with_hit(uint32_t i, Do &&f) const {
        const AovContext<S> c(stage.scene, layout, stage.config.sensor, stage.width, stage.height);
        const Entries<S> from(i);
        const CameraSample<S> sample = camera_sample<S>(stage.config, c.sensor, stage.slots, from);
        const CameraRay<S> ray = camera_ray(stage.scene, c.sensor, sample, stage.width, stage.height);
        FirstHit<S> hit{sample,    {rays.o.get(i), rays.d.get(i)},  // which may have gone on behind emitters
                        ray.ray.o, ray.center,
                        {},        {stage.config, stage.slots.pixel[i], stage.slots.sample[i]}};
        hit.si = make_interaction<S>(stage.scene, hit.ray, SurfacePoint<S>(from(hits.at)), hits.t[i], true);
        f(c, hit);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), rays.for_arrays(visit), hits.for_arrays(visit), visit(key);
    }
};

// The values of the layout's channels, zero at misses, and as alpha whether something was hit.
template <class S>
struct EvaluateOutputs {
    static constexpr const char *Name = TR_KERNEL_NAME(EvaluateOutputs), *Header = "device/output_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    FirstHitStage<S> first;
    OutputValues<S> value;

    TR_HD void operator()(uint32_t i) const {
        const bool is_hit = first.is_hit(i);
        S v[MaxAovChannels] = {};
        if (is_hit && first.layout.n > 0)
            first.with_hit(i, [&](const AovContext<S> &c, const FirstHit<S> &hit) { eval_aovs<S>(c, hit, true, v); });
        for (int c = 0; c < first.layout.n; ++c) value(c, i) = v[c];
        first.stage.slots.alpha[i] = is_hit ? S(1) : S(0);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        first.for_pointers(visit), visit(value.at);
    }
};

// Rays through the centres of the samples' pixels, which have met nothing so far.
template <class S>
struct StartCentres {
    static constexpr const char *Name = TR_KERNEL_NAME(StartCentres), *Header = "device/output_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    PathStage<S> stage;
    PathQueue<S> out;
    HitColumns<S> hits;
    int32_t *key;

    TR_HD void operator()(uint32_t i) const {
        const CameraSample<S> at{S(int32_t(stage.slots.column[i])) + S(0.5), S(int32_t(stage.slots.row[i])) + S(0.5)};
        const Record &sensor = stage.scene.sensors[stage.config.sensor];
        const CameraRay<S> ray = camera_ray(stage.scene, sensor, at, stage.width, stage.height);
        out.o.set(i, ray.ray.o), out.d.set(i, ray.ray.d), out.length[i] = ray.length;
        key[i] = ray.exists ? Kept : Gone;
        hits.at.shape[i] = NoHit;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), out.for_arrays(visit), hits.for_arrays(visit), visit(key);
    }
};

}  // namespace tr
