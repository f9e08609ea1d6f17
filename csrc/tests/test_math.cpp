// Arithmetic: packets against numbers, dual numbers against finite differences, random numbers against published ones.
#include <algorithm>
#include <complex>
#include <random>
#include <vector>

#include "core/math/dual.h"
#include "core/math/erf.h"
#include "core/math/fresnel.h"
#include "core/math/philox.h"
#include "core/math/warp.h"
#include "core/sampler/sobol.h"
#include "core/sampler/stratified.h"
#include "core/state/columns.h"
#include "harness.h"

namespace tr {

// Test vectors of the Random123 library, philox4x32 with 7 rounds.
TR_TEST(philox_matches_published_vectors) {
    struct {
        uint32_t counter[4], key[2], expected[4];
    } const vectors[] = {
        {{0, 0, 0, 0}, {0, 0}, {0x5f6fb709, 0x0d893f64, 0x4f121f81, 0x4f730a48}},
        {{~0u, ~0u, ~0u, ~0u}, {~0u, ~0u}, {0x5207ddc2, 0x45165e59, 0x4d8ee751, 0x8c52f662}},
        {{0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344},
         {0xa4093822, 0x299f31d0},
         {0x4dfccaba, 0x190a87f0, 0xc47362ba, 0xb6b5242a}},
    };
    for (const auto &v : vectors) {
        uint32_t c[4] = {v.counter[0], v.counter[1], v.counter[2], v.counter[3]};
        philox(c, v.key[0], v.key[1]);
        for (int i = 0; i < 4; ++i) CHECK(c[i] == v.expected[i]);
    }
}

TR_TEST(random_numbers_are_uniform) {
    double sum = 0, squares = 0, product = 0;
    const int n = 100000;
    for (int i = 0; i < n; ++i) {
        auto r = random4<double>(7, 0, uint32_t(i), 3, 1);
        for (double u : r.u) CHECK(u >= 0 && u < 1);
        sum += r.u[0], squares += r.u[1] * r.u[1], product += r.u[2] * r.u[3];
    }
    // five standard deviations of each mean
    CHECK_NEAR(sum / n, 0.5, 5 * std::sqrt(1 / 12. / n));
    CHECK_NEAR(squares / n, 1 / 3., 5 * std::sqrt((1 / 5. - 1 / 9.) / n));
    CHECK_NEAR(product / n, 0.25, 5 * std::sqrt((1 / 9. - 1 / 16.) / n));
}

TR_TEST(strata_divide_the_unit_interval) {
    for (uint32_t n : {1u, 2u, 3u, 7u, 64u, 1000u, 65535u, 65536u}) {
        Strata strata = make_strata(n);
        for (uint32_t x : {0u, 1u, n - 1, n, 12345678u, 0x7fffffffu, 0xfffffffeu, 0xffffffffu}) {
            uint32_t remainder;
            CHECK(divide(strata, x, remainder) == x / n);
            CHECK(remainder == x % n);
        }
        for (uint32_t k = 0; k < n; k += 1 + n / 50)
            for (uint32_t jitter : {0u, 0x80000000u, 0xffffffffu}) {
                double exact = (k + jitter / 4294967296.) / n, error = exact - place(strata, k, jitter) / 4294967296.;
                CHECK(error >= 0 && error < 3 / 4294967296.);
            }
        for (uint32_t key : {0u, 1u, 0xffffffffu, 0x9e3779b9u}) {
            std::vector<bool> taken(n, false);
            for (uint32_t i = 0; i < n; ++i) {
                uint32_t k = permute(i, n, key);
                CHECK(k < n && !taken[k]);
                taken[k] = true;
            }
        }
    }
}

// Sizes at which shifts and products are at their limits; how numbers are distributed is tested in Python.
TR_TEST(samplers_take_any_number_of_samples) {
    for (int64_t count : {int64_t(1), int64_t(2), int64_t(5), int64_t(65536), int64_t(65537), int64_t(1) << 32})
        for (int64_t first : {int64_t(0), int64_t(1000)})
            for (SamplerKind kind : {SamplerKind::Stratified, SamplerKind::Sobol}) {
                SamplerConfig sampler = make_sampler(kind, first, count);
                CHECK(sampler.all.n >= 1 && sampler.all.n <= LargestPattern);
                CHECK(uint64_t(sampler.columns.n) * sampler.rows.n >= sampler.all.n);
                for (int64_t s : {first, first + count / 2, first + count - 1}) {
                    auto r = kind == SamplerKind::Sobol
                                 ? sobol4<double>(sampler, ~0ull, 3,
                                                  SobolPlace<uint32_t>(sampler, 0x80018005u, uint32_t(s)), 4, AllWanted)
                                 : stratified4<double>(sampler, ~0ull, 3, 0x80018005u, uint32_t(s), 4, AllWanted);
                    for (double u : r.u) CHECK(u >= 0 && u < 1);
                }
            }
}

TR_TEST(fresnel_dielectric_matches_complex_formula) {
    for (double eta : {0.5, 0.75, 1.0, 1.33, 1.5, 2.4}) {
        for (double cos_i = -1; cos_i <= 1; cos_i += 1 / 64.) {
            if (cos_i == 0) continue;
            double index = cos_i > 0 ? eta : 1 / eta, ci = std::abs(cos_i);
            std::complex<double> ct = std::sqrt(std::complex<double>(1 - (1 - ci * ci) / (index * index)));
            double s = std::norm((ci - index * ct) / (ci + index * ct)),
                   p = std::norm((ct - index * ci) / (ct + index * ci));
            auto fresnel = fresnel_dielectric(cos_i, eta);
            CHECK_NEAR(fresnel.reflectance, (s + p) / 2, 1e-10);
            if (eta != 1) CHECK_NEAR(std::abs(fresnel.cos_t), ct.real(), 1e-10);
        }
    }
    CHECK_NEAR(fresnel_dielectric(1.0, 1.5).reflectance, 0.04, 1e-12);
}

template <class Function>
static void check_dual(Function f, double a, double b) {
    using D = Dual<double, 2>;
    D y = f(D(a, 0), D(b, 1));
    const double h = 1e-6;
    CHECK_NEAR(y.v, f(a, b), 1e-14);
    CHECK_NEAR(y.d[0], (f(a + h, b) - f(a - h, b)) / (2 * h), 1e-7);
    CHECK_NEAR(y.d[1], (f(a, b + h) - f(a, b - h)) / (2 * h), 1e-7);
}

template <class S>
static void check_error_functions(double tolerance) {
    for (double x = 0; x < 9; x += 0.125) {
        CHECK_NEAR(erfc_scaled(S(x)) / (std::exp(x * x) * std::erfc(x)), 1, tolerance);
        double integral = std::exp(-x * x) - SqrtPi * x * std::erfc(x);
        CHECK_NEAR(erfc_integral(S(x)), integral, tolerance);
        if (x > 0 && x < 4) {
            double p = std::erfc(x) / 2;
            CHECK_NEAR(erf_inverse_of_share(S(p)) / x, -1, 4 * tolerance);
            if (x < 2) CHECK_NEAR(erf_inverse_of_share(S(1 - p)) / x, 1, 100 * tolerance);
        }
    }
}

TR_TEST(error_functions_match_the_standard_library) {
    check_error_functions<double>(1e-14);
    check_error_functions<float>(4e-7);
    check_dual([](auto x, auto y) { return erfc_integral(x * y); }, 0.6, 1.5);
}

TR_TEST(fresnel_conductor_matches_complex_formula) {
    for (double eta : {0.2, 1.1, 3.0}) {
        for (double k : {0.0, 0.5, 3.9}) {
            for (double c = 1 / 64.; c <= 1; c += 1 / 64.) {
                std::complex<double> index(eta, -k), ct = std::sqrt(1. - (1 - c * c) / (index * index));
                double s = std::norm((c - index * ct) / (c + index * ct)),
                       p = std::norm((ct - index * c) / (ct + index * c));
                CHECK_NEAR(fresnel_conductor(c, eta, k), (s + p) / 2, 1e-9);
            }
        }
    }
}

TR_TEST(dual_numbers_match_finite_differences) {
    for (double a : {0.3, 0.7, 1.2}) {
        for (double b : {0.4, 1.5}) {
            check_dual([](auto x, auto y) { return x * y + x / y - (x - y) * x; }, a, b);
            check_dual([](auto x, auto y) { return sqrt(x) * exp(y) + log(x * y); }, a, b);
            check_dual([](auto x, auto y) { return max(x, y) - min(x * y, y) + abs(x - y); }, a, b);
            check_dual([](auto x, auto y) { return fresnel_conductor(decltype(x)(0.6), x, y); }, a, b);
            auto turned = [](auto x, auto y) {
                decltype(x) sine, cosine;
                sincos(x * y, sine, cosine);
                return sine * cosine * cosine + atan2(x, cosine - y);
            };
            check_dual(turned, a, b);
        }
    }
    check_dual([](auto x, auto y) { return fresnel_dielectric(x, y).reflectance; }, 0.6, 1.5);
    check_dual([](auto x, auto y) { return fresnel_dielectric(x, y).reflectance; }, -0.9, 1.5);
}

TR_TEST(warps_have_their_distributions) {
    double cosine = 0, z = 0, z_squared = 0, b1 = 0, b2 = 0;
    const int n = 200;  // a grid of cell centres: midpoint rule
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
            double u1 = (i + 0.5) / n, u2 = (j + 0.5) / n;
            auto h = square_to_cosine_hemisphere(u1, u2);
            auto s = square_to_sphere(u1, u2);
            auto c = square_to_cone(u1, u2, 0.25);
            auto t = square_to_triangle(u1, u2);
            CHECK_NEAR(norm(h), 1, 1e-9);
            CHECK_NEAR(norm(s), 1, 1e-9);
            CHECK_NEAR(norm(c), 1, 1e-9);
            CHECK(c.z >= 0.75 && h.z > 0 && t.x >= 0 && t.y >= 0 && t.x + t.y <= 1);
            cosine += h.z, z += s.z, z_squared += s.z * s.z, b1 += t.x, b2 += t.y;
        }
    }
    CHECK_NEAR(cosine / n / n, 2 / 3., 1e-3);
    CHECK_NEAR(z / n / n, 0, 1e-12);
    CHECK_NEAR(z_squared / n / n, 1 / 3., 1e-4);
    CHECK_NEAR(b1 / n / n, 1 / 3., 1e-3);
    CHECK_NEAR(b2 / n / n, 1 / 3., 1e-3);
}

