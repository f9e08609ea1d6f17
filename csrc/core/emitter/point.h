// `point`: radiates equally in all directions from a point.
#pragma once

#include "../scene.h"

namespace tr {

struct PointEmitter {
    enum { Intensity, Position, Weight };
    static constexpr Field fields[] = {
        {"intensity", Kind::Spectrum, 1, 0, INFINITY, "interior", "radiant intensity, W / sr"},
        {"position", Kind::Point, 0, -INFINITY, INFINITY,
         "interior, without moving shadow edges; zero where nothing casts a shadow of it", "where it is, world space"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
    };
    static constexpr Model model = {"emitter", "point", "A point light.", fields, 3};
};

}  // namespace tr
