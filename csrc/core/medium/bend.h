// Rays that bend: the state of a ray in a medium whose index of refraction n varies, and one step of it.
//
// With the parameter t, dt = ds / n, a ray is dx/dt = p, dp/dt = grad Phi, Phi = n^2 / 2 (|p| = n). In voxels, q, and
// voxels a step, u, a step of velocity Verlet is a kick u += F(q), F = G grad Phi, and a drift q += u; the kicks at the
// beginning and the end are of the size that remains (Hairer, Lubich, Wanner, "Geometric Numerical Integration", 2006,
// section I.1.4). Between two kicks a ray is straight.
//
// Positions and velocities are integers, fixed-point numbers. A kick adds a function of the position to the velocity, a
// drift one of the velocity to the position: whatever their rounding is, subtracting the same integers goes back bit
// for bit (Levesque and Verlet, "Molecular dynamics and time reversibility", J. Stat. Phys. 72, 1993).
#pragma once

#include "../math/shared_rows.h"
#include "../math/vector.h"

namespace tr {

// Phi as a tensor product of B-splines, but for a constant, over a box of voxels [0, X] x [0, Y] x [0, Z].
template <class S>
struct BendField {
    static constexpr int32_t Padding = 2;  // coefficients beyond every border, those at the border once more
    const S *values;                       // (Z + 4, Y + 4, X + 4)
    int32_t n[3];                          // X, Y, Z
    S kick[6];                             // G: xx, yy, zz, xy, xz, yz

