// `blendbsdf`: one of two BSDFs, chosen by chance, the second with probability `weight`. Not a BSDF of its own while
// rendering, see integrator/bsdf_stack.h.
#pragma once

#include "../math/dual.h"
#include "../model.h"

namespace tr {

struct BlendBsdf {
    enum { Weight, First, Second };
    static constexpr Field fields[] = {
        {"weight", Kind::Scalar, 0.5, 0, 1, "interior", "share of the second BSDF; beyond 0 and 1 it counts as those"},
        {"bsdf_0", Kind::Bsdf, None, 0, INFINITY, "", "seen where the weight is 0"},
        {"bsdf_1", Kind::Bsdf, None, 0, INFINITY, "", "seen where it is 1"},
    };
    static constexpr Model model = {"bsdf", "blendbsdf", "A mixture of two BSDFs.", fields, 3, WrapsBsdfs, "BlendBSDF"};
};

}  // namespace tr
