// Compiled once for all who trace paths.
#include "wavefront.h"

namespace tr {

#define TR_INSTANTIATE(S)                  \
    template class Wavefront<PacketOf<S>>; \
    template class Bender<PacketOf<S>>;    \
    template struct TapeLevel<S>;
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
