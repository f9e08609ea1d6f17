// The part of CUDA's driver interface that is used, declared by hand from NVIDIA's documentation: no header of CUDA is
// needed to compile, and the library is loaded when a device is first asked for.
#pragma once

#include <cstddef>
#include <cstdint>

namespace tr::cuda {

using Result = int;  // 0: success
using Device = int;
using DevicePointer = unsigned long long;
using Context = struct ContextObject *;
using Module = struct ModuleObject *;
using Function = struct FunctionObject *;
using Stream = struct StreamObject *;  // null: the default stream

enum Attribute { MultiprocessorCount = 16, ComputeCapabilityMajor = 75, ComputeCapabilityMinor = 76 };
enum Code { Success = 0, OutOfMemory = 2, NoDevice = 100 };

// name, symbol, arguments; all return a Result
#define TR_CUDA_FUNCTIONS(X)                                                                                        \
    X(Init, "cuInit", (unsigned flags))                                                                             \
    X(DriverGetVersion, "cuDriverGetVersion", (int *version))                                                       \
    X(GetErrorName, "cuGetErrorName", (Result error, const char **name))                                            \
    X(GetErrorString, "cuGetErrorString", (Result error, const char **text))                                        \
    X(DeviceGetCount, "cuDeviceGetCount", (int *count))                                                             \
    X(DeviceGet, "cuDeviceGet", (Device * device, int ordinal))                                                     \
    X(DeviceGetName, "cuDeviceGetName", (char *name, int length, Device device))                                    \
    X(DeviceGetAttribute, "cuDeviceGetAttribute", (int *value, Attribute attribute, Device device))                 \
    X(DevicePrimaryCtxRetain, "cuDevicePrimaryCtxRetain", (Context * context, Device device))                       \
    X(DevicePrimaryCtxRelease, "cuDevicePrimaryCtxRelease_v2", (Device device))                                     \
    X(CtxPushCurrent, "cuCtxPushCurrent_v2", (Context context))                                                     \
    X(CtxPopCurrent, "cuCtxPopCurrent_v2", (Context * context))                                                     \
    X(ModuleLoadData, "cuModuleLoadData", (Module * module, const void *image))                                     \
    X(ModuleUnload, "cuModuleUnload", (Module module))                                                              \
    X(ModuleGetFunction, "cuModuleGetFunction", (Function * function, Module module, const char *name))             \
    X(MemAlloc, "cuMemAlloc_v2", (DevicePointer * memory, size_t bytes))                                            \
    X(MemFree, "cuMemFree_v2", (DevicePointer memory))                                                              \
    X(MemHostAlloc, "cuMemHostAlloc", (void **memory, size_t bytes, unsigned flags))                                \
    X(MemFreeHost, "cuMemFreeHost", (void *memory))                                                                 \
    X(MemcpyHtoDAsync, "cuMemcpyHtoDAsync_v2", (DevicePointer to, const void *from, size_t bytes, Stream stream))   \
    X(MemcpyDtoHAsync, "cuMemcpyDtoHAsync_v2", (void *to, DevicePointer from, size_t bytes, Stream stream))         \
    X(MemcpyDtoDAsync, "cuMemcpyDtoDAsync_v2", (DevicePointer to, DevicePointer from, size_t bytes, Stream stream)) \
    X(StreamSynchronize, "cuStreamSynchronize", (Stream stream))                                                    \
    X(LaunchKernel, "cuLaunchKernel",                                                                               \
      (Function function, unsigned grid_x, unsigned grid_y, unsigned grid_z, unsigned block_x, unsigned block_y,    \
       unsigned block_z, unsigned shared_bytes, Stream stream, void **parameters, void **extra))

struct Api {
#define TR_DECLARE(name, symbol, arguments) Result(*name) arguments = nullptr;
    TR_CUDA_FUNCTIONS(TR_DECLARE)
#undef TR_DECLARE
};

}  // namespace tr::cuda
