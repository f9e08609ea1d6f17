// Kernels that are compiled at once: NVRTC takes half a second to three for one, and from version 12.9 on several
// threads may have it compile.
#pragma once

#include <functional>
#include <future>
#include <string>

namespace tr::cuda {

// What compile() returns or throws. It runs beside the others that were asked for, as many at once as there are
// processors, but no more than eight, which take some hundred megabytes each.
std::future<std::string> compile_beside(std::function<std::string()> compile);

}  // namespace tr::cuda
