// Outlines that vertices of paths see as kernels: see core/boundary/vertex_sights.h. An item is a sample or, where it
// is said, a group of samples, or an outline that a vertex sees.
#pragma once

#include "core/boundary/vertex_sights.h"
#include "vertex_kernels.h"

namespace tr {

template <class S>
struct OutlineRecord {
    VertexSight<S> x;
    OutlineRay<S> beside[2];
    Spectrum<S> jump[2];  // on both sides
    bool kept;
};

// By slot: how many outlines its vertex looks past, and the first of these.
struct VertexShares {
    uint32_t *copies, *begin;

    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(copies), visit(begin);
    }
};
// Outlines that a group of so many samples has room for: the sum of copies is rounded.
TR_HD constexpr uint32_t room_of(uint32_t group) { return group + 2; }

// What is shared out: where vertices slide over surfaces more, see VertexSamples::sliding.
template <class S>
struct SlideVertices {
    static constexpr const char *Name = TR_KERNEL_NAME(SlideVertices), *Header = "device/vertex_outline_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    TapeLevelTables<S> levels;
    AnchorColumns<S> anchors;
    VertexTotals totals;
    const uint8_t *moves;  // by shape

    TR_HD void operator()(uint32_t i) const {
        double &total = totals.total[i];
        if (anchors.level[i] == NoVertex) total = 0;
        if (!(total > 0)) return;
        const VertexSamples<S> samples(stage.scene, stage.config, stage.view);
        const TapeVertex<S, const TapeLevelTables<S>> vertex{levels, anchors.level[i], anchors.entry[i]};
        total = samples.sliding(total, vertex.moves(moves), vertex.columns().arrival.segment.get(vertex.entry),
                                anchors.ng.get(i));
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(levels.at), anchors.for_arrays(visit), totals.for_pointers(visit);
        visit(moves);
    }
};

// An item is a group, which has room_of(group) outlines from the same number times its own on: `slots`, of their
// vertices.
template <class S>
struct ShareOutlines {
    static constexpr const char *Name = TR_KERNEL_NAME(ShareOutlines), *Header = "device/vertex_outline_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    VertexTotals totals;
    uint32_t n, group;
    VertexShares shares;
    uint32_t *slots;

    TR_HD void operator()(uint32_t g) const {
        const OutlineSamples<S> samples(stage.scene, stage.config, stage.view);
        const uint32_t begin = g * group, size = begin + group < n ? group : n - begin;
        const double u = double(uniform_of<S>(samples.bits(stage.sample(begin), samples.PlaceBlock).bits[0]));
        share_out(totals.total + begin, size, u, totals.inverse + begin, shares.copies + begin);
        uint32_t at = g * room_of(group);
        const uint32_t end = at + room_of(group);
        for (uint32_t i = begin; i < begin + size; ++i) {
            shares.begin[i] = at;
            for (uint32_t k = 0; k < shares.copies[i] && at < end; ++k) slots[at++] = i;
            shares.copies[i] = at - shares.begin[i];
        }
        while (at < end) slots[at++] = NoVertex;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), totals.for_pointers(visit), shares.for_pointers(visit), visit(slots);
    }
};

// All outlines of a vertex at once.
template <class S>
struct ChooseOutlines {
    static constexpr const char *Name = TR_KERNEL_NAME(ChooseOutlines), *Header = "device/vertex_outline_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    TapeLevelTables<S> levels;
    AnchorColumns<S> anchors;
    VertexShares shares;
    const uint8_t *moves;  // by shape
    OutlineChoice *choices;

    TR_HD void operator()(uint32_t i) const {
        if (shares.copies[i] == 0) return;
        const OutlineSamples<S> samples(stage.scene, stage.config, stage.view);
        const TapeVertex<S, const TapeLevelTables<S>> vertex{levels, anchors.level[i], anchors.entry[i]};
        const OutlineAnchor from = vertex.anchor(anchors, i, samples.still(vertex.moves(moves)));
        choose_outlines(stage.view.outlines.tree, from, samples.tree_seed(stage.sample(i)), MostOutlineDescents,
                        choices + shares.begin[i], shares.copies[i]);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(levels.at), anchors.for_arrays(visit), shares.for_pointers(visit);
        visit(moves), visit(choices);
    }
};

// Those that are seen, an item each: where they are, and the directions there.
template <class S>
struct FindOutlines {
    static constexpr const char *Name = TR_KERNEL_NAME(FindOutlines), *Header = "device/vertex_outline_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    TapeLevelTables<S> levels;
    AnchorColumns<S> anchors;
    VertexShares shares;
    const double *inverse;  // by slot
    const uint32_t *slots;
    const OutlineChoice *choices;
    OutlineRecord<S> *to;
    TowardsColumns<S> towards;

