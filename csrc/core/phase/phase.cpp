#include "phase.h"

namespace tr {

template <class F>
TR_HD const PhaseKernels<F> &phase_kernels(int kind) {
#define TR_TABLE(M) phase_kernels_of<M, F>(),
    static const PhaseKernels<F> all[] = {TR_PHASES(TR_TABLE)};
#undef TR_TABLE
    return all[kind];
}

#define TR_INSTANTIATE(F, S) template const PhaseKernels<F> &phase_kernels(int);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
