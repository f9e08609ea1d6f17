// Kernels on a card, through the driver. Nobody has run this on one yet: tests have a driver of their own.
#pragma once

#include <memory>

#include "compiler.h"
#include "driver.h"
#include "launcher.h"

namespace tr::cuda {

// On the primary context of the card, which others (PyTorch) share, and on a stream of it. `api` and `compiler` have to
// live longer. std::runtime_error, with the kernel's name, for what the driver reports; errors of a launch come from
// what is called after it.
std::unique_ptr<Launcher> make_launcher(const Api &api, const KernelCompiler &compiler, int ordinal,
                                        Stream stream = nullptr);

}  // namespace tr::cuda
