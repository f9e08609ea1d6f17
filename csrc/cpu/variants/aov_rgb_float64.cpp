#include "cpu/aov_schedule.h"

namespace tr {

template RenderStats render_aov<double, 3>(const RenderCall<double> &, bool, const AovOutput<double> &);
template RenderStats reverse_aov<double, 3>(const RenderCall<double> &, bool, const AovOutput<double> &,
                                            DerivativeCall<double> &);
template RenderStats forward_aov<double, 3>(const RenderCall<double> &, bool, const AovOutput<double> &,
                                            const DerivativeCall<double> &);

}  // namespace tr
