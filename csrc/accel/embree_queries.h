// Queries of Embree, as many rays at a time as a width says: 1, 4, 8 or 16. What is not finite hits nothing.
#pragma once

#include "accel.h"
#include "embree_library.h"

namespace tr {

void intersect_embree(const rtc::Api &api, rtc::Scene scene, int width, const RayBatch &rays, const HitBatch &hits,
                      size_t n, bool coherent);
void occluded_embree(const rtc::Api &api, rtc::Scene scene, int width, const RayBatch &rays, uint8_t *hit, size_t n);

}  // namespace tr
