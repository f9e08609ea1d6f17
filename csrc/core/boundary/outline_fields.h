// Outlines of height fields: contours of splines and of bilinear patches, borders, and the creases between patches.
//
// All is in the frame of the shape, z = h(x, y), to which side and tangency are the same as in the world. With w
// towards where rays come from, o - x, or minus their direction, the contour is g = N.w = 0 with N = (-h_x, -h_y, 1). A
// line of constant v meets it where a polynomial of degree 3 a cell is zero, all of whose roots are found between those
// of its derivative; one of constant u likewise. The parameter chooses one of these lines, and one of the n roots
// there: by length, a contour with the unit tangent (t_u, t_v, ...) gets the density (|t_v| / n_u + |t_u| / n_v) / 2 of
// both ways together. Where a spline touches a ray it has the curvature K = h_xx w_x^2 + 2 h_xy w_x w_y + h_yy w_y^2
// along it, and hides what is below if it is negative, else what is above.
//
// Points move with the material: a contour slides over its surface, but not across the ray.
#pragma once

#include <algorithm>
#include <cmath>

#include "../shape/heightfield.h"
#include "outline_table.h"

namespace tr {

template <class S>
struct FieldPoint {
    Vec3<S> p, along, hiding;  // in the world; `along` is dp/ds, `hiding` points to what hides, 0 of creases
    bool valid;
    S room;
};

template <class S>
class FieldOutline {
    using V = Vec3<double>;
    using P = Vec3<S>;

public:
    // As rays from `origin`, or along the unit vector of this name if `parallel`, see it.
    TR_HD FieldOutline(const SceneView<S> &scene, const OutlineCurve &curve, const P &origin, bool parallel)
        : heights_(scene, uint32_t(curve.shape)),
          matrix_(scene.shape_matrices + 24 * size_t(curve.shape)),
          curve_(curve),
          parallel_(parallel) {
        const P o = parallel ? transform_vector(matrix_ + 12, origin) : transform_point(matrix_ + 12, origin);
        origin_ = {double(o.x), double(o.y), double(o.z)};
    }

    // Whether there may be a contour: not where slopes are too small for one.
    TR_HD bool possible() const {
        const HeightBounds &b = curve_.bounds;
        const double x = std::fabs(origin_.x) + (parallel_ ? 0 : 1), y = std::fabs(origin_.y) + (parallel_ ? 0 : 1);
        const double above = parallel_ ? origin_.z : origin_.z - double(b.high),
                     below = parallel_ ? -origin_.z : double(b.low) - origin_.z;
        return !(std::max(above, below) > double(b.slope_x) * x + double(b.slope_y) * y);
    }

    TR_HD FieldPoint<S> at(S s) const {
        switch (curve_.kind) {
            case OutlineCurve::FieldBorder:
                return border(double(s));
            case OutlineCurve::FieldCreases:
                return crease(double(s));
            default:
                return contour(s);
        }
    }

private:
    const HeightView<S> heights_;
    const S *matrix_;
    const OutlineCurve &curve_;
    const bool parallel_;
    V origin_;

    TR_HD bool linear() const { return heights_.linear; }
    TR_HD V towards(const V &x) const { return parallel_ ? origin_ * -1.0 : origin_ - x; }
    TR_HD static P single(const V &v) { return {S(v.x), S(v.y), S(v.z)}; }
    TR_HD static double sign(double x) { return double(x > 0) - double(x < 0); }

    struct Local {
        V x;
        double u, v, uu, uv, vv;  // derivatives of the height
    };
    TR_HD Local local(double u, double v) const {
        const HeightPoint<S> h = height_at<S>(heights_, S(u), S(v), true);
        return {
            {2 * u - 1, 2 * v - 1, double(h.z)}, double(h.u), double(h.v), double(h.uu), double(h.uv), double(h.vv)};
    }
    TR_HD FieldPoint<S> point(const Local &at, const V &along, const V &hiding, bool valid, double room) const {
        FieldPoint<S> r;
        r.p = transform_point(matrix_, single(at.x)), r.along = transform_vector(matrix_, single(along));
        r.hiding = transform_vector(matrix_, single(hiding));
        r.valid = valid, r.room = S(room);
        return r;
    }

    // ------------------------------------------------------------------------------------------------------- contours
    // g along a line, cell by cell: power bases of the height along it, and of its slope across it.
    struct Cell {
        double low, high, q[4];
        int index;  // f = n a - 1/2 - index, a the coordinate along the line

