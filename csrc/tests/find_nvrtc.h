// What tests compile kernels with, and from.
#pragma once

#include <cstdlib>
#include <memory>
#include <stdexcept>
#include <string>

#include "device/nvrtc.h"
#include "harness.h"

namespace tr::testing {

// NVRTC from $TORCHRENDER_NVRTC or the system; without one, what needs it is left out.
inline std::unique_ptr<cuda::Nvrtc> find_nvrtc() {
    const char *given = std::getenv("TORCHRENDER_NVRTC");
    for (const char *name : {given ? given : "libnvrtc.so.12", "libnvrtc.so.13"}) {
        try {
            return std::make_unique<cuda::Nvrtc>(name);
        } catch (const std::runtime_error &error) {
            if (given) throw;
        }
    }
    std::printf("  left out: there is no NVRTC, which TORCHRENDER_NVRTC names\n");
    return nullptr;
}

// The folder of core/ and device/.
inline std::string sources() {
    const std::string here = __FILE__;
    return here.substr(0, here.rfind("/tests/"));
}

}  // namespace tr::testing
