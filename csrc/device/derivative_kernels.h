// The sweep over the tape as a kernel, an item of which is a vertex.
//
// Gradients are sums over many vertices at once: those of the small parameters are kept in copies, side by side, so
// that neighbouring items add to neighbouring places; those of texels lie apart as they are.
#pragma once

#include "core/adjoint/sweep.h"
#include "path_stage.h"
#if defined(__CUDACC_RTC__)
#include "adjoint_parts.h"
#endif

namespace tr {

// Where derivatives go, see GradientSink: gradients, or in forward mode tangents that the samples' radiance gets the
// derivatives by.
template <class S>
struct DerivativePlaces {
    double *constants;  // (n, copies)
    uint32_t copies;
    S *const *tensors;  // by slot, null where it is not wanted
    double *vertices[VertexArrays];
    Values<S> tangent;
    const S *vertex_tangent[VertexArrays];
    TR_FACT(bool, forward, TR_FORWARD);
    int32_t component;  // in forward mode, where something moves
    uint32_t matrices;
    const int32_t *shape_wanted;
    uint64_t *non_finite;
    TR_FACT(bool, fixed, TR_FIXED_SUMS);  // all gradients are FixedSums, see GradientSink
    bool measures;

    TR_HD GradientSink<S> sink(uint32_t item) const {
        GradientSink<S> r;
#if !defined(TR_ONE_SCENE)
        r.forward = forward, r.fixed = fixed;
#endif
        const size_t own = (fixed ? sizeof(FixedSum<S>) / sizeof(double) : 1) * (item % copies);
        r.copies = copies, r.constants = constants ? constants + own : nullptr, r.measures = measures;
        r.tensors = tensors, r.tangent = tangent;
        for (int k = 0; k < VertexArrays; ++k) r.vertices[k] = vertices[k], r.vertex_tangent[k] = vertex_tangent[k];
        r.component = component, r.matrices = matrices, r.shape_wanted = shape_wanted;
        return r;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(constants), visit(static_cast<const void *>(tensors)), visit(tangent.constants), visit(tangent.tensors),
            visit(non_finite);
        for (int k = 0; k < VertexArrays; ++k) visit(vertices[k]), visit(vertex_tangent[k]);
        visit(shape_wanted);
    }
};

// What vertices hand to those before them; null: there are none.
template <class S>
struct TapeBefore {
    SpectrumColumn<S> suffix{};
    NextColumns<S> next{};
    VectorColumn<S> rest{}, from{};  // through media

    template <class Visit>
    void for_pointers(Visit &&visit) const {
        suffix.each(visit), next.for_arrays(visit), rest.each(visit), from.each(visit);
    }
};

// Of paths that have gone on from differential samples of segments (BranchColumns): where they began, and what they
// have brought; null: there are none.
template <class S>
struct BranchEnds {
    IndexColumn<S> level{}, entry{};
    SpectrumColumn<S> radiance{};

    template <class Visit>
    void for_pointers(Visit &&visit) const {
        level.each(visit), entry.each(visit), radiance.each(visit);
    }
};

// Vertices of one kind on a level of the tape: those of the kind from `begin` on, `total` of them. `unit_adjoint`: see
// SweepContext.
template <class S>
struct SweepVertices {
    static constexpr const char *Name = TR_KERNEL_NAME(SweepVertices), *Header = "device/derivative_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Derivative;
    bool adds() const { return !to.fixed; }
    PathStage<S> stage;  // with the level
    TR_MODEL_FACT(int32_t, kind, TR_BSDF_KIND);
    uint32_t level;
    bool scatters;
    const uint32_t *begin, *total;  // by kind
    TapeBefore<S> before;
    BranchEnds<S> branches;
    DerivativePlaces<S> to;
    bool unit_adjoint;

    TR_HD void operator()(uint32_t j) const {
        for_vertex(j, [&](const SweepContext<S> &c, const TapeColumns<S> &parents, uint32_t i, GradientSink<S> &sink) {
            sweep_vertex<S>(c, stage.tape, &parents, level, kind, scatters, i, true, sink);
        });
    }
    // Calls sweep(context, parents, i, sink) for vertex j of the kind.
    template <class Sweep>
    TR_HD void for_vertex(uint32_t j, Sweep &&sweep) const {
        if (j >= total[kind]) return;
        const uint32_t i = begin[kind] + j;
        TapeColumns<S> parents{};
        parents.vertex.suffix = before.suffix, parents.next = before.next;
        BranchColumns<S> ends{};
        const bool volumetric = stage.config.volumetric;
        if (volumetric) {
            parents.motion.rest_bar = before.rest, parents.motion.from_bar = before.from;
            ends.level = branches.level, ends.entry = branches.entry, ends.radiance = branches.radiance;
        }
        const SweepContext<S> c{stage.scene,
                                stage.config,
                                stage.slots,
                                stage.needs,
                                stage.width,
                                stage.height,
                                volumetric && branches.level.at ? &ends : nullptr,
                                unit_adjoint};
        GradientSink<S> sink = to.sink(i);
        sweep(c, parents, i, sink);
        if (sink.non_finite != 0 && !to.measures) accumulate(to.non_finite, uint64_t(sink.non_finite));
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        stage.for_pointers(visit), visit(begin), visit(total), before.for_pointers(visit);
        branches.for_pointers(visit), to.for_pointers(visit);
    }
};

// ... of light paths.
template <class S>
struct SweepLightVertices {
    static constexpr const char *Name = TR_KERNEL_NAME(SweepLightVertices), *Header = "device/derivative_kernels.h";
    static constexpr Knowledge Knows = Knowledge::Derivative;
    SweepVertices<S> of;
    LightView<S> view;
    bool adds() const { return of.adds(); }

    TR_HD void operator()(uint32_t j) const {
        of.for_vertex(
            j, [&](const SweepContext<S> &c, const TapeColumns<S> &parents, uint32_t i, GradientSink<S> &sink) {
                sweep_light_vertex<S>(c, view.sensor(of.stage), of.stage.tape, &parents, of.kind, i, true, sink);
            });
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        of.for_pointers(visit);
    }
};

}  // namespace tr
