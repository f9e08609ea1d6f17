// Outlines that lights see: the edges of shadows.
//
// From a place on a light, or along a direction of one that is infinitely far away, an outline's point B is chosen, of
// a small light from the pieces of cpu/shadow_pieces.h, evenly, else from the tree. The ray past it ends at S, which
// the camera sees at the place u of its film, at the end of a segment c. With the unit direction d from S to the light,
// at S the BSDF f with its cosine, w pixels per area perpendicular to c, and the density p of the light's place,
//
//     dI = - integral of h(p - u) / Z  w |n.c| / |n.d|  f L g  n.(dB - (1 - tau) dS - tau dE)  dl
//
// with tau = |B - S| / |E - S|, and g = sin cos_E / (r^2 p) for places E on shapes with the cosine there, r from B
// away; sin / r^2 for points, L being their intensity; and sin / p for directions. Where a vertex x of a path sees S in
// place of the camera, beta f_x / |S - x|^2 stands for h w / Z. Directions that the BSDF finds as well share what they
// bring with it by the power heuristic of the path tracer, and close to x with what is found there from x, see
// vertex_sights.h.
#pragma once

#include "../adjoint/revisit.h"
#include "../integrator/emission.h"
#include "outline_choice.h"
#include "samples.h"
#include "shadow_lights.h"

namespace tr {

// An outline's point B before the light of a slot, and the weight of what arrives at S.
template <class S>
struct ShadowEdge {
    uint32_t slot;
    int32_t element;
    S s;
    Vec3<S> b, free;
    S weight, reach, side;
    bool far, folded;     // see CloserRay
    S tau, length;        // of S to B
    SurfacePoint<S> end;  // S
};

// Which outlines lights choose from: pieces by emitter, null where there are none of any; an emitter's tree if it has
// none. `emitter`: if not below zero, that of all samples, which take its pieces in turn.
struct ShadowChoice {
    const OutlinePiecesView *pieces;
    int32_t n, emitter;

    TR_HD const OutlinePiecesView *find(int32_t of) const {
        return of >= 0 && of < n && pieces[of].n > 0 ? &pieces[of] : nullptr;
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(pieces);
    }
};

template <class S>
class ShadowSamples : public OutlineSamples<S> {
    using Base = OutlineSamples<S>;
    using Columns = ShadowEdgeColumns<S>;
    static constexpr size_t Descents = 4;  // lights see about as much of all outlines
    const ShadowChoice choice_;

public:
    using Base::config, Base::outlines, Base::scene, Base::view;
    using typename Base::V;

    TR_HD ShadowSamples(const SceneView<S> &scene, const PathConfig &config, const BoundaryView<S> &view,
                        const ShadowChoice &choice)
        : Base(scene, config, view), choice_(choice) {}

    // Four numbers of samples: for their lights and pieces, for places on the lights, and for what the lights choose.
    // They are points of a scrambled sequence, since what a small light makes of them is smooth; 2^n samples are spread
    // best. (With a lattice in their place the pieces find resonances.)
    static constexpr uint32_t LightBlock = Base::PlaceBlock + 1;
    template <class F>
    TR_HD Random4<F> spread(const SamplerConfig &sequence, uint64_t sample) const {
        using U = UIntOf<F>;
        const U high(uint32_t(sample >> 32)), low = U(uint32_t(sample)) + lane_index<F>();
        return sobol4<F>(sequence, config.seed, config.sensor, SobolPlace<U>(sequence, high, low), LightBlock,
                         AllWanted);
    }

