// `sdfgrid`: where the trilinear interpolant of numbers at the corners of cells is zero, inside the unit cube. Sample
// (k, j, i) of a grid (D, H, W) lies at x = i / (W - 1), y = j / (H - 1), z = k / (D - 1).
//
// A point is stored as its cell, the axis along which the interpolant f changes most, and its place in the cell on the
// two others: along one axis f is linear, so that the third coordinate is a quotient.
#pragma once

#include "sdf_cell.h"
#include "surface_point.h"

namespace tr {

// The grid of one shape. Axes are numbered x, y, z.
template <class S>
struct SdfGridView {
    const S *data;
    int32_t cells[3], stride[3], slot, bits[2];

    TR_INLINE SdfGridView(const SceneView<S> &scene, uint32_t shape) {
        slot = scene.shapes[shape].heights;
        const TensorView<S> &tensor = scene.values.tensors[slot];  // (rows, columns, 1, slices)
        data = tensor.data;
        const int32_t n[3] = {tensor.shape[1], tensor.shape[0], tensor.shape[3]};
        stride[0] = 1, stride[1] = n[0], stride[2] = n[0] * n[1];
        for (int a = 0; a < 3; ++a) cells[a] = n[a] - 1;
        for (int a = 0; a < 2; ++a) bits[a] = SdfCellBits::of(cells[a]);
    }
};

// A point of the surface: its cell, the numbers at its corners, its place there, and f with its derivatives by
// that place.
template <class F>
struct SdfPoint {
    IntOf<F> cell[3], first;  // the index of corner 0
    F corner[8], at[3];
    F value, slope[3], mixed[3];  // see SdfCorners

    template <class S>
    TR_INLINE SdfPoint(const SdfGridView<S> &grid, const UIntOf<F> &primitive, const MaskOf<F> &active) {
        using U = UIntOf<F>;
        U code = primitive >> SdfCellBits::Axis;
        const U x = code & U(uint32_t((1 << grid.bits[0]) - 1)), rest = code >> uint32_t(grid.bits[0]),
                y = rest & U(uint32_t((1 << grid.bits[1]) - 1)), z = rest >> uint32_t(grid.bits[1]);
        cell[0] = IntOf<F>(x), cell[1] = IntOf<F>(y), cell[2] = IntOf<F>(z);
        first = cell[2] * grid.stride[2] + cell[1] * grid.stride[1] + cell[0];
        for (int b = 0; b < 8; b += 2) {
            F row[2];
            gather_rows<F>(grid.data, U(first + ((b >> 1 & 1) * grid.stride[1] + (b >> 2) * grid.stride[2])), active,
                           row);
            corner[b] = row[0], corner[b + 1] = row[1];
        }
    }

    // The weight of a corner, of the place on the axes other than `without`.
    TR_INLINE F weight(int corner_index, int without = -1) const {
        F w(1);
        for (int a = 0; a < 3; ++a)
            if (a != without) w = w * (corner_index >> a & 1 ? at[a] : F(1) - at[a]);
        return w;
    }
    // Its derivative along an axis.
    TR_INLINE F weight_slope(int corner_index, int axis) const {
        F w = weight(corner_index, axis);
        return corner_index >> axis & 1 ? w : -w;
    }

    TR_INLINE void evaluate() {
        SdfCorners<F> f(corner);
        f.evaluate(at);
        value = f.value;
        for (int a = 0; a < 3; ++a) slope[a] = f.slope[a], mixed[a] = f.mixed[a];
    }

    // Puts the point on the surface: from its coordinates on the two axes behind `axis`.
    TR_INLINE void put(const UIntOf<F> &axis, const F &b1, const F &b2) {
        auto is_x = mask<F>(axis == 0u), is_y = mask<F>(axis == 1u);
        at[0] = select(is_x, F(0), select(is_y, b2, b1));
        at[1] = select(is_x, b1, select(is_y, F(0), b2));
        at[2] = select(is_x, b2, select(is_y, b1, F(0)));
        evaluate();
        F steepness = select(is_x, slope[0], select(is_y, slope[1], slope[2]));
        auto usable = mask<F>(steepness != F(0));
        F third = select(usable, -value / select(usable, steepness, F(1)), F(0.5));
        third = max(F(ScalarOf<F>(-0.01)), min(F(ScalarOf<F>(1.01)), third));  // not far off, whatever rounding does
        at[0] = select(is_x, third, at[0]);
        at[1] = select(is_y, third, at[1]);
        at[2] = select(is_x || is_y, at[2], third);
        evaluate();
    }

