// Rays and grids of distances, see sdfgrid.h. Along a ray the trilinear interpolant in a cell is a cubic polynomial;
// its first root is between two of its extrema, where Newton's iteration between bounds finds it (Marmitt, Kleer, Wald,
// Friedrich and Slusallek, "Fast and Accurate Ray-Voxel Intersection Techniques for Iso-Surface Ray Tracing", VMV 2004;
// Hansson-Soederlund, Evans and Akenine-Moeller, "Ray Tracing of Signed Distance Function Grids", JCGT 11(3), 2022).
// From cell to cell rays walk through a table that says of every cell how large the empty block around it is, so that a
// step is one look-up, however far it leads.
#pragma once

#include "sdf_cell.h"

namespace tr {

// A grid as tables, in single precision: values at the corners of cells, x fastest, and a byte a cell: 0 where the
// surface may be, else the side of the largest aligned empty block of cells around it, a power of two.
struct SdfTable {
    const float *values;
    const uint32_t *empty;
    int32_t cells[3], stride[3], bits[3];
    int32_t first[3], last[3];  // cells that are not empty lie between these; last[0] < 0: there are none
};

// What a ray meets: the primitive and (b1, b2) of sdfgrid.h.
template <class F>
struct SdfFound {
    F t, b1, b2;
    UIntOf<F> primitive;
};

// c0 + c1 s + c2 s^2 + c3 s^3 from s = 0 to 1.
template <class F>
struct SdfCubic {
    F c0, c1, c2, c3;

    TR_INLINE F at(const F &s) const { return fmadd(fmadd(fmadd(c3, s, c2), s, c1), s, c0); }
    TR_INLINE F slope(const F &s) const { return fmadd(fmadd(F(3) * c3, s, F(2) * c2), s, c1); }

    // Its extrema between 0 and 1 in order; 1 in place of those that are not.
    TR_INLINE void extrema(F &first, F &second) const {
        F a = F(3) * c3, b = c2, square = b * b - a * c1;
        F q = -(b + mulsign(sqrt(max(square, F(0))), b));
        F r = q / a, s = c1 / q;  // infinite or NaN: none
        auto keep = [&](const F &x) {
            return select(mask<F>(square > F(0)) && mask<F>(x > F(0)) && mask<F>(x < F(1)), x, F(1));
        };
        r = keep(r), s = keep(s);
        first = min(r, s), second = max(r, s);
    }

