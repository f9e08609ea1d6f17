// Outputs besides radiance: what is known of the first surface that the camera sees (in computer graphics "arbitrary
// output variables"). They are functions of the camera's samples alone, the same that radiance is estimated from.
#pragma once

#include <array>
#include <cstring>

#include "render.h"

namespace tr {

enum AovKind {
    AovDepth,      // along the camera's axis
    AovDistance,   // from the camera
    AovRayLength,  // from the near plane, along the ray
    AovPosition,
    AovNormal,
    AovShadingNormal,
    AovNormalCamera,  // the same in the camera's frame
    AovShadingNormalCamera,
    AovUv,
    AovBarycentric,
    AovPartialU,  // of the position by the texture coordinates
    AovPartialV,
    AovAlbedo,
    AovSpecular,
    AovRoughness,
    AovAttribute,  // colours of meshes, see AovOutput::attributes
    AovCount = AovAttribute + 4
};
constexpr int AovAttributes = AovCount - AovAttribute;

struct AovName {
    const char *name;
    int channels;   // 0: those of a colour
    bool infinite;  // where nothing is hit; else zero
};
constexpr AovName aov_names[AovCount] = {
    {"depth", 1, true},
    {"distance", 1, true},
    {"ray_length", 1, true},
    {"position", 3, true},
    {"normal", 3, false},
    {"shading_normal", 3, false},
    {"normal_camera", 3, false},
    {"shading_normal_camera", 3, false},
    {"uv", 2, false},
    {"barycentric", 2, false},
    {"dp_du", 3, false},
    {"dp_dv", 3, false},
    {"albedo", 0, false},
    {"specular_reflectance", 0, false},
    {"roughness", 1, false},
    {"attribute_0", 0, false},
    {"attribute_1", 0, false},
    {"attribute_2", 0, false},
    {"attribute_3", 0, false},
};
constexpr int MaxAovChannels = 49;

// Which are wanted, and where each begins among the channels: -1 where it is not wanted.
struct AovLayout {
    int offset[AovCount], n = 0, colors;
    std::array<int32_t, AovAttributes> attributes{-1, -1, -1, -1};  // see AovOutput

    template <class Given>
    AovLayout(int colors_, Given &&given) : colors(colors_) {
        for (int k = 0; k < AovCount; ++k) {
            offset[k] = given(k) ? n : -1;
            if (given(k)) n += count(k);
        }
    }
    int count(int k) const { return aov_names[k].channels ? aov_names[k].channels : colors; }
    bool wants(int k) const { return offset[k] >= 0; }
};

// For every wanted pixel: tensors (n, channels) by kind, null where not wanted; identifiers (n), may be null.
template <class S>
struct AovOutput {
    std::array<S *, AovCount> data{};
    int32_t *shape = nullptr, *primitive = nullptr, *material = nullptr;
    std::array<int32_t, AovAttributes> attributes{-1, -1, -1, -1};  // numbers of their names
    std::vector<uint64_t> seeds;                                    // of each pass
    bool zero_at_misses = false;  // averages over all samples, zero where nothing is hit, in place of those that hit
};

template <class S, int C>
RenderStats render_aov(const RenderCall<S> &call, bool packets, const AovOutput<S> &out);
// out.data: derivatives of the loss with respect to the outputs, read only.
template <class S, int C>
RenderStats reverse_aov(const RenderCall<S> &call, bool packets, const AovOutput<S> &out,
                        DerivativeCall<S> &derivative);
// out.data: derivatives of the outputs along the tangent.
template <class S, int C>
RenderStats forward_aov(const RenderCall<S> &call, bool packets, const AovOutput<S> &out,
                        const DerivativeCall<S> &derivative);

}  // namespace tr
