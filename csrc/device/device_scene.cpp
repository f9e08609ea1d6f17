#include "device_scene.h"

namespace tr {

template <class T>
T *DeviceScene::put(Launcher &launcher, const T *from, size_t n) {
    if (n == 0) return nullptr;
    if (n_used_ == memory_.size()) memory_.emplace_back();
    DeviceArray<uint8_t> &to = memory_[n_used_++];
    to.upload(launcher, reinterpret_cast<const uint8_t *>(from), n * sizeof(T));
    return reinterpret_cast<T *>(to.get());
}

static_assert(sizeof(SceneView<float>) == 320, "a table more? SceneView and SceneData list them all");

const SceneView<float> &DeviceScene::upload(Launcher &launcher, const SceneData<float> &data) {
    const SceneView<float> &host = data.view();
    n_used_ = 0;
    view_ = host;
    view_.bends = nullptr;
    data.for_tables([&](auto member, auto *table, size_t n) { view_.*member = put(launcher, table, n); });
    const std::vector<int64_t> &sizes = data.layout().slot_sizes;
    std::vector<TensorView<float>> tensors(host.values.tensors, host.values.tensors + sizes.size());
    for (size_t i = 0; i < tensors.size(); ++i) tensors[i].data = put(launcher, tensors[i].data, size_t(sizes[i]));
    view_.values.tensors = put(launcher, tensors.data(), tensors.size());
    view_.values.constants = put(launcher, host.values.constants, data.n_constants());
    return view_;
}

}  // namespace tr
