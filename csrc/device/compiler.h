// From a functor to machine code of a card: the translation unit around it, and the cache of what was compiled.
#pragma once

#include <string>
#include <vector>

#include "kernel.h"
#include "kernel_cache.h"
#include "nvrtc.h"

namespace tr::cuda {

class KernelCompiler {
public:
    // `sources`: the folder that has core/ and device/.
    KernelCompiler(const Nvrtc &nvrtc, std::string sources, KernelCache cache);

    // Machine code with the function `EntryPoint`, for a card of this capability (90).
    std::string cubin(const Kernel &kernel, int capability) const;

    static constexpr const char *EntryPoint = "tr_kernel";
    // A few lines: the header, a loop over the items, and that host and compiler agree on the size of the functor.
    static std::string unit(const Kernel &kernel);

private:
    const Nvrtc &nvrtc_;
    std::string sources_, fingerprint_;
    KernelCache cache_;
};

}  // namespace tr::cuda
