#include "morton_order.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "parallel.h"

namespace tr {

namespace {

constexpr size_t CellBits = 10, ClassBits = 3, NumberBits = 31;  // cells: of an axis
constexpr size_t Bits = 11, Digits = size_t(1) << Bits;          // of a pass of the sort
static_assert(3 * CellBits + ClassBits == 3 * Bits && 3 * Bits + NumberBits == 64);

uint64_t spread(uint64_t x) {  // two zeros after each bit
    x = (x | x << 32) & 0x1F00000000FFFFull;
    x = (x | x << 16) & 0x1F0000FF0000FFull;
    x = (x | x << 8) & 0x100F00F00F00F00Full;
    x = (x | x << 4) & 0x10C30C30C30C30C3ull;
    return (x | x << 2) & 0x1249249249249249ull;
}

struct Box {
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    void include(const float *p) {
        for (size_t k = 0; k < 3; ++k)
            if (std::isfinite(p[k])) low[k] = std::min(low[k], p[k]), high[k] = std::max(high[k], p[k]);
    }
};

Box box_of(const Extent *things, size_t n, int threads) {
    std::vector<Box> parts(size_t(std::max(1, threads)));
    for_ranges(n, threads, [&](size_t begin, size_t end, int part) {
        for (size_t i = begin; i < end; ++i) parts[size_t(part)].include(things[i].middle);
    });
    Box box;
    for (const Box &part : parts) box.include(part.low), box.include(part.high);
    return box;
}

}  // namespace

// Classes of size, cells and numbers in one word, sorted from the lowest digit of the cells on.
std::vector<int32_t> morton_order(const Extent *things, size_t n, int threads) {
    constexpr float cells = float((size_t(1) << CellBits) - 1);
    const Box box = box_of(things, n, threads);
    float size = 0;  // cells are cubes
    for (size_t k = 0; k < 3; ++k) size = std::max(size, box.high[k] - box.low[k]);
    const float scale = size > 0 ? cells / size : 0;
    std::vector<uint64_t> keys(n), sorted(n);
    for_ranges(n, threads, [&](size_t begin, size_t end, int) {
        for (size_t i = begin; i < end; ++i) {
            const Extent &thing = things[i];
            uint64_t key = 0;
            float step = size / 16;
            while (thing.size < step && key + 1 < uint64_t(1) << ClassBits) ++key, step /= 16;
            key <<= 3 * CellBits;
            for (size_t k = 0; k < 3; ++k) {
                const float x = (thing.middle[k] - box.low[k]) * scale;
                key |= spread(uint64_t(x > 0 ? std::min(x, cells) : 0.f)) << k;
            }
            keys[i] = key << NumberBits | i;
        }
    });
    std::vector<std::array<size_t, Digits>> places_of(size_t(std::max(1, threads)));
    for (size_t shift = NumberBits; shift < NumberBits + 3 * Bits; shift += Bits) {
        auto digit = [&](uint64_t key) { return size_t(key >> shift) & (Digits - 1); };
        for (auto &part : places_of) part.fill(0);
        for_ranges(n, threads, [&](size_t begin, size_t end, int part) {
            for (size_t i = begin; i < end; ++i) ++places_of[size_t(part)][digit(keys[i])];
        });
        size_t next = 0;
        for (size_t d = 0; d < Digits; ++d)
            for (auto &part : places_of) next += std::exchange(part[d], next);
        for_ranges(n, threads, [&](size_t begin, size_t end, int part) {
            for (size_t i = begin; i < end; ++i) sorted[places_of[size_t(part)][digit(keys[i])]++] = keys[i];
        });
        keys.swap(sorted);
    }
    std::vector<int32_t> order(n);
    for (size_t i = 0; i < n; ++i) order[i] = int32_t(keys[i] & ((uint64_t(1) << NumberBits) - 1));
    return order;
}

}  // namespace tr
