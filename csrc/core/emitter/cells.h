// Densities over the unit square that are constant in each cell of a grid: a row is chosen, then a column in it, and
// what is left of the two numbers is the place in the cell. Pharr, Jakob and Humphreys, "Physically Based Rendering",
// section 12.5. Tables: csrc/host/distribution.h.
#pragma once

#include "../scene.h"

namespace tr {

// A grid in tables that several may share; lanes may have different ones.
template <class F>
struct CellGrid {
    using U = UIntOf<F>;
    const ScalarOf<F> *marginal, *conditional;  // cumulative: of rows, of the columns in each
    U rows, columns, first_row, first_cell;     // where they begin in the tables

    // Probability of a cell.
    TR_INLINE F mass(const U &row, const U &column, const MaskOf<F> &active) const {
        F of_row = step(marginal, first_row, row, active);
        return of_row * step(conditional, first_cell + row * columns, column, active);
    }

    static TR_INLINE F before(const ScalarOf<F> *cdf, const U &first, const U &i, const MaskOf<F> &active) {
        return select(mask<F>(i > 0u), gather<F>(cdf, first + max(i, U(1u)) - 1u, active), F(0));
    }

private:
    static TR_INLINE F step(const ScalarOf<F> *cdf, const U &first, const U &i, const MaskOf<F> &active) {
        return gather<F>(cdf, first + i, active) - before(cdf, first, i, active);
    }
};

// A cell, and where in it: fractions of its width and height.
template <class F>
struct SampledCell {
    UIntOf<F> row, column;
    F across, down, mass;

    TR_INLINE SampledCell(const CellGrid<F> &grid, const F &by_row, const F &by_column, const MaskOf<F> &active) {
        F of_row, of_column;
        row = find(grid.marginal, grid.first_row, grid.rows, by_row, active, of_row, down);
        column = find(grid.conditional, grid.first_cell + row * grid.columns, grid.columns, by_column, active,
                      of_column, across);
        mass = of_row * of_column;
    }

private:
    static TR_INLINE UIntOf<F> find(const ScalarOf<F> *cdf, const UIntOf<F> &first, const UIntOf<F> &n, const F &u,
                                    const MaskOf<F> &active, F &mass, F &fraction) {
        UIntOf<F> i = search_cdf<F>(cdf, first, n, u, active);
        F before = CellGrid<F>::before(cdf, first, i, active);
        mass = gather<F>(cdf, first + i, active) - before;
        fraction = max(F(0), min((u - before) / max(mass, F(1e-20)), F(1)));
        return i;
    }
};

}  // namespace tr