    TR_INLINE int32_t row() const { return n[0] + 2 * Padding; }
    TR_INLINE int32_t slice() const { return row() * (n[1] + 2 * Padding); }
    TR_INLINE size_t size() const { return size_t(slice()) * size_t(n[2] + 2 * Padding); }
};

// ------------------------------------------------------------------------------------------------------ fixed point
// How many bits positions (in all: a grid of more voxels has fewer behind the point) and velocities have.
template <class F>
struct BendNumber {
    using Int = IntOf<F>;
    static constexpr int Position = 30, Velocity = 28;
};
template <>
struct BendNumber<double> {
    using Int = int64_t;
    static constexpr int Position = 56, Velocity = 54;
};
template <class F>
using BendInt = typename BendNumber<F>::Int;
template <class F>
using BendLane = std::conditional_t<std::is_same_v<BendInt<F>, int64_t>, int64_t, int32_t>;

template <class F>
struct BendState {
    BendInt<F> q[3], u[3];
};

// Bits behind the point of positions within twice the length of the grid's longest side.
template <class F, class S>
TR_INLINE int position_bits(const BendField<S> &field) {
    int longest = field.n[0] > field.n[1] ? field.n[0] : field.n[1], bits = 0;
    longest = (longest > field.n[2] ? longest : field.n[2]) + 2 * BendField<S>::Padding;
    while ((1 << bits) < longest) ++bits;
    return BendNumber<F>::Position - bits;
}

// Rounded; what is to be converted has room, see within_fixed.
template <class F>
TR_INLINE BendInt<F> to_fixed(const F &x, int bits) {
    const F scaled = x * F(ScalarOf<F>(int64_t(1) << bits));
    return BendInt<F>(scaled + mulsign(F(ScalarOf<F>(0.5)), scaled));
}
template <class F>
TR_INLINE F from_fixed(const BendInt<F> &x, int bits) {
    return F(x) * F(ScalarOf<F>(1) / ScalarOf<F>(int64_t(1) << bits));
}
template <class F>
TR_INLINE Vec3<F> position_of(const BendState<F> &s, int bits) {
    return {from_fixed<F>(s.q[0], bits), from_fixed<F>(s.q[1], bits), from_fixed<F>(s.q[2], bits)};
}
template <class F>
TR_INLINE Vec3<F> velocity_of(const BendState<F> &s) {
    constexpr int bits = BendNumber<F>::Velocity;
    return {from_fixed<F>(s.u[0], bits), from_fixed<F>(s.u[1], bits), from_fixed<F>(s.u[2], bits)};
}

// Integers as the bits of numbers, which columns hold.
template <class F>
TR_INLINE F to_bits(const BendInt<F> &x) {
    if constexpr (Lanes<F>::Width == 1) {
        F r;
        std::memcpy(&r, &x, sizeof r);
        return r;
#if TR_HAS_PACKETS
    } else {
        return drjit::reinterpret_array<F>(x);
#endif
    }
}
template <class F>
TR_INLINE BendInt<F> from_bits(const F &x) {
    if constexpr (Lanes<F>::Width == 1) {
        BendInt<F> r;
        std::memcpy(&r, &x, sizeof r);
        return r;
#if TR_HAS_PACKETS
    } else {
        return drjit::reinterpret_array<BendInt<F>>(x);
#endif
    }
}
template <class F>
TR_INLINE BendState<F> state_from_bits(const Vec3<F> &q, const Vec3<F> &u) {
    return {{from_bits<F>(q.x), from_bits<F>(q.y), from_bits<F>(q.z)},
            {from_bits<F>(u.x), from_bits<F>(u.y), from_bits<F>(u.z)}};
}

// What numbers of any size are clamped to, so that sums of two do not overflow.
template <class F>
TR_INLINE F within_fixed(const F &x, int bits) {
    const F limit(ScalarOf<F>(int64_t(1) << (BendNumber<F>::Position + 1 - bits)) * ScalarOf<F>(0.49));
    return select(mask<F>(x == x), max(-limit, min(limit, x)), F(0));
}

template <class F>
TR_INLINE void start_bent(BendState<F> &s, const Vec3<F> &q, const Vec3<F> &u, int bits) {
    constexpr int fine = BendNumber<F>::Velocity;
    const F at[3] = {q.x, q.y, q.z}, v[3] = {u.x, u.y, u.z};
    for (int k = 0; k < 3; ++k) {
        s.q[k] = to_fixed<F>(within_fixed<F>(at[k], bits), bits);
        s.u[k] = to_fixed<F>(within_fixed<F>(v[k], fine), fine);
    }
}

// Sums wrap around: a ray that has left every bound is recognised and ended, not an error.
template <class F>
TR_INLINE BendInt<F> wrapping_add(const BendInt<F> &a, const BendInt<F> &b) {
    if constexpr (std::is_same_v<BendInt<F>, int64_t>)
        return int64_t(uint64_t(a) + uint64_t(b));
    else
        return BendInt<F>(UIntOf<F>(a) + UIntOf<F>(b));
}
template <class F>
TR_INLINE BendInt<F> wrapping_subtract(const BendInt<F> &a, const BendInt<F> &b) {
    if constexpr (std::is_same_v<BendInt<F>, int64_t>)
        return int64_t(uint64_t(a) - uint64_t(b));
    else
        return BendInt<F>(UIntOf<F>(a) - UIntOf<F>(b));
}

// The way of one step; rounded, not cut off, so that no drift is left over.
template <class F>
TR_INLINE BendInt<F> drift_of(const BendInt<F> &u, int bits) {
    const int shift = BendNumber<F>::Velocity - bits;
    return wrapping_add<F>(u, BendInt<F>(BendLane<F>(1) << (shift - 1))) >> shift;
}
template <class F>
TR_INLINE void drift(BendState<F> &s, int bits, const MaskOf<F> &active) {
    using I = BendInt<F>;
    for (int k = 0; k < 3; ++k)
        s.q[k] = wrapping_add<F>(s.q[k], select(mask<I>(active), drift_of<F>(s.u[k], bits), I(0)));
}
template <class F>
TR_INLINE void drift_back(BendState<F> &s, int bits, const MaskOf<F> &active) {
    using I = BendInt<F>;
    for (int k = 0; k < 3; ++k)
        s.q[k] = wrapping_subtract<F>(s.q[k], select(mask<I>(active), drift_of<F>(s.u[k], bits), I(0)));
}
template <class F, bool Back>
TR_INLINE void kick(BendState<F> &s, const Vec3<F> &force, const MaskOf<F> &active) {
    constexpr int fine = BendNumber<F>::Velocity;
    const F f[3] = {force.x, force.y, force.z};
    for (int k = 0; k < 3; ++k) {
        const BendInt<F> change = to_fixed<F>(select(active, within_fixed<F>(f[k], fine), F(0)), fine);
        s.u[k] = Back ? wrapping_subtract<F>(s.u[k], change) : wrapping_add<F>(s.u[k], change);
    }
}

// -------------------------------------------------------------------------------------------------------- the field
// Phi without its constant, its gradient, and its second derivatives xx, yy, zz, xy, xz, yz, by voxels.
template <class F>
struct BendSlope {
    F value;
    Vec3<F> slope;
};
template <class F>
struct BendJet : BendSlope<F> {
    F curve[6];
};

// Weights of the T coefficients of one axis around a point at fraction f of its cell, with two derivatives: B-splines
// of degree T - 1 (de Boor, "A Practical Guide to Splines", 1978, chapter IX).
template <int T, class F>
struct SplineWeights {
    F w[T], d[T], c[T];
    TR_INLINE explicit SplineWeights(const F &f) {
        using S = ScalarOf<F>;
        const F g = F(1) - f;
        if constexpr (T == 4) {
            const F ff = f * f, gg = g * g;
            w[0] = gg * g * F(S(1) / 6), w[3] = ff * f * F(S(1) / 6);
            w[1] = F(S(2) / 3) - ff * (F(1) - F(S(0.5)) * f), w[2] = F(S(2) / 3) - gg * (F(1) - F(S(0.5)) * g);
            d[0] = F(S(-0.5)) * gg, d[3] = F(S(0.5)) * ff;
            d[1] = f * (F(S(1.5)) * f - F(2)), d[2] = g * (F(2) - F(S(1.5)) * g);
            c[0] = g, c[3] = f, c[1] = F(3) * f - F(2), c[2] = F(1) - F(3) * f;
        } else {
            const F t = f - F(S(0.5));
            w[0] = g * g * F(S(0.5)), w[1] = F(S(0.75)) - t * t, w[2] = f * f * F(S(0.5));
            d[0] = -g, d[1] = F(-2) * t, d[2] = f;
            c[0] = F(1), c[1] = F(-2), c[2] = F(1);
        }
    }
};

// Where the coefficients around a position are: the first one of T^3, and the fractions.
template <class F>
struct BendCell {
    UIntOf<F> first;
    F f[3];
};

// Coefficients are centred in voxels; beyond the grid they are those at its border, so that a place there is as good as
// one half a voxel outside.
template <int T, class F, class S>
TR_INLINE BendCell<F> cell_at(const BendField<S> &field, const BendState<F> &s, int bits) {
    using I = BendInt<F>;
    using Lane = BendLane<F>;
    const Lane one = Lane(1) << bits, half = one / 2;
    BendCell<F> r;
    IntOf<F> index[3];
    for (int k = 0; k < 3; ++k) {
        I x = max(I(-half), min(I(Lane(field.n[k]) * one + half - 1), s.q[k]));
        if constexpr (T == 4) x = x - I(half);
        index[k] = IntOf<F>(x >> bits);
        r.f[k] = from_fixed<F>(x & I(one - 1), bits);
    }
    constexpr int32_t first = BendField<S>::Padding - 1;
    r.first = UIntOf<F>((index[2] + first) * field.slice() + (index[1] + first) * field.row() + index[0] + first);
    return r;
}

// What sum(rows) makes of the coefficients of each lane; rows(z, y, out) are T neighbours. Those of a cell that several
// lanes share are read once. `cells`: the lanes' first coefficients.
template <int T, class F, class S, class Sum>
TR_INLINE auto over_cells(const BendField<S> &field, const UIntOf<F> &first, const FewNumbers<F> &cells,
                          const MaskOf<F> &active, Sum &&sum) {
    auto offset = [&](int z, int y) { return uint32_t(z * field.slice() + y * field.row()); };
    if constexpr (FewNumbers<F>::Most > 0) {
        if (cells.all)
            return with_shared_rows<F, T>(cells, [&](auto &&rows) {
                return sum([&](int z, int y, F(&row)[T]) { rows(field.values + offset(z, y), row); });
            });
    }
    return sum([&](int z, int y, F(&row)[T]) { gather_rows<F>(field.values, first + offset(z, y), active, row); });
}

template <int T, class F>
struct SplineAxes {
    SplineWeights<T, F> axis[3];
    TR_INLINE explicit SplineAxes(const BendCell<F> &cell)
        : axis{SplineWeights<T, F>(cell.f[0]), SplineWeights<T, F>(cell.f[1]), SplineWeights<T, F>(cell.f[2])} {}
    TR_INLINE const SplineWeights<T, F> &operator[](int k) const { return axis[k]; }
};

// What a kick needs.
template <int T, class F, class S>
TR_INLINE BendSlope<F> spline_slope(const BendField<S> &field, const BendCell<F> &cell, const MaskOf<F> &active) {
    const FewNumbers<F> cells(cell.first, active);
    const SplineAxes<T, F> at(cell);
    return over_cells<T, F>(field, cell.first, cells, active, [&](auto &&rows) {
        BendSlope<F> r{F(0), {F(0), F(0), F(0)}};
        for (int z = 0; z < T; ++z) {
            F value(0), y_slope(0), x_slope(0);
            for (int y = 0; y < T; ++y) {
                F row[T];
                rows(z, y, row);
                F v = row[0] * at[0].w[0], x = row[0] * at[0].d[0];
                for (int k = 1; k < T; ++k) v = fmadd(row[k], at[0].w[k], v), x = fmadd(row[k], at[0].d[k], x);
                value = fmadd(v, at[1].w[y], value);
                y_slope = fmadd(v, at[1].d[y], y_slope);
                x_slope = fmadd(x, at[1].w[y], x_slope);
            }
            r.value = fmadd(value, at[2].w[z], r.value);
            r.slope.x = fmadd(x_slope, at[2].w[z], r.slope.x);
            r.slope.y = fmadd(y_slope, at[2].w[z], r.slope.y);
            r.slope.z = fmadd(value, at[2].d[z], r.slope.z);
        }
        return r;
    });
}

// The same numbers, and the second derivatives.
template <int T, class F, class S>
TR_INLINE BendJet<F> spline_jet(const BendField<S> &field, const SplineAxes<T, F> &at, const UIntOf<F> &first,
                                const FewNumbers<F> &cells, const MaskOf<F> &active) {
    return over_cells<T, F>(field, first, cells, active, [&](auto &&rows) {
        BendJet<F> r{{F(0), {F(0), F(0), F(0)}}, {F(0), F(0), F(0), F(0), F(0), F(0)}};
        for (int z = 0; z < T; ++z) {
            F v(0), v_y(0), v_yy(0), v_x(0), v_xy(0), v_xx(0);
            for (int y = 0; y < T; ++y) {
                F row[T];
                rows(z, y, row);
                F a = row[0] * at[0].w[0], a_x = row[0] * at[0].d[0], a_xx = row[0] * at[0].c[0];
                for (int k = 1; k < T; ++k) {
                    a = fmadd(row[k], at[0].w[k], a), a_x = fmadd(row[k], at[0].d[k], a_x);
                    a_xx = fmadd(row[k], at[0].c[k], a_xx);
                }
                v = fmadd(a, at[1].w[y], v), v_y = fmadd(a, at[1].d[y], v_y), v_yy = fmadd(a, at[1].c[y], v_yy);
                v_x = fmadd(a_x, at[1].w[y], v_x), v_xy = fmadd(a_x, at[1].d[y], v_xy);
                v_xx = fmadd(a_xx, at[1].w[y], v_xx);
            }
            const F &w = at[2].w[z], &d = at[2].d[z];
            r.value = fmadd(v, w, r.value);
            r.slope.x = fmadd(v_x, w, r.slope.x), r.slope.y = fmadd(v_y, w, r.slope.y);
            r.slope.z = fmadd(v, d, r.slope.z);
            r.curve[0] = fmadd(v_xx, w, r.curve[0]), r.curve[1] = fmadd(v_yy, w, r.curve[1]);
            r.curve[2] = fmadd(v, at[2].c[z], r.curve[2]), r.curve[3] = fmadd(v_xy, w, r.curve[3]);
            r.curve[4] = fmadd(v_x, d, r.curve[4]), r.curve[5] = fmadd(v_y, d, r.curve[5]);
        }
        return r;
    });
}

// The field where a ray is, with what derivatives by its coefficients need.
template <int T, class F>
struct BendPoint {
    BendCell<F> cell;
    FewNumbers<F> cells;
    SplineAxes<T, F> axes;
    BendJet<F> jet;

