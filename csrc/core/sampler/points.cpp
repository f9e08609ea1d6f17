// Compiled once for all who draw numbers.
#include "sobol.h"
#include "stratified.h"

namespace tr {

#define TR_INSTANTIATE(S)                                                                                            \
    template Random4<PacketOf<S>> sobol4<PacketOf<S>>(const SamplerConfig &, uint64_t, uint32_t,                     \
                                                      const SobolPlace<UIntOf<PacketOf<S>>> &, uint32_t, uint32_t,   \
                                                      const uint32_t *);                                             \
    template Random4<PacketOf<S>> stratified4<PacketOf<S>>(const SamplerConfig &, uint64_t, uint32_t,                \
                                                           const UIntOf<PacketOf<S>> &, const UIntOf<PacketOf<S>> &, \
                                                           uint32_t, uint32_t);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
