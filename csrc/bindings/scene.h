// A scene as Python sees it: one class for all variants.
#pragma once

#include <pybind11/pybind11.h>

namespace tr {

void declare_scene(pybind11::module_ &m);

}  // namespace tr
