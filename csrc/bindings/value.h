// What Python and the core say to each other: None, booleans, numbers, texts, lists and dicts, as bytes in the format
// of Python's module marshal, version 2, which every Python writes and reads natively. So no header of Python is
// needed, and one library serves all its versions.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

namespace tr {

// An argument of another type than expected.
struct TypeError : std::invalid_argument {
    using std::invalid_argument::invalid_argument;
};

struct Bytes {
    std::string content;
};

class Value {
public:
    using List = std::vector<Value>;
    using Dict = std::vector<std::pair<std::string, Value>>;

    Value() = default;
    Value(bool x) : content_(x) {}
    template <class T, std::enable_if_t<std::is_integral_v<T>, int> = 0>
    Value(T x) : content_(Integer{x < T(0), uint64_t(x)}) {}
    Value(double x) : content_(x) {}
    Value(std::string x) : content_(std::move(x)) {}
    Value(const char *x) : content_(std::string(x)) {}
    Value(Bytes x) : content_(std::move(x)) {}
    Value(List x) : content_(std::move(x)) {}
    Value(Dict x) : content_(std::move(x)) {}
    template <class T, size_t N>
    Value(const std::array<T, N> &x) : content_(List(x.begin(), x.end())) {}
    template <class T, std::enable_if_t<!std::is_same_v<T, Value>, int> = 0>
    Value(const std::vector<T> &x) : content_(List(x.begin(), x.end())) {}
    template <class T>
    Value(const std::map<std::string, T> &x) : content_(Dict(x.begin(), x.end())) {}

    bool is_none() const { return std::holds_alternative<std::monostate>(content_); }
    // TypeError unless this is of that kind.
    const List &list() const { return get<List>("a list"); }
    const Dict &dict() const { return get<Dict>("a dict"); }
    const Bytes &bytes() const { return get<Bytes>("an object of this library"); }

    // Of a dict; null: there is no such entry.
    const Value *find(const char *key) const {
        for (const auto &[name, value] : dict())
            if (name == key) return &value;
        return nullptr;
    }
    const Value &operator[](const char *key) const {
        if (const Value *found = find(key)) return *found;
        throw std::invalid_argument(std::string(key) + ": is missing");
    }

    // TypeError unless it is one, or a number that T cannot hold.
    template <class T>
    T as() const {
        T result;
        read(result);
        return result;
    }

    std::string to_bytes() const;
    static Value from_bytes(const char *bytes, size_t size);

private:
    struct Integer {
        bool negative;
        uint64_t bits;  // two's complement
    };
    friend class MarshalReader;
    friend class MarshalWriter;

    [[noreturn]] void refuse(const char *expected) const;

    template <class T>
    const T &get(const char *expected) const {
        if (const T *found = std::get_if<T>(&content_)) return *found;
        refuse(expected);
    }

    void read(Value &to) const { to = *this; }
    void read(bool &to) const { to = get<bool>("True or False"); }
    void read(std::string &to) const { to = get<std::string>("a text"); }
    void read(double &to) const {
        const Integer *integer = std::get_if<Integer>(&content_);
        to = !integer            ? get<double>("a number")
             : integer->negative ? double(int64_t(integer->bits))
                                 : double(integer->bits);
    }
    template <class T, std::enable_if_t<std::is_integral_v<T>, int> = 0>
    void read(T &to) const {
        const Integer &x = get<Integer>("an integer");
        to = T(x.bits);
        if (x.negative ? !std::is_signed_v<T> || int64_t(x.bits) < int64_t(std::numeric_limits<T>::min())
                       : x.bits > uint64_t(std::numeric_limits<T>::max()))
            refuse("an integer in range");
    }
    template <class T>
    void read(std::vector<T> &to) const {
        const List &from = list();
        to.reserve(from.size());
        for (const Value &one : from) to.push_back(one.as<T>());
    }
    template <class T, size_t N>
    void read(std::array<T, N> &to) const {
        const List &from = list();
        if (from.size() != N) refuse(("a list of " + std::to_string(N)).c_str());
        for (size_t i = 0; i < N; ++i) from[i].read(to[i]);
    }
    template <class... T>
    void read(std::tuple<T...> &to) const {
        const List &from = list();
        if (from.size() != sizeof...(T)) refuse(("a list of " + std::to_string(sizeof...(T))).c_str());
        size_t i = 0;
        std::apply([&](T &...each) { (from[i++].read(each), ...); }, to);
    }
    template <class A, class B>
    void read(std::pair<A, B> &to) const {
        auto [first, second] = as<std::tuple<A, B>>();
        to = {std::move(first), std::move(second)};
    }
    template <class T>
    void read(std::map<std::string, T> &to) const {
        for (const auto &[name, value] : dict()) value.read(to[name]);
    }

    std::variant<std::monostate, bool, Integer, double, std::string, Bytes, List, Dict> content_;
};

}  // namespace tr
