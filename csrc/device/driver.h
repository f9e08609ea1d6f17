// The CUDA driver of this machine, loaded when it is first asked for.
#pragma once

#include <string>

#include "driver_api.h"

namespace tr::cuda {

// std::runtime_error with one sentence if there is no driver, or one that is older than 525. It is not started, after
// which a process could not fork any more without losing it.
const Api &find_driver();

// The same for a table of functions.
void check_version(const Api &api);

// Starts it. std::runtime_error if that fails, or there is no card.
void start(const Api &api);

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
