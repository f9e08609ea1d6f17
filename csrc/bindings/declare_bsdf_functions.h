// The functions of BSDFs as Python sees them.
#pragma once

#include <pybind11/stl.h>

#include "bsdf_functions.h"

namespace tr {

namespace py = pybind11;

inline void declare_bsdf_functions(py::module_ &m) {
    py::class_<BsdfFunctions>(m, "BsdfFunctions", py::module_local())
        .def(py::init(&make_bsdf_functions), py::arg("type"), py::arg("dtype"), py::arg("channels"), py::arg("choices"))
        // Names of the continuous fields, and of those that are colours, that are variables, and whose luminance is
        // one.
        .def_property_readonly("fields",
                               [](const BsdfFunctions &self) {
                                   const BsdfInfo &info = self.info();
                                   py::list all, colors, variables, luminance;
                                   for (int i = 0; i < info.n_continuous; ++i) {
                                       const py::str name(info.model->fields[i].name);
                                       all.append(name);
                                       if (info.use[i] == BsdfInfo::Color) colors.append(name);
                                       if (i < info.n_differentiable) variables.append(name);
                                       if (i == info.luminance_of) luminance.append(name);
                                   }
                                   return py::dict(py::arg("all") = all, py::arg("colors") = colors,
                                                   py::arg("variables") = variables, py::arg("luminance") = luminance);
                               })
        .def_property_readonly("channels", &BsdfFunctions::channels)
        .def_property_readonly("tabulated", [](const BsdfFunctions &self) { return self.info().tabulated; })
        .def_property_readonly("turned_by", [](const BsdfFunctions &self) { return self.info().turned_by; })
        .def("eval", &BsdfFunctions::eval, py::call_guard<py::gil_scoped_release>())
        .def("pdf", &BsdfFunctions::pdf, py::call_guard<py::gil_scoped_release>())
        .def("sample", &BsdfFunctions::sample, py::call_guard<py::gil_scoped_release>())
        .def("eval_derivative", &BsdfFunctions::eval_derivative, py::call_guard<py::gil_scoped_release>())
        .def("direction_derivative", &BsdfFunctions::direction_derivative, py::call_guard<py::gil_scoped_release>());
}

}  // namespace tr
