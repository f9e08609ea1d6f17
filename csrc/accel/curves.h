// Curves in Embree: tubes along B-splines, and cones between spheres.
#pragma once

#include <cstddef>

#include "embree_library.h"

namespace tr {

struct Curve {
    rtc::Geometry geometry = nullptr;
    float *points = nullptr;  // Embree's buffers: (n_points, 4) with radii, the first point of each segment
    uint32_t *segments = nullptr;
    size_t n_points = 0, n_segments = 0;
    bool straight = false;
};

// Rays meet it from outside only: what starts within leaves it unseen, as light that a fibre's BSDF lets through.
Curve new_curve(const EmbreeDevice &device, size_t n_points, const uint32_t *segments, size_t n_segments,
                bool straight);

// With other points, if it was committed before.
void set_curve_points(const EmbreeDevice &device, Curve &curve, const float *points);

}  // namespace tr
