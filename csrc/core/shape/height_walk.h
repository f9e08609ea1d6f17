// Rays and height fields, without a mesh and without a tree. The square is a grid of cells, between whose heights the
// surface is one polynomial. A surface of B-splines or bilinear patches lies in the convex hull of its control values,
// so their least and largest over blocks of 8 x 8 cells, and over 8 x 8 of those, say where a ray has nothing to look
// for (Tevs, Ihrke and Seidel, "Maximum Mipmaps for Fast, Accurate, and Scalable Dynamic Height Field Rendering", I3D
// 2008). Where it has, it walks from cell to cell and is intersected by Newton's iteration between bounds.
#pragma once

#include "../math/rows.h"
#include "../math/spline.h"
#include "../math/vector.h"

namespace tr {

struct HeightRange {
    float low, high;
};

// A field as tables: heights (rows, columns), and ranges of the control values of 8 x 8 cells and of 64 x 64.
struct HeightTable {
    const float *heights;
    const HeightRange *fine, *coarse;
    int32_t rows, columns, fine_columns, coarse_columns;
    HeightRange range;  // of all
    float largest;      // of the absolute values
    bool linear;        // bilinear patches, not splines
};

// One coordinate along a ray.
template <class F>
struct HeightLine {
    using I = IntOf<F>;
    F o, d, inverse;
    MaskOf<F> forward;

    TR_INLINE HeightLine(const F &origin, const F &direction) : o(origin), d(direction), inverse(F(1) / direction) {
        forward = mask<F>(direction > F(0));
    }
    TR_INLINE F at(const F &t) const { return fmadd(t, d, o); }
    TR_INLINE F time(const F &x) const { return (x - o) * inverse; }
    TR_INLINE void clip(const F &low, const F &high, F &enter, F &leave) const {
        F a = time(low), b = time(high);
        enter = max(enter, min(a, b));
        leave = min(leave, max(a, b));
    }
    // The cell at t, between two others.
    TR_INLINE I cell(const F &t, const I &low, const I &high) const {
        return max(low, min(high, I(floor(max(F(-1), min(F(2e9f), at(t)))))));
    }
};

// A direction without zeros: what changes by so little does not change.
template <class F>
TR_INLINE F not_zero(const F &x, const F &tiny) {
    return select(mask<F>(abs(x) < tiny), mulsign(tiny, x), x);
}

// N x N heights take part in a cell: 4 in a spline, 2 in a bilinear patch. Cell i lies between the centres of the
// heights i - 1 and i, or between one and the border: coordinates of the grid are X = columns u + 1/2.
template <class F, int N>
struct HeightWalk {
    using U = UIntOf<F>;
    using I = IntOf<F>;
    using M = MaskOf<F>;
    const HeightTable &field;
    HeightLine<F> x, y, z;

    TR_INLINE static M is(const MaskOf<I> &m) { return mask<F>(m); }
    TR_INLINE static I choose(const M &m, const I &a, const I &b) { return select(mask<I>(m), a, b); }

    TR_INLINE HeightWalk(const HeightTable &f, const Vec3<F> &o, const Vec3<F> &d)
        : field(f),
          x(grid(o.x, f.columns) + F(0.5), grid_step(d.x, f.columns)),
          y(grid(o.y, f.rows) + F(0.5), grid_step(d.y, f.rows)),
          z(o.z, d.z) {}

    TR_INLINE static F grid(const F &local, int n) { return (local + F(1)) * F(0.5f * float(n)); }
    TR_INLINE static F grid_step(const F &local, int n) { return local * F(0.5f * float(n)); }

    // The heights of the cells (ix, iy).
    struct Taps {
        F h[N][N];
    };
    TR_INLINE Taps load(const I &ix, const I &iy, const M &lanes) const {
        constexpr int Before = N / 2;
        Taps r;
        I first = ix - Before, top = iy - Before;
        const int columns = field.columns, rows = field.rows;
        M border = lanes && (is(first < 0) || is(first > columns - N) || is(top < 0) || is(top > rows - N));
        if (!any(border)) {
            for (int j = 0; j < N; ++j) gather_rows<F>(field.heights, U((top + j) * columns + first), lanes, r.h[j]);
            return r;
        }
        I column[N];
        for (int i = 0; i < N; ++i) column[i] = max(I(0), min(I(columns - 1), first + i));
        for (int j = 0; j < N; ++j) {
            I row = max(I(0), min(I(rows - 1), top + j)) * columns;
            for (int i = 0; i < N; ++i) r.h[j][i] = gather<F>(field.heights, U(row + column[i]), lanes);
        }
        return r;
    }

