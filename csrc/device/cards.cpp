#include "cards.h"

#include <map>
#include <mutex>
#include <stdexcept>
#include <utility>

#include "cuda_launcher.h"

namespace tr::cuda {

namespace {

struct Made {
    const Nvrtc nvrtc;
    const KernelCompiler compiler;

    Made(const std::string &path, const std::string &sources)
        : nvrtc(path), compiler(nvrtc, sources, KernelCache(default_kernel_folder())) {}
};

std::mutex mutex;
const Made *made;  // the last one; none is ever taken down, since launchers may use it when the process ends

}  // namespace

void use_compiler(const std::string &nvrtc, const std::string &sources) {
    const std::lock_guard<std::mutex> lock(mutex);
    static std::map<std::pair<std::string, std::string>, const Made *> all;
    const Made *&found = all[{nvrtc, sources}];
    if (!found) found = new Made(nvrtc, sources);
    made = found;
}

std::unique_ptr<Launcher> make_card(int ordinal) {
    const Api &api = find_driver();
    start(api);
    const std::lock_guard<std::mutex> lock(mutex);
    if (!made) throw std::runtime_error("no compiler of kernels was named");
    return make_launcher(api, made->compiler, ordinal);
}

}  // namespace tr::cuda