    TR_HD void operator()(uint32_t k) const {
        OutlineRecord<S> r{};
        const uint32_t slot = slots[k];
        towards.d.set(k, {S(0), S(0), S(1)}), towards.pdf[k] = 0;
        for (int c = 0; c < SpectrumSize; ++c) towards.f[c][k] = 0;
        if (slot != NoVertex) {
            const VertexSamples<S> samples(stage.scene, stage.config, stage.view);
            const TapeVertex<S, const TapeLevelTables<S>> vertex{levels, anchors.level[slot], anchors.entry[slot]};
            r.x.slot = slot, r.x.copy = k - shares.begin[slot], r.x.from = vertex.place();
            Vec3<S> d;
            r.kept = samples.find(choices[k], vertex.point(), S(inverse[slot]), r.x, d);
            if (r.kept) towards.d.set(k, d);
        }
        to[k] = r;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(levels.at), anchors.for_arrays(visit), shares.for_pointers(visit);
        visit(inverse), visit(slots), visit(choices), visit(to), towards.for_arrays(visit);
    }
};

// What they bring, and rays beside them, an item each.
template <class S>
struct LookPastOutlines {
    static constexpr const char *Name = TR_KERNEL_NAME(LookPastOutlines), *Header = "device/vertex_outline_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    TapeLevelTables<S> levels;
    AnchorColumns<S> anchors;
    TowardsColumns<S> towards;
    OutlineRecord<S> *records;

    TR_HD void operator()(uint32_t k) const {
        OutlineRecord<S> &r = records[k];
        if (r.kept) r.kept = weigh(k, r.x) && look_past(r);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(levels.at), anchors.for_arrays(visit), towards.for_arrays(visit);
        visit(records);
    }

private:
    TR_HD bool weigh(uint32_t k, VertexSight<S> &x) const {
        const VertexSamples<S> samples(stage.scene, stage.config, stage.view);
        const uint32_t level = anchors.level[x.slot], entry = anchors.entry[x.slot];
        const TapeColumns<S> &columns = levels[int(level)].columns;
        Spectrum<S> f, beta;
        for (int c = 0; c < SpectrumSize; ++c) f[c] = towards.f[c][k], beta[c] = columns.vertex.beta[c][entry];
        if (!samples.weigh(x, f, beta)) return false;
        x.density = samples.density(x, stage.sample(x.slot), towards.pdf[k], anchors.ng.get(x.slot), towards.d.get(k),
                                    level == 0, [&] { return seen_from(columns, int(level), entry); });
        return true;
    }
    TR_HD double seen_from(const TapeColumns<S> &columns, int level, uint32_t entry) const {
        const uint32_t parent = columns.vertex.parent[entry];
        if (!levels.is_smooth(level - 1, parent) || levels[level - 1].columns.outgoing.lobe[parent] != 0) return -1;
        return double(OutlineSamples<S>::length(columns.arrival.segment.get(entry)));
    }
    TR_HD bool look_past(OutlineRecord<S> &r) const {
        const VertexSamples<S> samples(stage.scene, stage.config, stage.view);
        const Vec3<S> ng = anchors.ng.get(r.x.slot);
        const auto none = [](uint32_t) { return false; };
        for (int h = 0; h < 2; ++h) {
            r.beside[h] = samples.ray_beside(r.x, ng, S(h == 0 ? -1 : 1));
            stage.trace(r.beside[h], S(INFINITY), none);
        }
        accumulate(stage.traced, uint64_t(2));
        CloserRay<S> wanted[2];
        OutlineRay<S> closer[2];
        if (r.x.folded) samples.look_closer(r.x, r.beside[0].o, wanted);
        for (int h = 0; h < 2 && r.x.folded; ++h) closer[h] = stage.trace(samples, wanted[h], none);
        return samples.is_open(r.x, r.beside, wanted, closer);
    }
};

// The rays beside those whose vertices are on a level, an item each.
template <class S>
struct StartOutlines {
    static constexpr const char *Name = TR_KERNEL_NAME(StartOutlines), *Header = "device/vertex_outline_kernels.h";
    const OutlineRecord<S> *records;
    const uint32_t *level_of;  // by slot
    uint32_t level;
    uint64_t first;  // the number of the first sample
    LightRays<S> rays;

