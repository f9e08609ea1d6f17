#include "nvrtc.h"

#include <dlfcn.h>

#include <algorithm>
#include <stdexcept>

namespace tr::cuda {

using Program = struct ProgramObject *;

// Functions return 0 or an error. Declared by hand from NVIDIA's documentation.
#define TR_NVRTC_FUNCTIONS(X)                                                                                     \
    X(Version, (int *major, int *minor))                                                                          \
    X(CreateProgram,                                                                                              \
      (Program * program, const char *source, const char *name, int n, const char **headers, const char **names)) \
    X(CompileProgram, (Program program, int n, const char **options))                                             \
    X(GetProgramLogSize, (Program program, size_t *size))                                                         \
    X(GetProgramLog, (Program program, char *log))                                                                \
    X(GetCUBINSize, (Program program, size_t *size))                                                              \
    X(GetCUBIN, (Program program, char *cubin))                                                                   \
    X(GetPTXSize, (Program program, size_t *size))                                                                \
    X(GetPTX, (Program program, char *ptx))                                                                       \
    X(DestroyProgram, (Program * program))

struct Nvrtc::Api {
#define TR_DECLARE(name, arguments) int(*name) arguments = nullptr;
    TR_NVRTC_FUNCTIONS(TR_DECLARE)
#undef TR_DECLARE
};

Nvrtc::Nvrtc(const std::string &path) : api_(std::make_unique<Api>()) {
    // It stays loaded: it has threads and memory of its own.
    void *handle = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (!handle) {
        const char *why = dlerror();
        throw std::runtime_error("NVRTC at " + path + " cannot be loaded (" + (why ? why : "unknown reason") + ")");
    }
    const char *missing = nullptr;
#define TR_RESOLVE(name, arguments)                                                    \
    api_->name = reinterpret_cast<decltype(api_->name)>(dlsym(handle, "nvrtc" #name)); \
    if (!api_->name && !missing) missing = "nvrtc" #name;
    TR_NVRTC_FUNCTIONS(TR_RESOLVE)
#undef TR_RESOLVE
    if (missing)
        throw std::runtime_error("NVRTC at " + path + " has no function " + missing +
                                 "; version 12.0 or newer is needed");
    int major = 0, minor = 0;
    api_->Version(&major, &minor);
    version_ = std::to_string(major) + "." + std::to_string(minor);
    // A part of it that it opens by name when it compiles, and not everywhere finds beside itself.
    if (const size_t slash = path.rfind('/'); slash != std::string::npos)
        dlopen((path.substr(0, slash + 1) + "libnvrtc-builtins.so." + version_).c_str(), RTLD_NOW | RTLD_LOCAL);
    if (major < 12)
        throw std::runtime_error("NVRTC at " + path + " is version " + version_ + ", expected at least 12.0");
}

Nvrtc::~Nvrtc() = default;

std::string Nvrtc::compile(const std::string &source, const std::vector<std::string> &options, std::string *log) const {
    struct Made {
        const Api &api;
        Program program = nullptr;
        ~Made() {
            if (program) api.DestroyProgram(&program);
        }
    } made{*api_};
    if (api_->CreateProgram(&made.program, source.c_str(), "kernel.cu", 0, nullptr, nullptr) != 0)
        throw std::runtime_error("NVRTC cannot make a program");
    std::vector<const char *> words;
    words.reserve(options.size());
    for (const std::string &option : options) words.push_back(option.c_str());
    const int failed = api_->CompileProgram(made.program, int(words.size()), words.data());
    size_t size = 0;
    std::string said;
    if (api_->GetProgramLogSize(made.program, &size) == 0 && size > 1) {
        said.resize(size);
        api_->GetProgramLog(made.program, said.data());
        said.pop_back();  // the zero at its end
    }
    if (failed != 0) throw std::runtime_error("NVRTC " + version_ + " cannot compile a kernel:\n" + said);
    if (log) *log = said;
    const bool ptx = std::any_of(options.begin(), options.end(),
                                 [](const std::string &option) { return option.rfind("-arch=compute_", 0) == 0; });
    if ((ptx ? api_->GetPTXSize : api_->GetCUBINSize)(made.program, &size) != 0 || size == 0)
        throw std::runtime_error("NVRTC " + version_ +
                                 " gives no machine code; -arch has to name an architecture, such as sm_90");
    std::string code(size, '\0');
    (ptx ? api_->GetPTX : api_->GetCUBIN)(made.program, code.data());
    return code;
}

}  // namespace tr::cuda
