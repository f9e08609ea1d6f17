#include "driver.h"

#include <dlfcn.h>

#include <new>
#include <stdexcept>

namespace tr::cuda {

namespace {

// Kernels are compiled by NVRTC 12 for the card itself, which drivers since 525 run (minor-version compatibility).
constexpr int OldestVersion = 12000;

Api resolve() {
    void *handle = dlopen("libcuda.so.1", RTLD_NOW | RTLD_LOCAL);
    if (!handle)
        throw std::runtime_error(
            "there is no NVIDIA driver: libcuda.so.1 was not found; install NVIDIA's driver, and "
            "in a container ask for the card (docker run --gpus all)");
    Api api;
    const char *missing = nullptr;
#define TR_RESOLVE(name, symbol, arguments)                                 \
    api.name = reinterpret_cast<decltype(api.name)>(dlsym(handle, symbol)); \
    if (!api.name && !missing) missing = symbol;
    TR_CUDA_FUNCTIONS(TR_RESOLVE)
#undef TR_RESOLVE
    if (missing)
        throw std::runtime_error("the NVIDIA driver has no function " + std::string(missing) +
                                 "; install driver 525 or newer");
    check_version(api);
    return api;
}

}  // namespace

const Api &find_driver() {
    static const Api api = resolve();  // tried again after an error
    return api;
}

void check_version(const Api &api) {
    int version = 0;
    if (api.DriverGetVersion(&version) == Success && version < OldestVersion)
        throw std::runtime_error("the NVIDIA driver is made for CUDA " + driver_version(api) +
                                 ", expected at least 12.0; install driver 525 or newer");
}

void start(const Api &api) {
    int count = 0;
    const Result started = api.Init(0);
    if (started != NoDevice) check(api, started, "starting the NVIDIA driver");
    if (started == NoDevice || api.DeviceGetCount(&count) != Success || count == 0)
        throw std::runtime_error("the NVIDIA driver finds no card; see what nvidia-smi and CUDA_VISIBLE_DEVICES say");
}

void check(const Api &api, Result result, const std::string &doing) {
    if (result == Success) return;
    if (result == OutOfMemory) throw std::bad_alloc();
    const char *name = nullptr, *text = nullptr;
    api.GetErrorName(result, &name);
    api.GetErrorString(result, &text);
    throw std::runtime_error("CUDA reported an error while " + doing + ": " + (text ? text : "unknown") + " (" +
                             (name ? name : "error " + std::to_string(result)) + ")");
}

std::string driver_version(const Api &api) {
    int version = 0;
    api.DriverGetVersion(&version);
    return std::to_string(version / 1000) + "." + std::to_string(version % 1000 / 10);
}

Card card(const Api &api, int ordinal) {
    Device device = 0;
    char name[256] = "";
    check(api, api.DeviceGet(&device, ordinal), "looking for card " + std::to_string(ordinal));
    check(api, api.DeviceGetName(name, int(sizeof name), device), "asking for a card's name");
    auto attribute = [&](Attribute which) {
        int value = 0;
        check(api, api.DeviceGetAttribute(&value, which, device), "asking for a card's attributes");
        return value;
    };
    return {name, 10 * attribute(ComputeCapabilityMajor) + attribute(ComputeCapabilityMinor),
            attribute(MultiprocessorCount)};
}

}  // namespace tr::cuda
