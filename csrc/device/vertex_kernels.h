// Vertices of the paths of samples of outlines as kernels, and what they see: outlines, see
// core/boundary/vertex_sights.h, and edges that lights have found, see core/boundary/shadows.h. An item is a sample or,
// where it is said, a vertex of the tape, a group of samples, or an outline that a vertex sees.
#pragma once

#include "boundary_stage.h"
#include "core/boundary/vertex_sights.h"
#include "shadow_kernels.h"

namespace tr {

// The levels of a tape, for kernels that walk along paths.
template <class S>
struct TapeLevelTable {
    TapeColumns<S> columns;
    const uint32_t *begin, *total;  // by kind
    int32_t parent_level;
};
template <class S>
struct TapeLevelTables {
    const TapeLevelTable<S> *at;
    uint32_t smooth;  // kinds with smooth lobes, a bit each

    TR_HD const TapeLevelTable<S> &operator[](int l) const { return at[l]; }
    // Whether entry i of a level is of such a kind.
    TR_HD bool is_smooth(int l, uint32_t i) const {
        for (uint32_t kind = 0; smooth >> kind != 0; ++kind)
            if ((smooth >> kind & 1u) && i - at[l].begin[kind] < at[l].total[kind]) return true;
        return false;
    }
};

// By slot, of the choice of vertices: what those of a path have in total, and up to one of them; and one over the
// probability of the chosen one.
struct VertexTotals {
    double *total, *before, *inverse;

    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(total), visit(before), visit(inverse);
    }
};

// Which samples the slots are, before their paths begin.
template <class S>
struct NumberOutlines {
    static constexpr const char *Name = TR_KERNEL_NAME(NumberOutlines), *Header = "device/vertex_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    SlotColumns<S> slots;
    AnchorColumns<S> anchors;
    VertexTotals totals;

    TR_HD void operator()(uint32_t i) const {
        const OutlineSamples<S> samples(stage.scene, stage.config, stage.view);
        const OutlineSample sample = stage.sample(i);
        const int64_t *cell = samples.cell(sample);
        slots.pixel[i] = sample.low, slots.sample[i] = sample.high;
        slots.column[i] = uint32_t(int32_t(cell[0])), slots.row[i] = uint32_t(int32_t(cell[1]));
        anchors.level[i] = NoVertex, totals.total[i] = totals.before[i] = 0;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), slots.for_arrays(visit), anchors.for_arrays(visit), totals.for_pointers(visit);
    }
};

// Places that were rounded up are in other pixels.
template <class S>
struct KeepInPixels {
    static constexpr const char *Name = TR_KERNEL_NAME(KeepInPixels), *Header = "device/vertex_kernels.h";
    SlotColumns<S> slots;

    TR_HD void operator()(uint32_t i) const {
        slots.film_x[i] = within_pixel(slots.film_x[i], slots.column[i]);
        slots.film_y[i] = within_pixel(slots.film_y[i], slots.row[i]);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        slots.for_arrays(visit);
    }
};

// Of vertices of one kind, whose kinds are smooth: adds what they bring up, or chooses one for each path. They count
// more close to `towards`, if there is one.
template <class S>
struct ChooseVertices {
    static constexpr const char *Name = TR_KERNEL_NAME(ChooseVertices), *Header = "device/vertex_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    VertexColumns<S> vertex;
    VectorColumn<S> place;
    int32_t kind;
    uint32_t level;
    const uint32_t *begin, *total;  // by kind
    int32_t values;
    VectorColumn<S> towards;  // by slot
    VertexTotals totals;
    AnchorColumns<S> anchors;
    bool chooses;

