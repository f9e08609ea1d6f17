// Colours as spectra, as Python asks for them.
#pragma once

#include <map>
#include <stdexcept>
#include <string>

#include "cpu/upsampling.h"
#include "functions.h"

namespace tr {

// `arrays`: addresses of the table's rows, nodes and cells, of n colours, of what the call is given and of what it
// makes.
template <class S>
void upsample_colours(const std::string &what, const std::map<std::string, uintptr_t> &arrays, int32_t size, bool light,
                      int threads, size_t n) {
    auto at = [&](const char *name) { return reinterpret_cast<S *>(arrays.at(name)); };
    auto cells = [&](const char *name) { return reinterpret_cast<const int32_t *>(arrays.at(name)); };
    const UpsamplingCall<S> call{
        {at("rows"), {at("value_nodes"), at("ratio_nodes")}, {cells("value_cells"), cells("ratio_cells")}, size},
        light,
        threads,
        n,
        at("rgb")};
    if (what == "values") return upsample(call, at("out"));
    if (what == "reverse") return upsample_reverse(call, at("given"), at("out"));
    if (what == "forward") return upsample_forward(call, at("given"), at("out"));
    throw std::invalid_argument("upsample: unknown: " + what);
}

inline void declare_upsampling(Functions &f) {
    f.add("upsample",
          [](const std::string &what, const std::string &dtype, const std::map<std::string, uintptr_t> &arrays,
             int32_t size, bool light, int threads, size_t n) {
              if (dtype == "float32") return upsample_colours<float>(what, arrays, size, light, threads, n);
#if !TR_HAS_PACKETS
              if (dtype == "float64") return upsample_colours<double>(what, arrays, size, light, threads, n);
#endif
              throw std::invalid_argument("upsample: dtype: this module does not compute in " + dtype);
          });
}

}  // namespace tr
