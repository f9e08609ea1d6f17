// Lists of models, and what is looked up in them when the program is compiled.
#pragma once

#include <type_traits>

#include "math/config.h"

namespace tr {

template <class... Ts>
struct TypeList {
    static constexpr int Size = sizeof...(Ts);
};

// The position of a model in its list.
template <class Model, class... Ts>
constexpr int kind_of_model(TypeList<Ts...>) {
    int i = 0;
    (void)((std::is_same_v<Model, Ts> ? true : (++i, false)) || ...);
    return i;
}

// Calls f with a value of the type at position `kind`.
template <class F, class... Ts>
TR_INLINE void dispatch(TypeList<Ts...>, int kind, F &&f) {
    int i = 0;
    (void)((i++ == kind ? (f(Ts{}), true) : false) || ...);
}

}  // namespace tr
