// Samples of outlines that lights see as kernels: see core/boundary/shadows.h. An item is a sample, but of the tape's
// vertices.
#pragma once

#include "boundary_stage.h"
#include "core/boundary/shadows.h"
#include "revisit_parts.h"

namespace tr {

template <class S>
struct ShadowRecord {
    ShadowEdge<S> x;
    bool kept;
    S area;            // of a pixel of the camera, at S
    Spectrum<S> jump;  // of what sees S
    bool connected;
};

// Rays to the ends S of edges, in entries that begin with their slots.
template <class S>
struct EndRays {
    SlotColumns<S> slots;
    PathQueue<S> out;
    int32_t *key;

    TR_HD void number(uint32_t i, const OutlineSample &sample, uint32_t other) const {
        slots.pixel[i] = sample.low, slots.sample[i] = sample.high ^ other;
        key[i] = Gone;
    }
    TR_HD void begin(uint32_t i, const Vec3<S> &o, const Vec3<S> &d, S length, const Vec3<S> &from, S pdf) const {
        out.o.set(i, o), out.d.set(i, d), out.from.set(i, from);
        out.length[i] = length, out.pdf[i] = pdf, out.eta[i] = 1;
        for (int c = 0; c < SpectrumSize; ++c) out.beta[c][i] = out.survival[c][i] = 1;
        out.slot[i] = i, out.parent[i] = 0, out.seen[i] = 1;
        key[i] = Kept;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        slots.for_arrays(visit), visit(slots.lens.x), visit(slots.lens.y), out.for_arrays(visit), visit(key);
    }
};

// Edges before lights, the ends of rays past them, and rays from the camera to these.
template <class S>
struct FindEdges {
    static constexpr const char *Name = TR_KERNEL_NAME(FindEdges), *Header = "device/shadow_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    LightList lights;
    ShadowChoice choice;
    SamplerConfig sequence;
    const uint8_t *moves;  // by shape
    ShadowEdgeColumns<S> at;
    ShadowRecord<S> *to;
    EndRays<S> ends;

    TR_HD void operator()(uint32_t i) const {
        const ShadowSamples<S> samples(stage.scene, stage.config, stage.view, choice);
        const OutlineSample sample = stage.sample(i);
        ShadowRecord<S> r{};
        at.ratio[i] = 0;
        ends.number(i, sample, 0);
        r.kept = find(samples, sample, i, r.x);
        if (r.kept) see_from_camera(samples, sample, i, r);
        to[i] = r;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), lights.for_pointers(visit), choice.for_pointers(visit), visit(moves);
        at.for_arrays(visit), visit(to), ends.for_pointers(visit);
    }

private:
    TR_HD bool find(const ShadowSamples<S> &samples, const OutlineSample &sample, uint32_t i, ShadowEdge<S> &x) const {
        const ShadowLights<S> on(stage.scene, lights);
        const Random4<S> u = samples.template spread<S>(sequence, sample.number()),
                         more = random4<S>(stage.config.seed, stage.config.sensor, sample.low, sample.high,
                                           OutlineSamples<S>::PlaceBlock);
        on.choose(at, i, double(u.u[0]));
        const S number = at.left[i];
        at.left[i] = u.u[3];
        if (choice.emitter >= 0) at.emitter[i] = choice.emitter, at.inverse_pmf[i] = S(1);
        on.find_places(at, i, true, {{u.u[1], u.u[2], more.u[2], more.u[3]}});
        OutlineRay<S> ray;
        if (!samples.find(sample, i, at, on.place(at, i), moves, number, x, ray)) return false;
        const auto none = [](uint32_t) { return false; };
        const bool hidden = x.far && stage.is_hidden(ray.o, -ray.d);
        stage.trace(ray, S(INFINITY), none);
        accumulate(stage.traced, uint64_t(1));
        if (x.folded) {
            const CloserRay<S> wanted = samples.look_closer(x, ray);
            samples.end_sooner(x, wanted, stage.trace(samples, wanted, none), ray);
        }
        return samples.end(x, ray, hidden, at);
    }
    TR_HD void see_from_camera(const ShadowSamples<S> &samples, const OutlineSample &sample, uint32_t i,
                               ShadowRecord<S> &r) const {
        CameraSample<S> place = samples.lens_of(sample);
        const Vec3<S> s = at.s.get(i);
        if (!samples.sees(s, place)) return;
        const CameraRay<S> ray = samples.ray_of(place);
        if (!ray.exists) return;
        ends.slots.film_x[i] = place.x, ends.slots.film_y[i] = place.y;
        if (ends.slots.lens.x) ends.slots.lens.x[i] = place.lens_x, ends.slots.lens.y[i] = place.lens_y;
        at.distance[i] = samples.length(s - ray.ray.o);
        r.area = samples.pixel_area(place, ray.ray.d, samples.length(s - ray.center));
        ends.begin(i, ray.ray.o, ray.ray.d, ray.length, ray.center, S(0));
    }
};