    // An outline before the light of a slot, by one of those numbers: an edge, and a ray past it. False if there is
    // none.
    TR_HD bool find(const OutlineSample &sample, uint32_t k, const Columns &at, const LightPlace &light,
                    const uint8_t *moves, S number, ShadowEdge<S> &x, OutlineRay<S> &ray) const {
        const bool on_shape = light.on_shape;
        x.slot = k, x.far = light.far;
        const V y = at.y.get(k), yn = at.yn.get(k), origin = x.far ? at.travel.get(k) : y;
        OutlineAnchor anchor{};
        anchor.p = Base::single(origin), anchor.n = anchor.axis = anchor.ng = Base::single(yn);
        // lights at points may move
        anchor.still = on_shape ? Base::still(moves[at.at.shape[k]] != 0) : 0.2f;
        anchor.parallel = x.far, anchor.own = on_shape ? int32_t(at.at.shape[k]) : -1;
        const OutlineChoice chosen = choose(sample, at.emitter[k], anchor, number);
        if (chosen.element < 0) return false;
        const OutlinePoint<S> point = outlines.point(chosen.element, S(chosen.s), origin, x.far);
        if (!point.valid || point.front == 0) return false;
        const V towards = x.far ? origin : point.p - y;
        const S r = Base::length(towards);
        const V d = towards * (1 / std::max(r, S(1e-30))), across = cross(d, point.along);
        const S turned = Base::length(across);  // the sine times |along|
        x.weight = turned * S(chosen.inverse_density) * at.inverse_pdf[k] * S(1 / view.total);
        if (!x.far) x.weight = x.weight / (r * r);
        if (on_shape) x.weight = x.weight * std::max(dot(yn, d), S(0));
        if (!(x.weight > 0) || !Base::is_finite(x.weight)) return false;
        x.element = chosen.element, x.s = S(chosen.s), x.b = point.p, x.length = r;
        x.free = across * (-point.front / turned);  // from what hides to what does not
        x.reach = point.reach;
        x.side = x.far ? Base::least_side(x.b, S(0), point.reach) : Base::side_of(r, x.b, point.room, point.reach);
        x.folded = this->is_folded(x.element, point.front, point.room, x.side);
        ray = x.far ? OutlineRay<S>{x.b + x.free * x.side, d}
                    : Base::beside(y, yn, x.b, x.free, point.room, point.reach, S(0));
        return true;
    }
    // Of a folded one; the ray past it ends where one does that is closer, if that ends sooner.
    TR_HD CloserRay<S> look_closer(const ShadowEdge<S> &x, const OutlineRay<S> &ray) const {
        const V at = x.b + x.free * (x.side * CloserRay<S>::Closer);
        const S before = x.far ? 16 * x.reach : dot(x.b - ray.o, ray.d);
        return {x.element, at, ray.d, before, S(INFINITY), x.reach, true};
    }
    TR_HD static void end_sooner(const ShadowEdge<S> &x, const CloserRay<S> &wanted, OutlineRay<S> closer,
                                 OutlineRay<S> &ray) {
        if (x.far) closer.o = wanted.at, closer.t -= wanted.distance;
        if (closer.t < ray.t * S(1 - 1e-5)) ray = closer;
    }
    // Where the ray past it ends; false if it does not come past it. `hidden`: something is between it and a light that
    // is infinitely far away.
    TR_HD bool end(ShadowEdge<S> &x, const OutlineRay<S> &ray, bool hidden, const Columns &at) const {
        const S t = ray.t;
        if (x.far ? hidden || !(t > 0) : !(t > x.length * S(1 - 1e-3))) return false;
        if (!Base::is_finite(t)) return false;
        const V s = ray.o + ray.d * t;
        at.s.set(x.slot, s), at.d.set(x.slot, -ray.d);
        x.end = ray.at;
        x.length = at.b_distance[x.slot] = Base::length(x.b - s);
        at.e_distance[x.slot] = x.far ? S(INFINITY) : Base::length(at.y.get(x.slot) - s);
        x.tau = x.far ? S(0) : x.length / at.e_distance[x.slot];
        return true;
    }