    // How far the ray is above the surface at t, and how that changes with t.
    struct Value {
        F f, slope;
    };
    TR_INLINE Value value(const Taps &taps, const F &fx0, const F &fy0, const F &t) const {
        F fx = x.at(t) - fx0, fy = y.at(t) - fy0, wx[N], wy[N], sx[N], sy[N];
        if constexpr (N == 4) {
            spline_weights(fx, wx);
            spline_weights(fy, wy);
            spline_slopes(fx, sx);
            spline_slopes(fy, sy);
        } else {
            wx[0] = F(1) - fx, wx[1] = fx, sx[0] = F(-1), sx[1] = F(1);
            wy[0] = F(1) - fy, wy[1] = fy, sy[0] = F(-1), sy[1] = F(1);
        }
        F h(0), by_x(0), by_y(0);
        for (int j = 0; j < N; ++j) {
            F along = taps.h[j][0] * wx[0], across = taps.h[j][0] * sx[0];
            for (int i = 1; i < N; ++i) {
                along = fmadd(taps.h[j][i], wx[i], along);
                across = fmadd(taps.h[j][i], sx[i], across);
            }
            h = fmadd(along, wy[j], h);
            by_x = fmadd(across, wy[j], by_x);
            by_y = fmadd(along, sy[j], by_y);
        }
        return {z.at(t) - h, z.d - by_x * x.d - by_y * y.d};
    }

    // A block of 2^Shift cells a side around the cells (ix, iy).
    template <int Shift>
    struct Block {
        I x0, y0;  // its first cell
        F to_x, to_y, out, in, until;
        M met;  // between `in` and `until` the ray is in the block and in the range of its heights
    };
    template <int Shift>
    TR_INLINE Block<Shift> block(const HeightRange *ranges, int columns, const I &ix, const I &iy, const F &t,
                                 const F &leave, const F &slack, const M &lanes) const {
        constexpr int Size = 1 << Shift;
        Block<Shift> r;
        r.x0 = (ix >> Shift) << Shift;
        r.y0 = (iy >> Shift) << Shift;
        r.to_x = x.time(F(r.x0 + choose(x.forward, I(Size), I(0))));
        r.to_y = y.time(F(r.y0 + choose(y.forward, I(Size), I(0))));
        r.out = max(t, min(min(r.to_x, r.to_y), leave));
        F range[2];
        gather_rows<F>(&ranges->low, U((iy >> Shift) * columns + (ix >> Shift)) * 2u, lanes, range);
        r.in = t;
        r.until = r.out;
        z.clip(range[0] - slack, range[1] + slack, r.in, r.until);
        r.met = mask<F>(r.in <= r.until);
        return r;
    }
    // Goes on to the cell behind the block.
    template <int Shift>
    TR_INLINE void pass(const Block<Shift> &b, I &ix, I &iy, F &t, const M &lanes) const {
        constexpr int Size = 1 << Shift;
        M across = mask<F>(b.to_x <= b.to_y);
        I end_x = b.x0 + (Size - 1), end_y = b.y0 + (Size - 1);
        I next_x = choose(x.forward, end_x + 1, b.x0 - 1), next_y = choose(y.forward, end_y + 1, b.y0 - 1);
        // never back, though rounding would have it
        I along_x = x.cell(b.out, choose(x.forward, ix, b.x0), choose(x.forward, end_x, ix));
        I along_y = y.cell(b.out, choose(y.forward, iy, b.y0), choose(y.forward, end_y, iy));
        ix = choose(lanes, choose(across, next_x, along_x), ix);
        iy = choose(lanes, choose(across, along_y, next_y), iy);
        t = select(lanes, b.out, t);
    }

