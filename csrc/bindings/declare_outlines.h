// The outlines of a scene as Python holds them.
#pragma once

#include <pybind11/pybind11.h>

#include <memory>

#include "native_scene.h"

namespace tr {

namespace py = pybind11;

inline void declare_outlines(py::module_ &m) {
    // Integers of 64 bits: of H half edges both ends, third corners, shapes and whether they are turned (H, 5); where
    // those of each edge begin (E + 1); shapes and kinds of curves (C, 2); the first vertex of each shape (S); pairs of
    // vertices in one place, with their shapes (D, 4).
    py::class_<SceneOutlines>(m, "Outlines", py::module_local())
        .def(py::init([](uintptr_t halves, size_t n_halves, uintptr_t begin, size_t n_edges, uintptr_t curves,
                         size_t n_curves, uintptr_t first_vertex, size_t n_shapes, uintptr_t copies, size_t n_copies) {
                 auto at = [](uintptr_t address) { return reinterpret_cast<const int64_t *>(address); };
                 const int64_t *h = at(halves), *c = at(curves), *d = at(copies);
                 std::vector<HalfEdge> half_edges(n_halves);
                 for (size_t i = 0; i < n_halves; ++i, h += 5)
                     half_edges[i] = {uint32_t(h[0]), uint32_t(h[1]), uint32_t(h[2]), uint32_t(h[3]) & 0x7FFFFFFFu,
                                      uint32_t(h[4]) & 1u};
                 std::vector<OutlineCurve> all(n_curves);
                 for (size_t i = 0; i < n_curves; ++i, c += 2) all[i] = {int32_t(c[0]), int32_t(c[1])};
                 OutlineSet set(std::move(half_edges), {at(begin), at(begin) + n_edges + 1}, std::move(all),
                                {at(first_vertex), at(first_vertex) + n_shapes}, {d, d + 4 * n_copies});
                 return std::make_unique<SceneOutlines>(SceneOutlines{std::move(set), {}});
             }),
             py::call_guard<py::gil_scoped_release>());
}

}  // namespace tr
