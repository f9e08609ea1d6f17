// The sweep over the path tape of polarised light, see polarization.h: a packet of vertices, whose column goes to the
// vertices before, whose row to those behind, and whose derivative to the gradients.
#pragma once

#include "polarized_medium.h"
#include "sweep.h"

namespace tr {

// Of polarised light: the column for the vertex before, or what the path brings; the row for the vertex behind; and,
// with both, the derivative.
template <class F>
TR_LARGE void hand_column(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                          const TapeColumns<ScalarOf<F>> *parents, int kind, bool scatters, uint32_t i,
                          const MaskOf<F> &active);
template <class F>
TR_LARGE void hand_row(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                       const TapeColumns<ScalarOf<F>> *parents, int kind, bool scatters, uint32_t i,
                       const MaskOf<F> &active);
// (after hand_row of the vertices before) the row for what leaves a vertex that scatters.
template <class F>
TR_LARGE Stokes<F> leaving_row(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                               const TapeColumns<ScalarOf<F>> *parents, int kind, uint32_t i, const MaskOf<F> &active);
template <class F>
TR_LARGE void sweep_polarized_vertex(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                                     const TapeColumns<ScalarOf<F>> *parents, uint32_t level, int kind, bool scatters,
                                     uint32_t i, const MaskOf<F> &active, GradientSink<F> &sink);

}  // namespace tr
