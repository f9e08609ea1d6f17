// What a derivative asks for.
#pragma once

#include "../math/facts.h"

namespace tr {

// Of the properties of media.
struct MediumNeeds {
    uint8_t extinction, albedo, emission, phase;
    TR_HD bool any() const { return extinction || albedo || emission || phase; }
};

struct GradientNeeds {
    bool bsdf, emitter;
    TR_MOVES(light_position);
    TR_MOVES(geometry);  // anything that moves rays, hits or look-ups
    TR_MOVES(camera);
    MediumNeeds medium{};
    bool black_light = true;         // light paths that carry nothing may have a derivative
    const int32_t *bsdfs = nullptr;  // by bsdf, whether a parameter of it is differentiated; null if `bsdf` is not set
    // By a BSDF's kind: its variables whose derivative counts for some record, a bit each; null: all of them. Of a call
    // in which nothing moves those are missing that move with a look-up: who sets `geometry` later sweeps no radiance.
    const uint32_t *variables = nullptr;
    // Of shapes whose BSDFs are differentiated, see SceneData::boxes_with; -1: they are not known.
    const float *boxes = nullptr;
    int32_t n_boxes = -1;
    TR_HD bool numbers() const { return light_position || geometry; }  // adjoints that are sums over components
    TR_HD uint32_t variables_of(int kind) const { return variables ? variables[kind] : 0xffffffffu; }
};

}  // namespace tr
