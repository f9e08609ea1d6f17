// Discrete distributions as cumulative tables, summed in double precision.
#pragma once

#include <cstddef>
#include <vector>

#include "../core/emitter/cells.h"

namespace tr {

// cdf[i] = (w[0] + ... + w[i]) / total, the last exactly 1; uniform if all weights are 0. Weights are finite and not
// negative. Returns the total.
template <class S>
double build_cdf(const double *weights, size_t n, S *cdf);

// A table of core/emitter/cells.h, of table_size(n) numbers; returns the total.
template <class S>
double build_cell_table(const double *weights, size_t n, S *table);

// Tables of a grid: cells of the weights weight(row, column), rows weighted by factor(row) besides, appended.
template <class S, class Weight, class Factor>
void build_cells(int rows, int columns, std::vector<S> &marginal, std::vector<S> &conditional, Weight &&weight,
                 Factor &&factor) {
    const size_t n_rows = size_t(rows), n_columns = size_t(columns), stride = table_size(uint32_t(columns));
    const size_t first_row = marginal.size(), first_cell = conditional.size();
    marginal.resize(first_row + table_size(uint32_t(rows))), conditional.resize(first_cell + n_rows * stride);
    std::vector<double> cells(n_columns), of_row(n_rows);
    for (size_t i = 0; i < n_rows; ++i) {
        for (size_t j = 0; j < n_columns; ++j) cells[j] = weight(int(i), int(j));
        of_row[i] = factor(int(i)) * build_cell_table(cells.data(), n_columns, &conditional[first_cell + i * stride]);
    }
    build_cell_table(of_row.data(), n_rows, &marginal[first_row]);
}

// The luminance of what value(wavelength in nm above FirstWavelength) is, under daylight.
template <class Value>
double luminance_under_daylight(Value &&value) {
    double sum = 0;
    for (int third = 0; third < LuminanceNodes / SpectrumSize; ++third) {
        const Wavelengths<double> waves = luminance_wavelengths<double>(third);
        for (double at : waves.at) sum += value(at);
    }
    return sum / LuminanceNodes;
}

// Of a colour of one or three channels, or with SigmoidChannels.
template <class S>
double luminance_of(const S *c, int channels) {
    if (channels == SigmoidChannels) {
        const double row[SigmoidChannels] = {double(c[0]), double(c[1]), double(c[2]), double(c[3])};
        return row[3] * luminance_under_daylight([&](double at) { return Sigmoid<double>(at, row).value; });
    }
    return channels == 3 ? luminance(Spectrum<double>{{double(c[0]), double(c[1]), double(c[2])}}) : double(c[0]);
}

// Tables of EnvironmentMap: a cell between each two neighbouring columns (cyclically) and rows of texels, weighted by
// the mean luminance of its corners and the sine of the polar angle at its centre.
template <class S>
struct EnvironmentTables {
    int columns = 0, rows = 0;
    std::vector<S> marginal;     // table of rows
    std::vector<S> conditional;  // tables of the columns in each row
    std::vector<S> texels;       // a copy of what they were made from

    void build(const TensorView<S> &data);
};

}  // namespace tr