    TR_HD void operator()(uint32_t j) const {
        if (j >= total[kind]) return;
        const uint32_t e = begin[kind] + j, slot = vertex.slot[e];
        double factor = 1;
        if (towards.x) {
            const Vec3<S> apart = towards.get(slot) - place.get(e);
            factor = 1 / (double(dot(apart, apart)) + stage.view.near * stage.view.near);
        }
        const double weight = vertex_weight(vertex, e, values, factor);
        if (!(weight > 0)) return;
        if (!chooses) {
            totals.total[slot] += weight;
            return;
        }
        const OutlineSamples<S> samples(stage.scene, stage.config, stage.view);
        const double all = totals.total[slot], before = totals.before[slot],
                     at = double(samples.number(stage.sample(slot), 0)) * all;
        if (at >= before && at < before + weight)
            anchors.level[slot] = level, anchors.entry[slot] = e, totals.inverse[slot] = all / weight;
        totals.before[slot] = before + weight;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), vertex.for_arrays(visit), place.each(visit), visit(begin), visit(total);
        towards.each(visit), totals.for_pointers(visit), anchors.for_arrays(visit);
    }
};

// Of chosen vertices of one kind: the geometric normal and, `lobes`, how they scatter.
template <class S>
struct LookAtVertices {
    static constexpr const char *Name = TR_KERNEL_NAME(LookAtVertices), *Header = "device/vertex_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Bsdf;
    PathStage<S> stage;  // with the level
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    uint32_t level;
    const uint32_t *begin, *total;  // by kind
    AnchorColumns<S> anchors;
    bool lobes;

    TR_HD void operator()(uint32_t j) const {
        if (j >= total[kind]) return;
        const uint32_t i = begin[kind] + j, slot = stage.tape.vertex.slot[i];
        if (anchors.level[slot] != level || anchors.entry[slot] != i) return;
        find_normals<S>(stage.scene, stage.tape, i, slot, true, anchors);
        if (lobes) find_lobes<S>(stage.scene, Wavelengths<S>{}, kind, stage.tape, i, slot, true, anchors);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(begin), visit(total), anchors.for_arrays(visit);
    }
};

// f and density of directions from chosen vertices of one kind. An item is a direction, from the vertex of `slot`;
// null: from that of its own number.
template <class S>
struct ScatterTowards {
    static constexpr const char *Name = TR_KERNEL_NAME(ScatterTowards), *Header = "device/vertex_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Bsdf;
    PathStage<S> stage;  // with the level
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    uint32_t level;
    const uint32_t *begin, *total;  // by kind
    AnchorColumns<S> anchors;
    const uint32_t *slot_of;
    TowardsColumns<S> towards;

    TR_HD void operator()(uint32_t k) const {
        const uint32_t slot = slot_of ? slot_of[k] : k;
        if (slot == NoVertex || anchors.level[slot] != level) return;
        const uint32_t i = anchors.entry[slot];
        if (i - begin[kind] >= total[kind]) return;
        scatter_chosen<S>(stage.scene, Wavelengths<S>{}, kind, stage.tape, i, k, true, stage.needs, towards);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(begin), visit(total), anchors.for_arrays(visit), visit(slot_of);
        towards.for_arrays(visit);
    }
};

// ------------------------------------------------------------------------------------------ edges that vertices see
// Of groups of so many samples: which edges are left, an item being a group.
template <class S>
struct ListEdges {
    static constexpr const char *Name = TR_KERNEL_NAME(ListEdges), *Header = "device/vertex_kernels.h";
    const ShadowRecord<S> *from;
    uint32_t n, group;
    uint32_t *slots, *count;  // of a group, from its first slot on; and how many

    TR_HD void operator()(uint32_t g) const {
        const uint32_t begin = g * group, end = begin + group < n ? begin + group : n;
        uint32_t at = begin;
        for (uint32_t i = begin; i < end; ++i)
            if (from[i].kept) slots[at++] = i;
        count[g] = at - begin;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(from), visit(slots), visit(count);
    }
};

// Every path gets one of those of its group, see ShadowTile::share_edges; with the columns of its light.
template <class S>
struct ShareEdges {
    static constexpr const char *Name = TR_KERNEL_NAME(ShareEdges), *Header = "device/vertex_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    const ShadowRecord<S> *from;
    ShadowEdgeColumns<S> from_at;
    const uint32_t *slots, *count;
    uint32_t n, group;
    ShadowRecord<S> *to;
    ShadowEdgeColumns<S> to_at;

