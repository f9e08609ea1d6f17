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

static_assert(MaxAovChannels <= OutputValues::Most, "kernels have room for all");

// First hits of camera rays, of those samples whose `key` is Kept.
struct FirstHitStage {
    PathStage stage;
    AovLayout layout;
    PathQueue<float> rays;
    HitColumns<float> hits;
    const int32_t *key;

    TR_HD bool is_hit(uint32_t i) const { return key[i] == Kept && hits.at.shape[i] != NoHit; }
    // As FirstHits::for_hits.
    template <class Do>
    TR_HD void with_hit(uint32_t i, Do &&f) const {
        const AovContext<float> c(stage.scene, layout, stage.config.sensor, stage.width, stage.height);
        const Entries<float> from(i);
        const CameraSample<float> sample = camera_sample<float>(stage.config, c.sensor, stage.slots, from);
        const CameraRay<float> ray = camera_ray(stage.scene, c.sensor, sample, stage.width, stage.height);
        FirstHit<float> hit{sample,    {rays.o.get(i), rays.d.get(i)},  // which may have gone on behind emitters
                            ray.ray.o, ray.center,
                            {},        {stage.config, stage.slots.pixel[i], stage.slots.sample[i]}};
        hit.si = make_interaction<float>(stage.scene, hit.ray, SurfacePoint<float>(from(hits.at)), hits.t[i], true);
        f(c, hit);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), rays.for_arrays(visit), hits.for_arrays(visit), visit(key);
    }
};

// The values of the layout's channels, zero at misses, and as alpha whether something was hit.
struct EvaluateOutputs {
    static constexpr const char *Name = "tr::EvaluateOutputs", *Header = "device/output_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    FirstHitStage first;
    OutputValues value;

    TR_HD void operator()(uint32_t i) const {
        const bool is_hit = first.is_hit(i);
        float v[MaxAovChannels] = {};
        if (is_hit && first.layout.n > 0)
            first.with_hit(
                i, [&](const AovContext<float> &c, const FirstHit<float> &hit) { eval_aovs<float>(c, hit, true, v); });
        for (int c = 0; c < first.layout.n; ++c) value(c, i) = v[c];
        first.stage.slots.alpha[i] = is_hit ? 1.f : 0.f;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        first.for_pointers(visit), visit(value.at);
    }
};

// Rays through the centres of the samples' pixels, which have met nothing so far.
struct StartCentres {
    static constexpr const char *Name = "tr::StartCentres", *Header = "device/output_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Scene;
    PathStage stage;
    PathQueue<float> out;
    HitColumns<float> hits;
    int32_t *key;

    TR_HD void operator()(uint32_t i) const {
        const CameraSample<float> at{float(int32_t(stage.slots.column[i])) + 0.5f,
                                     float(int32_t(stage.slots.row[i])) + 0.5f};
        const Record &sensor = stage.scene.sensors[stage.config.sensor];
        const CameraRay<float> ray = camera_ray(stage.scene, sensor, at, stage.width, stage.height);
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