    // The first place where it is on the other side than `side`, which the ray was on before; where there is none is
    // left out of `lanes`.
    TR_INLINE F first_root(const F &side, MaskOf<F> &lanes) const {
        F e1, e2;
        extrema(e1, e2);
        auto other = [&](const F &s) { return mask<F>(side * at(s) < F(0)); };
        using M = MaskOf<F>;
        const M by_first = other(e1), by_second = other(e2), by_end = other(F(1));
        lanes = lanes && (by_first || by_second || by_end);
        F low = select(by_first, F(0), select(by_second, e1, e2)),
          high = select(by_first, e1, select(by_second, e2, F(1)));
        F v_low = at(low), v_high = at(high), change = v_low - v_high;
        F s = low + (high - low) * (v_low / select(mask<F>(change == F(0)), F(1), change));
        M open = lanes;
        for (int step = 0; step < 24 && any(open); ++step) {
            s = max(low, min(high, s));
            F v = at(s), d = slope(s);
            M before = mask<F>(v * side > F(0));
            low = select(open && before, s, low);
            high = select(open && !before, s, high);
            F next = s - v / select(mask<F>(d == F(0)), F(1), d);
            M inside = mask<F>(next >= low) && mask<F>(next <= high) && mask<F>(d != F(0));
            next = select(inside, next, F(0.5) * (low + high));
            F apart = abs(next - s);
            s = select(open, next, s);
            open = open && mask<F>(apart > F(1e-7f)) && mask<F>(v != F(0));
        }
        return s;
    }
};

// Where rays, given in the unit cube's frame, meet the surface before `tmax`: which do, and where; with `Occlusion`
// only which.
template <bool Occlusion, class F>
TR_INLINE MaskOf<F> walk_sdf(const SdfTable &grid, const Vec3<F> &origin, const Vec3<F> &direction, const F &tmax,
                             const MaskOf<F> &valid, SdfFound<F> &found) {
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    using I = IntOf<F>;
    const auto choose = [](const M &m, const I &a, const I &b) { return select(mask<I>(m), a, b); };
    M hit(false);
    if (grid.last[0] < 0) return hit;  // there is no cell to begin in
    const F os[3] = {origin.x, origin.y, origin.z}, ds[3] = {direction.x, direction.y, direction.z};
    F o[3], d[3], inverse[3], enter(0), leave = tmax;
    M forward[3];
    const F scale(float(max(grid.cells[0], max(grid.cells[1], grid.cells[2]))));
    // a direction without zeros: what changes by so little does not change
    F tiny = max(max_abs(direction) * scale * F(1e-12f), F(1e-37f));
    for (int a = 0; a < 3; ++a) {
        o[a] = os[a] * F(float(grid.cells[a]));
        d[a] = ds[a] * F(float(grid.cells[a]));
        d[a] = select(mask<F>(abs(d[a]) < tiny), mulsign(tiny, d[a]), d[a]);
        inverse[a] = F(1) / d[a];
        forward[a] = mask<F>(d[a] > F(0));
        F low = (F(float(grid.first[a])) - o[a]) * inverse[a], high = (F(float(grid.last[a] + 1)) - o[a]) * inverse[a];
        enter = max(enter, min(low, high));
        leave = min(leave, max(low, high));
    }
    M open = valid && mask<F>(enter <= leave);
    if (!any(open)) return hit;

    auto cell_at = [&](int a, const F &t, const I &low, const I &high) {
        F x = max(F(-1), min(F(2e9f), fmadd(t, d[a], o[a])));
        return max(low, min(high, I(floor(x))));
    };
    I cell[3];
    for (int a = 0; a < 3; ++a) cell[a] = cell_at(a, enter, I(grid.first[a]), I(grid.last[a]));
    F t = enter, side(0);
    while (any(open)) {
        U index = U((cell[2] * grid.cells[1] + cell[1]) * grid.cells[0] + cell[0]);
        U word = gather<U>(grid.empty, index >> 2, mask<U>(open));
        I empty = I((word >> ((index & 3u) * 8u)) & 255u);
        M full = open && mask<F>(empty == 0);
        I size = choose(full, I(1), empty), low[3];
        F to[3];
        for (int a = 0; a < 3; ++a) {
            low[a] = cell[a] & (I(0) - size);
            to[a] = (F(choose(forward[a], low[a] + size, low[a])) - o[a]) * inverse[a];
        }
        F out = max(t, min(min(to[0], to[1]), min(to[2], leave)));
        if (any(full)) {
            // f along the ray from t to out, in parts of this way
            F corner[8], at[3], along[3], length = out - t;
            I base = cell[2] * grid.stride[2] + cell[1] * grid.stride[1] + cell[0];
            for (int b = 0; b < 8; b += 2) {
                F row[2];
                gather_rows<F>(grid.values, U(base + ((b >> 1 & 1) * grid.stride[1] + (b >> 2) * grid.stride[2])), full,
                               row);
                corner[b] = row[0], corner[b + 1] = row[1];
            }
            for (int a = 0; a < 3; ++a) {
                at[a] = fmadd(t, d[a], o[a]) - F(cell[a]);
                along[a] = d[a] * length;
            }
            SdfCorners<F> f(corner);
            f.evaluate(at);
            SdfCubic<F> c{
                f.value, f.slope[0] * along[0] + f.slope[1] * along[1] + f.slope[2] * along[2],
                f.mixed[0] * along[1] * along[2] + f.mixed[1] * along[2] * along[0] + f.mixed[2] * along[0] * along[1],
                f.all * along[0] * along[1] * along[2]};
            // The side the ray is on is kept from cell to cell, so that none slips through where they meet.
            side = select(full && mask<F>(side == F(0)), select(mask<F>(c.c0 < F(0)), F(-1), F(1)), side);
            M behind = full && mask<F>(side * c.c0 < F(0)), crossing = full && !behind;
            F s = c.first_root(side, crossing);
            M met = behind || crossing;
            if constexpr (!Occlusion) {
                if (any(met)) {
                    s = select(behind, F(0), s);
                    for (int a = 0; a < 3; ++a) at[a] = max(F(0), min(F(1), fmadd(s, along[a], at[a])));
                    f.evaluate(at);
                    F steep[3] = {abs(f.slope[0]), abs(f.slope[1]), abs(f.slope[2])};
                    M x = mask<F>(steep[0] >= steep[1]) && mask<F>(steep[0] >= steep[2]);
                    M y = !x && mask<F>(steep[1] >= steep[2]);
                    U axis = select(mask<U>(x), U(0u), select(mask<U>(y), U(1u), U(2u)));
                    I code = (cell[2] << grid.bits[1] | cell[1]) << grid.bits[0] | cell[0];
                    found.t = select(met, fmadd(s, length, t), found.t);
                    found.b1 = select(met, select(x, at[1], select(y, at[2], at[0])), found.b1);
                    found.b2 = select(met, select(x, at[2], select(y, at[0], at[1])), found.b2);
                    found.primitive = select(mask<U>(met), (U(code) << SdfCellBits::Axis) | axis, found.primitive);
                }
            }
            hit = hit || met;
            open = open && !met;
        }
        // to the block behind, never back, though rounding would have it
        M by_x = mask<F>(to[0] <= to[1]) && mask<F>(to[0] <= to[2]), by_y = !by_x && mask<F>(to[1] <= to[2]);
        const M by[3] = {by_x, by_y, !by_x && !by_y};
        M inside(true);
        for (int a = 0; a < 3; ++a) {
            I end = low[a] + size - 1, next = choose(forward[a], end + 1, low[a] - 1);
            I beside = cell_at(a, out, choose(forward[a], cell[a], low[a]), choose(forward[a], end, cell[a]));
            cell[a] = choose(open, choose(by[a], next, beside), cell[a]);
            inside = inside && mask<F>(cell[a] >= grid.first[a]) && mask<F>(cell[a] <= grid.last[a]);
        }
        t = out;
        open = open && mask<F>(t < leave) && inside;
    }
    return hit;
}

}  // namespace tr
