// Points on outlines: where rays that pass an edge of a mesh, or the contour, rim or line of a curved shape, touch it;
// on which side of the ray something is that hides what is behind; and what gets the derivative of such a point.
#pragma once

#include <cmath>

#include "../adjoint/gradient_sink.h"
#include "outline_fields.h"
#include "outline_rims.h"

namespace tr {

// From where outlines are seen: a place, or along the unit vector `origin` if `parallel`; rays begin up to `beside`
// away.
template <class S>
struct OutlineView {
    Vec3<S> origin;
    bool parallel;
    S beside;
};

template <class S>
struct OutlinePoint {
    Vec3<S> p, along;    // and its derivative by the parameter
    bool valid = false;  // it is an outline from there, or a crease
    S front = 0;         // 1: what hides is on the side of (direction of the ray) x along; -1: on the other; 0: crease
    S room = S(INFINITY);  // how far across the ray the faces beside it reach
    S rim = 0;             // how far across it, in front, interpolated normals look away
    S reach = 0;           // how far from it what it is an outline of may reach, roughly
};

template <class S>
class Outlines {
    using V = Vec3<S>;

public:
    TR_HD Outlines(const SceneView<S> &scene, const OutlineTable &set) : scene_(scene), set_(set) {}

    // At the parameter s of an element, as rays from `origin`, or along the unit vector of this name if `parallel`, see
    // it.
    TR_HD OutlinePoint<S> point(int32_t element, S s, const V &origin, bool parallel) const {
        if (set_.is_face(size_t(element))) {
            const RimPoint<S> found = rim_point(element, s, origin, parallel);
            return {found.p, found.along, found.valid, S(0), found.room / 8, S(0), found.reach};
        }
        return set_.is_edge(size_t(element)) ? edge_point(size_t(element), s, origin, parallel)
                                             : curve_point(set_.curve(size_t(element)), s, origin, parallel);
    }
    // Its place alone.
    TR_HD V place(int32_t element, S s, const V &origin, bool parallel) const {
        if (set_.is_face(size_t(element))) {
            const RimPoint<S> found = rim_point(element, s, origin, parallel);
            return found.valid ? found.p : V{S(NAN), S(NAN), S(NAN)};
        }
        if (!set_.is_edge(size_t(element))) {
            const OutlinePoint<S> found = curve_point(set_.curve(size_t(element)), s, origin, parallel);
            return found.valid || !is_of_field(element) ? found.p : V{S(NAN), S(NAN), S(NAN)};
        }
        const HalfEdge h = set_.half(scene_, size_t(element), 0);
        const V a = position(h.v0);
        return a + (position(h.v1) - a) * s;
    }

    // Of an element that is a face.
    TR_HD RimPoint<S> rim_point(int32_t element, S s, const V &origin, bool parallel) const {
        return Rim<S>(scene_, set_.face(size_t(element)), origin, parallel).at(s);
    }

    // Whether it is one of a height field.
    TR_HD bool is_of_field(int32_t element) const {
        return set_.is_curve(size_t(element)) && set_.curve(size_t(element)).of_field();
    }

    // Whether it is scattered over one, wherever its parameter is; and whether some of that may be seen from there, as
    // an outline or, with `creases`, as one of these.
    TR_HD bool is_scattered(int32_t element) const {
        return is_of_field(element) && set_.curve(size_t(element)).kind != OutlineCurve::FieldBorder;
    }
    TR_HD bool may_be_seen(int32_t element, const OutlineView<S> &view, bool creases) const {
        const OutlineCurve &curve = set_.curve(size_t(element));
        if (view.beside > 0 || (creases && curve.kind == OutlineCurve::FieldCreases)) return true;
        return FieldOutline<S>(scene_, curve, view.origin, view.parallel).possible();
    }

