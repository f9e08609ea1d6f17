#include "cpu/aov_schedule.h"

namespace tr {

template RenderStats render_aov<float, 1>(const RenderCall<float> &, bool, const AovOutput<float> &);
template RenderStats reverse_aov<float, 1>(const RenderCall<float> &, bool, const AovOutput<float> &,
                                           DerivativeCall<float> &);
template RenderStats forward_aov<float, 1>(const RenderCall<float> &, bool, const AovOutput<float> &,
                                           const DerivativeCall<float> &);

}  // namespace tr
