#include "cpu/particle_schedule.h"

namespace tr {

// in light_mono_float32_single.cpp
extern template RenderStats detail::splat_light<float, 1, false>(const RenderCall<float> &,
                                                                 const DerivativeCall<float> *, float *);
extern template RenderStats detail::splat_light<float, 1, true>(const RenderCall<float> &,
                                                                const DerivativeCall<float> *, float *);
extern template RenderStats detail::reverse_light<float, 1>(const RenderCall<float> &, DerivativeCall<float> &);

template RenderStats trace_light<float, 1>(const RenderCall<float> &, bool, float *);
template RenderStats trace_light_reverse<float, 1>(const RenderCall<float> &, bool, DerivativeCall<float> &);
template RenderStats trace_light_forward<float, 1>(const RenderCall<float> &, bool, const DerivativeCall<float> &,
                                                   float *);

}  // namespace tr