    template <class S>
    TR_INLINE BendPoint(const BendField<S> &field, const BendState<F> &s, int bits, const MaskOf<F> &active)
        : cell(cell_at<T>(field, s, bits)), cells(cell.first, active), axes(cell), jet(jet_of(field, active)) {}

    // Of a field of other values there.
    template <class S>
    TR_INLINE BendJet<F> jet_of(const BendField<S> &field, const MaskOf<F> &active) const {
        return spline_jet<T>(field, axes, cell.first, cells, active);
    }
};

// Of a value of the field and its constant.
template <class F, class S>
TR_INLINE F refractive_index(const F &value, S constant, S least_square = S(0)) {
    return sqrt(max(F(least_square), (value + F(constant)) * F(2)));
}

// A symmetric matrix, in the order of BendField::kick, times a vector.
template <class F, class T>
TR_INLINE Vec3<F> symmetric_times(const T &m, const Vec3<F> &v) {
    auto number = [&](int k) { return F(m[k]); };
    return {fmadd(number(0), v.x, fmadd(number(3), v.y, number(4) * v.z)),
            fmadd(number(3), v.x, fmadd(number(1), v.y, number(5) * v.z)),
            fmadd(number(4), v.x, fmadd(number(5), v.y, number(2) * v.z))};
}

}  // namespace tr