    // Hands on the adjoint of an edge's rate; those of the light's place, and of S if that is not glued, are in its
    // columns.
    template <class Sink, class Glue>
    TR_HD void add(const ShadowEdge<S> &x, S w, const Columns &at, Sink &sink, Glue &&glue) const {
        const V g = x.free * w;
        const V s_bar = g * (x.tau - 1);
        if (view.glued)
            glue(x.end, at.s.get(x.slot), s_bar);
        else
            at.s_bar.set(x.slot, s_bar);
        at.e_bar.set(x.slot, g * (x.far ? x.length : -x.tau));
        outlines.spread(x.element, x.s, x.b, g, sink, glue);
    }

private:
    // Its element, a place on it, and one over the density of both.
    TR_HD OutlineChoice choose(const OutlineSample &sample, int32_t emitter, const OutlineAnchor &from,
                               S number) const {
        const OutlinePiecesView *pieces = choice_.find(emitter);
        if (!pieces) {
            OutlineChoice r;
            choose_outlines(view.outlines.tree, from, this->tree_seed(sample), Descents, &r, 1);
            return r;
        }
        if (choice_.emitter >= 0) {
            const OutlinePiece &piece = pieces->all[size_t(sample.number()) % pieces->n];
            const float length = piece.end - piece.begin;
            return {piece.element, piece.begin + length * float(number), length};
        }
        const OutlinePlace chosen = pieces->choose(double(number), view.outlines.tree);
        return {chosen.element, float(chosen.s), float(chosen.inverse_density)};
    }
};

// What a vertex that rays from the camera, or vertices, have found gets of lights past an edge, if it is its S.
template <class F>
struct ShadedEnd {
    MaskOf<F> meets;
    Vec3<F> c, d;
    EmitterPoint<F> light;
    Spectrum<F> radiance;
};

// Of entries i on of a level, of one kind; value, mis and ratio of their slots become what they get. Numbers of
// samples: those of emitters and BSDFs there; in_view: of what lights see.
template <class F>
TR_HD ShadedEnd<F> shade_end(const SceneOf<F> &scene, const Wavelengths<F> &waves, const ShadowLights<F> &lights,
                             const ShadowEdgeColumns<ScalarOf<F>> &at, const TapeColumns<ScalarOf<F>> &columns,
                             int kind, uint32_t i, const UIntOf<F> &slot, const MaskOf<F> &meets,
                             const GradientNeeds &needs, double near, double in_view, int emitter_samples,
                             int bsdf_samples) {
    using S = ScalarOf<F>;
    Gathered<F> from(slot, meets);
    Entries<F> entry(i);
    ShadedEnd<F> r;
    const Vec3<F> p = entry(columns.arrival.p);
    r.c = entry(columns.arrival.d), r.d = from(at.d);
    const BsdfValue<F> found = scatter_towards<F>(scene, waves, kind, columns, i, r.d, needs, meets);
    const Vec3<F> ng = geometric_normal<F>(scene, columns, i, meets);
    F density;
    r.radiance = lights.arriving(at, waves, p, r.d, from, meets, r.light, density);
    const Spectrum<F> value = found.f * r.radiance;
    density = density * F(S(in_view));
    const F cosine = dot(ng, r.d);
    density = density / beside_lights(near, from(at.b_distance), cosine, found.pdf);
    const F n_light = F(S(emitter_samples)), n_bsdf = F(S(bsdf_samples));
    const F mis = select(mask<F>(density > F(0)), power_heuristic(n_light * density, n_bsdf * found.pdf), F(-1));
    const F ratio = abs(dot(ng, r.c)) / max(abs(cosine), F(S(1e-6)));
    r.meets = meets && is_finite(value) && mask<F>(found.pdf > F(0));
    for (int k = 0; k < SpectrumSize; ++k) scatter_lanes<F>(at.value[k], slot, value[k], r.meets);
    scatter_lanes<F>(at.mis.at, slot, mis, r.meets);
    scatter_lanes<F>(at.ratio.at, slot, ratio, r.meets);
    return r;
}
// Whether those that rays have found are S.
template <class F>
TR_HD MaskOf<F> meets_end(const ShadowEdgeColumns<ScalarOf<F>> &at, const TapeColumns<ScalarOf<F>> &columns, uint32_t i,
                          const UIntOf<F> &slot, const MaskOf<F> &there) {
    using S = ScalarOf<F>;
    Gathered<F> from(slot, there);
    Entries<F> entry(i);
    const Vec3<F> s = from(at.s), apart = entry(columns.arrival.p) - s;
    const F reach = F(S(1e-3)) * (from(at.distance) + max_abs(s));
    return there && mask<F>(squared_norm(apart) < reach * reach);
}

}  // namespace tr
