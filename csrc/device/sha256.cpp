#include "sha256.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>

namespace tr {

namespace {

// The first 32 bits of the fractions of roots of the first primes.
template <size_t N>
std::array<uint32_t, N> root_fractions(long double (*root)(long double)) {
    std::array<uint32_t, N> r{};
    size_t n = 0;
    for (int p = 2; n < N; ++p) {
        bool prime = true;
        for (int d = 2; d * d <= p; ++d) prime = prime && p % d != 0;
        if (!prime) continue;
        const long double x = root(static_cast<long double>(p));
        r[n++] = uint32_t((x - std::floor(x)) * 4294967296.0L);
    }
    return r;
}

uint32_t turned(uint32_t x, int by) { return x >> by | x << (32 - by); }

void add_block(std::array<uint32_t, 8> &state, const unsigned char *block) {
    static const std::array<uint32_t, 64> k = root_fractions<64>([](long double x) { return std::cbrt(x); });
    uint32_t w[64];
    for (size_t i = 0; i < 16; ++i)
        w[i] = uint32_t(block[4 * i]) << 24 | uint32_t(block[4 * i + 1]) << 16 | uint32_t(block[4 * i + 2]) << 8 |
               uint32_t(block[4 * i + 3]);
    for (size_t i = 16; i < 64; ++i) {
        const uint32_t x = w[i - 15], y = w[i - 2];
        w[i] =
            w[i - 16] + (turned(x, 7) ^ turned(x, 18) ^ x >> 3) + w[i - 7] + (turned(y, 17) ^ turned(y, 19) ^ y >> 10);
    }
    auto [a, b, c, d, e, f, g, h] = state;
    for (size_t i = 0; i < 64; ++i) {
        const uint32_t t1 = h + (turned(e, 6) ^ turned(e, 11) ^ turned(e, 25)) + ((e & f) ^ (~e & g)) + k[i] + w[i],
                       t2 = (turned(a, 2) ^ turned(a, 13) ^ turned(a, 22)) + ((a & b) ^ (a & c) ^ (b & c));
        h = g, g = f, f = e, e = d + t1, d = c, c = b, b = a, a = t1 + t2;
    }
    const uint32_t change[] = {a, b, c, d, e, f, g, h};
    for (size_t i = 0; i < 8; ++i) state[i] += change[i];
}

}  // namespace

std::string sha256(const std::string &bytes) {
    std::array<uint32_t, 8> state = root_fractions<8>([](long double x) { return std::sqrt(x); });
    // the end: one bit, zeros, the number of bits
    const size_t rest = bytes.size() / 64 * 64;
    std::string end = bytes.substr(rest) + '\x80';
    end.resize((end.size() + 8 + 63) / 64 * 64 - 8, '\0');
    for (int i = 7; i >= 0; --i) end += char(uint64_t(bytes.size()) * 8 >> 8 * i & 255);
    for (size_t i = 0; i < rest; i += 64) add_block(state, reinterpret_cast<const unsigned char *>(bytes.data()) + i);
    for (size_t i = 0; i < end.size(); i += 64) add_block(state, reinterpret_cast<const unsigned char *>(&end[i]));
    std::string digits;
    for (uint32_t word : state) {
        char eight[9];
        std::snprintf(eight, sizeof eight, "%08x", word);
        digits += eight;
    }
    return digits;
}

}  // namespace tr
