// Rims of interpolated normals: lines on the faces of a mesh, beyond which its normals look away from where rays come
// from although the faces are seen, so that what reflects or glows on one side turns black at once.
//
// With b the barycentric coordinates, x(b) = sum b_i p_i, N(b) = sum b_i n_i, and w towards where rays come from, o -
// x, or minus their direction, a rim is g(b) = N.w = 0: a conic. A line from a corner to a point of the opposite side,
// which is the rim's parameter, meets it once where g has one sign at that corner and another at the other two. Where
// things move the rim moves over the face, on such a line by -dg / g_t: across rays, along n,
//
//     n.db = n.dx - (n.x_t / g_t) dg,   dg = w.dN + N.(do - dx),
//
// dx and dN those of the material point.
#pragma once

#include <algorithm>
#include <cmath>

#include "../scene.h"

namespace tr {

template <class S>
struct RimPoint {
    Vec3<S> p, along;     // and its derivative by the parameter
    bool valid = false;   // there is one
    S b[3];               // barycentric coordinates
    Vec3<S> N, w, slope;  // slope: x_t / g_t
    S room;               // how far the face reaches across the ray, beside the line
    S reach;              // how far it reaches from p
};

template <class S>
class Rim {
    using V = Vec3<S>;

public:
    // Of a face of a mesh with normals, as rays from `origin`, or along the unit vector of this name if `parallel`, see
    // it.
    TR_HD Rim(const SceneView<S> &scene, uint32_t face, const V &origin, bool parallel)
        : parallel_(parallel), origin_(origin) {
        const auto *rows = reinterpret_cast<const VertexRow<S> *>(scene.vertices);
        for (size_t i = 0; i < 3; ++i) {
            const VertexRow<S> &row = rows[scene.faces[3 * size_t(face) + i]];
            p_[i] = {row.p[0], row.p[1], row.p[2]}, n_[i] = {row.n[0], row.n[1], row.n[2]};
        }
    }

    // Whether there may be one, from somewhere not further away from the origin than `beside`.
    TR_HD bool possible(S beside) const {
        bool above = false, below = false;
        for (size_t i = 0; i < 3; ++i) {
            const S margin = beside * std::sqrt(dot(n_[i], n_[i]));
            for (size_t j = i; j < 3; ++j) {
                const S g = coefficient(i, j);
                above |= g + margin > 0, below |= g - margin < 0;
            }
        }
        return above && below;
    }

    TR_HD RimPoint<S> at(S s) const {
        const S g[3] = {coefficient(0, 0), coefficient(1, 1), coefficient(2, 2)};
        size_t a = 0;
        for (size_t i = 1; i < 3; ++i)
            if ((g[i] > 0) != (g[(i + 1) % 3] > 0) && (g[i] > 0) != (g[(i + 2) % 3] > 0)) a = i;
        const size_t b = (a + 1) % 3, c = (a + 2) % 3;
        const bool once = (g[a] > 0) != (g[b] > 0) && (g[a] > 0) != (g[c] > 0);
        // otherwise there are two points on a line, or none: one for each half of the parameter
        const bool second = !once && s >= S(0.5);
        const S speed = once ? S(1) : S(2);
        if (!once) s = 2 * s - S(second);
        // g = (1 - t)^2 A + 2 t (1 - t) B + t^2 C
        const S ab = coefficient(a, b), ac = coefficient(a, c), bc = coefficient(b, c);
        const S A = g[a], B = (1 - s) * ab + s * ac;
        const S C = (1 - s) * (1 - s) * g[b] + 2 * s * (1 - s) * bc + s * s * g[c];
        RimPoint<S> r{};
        const S t = root(A, B, C, second, once);
        if (!(t > 0 && t < 1)) return r;
        const V side = p_[b] * (1 - s) + p_[c] * s, x_t = side - p_[a], x_s = (p_[c] - p_[b]) * t;
        const S C_s = 2 * ((s - 1) * g[b] + (1 - 2 * s) * bc + s * g[c]);
        const S g_t = 2 * ((1 - t) * (B - A) + t * (C - B)), g_s = 2 * t * (1 - t) * (ac - ab) + t * t * C_s;
        r.b[a] = 1 - t, r.b[b] = t * (1 - s), r.b[c] = t * s;
        r.p = p_[a] * r.b[a] + p_[b] * r.b[b] + p_[c] * r.b[c];
        r.N = n_[a] * r.b[a] + n_[b] * r.b[b] + n_[c] * r.b[c];
        r.w = towards(r.p);
        r.slope = x_t * (1 / g_t), r.along = (x_s - r.slope * g_s) * speed;
        const V across = cross(r.w, r.along);
        r.room = std::fabs(dot(across, x_t)) * std::min(t, 1 - t) / std::sqrt(dot(across, across));
        r.reach = std::max(std::max(max_abs(p_[0] - r.p), max_abs(p_[1] - r.p)), max_abs(p_[2] - r.p));
        r.valid = g_t != 0 && std::isfinite(dot(r.along, r.along));
        return r;
    }

private:
    bool parallel_;
    V origin_, p_[3], n_[3];

    TR_HD V towards(const V &p) const { return parallel_ ? -origin_ : origin_ - p; }
    // Of the quadratic form.
    TR_HD S coefficient(size_t i, size_t j) const {
        const S g = dot(n_[i], towards(p_[j]));
        return i == j ? g : (g + dot(n_[j], towards(p_[i]))) / 2;
    }
    // Of the quadratic polynomial with these Bernstein coefficients, in (0, 1): the one, the first or the second.
    TR_HD static S root(S A, S B, S C, bool second, bool once) {
        // with u = t / (1 - t): C u^2 + 2 B u + A = 0
        const S square = B * B - A * C;
        if (!(square >= 0)) return S(-1);
        const S q = -(B + std::copysign(std::sqrt(square), B));
        const S u[2] = {q / C, A / q};
        auto place = [](S x) { return std::isfinite(x) ? x / (1 + x) : S(1); };
        if (once) return place(A * C <= 0 && u[0] > 0 ? u[0] : u[1]);
        if (!(u[0] > 0 && u[1] > 0)) return S(-1);
        return place(second ? std::max(u[0], u[1]) : std::min(u[0], u[1]));
    }
};

}  // namespace tr
