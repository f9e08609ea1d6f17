// Densities over the unit square that are constant in each cell of a grid: a row is chosen, then a column in it, and
// what is left of the two numbers is the place in the cell. Pharr, Jakob and Humphreys, "Physically Based Rendering",
// section 12.5. Tables: csrc/host/distribution.h.
//
// Which of n cells a number u of [0, 1) chooses, cumulative probabilities say, and a guide behind them where to look
// (Chen and Asau, "On Generating Random Variates from an Empirical Distribution", AIIE Transactions 6(2), 1974): for
// each of n_buckets(n) equal parts of the unit interval, and for its end, the first cell that may be meant. There are a
// power of two of them, so that the part of u is exact. Numbers of cells are, in single precision, up to 2^24.
#pragma once

#include "../scene.h"

namespace tr {

// The largest power of two that is at most half of n, or 1.
template <class U>
TR_INLINE U n_buckets(const U &n) {
    U bits = max(n >> 1, U(1u));
    bits = bits | (bits >> 1), bits = bits | (bits >> 2), bits = bits | (bits >> 4);
    bits = bits | (bits >> 8), bits = bits | (bits >> 16);
    return bits - (bits >> 1);
}
// Numbers of a table of n cells.
template <class U>
TR_INLINE U table_size(const U &n) {
    return n + n_buckets(n) + U(1u);
}

// A table, or one a lane.
template <class F>
struct CellTable {
    using U = UIntOf<F>;
    using I = IntOf<F>;
    const ScalarOf<F> *at;
    U first, n;

    TR_INLINE U find(const F &u, const MaskOf<F> &active) const {
        const U buckets = n_buckets(n);
        const U bucket = min(U(I(u * F(I(buckets)))), buckets - 1u);
        F range[2];
        gather_rows<F>(at, first + n + bucket, active, range);
        return search_cdf_between<F>(at, first, U(I(range[0])), U(I(range[1])), u, active);
    }
    // The probability of cell i, and of those before it.
    TR_INLINE F mass(const U &i, const MaskOf<F> &active, F &before) const {
        F up_to[2];
        gather_rows<F>(at, first + max(i, U(1u)) - 1u, active, up_to);
        auto is_first = mask<F>(i == 0u);
        before = select(is_first, F(0), up_to[0]);
        return select(is_first, up_to[0], up_to[1]) - before;
    }
};

// A grid in tables that several may share; lanes may have different ones.
template <class F>
struct CellGrid {
    using U = UIntOf<F>;
    const ScalarOf<F> *marginal, *conditional;  // tables of rows, of the columns in each
    U rows, columns, first_row, first_cell;     // where they begin

    TR_INLINE CellTable<F> of_rows() const { return {marginal, first_row, rows}; }
    TR_INLINE CellTable<F> of_columns(const U &row) const {
        return {conditional, first_cell + row * table_size(columns), columns};
    }
    // Probability of a cell.
    TR_INLINE F mass(const U &row, const U &column, const MaskOf<F> &active) const {
        F before;
        F of_row = of_rows().mass(row, active, before);
        return of_row * of_columns(row).mass(column, active, before);
    }
};

// A cell, and where in it: fractions of its width and height.
template <class F>
struct SampledCell {
    UIntOf<F> row, column;
    F across, down, mass;

    TR_INLINE SampledCell(const CellGrid<F> &grid, const F &by_row, const F &by_column, const MaskOf<F> &active) {
        mass = choose(grid.of_rows(), by_row, active, row, down);
        mass = mass * choose(grid.of_columns(row), by_column, active, column, across);
    }

private:
    static TR_INLINE F choose(const CellTable<F> &table, const F &u, const MaskOf<F> &active, UIntOf<F> &i,
                              F &fraction) {
        i = table.find(u, active);
        F before, mass = table.mass(i, active, before);
        fraction = max(F(0), min((u - before) / max(mass, F(1e-20)), F(1)));
        return mass;
    }
};

}  // namespace tr