    // A root of f between two distances; f(low) has the sign of `side`, f(high) has not.
    struct Bracket {
        F low, high, guess;
    };
    TR_INLINE F root(const Taps &taps, const F &fx0, const F &fy0, const F &side, Bracket b, const F &slack,
                     M lanes) const {
        F t = b.guess;
        for (int step = 0; step < 24 && any(lanes); ++step) {
            Value v = value(taps, fx0, fy0, t);
            M before = mask<F>(v.f * side > F(0));
            b.low = select(lanes && before, t, b.low);
            b.high = select(lanes && !before, t, b.high);
            F next = t - v.f / select(mask<F>(v.slope == F(0)), F(1), v.slope);
            M inside = mask<F>(next >= b.low) && mask<F>(next <= b.high) && mask<F>(v.slope != F(0));
            next = select(inside, next, F(0.5) * (b.low + b.high));
            F apart = abs(next - t);
            t = select(lanes, next, t);
            // as near as the numbers tell
            lanes = lanes && mask<F>(apart > F(2.4e-7f) * abs(t)) && mask<F>(abs(v.f) > F(0.02f) * slack);
        }
        return t;
    }

    // Where f may change its sign between l and r, and both ends are on one side: its extremum, if the slopes say that
    // there is one. Returns the lanes where it is on the other side; `at` is where.
    TR_INLINE M touch(const Taps &taps, const F &fx0, const F &fy0, const F &side, F l, Value vl, F r, Value vr,
                      M lanes, F &at) const {
        // a convex function is above its tangents
        lanes = lanes && mask<F>(side * vl.slope < F(0)) && mask<F>(side * vr.slope > F(0)) &&
                mask<F>(side * fmadd(vl.slope, r - l, vl.f) < F(0)) &&
                mask<F>(side * fmadd(vr.slope, l - r, vr.f) < F(0));
        M found(false);
        F gl = vl.slope, gr = vr.slope;
        for (int step = 0; step < 10 && any(lanes); ++step) {
            F fraction = gl / (gl - gr);
            F t = l + (r - l) * max(F(0.1f), min(F(0.9f), fraction));
            Value v = value(taps, fx0, fy0, t);
            M beyond = lanes && mask<F>(side * v.f < F(0));
            at = select(beyond, t, at);
            found = found || beyond;
            lanes = lanes && !beyond && mask<F>(t > l) && mask<F>(t < r);
            M left = mask<F>(side * v.slope < F(0));
            l = select(left, t, l), gl = select(left, v.slope, gl);
            r = select(left, r, t), gr = select(left, gr, v.slope);
        }
        return found;
    }
};

// Where rays, given in the field's own frame, meet it before `tmax`: which do, and where; with `Occlusion` only which.
template <int N, bool Occlusion, class F>
TR_INLINE MaskOf<F> walk_heights(const HeightTable &field, const Vec3<F> &o, Vec3<F> d, const F &tmax,
                                 const MaskOf<F> &valid, F &t_hit, F &u, F &v) {
    using I = IntOf<F>;
    using M = MaskOf<F>;
    using Walk = HeightWalk<F, N>;
    auto is = [](const MaskOf<I> &m) { return Walk::is(m); };
    auto choose = [](const M &m, const I &a, const I &b) { return Walk::choose(m, a, b); };
    F tiny = max(max_abs(d) * F(1e-12f), F(1e-37f));
    d = {not_zero(d.x, tiny), not_zero(d.y, tiny), not_zero(d.z, tiny)};
    const Walk w(field, o, d);
    // rounding of heights along the ray
    F slack = F(2e-6f) * (abs(o.z) + F(field.largest));
    F enter(0), leave = tmax;
    w.x.clip(F(0.5), F(float(field.columns) + 0.5f), enter, leave);
    w.y.clip(F(0.5), F(float(field.rows) + 0.5f), enter, leave);
    w.z.clip(F(field.range.low) - slack, F(field.range.high) + slack, enter, leave);
    M open = valid && mask<F>(enter <= leave), hit(false);
    if (!any(open)) return hit;

    const I none(0), last_x(field.columns), last_y(field.rows);
    I ix = w.x.cell(enter, none, last_x), iy = w.y.cell(enter, none, last_y);
    F t = enter, side(0);
    while (any(open)) {
        auto coarse = w.template block<6>(field.coarse, field.coarse_columns, ix, iy, t, leave, slack, open);
        M far = open && !coarse.met;
        auto fine = w.template block<3>(field.fine, field.fine_columns, ix, iy, t, leave, slack, open);
        M walking = open && coarse.met && fine.met, within = walking;
        if (any(walking)) {
            F in = select(walking, fine.in, t);
            I end_x = fine.x0 + 7, end_y = fine.y0 + 7;
            M later = walking && mask<F>(in > t);
            ix = choose(
                later, w.x.cell(in, choose(w.x.forward, ix, fine.x0), choose(w.x.forward, min(end_x, last_x), ix)), ix);
            iy = choose(
                later, w.y.cell(in, choose(w.y.forward, iy, fine.y0), choose(w.y.forward, min(end_y, last_y), iy)), iy);
            t = in;
            while (any(walking)) {
                F to_x = w.x.time(F(ix + choose(w.x.forward, I(1), I(0)))),
                  to_y = w.y.time(F(iy + choose(w.y.forward, I(1), I(0))));
                F out = min(to_x, to_y), b = max(t, min(out, fine.until));
                auto taps = w.load(ix, iy, walking);
                F fx0(ix), fy0(iy);
                auto va = w.value(taps, fx0, fy0, t), vb = w.value(taps, fx0, fy0, b);
                side = select(walking && mask<F>(side == F(0)), mulsign(F(1), va.f), side);
                // The side the ray is on is kept from cell to cell, so that none slips through where they meet.
                M behind = walking && mask<F>(side * va.f < F(0)), found = behind;
                F low = t, high = t;
                auto look = [&](const F &l, const auto &vl, const F &r, const auto &vr, const M &lanes) {
                    M crossed = lanes && mask<F>(side * vr.f < F(0));
                    F at = r;
                    M some = crossed || w.touch(taps, fx0, fy0, side, l, vl, r, vr, lanes && !crossed, at);
                    low = select(some, l, low);
                    high = select(some, at, high);
                    found = found || some;
                };
                F begin = t;
                auto vbegin = va;
                if constexpr (N == 4) {
                    // far enough through the cell for the polynomial to turn twice: in two parts
                    M wide = walking && !found && mask<F>((b - t) * (abs(w.x.d) + abs(w.y.d)) > F(0.25f));
                    if (any(wide)) {
                        F middle = F(0.5) * (t + b);
                        auto vm = w.value(taps, fx0, fy0, middle);
                        look(t, va, middle, vm, wide);
                        begin = select(wide, middle, t);
                        vbegin = {select(wide, vm.f, va.f), select(wide, vm.slope, va.slope)};
                    }
                }
                look(begin, vbegin, b, vb, walking && !found);
                if (any(found)) {
                    if constexpr (!Occlusion) {
                        F change = va.f - vb.f;
                        F guess = t + (b - t) * (va.f / select(mask<F>(change == F(0)), F(1), change));
                        guess = select(mask<F>(guess >= low) && mask<F>(guess <= high), guess, F(0.5) * (low + high));
                        F at = w.root(taps, fx0, fy0, side, {low, high, guess}, slack, found);
                        t_hit = select(found, at, t_hit);
                        u = select(found, (w.x.at(at) - F(0.5)) * F(1 / float(field.columns)), u);
                        v = select(found, (w.y.at(at) - F(0.5)) * F(1 / float(field.rows)), v);
                    }
                    hit = hit || found;
                    open = open && !found;
                    walking = walking && !found;
                }
                t = select(walking, b, t);
                walking = walking && mask<F>(out < fine.until);
                M across = mask<F>(to_x <= to_y);
                ix = choose(walking && across, choose(w.x.forward, ix + 1, ix - 1), ix);
                iy = choose(walking && !across, choose(w.y.forward, iy + 1, iy - 1), iy);
                M outside = is((ix & ~7) != fine.x0) || is((iy & ~7) != fine.y0);
                within = within && !(walking && outside);
                walking = walking && !outside;
            }
        }
        // those that are not in the next block already
        if (any(open && far)) w.pass(coarse, ix, iy, t, open && far);
        M near = open && !far && (within || !fine.met);
        if (any(near)) w.pass(fine, ix, iy, t, near);
        open = open && mask<F>(t < leave) && is(ix >= 0) && is(ix <= last_x) && is(iy >= 0) && is(iy <= last_y);
    }
    if constexpr (!Occlusion) {
        u = max(F(0), min(F(1), u));
        v = max(F(0), min(F(1), v));
    }
    return hit;
}

}  // namespace tr
