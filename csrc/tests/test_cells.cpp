// Tables of cells: what their guides find is what a search of all cells finds.
#include <algorithm>
#include <cmath>
#include <random>
#include <utility>
#include <vector>

#include "harness.h"
#include "host/distribution.h"

namespace tr::testing {

namespace {

// Densities that are even, black at both ends and in between, steep, and black altogether.
std::vector<std::vector<double>> densities(size_t n) {
    std::mt19937 random(9);
    std::uniform_real_distribution<double> uniform(0, 1);
    std::vector<std::vector<double>> r(4, std::vector<double>(n, 0.0));
    for (size_t i = 0; i < n; ++i) {
        r[0][i] = uniform(random);
        r[1][i] = i % 7 < 3 || i < n / 4 || i > 3 * n / 4 ? 0 : uniform(random);
        r[2][i] = std::exp(-40 * std::abs(double(i) / double(n) - 0.6));
    }
    return r;
}

template <class F>
void check_cells() {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    constexpr size_t W = size_t(Lanes<F>::Width);
    std::mt19937 random(4);
    std::uniform_real_distribution<S> uniform(0, 1);
    for (uint32_t n : {1u, 2u, 3u, 4u, 7u, 64u, 100u, 1025u})
        for (const std::vector<double> &weights : densities(n)) {
            std::vector<S> table(5, S(-1)), cdf(n), numbers;  // the table lies behind another one
            table.resize(5 + table_size(n));
            const double total = build_cell_table(weights.data(), n, &table[5]);
            CHECK(total == build_cdf(weights.data(), n, cdf.data()));
            CHECK(std::equal(cdf.begin(), cdf.end(), &table[5]));
            // anywhere, at the ends of cells, and at those of the guide's parts
            for (int i = 0; i < 200; ++i) numbers.push_back(uniform(random));
            numbers.insert(numbers.end(), cdf.begin(), cdf.end());
            for (uint32_t k = 0; k <= n_buckets(n); ++k) numbers.push_back(S(k) / S(n_buckets(n)));
            for (size_t i = 0, many = numbers.size(); i < many; ++i)
                for (S to : {S(0), S(1)}) numbers.push_back(std::nextafter(numbers[i], to));
            for (S &u : numbers) u = std::min(u, std::nextafter(S(1), S(0)));
            while (numbers.size() % W) numbers.push_back(0);
            for (size_t i = 0; i < numbers.size(); i += W) {
                const MaskOf<F> all(true);
                const F u = load<F>(&numbers[i]);
                const CellTable<F> cells{table.data(), U(5u), U(n)};
                const U found = cells.find(u, all);
                F before, mass = cells.mass(found, all, before);
                alignas(64) uint32_t index[W];
                alignas(64) S p[W], p_before[W];
                store(&index[0], found), store(&p[0], mass), store(&p_before[0], before);
                for (size_t k = 0; k < W; ++k) {
                    auto expected = size_t(std::upper_bound(cdf.begin(), cdf.end(), numbers[i + k]) - cdf.begin());
                    CHECK(index[k] == expected);
                    CHECK(p_before[k] == (expected ? cdf[expected - 1] : S(0)));
                    CHECK(p[k] == cdf[expected] - p_before[k]);
                    CHECK(p[k] > 0);
                }
            }
        }
}

}  // namespace

TR_TEST(guides_find_the_cells_that_a_search_finds) {
    for (auto [n, buckets] :
         {std::pair(1u, 1u), {3u, 1u}, {4u, 2u}, {7u, 2u}, {8u, 4u}, {1025u, 512u}, {~0u, 1u << 30}})
        CHECK(n_buckets(n) == buckets);
    const std::vector<double> even(100, 1.0);  // with 32 parts of 3.1 cells
    std::vector<float> table(table_size(100u));
    build_cell_table(even.data(), 100, table.data());
    for (size_t k = 0; k < 32; ++k) CHECK(table[100 + k + 1] - table[100 + k] <= 4);
    check_cells<float>();
    check_cells<double>();
    check_cells<PacketOf<float>>();
}

}  // namespace tr::testing
