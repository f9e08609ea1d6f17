// What kernels of samples of outlines have in common: see core/boundary and cpu/boundary_tile.h, whose schedule they
// follow. Items trace the rays that belong to a sample themselves; what these see of light is left to the kernels of
// paths.
#pragma once

#include "adjoint_kernels.h"
#include "core/boundary/samples.h"
#include "derivative_kernels.h"
#include "path_kernels.h"
#if defined(__CUDACC_RTC__)
#include "core/boundary/outline_choice.cpp"
#endif

namespace tr {

template <class S>
struct BoundaryStage {
    SceneView<S> scene;
    PathConfig config;  // of paths
    BoundaryView<S> view;
    TreeView tree;
    uint64_t first;  // the number of slot 0's sample
    uint64_t *traced;

    TR_HD OutlineSample sample(uint32_t slot) const { return OutlineSample(first + slot); }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        scene.for_pointers(visit), view.for_pointers(visit), tree.for_pointers(visit), visit(traced);
    }

    // Closest hits; rays go on behind shapes that passes(shape) is true of.
    template <class Passes>
    TR_HD void trace(OutlineRay<S> &ray, S length, Passes &&passes) const {
        Vec3<S> o = ray.o;
        TreeHit hit = closest(o, ray.d, length);
        for (int pass = 0; pass < MostPasses && hit.shape != TreeHit::Miss && passes(hit.shape); ++pass) {
            pass_behind(o, ray.d, S(hit.t), length);
            hit = closest(o, ray.d, length);
        }
        meet(ray, hit, o);
    }
    template <class Passes>
    TR_HD OutlineRay<S> trace(const OutlineSamples<S> &samples, const CloserRay<S> &x, Passes &&passes) const {
        OutlineRay<S> ray = x.begin();
        for (int round = 0; round < CloserRay<S>::Rounds; ++round) {
            meet(ray, closest(ray.met_from, ray.d, x.left(ray)), ray.met_from);
            if (ray.at.shape == NoHit || (!passes(ray.at.shape) && !samples.passes_own(x, ray))) break;
            CloserRay<S>::go_on(ray);
        }
        return x.whole(ray);
    }
    TR_HD bool is_hidden(const Vec3<S> &o, const Vec3<S> &d) const {
        return hit<true>(o, d, S(INFINITY)).shape != TreeHit::Miss;
    }

private:
    TR_HD TreeHit closest(const Vec3<S> &o, const Vec3<S> &d, S length) const { return hit<false>(o, d, length); }
    template <bool Any>
    TR_HD TreeHit hit(const Vec3<S> &o, const Vec3<S> &d, S length) const {
        const float from[] = {float(o.x), float(o.y), float(o.z)}, along[] = {float(d.x), float(d.y), float(d.z)};
        return tr::trace<Any>(tree, from, along, float(length));
    }
    TR_HD static void meet(OutlineRay<S> &ray, const TreeHit &hit, const Vec3<S> &from) {
        ray.meet({hit.shape, hit.primitive, S(hit.b1), S(hit.b2)}, S(hit.t), from);
    }
};

// Where paths of a sample's look-ups begin: entry i of the first queue, in the slot of this number. What its ray meets
// is known.
template <class S>
struct LightRays {
    SlotColumns<S> slots;
    PathQueue<S> out;
    HitColumns<S> hits;
    int32_t *key;

    TR_HD void begin(uint32_t i, const OutlineRay<S> &ray, S length, S pdf, uint32_t pixel) const {
        slots.pixel[i] = pixel, slots.sample[i] = slots.row[i] = slots.column[i] = 0;
        slots.alpha[i] = 0;
        for (int c = 0; c < SpectrumSize; ++c) slots.radiance[c][i] = 0, out.beta[c][i] = 1, out.survival[c][i] = 1;
        out.o.set(i, ray.o), out.d.set(i, ray.d), out.from.set(i, ray.o);
        out.length[i] = length, out.pdf[i] = pdf, out.eta[i] = 1;
        out.slot[i] = i, out.parent[i] = 0, out.seen[i] = 0;
        hits.at.set(i, ray.at), hits.t[i] = ray.t;
        key[i] = Kept;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        slots.for_arrays(visit), out.for_arrays(visit), hits.for_arrays(visit), visit(key);
    }
};

// What a sample's jumps, a channel each, are for: the number that the film's adjoint makes of them or, in forward mode,
// their place and values.
template <class S>
struct BoundaryFilm {
    AdjointGather<S> adjoint;  // of no samples; reverse mode
    int32_t channels;
    double *place, *value;  // in forward mode, see BoundaryCall

    // There are `Most` channels at most.
    template <int Most>
    TR_HD S contracted(S x, S y, const double *jumps) const {
        double from[Most] = {}, sum = 0;
        adjoint.gather_at(int32_t(floor(y)), int32_t(floor(x)), x, y, from);
        for (int32_t c = 0; c < channels; ++c) sum += from[c] * jumps[c];
        return S(sum);
    }
    TR_HD size_t at(uint32_t i, int32_t c) const { return size_t(i) * size_t(channels) + size_t(c); }
    TR_HD void tell_nothing(uint32_t i) const {
        place[2 * i] = place[2 * i + 1] = 0;
        for (int32_t c = 0; c < channels; ++c) value[at(i, c)] = 0;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        adjoint.for_pointers(visit), visit(place), visit(value);
    }
};

// A sink of single numbers, as the CPU's PointSink.
template <class S>
struct DevicePointSink {
    GradientSink<S> &sink;

    TR_HD bool wants(uint32_t shape) const { return sink.shape_wanted[shape] != 0; }
    TR_HD void vertex(uint32_t index, const Vec3<S> &g, VertexArray array = VertexArray::Positions) {
        const S v[3] = {g.x, g.y, g.z};
        for (uint32_t k = 0; k < 3; ++k) sink.vertex(array, 3 * index + k, v[k], true);
    }
    TR_HD void matrix(uint32_t shape, const Vec3<S> &local, const Vec3<S> &g) {
        const S row[3] = {g.x, g.y, g.z}, column[4] = {local.x, local.y, local.z, S(1)};
        for (uint32_t k = 0; k < 12; ++k)
            sink.scalar(int32_t(sink.matrices + 12 * shape + k), row[k / 4] * column[k % 4], true);
    }
};

// For what samples hand on: f(sink, glue) adds to it, and glues points to surfaces.
template <class S>
struct BoundaryGradients {
    SceneView<S> scene;
    PathConfig config;
    GradientNeeds needs;
    DerivativePlaces<S> to;

    template <class Do>
    TR_HD void with_sink(uint32_t i, Do &&f) const {
        GradientSink<S> sink = to.sink(i);
        sink.begin();
        f(sink, [&](const SurfacePoint<S> &at, const Vec3<S> &p, const Vec3<S> &p_bar) {
            if (sink.wants_shape(at.shape, true)) sweep_position<S>(scene, at, p, p_bar, true, sink);
        });
        if (sink.non_finite != 0 && !to.measures) accumulate(to.non_finite, uint64_t(sink.non_finite));
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        scene.for_pointers(visit), visit(needs.bsdfs), visit(needs.variables), visit(needs.boxes);
        to.for_pointers(visit);
    }
};

}  // namespace tr
