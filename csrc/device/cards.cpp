#include "cards.h"

#include <map>
#include <mutex>
#include <stdexcept>
#include <tuple>
#include <utility>

#include "compiling_launcher.h"

namespace tr::cuda {

namespace {

struct Made {
    std::unique_ptr<const Nvrtc> nvrtc;
    const KernelCompiler compiler;

    Made(const std::string &path, const std::string &sources, const std::string &into,
         const std::vector<std::string> &packs)
        : nvrtc(path.empty() ? nullptr : std::make_unique<const Nvrtc>(path)),
          compiler(nvrtc.get(), sources, KernelCache(into.empty() ? default_kernel_folder() : into),
                   {packs.begin(), packs.end()}) {}
};

std::mutex mutex;
CardMemory memory;
const Made *made;  // the last one; none is ever taken down, since launchers may use it when the process ends

const KernelCompiler &compiler() {
    const std::lock_guard<std::mutex> lock(mutex);
    if (!made) throw std::runtime_error("no compiler of kernels was named");
    return made->compiler;
}

}  // namespace

void use_compiler(const std::string &nvrtc, const std::string &sources, const std::string &into,
                  const std::vector<std::string> &packs) {
    const std::lock_guard<std::mutex> lock(mutex);
    static std::map<std::tuple<std::string, std::string, std::string, std::vector<std::string>>, const Made *> all;
    const Made *&found = all[{nvrtc, sources, into, packs}];
    if (!found) found = new Made(nvrtc, sources, into, packs);
    made = found;
}

void use_memory(const CardMemory &from) {
    const std::lock_guard<std::mutex> lock(mutex);
    memory = from;
}

std::unique_ptr<Launcher> make_card(int ordinal) {
    const Api &api = find_driver();
    start(api);
    const KernelCompiler &made_by = compiler();
    const std::lock_guard<std::mutex> lock(mutex);
    return make_launcher(api, made_by, ordinal, memory);
}

std::unique_ptr<Launcher> make_compiling(int capability) {
    return make_compiling_launcher(&compiler, capability, false);
}

std::unique_ptr<Launcher> make_compiling_ptx(int capability) {
    return make_compiling_launcher(&compiler, capability, true);
}

}  // namespace tr::cuda
