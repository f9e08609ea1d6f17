#include "cpu/schedule.h"

namespace tr {

template RenderStats render_primal<double, 3>(const RenderCall<double> &, bool, const RenderOutput<double> &);
template RenderStats render_reverse<double, 3>(const RenderCall<double> &, bool, DerivativeCall<double> &);
template RenderStats render_forward<double, 3>(const RenderCall<double> &, bool, const DerivativeCall<double> &,
                                               double *);

}  // namespace tr
