#include "compiler.h"

#include <dirent.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <utility>

#include "sha256.h"

namespace tr::cuda {

namespace {

std::string content(const std::string &path) {
    std::ifstream file(path, std::ios::binary);
    if (!file) throw std::runtime_error("the source of a kernel cannot be read: " + path);
    return {std::istreambuf_iterator<char>(file), {}};
}

// Paths of the files below a folder, sorted.
std::vector<std::string> files_below(const std::string &folder) {
    std::vector<std::string> names, paths;
    DIR *opened = opendir(folder.c_str());
    if (!opened) return {folder};
    while (const dirent *found = readdir(opened))
        if (found->d_name[0] != '.') names.emplace_back(found->d_name);
    closedir(opened);
    std::sort(names.begin(), names.end());
    for (const std::string &name : names)
        for (std::string &path : files_below(std::string(folder).append("/").append(name)))
            paths.push_back(std::move(path));
    return paths;
}

// Of everything that a kernel may include.
std::string fingerprint(const std::string &sources) {
    std::string all;
    for (const char *folder : {"core", "device"})
        for (const std::string &path : files_below(sources + "/" + folder)) {
            all.append(path, sources.size()).append(1, '\n');
            all.append(sha256(content(path))).append(1, '\n');
        }
    return sha256(all);
}

}  // namespace

KernelCompiler::KernelCompiler(const Nvrtc &nvrtc, std::string sources, KernelCache cache)
    : nvrtc_(nvrtc), sources_(std::move(sources)), fingerprint_(fingerprint(sources_)), cache_(std::move(cache)) {}

std::string KernelCompiler::unit(const Kernel &kernel) {
    const std::string type = kernel.name;
    return "#include \"" + std::string(kernel.header) + "\"\nstatic_assert(sizeof(" + type +
           ") == " + std::to_string(kernel.size) + " && alignof(" + type + ") == " + std::to_string(kernel.alignment) +
           ", \"a functor is not what it is on the host\");\nextern \"C\" __global__ void " + EntryPoint +
           "(__grid_constant__ const " + type +
           " kernel, unsigned n) {\n"
           "    for (unsigned i = blockIdx.x * blockDim.x + threadIdx.x; i < n; i += gridDim.x * blockDim.x) "
           "kernel(i);\n}\n";
}

std::string KernelCompiler::cubin(const Kernel &kernel, int capability) const {
    // Products and sums round one by one, as on the host: hits are to be the same.
    std::vector<std::string> options = {"-std=c++17", "-default-device", "-fmad=false",
                                        "-arch=sm_" + std::to_string(capability)};
    const std::string source = unit(kernel);
    std::string all = nvrtc_.version() + '\n' + fingerprint_ + '\n' + source;
    for (const std::string &option : options) all += '\n' + option;
    const std::string key = sha256(all);
    if (std::optional<std::string> found = cache_.find(key)) return *found;
    options.push_back("-I" + sources_);
    options.push_back("-I" + sources_ + "/device/shim");  // what NVRTC lacks of the standard library
    std::string made = nvrtc_.compile(source, options);
    cache_.put(key, made);
    return made;
}

}  // namespace tr::cuda