// Vertices of one kind that those rays have found, where that is S: what they get of the light. Numbers: see shade_end.
template <class S>
struct ShadeEnds {
    static constexpr const char *Name = TR_KERNEL_NAME(ShadeEnds), *Header = "device/shadow_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Bsdf;
    PathStage<S> stage;  // with the level
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    const uint32_t *begin, *total;  // by kind
    LightList lights;
    ShadowEdgeColumns<S> at;
    double near, in_view;
    int32_t emitter_samples, bsdf_samples;

    TR_HD void operator()(uint32_t j) const {
        if (j >= total[kind]) return;
        const uint32_t i = begin[kind] + j, slot = stage.tape.vertex.slot[i];
        if (!meets_end<S>(at, stage.tape, i, slot, true)) return;
        const ShadowLights<S> on(stage.scene, lights);
        shade_end<S>(stage.scene, Wavelengths<S>{}, on, at, stage.tape, kind, i, slot, true, stage.needs, near, in_view,
                     emitter_samples, bsdf_samples);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(begin), visit(total), lights.for_pointers(visit), at.for_arrays(visit);
    }
};

// What the camera, or the vertex of a path, gets of edges: a number and colours of each, null: the camera's.
template <class S>
struct ConnectEdges {
    static constexpr const char *Name = TR_KERNEL_NAME(ConnectEdges), *Header = "device/shadow_kernels.h";
    ShadowEdgeColumns<S> at;
    ShadowRecord<S> *records;
    const S *factor;  // of vertices
    SpectrumColumn<S> carried;

    TR_HD void operator()(uint32_t i) const {
        ShadowRecord<S> &r = records[i];
        r.connected = false;
        if (!r.kept || !(at.ratio[i] > 0)) return;
        const S mis = at.mis[i] < 0 ? S(1) : at.mis[i];
        const S number = factor ? at.ratio[i] * r.x.weight * (at.mis[i] < 0 ? S(1) : factor[i] * mis)
                                : at.ratio[i] * r.x.weight * mis / r.area;
        bool some = false;
        for (int c = 0; c < SpectrumSize; ++c) {
            r.jump[c] = -at.value[c][i] * number * (factor ? carried[c][i] : S(1));
            if (!OutlineSamples<S>::is_finite(r.jump[c])) return;
            some |= r.jump[c] != 0;
        }
        r.connected = some;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        at.for_arrays(visit), visit(records), visit(factor), carried.each(visit);
    }
};

// The sum of the squares of what they bring or, `sizes`, of its size.
template <class S>
struct WeighEdges {
    static constexpr const char *Name = TR_KERNEL_NAME(WeighEdges), *Header = "device/shadow_kernels.h";
    const ShadowRecord<S> *records;
    int32_t values;
    bool sizes;
    double *to;

    TR_HD void operator()(uint32_t i) const {
        const ShadowRecord<S> &r = records[i];
        to[i] = 0;
        for (int32_t c = 0; c < values && r.connected; ++c) {
            const auto x = double(r.jump[c]);
            to[i] += sizes ? std::fabs(x) : x * x;
        }
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(records), visit(to);
    }
};

// What is handed on by these.
template <class S>
struct AddEdges {
    static constexpr const char *Name = TR_KERNEL_NAME(AddEdges), *Header = "device/shadow_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Derivative;
    bool adds() const { return !gradients.to.fixed && !gradients.to.forward; }
    BoundaryView<S> view;
    BoundaryGradients<S> gradients;
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    LightList lights;
    ShadowEdgeColumns<S> at;
    const ShadowRecord<S> *records;
    SlotColumns<S> slots;  // whose places those are, and whose radiance gets derivatives
    VectorColumn<S> p_bar;
    BoundaryFilm<S> film;