TR_TEST(frames_are_orthonormal) {
    std::mt19937 generator(1);
    std::normal_distribution<double> normal;
    for (int i = 0; i < 1000; ++i) {
        Vec3<double> n = normalize(Vec3<double>{normal(generator), normal(generator), normal(generator)});
        if (i == 0) n = {0, 0, -1};
        Frame<double> f = make_frame(n);
        CHECK_NEAR(dot(f.s, f.t), 0, 1e-12);
        CHECK_NEAR(dot(f.s, f.n), 0, 1e-12);
        CHECK_NEAR(norm(f.s), 1, 1e-12);
        Vec3<double> c = cross(f.s, f.t) - n;
        CHECK_NEAR(max_abs(c), 0, 1e-12);
    }
}

#if TR_HAS_PACKETS
TR_TEST(packets_compute_what_numbers_do) {
    constexpr int W = TR_PACKET_WIDTH;
    alignas(64) float a[W], b[W];
    std::mt19937 generator(2);
    std::uniform_real_distribution<float> uniform(0.01f, 3.f);
    for (int round = 0; round < 100; ++round) {
        for (int i = 0; i < W; ++i) a[i] = uniform(generator), b[i] = uniform(generator) - 1.5f;
        auto x = load<FloatPacket>(a), y = load<FloatPacket>(b);
        FloatPacket s, c;
        sincos(y, s, c);
        for (int i = 0; i < W; ++i) {
            CHECK_NEAR(lane(sqrt(x), i), std::sqrt(a[i]), 1e-6);
            CHECK_NEAR(lane(exp(y), i), std::exp(b[i]), 4e-6);
            CHECK_NEAR(lane(log(x), i), std::log(a[i]), 1e-6);
            CHECK_NEAR(lane(s, i), std::sin(b[i]), 1e-6);
            CHECK_NEAR(lane(c, i), std::cos(b[i]), 1e-6);
            CHECK_NEAR(lane(atan2(y, x), i), std::atan2(b[i], a[i]), 1e-6);
            CHECK_NEAR(lane(abs(y), i), std::abs(b[i]), 0);
            CHECK_NEAR(lane(floor(y), i), std::floor(b[i]), 0);
            CHECK_NEAR(lane(min(x, y), i), std::min(a[i], b[i]), 0);
            CHECK_NEAR(lane(max(x, y), i), std::max(a[i], b[i]), 0);
        }
    }
}

