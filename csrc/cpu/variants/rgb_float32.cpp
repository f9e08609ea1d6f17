#include "cpu/schedule.h"

namespace tr {

// in rgb_float32_single.cpp
extern template RenderStats detail::splat_paths<float, 3, false>(const RenderCall<float> &,
                                                                 const DerivativeCall<float> *,
                                                                 const RenderOutput<float> &);
extern template RenderStats detail::splat_paths<float, 3, true>(const RenderCall<float> &,
                                                                const DerivativeCall<float> *,
                                                                const RenderOutput<float> &);
extern template RenderStats detail::reverse_paths<float, 3>(const RenderCall<float> &, DerivativeCall<float> &);

template RenderStats render_primal<float, 3>(const RenderCall<float> &, bool, const RenderOutput<float> &);
template RenderStats render_reverse<float, 3>(const RenderCall<float> &, bool, DerivativeCall<float> &);
template RenderStats render_forward<float, 3>(const RenderCall<float> &, bool, const DerivativeCall<float> &, float *);

}  // namespace tr
