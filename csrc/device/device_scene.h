// The tables of a scene in a device's memory.
#pragma once

#include <vector>

#include "host/scene_data.h"
#include "launcher.h"

namespace tr {

template <class S>
class DeviceScene {
public:
    // Tables and parameters as they are now, of which those are copied that have changed since the last time, also
    // without a word; the view is of the device. Nothing of light that bends is copied. The device is done with what
    // was launched before. `there`, by slot or empty: parameters that lie on the device; it reads them where they lie,
    // or copies of them.
    const SceneView<S> &upload(Launcher &launcher, const SceneData<S> &data, const std::vector<uint8_t> &there,
                               int threads);

private:
    SceneView<S> view_{};
    struct Table {
        DeviceArray<uint8_t> there;
        HostBuffer here;  // the same
        size_t bytes = 0;
    };
    std::vector<Table> tables_;
    std::vector<DeviceArray<S>> copies_;  // by slot
    size_t n_used_ = 0;

    template <class T>
    T *put(Launcher &launcher, const T *from, size_t n, int threads);
};

}  // namespace tr
