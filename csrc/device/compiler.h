// From a functor to machine code of a card: the translation unit around it, and the cache of what was compiled.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "kernel.h"
#include "kernel_cache.h"
#include "nvrtc.h"

namespace tr::cuda {

class KernelCompiler {
public:
    // `sources`: the folder that has core/ and device/; `packs`: where kernels may lie that were compiled before. Null:
    // there are no others than those and the cache's.
    KernelCompiler(const Nvrtc *nvrtc, std::string sources, KernelCache cache, std::vector<KernelCache> packs = {});

    // Code with the function `EntryPoint` for a card of this capability (90): its machine code, or where that is not
    // there and cannot be compiled PTX, which the driver compiles. `definitions`: of a scene. std::runtime_error if
    // there is neither.
    std::string for_card(const Kernel &kernel, int capability, const std::vector<std::string> &definitions = {}) const;
    // ... for an architecture as NVRTC names it: sm_90, or compute_80 for PTX.
    std::string code(const Kernel &kernel, const std::string &architecture,
                     const std::vector<std::string> &definitions = {}) const;

    // What the kernel itself takes of a card, besides functions that it calls: registers of a thread, bytes of its
    // stack and of what is spilled to it; and bytes of machine code and tables in all.
    struct Resources {
        size_t registers, stack, spilled, code;
    };
    Resources resources(const Kernel &kernel, int capability, const std::vector<std::string> &definitions = {}) const;

    static constexpr const char *EntryPoint = "tr_kernel";
    // A few lines: the header, a loop over the items, and that host and compiler agree on the size of the functor.
    static std::string unit(const Kernel &kernel);

private:
    const Nvrtc *nvrtc_;
    std::string sources_, fingerprint_;
    KernelCache cache_;
    std::vector<KernelCache> packs_;

    static std::vector<std::string> options(const Kernel &kernel, const std::string &architecture,
                                            const std::vector<std::string> &definitions);
    std::string key(const Kernel &kernel, const std::vector<std::string> &options) const;
    std::optional<std::string> find(const std::string &key) const;
};

}  // namespace tr::cuda