    // In the unit cube.
    template <class S>
    TR_INLINE Vec3<F> local(const SdfGridView<S> &grid) const {
        F p[3];
        for (int a = 0; a < 3; ++a) p[a] = (F(cell[a]) + at[a]) * F(S(1) / S(grid.cells[a]));
        return {p[0], p[1], p[2]};
    }
    // The gradient there.
    template <class S>
    TR_INLINE Vec3<F> gradient(const SdfGridView<S> &grid) const {
        return {slope[0] * F(S(grid.cells[0])), slope[1] * F(S(grid.cells[1])), slope[2] * F(S(grid.cells[2]))};
    }
};

// The corners of a cell at the lower end of `axis`, by a number from 0 to 3.
TR_INLINE int sdf_face_corner(int face, int axis) {
    return (face & 1) << ((axis + 1) % 3) | (face >> 1) << ((axis + 2) % 3);
}

// The normal of "smooth" shading, found by experiment to be Mitsuba's: along every axis the difference of the
// interpolant over the point's cell, and that over the next cell on the side where the point is; the eight gradients
// that can be made of those, each of unit length, interpolated between the cells' centres. At the border of the grid
// the outermost cell's difference goes on.
template <class F>
struct SdfSmoothNormal {
    IntOf<F> outer[3];   // per axis: how far the next cell's outer corners are from those at its lower end
    MaskOf<F> after[3];  // the next cell follows, or precedes
    F outer_corner[3][4];
    F share[3], share_slope[3];  // of the next cell, and its derivative by the place
    F difference[3][2];          // in the unit cube's units: over the point's cell, over the next one
    F turning[3][2][2];          // their derivatives by the places on the two axes behind
    Vec3<F> sum;                 // not normalised

