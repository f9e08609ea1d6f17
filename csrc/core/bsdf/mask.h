// `mask`: a BSDF with holes: met with probability `opacity`, else passed unchanged. See integrator/bsdf_stack.h.
#pragma once

#include "../math/dual.h"
#include "../model.h"

namespace tr {

struct MaskBsdf {
    enum { Opacity, Nested };
    static constexpr Field fields[] = {
        {"opacity", Kind::Scalar, 0.5, 0, 1, "interior",
         "share of the surface that is there; beyond 0 and 1 it counts as those"},
        {"nested_bsdf", Kind::Bsdf, None, 0, INFINITY, "", "what is there"},
    };
    static constexpr Model model = {"bsdf", "mask", "A BSDF with holes.", fields, 2, WrapsBsdfs | Transmits};
};

}  // namespace tr
