// Vertices of the paths of samples of outlines as kernels: which one of a path looks out, and how it scatters. An item
// is a sample or, where it is said, a vertex of the tape.
#pragma once

#include "boundary_stage.h"
#include "core/boundary/anchors.h"
#include "revisit_parts.h"

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

}  // namespace tr
