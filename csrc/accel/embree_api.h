// The part of Embree 4's C interface that is used, declared by hand: the wheel that brings the library has no headers.
// Names, values and layouts are those of the Embree 4 API reference (https://github.com/RenderKit/embree, doc/src/api).
// embree_library.h loads the functions and checks, with rays at known triangles, that these declarations fit.
#pragma once

#include <sys/types.h>
#include <cstddef>
#include <cstdint>

namespace tr::rtc {

using Device = struct DeviceObject *;
using Scene = struct SceneObject *;
using Geometry = struct GeometryObject *;

constexpr uint32_t InvalidGeometry = 0xffffffffu;

enum Format : int {
    FormatUChar = 0x1001,
    FormatUInt = 0x5001,
    FormatUInt3 = 0x5003,
    FormatFloat3 = 0x9003,
    FormatFloat4 = 0x9004
};
enum GeometryType : int {
    GeometryTriangle = 0,
    GeometryRoundLinear = 16,
    GeometryRoundBSpline = 32,
    GeometryUser = 120
};
enum BufferType : int { BufferIndex = 0, BufferVertex = 1, BufferFlags = 32 };
enum CurveFlags : int { CurveNeighborLeft = 1, CurveNeighborRight = 2 };
enum BuildQuality : int { BuildLow = 0, BuildMedium = 1, BuildHigh = 2, BuildRefit = 3 };
enum SceneFlags : int { SceneDynamic = 1 };
enum Property : int {
    PropertyVersion = 0,  // major * 10000 + minor * 100 + patch
    PropertyNativeRay8 = 33,
    PropertyNativeRay16 = 34,
    PropertyFilters = 66,
    PropertyTriangles = 96,
    PropertyCurves = 99,
    PropertyUserGeometry = 100
};
enum QueryFlags : int { QueryIncoherent = 0, QueryCoherent = 1 << 16 };

// N rays, N = 1, 4, 8 or 16, a structure of arrays.
template <int N>
struct alignas(N == 1 ? 16 : 4 * N) Ray {
    float org_x[N], org_y[N], org_z[N], tnear[N];
    float dir_x[N], dir_y[N], dir_z[N], time[N];
    float tfar[N];  // set to the distance of the hit; by an occlusion query to -infinity
    uint32_t mask[N], id[N], flags[N];
};

template <int N>
struct alignas(N == 1 ? 16 : 4 * N) Hit {
    float normal_x[N], normal_y[N], normal_z[N];  // not normalised
    float u[N], v[N];                             // weights of the second and third vertex of a triangle
    uint32_t primitive[N], geometry[N], instance[N];
    uint32_t instance_primitive[N];  // in libraries built with instance arrays; otherwise never touched
};

template <int N>
struct RayHit {
    Ray<N> ray;
    Hit<N> hit;
};
static_assert(sizeof(Ray<1>) == 48 && sizeof(Ray<16>) == 12 * 64, "layout of the API reference");
static_assert(offsetof(Hit<16>, geometry) == 6 * 64 && offsetof(RayHit<4>, hit) == 12 * 16,
              "layout of the API reference");

struct alignas(16) Bounds {
    float lower[3], pad0, upper[3], pad1;
};

// rtcIntersectN and rtcOccludedN take the same structure
struct QueryArguments {
    int flags = QueryIncoherent;
    uint32_t features = 0xffffffffu;
    void *context = nullptr, *filter = nullptr, *user_geometry = nullptr;
    float min_width_distance_factor = 0;  // in libraries built with it; otherwise never read
};

struct BoundsFunctionArguments {
    void *user;
    uint32_t primitive, time_step;
    Bounds *bounds;
};

// Of an intersection callback, whose rays are followed by their hits (rays: 12 N numbers), and of an occlusion
// callback.
struct UserFunctionArguments {
    int *valid;  // -1: active
    void *user;
    uint32_t primitive;
    void *context;
    float *rays;
    uint32_t n, geometry;
};

// Of a hit that may be refused: `valid` becomes 0 then. Rays and hits lie as in Ray and Hit.
struct FilterFunctionArguments {
    int *valid;
    void *user, *context;
    const float *rays, *hits;
    uint32_t n;
};

using FilterFunction = void (*)(const FilterFunctionArguments *);
using BoundsFunction = void (*)(const BoundsFunctionArguments *);
using UserFunction = void (*)(const UserFunctionArguments *);
using ErrorFunction = void (*)(void *user, int code, const char *message);

// The functions, as members without the prefix `rtc`.
#define TR_EMBREE_FUNCTIONS(X)                                                                                \
    X(Device, NewDevice, (const char *config))                                                                \
    X(void, ReleaseDevice, (Device))                                                                          \
    X(ssize_t, GetDeviceProperty, (Device, int property))                                                     \
    X(int, GetDeviceError, (Device))                                                                          \
    X(void, SetDeviceErrorFunction, (Device, ErrorFunction, void *user))                                      \
    X(Scene, NewScene, (Device))                                                                              \
    X(void, ReleaseScene, (Scene))                                                                            \
    X(void, SetSceneBuildQuality, (Scene, int quality))                                                       \
    X(void, SetSceneFlags, (Scene, int flags))                                                                \
    X(void, CommitScene, (Scene))                                                                             \
    X(void, GetSceneBounds, (Scene, Bounds *))                                                                \
    X(void, AttachGeometryByID, (Scene, Geometry, uint32_t id))                                               \
    X(Geometry, NewGeometry, (Device, int type))                                                              \
    X(void, ReleaseGeometry, (Geometry))                                                                      \
    X(void, SetGeometryBuildQuality, (Geometry, int quality))                                                 \
    X(void, CommitGeometry, (Geometry))                                                                       \
    X(void *, SetNewGeometryBuffer, (Geometry, int type, uint32_t slot, int format, size_t stride, size_t n)) \
    X(void, UpdateGeometryBuffer, (Geometry, int type, uint32_t slot))                                        \
    X(void, SetGeometryUserPrimitiveCount, (Geometry, uint32_t))                                              \
    X(void, SetGeometryUserData, (Geometry, void *))                                                          \
    X(void, SetGeometryBoundsFunction, (Geometry, BoundsFunction, void *user))                                \
    X(void, SetGeometryIntersectFunction, (Geometry, UserFunction))                                           \
    X(void, SetGeometryOccludedFunction, (Geometry, UserFunction))                                            \
    X(void, SetGeometryIntersectFilterFunction, (Geometry, FilterFunction))                                   \
    X(void, SetGeometryOccludedFilterFunction, (Geometry, FilterFunction))                                    \
    X(void, Intersect1, (Scene, RayHit<1> *, QueryArguments *))                                               \
    X(void, Intersect4, (const int *valid, Scene, RayHit<4> *, QueryArguments *))                             \
    X(void, Intersect8, (const int *valid, Scene, RayHit<8> *, QueryArguments *))                             \
    X(void, Intersect16, (const int *valid, Scene, RayHit<16> *, QueryArguments *))                           \
    X(void, Occluded1, (Scene, Ray<1> *, QueryArguments *))                                                   \
    X(void, Occluded4, (const int *valid, Scene, Ray<4> *, QueryArguments *))                                 \
    X(void, Occluded8, (const int *valid, Scene, Ray<8> *, QueryArguments *))                                 \
    X(void, Occluded16, (const int *valid, Scene, Ray<16> *, QueryArguments *))

struct Api {
#define TR_DECLARE(result, name, arguments) result(*name) arguments = nullptr;
    TR_EMBREE_FUNCTIONS(TR_DECLARE)
#undef TR_DECLARE

    template <int N>
    void intersect(const int *valid, Scene scene, RayHit<N> &rays, QueryArguments &arguments) const {
        if constexpr (N == 16) Intersect16(valid, scene, &rays, &arguments);
        if constexpr (N == 8) Intersect8(valid, scene, &rays, &arguments);
        if constexpr (N == 4) Intersect4(valid, scene, &rays, &arguments);
        if constexpr (N == 1)
            if (valid[0]) Intersect1(scene, &rays, &arguments);
    }
    template <int N>
    void occluded(const int *valid, Scene scene, Ray<N> &rays, QueryArguments &arguments) const {
        if constexpr (N == 16) Occluded16(valid, scene, &rays, &arguments);
        if constexpr (N == 8) Occluded8(valid, scene, &rays, &arguments);
        if constexpr (N == 4) Occluded4(valid, scene, &rays, &arguments);
        if constexpr (N == 1)
            if (valid[0]) Occluded1(scene, &rays, &arguments);
    }
};

}  // namespace tr::rtc
