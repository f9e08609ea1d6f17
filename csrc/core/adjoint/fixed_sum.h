// Sums that are the same, bit for bit, in whatever order numbers are added: whole multiples of a unit, which follows
// from the largest of the numbers (as the bins of Demmel and Nguyen, "Parallel Reproducible Summation", 2015). That is
// found first, in a sweep of its own.
#pragma once

#include <cmath>
#include <cstring>

#include "../math/lanes.h"

namespace tr {

struct FixedSum {
    uint64_t sum;      // of two's complements
    uint32_t largest;  // the bits of the largest number's size, which are in the order of sizes
    uint32_t unused;

    // Below the largest: a float has 24 of them, and 2^28 numbers find room.
    static constexpr int Bits = 34;

    TR_HD void measure(float x) {
        const float size = std::fabs(x);
        uint32_t bits;
        std::memcpy(&bits, &size, sizeof bits);
        raise(bits);
    }
    TR_HD void add(float x) {
        const auto units = int64_t(std::llrint(double(x) * power_of_two(Bits - exponent())));
        if (units != 0) accumulate(&sum, uint64_t(units));
    }
    TR_HD double value() const { return double(int64_t(sum)) * power_of_two(exponent() - Bits); }

private:
    TR_HD int exponent() const { return int(largest >> 23 == 0 ? 1 : largest >> 23) - 127; }
    static TR_HD double power_of_two(int n) {
        const uint64_t bits = uint64_t(1023 + n) << 52;
        double r;
        std::memcpy(&r, &bits, sizeof r);
        return r;
    }
    TR_HD void raise(uint32_t bits) {
#if defined(__CUDA_ARCH__)
        if (bits > *static_cast<volatile uint32_t *>(&largest)) atomicMax(&largest, bits);
#elif defined(__GNUC__)
        uint32_t before = __atomic_load_n(&largest, __ATOMIC_RELAXED);
        while (bits > before &&
               !__atomic_compare_exchange_n(&largest, &before, bits, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {}
#else
        if (bits > largest) largest = bits;
#endif
    }
};
static_assert(sizeof(FixedSum) == 16);

}  // namespace tr