        TR_HD double value(double f) const { return q[0] + f * (q[1] + f * (q[2] + f * q[3])); }
    };
    // Calls visit(cell) for those where g may have a root, of the line of constant v (across = 1) or u (0).
    template <class Visit>
    TR_HD void for_cells(int across, double fixed, Visit &&visit) const {
        const int n = across == 1 ? heights_.columns : heights_.rows,
                  m = across == 1 ? heights_.rows : heights_.columns;
        const HeightAxis<double> axis(fixed, m, linear());
        const auto value = [&](int i, const double (&weight)[4]) {
            i = std::clamp(i, 0, n - 1);
            double sum = 0;
            for (int j = 0; j < 4; ++j) {
                const int k = int(axis.index[j]);
                sum += weight[j] * double(heights_.data[across == 1 ? k * n + i : i * m + k]);
            }
            return sum;
        };
        double h[4], slope[4];
        for (int i = 0; i < 4; ++i) h[i] = value(i - 2, axis.weight), slope[i] = value(i - 2, axis.slope);
        const double other = 2 * fixed - 1, step = 2.0 / n;
        const double o_along = across == 1 ? origin_.x : origin_.y, o_across = across == 1 ? origin_.y : origin_.x;
        for (int i = -1; i < n; ++i) {
            double a[4], b[4];
            to_powers(h, a), to_powers(slope, b);
            Cell cell;
            cell.index = i, cell.low = i < 0 ? 0.5 : 0, cell.high = i == n - 1 ? 0.5 : 1;
            // slopes by x and y are half of those by u and v
            const double d[3] = {a[1] / step, 2 * a[2] / step, 3 * a[3] / step};
            const double x0 = step * (i + 0.5) - 1, x = parallel_ ? -o_along : o_along - x0, e = parallel_ ? 0 : step;
            const double y = parallel_ ? -o_across : o_across - other, z = parallel_ ? 0 : 1;
            cell.q[0] = (parallel_ ? -origin_.z : origin_.z) - d[0] * x - b[0] * y / 2 - a[0] * z;
            cell.q[1] = d[0] * e - d[1] * x - b[1] * y / 2 - a[1] * z;
            cell.q[2] = d[1] * e - d[2] * x - b[2] * y / 2 - a[2] * z;
            cell.q[3] = d[2] * e - b[3] * y / 2 - a[3] * z;
            if (may_vanish(cell.q)) visit(cell);
            for (int k = 0; k < 3; ++k) h[k] = h[k + 1], slope[k] = slope[k + 1];
            h[3] = value(i + 3, axis.weight), slope[3] = value(i + 3, axis.slope);
        }
    }
    TR_HD void to_powers(const double (&c)[4], double (&a)[4]) const {
        if (linear()) {
            a[0] = c[1], a[1] = c[2] - c[1], a[2] = a[3] = 0;
            return;
        }
        a[0] = (c[0] + 4 * c[1] + c[2]) / 6, a[1] = (c[2] - c[0]) / 2;
        a[2] = (c[0] - 2 * c[1] + c[2]) / 2, a[3] = (c[3] - c[0] + 3 * (c[1] - c[2])) / 6;
    }
    // Not where the numbers of the Bernstein basis have one sign.
    TR_HD static bool may_vanish(const double (&q)[4]) {
        const double b1 = q[0] + q[1] / 3, b2 = b1 + (q[1] + q[2]) / 3, b3 = q[0] + q[1] + q[2] + q[3];
        return !((q[0] > 0 && b1 > 0 && b2 > 0 && b3 > 0) || (q[0] < 0 && b1 < 0 && b2 < 0 && b3 < 0));
    }
    // Calls visit(cell, a, b) for every part of a line between zeros of the slope of g where that changes its sign.
    template <class Visit>
    TR_HD void for_roots(int across, double fixed, Visit &&visit) const {
        for_cells(across, fixed, [&](const Cell &cell) {
            double ends[4] = {cell.low, cell.high, 0, 0};
            int n = 1;
            const double A = 3 * cell.q[3], B = cell.q[2], C = cell.q[1], square = B * B - A * C;
            if (square > 0) {
                const double q = -(B + std::copysign(std::sqrt(square), B));
                double turns[2] = {q / A, C / q};
                if (const double first = turns[0]; first > turns[1]) turns[0] = turns[1], turns[1] = first;
                for (double t : turns)
                    if (t > ends[n - 1] && t < cell.high) ends[n++] = t;
                ends[n] = cell.high;
            }
            for (int k = 0; k < n; ++k)
                if ((cell.value(ends[k]) > 0) != (cell.value(ends[k + 1]) > 0)) visit(cell, ends[k], ends[k + 1]);
        });
    }
    TR_HD int count(int across, double fixed) const {
        int n = 0;
        for_roots(across, fixed, [&](const Cell &, double, double) { ++n; });
        return n;
    }
    TR_HD static double root(const Cell &cell, double a, double b) {
        const bool rising = cell.value(b) > 0;
        for (int i = 0; i < 60 && a < b; ++i) {
            const double f = (a + b) / 2;
            if (f == a || f == b) break;
            ((cell.value(f) > 0) == rising ? b : a) = f;
        }
        return (a + b) / 2;
    }