    TR_HD void operator()(uint32_t i) const {
        const OutlineRecord<S> &r = records[i / 2];
        rays.key[i] = Gone;
        if (!r.kept || level_of[r.x.slot] != level) return;
        const uint32_t sample = uint32_t(first + r.x.slot);
        rays.begin(i, r.beside[i % 2], S(INFINITY), r.x.density, sample ^ r.x.copy << CopyBit);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(records), visit(level_of), rays.for_pointers(visit);
    }
};

// ... and what light along them brings.
template <class S>
struct TakeOutlines {
    static constexpr const char *Name = TR_KERNEL_NAME(TakeOutlines), *Header = "device/vertex_outline_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    OutlineRecord<S> *records;
    const uint32_t *level_of;
    uint32_t level;
    SpectrumColumn<S> radiance;

    TR_HD void operator()(uint32_t k) const {
        OutlineRecord<S> &r = records[k];
        if (!r.kept || level_of[r.x.slot] != level) return;
        const VertexSamples<S> samples(stage.scene, stage.config, stage.view);
        for (int h = 0; h < 2; ++h) {
            const S sign = samples.sign_of(r.x, h);
            for (int c = 0; c < SpectrumSize; ++c) {
                const S light = radiance[c][2 * k + uint32_t(h)];
                r.jump[h][c] = sign != 0 && samples.is_finite(light) ? r.x.carried[c] * light * sign : S(0);
            }
        }
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(records), visit(level_of), radiance.each(visit);
    }
};

// What they hand on, an item being a slot with all of its own.
template <class S>
struct AddOutlines {
    static constexpr const char *Name = TR_KERNEL_NAME(AddOutlines), *Header = "device/vertex_outline_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Derivative;
    bool adds() const { return !gradients.to.fixed && !gradients.to.forward; }
    BoundaryView<S> view;
    BoundaryGradients<S> gradients;
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    TapeLevelTables<S> levels;
    AnchorColumns<S> anchors;  // which get the adjoints of their places, also of those that are glued to surfaces
    VertexShares shares;
    const OutlineRecord<S> *records;
    SlotColumns<S> slots;
    BoundaryFilm<S> film;

    TR_HD void operator()(uint32_t i) const {
        const VertexSamples<S> samples(gradients.scene, gradients.config, view);
        Vec3<S> place{S(0), S(0), S(0)};
        gradients.with_sink(i, [&](GradientSink<S> &sink, auto &&glue) {
            for (uint32_t k = shares.begin[i]; k < shares.begin[i] + shares.copies[i]; ++k) {
                const OutlineRecord<S> &r = records[k];
                if (!r.kept) continue;
                const S weights[2] = {weight(i, r.jump[0]), weight(i, r.jump[1])};
                DevicePointSink<S> points{sink};
                place = place + samples.add(r.x, weights, points, glue);
            }
            if (view.glued && max_abs(place) > 0) {
                const TapeVertex<S, const TapeLevelTables<S>> vertex{levels, anchors.level[i], anchors.entry[i]};
                glue(vertex.point(), vertex.place(), place);
            }
            if (sink.forward) add_to_entries<S>(slots.radiance, i, sink.derivative, true);
        });
        anchors.p_bar.set(i, place);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        view.for_pointers(visit), gradients.for_pointers(visit), visit(levels.at), anchors.for_arrays(visit);
        shares.for_pointers(visit), visit(records), slots.for_arrays(visit), film.for_pointers(visit);
    }

private:
    TR_HD S weight(uint32_t i, const Spectrum<S> &jump) const {
        if (gradients.to.forward) return jump[gradients.to.component];
        constexpr int Most = SpectrumSize + 1;
        double jumps[Most] = {};
        bool some = false;
        for (int c = 0; c + 1 < film.channels; ++c) jumps[c] = double(jump[c]), some |= jump[c] != 0;
        return some ? film.template contracted<Most>(slots.film_x[i], slots.film_y[i], jumps) : S(0);
    }
};

// The sum of the squares of what they bring.
template <class S>
struct WeighOutlines {
    static constexpr const char *Name = TR_KERNEL_NAME(WeighOutlines), *Header = "device/vertex_outline_kernels.h";
    VertexShares shares;
    const OutlineRecord<S> *records;
    int32_t values;
    double *to;

    TR_HD void operator()(uint32_t i) const {
        to[i] = 0;
        for (uint32_t k = shares.begin[i]; k < shares.begin[i] + shares.copies[i]; ++k)
            for (int32_t c = 0; c < values && records[k].kept; ++c) {
                const double both = double(records[k].jump[0][c]) + double(records[k].jump[1][c]);
                to[i] += both * both;
            }
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        shares.for_pointers(visit), visit(records), visit(to);
    }
};

}  // namespace tr
