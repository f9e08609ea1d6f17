// A cell of a grid of distances: how it is numbered, and the trilinear interpolant in it. Axes are numbered x, y, z.
#pragma once

#include "../math/rows.h"
#include "../math/vector.h"

namespace tr {

// Numbers of bits that the cells' coordinates take, and the axis, of a `primitive`.
struct SdfCellBits {
    static constexpr int Axis = 2, Most = 29;
    TR_INLINE static int of(int32_t cells) {
        int bits = 0;
        while (((cells - 1) >> bits) != 0) ++bits;
        return bits;
    }
};

// The interpolant f in a cell from the numbers at its corners, corner b having the offset b >> a & 1 along axis a.
template <class F>
struct SdfCorners {
    const F (&corner)[8];
    F value, slope[3], mixed[3], all;  // derivatives: mixed[a] by the two axes other than a, `all` by all three

    TR_INLINE explicit SdfCorners(const F (&corner)[8]) : corner(corner) {}
    TR_INLINE void evaluate(const F (&at)[3]) {
        const F &x = at[0], &y = at[1], &z = at[2];
        F row[4], along[4];  // along x
        for (int k = 0; k < 4; ++k) {
            along[k] = corner[2 * k + 1] - corner[2 * k];
            row[k] = fmadd(x, along[k], corner[2 * k]);
        }
        F low = fmadd(y, row[1] - row[0], row[0]), high = fmadd(y, row[3] - row[2], row[2]);
        F x_low = fmadd(y, along[1] - along[0], along[0]), x_high = fmadd(y, along[3] - along[2], along[2]);
        F xy_low = along[1] - along[0];
        value = fmadd(z, high - low, low);
        slope[0] = fmadd(z, x_high - x_low, x_low);
        mixed[0] = (row[3] - row[2]) - (row[1] - row[0]);
        slope[1] = fmadd(z, mixed[0], row[1] - row[0]);
        slope[2] = high - low;
        mixed[1] = x_high - x_low;
        all = (along[3] - along[2]) - xy_low;
        mixed[2] = fmadd(z, all, xy_low);
    }
};

}  // namespace tr