    template <class S>
    TR_INLINE SdfSmoothNormal(const SdfGridView<S> &grid, const SdfPoint<F> &p, const MaskOf<F> &active) {
        using I = IntOf<F>;
        for (int a = 0; a < 3; ++a) {
            after[a] = mask<F>(p.at[a] >= F(0.5));
            I next = p.cell[a] + select(mask<I>(after[a]), I(1), I(-1));
            auto inside = mask<F>(next >= 0) && mask<F>(next < grid.cells[a]);
            share[a] = select(inside, abs(p.at[a] - F(0.5)), F(0));
            share_slope[a] = select(inside, select(after[a], F(1), F(-1)), F(0));
            // from corner 0 along the axis
            I from = select(mask<I>(inside), select(mask<I>(after[a]), I(2), I(-1)), I(0));
            outer[a] = from * grid.stride[a];
            for (int k = 0; k < 4; ++k) {
                const int c = sdf_face_corner(k, a);
                I offset((c & 1) + (c >> 1 & 1) * grid.stride[1] + (c >> 2) * grid.stride[2]);
                outer_corner[a][k] = gather<F>(grid.data, UIntOf<F>(p.first + outer[a] + offset), active);
            }
            const F &u = p.at[(a + 1) % 3], &v = p.at[(a + 2) % 3];
            const F scale{S(grid.cells[a])};
            for (int which = 0; which < 2; ++which) {
                F d[4];
                for (int k = 0; k < 4; ++k) {
                    const int c = sdf_face_corner(k, a);
                    const F &low = p.corner[c], &high = p.corner[c | 1 << a];
                    F over =
                        which == 0 ? high - low : select(after[a], outer_corner[a][k] - high, low - outer_corner[a][k]);
                    d[k] = over * scale;
                }
                F near = fmadd(u, d[1] - d[0], d[0]), far = fmadd(u, d[3] - d[2], d[2]);
                difference[a][which] = fmadd(v, far - near, near);
                turning[a][which][0] = fmadd(v, (d[3] - d[2]) - (d[1] - d[0]), d[1] - d[0]);
                turning[a][which][1] = far - near;
            }
        }
        sum = {F(0), F(0), F(0)};
        for (int b = 0; b < 8; ++b) {
            F inverse;
            Vec3<F> n = unit(b, inverse);
            sum = sum + n * (part(b, 0) * part(b, 1) * part(b, 2));
        }
    }
    TR_INLINE F part(int b, int a) const { return b >> a & 1 ? share[a] : F(1) - share[a]; }
    TR_INLINE Vec3<F> unit(int b, F &inverse) const {
        Vec3<F> g{difference[0][b & 1], difference[1][b >> 1 & 1], difference[2][b >> 2]};
        F squared = squared_norm(g);
        auto usable = mask<F>(squared > F(0));
        inverse = select(usable, rsqrt(select(usable, squared, F(1))), F(0));
        return g * inverse;
    }
};

// The point that is stored as (primitive, b1, b2).
template <class F, class S>
TR_INLINE SdfPoint<F> sdf_point(const SdfGridView<S> &grid, const UIntOf<F> &primitive, const F &b1, const F &b2,
                                const MaskOf<F> &lanes) {
    SdfPoint<F> p(grid, primitive, lanes);
    p.put(primitive & ((1u << SdfCellBits::Axis) - 1), b1, b2);
    return p;
}

// Newton's iteration for the distance near t, which is known to single precision; then also (b1, b2).
template <class F, class S>
TR_INLINE void refine_sdf(const SdfGridView<S> &grid, SdfPoint<F> &p, const UIntOf<F> &axis, const Vec3<F> &o,
                          const Vec3<F> &d, F &t, F &b1, F &b2, const MaskOf<F> &lanes) {
    const F os[3] = {o.x, o.y, o.z}, ds[3] = {d.x, d.y, d.z};
    F best = F(INFINITY), next = t, found[3] = {p.at[0], p.at[1], p.at[2]};
    for (int step = 0; step < 12; ++step) {
        F along(0);
        for (int a = 0; a < 3; ++a) p.at[a] = fmadd(next, ds[a], os[a]) * F(ScalarOf<F>(grid.cells[a])) - F(p.cell[a]);
        p.evaluate();
        for (int a = 0; a < 3; ++a) along = fmadd(p.slope[a], ds[a] * F(ScalarOf<F>(grid.cells[a])), along);
        auto nearer = lanes && mask<F>(abs(p.value) < best);
        if (!any(nearer)) break;
        best = select(nearer, abs(p.value), best);
        t = select(nearer, next, t);
        for (int a = 0; a < 3; ++a) found[a] = select(nearer, p.at[a], found[a]);
        auto usable = mask<F>(along != F(0));
        next = t - select(usable, p.value / select(usable, along, F(1)), F(0));
    }
    auto is_x = mask<F>(axis == 0u), is_y = mask<F>(axis == 1u);
    b1 = select(lanes, select(is_x, found[1], select(is_y, found[2], found[0])), b1);
    b2 = select(lanes, select(is_x, found[2], select(is_y, found[0], found[1])), b2);
}

// What the query for grids reports made into points, unit normals and unit shading normals.
template <class F, class S>
TR_NOINLINE void meet_sdf_grids(const SceneView<S> &scene, const UIntOf<F> &shape, const UIntOf<F> &primitive,
                                const Vec3<F> &o, const Vec3<F> &d, const MaskOf<F> &active, F &b1, F &b2, F &t,
                                Vec3<F> &p, Vec3<F> &ng, Vec3<F> &ns) {
    each_shape<SdfGridView, F>(
        scene, shape, active, [&](uint32_t one, const SdfGridView<S> &grid, const MaskOf<F> &lanes) {
            const S *to_world = scene.shape_matrices + 24 * size_t(one), *to_object = to_world + 12;
            SdfPoint<F> at(grid, primitive, lanes);
            UIntOf<F> axis = primitive & ((1u << SdfCellBits::Axis) - 1);
            if constexpr (sizeof(S) == 8) {
                at.at[0] = at.at[1] = at.at[2] = F(0);
                refine_sdf(grid, at, axis, transform_point(to_object, o), transform_vector(to_object, d), t, b1, b2,
                           lanes);
            }
            at.put(axis, b1, b2);
            p = select(lanes, transform_point(to_world, at.local(grid)), p);
            auto unit = [&](const Vec3<F> &gradient) {
                Vec3<F> n = transform_normal(to_object, gradient);
                F squared = squared_norm(n);
                auto usable = mask<F>(squared > F(0));
                return select(usable, n * rsqrt(select(usable, squared, F(1))), Vec3<F>{F(0), F(0), F(1)});
            };
            Vec3<F> n = unit(at.gradient(grid));
            ng = select(lanes, n, ng);
            if (scene.shapes[one].flags & HasNormals) n = unit(SdfSmoothNormal<F>(grid, at, lanes).sum);
            ns = select(lanes, n, ns);
        });
}

// The positions of stored points.
template <class F, class S>
TR_NOINLINE void sdf_positions(const SceneView<S> &scene, const UIntOf<F> &shape, const UIntOf<F> &primitive,
                               const F &b1, const F &b2, const MaskOf<F> &active, Vec3<F> &p) {
    each_shape<SdfGridView, F>(
        scene, shape, active, [&](uint32_t one, const SdfGridView<S> &grid, const MaskOf<F> &lanes) {
            Vec3<F> local = sdf_point(grid, primitive, b1, b2, lanes).local(grid);
            p = select(lanes, transform_point(scene.shape_matrices + 24 * size_t(one), local), p);
        });
}

}  // namespace tr
