// `constant`: the same radiance from every direction. Sampled uniformly.
#pragma once

#include "../scene.h"

namespace tr {

struct ConstantEmitter {
    enum { Radiance, Weight };
    static constexpr Field fields[] = {
        {"radiance", Kind::Spectrum, 1, 0, INFINITY, "interior", "radiance from everywhere, W / (m^2 sr)"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
    };
    static constexpr Model model = {"emitter", "constant", "A constant environment.", fields, 2};
};

}  // namespace tr