    TR_HD void operator()(uint32_t i) const {
        const ShadowRecord<S> &r = records[i];
        const Vec3<S> zero{S(0), S(0), S(0)};
        at.s_bar.set(i, zero), at.e_bar.set(i, zero), p_bar.set(i, zero);
        if (!r.connected) return;
        constexpr int Most = SpectrumSize + 1;
        double jumps[Most] = {};
        for (int c = 0; c + 1 < film.channels; ++c) jumps[c] = double(r.jump[c]);
        const S w = gradients.to.forward ? r.jump[gradients.to.component]
                                         : film.template contracted<Most>(slots.film_x[i], slots.film_y[i], jumps);
        if (w == 0 || !OutlineSamples<S>::is_finite(w)) return;
        const ShadowSamples<S> samples(gradients.scene, gradients.config, view, {});
        gradients.with_sink(i, [&](GradientSink<S> &sink, auto &&glue) {
            DevicePointSink<S> points{sink};
            samples.add(r.x, w, at, points, glue);
            if (sink.forward) add_to_entries<S>(slots.radiance, i, sink.derivative, true);
            ShadowLights<S>(gradients.scene, lights).sweep(at, i, true, slots, sink);
        });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        view.for_pointers(visit), gradients.for_pointers(visit), lights.for_pointers(visit), at.for_arrays(visit);
        visit(records), slots.for_arrays(visit), p_bar.each(visit), film.for_pointers(visit);
    }
};

// In forward mode, what the samples add to the film; of the pilot whether there is an edge, and where the camera sees
// it if it does. Without records all samples have a place.
template <class S>
struct TellEdges {
    static constexpr const char *Name = TR_KERNEL_NAME(TellEdges), *Header = "device/shadow_kernels.h";
    const ShadowRecord<S> *records;
    SlotColumns<S> slots;
    BoundaryFilm<S> film;
    bool pilot;

    TR_HD void operator()(uint32_t i) const {
        const bool placed = !records || records[i].connected;
        for (int k = 0; k < 2; ++k) {
            const S x = k == 0 ? slots.film_x[i] : slots.film_y[i];
            film.place[2 * i + uint32_t(k)] = placed ? double(x) : pilot ? double(NAN) : 0;
        }
        if (pilot) {
            film.value[i] = records[i].kept ? 1 : 0;
            return;
        }
        for (int32_t c = 0; c < film.channels; ++c)
            film.value[film.at(i, c)] = placed && c + 1 < film.channels ? double(slots.radiance[c][i]) : 0;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(records), slots.for_arrays(visit), film.for_pointers(visit);
    }
};

// The adjoints of places of vertices of one kind to what moves them: of chosen ones, or of all.
template <class S>
struct SweepPlaces {
    static constexpr const char *Name = TR_KERNEL_NAME(SweepPlaces), *Header = "device/shadow_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Derivative;
    bool adds() const { return !to.fixed; }
    PathStage<S> stage;  // with the level
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    uint32_t level;
    bool scatters;
    const uint32_t *begin, *total;  // by kind
    TapeBefore<S> before;
    DerivativePlaces<S> to;
    bool from_camera;
    const uint32_t *levels, *entry;  // by slot, of the chosen ones; null: all are
    VectorColumn<S> p_bar;           // by slot, of these
    VectorColumn<S> o_bar;           // ... of rays' origins, where they are not the camera's; null: nobody wants them

    TR_HD void operator()(uint32_t j) const {
        if (j >= total[kind]) return;
        const uint32_t i = begin[kind] + j, slot = stage.tape.vertex.slot[i];
        const bool chosen = !levels || (levels[slot] == level && entry[slot] == i);
        const Vec3<S> zero{S(0), S(0), S(0)}, own = chosen ? p_bar.get(slot) : zero;
        const NextColumns<S> &next = stage.tape.next;
        const Vec3<S> o_next = next.ray_o_bar.get(i), d_next = next.ray_d_bar.get(i);
        const S some = max_abs(own) + max_abs(o_next) + max_abs(d_next);
        if (some == 0) return;
        if (some > 0) sweep(i, slot, own);
        next.ray_o_bar.set(i, zero), next.ray_d_bar.set(i, zero);  // the next sweep finds none of this
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(begin), visit(total), before.for_pointers(visit), to.for_pointers(visit);
        visit(levels), visit(entry), p_bar.each(visit), o_bar.each(visit);
    }

private:
    TR_HD void sweep(uint32_t i, uint32_t slot, const Vec3<S> &own) const {
        TapeColumns<S> parents{};
        parents.next = before.next;
        const bool first = !before.next.ray_o_bar.x;
        const SweepContext<S> c{stage.scene,  stage.config, stage.slots, stage.needs, stage.width,
                                stage.height, nullptr,      false,       from_camera};
        GradientSink<S> sink = to.sink(i);
        const Vec3<S> origin =
            sweep_place<S>(c, stage.tape, first ? nullptr : &parents, kind, scatters, i, own, true, sink);
        if (first && !from_camera && o_bar.x) o_bar.set(slot, origin);
        if (sink.non_finite != 0 && !to.measures) accumulate(to.non_finite, uint64_t(sink.non_finite));
    }
};

}  // namespace tr
