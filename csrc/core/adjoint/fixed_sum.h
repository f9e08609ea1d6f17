// Sums that are the same, bit for bit, in whatever order numbers are added: whole multiples of a unit, which follows
// from the largest of the numbers (as the bins of Demmel and Nguyen, "Parallel Reproducible Summation", 2015). That is
// found first, in a sweep of its own.
#pragma once

#include <cmath>
#include <cstring>
#include <type_traits>

#include "../math/lanes.h"

namespace tr {

// Of numbers of type S. In double precision what is left of them beside multiples of the unit has a sum of its own, in
// a unit that is as much smaller.
template <class S>
struct FixedSum {
    static constexpr bool Double = sizeof(S) == sizeof(double);
    using SizeBits = std::conditional_t<Double, uint64_t, uint32_t>;

    uint64_t sum[Double ? 2 : 1];  // of two's complements
    SizeBits largest;              // the bits of the largest number's size, which are in the order of sizes

    // Below the largest: a float has 24 of them, and 2^28 numbers find room.
    static constexpr int Bits = 34;

    TR_HD void measure(S x) {
        const S size = std::fabs(x);
        SizeBits bits;
        std::memcpy(&bits, &size, sizeof bits);
        raise(bits);
    }
    TR_HD void add(S x) {
        const double scaled = times_power_of_two(double(x), Bits - exponent());
        const auto units = int64_t(std::llrint(scaled));
        if (units != 0) accumulate(&sum[0], uint64_t(units));
        if constexpr (Double) {
            const auto rest = int64_t(std::llrint(times_power_of_two(scaled - double(units), Bits)));
            if (rest != 0) accumulate(&sum[1], uint64_t(rest));
        }
    }
    TR_HD double value() const {
        double r = times_power_of_two(double(int64_t(sum[0])), exponent() - Bits);
        if constexpr (Double) r += times_power_of_two(double(int64_t(sum[1])), exponent() - 2 * Bits);
        return r;
    }

private:
    // Of the largest number.
    TR_HD int exponent() const {
        constexpr int Fraction = Double ? 52 : 23, Bias = Double ? 1023 : 127;
        return int(largest >> Fraction == 0 ? 1 : largest >> Fraction) - Bias;
    }
    static TR_HD double power_of_two(int n) {
        const uint64_t bits = uint64_t(1023 + n) << 52;
        double r;
        std::memcpy(&r, &bits, sizeof r);
        return r;
    }
    // In two steps where one power may be too large or small for a double.
    static TR_HD double times_power_of_two(double x, int n) {
        if constexpr (Double) return x * power_of_two(n / 2) * power_of_two(n - n / 2);
        return x * power_of_two(n);
    }
    TR_HD void raise(SizeBits bits) {
#if defined(__CUDA_ARCH__)
        using Word = std::conditional_t<Double, unsigned long long, unsigned>;
        if (bits > *static_cast<volatile SizeBits *>(&largest))
            atomicMax(reinterpret_cast<Word *>(&largest), Word(bits));
#elif defined(__GNUC__)
        SizeBits before = __atomic_load_n(&largest, __ATOMIC_RELAXED);
        while (bits > before &&
               !__atomic_compare_exchange_n(&largest, &before, bits, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {}
#else
        if (bits > largest) largest = bits;
#endif
    }
};
static_assert(sizeof(FixedSum<float>) == 16 && sizeof(FixedSum<double>) == 24);

}  // namespace tr
