// Outputs besides radiance: what is known of the first surface that the camera sees ("arbitrary output variables").
// They are functions of the camera's samples alone, the same that radiance is estimated from.
#pragma once

#include <array>

#include "../adjoint/outputs.h"
#include "bsdf_aovs.h"
#include "config.h"

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
    int offset[AovCount], channels[AovCount], n = 0;
    std::array<int32_t, AovAttributes> attributes{-1, -1, -1, -1};  // see AovOutput

    template <class Given>
    AovLayout(int colors, Given &&given) {
        for (int k = 0; k < AovCount; ++k) {
            channels[k] = aov_names[k].channels ? aov_names[k].channels : colors;
            offset[k] = given(k) ? n : -1;
            if (given(k)) n += count(k);
        }
    }
    TR_HD int count(int k) const { return channels[k]; }
    TR_HD bool wants(int k) const { return offset[k] >= 0; }
};

// What is asked, and of which camera.
template <class F>
struct AovContext {
    using S = ScalarOf<F>;
    const SceneView<S> &scene;
    const AovLayout &layout;
    const Record &sensor;
    CameraFrame<S> camera;
    S width, height;  // of the film

    TR_HD AovContext(const SceneView<S> &scene_, const AovLayout &layout_, uint32_t sensor_, S width_, S height_)
        : scene(scene_),
          layout(layout_),
          sensor(scene.sensors[sensor_]),
          camera(scene, sensor),
          width(width_),
          height(height_) {}
};

// The first hit of a camera ray, which begins at `first` after it came from `center`.
template <class F>
struct FirstHit {
    CameraSample<F> sample;
    Ray<F> ray;
    Vec3<F> first, center;
    Interaction<F> si;
    SampleColors<F> colors;
};

// The values of all channels of the layout.
template <class F>
TR_LARGE void eval_aovs(const AovContext<F> &c, const FirstHit<F> &hit, const MaskOf<F> &active, F *value);

// Their derivative: in reverse mode `value` holds the adjoints of the channels, in forward mode their derivatives are
// written there.
template <class F>
TR_LARGE void sweep_aovs(const AovContext<F> &c, const FirstHit<F> &hit, const GradientNeeds &needs,
                         const MaskOf<F> &active, F *value, GradientSink<F> &sink);

}  // namespace tr
