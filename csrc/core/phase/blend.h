// `blendphase`: two phase functions, (1 - weight) of the first and weight of the second.
#pragma once

#include "../model.h"

namespace tr {

struct BlendPhase {
    enum { Weight, First, Second };
    static constexpr Field fields[] = {
        {"weight", Kind::Volume, 0.5, 0, 1, "interior", "share of the second, one number everywhere or in each voxel"},
        {"phase_0", Kind::Phase, None, 0, INFINITY, "", "the first phase function"},
        {"phase_1", Kind::Phase, None, 0, INFINITY, "", "the second phase function"},
    };
    static constexpr Model model = {"phase", "blendphase", "Two phase functions, blended by a volume.", fields, 3};
};

}  // namespace tr
