// A loop over many small things, in as many ranges as there are threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <exception>
#include <system_error>
#include <thread>
#include <vector>

namespace tr {

// Calls visit(begin, end, number) for ranges of 0 .. n, in this order of numbers, at once; `few` are not worth a
// thread.
template <class Visit>
void for_ranges(size_t n, int threads, Visit &&visit, size_t few = 4096) {
    const size_t ranges = std::max<size_t>(1, std::min(size_t(std::max(1, threads)), n / few));
    std::vector<std::exception_ptr> errors(ranges);
    auto run = [&](size_t r) {
        try {
            visit(n * r / ranges, n * (r + 1) / ranges, int(r));
        } catch (...) {
            errors[r] = std::current_exception();
        }
    };
    std::vector<std::thread> others;
    size_t left = ranges;
    try {
        for (size_t r = 1; r < ranges; ++r) others.emplace_back(run, r);
    } catch (const std::system_error &) {  // no more threads to be had
        left = others.size() + 1;
    }
    run(0);
    for (size_t r = left; r < ranges; ++r) run(r);
    for (std::thread &t : others) t.join();
    for (const auto &error : errors)
        if (error) std::rethrow_exception(error);
}

}  // namespace tr
