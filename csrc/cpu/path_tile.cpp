// Compiled once for all who trace paths.
#include "path_tile.h"

namespace tr {

#define TR_INSTANTIATE(S)                 \
    template class PathTile<PacketOf<S>>; \
    template class MediumStage<PacketOf<S>>;
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
