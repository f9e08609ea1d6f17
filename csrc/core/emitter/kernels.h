// From a model's functions to its table: a class template over the Float with a static function `table`. A model ends
// with TR_EMITTER(Model, Functions).
#pragma once

#include "../adjoint/vertex.h"

namespace tr {

template <class M>
struct EmitterFunctions;

template <class M, class F>
TR_DEVICE_CONSTEXPR EmitterKernels<F> emitter_kernels_of() {
    return EmitterFunctions<M>::template Of<F>::table();
}

}  // namespace tr

#define TR_EMITTER_FOR(S, M) template EmitterKernels<PacketOf<S>> emitter_kernels_of<M, PacketOf<S>>();
#define TR_EMITTER(M, Functions) \
    template <>                  \
    struct EmitterFunctions<M> { \
        template <class F>       \
        using Of = Functions<F>; \
    };                           \
    TR_FOR_EACH_PRECISION_OF(TR_EMITTER_FOR, M)
