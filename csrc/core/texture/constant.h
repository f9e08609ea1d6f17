// A colour that is the same everywhere.
#pragma once

#include "../scene.h"

namespace tr {

struct ConstantTexture {
    enum { Value };
    static constexpr Field fields[] = {
        {"value", Kind::Spectrum, None, -INFINITY, INFINITY, "interior", "one number, or one a channel"},
    };
    static constexpr Model model = {"texture", "constant",       "A colour that is the same everywhere.", fields, 1,
                                    0,         "ConstantTexture"};
};

}  // namespace tr
