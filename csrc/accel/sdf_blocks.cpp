#include "sdf_blocks.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "mapped_box.h"

namespace tr {

float SdfBlocks::set(const float *values, const std::array<int32_t, 3> &n) {
    table_.stride[0] = 1, table_.stride[1] = n[0], table_.stride[2] = n[0] * n[1];
    for (int a = 0; a < 3; ++a) table_.cells[a] = n[size_t(a)] - 1, table_.bits[a] = SdfCellBits::of(table_.cells[a]);
    const size_t nx = size_t(table_.cells[0]), ny = size_t(table_.cells[1]), nz = size_t(table_.cells[2]);

    // which cells have values of both signs, and then blocks of twice the side, up to 128
    float largest = 0;
    const size_t n_values = size_t(n[0]) * size_t(n[1]) * size_t(n[2]);
    for (size_t i = 0; i < n_values; ++i) {
        float size = std::abs(values[i]);
        largest = size <= largest ? largest : size;  // NaN is the largest
    }
    struct Level {
        size_t n[3];
        std::vector<uint8_t> full;
    };
    std::vector<Level> levels(1, Level{{nx, ny, nz}, std::vector<uint8_t>(nx * ny * nz)});
    for (int a = 0; a < 3; ++a) table_.first[a] = table_.cells[a], table_.last[a] = -1;
    std::vector<float> low(nx + 1), high(nx + 1);
    for (int32_t z = 0; z < table_.cells[2]; ++z)
        for (int32_t y = 0; y < table_.cells[1]; ++y) {
            // of the four numbers beside each other, then of two such: loops that a compiler makes packets of
            const float *a = values + size_t(z) * size_t(table_.stride[2]) + size_t(y) * size_t(table_.stride[1]),
                        *b = a + table_.stride[1], *c = a + table_.stride[2], *d = b + table_.stride[2];
            float *l = low.data(), *h = high.data();
            for (size_t x = 0; x <= nx; ++x) {
                float ab = a[x] < b[x] ? a[x] : b[x], cd = c[x] < d[x] ? c[x] : d[x];
                float most = a[x] > b[x] ? a[x] : b[x], other = c[x] > d[x] ? c[x] : d[x];
                l[x] = ab < cd ? ab : cd;
                h[x] = most > other ? most : other;
            }
            uint8_t *full = &levels[0].full[(size_t(z) * ny + size_t(y)) * nx], some = 0;
            for (size_t x = 0; x < nx; ++x) {
                float least = l[x] < l[x + 1] ? l[x] : l[x + 1], most = h[x] > h[x + 1] ? h[x] : h[x + 1];
                full[x] = uint8_t((least <= 0) & (most >= 0) & (least < most));
                some |= full[x];
            }
            if (!some) continue;
            int32_t begin = 0, end = table_.cells[0] - 1;
            while (!full[begin]) ++begin;
            while (!full[end]) --end;
            const int32_t from[3] = {begin, y, z}, to[3] = {end, y, z};
            for (int k = 0; k < 3; ++k)
                table_.first[k] = std::min(table_.first[k], from[k]), table_.last[k] = std::max(table_.last[k], to[k]);
        }
    while (levels.size() < 8 && std::max(levels.back().n[0], std::max(levels.back().n[1], levels.back().n[2])) > 1) {
        const Level &fine = levels.back();
        Level coarse{{(fine.n[0] + 1) / 2, (fine.n[1] + 1) / 2, (fine.n[2] + 1) / 2}, {}};
        coarse.full.assign(coarse.n[0] * coarse.n[1] * coarse.n[2], 0);
        const uint8_t *from = fine.full.data();
        for (size_t z = 0; z < fine.n[2]; ++z)
            for (size_t y = 0; y < fine.n[1]; ++y) {
                uint8_t *to = &coarse.full[(z / 2 * coarse.n[1] + y / 2) * coarse.n[0]];
                for (size_t x = 0; x < fine.n[0]; ++x) to[x / 2] |= *from++;
            }
        levels.push_back(std::move(coarse));
    }
    // from the coarsest to the finest: a block that is empty, or in one that is, has that one's side
    std::vector<uint8_t> side, above;
    size_t above_n[3] = {0, 0, 0};
    for (size_t k = levels.size(); k-- > 0;) {
        const Level &level = levels[k];
        above.swap(side);
        side.resize(level.full.size());
        size_t i = 0;
        for (size_t z = 0; z < level.n[2]; ++z)
            for (size_t y = 0; y < level.n[1]; ++y)
                for (size_t x = 0; x < level.n[0]; ++x, ++i) {
                    uint8_t larger = above.empty() ? 0 : above[(z / 2 * above_n[1] + y / 2) * above_n[0] + x / 2];
                    side[i] = larger ? larger : level.full[i] ? uint8_t(0) : uint8_t(1u << k);
                }
        std::copy_n(level.n, 3, above_n);
    }
    empty_.assign(side.size() / 4 + 1, 0);
    std::memcpy(empty_.data(), side.data(), side.size());
    table_.values = values, table_.empty = empty_.data();
    return largest;
}

void sdf_box(const float to_world[12], const SdfTable &grid, float lower[3], float upper[3]) {
    float low[3] = {0, 0, 0}, high[3] = {0, 0, 0};  // no surface: a point in the grid
    for (int a = 0; a < 3 && grid.last[0] >= 0; ++a)
        low[a] = float(grid.first[a]) / float(grid.cells[a]), high[a] = float(grid.last[a] + 1) / float(grid.cells[a]);
    mapped_box(to_world, low, high, lower, upper);
}

}  // namespace tr