TR_TEST(packets_draw_the_same_random_numbers) {
    using U = UIntOf<FloatPacket>;
    auto packet = random4<FloatPacket>(0x123456789abcdefull, 2, lane_index<FloatPacket>() + 5u, U(9u), 4);
    for (int i = 0; i < TR_PACKET_WIDTH; ++i) {
        auto one = random4<float>(0x123456789abcdefull, 2, uint32_t(i) + 5u, 9u, 4);
        for (int k = 0; k < 4; ++k) CHECK(lane(packet.u[k], i) == one.u[k]);
    }
}

// Numbers do not depend on what else is wanted, nor on how their keys were found.
TR_TEST(sobol_points_are_the_same_however_they_are_asked_for) {
    using U = UIntOf<FloatPacket>;
    const uint64_t seed = 0x123456789abcdefull;
    for (int64_t count : {int64_t(1), int64_t(16), int64_t(300), int64_t(100000)}) {
        const SamplerConfig sampler = make_sampler(SamplerKind::Sobol, 3, count);
        // pixels of one tile, and samples of one pattern
        uint32_t pixels[2 * TR_PACKET_WIDTH], samples[2 * TR_PACKET_WIDTH];
        const uint32_t side = 1u << sampler.tile_bits, first = 0x80008000u + (side << 16) + 5 * side;
        for (uint32_t i = 0; i < 2 * TR_PACKET_WIDTH; ++i) {
            pixels[i] = first + i % side + (i / side % side << 16);
            samples[i] = 3 + i % uint32_t(count);
        }
        CommonKeys keys;
        keys.of_batch(sampler, pixels, samples, 2 * TR_PACKET_WIDTH);
        CHECK(keys.common);
        keys.find(seed, 2, 4);
        CHECK(!keys(3) && keys(4) && keys(5) && !keys(6));
        const SobolPlace<U> place(sampler, load_uint<FloatPacket>(pixels), load_uint<FloatPacket>(samples));
        for (uint32_t block : {4u, 5u}) {
            const auto all = sobol4<FloatPacket>(sampler, seed, 2, place, block, AllWanted);
            for (uint32_t wanted = 1; wanted <= AllWanted; ++wanted) {
                const auto some = sobol4<FloatPacket>(sampler, seed, 2, place, block, wanted),
                           common = sobol4<FloatPacket>(sampler, seed, 2, place, block, wanted, keys(block));
                for (int k = 0; k < 4; ++k) {
                    const uint32_t bit = k < 2 ? PairWanted : k == 2 ? ThirdWanted : FourthWanted;
                    for (int i = 0; i < TR_PACKET_WIDTH; ++i) {
                        const float u = lane(some.u[k], i), v = lane(common.u[k], i);
                        if (wanted & bit)
                            CHECK(u == lane(all.u[k], i) && v == u);
                        else
                            CHECK(u != u && v != v);
                    }
                }
            }
        }
        for (uint32_t *one : {&pixels[1], &samples[1]}) {  // beside the tile; of another pattern
            const uint32_t kept = *one;
            *one += one == &pixels[1] ? side : 1u << sampler.bits;
            keys.of_batch(sampler, pixels, samples, 2 * TR_PACKET_WIDTH);
            CHECK(!keys.common);
            keys.find(seed, 2, 4);
            CHECK(!keys(4));
            *one = kept;
        }
        for (uint32_t y = 0; y < side; ++y)
            for (uint32_t x = 0; x < side; ++x) {
                uint32_t expected = 0;
                for (int b = 0; b < sampler.tile_bits; ++b)
                    expected |= (x >> b & 1) << (2 * b) | (y >> b & 1) << (2 * b + 1);
                CHECK(morton_in_tile(first + x + (y << 16), sampler.tile_bits) == expected);
            }
    }
}

