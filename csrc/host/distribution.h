// Discrete distributions as cumulative tables, summed in double precision.
#pragma once

#include <cstddef>
#include <vector>

#include "../core/scene.h"

namespace tr {

// cdf[i] = (w[0] + ... + w[i]) / total, the last exactly 1; uniform if all weights are 0. Weights are finite and not
// negative. Returns the total.
template <class S>
double build_cdf(const double *weights, size_t n, S *cdf);

// Tables of core/emitter/cells.h: cells of the weights weight(row, column), rows weighted by factor(row) besides.
template <class S, class Weight, class Factor>
void build_cells(int rows, int columns, S *marginal, S *conditional, Weight &&weight, Factor &&factor) {
    std::vector<double> cells(static_cast<size_t>(columns)), of_row(static_cast<size_t>(rows));
    for (int i = 0; i < rows; ++i) {
        for (int j = 0; j < columns; ++j) cells[size_t(j)] = weight(i, j);
        of_row[size_t(i)] =
            factor(i) * build_cdf(cells.data(), cells.size(), conditional + size_t(i) * size_t(columns));
    }
    build_cdf(of_row.data(), of_row.size(), marginal);
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
    std::vector<S> marginal;     // of rows
    std::vector<S> conditional;  // of the columns in each row
    std::vector<S> texels;       // a copy of what they were made from

    void build(const TensorView<S> &data);
};

}  // namespace tr