    // Hands the adjoint of a point that is not of a rim on: to a sink, vertices of an edge and the matrix of a quadric,
    // those that it wants; to glue(at, p, p_bar) that of a height field, which moves with its surface.
    template <class Sink, class Glue>
    TR_HD void spread(int32_t element, S s, const V &p, const V &p_bar, Sink &sink, Glue &&glue) const {
        if (!set_.is_edge(size_t(element))) {
            const uint32_t shape = uint32_t(set_.curve(size_t(element)).shape);
            const V local = transform_point(scene_.shape_matrices + 24 * shape + 12, p);
            if (is_of_field(element))
                glue(SurfacePoint<S>{shape, 0, (local.x + 1) / 2, (local.y + 1) / 2}, p, p_bar);
            else if (sink.wants(shape))
                sink.matrix(shape, local, p_bar);
            return;
        }
        const size_t n = set_.count(size_t(element));
        for (size_t k = 0; k < n; ++k) {  // copies of a vertex share its motion
            const HalfEdge h = set_.half(scene_, size_t(element), k);
            if (!sink.wants(set_.shape_of(h))) continue;
            sink.vertex(h.v0, p_bar * ((S(1) - s) / S(n)));
            sink.vertex(h.v1, p_bar * (s / S(n)));
        }
    }

private:
    const SceneView<S> &scene_;
    const OutlineTable &set_;

    TR_HD const VertexRow<S> &vertex(uint32_t i) const {
        return reinterpret_cast<const VertexRow<S> *>(scene_.vertices)[i];
    }
    TR_HD V position(uint32_t i) const { return vec(vertex(i).p); }
    TR_HD V normal(uint32_t i) const { return vec(vertex(i).n); }
    TR_HD static V vec(const S *a) { return {a[0], a[1], a[2]}; }
    TR_HD static S sign(S x) { return S(x > 0) - S(x < 0); }

    TR_HD OutlinePoint<S> edge_point(size_t edge, S s, const V &origin, bool parallel) const {
        const size_t n = set_.count(edge);
        const HalfEdge first = set_.half(scene_, edge, 0);
        const V a = position(first.v0), b = position(first.v1);
        OutlinePoint<S> r;
        r.along = b - a, r.p = a + r.along * s;
        const V towards = parallel ? origin : r.p - origin, across = cross(towards, r.along);
        const S length = std::sqrt(dot(across, across)), inverse = 1 / std::max(length, S(1e-30));
        bool right = false, left = false;
        for (size_t k = 0; k < n; ++k) {
            const V third = position(set_.half(scene_, edge, k).third);
            const S side = dot(third - a, across);
            right |= side > 0, left |= side < 0;
            r.room = std::min(r.room, std::abs(side) * inverse * share(third, s, r, towards, parallel));
            r.reach = std::max(r.reach, max_abs(third - r.p));
        }
        r.reach = std::max(std::max(r.reach, max_abs(a - r.p)), max_abs(b - r.p));
        const bool flat = !(scene_.shapes[set_.shape_of(first)].flags & HasNormals), both = right && left;
        r.valid = !both || set_.is_split(edge) || flat;
        r.front = both ? S(0) : S(right) - S(left);
        if (r.front != 0) r.rim = rim(edge, s, towards, a, across, inverse);
        return r;
    }

    // The share of its height that a triangle has at a place on its base, the edge from a, as rays see it.
    TR_HD static S share(const V &third, S s, const OutlinePoint<S> &r, const V &towards, bool parallel) {
        const S square = dot(towards, towards), depth = dot(third - r.p, towards);
        const V beside = parallel ? third - r.p : (third - r.p + towards) * (square / (square + depth)) - towards;
        const V along = r.along - towards * (dot(r.along, towards) / square);
        const S foot = s + dot(beside, along) / std::max(dot(along, along), S(1e-30));
        return s < foot ? s / foot : (1 - s) / (1 - foot);
    }