    TR_HD void operator()(uint32_t i) const {
        const uint32_t g = i / group, begin = g * group, size = begin + group < n ? group : n - begin;
        to_at.ratio[i] = 0, to_at.s.set(i, {S(0), S(0), S(0)});
        to[i].kept = to[i].connected = false;
        if (count[g] == 0) return;
        const OutlineSamples<S> samples(stage.scene, stage.config, stage.view);
        const uint32_t shift = samples.bits(stage.sample(begin), samples.PlaceBlock).bits[0];
        const uint32_t source = slots[begin + uint32_t((i - begin + size_t(shift)) % count[g])];
        to[i] = from[source];
        to[i].x.slot = i, to[i].connected = false;
        to[i].x.weight = to[i].x.weight * S(double(count[g]) / size);
        to_at.emitter[i] = from_at.emitter[source];
        to_at.at.set(i, from_at.at.get(source));
        to_at.y.set(i, from_at.y.get(source)), to_at.yn.set(i, from_at.yn.get(source));
        to_at.d.set(i, from_at.d.get(source)), to_at.s.set(i, from_at.s.get(source));
        to_at.e_distance[i] = from_at.e_distance[source], to_at.b_distance[i] = from_at.b_distance[source];
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(from), from_at.for_arrays(visit), visit(slots), visit(count), visit(to);
        to_at.for_arrays(visit);
    }
};

// The directions to them from chosen vertices, and how far they are.
template <class S>
struct AimAtEdges {
    static constexpr const char *Name = TR_KERNEL_NAME(AimAtEdges), *Header = "device/vertex_kernels.h";
    TapeLevelTables<S> levels;
    AnchorColumns<S> anchors;
    const ShadowRecord<S> *records;
    ShadowEdgeColumns<S> at;
    TowardsColumns<S> towards;

    TR_HD void operator()(uint32_t i) const {
        towards.d.set(i, {S(0), S(0), S(1)}), at.distance[i] = 0, towards.pdf[i] = 0;
        if (!records[i].kept || anchors.level[i] == NoVertex) return;
        const TapeVertex<S, const TapeLevelTables<S>> vertex{levels, anchors.level[i], anchors.entry[i]};
        const Vec3<S> way = at.s.get(i) - vertex.place();
        at.distance[i] = OutlineSamples<S>::length(way);
        towards.d.set(i, OutlineSamples<S>::unit(way));
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(levels.at), anchors.for_arrays(visit), visit(records), at.for_arrays(visit), towards.for_arrays(visit);
    }
};

// Rays to them, with what the paths carry along these, and the share of what is found from there that lights find.
template <class S>
struct SeeEdges {
    static constexpr const char *Name = TR_KERNEL_NAME(SeeEdges), *Header = "device/vertex_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Tracing;
    BoundaryStage<S> stage;
    TapeLevelTables<S> levels;
    AnchorColumns<S> anchors;
    const double *inverse;
    ShadowEdgeColumns<S> at;
    TowardsColumns<S> towards;
    EndRays<S> ends;
    S *apart;
    SpectrumColumn<S> carried;

    TR_HD void operator()(uint32_t i) const {
        ends.number(i, stage.sample(i), 0x80000000u);  // those of the path have chosen its BSDFs
        const S r = at.distance[i];
        if (!(r > 0) || !(towards.pdf[i] > 0)) return;
        const OutlineSamples<S> samples(stage.scene, stage.config, stage.view);
        const TapeVertex<S, const TapeLevelTables<S>> vertex{levels, anchors.level[i], anchors.entry[i]};
        const SpectrumColumn<S> &beta = vertex.columns().vertex.beta;
        const S factor = S(inverse[i]) * S(stage.view.n_cells) / (r * r);
        S sum = 0, most = 0;
        for (int c = 0; c < SpectrumSize; ++c) {
            const S x = towards.f[c][i] * beta[c][vertex.entry] * factor;
            carried[c][i] = x, sum += x, most = std::max(most, std::fabs(x));
        }
        if (!(most > 0) || !samples.is_finite(sum)) return;
        apart[i] = S(samples.apart(double(r)));
        const Vec3<S> d = towards.d.get(i), p = vertex.place();
        ends.begin(i, offset_origin(p, anchors.ng.get(i), d), d, S(INFINITY), p, S(1));
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(levels.at), anchors.for_arrays(visit), visit(inverse);
        at.for_arrays(visit), towards.for_arrays(visit), ends.for_pointers(visit), visit(apart), carried.each(visit);
    }
};

