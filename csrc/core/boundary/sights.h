// Outlines that the camera sees. With b on a piece of one, at the place u of the film, n across the ray to it at the
// distance r, w pixels per area perpendicular to it, and the colours and coverages L on both sides,
//
//     dI = integral of h(p - u) / Z  (L_minus - L_plus)  w sin  n.(db - do - r dd)  dl
//
// L may be anything that is seen; see cpu/boundary_outputs.h for what is not radiance. Of glued samples L is zero on
// the side of what hides, and where the ray on the other side ends at E the rate is n.(dB - (1 - tau) do - tau dE).
// Rims of normals are among the outlines, see outline_rims.h; glued, they have what they move over their faces, and
// both sides.
#pragma once

#include "../integrator/shadow_transmittance.h"
#include "samples.h"

namespace tr {

template <class S>
struct Sight {
    uint32_t slot;
    int32_t element;
    Vec3<S> origin;  // of the ray, or its direction
    S s;
    Vec3<S> b, n;
    S front, t, distance;  // of b from where the ray begins, and from the camera
    S weight, reach, room, side;
    bool folded;  // see CloserRay
};

template <class S>
class SightSamples : public OutlineSamples<S> {
    using Base = OutlineSamples<S>;

public:
    using Base::config, Base::outlines, Base::scene, Base::view;
    using typename Base::V;

    TR_HD SightSamples(const SceneView<S> &scene, const PathConfig &config, const BoundaryView<S> &view)
        : Base(scene, config, view) {}

    TR_HD bool parallel() const { return is_parallel(this->sensor()); }
    TR_HD bool is_rim(const Sight<S> &x) const { return view.outlines.is_face(size_t(x.element)); }

    // What a sample sees: a sight, its place, and rays of a length beside it; false if that is nothing.
    TR_HD bool find(const OutlineSample &sample, CameraSample<S> &place, Sight<S> &x, OutlineRay<S> *beside,
                    S &length) const {
        place.x = view.width / 2, place.y = view.height / 2;
        const CameraRay<S> middle = this->ray_of(place);
        // every sample has a part of the length of all pieces, in which its place is drawn
        const double at = (double(sample.number()) + double(this->number(sample, 0))) / view.samples;
        const OutlinePlace chosen = view.pieces.choose(at, view.outlines.tree);
        x.element = chosen.element, x.s = S(chosen.s);
        const V origin = parallel() ? middle.ray.d : middle.center;
        const OutlinePoint<S> point = outlines.point(x.element, x.s, origin, parallel());
        if (!point.valid || is_invisible(x.element) || (view.glued && point.front == 0 && !is_rim(x))) return false;
        if (!this->sees(point.p, place)) return false;
        const CameraRay<S> ray = this->ray_of(place);
        const V o = ray.ray.o, d = ray.ray.d, towards = point.p - o, across = cross(d, point.along);
        x.t = dot(towards, d);
        x.distance = dot(point.p - ray.center, d);
        const S turned = Base::length(across), area = this->pixel_area(place, d, x.distance);
        if (!ray.exists || !(turned > 0) || !(area > 0) || !(x.t > 0) || !(x.t < ray.length)) return false;
        if (!(Base::length(towards - d * x.t) < S(1e-3) * x.t)) return false;  // the lens does not show it there
        x.weight = S(double(turned) / double(area) * chosen.inverse_density / view.total);
        if (!Base::is_finite(x.weight)) return false;
        x.b = point.p, x.n = across * (1 / turned), x.front = point.front, x.origin = origin;
        const S next = S(is_rim(x) ? BesideRim : Beside) * std::sqrt(area);
        const S side = std::max(std::min(next, point.room / 8), Base::least_side(point.p, x.t, point.reach));
        x.reach = point.reach, x.room = point.room, x.side = side;
        x.folded = this->is_folded(x.element, x.front, x.room, side);
        for (int h = 0; h < 2; ++h) {
            const V offset = x.n * (S(h == 0 ? -1 : 1) * side);
            beside[h] = parallel() ? OutlineRay<S>{o + offset, d} : OutlineRay<S>{o, Base::unit(point.p - o + offset)};
        }
        length = ray.length;
        return true;
    }