    // How far across rays, on faces that are seen, interpolated normals look away from where these come from. There a
    // surface is black although it is seen. That ends at a line on the face, which moves about like the edge, and what
    // is beyond is what the edge's motion uncovers.
    TR_HD S rim(size_t edge, S s, const V &towards, const V &a, const V &across, S inverse) const {
        for (size_t k = 0; k < set_.count(edge); ++k) {
            const HalfEdge h = set_.half(scene_, edge, k);
            const V out = cross(position(h.v1) - a, position(h.third) - a);
            if (!(dot(out, towards) * (h.turned ? S(-1) : S(1)) < 0)) continue;
            if (!(scene_.shapes[set_.shape_of(h)].flags & HasNormals)) return 0;
            const S at_edge = dot(normal(h.v0) * (S(1) - s) + normal(h.v1) * s, towards);
            if (!(at_edge > 0)) return 0;
            const S inside = std::min(dot(normal(h.third), towards), S(0));
            const S share = std::min(at_edge / std::max(at_edge - inside, S(1e-30)), S(1));
            return share * std::abs(dot(position(h.third) - a, across)) * inverse;
        }
        return 0;
    }

    TR_HD OutlinePoint<S> field_point(const OutlineCurve &curve, S s, const V &origin, bool parallel) const {
        const FieldPoint<S> found = FieldOutline<S>(scene_, curve, origin, parallel).at(s);
        const S *m = scene_.shape_matrices + 24 * size_t(curve.shape);
        OutlinePoint<S> r;
        r.p = found.p, r.along = found.along, r.valid = found.valid;
        r.front = sign(dot(cross(parallel ? origin : r.p - origin, r.along), found.hiding));
        r.room = found.room;
        r.reach = 32 * max_abs(transform_vector(m, V{S(2), S(2), S(0)}));  // grazing rays miss it where they are closer
        return r;
    }

    TR_HD OutlinePoint<S> curve_point(const OutlineCurve &curve, S s, const V &origin, bool parallel) const {
        if (curve.of_field()) return field_point(curve, s, origin, parallel);
        const S *m = scene_.shape_matrices + 24 * size_t(curve.shape);
        const V o = parallel ? transform_vector(m + 12, origin) : transform_point(m + 12, origin);
        const bool round = curve.kind == OutlineCurve::Contour, line = curve.kind >= OutlineCurve::LeftLine;
        const V flat{o.x, o.y, round ? o.z : S(0)};  // of a cylinder across its axis
        const S square = dot(flat, flat);
        OutlinePoint<S> r;
        r.valid = parallel ? square > 0 : square > 1 || !(round || line);
        const S length = r.valid && square > 0 ? std::sqrt(square) : S(1);
        const V axis = flat * (1 / length);
        // the circle (pair of points) of tangency: its centre and radius
        const S near = parallel || !r.valid ? S(0) : 1 / length, radius = std::sqrt(std::max(S(0), 1 - near * near));
        const S phi = S(2 * Pi) * s, cosine = std::cos(phi), sine = std::sin(phi), turn = S(2 * Pi);
        V local, along;
        if (round) {
            V u, v;
            coordinate_system(axis, u, v);
            local = axis * near + (u * cosine + v * sine) * radius;
            along = (v * cosine - u * sine) * (radius * turn);
        } else if (line) {
            const S side = curve.kind == OutlineCurve::LeftLine ? S(1) : S(-1);
            local = axis * near + V{-axis.y * side, axis.x * side, S(0)} * radius + V{S(0), S(0), s};
            along = {S(0), S(0), S(1)};
        } else {
            local = {cosine, sine, S(curve.kind == OutlineCurve::UpperRim ? 1 : 0)};
            along = {-sine * turn, cosine * turn, S(0)};
        }
        r.p = transform_point(m, local), r.along = transform_vector(m, along);
        r.reach = max_abs(r.along);
        const V middle = transform_vector(m, V{-local.x, -local.y, round ? -local.z : S(0)});
        r.front = sign(dot(cross(parallel ? origin : r.p - origin, r.along), middle));
        return r;
    }
};

}  // namespace tr
