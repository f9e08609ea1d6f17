#include "cpu/particle_schedule.h"

namespace tr {

template RenderStats trace_light<double, 3>(const RenderCall<double> &, bool, double *);
template RenderStats trace_light_reverse<double, 3>(const RenderCall<double> &, bool, DerivativeCall<double> &);
template RenderStats trace_light_forward<double, 3>(const RenderCall<double> &, bool, const DerivativeCall<double> &,
                                                    double *);

}  // namespace tr
