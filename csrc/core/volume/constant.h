// `constvolume`: the same everywhere.
#pragma once

#include "../model.h"

namespace tr {

struct ConstantVolume {
    enum { Value };
    static constexpr Field fields[] = {
        {"value", Kind::Spectrum, 1, -INFINITY, INFINITY, "interior", "the value, a number or one a channel"},
    };
    static constexpr Model model = {"volume", "constvolume",   "The same value everywhere.", fields, 1,
                                    0,        "ConstantVolume"};
};

}  // namespace tr
