// A number at a time instead of a packet: what packets are tested against. (Elsewhere than the packets, since it need
// not be as fast.)
#include "cpu/particle_schedule.h"

namespace tr {

template RenderStats detail::splat_light<float, 1, false>(const RenderCall<float> &, const DerivativeCall<float> *,
                                                          float *);
template RenderStats detail::splat_light<float, 1, true>(const RenderCall<float> &, const DerivativeCall<float> *,
                                                         float *);
template RenderStats detail::reverse_light<float, 1>(const RenderCall<float> &, DerivativeCall<float> &);

}  // namespace tr
