#include "cpu/schedule.h"

namespace tr {

template RenderStats render_primal<float, 3>(const RenderCall<float> &, bool, const RenderOutput<float> &);
template RenderStats render_reverse<float, 3>(const RenderCall<float> &, bool, DerivativeCall<float> &);
template RenderStats render_forward<float, 3>(const RenderCall<float> &, bool, const DerivativeCall<float> &, float *);

}  // namespace tr
