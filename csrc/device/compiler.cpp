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

constexpr int OldestCapability = 50;  // that NVRTC 12 knows

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

void add_folders(const std::string &sources, std::vector<std::string> &options) {
    options.push_back("-I" + sources);
    options.push_back("-I" + sources + "/device/shim");  // what NVRTC lacks of the standard library
}

// The number in front of `unit`, from `at` on in what the assembler says.
size_t number_before(const std::string &log, const char *unit, size_t at) {
    const size_t end = log.find(unit, at);
    if (at == std::string::npos || end == std::string::npos)
        throw std::runtime_error("NVRTC does not say what a kernel takes:\n" + log);
    size_t begin = end;
    while (begin > at && log[begin - 1] >= '0' && log[begin - 1] <= '9') --begin;
    return std::stoul(log.substr(begin, end - begin));
}

}  // namespace

KernelCompiler::KernelCompiler(const Nvrtc *nvrtc, std::string sources, KernelCache cache,
                               std::vector<KernelCache> packs)
    : nvrtc_(nvrtc),
      sources_(std::move(sources)),
      fingerprint_(fingerprint(sources_)),
      cache_(std::move(cache)),
      packs_(std::move(packs)) {}

std::string KernelCompiler::unit(const Kernel &kernel) {
    const std::string type = kernel.name;
    const std::string work =
        kernel.blocks ? "    __shared__ " + type +
                            "::Shared shared;\n"
                            "    for (unsigned i = blockIdx.x; i < n; i += gridDim.x)\n"
                            "        kernel(tr::Block<" +
                            type + "::Shared>{shared, i}, i);\n"
                      : "    for (unsigned i = blockIdx.x * blockDim.x + threadIdx.x; i < n; i += gridDim.x * "
                        "blockDim.x) kernel(i);\n";
    return "#include \"" + std::string(kernel.header) + "\"\nstatic_assert(sizeof(" + type +
           ") == " + std::to_string(kernel.size) + " && alignof(" + type + ") == " + std::to_string(kernel.alignment) +
           ", \"a functor is not what it is on the host\");\nextern \"C\" __global__ void " + EntryPoint +
           "(__grid_constant__ const " + type + " kernel, unsigned n) {\n" + work + "}\n";
}

// What traces rays and adds up has the host's rounding: products and sums one by one, so that hits are the same. Light
// is as good with products that are added unrounded, and quotients and roots whose last bit or two may differ. A
// default of the core's is host and device.
std::vector<std::string> KernelCompiler::options(const Kernel &kernel, const std::string &architecture,
                                                 const std::vector<std::string> &definitions) {
    std::vector<std::string> all{"-std=c++17", "-default-device", "-diag-suppress=20012", "-arch=" + architecture};
    if (knows_light(kernel.knows) && kernel.knows != Knowledge::Tracing)
        all.insert(all.end(), {"-fmad=true", "-prec-div=false", "-prec-sqrt=false"});
    else
        all.emplace_back("-fmad=false");
    all.insert(all.end(), definitions.begin(), definitions.end());
    return all;
}

// Not of the compiler: what one has made is as good where there is another, or none.
std::string KernelCompiler::key(const Kernel &kernel, const std::vector<std::string> &options) const {
    std::string all = fingerprint_ + '\n' + unit(kernel);
    for (const std::string &option : options) all += '\n' + option;
    return sha256(all);
}

std::optional<std::string> KernelCompiler::find(const std::string &key) const {
    for (const KernelCache &pack : packs_)
        if (std::optional<std::string> found = pack.find(key)) return found;
    return cache_.find(key);
}

std::string KernelCompiler::code(const Kernel &kernel, const std::string &architecture,
                                 const std::vector<std::string> &definitions) const {
    std::vector<std::string> all_options = options(kernel, architecture, definitions);
    const std::string own = key(kernel, all_options);
    if (std::optional<std::string> found = find(own)) return *found;
    if (!nvrtc_)
        throw std::runtime_error(std::string("there is no NVRTC to compile ") + kernel.name + " with, for " +
                                 architecture +
                                 ", and it was not compiled before: pip install nvidia-cuda-nvrtc-cu12, or name a "
                                 "folder that `python -m torchrender.cuda compile` (--double for float64) has made for "
                                 "this scene in TORCHRENDER_KERNELS");
    add_folders(sources_, all_options);
    std::string made = nvrtc_->compile(unit(kernel), all_options);
    cache_.put(own, made);
    return made;
}

std::string KernelCompiler::for_card(const Kernel &kernel, int capability,
                                     const std::vector<std::string> &definitions) const {
    const std::string architecture = "sm_" + std::to_string(capability);
    const auto found = [&](const std::string &of) { return find(key(kernel, options(kernel, of, definitions))); };
    const bool missing = !nvrtc_ && !found(architecture);
    for (int from = capability; missing && from >= OldestCapability; --from)
        if (std::optional<std::string> ptx = found("compute_" + std::to_string(from))) return *ptx;
    return code(kernel, architecture, definitions);
}

KernelCompiler::Resources KernelCompiler::resources(const Kernel &kernel, int capability,
                                                    const std::vector<std::string> &definitions) const {
    std::vector<std::string> all_options = options(kernel, "sm_" + std::to_string(capability), definitions);
    add_folders(sources_, all_options);
    all_options.emplace_back("--ptxas-options=-v");
    std::string log;
    const std::string made = nvrtc_->compile(unit(kernel), all_options, &log);
    const size_t entry = log.find(std::string("Function properties for ") + EntryPoint);
    const size_t spilled = number_before(log, " bytes spill stores", entry);
    return {number_before(log, " registers", entry), number_before(log, " bytes stack frame", entry), spilled,
            made.size()};
}

}  // namespace tr::cuda
