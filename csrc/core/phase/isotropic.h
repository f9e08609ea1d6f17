// `isotropic`: all directions alike.
#pragma once

#include "../math/warp.h"
#include "../model.h"

namespace tr {

struct Isotropic {
    static constexpr Field fields[] = {{nullptr, Kind::Int, 0, 0, 0, "", ""}};
    static constexpr Model model = {"phase", "isotropic", "Scatters alike in all directions.", fields, 0};
};

}  // namespace tr
