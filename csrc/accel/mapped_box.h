// Boxes around shapes that are placed by a matrix.
#pragma once

namespace tr {

// Around what an affine map of 3 rows of 4 makes of the box from `low` to `high`.
inline void mapped_box(const float matrix[12], const float low[3], const float high[3], float lower[3],
                       float upper[3]) {
    for (int corner = 0; corner < 8; ++corner) {
        float local[3];
        for (int a = 0; a < 3; ++a) local[a] = corner >> a & 1 ? high[a] : low[a];
        for (int i = 0; i < 3; ++i) {
            const float *row = matrix + 4 * i;
            const float p = row[0] * local[0] + row[1] * local[1] + row[2] * local[2] + row[3];
            lower[i] = corner == 0 || p < lower[i] ? p : lower[i];
            upper[i] = corner == 0 || p > upper[i] ? p : upper[i];
        }
    }
}

}  // namespace tr
