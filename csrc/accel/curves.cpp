#include "curves.h"

#include <cstring>
#include <stdexcept>

#include "embree_api.h"

namespace tr {

namespace {

void keep_outside(const rtc::FilterFunctionArguments *arguments) {
    const uint32_t n = arguments->n;
    const float *directions = arguments->rays + 4 * n, *normals = arguments->hits;
    for (uint32_t i = 0; i < n; ++i) {
        float cosine = 0;
        for (uint32_t k = 0; k < 3; ++k) cosine += directions[k * n + i] * normals[k * n + i];
        if (arguments->valid[i] != 0 && cosine > 0) arguments->valid[i] = 0;
    }
}

// Which ends of a straight segment another one goes on from; those are joined, the others closed.
void join(const uint32_t *segments, size_t n, uint8_t *flags) {
    for (size_t k = 0; k < n; ++k) {
        bool left = k > 0 && segments[k - 1] + 1 == segments[k],
             right = k + 1 < n && segments[k] + 1 == segments[k + 1];
        flags[k] = uint8_t((left ? rtc::CurveNeighborLeft : 0) | (right ? rtc::CurveNeighborRight : 0));
    }
}

}  // namespace

Curve new_curve(const EmbreeDevice &device, size_t n_points, const uint32_t *segments, size_t n_segments,
                bool straight) {
    const rtc::Api &api = device.api;
    Curve curve;
    curve.n_points = n_points;
    curve.n_segments = n_segments;
    curve.straight = straight;
    curve.geometry = api.NewGeometry(device.handle, straight ? rtc::GeometryRoundLinear : rtc::GeometryRoundBSpline);
    uint8_t *flags = nullptr;
    if (curve.geometry) {
        curve.points = static_cast<float *>(
            api.SetNewGeometryBuffer(curve.geometry, rtc::BufferVertex, 0, rtc::FormatFloat4, 16, n_points));
        curve.segments = static_cast<uint32_t *>(
            api.SetNewGeometryBuffer(curve.geometry, rtc::BufferIndex, 0, rtc::FormatUInt, 4, n_segments));
        if (straight)
            flags = static_cast<uint8_t *>(
                api.SetNewGeometryBuffer(curve.geometry, rtc::BufferFlags, 0, rtc::FormatUChar, 1, n_segments));
    }
    if (!curve.points || !curve.segments || (straight && !flags)) {
        if (curve.geometry) api.ReleaseGeometry(curve.geometry);
        device.check("while making a curve");
        throw std::runtime_error("Embree has no memory for a curve");
    }
    std::memcpy(curve.segments, segments, n_segments * 4);
    if (straight) join(segments, n_segments, flags);
    api.SetGeometryIntersectFilterFunction(curve.geometry, keep_outside);
    api.SetGeometryOccludedFilterFunction(curve.geometry, keep_outside);
    return curve;
}

void set_curve_points(const EmbreeDevice &device, Curve &curve, const float *points) {
    std::memcpy(curve.points, points, curve.n_points * 16);
    device.api.UpdateGeometryBuffer(curve.geometry, rtc::BufferVertex, 0);
    device.api.CommitGeometry(curve.geometry);
    device.check("while setting a curve");
}

}  // namespace tr