TR_TEST(packets_draw_the_same_numbers_from_samplers) {
    using U = UIntOf<FloatPacket>;
    for (int64_t count : {int64_t(1), int64_t(6), int64_t(70000)}) {
        SamplerConfig sampler = make_sampler(SamplerKind::Stratified, 0, count);
        U pixel = lane_index<FloatPacket>() * U(65537u) + U(0x80008000u), sample(uint32_t(count - 1));
        const uint64_t seed = 0x123456789abcdefull;
        auto strata = stratified4<FloatPacket>(sampler, seed, 2, pixel, sample, 4, AllWanted);
        auto points = sobol4<FloatPacket>(sampler, seed, 2, SobolPlace<U>(sampler, pixel, sample), 4, AllWanted);
        for (int i = 0; i < TR_PACKET_WIDTH; ++i) {
            const uint32_t at = lane(pixel, i), number = lane(sample, i);
            auto one = stratified4<float>(sampler, seed, 2, at, number, 4, AllWanted);
            auto other = sobol4<float>(sampler, seed, 2, SobolPlace<uint32_t>(sampler, at, number), 4, AllWanted);
            for (int k = 0; k < 4; ++k) {
                CHECK(lane(strata.u[k], i) == one.u[k]);
                CHECK(lane(points.u[k], i) == other.u[k]);
            }
        }
    }
}

