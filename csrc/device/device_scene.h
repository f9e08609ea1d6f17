// The tables of a scene in a device's memory.
#pragma once

#include <vector>

#include "host/scene_data.h"
#include "launcher.h"

namespace tr {

class DeviceScene {
public:
    // Copies all tables and parameters there, as they are now; the view is of the device. Nothing of light that bends
    // is copied.
    const SceneView<float> &upload(Launcher &launcher, const SceneData<float> &data);

private:
    SceneView<float> view_{};
    std::vector<DeviceArray<uint8_t>> memory_;
    size_t n_used_ = 0;

    template <class T>
    T *put(Launcher &launcher, const T *from, size_t n);
};

}  // namespace tr
