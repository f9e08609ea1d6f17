// How a model declares itself. The declaration is the only list of a model's parameters and of what it is: packing,
// gradient buffers, checks of nesting, the Python classes, the documentation and the generic tests are made from it.
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
    Vector,      // the same, of what is not a place
    Transform,   // a small tensor: (4, 4)
    Transform2,  // a small tensor: (3, 3), acts on texture coordinates
    Tensor,      // a tensor of any size, used where it lies
    Indices,     // an int32 array (F, 3)
    Int,         // a static integer: a number, or one of the field's choices
    Bsdf,
    Emitter,
    Shape,
    Volume,  // index of a volume
    Phase,   // index of a phase function
    Medium   // index of a medium
};

constexpr double None = std::numeric_limits<double>::quiet_NaN();

// The names of an Int's values, from 0 on; null ends them.
using Choices = const char *const *;
inline constexpr const char *Boolean[] = {"false", "true", nullptr};
inline constexpr const char *WrapModes[] = {"repeat", "mirror", "clamp", nullptr};
inline constexpr const char *MicrofacetDistributions[] = {"beckmann", "ggx", nullptr};

struct Field {
    const char *name;
    Kind kind;
    double fallback;  // the default; None: must be given, or is given by Python
    double minimum, maximum;
    // "interior": the derivative is complete. "none: REASON": refused with this reason.
    const char *derivative;
    const char *doc;
    Choices choices = nullptr;
    uint32_t traits = 0;  // Optional; and flags of the model that hold only where this field is given
};

// What a model is, for all who treat models alike.
enum ModelFlags : uint32_t {
    // BSDFs
    HasSmoothLobes = 1 << 0,  // a part with a density
    HasDeltaLobes = 1 << 1,
    FollowsTangent = 1 << 2,   // its local x is along dp/du
    Transmits = 1 << 3,        // light may come out on the other side
    IsAsymmetric = 1 << 4,     // other values where importance is transported
    WrapsBsdfs = 1 << 5,       // resolved to one of those it contains, where a path meets it
    PerturbsNormals = 1 << 6,  // ... and turns the shading normal
    Disperses = 1 << 7,        // a texture turns its delta lobes, by wavelength
    ChoosesLobe = 1 << 14,     // samples take a number besides those of a direction
    // emitters
    IsEnvironment = 1 << 8,      // light from all around, which the camera sees
    IsInfinite = 1 << 9,         // from infinitely far away
    HasDeltaPosition = 1 << 10,  // from a point
    IsOnShape = 1 << 11,         // the light of a shape, whose index its records hold
    HasImageAspect = 1 << 13,    // the host adds the aspect of its image, a number at ImageAspect
    IsBeam = 1 << 12,            // in one direction from each point: neither sampled nor hit, but by light tracing
};

constexpr uint32_t Optional = 1u << 31;  // of a field: not there unless it is given, the default then counts

struct Model {
    const char *category, *type, *doc;
    const Field *fields;
    int n_fields;
    uint32_t flags = 0;
    const char *class_name = nullptr;  // of the Python class, where that is not the type in capitals

    constexpr bool is(uint32_t flag) const { return (flags & flag) != 0; }
};

// What a table of functions says of its model: the flags, and for the host the declaration.
struct ModelInfo {
    const Model *model = nullptr;
    uint32_t flags = 0;

    constexpr ModelInfo() = default;
    constexpr ModelInfo(const Model &declared) : model(TR_HOST_POINTER(&declared)), flags(declared.flags) {}
    constexpr bool is(uint32_t flag) const { return (flags & flag) != 0; }
};

// Fields by their names, when the program is compiled: a name that is not declared does not compile.
constexpr bool same_name(const char *a, const char *b) {
    for (; *a && *a == *b; ++a, ++b) {}
    return *a == *b;
}
template <int N>
constexpr int field_index(const Field (&fields)[N], const char *name) {
    int i = 0;
    while (!same_name(fields[i].name, name)) ++i;  // beyond the end is no constant expression
    return i;
}

// The same when the program runs; -1: there is none.
constexpr int field_named(const Model &model, const char *name) {
    for (int i = 0; i < model.n_fields; ++i)
        if (same_name(model.fields[i].name, name)) return i;
    return -1;
}

// A model in a scene: its index in the registry's list and one number a field (an index, an offset into the block of
// small parameters, or the number itself). What the host adds to a model of few fields begins at `Extra`.
struct Record {
    static constexpr int Fields = 31, Extra = 12, Stride = Fields + 1;
    int32_t kind;
    int32_t field[Fields];
};
constexpr int MaxBsdfDepth = 8;  // BSDFs around a BSDF
static_assert(sizeof(Record) == Record::Stride * sizeof(int32_t), "records are gathered with this stride");

}  // namespace tr
