// Polarised light on the tape of a light path, see polarization.h: what light brings runs from the path's beginning, as
// rows, and brings Stokes vectors to the film along connections; what the film hands back runs from its end, as
// columns.
#pragma once

#include "polarization.h"
#include "sweep.h"

namespace tr {

// A packet of vertices, or of beginnings: the row for what leaves along the path goes to the vertices behind, and what
// connections bring to the tape.
template <class F>
TR_LARGE void hand_light(const SweepContext<F> &c, const LightSensor<ScalarOf<F>> &sensor,
                         const TapeColumns<ScalarOf<F>> &tape, const TapeColumns<ScalarOf<F>> *parents, int kind,
                         uint32_t i, const MaskOf<F> &active);

// The derivative, with the adjoints of connections in the place of what they brought.
template <class F>
TR_LARGE void sweep_polarized_light_vertex(const SweepContext<F> &c, const LightSensor<ScalarOf<F>> &sensor,
                                           const TapeColumns<ScalarOf<F>> &tape,
                                           const TapeColumns<ScalarOf<F>> *parents, int kind, uint32_t i,
                                           const MaskOf<F> &active, GradientSink<F> &sink);

}  // namespace tr
