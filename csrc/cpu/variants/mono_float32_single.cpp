// A number at a time instead of a packet: what packets are tested against. (Elsewhere than the packets, since it need
// not be as fast.)
#include "cpu/schedule.h"

namespace tr {

template RenderStats detail::splat_paths<float, 1, false>(const RenderCall<float> &, const DerivativeCall<float> *,
                                                          const RenderOutput<float> &);
template RenderStats detail::splat_paths<float, 1, true>(const RenderCall<float> &, const DerivativeCall<float> *,
                                                         const RenderOutput<float> &);
template RenderStats detail::reverse_paths<float, 1>(const RenderCall<float> &, DerivativeCall<float> &);

}  // namespace tr
