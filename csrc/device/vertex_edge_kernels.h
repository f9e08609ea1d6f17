// Edges that lights have found, as vertices of paths see them, as kernels: see core/boundary/shadows.h. An item is a
// sample or, where it is said, a group of samples.
#pragma once

#include "shadow_kernels.h"
#include "vertex_kernels.h"

namespace tr {

// Of groups of so many samples: which edges are left, an item being a group.
template <class S>
struct ListEdges {
    static constexpr const char *Name = TR_KERNEL_NAME(ListEdges), *Header = "device/vertex_edge_kernels.h";
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
    static constexpr const char *Name = TR_KERNEL_NAME(ShareEdges), *Header = "device/vertex_edge_kernels.h";
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
    static constexpr const char *Name = TR_KERNEL_NAME(AimAtEdges), *Header = "device/vertex_edge_kernels.h";
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
    static constexpr const char *Name = TR_KERNEL_NAME(SeeEdges), *Header = "device/vertex_edge_kernels.h";
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

}  // namespace tr
