// Rays that bend, as Python asks for them.
#pragma once

#include "accel/accel.h"
#include "core/scene.h"
#include "native_scene.h"

namespace tr {

// Scene and rays are needed by `trace` alone. std::out_of_range for a number or an array that is not there.
template <class S>
void bend(const SceneView<S> *scene, const Accel *accel, const BendRequest &request);

}  // namespace tr
