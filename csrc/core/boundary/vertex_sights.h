// Outlines that points on surfaces see: where the light that they scatter ends to be visible, and begins.
//
// At a vertex S of a path, which has the throughput beta, light comes from everywhere; past an outline's point B there
// is one thing on the one side and another on the other. With the unit direction d to B, at the distance r,
//
//     dI = beta  integral of f(d) sin / r^2  (L_minus v_minus - L_plus v_plus)  dl
//
// where v = n.(dB - (1 - tau) dS - tau dE) for a point E that is glued to what emits, tau = r / |E - S|, and n.(dB -
// dS) for all else, which is looked up along a direction at rest: see docs/theory/motion.md. Of glued samples all E are
// glued to what they belong to, and S is, too.
#pragma once

#include "anchors.h"
#include "samples.h"

namespace tr {

// An outline's point B that the vertex S of a slot sees, and what rays on the side of -n and of n meet.
template <class S>
struct VertexSight {
    uint32_t slot, copy;
    int32_t element;
    S s, r;
    Vec3<S> from, b, n;
    S front, room, reach, rim, side;
    bool folded;  // see CloserRay
    Spectrum<S> carried;
    S density;
    bool has_end[2];  // what is met there is glued to its surface
    S tau[2];
    SurfacePoint<S> end[2];
    Vec3<S> end_p[2];
};

// How far beyond the rim of interpolated normals a ray passes, in widths of it.
constexpr double BeyondRim = 1.05;

template <class S>
class VertexSamples : public OutlineSamples<S> {
    using Base = OutlineSamples<S>;

public:
    using Base::config, Base::outlines, Base::scene, Base::view;
    using typename Base::V;

    TR_HD VertexSamples(const SceneView<S> &scene, const PathConfig &config, const BoundaryView<S> &view)
        : Base(scene, config, view) {}

    // What a vertex brings that is seen along a segment, with this normal, and in total: where it slides over its
    // surface, as fast as one over the cosine with which it is seen. (Of a silhouette's neighbourhood the variance of
    // equal numbers of outlines would have no bound.)
    TR_HD double sliding(double total, bool moves, const V &segment, const V &ng) const {
        if (view.glued || !moves) return total;
        return total / std::max(std::fabs(double(dot(ng, Base::unit(segment)))), 0.05);
    }

    // Of a vertex at a point of a surface: the sight of an outline that it has chosen, with one over the probability of
    // the vertex, and the direction to it; false if it is none.
    TR_HD bool find(const OutlineChoice &chosen, const SurfacePoint<S> &at, S inverse, VertexSight<S> &x,
                    V &towards) const {
        if (chosen.element < 0 || is_own_face(at, chosen.element)) return false;
        const OutlinePoint<S> point = outlines.point(chosen.element, S(chosen.s), x.from, false);
        const V way = point.p - x.from;
        x.r = Base::length(way);
        const S stretch = Base::length(point.along);
        const V d = way * (1 / std::max(x.r, S(1e-30))), across = cross(d, point.along);
        const S turned = Base::length(across);
        if (!point.valid || !(stretch > 0) || !(turned > 0) || !(x.r > 0)) return false;
        x.element = chosen.element, x.s = S(chosen.s), x.b = point.p, x.n = across * (1 / turned);
        x.front = point.front, x.room = point.room, x.reach = point.reach, x.rim = S(BeyondRim) * point.rim;
        x.side = Base::side_of(x.r, x.b, x.room, x.reach);
        x.folded = this->is_folded(x.element, x.front, x.room, x.side);
        // sin / r^2 over the density by length
        x.carried = uniform_spectrum(
            S(turned / (x.r * x.r) * S(chosen.inverse_density) * inverse * S(double(view.n_cells) / view.total)));
        towards = d;
        return true;
    }

