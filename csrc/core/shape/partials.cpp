// Compiled once for all who evaluate surfaces.
#include "partials.h"

namespace tr {

#define TR_INSTANTIATE(S)                                                                                             \
    template CurvePoint<PacketOf<S>>::CurvePoint(const SceneView<S> &, const SurfacePoint<PacketOf<S>> &,             \
                                                 const ShapeLanes<PacketOf<S>> &, const MaskOf<PacketOf<S>> &);       \
    template PositionPartials<PacketOf<S>> position_partials(const SceneView<S> &, const SurfacePoint<PacketOf<S>> &, \
                                                             const ShapeLanes<PacketOf<S>> &,                         \
                                                             const MaskOf<PacketOf<S>> &);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