    TR_HD FieldPoint<S> contour(S s) const {
        FieldPoint<S> none{};
        if (!possible()) return none;
        const int across = s < S(0.5) ? 1 : 0;
        const double fixed = 2 * double(s) - (across == 1 ? 0 : 1);
        struct Part {
            Cell cell;
            double a, b;
        };
        // few lines meet a contour more often; of those its parts are found once more
        constexpr int few = 8;
        Part parts[few];
        int n_parts = 0;
        for_roots(across, fixed, [&](const Cell &cell, double a, double b) {
            if (n_parts < few) parts[n_parts] = {cell, a, b};
            ++n_parts;
        });
        if (n_parts == 0) return none;
        const int n = across == 1 ? heights_.columns : heights_.rows, chosen = int(hash(s) * double(n_parts));
        Part part = parts[std::min(chosen, few - 1)];
        if (chosen >= few) {
            int at = 0;
            for_roots(across, fixed, [&](const Cell &cell, double a, double b) {
                if (at++ == chosen) part = {cell, a, b};
            });
        }
        const double f = root(part.cell, part.a, part.b), free = (part.cell.index + 0.5 + f) / n;
        const double u = across == 1 ? free : fixed, v = across == 1 ? fixed : free;
        const Local at = local(u, v);
        const V w = towards(at.x);
        const double g_u = at.uu * w.x + at.uv * w.y, g_v = at.uv * w.x + at.vv * w.y;
        V along{-2 * g_v, 2 * g_u, at.v * g_u - at.u * g_v};
        const double curvature = g_u * w.x + g_v * w.y;
        // by the lengths of the frame, which have the same ratio as those of the world
        const double here = double(n_parts), there = std::max(1, count(1 - across, across == 1 ? u : v));
        const double by_u = std::fabs(g_u) / (across == 1 ? here : there),  // lines of constant v
            by_v = std::fabs(g_v) / (across == 1 ? there : here), density = (by_u + by_v) / 2;
        along = along * (1 / density);
        return point(at, along, {0, 0, sign(curvature)}, density > 0 && curvature != 0, INFINITY);
    }
    // In [0, 1), of the bits of a number that has been used (Murmur3's mixing of them).
    TR_HD static double hash(S s) {
        uint32_t x = uint32_t(int64_t(double(s) * 0x1p32));
        x ^= x >> 16, x *= 0x85EBCA6Bu, x ^= x >> 13, x *= 0xC2B2AE35u, x ^= x >> 16;
        return double(x) * 0x1p-32;
    }

    // --------------------------------------------------------------------------------------------- borders and creases
    TR_HD FieldPoint<S> border(double s) const {
        const int side = std::min(3, int(4 * s));
        const double t = 4 * s - side, end = side % 2;
        const bool first = side < 2;  // u is constant
        const Local at = first ? local(end, t) : local(t, end);
        const double in = end > 0 ? -1 : 1;
        const V by_u{2, 0, at.u}, by_v{0, 2, at.v};
        return point(at, (first ? by_v : by_u) * 4.0, (first ? by_u : by_v) * in, true, INFINITY);
    }

    // The lines where bilinear patches meet.
    TR_HD FieldPoint<S> crease(double s) const {
        const int lines = heights_.columns + heights_.rows, line = std::min(lines - 1, int(s * lines));
        const double t = s * lines - line;
        const bool first = line < heights_.columns;  // u is constant
        const int n = first ? heights_.columns : heights_.rows, k = first ? line : line - heights_.columns;
        const double fixed = (k + 0.5) / n, beside = 0.25 / n;
        const Local at = first ? local(fixed, t) : local(t, fixed);
        const double before = first ? local(fixed - beside, t).x.z : local(t, fixed - beside).x.z,
                     after = first ? local(fixed + beside, t).x.z : local(t, fixed + beside).x.z;
        const double slope0 = (at.x.z - before) / beside, slope1 = (after - at.x.z) / beside;
        const V w = towards(at.x);
        auto seen = [&](double across) {
            return w.z - (first ? across * w.x + at.v * w.y : at.u * w.x + across * w.y) / 2;
        };
        const bool folds = (seen(slope0) > 0) != (seen(slope1) > 0);
        const V along = (first ? V{0, 2, at.v} : V{2, 0, at.u}) * double(lines);
        FieldPoint<S> r = point(at, along, {0, 0, folds ? sign(slope1 - slope0) : 0.0}, slope0 != slope1, INFINITY);
        // how far the patches reach across the ray
        const P d = transform_vector(matrix_, single(w));
        const P across = cross(d, r.along);
        const double length = std::sqrt(double(dot(across, across)));
        for (double slope : {slope0, slope1}) {
            const V side = (first ? V{2, 0, slope} : V{0, 2, slope}) * (1.0 / n);
            const double room = std::fabs(double(dot(transform_vector(matrix_, single(side)), across))) / length;
            r.room = std::min(r.room, S(room));
        }
        return r;
    }
};

}  // namespace tr