    // What it carries, f and the throughput being those there; false if that is nothing.
    TR_HD bool weigh(VertexSight<S> &x, const Spectrum<S> &f, const Spectrum<S> &beta) const {
        bool some = false, finite = true;
        for (int c = 0; c < SpectrumSize; ++c) {
            x.carried[c] = x.carried[c] * beta[c] * f[c];
            some |= x.carried[c] != 0, finite &= Base::is_finite(x.carried[c]);
        }
        return some && finite && !(view.glued && x.front == 0);
    }
    // The density that what lights find, too, shares it by: what a smooth vertex, or the camera, sees, and not too
    // close to it. `first`: it is the camera's; else seen_from(): how far, negative where that is no smooth one.
    template <class SeenFrom>
    TR_HD S density(const VertexSight<S> &x, const OutlineSample &sample, S pdf, const V &ng, const V &d, bool first,
                    SeenFrom &&seen_from) const {
        pdf = pdf * beside_lights(view.near, x.r, dot(ng, d), pdf);
        if (first) return pdf / S(view.in_view);
        const double distance = seen_from();
        return distance >= 0 && double(this->number(sample, 1)) < this->apart(distance) ? pdf : S(0);
    }

    // Rays beside it, from a surface of this normal; of a folded one those that look closer.
    TR_HD OutlineRay<S> ray_beside(const VertexSight<S> &x, const V &ng, S side) const {
        return Base::beside(x.from, ng, x.b, x.n * side, x.room, x.reach, x.front == side ? x.rim : S(0));
    }
    TR_HD void look_closer(const VertexSight<S> &x, const V &o, CloserRay<S> *to) const {
        for (int h = 0; h < 2; ++h)
            to[h] = Base::closer(S(h == 0 ? -1 : 1), x.element, x.b, x.n, o, Base::unit(x.b - o), S(INFINITY), x.reach,
                                 x.front, x.side);
    }
    // Whether it is seen, for rays beside it that have been traced; then what these have met is known.
    TR_HD bool is_open(VertexSight<S> &x, OutlineRay<S> *beside, const CloserRay<S> *wanted,
                       const OutlineRay<S> *closer) const {
        if (x.folded && !this->is_seen(wanted, closer, x.front, x.room, x.side, beside)) return false;
        const S t[2] = {beside[0].t, beside[1].t};
        if (!Base::is_open(x.front, x.r, t, S(1e-3))) return false;
        for (int h = 0; h < 2; ++h) {
            const OutlineRay<S> &ray = beside[h];
            x.has_end[h] = ray.at.shape != NoHit && (view.glued || scene.shapes[ray.at.shape].emitter >= 0);
            if (!x.has_end[h]) continue;
            x.end[h] = ray.at, x.end_p[h] = ray.o + ray.d * t[h];
            x.tau[h] = x.r / Base::length(x.end_p[h] - x.from);
        }
        return true;
    }
    // The sign of what is seen on a side (0: that of -n); 0 where it moves with what hides something, or is a crease.
    TR_HD S sign_of(const VertexSight<S> &x, int h) const {
        const S sign = h == 0 ? S(1) : S(-1);
        return !(x.has_end[h] || view.glued) || x.front * sign == S(1) ? sign : S(0);
    }

    // Hands on the adjoints of the rates on both sides; returns that of the vertex's place.
    template <class Sink, class Glue>
    TR_HD V add(const VertexSight<S> &x, const S (&weights)[2], Sink &sink, Glue &&glue) const {
        V b_bar{S(0), S(0), S(0)}, s_bar = b_bar;
        for (int h = 0; h < 2; ++h) {
            const S w = weights[h];
            if (w == 0 || !Base::is_finite(w)) continue;
            const V g = x.n * w;
            b_bar = b_bar + g;
            s_bar = s_bar - g * (x.has_end[h] ? 1 - x.tau[h] : S(1));
            if (x.has_end[h]) glue(x.end[h], x.end_p[h], g * -x.tau[h]);
        }
        outlines.spread(x.element, x.s, x.b, b_bar, sink, glue);
        return s_bar;
    }

private:
    // Whether it is an edge of the face that the vertex is on: nothing comes from along a face, whichever side of the
    // edge rounding takes for the free one. (Of light that interpolated normals still see there, see motion.md.)
    TR_HD bool is_own_face(const SurfacePoint<S> &at, int32_t element) const {
        return view.outlines.is_edge(size_t(element)) && this->is_face_of(element, at);
    }
};

}  // namespace tr
