// The tree of outlines as Python sees it.
#pragma once

#include <pybind11/pybind11.h>

#include <memory>
#include <thread>

#include "host/outline_tree.h"

namespace tr {

namespace py = pybind11;

inline void declare_outlines(py::module_ &m) {
    using Release = py::call_guard<py::gil_scoped_release>;
    // rows of 32-bit numbers, as torchrender/visibility/tree.py makes them
    static_assert(sizeof(OutlineElement) == 17 * 4 && sizeof(OutlineAnchor) == 13 * 4 &&
                  sizeof(OutlineChoice) == 3 * 4);
    m.def(
        "morton_order",
        [](uintptr_t places, size_t n, uintptr_t order) {
            const std::vector<int32_t> found = morton_order(reinterpret_cast<const float *>(places), n);
            std::copy(found.begin(), found.end(), reinterpret_cast<int32_t *>(order));
        },
        Release());
    py::class_<OutlineTree>(m, "OutlineTree", py::module_local())
        .def(py::init([](uintptr_t elements, size_t n, uintptr_t order) {
                 const auto *first = reinterpret_cast<const OutlineElement *>(elements);
                 return std::make_unique<OutlineTree>(std::vector<OutlineElement>(first, first + n),
                                                      reinterpret_cast<const int32_t *>(order));
             }),
             Release())
        .def(
            "choose",
            [](const OutlineTree &self, uintptr_t anchors, size_t n, uint64_t seed, size_t threads, uintptr_t choices) {
                const auto *from = reinterpret_cast<const OutlineAnchor *>(anchors);
                auto *to = reinterpret_cast<OutlineChoice *>(choices);
                auto run = [&](size_t begin, size_t end) {
                    for (size_t i = begin; i < end; ++i)
                        to[i] = self.choose(from[i], seed + uint64_t(i) * 0xD1342543DE82EF95ull);
                };
                threads = std::max<size_t>(1, std::min(threads, n / 256));
                std::vector<std::thread> others;
                for (size_t t = 1; t < threads; ++t) others.emplace_back(run, n * t / threads, n * (t + 1) / threads);
                run(0, n / threads);
                for (std::thread &other : others) other.join();
            },
            Release());
}

}  // namespace tr
