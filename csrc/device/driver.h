// The CUDA driver of this machine, loaded when it is first asked for.
#pragma once

#include <string>

#include "driver_api.h"

namespace tr::cuda {

// std::runtime_error with one sentence if there is no driver, one that is older than 525, or no card.
const Api &load_driver();

// The same for a table of functions: version and cards.
void check_driver(const Api &api);

// std::runtime_error for an error: what was being done, its name and the driver's words; std::bad_alloc where memory is
// used up.
void check(const Api &api, Result result, const std::string &doing);

struct Card {
    std::string name;
    int capability;  // 10 * major + minor
    int multiprocessors;
};
Card card(const Api &api, int ordinal);

// The driver's version as CUDA counts, 12.2 say.
std::string driver_version(const Api &api);

}  // namespace tr::cuda