// --------------------------------------------------------------------------------------- outlines that vertices see
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
    static constexpr const char *Name = TR_KERNEL_NAME(SlideVertices), *Header = "device/vertex_kernels.h";
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
    static constexpr const char *Name = TR_KERNEL_NAME(ShareOutlines), *Header = "device/vertex_kernels.h";
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
    static constexpr const char *Name = TR_KERNEL_NAME(ChooseOutlines), *Header = "device/vertex_kernels.h";
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
    static constexpr const char *Name = TR_KERNEL_NAME(FindOutlines), *Header = "device/vertex_kernels.h";
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
    static constexpr const char *Name = TR_KERNEL_NAME(LookPastOutlines), *Header = "device/vertex_kernels.h";
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
    static constexpr const char *Name = TR_KERNEL_NAME(StartOutlines), *Header = "device/vertex_kernels.h";
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
    static constexpr const char *Name = TR_KERNEL_NAME(TakeOutlines), *Header = "device/vertex_kernels.h";
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
    static constexpr const char *Name = TR_KERNEL_NAME(AddOutlines), *Header = "device/vertex_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Derivative;
    bool adds() const { return !gradients.to.fixed && !gradients.to.forward; }
    BoundaryView<S> view;
    BoundaryGradients<S> gradients;
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    VertexShares shares;
    const OutlineRecord<S> *records;
    SlotColumns<S> slots;
    VectorColumn<S> p_bar;
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
            if (sink.forward) add_to_entries<S>(slots.radiance, i, sink.derivative, true);
        });
        p_bar.set(i, place);
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        view.for_pointers(visit), gradients.for_pointers(visit), shares.for_pointers(visit), visit(records);
        slots.for_arrays(visit), p_bar.each(visit), film.for_pointers(visit);
    }

private:
    TR_HD S weight(uint32_t i, const Spectrum<S> &jump) const {
        if (gradients.to.forward) return jump[gradients.to.component];
        double jumps[BoundaryFilm<S>::MostOutlineChannels] = {};
        bool some = false;
        for (int c = 0; c + 1 < film.channels; ++c) jumps[c] = double(jump[c]), some |= jump[c] != 0;
        return some ? film.contracted(slots.film_x[i], slots.film_y[i], jumps) : S(0);
    }
};

// The sum of the squares of what they bring.
template <class S>
struct WeighOutlines {
    static constexpr const char *Name = TR_KERNEL_NAME(WeighOutlines), *Header = "device/vertex_kernels.h";
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

// In forward mode, what the samples add to the film.
template <class S>
struct TellOutlines {
    static constexpr const char *Name = TR_KERNEL_NAME(TellOutlines), *Header = "device/vertex_kernels.h";
    SlotColumns<S> slots;
    BoundaryFilm<S> film;

    TR_HD void operator()(uint32_t i) const {
        film.place[2 * i] = double(slots.film_x[i]), film.place[2 * i + 1] = double(slots.film_y[i]);
        for (int32_t c = 0; c < film.channels; ++c)
            film.value[size_t(i) * size_t(film.channels) + size_t(c)] =
                c + 1 < film.channels ? double(slots.radiance[c][i]) : 0;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        slots.for_arrays(visit), film.for_pointers(visit);
    }
};

}  // namespace tr
