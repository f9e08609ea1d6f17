#include "height_ranges.h"

#include <algorithm>
#include <cmath>

#include "mapped_box.h"

namespace tr {

void HeightRanges::set(const float *heights, int rows, int columns) {
    fine_.columns = columns / 8 + 1, fine_.rows = rows / 8 + 1;  // of columns + 1 cells
    fine_.ranges.resize(size_t(fine_.columns) * size_t(fine_.rows));
    // A block's 8 cells have the 11 heights from two before its first cell's on. `Before` numbers are put before a row
    // and enough behind it, so that all windows are full.
    constexpr size_t Before = 2, Window = 11;
    const size_t n = size_t(columns), padded = 8 * size_t(fine_.columns) + Window;
    std::vector<float> low(padded + 8), high(padded + 8);
    for (int by = 0; by < fine_.rows; ++by) {
        int begin = std::max(0, 8 * by - 2), end = std::min(rows, 8 * by + 9);
        begin = std::min(begin, rows - 1);
        float *l = low.data() + Before, *h = high.data() + Before;
        const float *row = heights + size_t(begin) * n;
        std::copy_n(row, n, l);
        std::copy_n(row, n, h);
        for (int j = begin + 1; j < end; ++j) {
            row += n;
            for (size_t i = 0; i < n; ++i) l[i] = row[i] < l[i] ? row[i] : l[i], h[i] = row[i] > h[i] ? row[i] : h[i];
        }
        std::fill_n(low.data(), Before, l[0]);
        std::fill_n(high.data(), Before, h[0]);
        std::fill(low.begin() + ptrdiff_t(Before + n), low.end(), l[n - 1]);
        std::fill(high.begin() + ptrdiff_t(Before + n), high.end(), h[n - 1]);
        // the least of 2, then of 4 that follow
        for (size_t width : {size_t(1), size_t(2)})
            for (size_t i = 0; i < padded; ++i) {
                low[i] = low[i + width] < low[i] ? low[i + width] : low[i];
                high[i] = high[i + width] > high[i] ? high[i + width] : high[i];
            }
        HeightRange *to = &fine_.ranges[size_t(by) * size_t(fine_.columns)];
        for (size_t b = 0; b < size_t(fine_.columns); ++b) {
            const float *x = &low[8 * b], *y = &high[8 * b];
            to[b] = {std::min(x[0], std::min(x[4], x[7])), std::max(y[0], std::max(y[4], y[7]))};
        }
    }
    coarse_.columns = (fine_.columns + 7) / 8, coarse_.rows = (fine_.rows + 7) / 8;
    coarse_.ranges.assign(size_t(coarse_.columns) * size_t(coarse_.rows), {INFINITY, -INFINITY});
    all_ = {INFINITY, -INFINITY};
    auto widen = [](HeightRange &a, const HeightRange &b) { a = {std::min(a.low, b.low), std::max(a.high, b.high)}; };
    for (int y = 0; y < fine_.rows; ++y)
        for (int x = 0; x < fine_.columns; ++x)
            widen(coarse_.ranges[size_t(y / 8) * size_t(coarse_.columns) + size_t(x / 8)],
                  fine_.ranges[size_t(y) * size_t(fine_.columns) + size_t(x)]);
    for (const HeightRange &r : coarse_.ranges) widen(all_, r);
}

HeightTable HeightRanges::table(const float *heights, int rows, int columns, bool linear) const {
    const float largest = std::max(std::abs(all_.low), std::abs(all_.high));
    return {heights,
            fine_.ranges.data(),
            coarse_.ranges.data(),
            rows,
            columns,
            fine_.columns,
            coarse_.columns,
            all_,
            largest,
            linear};
}

void height_box(const float to_world[12], const HeightRange &range, float lower[3], float upper[3]) {
    const float low[3] = {-1, -1, range.low}, high[3] = {1, 1, range.high};
    mapped_box(to_world, low, high, lower, upper);
}

}  // namespace tr
