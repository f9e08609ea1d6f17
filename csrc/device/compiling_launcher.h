// A device that only compiles: what is launched on it is put into the compiler's cache for cards of a capability, and
// does nothing; whatever is read back is zero. So kernels are made ahead of time, where there is no card.
#pragma once

#include <memory>

#include "compiler.h"
#include "launcher.h"

namespace tr::cuda {

// `compiler`: gives that which is used, at every launch. `ptx`: it makes PTX.
std::unique_ptr<Launcher> make_compiling_launcher(const KernelCompiler &(*compiler)(), int capability, bool ptx);

}  // namespace tr::cuda
