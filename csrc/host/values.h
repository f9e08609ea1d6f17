// Looking at numbers that come from outside: are they finite, is a matrix invertible.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>
#include <type_traits>

namespace tr {

[[noreturn]] inline void bad_value(const std::string &where, const std::string &expected, const std::string &got) {
    throw std::invalid_argument(where + ": expected " + expected + ", got " + got);
}

// Position of the first number that is not finite; -1 if all are. Tests the bits, which the compiler vectorises.
template <class S>
int64_t first_nonfinite(const S *data, int64_t n) {
    using Bits = std::conditional_t<sizeof(S) == 4, uint32_t, uint64_t>;
    constexpr Bits exponent = sizeof(S) == 4 ? Bits(0x7f800000u) : Bits(0x7ff0000000000000ull);
    auto bad = [&](int64_t i) {
        Bits bits;
        std::memcpy(&bits, data + i, sizeof(bits));
        return Bits((bits & exponent) == exponent);
    };
    constexpr int64_t block = 4096;
    for (int64_t begin = 0; begin < n; begin += block) {
        int64_t end = begin + block < n ? begin + block : n;
        Bits any = 0;
        for (int64_t i = begin; i < end; ++i) any |= bad(i);
        if (any)
            for (int64_t i = begin; i < end; ++i)
                if (bad(i)) return i;
    }
    return -1;
}

template <class S>
void require_finite(const S *data, int64_t n, const std::string &where) {
    int64_t i = first_nonfinite(data, n);
    if (i >= 0) bad_value(where, "finite numbers", std::to_string(data[i]) + " at element " + std::to_string(i));
}

// A number that other contents are unlikely to have, in the time that reading them takes.
template <class S>
uint64_t fingerprint(const S *data, int64_t n) {
    uint32_t sum = 0, weighted = 0;
    const char *bytes = reinterpret_cast<const char *>(data);
    const int64_t words = n * int64_t(sizeof(S) / 4);
    for (int64_t i = 0; i < words; ++i) {
        uint32_t bits;
        std::memcpy(&bits, bytes + 4 * i, 4);
        sum += bits;
        weighted += bits * (2u * uint32_t(i) + 1u);
    }
    return uint64_t(weighted) << 32 | sum;
}

// Affine maps, 3 rows of 4, in double precision.
struct Affine {
    double m[12];

    double determinant() const {
        return m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
               m[2] * (m[4] * m[9] - m[5] * m[8]);
    }
    double column_norm(int j) const { return std::sqrt(column_dot(j, j)); }
    double column_dot(int j, int k) const { return m[j] * m[k] + m[4 + j] * m[4 + k] + m[8 + j] * m[8 + k]; }

    Affine inverse(const std::string &where) const {
        double d = determinant(), scale = column_norm(0) * column_norm(1) * column_norm(2);
        if (!(std::abs(d) > 1e-12 * scale) || !(scale > 0)) bad_value(where, "an invertible matrix", "a singular one");
        Affine r;
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) {
                int a = (j + 1) % 3, b = (j + 2) % 3, c = (i + 1) % 3, e = (i + 2) % 3;
                r.m[4 * i + j] = (m[4 * a + c] * m[4 * b + e] - m[4 * a + e] * m[4 * b + c]) / d;
            }
        for (int i = 0; i < 3; ++i)
            r.m[4 * i + 3] = -(r.m[4 * i] * m[3] + r.m[4 * i + 1] * m[7] + r.m[4 * i + 2] * m[11]);
        return r;
    }
};

}  // namespace tr