TR_TEST(lanes_of_a_column_are_found_in_any_order) {
    constexpr uint32_t W = TR_PACKET_WIDTH;
    alignas(64) float column[64 * W];
    for (uint32_t i = 0; i < 64 * W; ++i) column[i] = float(i);
    // from one entry on, both ways, near and far
    for (uint32_t first : {0u, 5 * W, 63 * W})
        for (int step : {-3, -2, -1, 0, 1, 2, 3}) {
            alignas(64) uint32_t entries[W];
            for (uint32_t i = 0; i < W; ++i)
                entries[i] = uint32_t(std::min(std::max(int(first) + step * int(i), 0), int(62 * W)));
            auto packet = load_uint<FloatPacket>(entries);
            MaskOf<FloatPacket> active = mask<FloatPacket>(lane_index<FloatPacket>() < W - 1);
            FloatPacket found = LaneSet<FloatPacket>(packet, active).get(column);
            for (uint32_t i = 0; i + 1 < W; ++i) CHECK(lane(found, int(i)) == column[entries[i]]);
        }
}

TR_TEST(compressed_lanes_keep_their_order) {
    constexpr int W = TR_PACKET_WIDTH;
    alignas(64) float values[W], out[W];
    for (int i = 0; i < W; ++i) values[i] = float(i);
    auto x = load<FloatPacket>(values);
    for (uint32_t bits = 0; bits < (1u << W); bits += W == 16 ? 37 : 1) {
        for (int i = 0; i < W; ++i) values[i] = (bits >> i) & 1 ? 1.f : 0.f;
        auto m = load<FloatPacket>(values) > 0.5f;
        store_compressed<FloatPacket>(out, x, m);
        int n = 0;
        for (int i = 0; i < W; ++i)
            if ((bits >> i) & 1) CHECK(out[n++] == float(i));
        CHECK(count(m) == n);
    }
}
#endif

}  // namespace tr
