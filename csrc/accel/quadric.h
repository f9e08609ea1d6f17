// Spheres and disks as Embree's user geometry: the functions that Embree calls for their bounds and for rays.
#pragma once

#include <cstdint>

#include "embree_api.h"

namespace tr {

// Where the unit sphere, or the unit disk in the plane z = 0, is in the world.
struct Quadric {
    bool sphere;
    uint32_t shape;
    double to_world[12], to_object[12];  // 3 rows of 4

    void bounds(rtc::Bounds &result) const;

    static void on_bounds(const rtc::BoundsFunctionArguments *arguments);
    static void on_intersect(const rtc::UserFunctionArguments *arguments);
    static void on_occluded(const rtc::UserFunctionArguments *arguments);
};

}  // namespace tr
