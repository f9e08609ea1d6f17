#include "distribution.h"

#include <algorithm>

namespace tr {

template <class S>
double build_cdf(const double *weights, size_t n, S *cdf) {
    double total = 0;
    for (size_t i = 0; i < n; ++i) total += weights[i];
    double sum = 0;
    for (size_t i = 0; i < n; ++i) {
        sum += total > 0 ? weights[i] : 1;
        cdf[i] = S(std::min(1.0, sum / (total > 0 ? total : double(n))));
    }
    if (n > 0) cdf[n - 1] = S(1);
    return total;
}

template <class S>
double build_cell_table(const double *weights, size_t n, S *table) {
    const double total = build_cdf(weights, n, table);
    const size_t buckets = n_buckets(uint32_t(n));
    for (size_t k = 0, i = 0; k <= buckets; ++k) {
        while (i + 1 < n && table[i] <= S(k) / S(buckets)) ++i;
        table[n + k] = S(i);
    }
    return total;
}

template <class S>
void EnvironmentTables<S>::build(const TensorView<S> &data) {
    const int height = data.shape[0], channels = data.shape[2];
    columns = data.shape[1];
    rows = std::max(height - 1, 1);
    std::vector<double> importance(size_t(height) * size_t(columns));
    for (size_t i = 0; i < importance.size(); ++i)
        importance[i] = std::max(luminance_of(data.data + i * size_t(channels), channels), 0.0);
    auto at = [&](int row, int column) {
        return importance[size_t(std::min(row, height - 1)) * size_t(columns) + size_t(column % columns)];
    };
    bool black = std::all_of(importance.begin(), importance.end(), [](double y) { return y == 0; });
    marginal.clear(), conditional.clear();
    auto weight = [&](int i, int j) {
        return black ? 1 : 0.25 * (at(i, j) + at(i, j + 1) + at(i + 1, j) + at(i + 1, j + 1));
    };
    build_cells(rows, columns, marginal, conditional, weight, [&](int i) { return std::sin((i + 0.5) / rows * Pi); });
}

template double build_cdf(const double *, size_t, float *);
template double build_cdf(const double *, size_t, double *);
template double build_cell_table(const double *, size_t, float *);
template double build_cell_table(const double *, size_t, double *);
#define TR_INSTANTIATE(S) template struct EnvironmentTables<S>;
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
