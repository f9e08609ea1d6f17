// Functions that Python calls by name. A C++ function of numbers, texts, containers and objects is put into the list as
// it is: what it takes is read from the values that came, and what it returns is made one.
#pragma once

#include <cstring>
#include <functional>
#include <memory>

#include "value.h"

namespace tr {

// Polled by the calling thread with the share that is done; not 0: stop. Null: nobody wants to stop.
using Progress = int (*)(double);

// Stopped by Progress.
struct Interrupted {};

// What Python holds on to. It passes the address of one, as bytes.
struct Handle {
    virtual ~Handle() = default;
};

template <class T>
struct HandleOf final : Handle {
    explicit HandleOf(std::shared_ptr<T> o) : object(std::move(o)) {}
    std::shared_ptr<T> object;
};

// None: null. TypeError for an object of another class.
template <class T>
std::shared_ptr<T> object_of(const Value &value) {
    if (value.is_none()) return nullptr;
    const std::string &bytes = value.bytes().content;
    Handle *handle = nullptr;
    if (bytes.size() != sizeof(handle)) throw TypeError("expected an object of this library, got bytes");
    std::memcpy(&handle, bytes.data(), sizeof(handle));
    auto *typed = dynamic_cast<HandleOf<T> *>(handle);
    if (!typed) throw TypeError("an object of another class than expected");
    return typed->object;
}

// A new object, and what of it never changes by name, as Python gets them.
template <class T>
Value made(std::shared_ptr<T> object, Value::Dict attributes = {}) {
    Handle *handle = std::make_unique<HandleOf<T>>(std::move(object)).release();
    return Value::List{reinterpret_cast<uintptr_t>(handle), std::move(attributes)};
}

// How an argument is kept while the function runs. Classes are passed as `T &`, `T *` or a shared pointer, everything
// else by value or constant reference.
template <class A>
struct Argument {
    using T = std::decay_t<A>;
    static constexpr bool is_object = std::is_lvalue_reference_v<A> && !std::is_const_v<std::remove_reference_t<A>>;

    explicit Argument(const Value &value) {
        if constexpr (is_object) {
            kept = object_of<T>(value);
            if (!kept) throw TypeError("expected an object, got None");
        } else {
            kept = value.as<T>();
        }
    }
    A get() {
        if constexpr (is_object)
            return *kept;
        else
            return static_cast<A>(kept);
    }
    std::conditional_t<is_object, std::shared_ptr<T>, T> kept;
};

template <class T>
struct Argument<std::shared_ptr<T>> {
    explicit Argument(const Value &value) : kept(object_of<T>(value)) {}
    std::shared_ptr<T> get() { return kept; }
    std::shared_ptr<T> kept;
};

class Functions {
public:
    // `f`: a function of any arguments, which may have Progress in front of them. Arguments that are not given are
    // None.
    template <class R, class... A>
    void add(const char *name, R (*f)(A...)) {
        all_[name] = [f](Progress, const Value::List &given) {
            return called<R>(given, f, std::index_sequence_for<A...>());
        };
    }
    template <class R, class... A>
    void add(const char *name, R (*f)(Progress, A...)) {
        all_[name] = [f](Progress progress, const Value::List &given) {
            auto bound = [&](A... arguments) -> R { return f(progress, std::forward<A>(arguments)...); };
            return called<R, A...>(given, bound, std::index_sequence_for<A...>());
        };
    }
    template <class Lambda>
    void add(const char *name, Lambda lambda) {
        add(name, +lambda);
    }

    Value call(const std::string &name, Progress progress, const Value::List &given) const {
        auto found = all_.find(name);
        if (found == all_.end()) throw TypeError("there is no function " + name);
        return found->second(progress, given);
    }

private:
    static const Value &at(const Value::List &given, size_t i) {
        static const Value none;
        return i < given.size() ? given[i] : none;
    }
    template <class R, class... A, size_t... I>
    static Value called(const Value::List &given, R (*f)(A...), std::index_sequence<I...> indices) {
        return called<R, A...>(given, [f](A... a) -> R { return f(std::forward<A>(a)...); }, indices);
    }
    template <class R, class... A, class F, size_t... I>
    static Value called(const Value::List &given, const F &f, std::index_sequence<I...>) {
        if (given.size() > sizeof...(A))
            throw TypeError("expected " + std::to_string(sizeof...(A)) + " arguments, got " +
                            std::to_string(given.size()));
        [[maybe_unused]] std::tuple<Argument<A>...> arguments{at(given, I)...};
        if constexpr (std::is_void_v<R>) {
            f(std::get<I>(arguments).get()...);
            return {};
        } else {
            return f(std::get<I>(arguments).get()...);
        }
    }

    std::map<std::string, std::function<Value(Progress, const Value::List &)>> all_;
};

}  // namespace tr
