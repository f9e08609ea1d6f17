// `directionalarea`: a shape that emits along its normal only, in parallel beams where it is flat. No other direction
// has light, so neither sampling of emitters nor a BSDF's sample finds it: it is seen by light tracing alone.
#pragma once

#include "../scene.h"

namespace tr {

struct DirectionalAreaEmitter {
    enum { Radiance, Weight };  // as the area emitter's, whose ShapeIndex it shares
    static constexpr Field fields[] = {
        {"radiance", Kind::Texture, 1, 0, INFINITY, "interior", "power that leaves a unit of area, W / m^2"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
    };
    static constexpr Model model = {"emitter", "directionalarea", "A shape that emits along its normal.", fields, 2};
};

}  // namespace tr
