#include "cpu/particle_schedule.h"

namespace tr {

template RenderStats trace_light<float, 1>(const RenderCall<float> &, bool, float *);
template RenderStats trace_light_reverse<float, 1>(const RenderCall<float> &, bool, DerivativeCall<float> &);
template RenderStats trace_light_forward<float, 1>(const RenderCall<float> &, bool, const DerivativeCall<float> &,
                                                   float *);

}  // namespace tr
