// From a model's functions to its table. A model has eval, sample, slope and, if it has parameters, vjp as PhaseKernels
// says, as static templates over the Float, and ends with TR_PHASE(Model).
#pragma once

#include "../adjoint/gradient_sink.h"
#include "phase.h"

namespace tr {

template <class M, class F>
TR_DEVICE_CONSTEXPR PhaseKernels<F> phase_kernels_of() {
    PhaseKernels<F> r{M::model, &M::template eval<F>, &M::template sample<F>, &M::template slope<F>, nullptr};
    if constexpr (M::model.n_fields > 0) r.vjp = &M::template vjp<F>;
    return r;
}

}  // namespace tr

#define TR_PHASE_FOR(S, M) template PhaseKernels<PacketOf<S>> phase_kernels_of<M, PacketOf<S>>();
#define TR_PHASE(M) TR_FOR_EACH_PRECISION_OF(TR_PHASE_FOR, M)