    // Of a folded one: rays that look closer, from those that are beside it, which have this length.
    TR_HD void look_closer(const Sight<S> &x, const OutlineRay<S> *beside, S length, CloserRay<S> *to) const {
        const V d = parallel() ? beside[0].d : Base::unit(x.b - beside[0].o);
        const V o = parallel() ? (beside[0].o + beside[1].o) * S(0.5) : beside[0].o;
        for (int h = 0; h < 2; ++h)
            to[h] = Base::closer(S(h == 0 ? -1 : 1), x.element, x.b, x.n, o, d, length, x.reach, x.front, x.side);
    }
    // Whether it is seen, for rays beside it that have been traced; `closer`, of a folded one, have looked closer.
    TR_HD bool is_open(const Sight<S> &x, OutlineRay<S> *beside, const CloserRay<S> *wanted,
                       const OutlineRay<S> *closer) const {
        if (x.folded ? !this->is_seen(wanted, closer, x.front, x.room, x.side, beside) : is_repeated(x, beside))
            return false;
        const S t[2] = {beside[0].distance(), beside[1].distance()};
        return Base::is_open(x.front, x.t, t, S(is_rim(x) ? 5e-3 : 1e-5));
    }
    // Shapes that the camera's rays pass: lights that are hidden, and boundaries of media that do not scatter.
    TR_HD bool lets_through(uint32_t shape) const {
        const bool hidden = config.hide_emitters && scene.shapes[shape].emitter >= 0;
        return hidden || (config.volumetric && passes_shadow_rays(scene, shape));
    }

    // What is seen on the sides of -n and of n, in a channel.
    TR_HD double jump(const Sight<S> &x, double minus, double plus) const {
        if (view.glued && !is_rim(x)) (x.front > 0 ? plus : minus) = 0;
        const double jump = (minus - plus) * double(x.weight);
        return jump - jump == 0 ? jump : 0;
    }

    // Hands on the adjoint of a sight's rate; that of the camera's ray, of its origin and direction, is o_bar and
    // d_bar. Points that are glued to surfaces go to glue(at, p, p_bar). `rays`: those beside it.
    template <class Sink, class Glue>
    TR_HD void add(const Sight<S> &x, const OutlineRay<S> *rays, S w, Sink &sink, Glue &&glue, V &o_bar,
                   V &d_bar) const {
        const V g = x.n * w;
        if (is_rim(x)) return add_to_rim(x, g, sink, o_bar, d_bar);
        outlines.spread(x.element, x.s, x.b, g, sink, glue);
        o_bar = view.glued ? g * -(1 - add_end(x, rays, g, glue)) : -g;
        if (!view.glued) d_bar = g * -x.distance;
    }

private:
    // How far beside an outline its colours are looked at, in pixels; beside rims, which are where rounded normals say.
    static constexpr double Beside = 0x1p-14, BesideRim = 0x1p-11;

    // Of two edges that are closer to each other, across rays, than rays are traced both would have the jump between
    // what is behind them and the nearer one. The nearer has it: past the other one a ray meets a face, beyond its own,
    // that is nearer.
    TR_HD bool is_repeated(const Sight<S> &x, const OutlineRay<S> *beside) const {
        const OutlineRay<S> &hiding = beside[x.front > 0 ? 1 : 0];
        if (x.front == 0 || !(x.room > S(1.25) * x.side) || !view.outlines.is_edge(size_t(x.element))) return false;
        return hiding.distance() < x.t - S(0.02) * x.reach && !this->is_face_of(x.element, hiding.at);
    }

    // Whether an element is of a shape that rays pass, and nothing of it is seen.
    TR_HD bool is_invisible(int32_t element) const {
        const uint32_t shape = view.outlines.shape_of_element(scene, size_t(element));
        return lets_through(shape) && (config.hide_emitters || scene.shapes[shape].emitter < 0);
    }

    // The share of g that the end of the ray past an outline has, to whose surface it is glued; 0 at infinity.
    template <class Glue>
    TR_HD S add_end(const Sight<S> &x, const OutlineRay<S> *rays, const V &g, Glue &&glue) const {
        const OutlineRay<S> &ray = rays[x.front > 0 ? 0 : 1];
        if (ray.at.shape == NoHit) return 0;
        const V end = ray.met_from + ray.d * ray.t;
        const S tau = x.distance / (x.distance - x.t + dot(end - ray.o, ray.d));
        glue(ray.at, end, g * -tau);
        return tau;
    }

    // Of a rim, which moves with its face (glued points do, too) and over it.
    template <class Sink>
    TR_HD void add_to_rim(const Sight<S> &x, const V &g, Sink &sink, V &o_bar, V &d_bar) const {
        const OutlineTable &set = view.outlines;
        const uint32_t face = set.face(size_t(x.element));
        const RimPoint<S> rim = outlines.rim_point(x.element, x.s, x.origin, parallel());
        const S rate = dot(g, rim.slope);
        const V with_face = view.glued ? V{S(0), S(0), S(0)} : g, turn = rim.N * rate;
        const V material = parallel() ? with_face : with_face + turn;
        const bool wanted = sink.wants(set.shape_of_face(face));
        for (size_t i = 0; i < 3 && wanted; ++i) {
            const uint32_t vertex = scene.faces[3 * size_t(face) + i];
            sink.vertex(vertex, material * rim.b[i]);
            sink.vertex(vertex, rim.w * (-rate * rim.b[i]), VertexArray::Normals);
        }
        o_bar = -material;
        d_bar = with_face * -x.distance + (parallel() ? turn : V{S(0), S(0), S(0)});
    }
};

}  // namespace tr
