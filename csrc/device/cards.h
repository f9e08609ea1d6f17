// The cards of this process: its driver, and the compiler of its kernels.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "cuda_launcher.h"

namespace tr::cuda {

// What kernels are compiled with from now on: the path of NVRTC, or nothing; the folder that has core/ and device/;
// that where they are kept, if it is not the usual one; and those where they may lie already. std::runtime_error if
// that NVRTC cannot be used.
void use_compiler(const std::string &nvrtc, const std::string &sources, const std::string &into,
                  const std::vector<std::string> &packs);

// Where the memory of cards comes from that are made from now on.
void use_memory(const CardMemory &memory);

// A card, by its number. std::runtime_error with one sentence if there is none, or nothing to compile kernels with.
std::unique_ptr<Launcher> make_card(int ordinal);
// What only compiles, for cards of this capability (90), or into PTX for these and later ones.
std::unique_ptr<Launcher> make_compiling(int capability);
std::unique_ptr<Launcher> make_compiling_ptx(int capability);

}  // namespace tr::cuda
