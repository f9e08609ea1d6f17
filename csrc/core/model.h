// How a model declares itself. The declaration is the only list of a model's parameters: packing, gradient buffers, the
// Python classes, the documentation and the generic tests are made from it.
#pragma once

#include <limits>

#include "math/config.h"

namespace tr {

enum class Kind {
    Texture,     // index of a texture
    Scalar,      // the same, of which one number is wanted: the luminance of its colour
    Spectrum,    // a small tensor: one number or a number a channel
    Float,       // a small tensor: one number
    Point,       // a small tensor: (3,)
    Transform,   // a small tensor: (4, 4)
    Transform2,  // a small tensor: (3, 3), acts on texture coordinates
    Tensor,      // a tensor of any size, used where it lies
    Indices,     // an int32 array (F, 3)
    Int,         // a static integer: switches, enumerations, names
    Bsdf,
    Emitter,
    Shape,
    Volume,  // index of a volume
    Phase,   // index of a phase function
    Medium   // index of a medium
};

constexpr double None = std::numeric_limits<double>::quiet_NaN();

struct Field {
    const char *name;
    Kind kind;
    double fallback;  // the default; None: must be given, or is given by Python
    double minimum, maximum;
    // "interior": the derivative is complete. "none: REASON": refused with this reason.
    const char *derivative;
    const char *doc;
};

struct Model {
    const char *category, *type, *doc;
    const Field *fields;
    int n_fields;
};

// A model in a scene: its index in the registry's list and one number a field (an index, an offset into the block of
// small parameters, or the number itself). What the host adds to a model of few fields begins at `Extra`.
struct Record {
    static constexpr int Fields = 31, Extra = 12, Stride = Fields + 1;
    int32_t kind;
    int32_t field[Fields];
};
constexpr int MaxLayers = 8;  // BSDFs around a BSDF
static_assert(sizeof(Record) == Record::Stride * sizeof(int32_t), "records are gathered with this stride");

}  // namespace tr
