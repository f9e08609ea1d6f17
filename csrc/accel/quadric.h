// Spheres, disks and cylinders as Embree's user geometry: the functions that Embree calls for their bounds and for
// rays.
#pragma once

#include <cstdint>

#include "accel.h"
#include "embree_api.h"

namespace tr {

// Where a unit shape is in the world.
struct Quadric {
    QuadricKind kind;
    uint32_t shape;
    double to_world[12], to_object[12];  // 3 rows of 4

    void bounds(rtc::Bounds &result) const;

    static void on_bounds(const rtc::BoundsFunctionArguments *arguments);
    static void on_intersect(const rtc::UserFunctionArguments *arguments);
    static void on_occluded(const rtc::UserFunctionArguments *arguments);
};

}  // namespace tr
