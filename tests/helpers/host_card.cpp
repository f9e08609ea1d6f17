// A card that is the host: CUDA's driver and its compiler, as torchrender asks for them. The host's compiler makes kernels
// of a scene's facts, which are constants in them as they are on cards, and not on the emulated device. "Machine code" is
// the path of a shared library, and a launch runs its items one after the other. TORCHRENDER_HOST_CARD names the folder of
// these libraries.
#include <dlfcn.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <string>

namespace {

// Words of device code that the host's compiler does not know, and the one thread that there is.
constexpr const char *Words =
    "#define __CUDACC_RTC__ 1\n"
    "#define __CUDACC__ 1\n"
    "#define __host__\n"
    "#define __device__\n"
    "#define __global__\n"
    "#define __shared__\n"
    "#define __grid_constant__\n"
    "#define __forceinline__ inline\n"
    "#define __noinline__\n"
    "static constexpr struct { unsigned x; } blockIdx{0}, threadIdx{0}, blockDim{1}, gridDim{1};\n";

struct Program {
    std::string source, log, made;
};
using Launch = void(void **);


std::string content(const std::string &path) {
    std::ifstream file(path);
    return {std::istreambuf_iterator<char>(file), {}};
}

}  // namespace

extern "C" {

// ------------------------------------------------------------------------------------------------------- the compiler
int nvrtcVersion(int *major, int *minor) { return *major = 13, *minor = 0, 0; }
int nvrtcCreateProgram(Program **p, const char *source, const char *, int, const char **, const char **) {
    return *p = new Program{source, "", ""}, 0;
}
int nvrtcDestroyProgram(Program **p) { return delete *p, 0; }
int nvrtcCompileProgram(Program *p, int n, const char **options) {
    static std::atomic<int> number{0};
    const std::string folder = std::getenv("TORCHRENDER_HOST_CARD"),
                      name = folder + "/kernel_" + std::to_string(getpid()) + "_" + std::to_string(number++);
    const size_t begin = p->source.find("sizeof(") + 7;
    const std::string type = p->source.substr(begin, p->source.find(')', begin) - begin);
    std::ofstream(name + ".cpp") << Words << p->source
                                 << "extern \"C\" __attribute__((visibility(\"default\"))) void tr_launch(void **given) {\n"
                                    "    tr_kernel(*static_cast<const "
                                 << type << " *>(given[0]), *static_cast<unsigned *>(given[1]));\n}\n";
    // Nothing of one kernel is another's, and products are not added unrounded.
    std::string command = "c++ -w -std=c++17 -O0 -ffp-contract=off -shared -fPIC -fvisibility=hidden";
    for (int i = 0; i < n; ++i) {
        const std::string option = options[i];
        const bool shim = option.size() > 5 && option.compare(option.size() - 5, 5, "/shim") == 0;
        if ((option.rfind("-D", 0) == 0 || option.rfind("-I", 0) == 0) && !shim) command += " '" + option + "'";
    }
    command += " -o " + name + ".so " + name + ".cpp 2> " + name + ".log";
    const int failed = std::system(command.c_str());
    p->log = failed != 0 ? content(name + ".log") : "", p->made = name + ".so";
    return failed != 0;
}
int nvrtcGetProgramLogSize(Program *p, size_t *size) { return *size = p->log.size() + 1, 0; }
int nvrtcGetProgramLog(Program *p, char *log) { return std::memcpy(log, p->log.c_str(), p->log.size() + 1), 0; }
int nvrtcGetCUBINSize(Program *p, size_t *size) { return *size = p->made.size() + 1, 0; }
int nvrtcGetCUBIN(Program *p, char *to) { return std::memcpy(to, p->made.c_str(), p->made.size() + 1), 0; }
int nvrtcGetPTXSize(Program *, size_t *size) { return *size = 0, 0; }
int nvrtcGetPTX(Program *, char *) { return 1; }

// --------------------------------------------------------------------------------------------------------- the driver
int cuInit(unsigned) { return 0; }
int cuDriverGetVersion(int *version) { return *version = 13000, 0; }
int cuGetErrorName(int, const char **name) { return *name = "CUDA_ERROR_OF_THE_HOST", 0; }
int cuGetErrorString(int, const char **text) { return *text = dlerror(), 0; }
int cuDeviceGetCount(int *count) { return *count = 1, 0; }
int cuDeviceGet(int *device, int) { return *device = 0, 0; }
int cuDeviceGetName(char *name, int length, int) { return std::strncpy(name, "the host", size_t(length)), 0; }
int cuDeviceGetAttribute(int *value, int which, int) { return *value = which == 75 ? 9 : which == 76 ? 0 : 2, 0; }
int cuDevicePrimaryCtxRetain(void **context, int) { return *context = nullptr, 0; }
int cuDevicePrimaryCtxRelease_v2(int) { return 0; }
int cuCtxPushCurrent_v2(void *) { return 0; }
int cuCtxPopCurrent_v2(void **) { return 0; }
int cuModuleLoadData(void **module, const void *image) {
    *module = dlopen(static_cast<const char *>(image), RTLD_LAZY | RTLD_LOCAL);  // what constants have made unreachable is not there
    return *module ? 0 : 1;
}
int cuModuleUnload(void *module) { return dlclose(module); }
int cuModuleGetFunction(void **function, void *module, const char *) {
    *function = dlsym(module, "tr_launch");
    return *function ? 0 : 1;
}
int cuMemAlloc_v2(unsigned long long *memory, size_t bytes) {
    void *const found = std::aligned_alloc(256, (bytes + 255) / 256 * 256);
    if (found) std::memset(found, 0xFF, bytes);  // NaN, where somebody reads what nobody has written
    *memory = reinterpret_cast<unsigned long long>(found);
    return found ? 0 : 2;
}
int cuMemFree_v2(unsigned long long memory) { return std::free(reinterpret_cast<void *>(memory)), 0; }
int cuMemHostAlloc(void **memory, size_t bytes, unsigned) { return *memory = std::malloc(bytes), 0; }
int cuMemFreeHost(void *memory) { return std::free(memory), 0; }
int cuMemcpyHtoDAsync_v2(unsigned long long to, const void *from, size_t bytes, void *) {
    return std::memcpy(reinterpret_cast<void *>(to), from, bytes), 0;
}
int cuMemcpyDtoHAsync_v2(void *to, unsigned long long from, size_t bytes, void *) {
    return std::memcpy(to, reinterpret_cast<void *>(from), bytes), 0;
}
int cuMemcpyDtoDAsync_v2(unsigned long long to, unsigned long long from, size_t bytes, void *) {
    return std::memcpy(reinterpret_cast<void *>(to), reinterpret_cast<void *>(from), bytes), 0;
}
int cuStreamSynchronize(void *) { return 0; }
int cuLaunchKernel(void *function, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned, void *,
                   void **parameters, void **) {
    reinterpret_cast<Launch *>(function)(parameters);
    return 0;
}
}
