// `twosided`: makes a one-sided BSDF reflect from both sides. Not a BSDF of its own while rendering: a hit is resolved
// to the nested model and, from behind, to mirrored directions.
#pragma once

#include "../math/dual.h"
#include "../model.h"

namespace tr {

struct TwoSided {
    enum { Front, Back };
    static constexpr Field fields[] = {
        {"brdf_0", Kind::Bsdf, None, 0, INFINITY, "", "front; and back, if there is no second"},
        {"brdf_1", Kind::Bsdf, -1, 0, INFINITY, "", "back"},
    };
    static constexpr Model model = {"bsdf",     "twosided", "Reflection from both sides of a surface.", fields, 2,
                                    WrapsBsdfs, "TwoSided"};
};

}  // namespace tr
