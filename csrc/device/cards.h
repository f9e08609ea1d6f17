// The cards of this process: its driver, and the compiler of its kernels.
#pragma once

#include <memory>
#include <string>

#include "launcher.h"

namespace tr::cuda {

// What kernels are compiled with from now on: the path of NVRTC, and the folder that has core/ and device/.
// std::runtime_error if that NVRTC cannot be used.
void use_compiler(const std::string &nvrtc, const std::string &sources);

// A card, by its number. std::runtime_error with one sentence if there is none, or nothing to compile kernels with.
std::unique_ptr<Launcher> make_card(int ordinal);

}  // namespace tr::cuda
