// A loop over many small things, in as many ranges as there are threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <exception>
#include <vector>

#include "team.h"

namespace tr {

// Calls visit(begin, end, number) for ranges of 0 .. n, in this order of numbers, at once; `few` are not worth a
// thread.
template <class Visit>
void for_ranges(size_t n, int threads, Visit &&visit, size_t few = 4096) {
    const size_t ranges = std::max<size_t>(1, std::min(size_t(std::max(1, threads)), n / few));
    std::vector<std::exception_ptr> errors(ranges);
    auto run = [&](int r) {
        try {
            visit(n * size_t(r) / ranges, n * size_t(r + 1) / ranges, r);
        } catch (...) {
            errors[size_t(r)] = std::current_exception();
        }
    };
    run_team(int(ranges), run, run);
    for (const auto &error : errors)
        if (error) std::rethrow_exception(error);
}

}  // namespace tr
