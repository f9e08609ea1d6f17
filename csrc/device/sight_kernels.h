// Samples of outlines that the camera sees as kernels: see core/boundary/sights.h. An item is a sample.
#pragma once

#include "boundary_stage.h"
#include "core/adjoint/camera.h"
#include "core/boundary/sights.h"

namespace tr {

template <class S>
struct SightRecord {
    Sight<S> x;
    OutlineRay<S> beside[2];
    S length;  // of these
    CameraSample<S> place;
    bool kept;
};

template <class S>
struct FindSights {
    static constexpr const char *Name = TR_KERNEL_NAME(FindSights), *Header = "device/sight_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    SightRecord<S> *to;

    TR_HD void operator()(uint32_t i) const {
        const SightSamples<S> samples(stage.scene, stage.config, stage.view);
        const OutlineSample sample = stage.sample(i);
        SightRecord<S> r{};
        r.place = samples.lens_of(sample);
        if (samples.find(sample, r.place, r.x, r.beside, r.length)) {
            r.x.slot = i;
            r.kept = look_past(samples, r);
        }
        to[i] = r;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(to);
    }

private:
    TR_HD bool look_past(const SightSamples<S> &samples, SightRecord<S> &r) const {
        const bool some = stage.config.hide_emitters || stage.config.volumetric;
        const auto passes = [&](uint32_t shape) { return some && samples.lets_through(shape); };
        for (OutlineRay<S> &ray : r.beside) stage.trace(ray, r.length, passes);
        accumulate(stage.traced, uint64_t(2));
        CloserRay<S> wanted[2];
        OutlineRay<S> closer[2];
        if (r.x.folded) samples.look_closer(r.x, r.beside, r.length, wanted);
        for (int h = 0; h < 2 && r.x.folded; ++h) closer[h] = stage.trace(samples, wanted[h], passes);
        return samples.is_open(r.x, r.beside, wanted, closer);
    }
};

// The rays beside them, of which an item is one.
template <class S>
struct StartSights {
    static constexpr const char *Name = TR_KERNEL_NAME(StartSights), *Header = "device/sight_kernels.h";
    const SightRecord<S> *from;
    uint64_t first;  // the number of the first sample
    LightRays<S> rays;

    TR_HD void operator()(uint32_t i) const {
        const SightRecord<S> &r = from[i / 2];
        rays.key[i] = Gone;
        if (r.kept) rays.begin(i, r.beside[i % 2], r.length, S(0), uint32_t(first + i / 2));
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(from), rays.for_pointers(visit);
    }
};

// What the outlines' motion makes of what is seen along these rays.
template <class S>
struct SightSums {
    BoundaryView<S> view;
    BoundaryGradients<S> gradients;
    const SightRecord<S> *from;
    BoundaryFilm<S> film;

    bool adds() const { return !gradients.to.fixed && !gradients.to.forward; }
    // Of sample i; value(c, k): of the film's channels, `Most` at most, along ray k.
    template <int Most, class Value>
    TR_HD void add(uint32_t i, Value &&value) const {
        const SightRecord<S> &r = from[i];
        const bool forward = gradients.to.forward;
        if (forward) film.tell_nothing(i);
        if (!r.kept) return;
        const SightSamples<S> samples(gradients.scene, gradients.config, view);
        double jumps[Most];
        for (int32_t c = 0; c < film.channels; ++c)
            jumps[c] = samples.jump(r.x, double(value(c, 2 * i)), double(value(c, 2 * i + 1)));
        const S w = forward ? S(1) : film.template contracted<Most>(r.place.x, r.place.y, jumps);
        if (w == 0 || !samples.is_finite(w)) return;
        gradients.with_sink(i, [&](GradientSink<S> &sink, auto &&glue) {
            DevicePointSink<S> points{sink};
            RayAdjoint<S> ray{{S(0), S(0), S(0)}, {S(0), S(0), S(0)}};
            samples.add(r.x, r.beside, w, points, glue, ray.o, ray.d);
            if (gradients.needs.camera && max_abs(ray.o) + max_abs(ray.d) > 0)
                sweep_camera<S>(gradients.scene, samples.sensor(), r.place, view.width, view.height, ray, S(0), true,
                                sink);
            if (!forward) return;
            film.place[2 * i] = double(r.place.x), film.place[2 * i + 1] = double(r.place.y);
            for (int32_t c = 0; c < film.channels; ++c)
                film.value[film.at(i, c)] = jumps[c] * double(sink.derivative[0]);
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        view.for_pointers(visit), gradients.for_pointers(visit), visit(from), film.for_pointers(visit);
    }
};

// ... of light.
template <class S>
struct AddSights {
    static constexpr const char *Name = TR_KERNEL_NAME(AddSights), *Header = "device/sight_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Derivative;
    bool adds() const { return sums.adds(); }
    SightSums<S> sums;
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    SpectrumColumn<S> radiance;
    const S *alpha;

    TR_HD void operator()(uint32_t i) const {
        sums.template add<SpectrumSize + 1>(
            i, [&](int32_t c, uint32_t k) { return c + 1 < sums.film.channels ? radiance[c][k] : alpha[k]; });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        sums.for_pointers(visit), radiance.each(visit), visit(alpha);
    }
};

// The sum of the squares of its components.
template <class S>
struct WeighSights {
    static constexpr const char *Name = TR_KERNEL_NAME(WeighSights), *Header = "device/sight_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    const SightRecord<S> *from;
    SpectrumColumn<S> radiance;
    int32_t values;
    double *to;

    TR_HD void operator()(uint32_t i) const {
        const SightSamples<S> samples(stage.scene, stage.config, stage.view);
        to[i] = 0;
        for (int32_t c = 0; c < values && from[i].kept; ++c) {
            const double jump = samples.jump(from[i].x, double(radiance[c][2 * i]), double(radiance[c][2 * i + 1]));
            to[i] += jump * jump;
        }
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(from), radiance.each(visit), visit(to);
    }
};

}  // namespace tr
