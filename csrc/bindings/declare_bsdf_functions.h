// The functions of BSDFs as Python sees them.
#pragma once

#include "bsdf_functions.h"
#include "functions.h"

namespace tr {

// What of it never changes. `fields`: names of the continuous ones, and of those that are colours, that are variables,
// and whose luminance is one.
inline Value::Dict attributes(const BsdfFunctions &functions) {
    const BsdfInfo &info = functions.info();
    Value::List all, colors, variables, luminance;
    for (int i = 0; i < info.n_continuous; ++i) {
        const Value name = info.model->fields[i].name;
        all.push_back(name);
        if (info.use[i] == BsdfInfo::Color) colors.push_back(name);
        if (i < info.n_differentiable) variables.push_back(name);
        if (i == info.luminance_of) luminance.push_back(name);
    }
    return {
        {"fields", Value::Dict{{"all", all}, {"colors", colors}, {"variables", variables}, {"luminance", luminance}}},
        {"channels", functions.channels()},
        {"tabulated", info.tabulated},
        {"turned_by", info.turned_by}};
}

inline void declare_bsdf_functions(Functions &f) {
    using Self = BsdfFunctions;
    f.add("BsdfFunctions",
          [](const std::string &type, const std::string &dtype, int channels, const std::vector<int32_t> &choices) {
              std::shared_ptr<Self> functions = make_bsdf_functions(type, dtype, channels, choices);
              return made(functions, attributes(*functions));
          });
    f.add("BsdfFunctions.eval",
          [](Self &self, size_t n, const Addresses &params, const Arrays &arrays) { self.eval(n, params, arrays); });
    f.add("BsdfFunctions.pdf",
          [](Self &self, size_t n, const Addresses &params, const Arrays &arrays) { self.pdf(n, params, arrays); });
    f.add("BsdfFunctions.sample",
          [](Self &self, size_t n, const Addresses &params, const Arrays &arrays) { self.sample(n, params, arrays); });
    f.add("BsdfFunctions.eval_derivative",
          [](Self &self, size_t n, const Addresses &params, const Arrays &arrays, const Addresses &by_variable) {
              self.eval_derivative(n, params, arrays, by_variable);
          });
    f.add("BsdfFunctions.direction_derivative",
          [](Self &self, size_t n, const Addresses &params, const Arrays &arrays) {
              self.direction_derivative(n, params, arrays);
          });
}

}  // namespace tr
