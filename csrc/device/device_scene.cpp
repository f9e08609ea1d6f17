#include "device_scene.h"

#include <algorithm>
#include <atomic>
#include <cstring>

#include "host/parallel.h"

namespace tr {

namespace {

constexpr size_t Few = 1 << 18;  // bytes that are not worth a thread

bool equal(const char *a, const char *b, size_t bytes, int threads) {
    std::atomic<bool> same{true};
    for_ranges(
        bytes, threads,
        [&](size_t begin, size_t end, int) {
            constexpr size_t Part = 1 << 16;  // another range may have found a difference
            for (; begin < end && same; begin += Part)
                if (std::memcmp(a + begin, b + begin, std::min(Part, end - begin)) != 0) same = false;
        },
        Few);
    return same;
}

}  // namespace

template <class S>
template <class T>
T *DeviceScene<S>::put(Launcher &launcher, const T *from, size_t n, int threads) {
    if (n == 0) return nullptr;
    if (n_used_ == tables_.size()) tables_.emplace_back();
    Table &table = tables_[n_used_++];
    const size_t bytes = n * sizeof(T);
    const char *given = reinterpret_cast<const char *>(from);
    if (table.bytes != bytes || !equal(static_cast<const char *>(table.here.get()), given, bytes, threads)) {
        table.bytes = 0;  // until it is there
        table.there.reserve(launcher, bytes);
        auto *here = static_cast<char *>(table.here.reserve(launcher, bytes));
        for_ranges(
            bytes, threads,
            [&](size_t begin, size_t end, int) { std::memcpy(here + begin, given + begin, end - begin); }, Few);
        launcher.upload(table.there.get(), here, bytes);
        table.bytes = bytes;
    }
    return reinterpret_cast<T *>(table.there.get());
}

static_assert(sizeof(SceneView<float>) == 328, "a table more? SceneView and SceneData list them all");

template <class S>
const SceneView<S> &DeviceScene<S>::upload(Launcher &launcher, const SceneData<S> &data,
                                           const std::vector<uint8_t> &there, int threads) {
    const SceneView<S> &host = data.view();
    n_used_ = 0;
    view_ = host;
    view_.bends = nullptr;
    data.for_tables([&](auto member, auto *table, size_t n) { view_.*member = put(launcher, table, n, threads); });
    const std::vector<int64_t> &sizes = data.layout().slot_sizes;
    std::vector<TensorView<S>> tensors(host.values.tensors, host.values.tensors + sizes.size());
    copies_.resize(tensors.size());
    for (size_t i = 0; i < tensors.size(); ++i) {
        const auto n = size_t(sizes[i]);
        if (i >= there.size() || !there[i]) {
            tensors[i].data = put(launcher, tensors[i].data, n, threads);
        } else if (!launcher.reaches_tensors()) {
            copies_[i].take(launcher, tensors[i].data, n, true);
            tensors[i].data = copies_[i].get();
        }
    }
    view_.values.tensors = put(launcher, tensors.data(), tensors.size(), threads);
    view_.values.constants = put(launcher, host.values.constants, data.n_constants(), threads);
    return view_;
}

template class DeviceScene<float>;
template class DeviceScene<double>;

}  // namespace tr
